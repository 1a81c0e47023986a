"""Rows of a study of variants, mappings with a "name": by name, as a CSV file, as lines of a picture."""

import csv
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from nassim.base import write_atomically
from nassim.plotting import plot_pareto, save_figure

Row = Mapping[str, Any]


def by_name(rows: Iterable[Row]) -> dict[str, Row]:
    """Return rows by their names."""
    return {row["name"]: row for row in rows}


def write_rows(path: Path, rows: Sequence[Row], columns: Sequence[str]) -> None:
    """Write columns of rows as a CSV file."""
    with write_atomically(path) as temporary, temporary.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, columns, extrasaction="ignore")
        writer.writeheader()
        writer.writerows(rows)


def save_pareto(
    path: Path,
    rows: Iterable[Row],
    labels: tuple[str, str],
    *,
    line: Callable[[Row], str],
    point: Callable[[Row], tuple[float, float, str]],
) -> None:
    """Plot error over cost.

    labels: of cost and error; line: name of a row's line; point: cost, error and label of a row
    """
    lines: dict[str, list[tuple[float, float, str]]] = {}
    for row in rows:
        lines.setdefault(line(row), []).append(point(row))
    save_figure(plot_pareto(lines, *labels), path)
