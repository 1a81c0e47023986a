"""Curves of universal files (UFF), data set 58, in SI units."""

import re
import tempfile
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from nassim.base.checks import Array
from nassim.base.units import to_si

CURVE_KINDS = {1: "time", 4: "frf", 6: "coherence", 26: "multiple coherence"}
"""Function types that are read; other data sets are ignored."""
BORDER = re.compile(rb"    -1 *(?=[\r\n]|\Z)")
"""First and last line of every data set; binary data may stand before the last one without a line break."""
BINARY = re.compile(rb"    -1\s*[\r\n] *58b", re.IGNORECASE)
FORTRAN_EXPONENT = re.compile(rb"(?<=\d)[Dd](?=[+-]\d\d)")


@dataclass(frozen=True, kw_only=True)
class Curve:
    """One data set 58 in SI units.

    Attributes:
        kind: "time", "frf", "coherence" (of one reference) or "multiple coherence"
        number: number of the data set in its file, from 1
        x: times [s] or frequencies [Hz], shape (n,)
        values: values in `unit`, shape (n,); complex for FRFs
        output: name of the response
        input: name of the reference
        unit: SI unit of the values
        node: node and direction of the response, such as "12 z"
    """

    kind: str
    number: int
    x: Array
    values: Array
    output: str
    input: str
    unit: str
    node: str


def read_curves(path: Path) -> tuple[Curve, ...]:
    """Read all time responses, FRFs and coherences of a universal file, ASCII or binary.

    The names of a curve are the axis labels of its ordinate (numerator and denominator), which hold 20 characters;
    otherwise its entity names; otherwise node and direction such as "12 z". Where curves of several nodes or directions
    have one label, these are added: "Acceleration 12 z". Its units are the unit labels of the axes. A data set without
    them is refused, because it cannot be converted to SI.

    Args:
        path: of the file

    Raises:
        FileNotFoundError: if there is no such file
        ValueError: if a data set cannot be read; the message names file, data set and cause
        RuntimeError: without the package pyuff
    """
    try:
        import pyuff  # noqa: PLC0415 - an optional dependency, needed by few
    except ImportError as error:
        raise RuntimeError('reading UFF files needs the package pyuff: pip install "nassim[uff]"') from error
    if not path.exists():
        raise FileNotFoundError(f"no such file: {path}")
    plain, contents = BORDER.sub(b"    -1", path.read_bytes()), {}
    if not BINARY.search(plain):
        plain = FORTRAN_EXPONENT.sub(b"E", plain)
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / path.name
        copy.write_bytes(plain)
        file = pyuff.UFF(str(copy))
        kinds = file.get_set_types()
        if len(BORDER.findall(plain)) != 2 * len(kinds):
            raise ValueError(f"{path}: a data set lacks its first or last line, -1; is the file cut off?")
        for index, kind in enumerate(kinds):
            if kind != 58:
                continue
            try:
                content = file.read_sets(index)
            except Exception as error:  # pyuff raises bare exceptions
                raise ValueError(
                    f"{path}, data set {index + 1}: it cannot be read as a data set 58 ({error})"
                ) from error
            if content["func_type"] in CURVE_KINDS:
                contents[index + 1] = content
    if not contents:
        raise ValueError(f"{path}: the file holds no time response, FRF or coherence as data set 58")
    outputs, inputs = (_names(list(contents.values()), *of) for of in (("ordinate", "rsp"), ("orddenom", "ref")))
    curves = []
    for (number, content), output, input in zip(contents.items(), outputs, inputs, strict=True):
        try:
            curves.append(_curve(content, number, output, input))
        except ValueError as error:
            raise ValueError(f"{path}, data set {number}: {error}") from error
    return tuple(curves)


def _curve(content: dict[str, Any], number: int, output: str, input: str) -> Curve:
    """Convert the content of a data set to a curve."""
    kind = CURVE_KINDS[content["func_type"]]
    x, values = np.asarray(content["x"], dtype=float), np.asarray(content["data"])
    if not len(values) or len(values) != content["num_pts"] or len(x) != len(values):
        raise ValueError(f"{len(values)} values but the header announces {content['num_pts']}; is the file cut off?")
    if not (np.all(np.isfinite(x)) and np.all(np.isfinite(values))):
        raise ValueError(f"value {1 + int(np.argmin(np.isfinite(values)))} is not finite")
    x_factor, x_unit = to_si(_unit(content, "abscissa"))
    if x_unit != ("s" if kind == "time" else "Hz"):
        raise ValueError(f"the axis of a {kind} is in {x_unit}")
    factor, unit = 1.0, "-"
    if kind in ("time", "frf"):
        factor, unit = to_si(_unit(content, "ordinate"))
    if kind == "frf":
        below, unit_below = to_si(_unit(content, "orddenom"))
        factor, unit = factor / below, f"{unit}/{unit_below}"
    return Curve(
        kind=kind,
        number=number,
        x=x_factor * x,
        values=factor * values,
        output=output,
        input=input,
        unit=unit,
        node=_node(content, "rsp"),
    )


def _unit(content: dict[str, Any], axis: str) -> str:
    """Return the unit of an axis."""
    unit = str(content.get(f"{axis}_axis_units_lab", "")).strip()
    if unit in ("", "NONE"):
        raise ValueError(f"its {axis} has no unit (axis units label), such as V or um")
    return unit


def _names(contents: list[dict[str, Any]], axis: str, entity: str) -> list[str]:
    """Return the name of an axis, entity or node of each data set."""
    labels = [_label(content, axis, entity) for content in contents]
    nodes = [_node(content, entity) for content in contents]
    # Coherences may lack the nodes of their responses, so each kind of curve counts alone.
    different = set(zip(labels, nodes, (content["func_type"] for content in contents), strict=True))
    n_nodes = Counter((label, kind) for label, _, kind in different)
    several = {label for (label, _), n in n_nodes.items() if n > 1}
    return [
        label if label and label not in several else f"{label} {node}".strip()
        for label, node in zip(labels, nodes, strict=True)
    ]


def _label(content: dict[str, Any], axis: str, entity: str) -> str:
    """Return the label of an axis or the name of an entity, '' if there is none."""
    names = (str(content.get(key, "")).strip() for key in (f"{axis}_axis_lab", f"{entity}_ent_name"))
    return next((name for name in names if name not in ("", "NONE")), "")


def _node(content: dict[str, Any], entity: str) -> str:
    """Return node and direction, such as "12 z"."""
    direction = int(content.get(f"{entity}_dir", 0))
    axes = ("", "x", "y", "z", "rx", "ry", "rz")
    sign = "-" if direction < 0 else ""
    return f"{content.get(f'{entity}_node', 0)} {sign}{axes[min(abs(direction), 6)]}".strip()
