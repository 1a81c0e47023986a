"""Output of a script: texts, tables, and summary.json, which contains every figure that is printed."""

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

MINUS_OF_ZERO = re.compile(r"-(?=0(\.0*)?$)")
"""Sign of a small negative number that is rounded to zero."""


def write_summary(folder: Path, summary: Mapping[str, Any]) -> None:
    """Write all figures, with units in the keys, the command that produced them and its time to summary.json."""
    elapsed = time.time() - psutil.Process().create_time()
    content = {"command": command_line(sys.argv), "script_time_s": elapsed, **summary}
    with write_atomically(folder / "summary.json") as temporary:
        temporary.write_text(json.dumps(_plain(content), indent=2, allow_nan=False) + "\n", encoding="utf-8")
    print(f"results in {folder.resolve()}")


def command_line(arguments: list[str]) -> str:
    """Return the command that reproduces the figures from the repository's folder, with pictures, to any folder."""
    script, *options = arguments
    kept = [
        option
        for before, option in zip(["", *options], options, strict=False)
        if before != "--output" and option.partition("=")[0] not in ("--output", "--no-plot")
    ]
    return shlex.join(["python", f"scripts/{Path(script).name}", *kept])


def _plain(value: Any) -> Any:
    """Convert mappings, sequences, arrays and numbers for JSON; numbers that are not finite become null."""
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple, np.ndarray)):
        return [_plain(item) for item in value]
    value = value.item() if isinstance(value, np.generic) else value
    return None if isinstance(value, float) and not math.isfinite(value) else value


def print_report(template: str, summary: Mapping[str, Any]) -> None:
    """Print a text with figures of a summary: {key}, {key:format} or {key*factor:format}.

    {key/3} is an entry of a list, {key/name} of a mapping. A figure that is None or NaN is printed as -.

    print_report("gain {gain_m_per_V*1e6:.2f} um/V", {"gain_m_per_V": 2.19e-5})
    """
    tell(re.sub(r"\{([^{}]+)\}", lambda match: _figure(summary, match[1]), template).rstrip(), indent="")


def folded(doc: str) -> str:
    """Wrap paragraphs to the width of the terminal."""
    return "\n\n".join(wrap_text(" ".join(paragraph.split()), next_indent="") for paragraph in doc.split("\n\n"))


def print_table(title: str, rows: Mapping[str, Mapping[str, Any]], columns: Mapping[str, str]) -> None:
    """Print a line per row and a column per heading, with figures as in `print_report`, without braces."""
    body = [[name, *(_figure(row, figure) for figure in columns.values())] for name, row in rows.items()]
    print("\n" + text_table([[title, *columns], *body]))


def _figure(summary: Mapping[str, Any], figure: str) -> str:
    path, _, form = figure.partition(":")
    key, _, factor = path.partition("*")
    name, _, place = key.partition("/")
    value = summary[name]
    if place:
        value = value[place] if isinstance(value, Mapping) else value[int(place)]
    if value is None or (isinstance(value, float) and math.isnan(value)):
        return "-"
    return MINUS_OF_ZERO.sub("", format(value * float(factor) if factor else value, form))


def across(summary: Mapping[str, Any], names: Iterable[str], keys: Iterable[str]) -> dict[str, dict[str, Any]]:
    """Return rows of a summary whose figures are mappings by row names; None for missing figures."""
    return {name: {key: summary[key].get(name) for key in keys} for name in names}


def key_of(name: str) -> str:
    """Convert a name to a prefix of keys: "5 kg, guided" becomes 5_kg_guided."""
    return name.replace(",", "").replace(" ", "_")


def with_prefix(name: str, figures: Mapping[str, Any]) -> dict[str, Any]:
    """Return figures of a row with the keys `name_key` of a flat summary."""
    return {f"{key_of(name)}_{key}": value for key, value in figures.items()}


def rows_of(summary: Mapping[str, Any], names: Iterable[str]) -> dict[str, dict[str, Any]]:
    """Return figures of rows from a flat summary with keys `name_key`; rows without figures are left out."""
    result = {}
    for name in names:
        start = f"{key_of(name)}_"
        result[name] = {key.removeprefix(start): value for key, value in summary.items() if key.startswith(start)}
    return {name: row for name, row in result.items() if row}
