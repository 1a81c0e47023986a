"""An amplified piezo actuator as three springs: with its bottom held, two masses move along its axis.

    lower ---- k1 (shell) ------------------------ upper
      |                                              |
      +---- ke (sensor) ---- middle ---- ka (drive) -+

All figures follow in closed form from those of a reduced actuator, `two_mass_actuator`; `python -m models.two_mass`
prints them. Source: the two-degree-of-freedom model of T. Dehaeze and others; here the sensor is open, and damping is
that of the scene.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, fields

import numpy as np
import scipy.optimize

from models.apa300ml import STACK, axial_stiffness
from nassim import ReducedBody, open_circuit
from nassim.base.modal import eigenmodes
from nassim.bodies.interface import free_coordinates

HEAVY = 5.0
"""Payload of the fit [kg]: the paper's bench."""
MIDDLE_MASS = 1e-3
"""Assumed [kg], because a body needs one: with it the middle swings at some 20 kHz, beyond what the model is for."""


@dataclass(frozen=True, kw_only=True)
class TwoMassActuator:
    """The figures of the model.

    shell, drive, sensor: stiffnesses k1, ka and, its charge held, ke [N/m]
    lower_mass, middle_mass, upper_mass: [kg]
    force_per_volt: of the drive, on middle and upper end, positive apart [N/V]
    voltage_per_elongation: of the sensor, positive where it reads positive when longer [V/m]
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
    """What an actuator does along its axis, the sensor open but where said; a payload of `HEAVY` on its guided top.

    stiffness, shorted_stiffness: static, sensor open and shorted [N/m]
    pole, zero: first frequency and that of the sensor's response to the drive below it [Hz]
    sensor_gain, stroke: static sensor voltage [V/V] and elongation [m/V] per stack voltage
    mass: of all of it [kg]
    """

    stiffness: float
    shorted_stiffness: float
    pole: float
    zero: float
    sensor_gain: float
    stroke: float
    mass: float


def actuator_figures(body: ReducedBody) -> ActuatorFigures:
    """Of a reduced actuator with points "bottom" and "top" and ports "actuator" and "sensor".

    Raises ValueError for a body without these, and for one without a zero below its pole.
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
    """The model of a reduced actuator, see `actuator_figures`.

    With M payload and upper mass: the zero is where no force passes the sensor, k1 / M; the pole (k1 + k2) / M with
    k2 = ka ke / (ka + ke), the whole static stiffness. Shorting the sensor softens it to ke (1 - k33^2), k33 the
    stack's coupling factor: from how much that softens the whole follows ke.
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
        # The drive pulls the sensor by -blocked_force k1 / (k1 + k2).
        voltage_per_elongation=-f.sensor_gain * f.stiffness * sensor / (blocked_force * shell),
    )


def _omega2(frequency: float) -> float:
    return (2 * math.pi * frequency) ** 2


def _zero_below(pole: float, response: Callable[[float], float], body: ReducedBody) -> float:
    """Frequency at which a response changes its sign [Hz]."""
    end = pole * (1 - 1e-9)
    if response(0.0) * response(end) >= 0:
        raise ValueError(
            f"body {body.name!r}: no frequency below its pole at {pole:g} Hz quiets the sensor, so no shell carries "
            "beside the stacks; are drive and sensor in one line of an amplified actuator?"
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
"""Of `reduced_apa300ml(ports=PORTS)`, as `python -m models.two_mass` prints it."""

if __name__ == "__main__":
    from models.apa300ml import PORTS, reduced_apa300ml

    found = two_mass_actuator(reduced_apa300ml(ports=PORTS))
    for field in fields(found):
        print(f"{field.name}={getattr(found, field.name):.5g},")
