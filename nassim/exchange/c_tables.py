"""Pieces of C source: identifiers, numbers, and matrices as tables of their nonzero entries by rows.

What is not coupled, such as modes, has zeros between its parts and costs nothing.
"""

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from nassim.base.checks import Array, known

RESERVED = """
    auto break case char const continue default do double else enum extern float for goto if inline int
    long register restrict return short signed sizeof static struct switch typedef union unsigned void volatile while
"""
"""Keywords of C99."""
PRECISIONS = {"double": ("double", "", 8), "single": ("float", "f", 4)}
"""C type, suffix of its functions and literals, and bytes, of each precision."""
IN_A_LINE = 6
PRODUCT = """\
/* A matrix by its nonzero entries: those of row r are the entries first[r] ... first[r + 1] - 1. */
typedef struct {
    int rows;
    const int *first;
    const int *column;
    const real *value;
} table;

/* y = y + T x */
static void add_product(const table *t, const real *x, real *y)
{
    int r, k;
    for (r = 0; r < t->rows; r++) {
        real sum = y[r];
        for (k = t->first[r]; k < t->first[r + 1]; k++)
            sum += t->value[k] * x[t->column[k]];
        y[r] = sum;
    }
}
"""


def checked_identifier(name: str) -> str:
    """Return a name that is an identifier of C.

    Args:
        name: the name.

    Raises:
        ValueError: for another name.
    """
    if not isinstance(name, str) or not re.fullmatch(r"[A-Za-z][A-Za-z0-9_]*", name) or name in RESERVED.split():
        raise ValueError(
            f"name must be an identifier of C (a letter, then letters, digits and _; no keyword), got {name!r}; "
            f"{as_identifier(str(name))!r} would be one"
        )
    return name


def as_identifier(name: str) -> str:
    """Return the identifier of C that is nearest to a name."""
    result = re.sub(r"[^A-Za-z0-9_]", "_", name)
    if not re.match(r"[A-Za-z]", result):
        result = f"n_{result.lstrip('_')}"
    return f"{result}_" if result in RESERVED.split() else result


def as_identifiers(names: Sequence[str]) -> list[str]:
    """Return different identifiers for different names; a number tells apart what would be the same."""
    result: list[str] = []
    for name in names:
        wanted = found = as_identifier(name)
        count = 1
        while found.upper() in {other.upper() for other in result}:
            count += 1
            found = f"{wanted}_{count}"
        result.append(found)
    return result


def comment(text: str) -> str:
    """Return a text that may stand in a comment of C: printable, in one line, without the end of a comment."""
    one_line = " ".join("".join(c if c.isprintable() else " " for c in text).split())
    return one_line.replace("*/", "* /").replace("/*", "/ *").replace("??", "? ?")


@dataclass(frozen=True)
class CNumbers:
    """How numbers are written in C.

    Attributes:
        precision: "double" or "single".
    """

    precision: str = "double"

    def __post_init__(self) -> None:
        known("precision", self.precision, PRECISIONS)

    @property
    def kind(self) -> str:
        """Type of C."""
        return PRECISIONS[self.precision][0]

    @property
    def suffix(self) -> str:
        """Suffix of the type's functions and literals."""
        return PRECISIONS[self.precision][1]

    @property
    def size(self) -> int:
        """Bytes of a number."""
        return PRECISIONS[self.precision][2]

    def literal(self, value: float) -> str:
        """Return the shortest literal of a number that has its value in this precision.

        Raises:
            ValueError: for a finite number that is too large for the precision.
        """
        if math.isinf(value):
            return "HUGE_VAL" + self.suffix.upper() if value > 0 else "-HUGE_VAL" + self.suffix.upper()
        if self.precision == "double":
            return repr(float(value))
        if abs(value) > float(np.finfo(np.float32).max):
            raise ValueError(f"{value:g} is too large for single precision; take precision='double'")
        return np.format_float_scientific(np.float32(value), trim="0") + "f"


def array(kind: str, name: str, items: Sequence[str]) -> str:
    """Return the definition of a constant array; an empty one has one entry, as C has no empty arrays."""
    items = list(items) or ["0"]
    rows = [", ".join(items[k : k + IN_A_LINE]) for k in range(0, len(items), IN_A_LINE)]
    return f"static const {kind} {name}[{len(items)}] = {{\n    " + ",\n    ".join(rows) + "\n};\n"


@dataclass(frozen=True)
class CTables:
    """A matrix for each kind of sample, as C.

    Attributes:
        name: identifier of the array of tables.
        text: definitions; empty where all entries are zero, so that nothing need be done.
        entries: largest number of nonzero entries: multiplications of a product.
        bytes: memory of the constants.
    """

    name: str
    text: str
    entries: int
    bytes: int

    @classmethod
    def of(cls, name: str, matrices: Sequence[Array], numbers: CNumbers) -> "CTables":
        """Write matrices of the same shape, one for each kind of sample."""
        places = [np.nonzero(matrix) for matrix in matrices]
        entries = max(len(rows) for rows, _ in places)
        if not entries:
            return cls(name, "", 0, 0)
        text, size = "", 0
        for k, (matrix, (rows, columns)) in enumerate(zip(matrices, places, strict=True)):
            first = np.concatenate([[0], np.cumsum(np.bincount(rows, minlength=len(matrix)))])
            text += array("int", f"{name}_first_{k}", list(map(str, first.tolist())))
            text += array("int", f"{name}_column_{k}", list(map(str, columns.tolist())))
            text += array("real", f"{name}_value_{k}", [numbers.literal(v) for v in matrix[rows, columns].tolist()])
            size += 4 * (len(first) + len(columns)) + numbers.size * len(rows)
        listed = ",\n    ".join(
            f"{{{len(matrix)}, {name}_first_{k}, {name}_column_{k}, {name}_value_{k}}}"
            for k, matrix in enumerate(matrices)
        )
        return cls(name, f"{text}static const table {name}[{len(matrices)}] = {{\n    {listed}\n}};\n", entries, size)

    def product(self, argument: str, result: str, kind: str = "0") -> str:
        """Return the statement that adds the product with a vector to a result; empty where nothing is added."""
        return f"    add_product(&{self.name}[{kind}], {argument}, {result});\n" if self.text else ""
