"""Where the figures of a script go: its summary.json."""

import json
import math
import shlex
import sys
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import psutil

from nassim.base import write_atomically


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
