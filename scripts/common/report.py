"""What a script prints and writes: texts, tables, and summary.json, which holds every figure that is printed."""

import json
import math
import re
import shlex
import sys
import time
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import psutil

from nassim.base import write_atomically
from nassim.base.progress import tell, wrap_text
from nassim.base.tables import text_table


def write_summary(folder: Path, summary: Mapping[str, Any]) -> None:
    """Write all figures, with units in the keys, the command that made them and its time to summary.json."""
    elapsed = time.time() - psutil.Process().create_time()
    content = {"command": command_line(sys.argv), "script_time_s": elapsed, **summary}
    with write_atomically(folder / "summary.json") as temporary:
        temporary.write_text(json.dumps(_plain(content), indent=2, allow_nan=False) + "\n", encoding="utf-8")
    print(f"results in {folder.resolve()}")


def command_line(arguments: list[str]) -> str:
    """The command that makes the same figures from the repository's folder, wherever results go, with pictures."""
    script, *options = arguments
    kept = [
        option
        for before, option in zip(["", *options], options, strict=False)
        if before != "--output" and option.partition("=")[0] not in ("--output", "--no-plot")
    ]
    return shlex.join(["python", f"scripts/{Path(script).name}", *kept])


def _plain(value: Any) -> Any:
    """Mappings, sequences, arrays and numbers as JSON knows them; null where a number is not finite."""
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple, np.ndarray)):
        return [_plain(item) for item in value]
    value = value.item() if isinstance(value, np.generic) else value
    return None if isinstance(value, float) and not math.isfinite(value) else value


def print_report(template: str, summary: Mapping[str, Any]) -> None:
    """Print a text whose figures are a summary's, as {key}, {key:format} or {key*factor:format}.

    {key/3} is a figure out of a list, {key/name} out of a mapping; a figure that is None prints as -.

    print_report("gain {gain_m_per_V*1e6:.2f} um/V", {"gain_m_per_V": 2.19e-5})
    """
    tell(re.sub(r"\{([^{}]+)\}", lambda match: _figure(summary, match[1]), template).rstrip(), indent="")


def folded(doc: str) -> str:
    """Paragraphs in lines that fit the terminal."""
    return "\n\n".join(wrap_text(" ".join(paragraph.split()), next_indent="") for paragraph in doc.split("\n\n"))


def print_table(title: str, rows: Mapping[str, Mapping[str, Any]], columns: Mapping[str, str]) -> None:
    """Print a line per row and a column per heading, its figure written as in `print_report`, without braces."""
    body = [[name, *(_figure(row, figure) for figure in columns.values())] for name, row in rows.items()]
    print("\n" + text_table([[title, *columns], *body]))


def _figure(summary: Mapping[str, Any], figure: str) -> str:
    path, _, form = figure.partition(":")
    key, _, factor = path.partition("*")
    name, _, place = key.partition("/")
    value = summary[name]
    if place:
        value = value[place] if isinstance(value, Mapping) else value[int(place)]
    if value is None:
        return "-"
    return format(value * float(factor) if factor else value, form)


def across(summary: Mapping[str, Any], names: Iterable[str], keys: Iterable[str]) -> dict[str, dict[str, Any]]:
    """Rows out of a summary that holds mappings by the rows' names; None where one knows no figure of a row."""
    return {name: {key: summary[key].get(name) for key in keys} for name in names}


def key_of(name: str) -> str:
    """A name as the beginning of keys: "5 kg, guided" as 5_kg_guided."""
    return name.replace(",", "").replace(" ", "_")


def with_prefix(name: str, figures: Mapping[str, Any]) -> dict[str, Any]:
    """Figures of a named row as they stand in a flat summary, under `name_key`."""
    return {f"{key_of(name)}_{key}": value for key, value in figures.items()}


def rows_of(summary: Mapping[str, Any], names: Iterable[str]) -> dict[str, dict[str, Any]]:
    """Figures of named rows out of a flat summary that holds them under `name_key`; rows without any left out."""
    result = {}
    for name in names:
        start = f"{key_of(name)}_"
        result[name] = {key.removeprefix(start): value for key, value in summary.items() if key.startswith(start)}
    return {name: row for name, row in result.items() if row}
