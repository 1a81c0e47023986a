"""What every script shares: its arguments, how it ends when something is wrong, and where its results go."""

import argparse
import importlib
import json
import math
import shlex
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
import psutil

from nassim import FRF, LinearModel
from nassim.linear import damping
from nassim.plotting import plot_frf, plot_frf_error, plt
from nassim.statespace import transmission_zeros
from nassim.storage import written_whole


class Arguments(argparse.ArgumentParser):
    """An argument parser that answers a wrong argument with one line."""

    def error(self, message: str) -> NoReturn:
        """Print what is wrong and exit with status 2."""
        self.exit(2, f"{self.prog}: {message}; see --help\n")


def parser(doc: str, name: str) -> Arguments:
    """An argument parser with the options that all scripts take."""
    result = Arguments(description=doc, formatter_class=argparse.RawDescriptionHelpFormatter, allow_abbrev=False)
    default = Path("results") / name
    help_text = f"folder of the results (default: {default})"
    result.add_argument("--output", type=writable_folder, default=str(default), metavar="DIR", help=help_text)
    result.add_argument("--no-plot", action="store_true", help="write no pictures")
    return result


def writable_folder(text: str) -> Path:
    """A folder of an argument, made later; refused at once if nothing can be written there."""
    folder = Path(text)
    try:
        existing = next(path for path in (folder, *folder.absolute().parents) if path.exists())
        if not existing.is_dir():
            raise argparse.ArgumentTypeError(f"{existing} is a file, not a folder")
        with tempfile.TemporaryFile(dir=existing):
            return folder
    except OSError as error:
        raise argparse.ArgumentTypeError(f"cannot write to {text} ({error.strerror})") from error


def _number(kind: type, wanted: str, allowed: Callable[[Any], bool]) -> Callable[[str], Any]:
    def read(text: str) -> Any:
        try:
            value = kind(text)
        except ValueError:
            value = math.nan
        if not (math.isfinite(value) and allowed(value)):
            raise argparse.ArgumentTypeError(f"must be {wanted}, got {text!r}")
        return value

    return read


positive = _number(float, "a number above 0", lambda x: x > 0)
not_negative = _number(float, "a number of at least 0", lambda x: x >= 0)
fraction = _number(float, "a number from 0 to below 1", lambda x: 0 <= x < 1)


def whole(least: int) -> Callable[[str], Any]:
    """Type of arguments that are whole numbers."""
    return _number(int, f"a whole number of at least {least}", lambda n: n >= least)


def run(main: Callable[[], None]) -> None:
    """Run a script: what stops it is told in one line, with exit status 2 (130 for Ctrl-C).

    `python -X dev script.py` shows where an error arose.
    """
    name = Path(sys.argv[0]).name
    try:
        main()
    except KeyboardInterrupt:
        print(f"\n{name}: interrupted", file=sys.stderr)
        sys.exit(130)
    except (OSError, RuntimeError, ValueError) as error:
        if sys.flags.dev_mode:
            raise
        print(f"{name}: {' '.join(str(error).split()) or type(error).__name__}", file=sys.stderr)
        sys.exit(2)


def write_summary(folder: Path, summary: Mapping[str, Any]) -> None:
    """Write all figures, with units in the keys, the command that made them and its time to summary.json."""
    elapsed = time.time() - psutil.Process().create_time()
    content = {"command": command_line(sys.argv), "script_time_s": elapsed, **summary}
    with written_whole(folder / "summary.json") as temporary:
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


def compare_frf(measured: FRF, reference: FRF, *, least_coherence: float = 0.99) -> dict[str, float]:
    """Largest difference in dB and degrees per output, where the measured coherence is high, and in what share."""
    result = {}
    for row, output in enumerate(measured.outputs):
        assert measured.coherence is not None
        good = measured.coherence[row] > least_coherence
        ratio = measured.values[row, 0, good] / reference.values[row, 0, good]
        result[f"{output}_magnitude_error_dB"] = float(np.max(np.abs(20 * np.log10(np.abs(ratio))), initial=0.0))
        result[f"{output}_phase_error_deg"] = float(np.max(np.abs(np.angle(ratio, deg=True)), initial=0.0))
        result[f"{output}_coherent_share"] = float(np.mean(good))
    return result


def plot_bode_pair(frfs: list[FRF], *, markers: list[str] | None = None) -> list[Any]:
    """The bench's two FRFs side by side in one figure; returns the Axes."""
    columns = plt.figure(figsize=(13, 7), layout="constrained").subfigures(1, 2)
    axes: list[Any] = []
    for column, (output, unit) in zip(columns, (("sensor_voltage", "V/V"), ("encoder", "m/V")), strict=True):
        axes += plot_frf(frfs, output=output, input="actuator_voltage", unit=unit, markers=markers or [], figure=column)
    return axes


def plot_error_pair(frfs: list[FRF], references: list[FRF]) -> list[Any]:
    """Errors of the bench's two FRFs side by side in one figure; returns the Axes."""
    columns = plt.figure(figsize=(13, 6), layout="constrained").subfigures(1, 2)
    axes: list[Any] = []
    for column, output in zip(columns, ("sensor_voltage", "encoder"), strict=True):
        axes += plot_frf_error(frfs, references, output=output, input="actuator_voltage", figure=column)
    return axes


def pole_and_zero(frf: FRF) -> tuple[float, float]:
    """Frequencies of the largest and the smallest magnitude of V_s/V_a below 300 Hz [Hz]."""
    band = frf.band(10, 300)
    magnitude = np.abs(band.response("sensor_voltage", "actuator_voltage"))
    return float(band.frequency[np.argmax(magnitude)]), float(band.frequency[np.argmin(magnitude)])


def pole_and_zero_of(model: LinearModel) -> tuple[float, float]:
    """Natural frequencies of the first pole of V_s/V_a above 10 Hz and of the zero below it [Hz]; nan without one."""
    frequency, ratio = damping(model)
    pole = min(f for f, zeta in zip(frequency, ratio, strict=True) if f > 10.0 and zeta < 0.9)
    row, column = model.outputs.index("sensor_voltage"), model.inputs.index("actuator_voltage")
    a, b, c, d = model.matrices
    zeros = transmission_zeros((a, b[:, [column]], c[[row]], d[[row]][:, [column]]))
    below = np.abs(zeros[zeros.imag > 0]) / (2 * np.pi)
    below = below[(below > 10.0) & (below < pole)]
    return float(pole), float(below.max()) if below.size else float("nan")


def peak_memory() -> float:
    """Largest memory that this process has used so far [bytes]."""
    info = psutil.Process().memory_info()
    if hasattr(info, "peak_wset"):  # Windows
        return float(info.peak_wset)
    resource = importlib.import_module("resource")
    unit = 1 if sys.platform == "darwin" else 1024
    return float(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit)


def run_in_own_process(script: str, *arguments: object) -> dict[str, Any]:
    """Run a script with arguments and return the JSON object in the last line that it prints; it writes no results.

    Raises RuntimeError with the last line of what it said when it fails.
    """
    command = [sys.executable, script, *map(str, arguments), "--output", tempfile.gettempdir()]
    child = subprocess.run(command, capture_output=True, text=True, check=False)
    lines = child.stdout.strip().splitlines()
    if child.returncode or not lines:
        said = (child.stderr.strip() or child.stdout.strip() or "nothing").splitlines()[-1]
        raise RuntimeError(f"{shlex.join(command)} failed ({child.returncode}), saying: {said}")
    result: dict[str, Any] = json.loads(lines[-1])
    return result
