"""Six equal loops from each strut's force sensor to its actuator: what they are designed on, and what they damp."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from _hexapod import SENSORS, VOLTAGES

from nassim import FRF, Controller, LinearModel, Loop, Scene, frequency_response, linearize
from nassim.simulation import linearize_closed
from nassim.systems import RootLocus, decentralised

WIRES = {"measured": SENSORS, "driven": VOLTAGES}


@dataclass(frozen=True)
class Design:
    """What six equal loops are designed on.

    plant: linear model sampled at the loops' rate; unit: controller of gain one
    """

    plant: LinearModel
    unit: Controller

    @property
    def frequency(self) -> np.ndarray:
        """Frequencies of the six suspension modes without loops, (6,) [Hz]."""
        poles = self.plant.poles()
        return np.sort(np.abs(poles[poles.imag > 0]))[:6] / (2 * np.pi)

    @property
    def six(self) -> Controller:
        """One controller of all six."""
        return decentralised(*[self.unit] * 6)

    def modes(self, locus: RootLocus, gain: float) -> np.ndarray:
        """Poles of the suspension modes at one of a locus's gains, which begin at zero, (6,) [rad/s]."""
        return locus.poles[np.searchsorted(locus.gains, gain), locus.branches(self.frequency)]


def with_loops(scene: Scene, six: Controller, gain: float) -> Scene:
    """The scene with a controller of all struts times a gain."""
    return replace(scene, loops=(Loop("iff", replace(six, C=gain * six.C, D=gain * six.D), **WIRES),))


def damped_plants(scene: Scene, six: Controller, gains: Sequence[float], frequency: np.ndarray) -> list[FRF]:
    """FRFs of a scene in linear motion without loops and with them at some gains [1/s]."""
    models = {"no loops": linearize(scene)}
    for gain in gains:
        models[f"gain {gain:.0f}/s"] = linearize_closed(with_loops(scene, six, gain), continuous=True)
    return [frequency_response(model, frequency, label=name) for name, model in models.items()]
