"""Assumed spectra of the disturbances of the end-station, and the aims for its sample."""

import math
from collections.abc import Callable, Sequence

import numpy as np

from nassim.signals import differentiate_spectrum

Spectrum = Callable[[np.ndarray], np.ndarray]
THIRD_OCTAVE = 2 ** (1 / 6) - 2 ** (-1 / 6)
"""Width of a third-octave band over its centre."""
CORNER = 5.0
"""Corner frequency of runout and noise of the stages [Hz], assumed."""
AIMS = {"ux": 30e-9, "uy": 30e-9, "uz": 15e-9, "rx": 250e-9, "ry": 250e-9, "rz": None}
"""Target rms of the sample's motion [m], [rad]."""


def floor_spectrum(velocity: float, corner: float = 20.0) -> Spectrum:
    """Return a floor's acceleration with equal rms velocity [m/s] in all third-octave bands, decreasing above a corner.

    Level: C. G. Gordon's generic vibration criteria (VC-E: 3.12 um/s, VC-G: 0.78 um/s); corner frequency [Hz]: assumed
    """

    def spectrum(frequency: np.ndarray) -> np.ndarray:
        return velocity**2 / (THIRD_OCTAVE * frequency) / (1 + (frequency / corner) ** 2)

    return differentiate_spectrum(spectrum)


def low_passed(rms: float, corner: float) -> Spectrum:
    """Return noise of a given total rms through two low-passes of first order with a corner frequency [Hz]."""

    def spectrum(frequency: np.ndarray) -> np.ndarray:
        return rms**2 * 4 / (math.pi * corner) / (1 + (frequency / corner) ** 2) ** 2

    return spectrum


def assumed_spectra(inputs: Sequence[str], *, floor: float, runout: float, stage: float) -> dict[str, Spectrum]:
    """Return spectra of all inputs from the floor's velocity per third of an octave [m/s] and rms of runout and stages
    [m].

    Angular noise of a stage is that of a stage with a size of 0.25 m: four times as many radians as metres.
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
