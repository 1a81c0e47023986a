"""Spectra of what disturbs the end-station: from a file, or plainly assumed."""

import csv
import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np

from nassim.signals import TabulatedSpectrum, differentiate_spectrum

Spectrum = Callable[[np.ndarray], np.ndarray]
THIRD_OCTAVE = 2 ** (1 / 6) - 2 ** (-1 / 6)
"""Width of a third-octave band over its centre."""
CORNER = 5.0
"""Of runout and stages' noise [Hz]: assumed."""


def floor_spectrum(velocity: float, corner: float = 20.0) -> Spectrum:
    """Acceleration of a floor with the same rms velocity [m/s] in every third of an octave, falling off above a corner.

    Level: as of C. G. Gordon's generic vibration criteria (VC-E: 3.12 um/s, VC-G: 0.78 um/s); corner [Hz]: assumed
    """

    def spectrum(frequency: np.ndarray) -> np.ndarray:
        return velocity**2 / (THIRD_OCTAVE * frequency) / (1 + (frequency / corner) ** 2)

    return differentiate_spectrum(spectrum)


def low_passed(rms: float, corner: float) -> Spectrum:
    """Noise of a given rms, all frequencies counted, through two low-passes of first order; their corner [Hz]."""

    def spectrum(frequency: np.ndarray) -> np.ndarray:
        return rms**2 * 4 / (math.pi * corner) / (1 + (frequency / corner) ** 2) ** 2

    return spectrum


def assumed_spectra(inputs: Sequence[str], *, floor: float, runout: float, stage: float) -> dict[str, Spectrum]:
    """For every input: the floor's velocity per third of an octave [m/s], rms of runout and of stages' noise [m].

    A stage's noise in angle is that of a stage of 0.25 m: four times as many radians as metres.
    """
    result = {}
    for name in inputs:
        if name.startswith("floor"):
            result[name] = floor_spectrum(floor)
        elif name.startswith("runout"):
            result[name] = low_passed(runout, CORNER)
        elif name.startswith(("translation", "tilt")):
            result[name] = low_passed(stage * (4.0 if name.endswith("ry") else 1.0), CORNER)
    return result


def read_spectra(path: Path, inputs: Sequence[str]) -> dict[str, TabulatedSpectrum]:
    """A CSV file: a column "frequency" [Hz], and by input's name its one-sided density in SI, unit^2/Hz.

    Raises ValueError for unknown columns, for rows of other lengths and for what is no number.
    """
    with path.open(newline="", encoding="utf-8") as file:
        rows = [row for row in csv.reader(file, skipinitialspace=True) if row and not row[0].startswith("#")]
    header = [name.strip() for name in rows[0]] if rows else []
    if "frequency" not in header or len(header) < 2:
        raise ValueError(f"{path}: the first line must name the columns, frequency and some of {', '.join(inputs)}")
    unknown = [name for name in header if name not in ("frequency", *inputs)]
    if unknown:
        raise ValueError(f"{path}: unknown input {unknown[0]!r}; known: {', '.join(inputs)}")
    try:
        table = np.array([[float(cell) for cell in row] for row in rows[1:]])
        columns: Mapping[str, np.ndarray] = dict(zip(header, table.T, strict=True))
    except ValueError as error:
        raise ValueError(f"{path}: each row must have {len(header)} numbers ({error})") from error
    return {name: TabulatedSpectrum(columns["frequency"], columns[name]) for name in header if name != "frequency"}
