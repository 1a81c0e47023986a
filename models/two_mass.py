"""An amplified piezo actuator as three springs: with its bottom held, two masses move along its axis.

    lower ---- k1 (shell) ------------------------ upper
      |                                              |
      +---- ke (sensor) ---- middle ---- ka (drive) -+

All values follow in closed form from those of a reduced actuator, see `two_mass_actuator`; `python -m models.two_mass`
prints them. Source: the two-degree-of-freedom model of T. Dehaeze and others. Here the sensor is open, and the damping
is that of the scene.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, fields

import numpy as np
import scipy.optimize

from nassim import ReducedBody, open_circuit
from nassim.base.modal import eigenmodes
from nassim.bodies.remote_points import free_coordinates

from .apa300ml import STACK, axial_stiffness

HEAVY = 5.0
"""Payload of the fit [kg], as on the paper's bench."""
MIDDLE_MASS = 1e-3
"""Mass of the middle [kg], assumed, because a body needs one; its mode at about 20 kHz is beyond the model's range."""


@dataclass(frozen=True, kw_only=True)
class TwoMassActuator:
    """Parameters of the model.

    Attributes:
        shell: stiffness k1 of the shell [N/m]
        drive: stiffness ka of the drive [N/m]
        sensor: stiffness ke of the sensor at constant charge [N/m]
        lower_mass: mass of the lower end [kg]
        middle_mass: mass between drive and sensor [kg]
        upper_mass: mass of the upper end [kg]
        force_per_volt: force of the drive on middle and upper end, positive if it pushes them apart [N/V]
        voltage_per_elongation: constant of the sensor, positive if elongation gives a positive voltage [V/m]
    """

    shell: float
    drive: float
    sensor: float
    lower_mass: float
    middle_mass: float
    upper_mass: float
    force_per_volt: float
    voltage_per_elongation: float


@dataclass(frozen=True)
class ActuatorFigures:
    """Properties of an actuator along its axis, with a payload of `HEAVY` on its guided top and the sensor open.

    Attributes:
        stiffness: static stiffness [N/m]
        shorted_stiffness: static stiffness with the sensor shorted [N/m]
        pole: first eigenfrequency [Hz]
        zero: frequency of the zero below it in the response of the sensor to the drive [Hz]
        sensor_gain: static sensor voltage per stack voltage [V/V]
        stroke: static elongation per stack voltage [m/V]
        mass: total mass [kg]
    """

    stiffness: float
    shorted_stiffness: float
    pole: float
    zero: float
    sensor_gain: float
    stroke: float
    mass: float


def actuator_figures(body: ReducedBody) -> ActuatorFigures:
    """Compute the properties of a reduced actuator with points "bottom" and "top" and ports "actuator" and "sensor".

    Args:
        body: the reduced actuator

    Raises:
        ValueError: for a body without these points or ports, or without a zero below its pole
    """
    opened = open_circuit(body, {"sensor": 0.0})
    drive, sensor = body.port("actuator").forces, body.port("sensor").forces
    reading = -sensor / body.port("sensor").blocked_capacitance
    top = body.coordinate_names.index("top.uz")
    free = free_coordinates(body.point_names, fixed=["bottom"], guided={"top": "z"})
    free = np.concatenate([free, np.arange(6 * len(body.point_names), len(body.mass_matrix))])
    k, m = opened.stiffness_matrix[np.ix_(free, free)], opened.mass_matrix[np.ix_(free, free)].copy()
    statics = np.zeros(len(reading))
    statics[free] = np.linalg.solve(k, drive[free])
    place = free.tolist().index(top)
    m[place, place] += HEAVY
    frequency, shapes = eigenmodes(k, m)
    strengths = (reading[free] @ shapes) * (drive[free] @ shapes)
    return ActuatorFigures(
        axial_stiffness(opened),
        axial_stiffness(body),
        float(frequency[0]),
        _zero_below(frequency[0], lambda f: float(np.sum(strengths / (frequency**2 - f**2))), body),
        float(reading @ statics),
        float(statics[top]),
        body.mass,
    )


def two_mass_actuator(body: ReducedBody) -> TwoMassActuator:
    """Compute the parameters of the model from a reduced actuator, see `actuator_figures`.

    With M the sum of payload and upper mass, the squared angular frequency of the zero, at which no force passes
    through the sensor, is k1 / M. That of the pole is (k1 + k2) / M with k2 = ka ke / (ka + ke), and k1 + k2 is the
    static stiffness. A short reduces the sensor's stiffness to ke (1 - k33^2) with its coupling factor k33.
    ke follows from the resulting change of the static stiffness.

    Args:
        body: the reduced actuator
    """
    f = actuator_figures(body)
    loaded = f.stiffness / _omega2(f.pole)
    shell = _omega2(f.zero) * loaded
    series, shorted = f.stiffness - shell, f.shorted_stiffness - shell
    sensor = STACK.coupling_factor**2 / (1 - STACK.coupling_factor**2) / (1 / shorted - 1 / series)
    drive = 1 / (1 / series - 1 / sensor)
    upper = loaded - HEAVY
    blocked_force = f.stroke * f.stiffness
    return TwoMassActuator(
        shell=shell,
        drive=drive,
        sensor=sensor,
        lower_mass=f.mass - upper - MIDDLE_MASS,
        middle_mass=MIDDLE_MASS,
        upper_mass=upper,
        force_per_volt=blocked_force * (drive + sensor) / sensor,
        # The drive acts on the sensor with -blocked_force k1 / (k1 + k2).
        voltage_per_elongation=-f.sensor_gain * f.stiffness * sensor / (blocked_force * shell),
    )


def _omega2(frequency: float) -> float:
    return (2 * math.pi * frequency) ** 2


def _zero_below(pole: float, response: Callable[[float], float], body: ReducedBody) -> float:
    """Return the frequency at which a response changes its sign [Hz]."""
    end = pole * (1 - 1e-9)
    if response(0.0) * response(end) >= 0:
        raise ValueError(
            f"body {body.name!r}: no frequency below its pole at {pole:g} Hz has a zero sensor response, so no "
            "shell is parallel to the stacks; are drive and sensor in one line of an amplified actuator?"
        )
    return float(scipy.optimize.brentq(response, 0.0, end, xtol=1e-12))


APA300ML = TwoMassActuator(
    shell=2.7926e5,
    drive=1.8565e6,
    sensor=1.5832e7,
    lower_mass=0.078024,
    middle_mass=MIDDLE_MASS,
    upper_mass=0.033395,
    force_per_volt=-2.375,
    voltage_per_elongation=1.5225e6,
)
"""Parameters of `reduced_apa300ml(ports=PORTS)`, as `python -m models.two_mass` prints them."""

if __name__ == "__main__":
    from .apa300ml import PORTS, reduced_apa300ml

    found = two_mass_actuator(reduced_apa300ml(ports=PORTS))
    for field in fields(found):
        print(f"{field.name}={getattr(found, field.name):.5g},")
