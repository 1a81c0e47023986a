"""What every script shares: its arguments and where its results go."""

import argparse
import importlib
import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import psutil

from nassim import FRF, LinearModel
from nassim.linear import damping
from nassim.plotting import plot_frf, plot_frf_error, plt
from nassim.statespace import transmission_zeros


def parser(doc: str, name: str) -> argparse.ArgumentParser:
    """An argument parser with the options that all scripts take."""
    result = argparse.ArgumentParser(description=doc, formatter_class=argparse.RawDescriptionHelpFormatter)
    default = Path("results") / name
    result.add_argument("--output", type=Path, default=default, help=f"folder of the results (default: {default})")
    result.add_argument("--no-plot", action="store_true", help="write no pictures")
    return result


def write_summary(folder: Path, summary: dict[str, Any]) -> None:
    """Write all figures, with units in the keys, to summary.json."""
    folder.mkdir(parents=True, exist_ok=True)

    def plain(value: Any) -> Any:
        return np.asarray(value).tolist()

    (folder / "summary.json").write_text(json.dumps(summary, indent=2, default=plain) + "\n")
    print(f"results in {folder.resolve()}")


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
    """Run a script with arguments and return the JSON object in the last line that it prints.

    Raises RuntimeError with what it printed when it fails.
    """
    command = [sys.executable, script, *map(str, arguments)]
    run = subprocess.run(command, capture_output=True, text=True, check=False)
    lines = run.stdout.strip().splitlines()
    if run.returncode or not lines:
        raise RuntimeError(f"{' '.join(command)} failed ({run.returncode}):\n{run.stdout}{run.stderr}")
    result: dict[str, Any] = json.loads(lines[-1])
    return result
