"""Assumed spectra of the disturbances of the end-station, and the aims for its sample."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from nassim.signals import amplifier_noise, differentiate_spectrum, quantisation_noise

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


@dataclass(frozen=True)
class Electronics:
    """Assumed noise of amplifiers, converters and metrology.

    Attributes:
        sample_rate: samples per second of the converters and of the metrology [Hz]
        amplifier: noise density of an amplifier [V/sqrt(Hz)]
        bits: resolution of all converters, whose range is +-10 V
        amplification: gain of an amplifier [-]
        metrology: rms of the noise of a length of the metrology [m]; angles have 10 times as many radians
    """

    sample_rate: float
    amplifier: float
    bits: int
    metrology: float
    amplification: float = 20.0

    @property
    def step(self) -> float:
        """Resolution of a converter [V]."""
        return 20.0 / 2**self.bits

    def of_amplifiers(self) -> Spectrum:
        """Return the noise of the voltage of an actuator [V^2/Hz]: that of the amplifier and of its converter."""
        own = amplifier_noise(self.amplifier)
        converter = quantisation_noise(self.amplification * self.step, sample_rate=self.sample_rate)
        return lambda frequency: own(frequency) + converter(frequency)

    def of_sensors(self, *, turns: bool, volts: bool) -> Spectrum:
        """Return the noise of the converter of a force sensor [V^2/Hz], or of a length or an angle of the metrology."""
        if volts:
            return quantisation_noise(self.step, sample_rate=self.sample_rate)
        rms = self.metrology * (10.0 if turns else 1.0)
        return amplifier_noise(rms / math.sqrt(self.sample_rate / 2))


def assumed_spectra(
    inputs: Sequence[str], *, floor: float, runout: float, stage: float, electronics: Electronics | None = None
) -> dict[str, Spectrum]:
    """Return spectra of all inputs from the floor's velocity per third of an octave [m/s] and rms of runout and stages
    [m], and from the noise of electronics if given.

    Angular noise of a stage is that of a stage with a size of 0.25 m: four times as many radians as metres.
    """
    result = {}
    for name in inputs:
        if name.startswith("floor"):
            result[name] = floor_spectrum(floor)
        elif name.startswith("runout"):
            result[name] = low_passed(runout, CORNER)
        elif name in ("translation_y", "translation_z", "tilt_ry"):
            result[name] = low_passed(stage * (4.0 if name.endswith("ry") else 1.0), CORNER)
        elif electronics and name.startswith(("target", "converter")):
            result[name] = electronics.of_sensors(turns=".r" in name, volts=name.startswith("converter"))
        elif electronics and name.endswith("actuator_voltage"):
            result[name] = electronics.of_amplifiers()
    return result


def disturbance_of(name: str) -> str:
    """Return the disturbance to which an input belongs."""
    starts = {
        "floor": "floor",
        "runout": "runout",
        "translation": "stages",
        "tilt": "stages",
        "target": "metrology",
        "converter": "converters",
    }
    return next((label for start, label in starts.items() if name.startswith(start)), "amplifiers")
