"""Tables as text for the terminal."""

import math
import textwrap
from collections.abc import Sequence

from nassim.base.progress import WIDTH

GAP = "  "
MOST_HEADING_LINES = 4
"""Largest number of lines of a heading."""

Columns = list[list[str]]


def text_table(rows: Sequence[Sequence[str]], *, width: int = WIDTH) -> str:
    """Format rows of cells as lines of text.

    If the table is too wide, its headings are broken into several lines. Columns that still do not fit follow below,
    with the row names repeated.

    Args:
        rows: cells; the first row holds the headings, the first column the row names
        width: largest width of a line [characters]
    """
    columns = [list(column) for column in zip(*rows, strict=True)]
    folded = columns
    for height in range(2, MOST_HEADING_LINES + 1):
        if _width(folded) <= width:
            break
        folded = _fold_headings(columns, height)
    names, *others = folded
    blocks = [[names]]
    for column in others:
        if len(blocks[-1]) > 1 and _width([*blocks[-1], column]) > width:
            blocks.append([names])
        blocks[-1].append(column)
    return "\n\n".join(map(_text, blocks))


def rounded(value: float, deviation: float, *, digits: int = 1) -> str:
    """Format a number down to the first digits of its standard deviation, or to five digits without a positive one."""
    if not (value and 0 < deviation < math.inf):
        return f"{value:.5g}"
    shown = max(1, math.floor(math.log10(abs(value))) - math.floor(math.log10(deviation)) + digits)
    return f"{value:#.{shown}g}".rstrip(".").replace(".e", "e")


def with_deviation(value: float, deviation: float) -> str:
    """Format a number with its standard deviation, both to the first digit of the deviation."""
    return f"{rounded(value, deviation)} ± {deviation:.1g}"


def _width(columns: Columns) -> int:
    return sum(max(map(len, column)) for column in columns) + len(GAP) * (len(columns) - 1)


def _fold_headings(columns: Columns, height: int) -> Columns:
    """Break the headings into `height` lines; shorter headings get empty lines at the top."""
    result = []
    for heading, *cells in columns:
        least = max(map(len, ["", *heading.split(), *cells]))
        widths = range(max(least, 1), max(least, len(heading)) + 1)
        lines = next(lines for w in widths if len(lines := textwrap.wrap(heading, w)) <= height)
        result.append([""] * (height - len(lines)) + lines + cells)
    return result


def _text(columns: Columns) -> str:
    widths = [max(map(len, column)) for column in columns]
    lines = [
        GAP.join([name.ljust(widths[0]), *map(str.rjust, cells, widths[1:])]).rstrip()
        for name, *cells in zip(*columns, strict=True)
    ]
    return "\n".join(filter(None, lines))
