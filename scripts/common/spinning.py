"""Hexapods on a spindle with six loops of integral force feedback: poles over speed and gain, trials in time."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from models.hexapods import DEFAULT_PLATFORM
from models.nano_hexapod import make_nano_hexapod, rigid_plate
from models.strut import controller_in_line, sensors_in_line, spring_strut, two_mass_strut, with_own_damping
from models.two_mass import APA300ML
from nassim import Controller, LinearModel, Loop, Scene, linearize
from nassim.kinematics import strut_lengths
from nassim.systems import close_loop, decentralised, integral_force_feedback

SIX = range(1, 7)
STIFFNESS = 1.846e6
"""Stiffness of the published hexapod's struts [N/m]."""
HIGHEST = 300.0
"""Highest frequency of the results [Hz]; above it are local modes of the struts."""
ALMOST_NONE = 1.0
"""Stiffness of the shell in machines without parallel stiffness [N/m]."""


@dataclass(frozen=True)
class Machine:
    """A hexapod with optional stiffness parallel to its force sensors, and the signals of its loops.

    make: function of speed [1/min] and of whether there is parallel stiffness, which returns the scene
    sensor, actuator: signals of a strut; sign: of the gain that damps; in_line: whether the sensor also measures the
        actuator's force, see `models.strut.sensors_in_line`
    """

    make: Callable[[float, bool], Scene]
    sensor: str
    actuator: str
    sign: float = 1.0
    in_line: bool = False

    @property
    def wires(self) -> dict[str, list[str]]:
        """Return measured and driven signals of the six loops."""
        return {
            "measured": [f"strut_{k}/{self.sensor}" for k in SIX],
            "driven": [f"strut_{k}/{self.actuator}" for k in SIX],
        }

    def plant(self, rpm: float, parallel: bool) -> LinearModel:
        """Return the linear model without loops in the rotor frame, computed once."""
        return _plant(self, rpm, parallel)

    def controller(self, gain: float, leak: float, sample_rate: float) -> Controller:
        """Return the controller of one strut; leak [Hz]."""
        return integral_force_feedback(self.sign * gain, sample_rate=sample_rate, corner_frequency=leak)

    def closed(self, plant: LinearModel, gain: float, leak: float) -> LinearModel:
        """Return a sampled plant with all six loops."""
        assert plant.time_step is not None
        return close_loop(plant, decentralised(*[self.controller(gain, leak, 1 / plant.time_step)] * 6), **self.wires)

    def looped(self, rpm: float, parallel: bool, gain: float, leak: float, sample_rate: float) -> Scene:
        """Return the scene with all six loops, for simulations."""
        each = self.controller(gain, leak, sample_rate)
        each = controller_in_line(each) if self.in_line else each
        pairs = zip(SIX, *self.wires.values(), strict=True)
        return replace(self.make(rpm, parallel), loops=tuple(Loop(f"iff_{k}", each, y, u) for k, y, u in pairs))


@cache
def _plant(machine: Machine, rpm: float, parallel: bool) -> LinearModel:
    model = linearize(machine.make(rpm, parallel))
    return sensors_in_line(model) if machine.in_line else model


def published_machine(payload_mass: float, share: float) -> Machine:
    """Make the published hexapod: massless spring struts, payload 0.2 m above; share: of parallel stiffness."""
    disc = rigid_plate(DEFAULT_PLATFORM, mass=1.0, radius=0.1, height=0.01)
    payload = {"payload_mass": payload_mass, "payload_centre": (0, 0, 0.2), "payload_inertia": np.eye(3)}

    def make(rpm: float, parallel: bool) -> Scene:
        beside = share * parallel * STIFFNESS
        length = float(strut_lengths(DEFAULT_PLATFORM)[0])
        strut = spring_strut(STIFFNESS - beside, parallel_stiffness=beside, length=length)
        return make_nano_hexapod(strut, platform=DEFAULT_PLATFORM, plate=disc, spindle_rpm=rpm, **payload)

    return Machine(make, "sensor_force", "actuator_force", -1.0, in_line=True)


def own_machine(payload_mass: float) -> Machine:
    """Make the hexapod of `models` with two-mass APA300ML, whose shells are the parallel stiffness."""

    def make(rpm: float, parallel: bool) -> Scene:
        actuator = APA300ML if parallel else replace(APA300ML, shell=ALMOST_NONE)
        strut = with_own_damping(two_mass_strut(actuator), 0.01)
        return make_nano_hexapod(strut, payload_mass=payload_mass, spindle_rpm=rpm)

    return Machine(make, "sensor_voltage", "actuator_voltage")
