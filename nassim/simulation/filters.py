"""What outputs pass before they are read: low-passes, high-passes, and the ground's motion of inertial sensors.

A filter is a state space of two inputs: what is read against the ground, and the acceleration of the ground along it.
Acceleration against inertial space is the sum of both. Of a velocity v the ground's share is the integral V of its
acceleration, which a high-pass at the entrance needs not know: with z = x - V in the place of its state x, that counts
v + V, it is z' = x' - V' and v - z that count.
"""

from collections.abc import Callable

import numpy as np

from nassim.base.checks import Array
from nassim.scene.part import Field, Filter, Reading, Row
from nassim.scene.scene import Scene
from nassim.systems.state_space import StateSpace, cascade, discretize


def output_filters(scene: Scene) -> dict[str, StateSpace]:
    """By output that passes a filter, or that the acceleration of the ground adds to.

    Raises ValueError for an inertial velocity that passes no high-pass, where fields accelerate the ground: that would
    be what the ground's acceleration adds up to since ever.
    """
    result = {}
    fields = {field.input for field in scene.said(Field)}
    for output in scene.outputs:
        filters = [word for word in scene.said(Filter) if word.output == output]
        inertial = [word for word in scene.said(Reading) if word.output == output and word.inertial and fields]
        derivative = inertial[0].derivative if inertial else None
        if derivative in (0, 1) and (derivative == 0 or not filters or filters[0].passes != "high"):
            raise ValueError(
                f"output {output!r} reads motion against inertial space, and {', '.join(sorted(fields))} accelerates "
                "the ground: its velocity is known behind a high-pass only; read against the ground, or acceleration"
            )
        if not (filters or inertial):
            continue
        whole: StateSpace = (np.zeros((0, 0)), np.zeros((0, 2)), np.zeros((1, 0)), np.array([[1.0, derivative == 2]]))
        for k, word in enumerate(filters):
            a, b, c, d = cascade(whole, _section(word))
            if k == 0 and derivative == 1:
                b[0, 1] = -1.0
            whole = a, b, c, d
        result[output] = whole
    return result


def _section(word: Filter) -> StateSpace:
    """Of one input, with states of its unit: what a low-pass lets through, and its rate over w."""
    w = 2 * np.pi * word.frequency
    if word.damping_ratio is None:
        a, b, c = np.array([[-w]]), np.array([[w]]), np.array([[1.0]])
    else:
        a, b, c = w * np.array([[0, 1.0], [-1.0, -2 * word.damping_ratio]]), np.array([[0], [w]]), np.array([[1.0, 0]])
    if word.passes == "low":
        return a, b, c, np.zeros((1, 1))
    return a, b, a[-1:] / w, np.ones((1, 1))


def ground_accelerations(scene: Scene) -> Array:
    """Acceleration of the ground along what inertial outputs read, per unit input, (outputs, inputs).

    A field that lets everything fall is an acceleration of the ground the other way.
    """
    result = np.zeros((len(scene.outputs), len(scene.inputs)))
    for word in scene.said(Reading):
        if word.inertial and isinstance(word.row, Row):
            weights = np.sum([np.zeros(3), *(w[:3] for _, w in word.row.points)], axis=0)
            for field in scene.said(Field):
                place = scene.outputs.index(word.output), scene.inputs.index(field.input)
                result[place] -= word.gain * float(weights @ field.direction)
    return result


def static_gain(system: StateSpace) -> float:
    """Of a constant that is read."""
    a, b, c, d = system
    return float(d[0, 0] - (c @ np.linalg.solve(a, b))[0, 0]) if len(a) else float(d[0, 0])


def start_filter(system: StateSpace, time_step: float, value: float) -> Callable[[float, float], float]:
    """A filter that has read a value since ever: a function to be called at every time step.

    It takes what is read and the acceleration of the ground along it, which run straight between the time steps, and
    returns what passes.
    """
    a, b, c, d = system
    phi, held, risen = discretize(a, b, time_step) if len(a) else (a, b, b)
    state = -np.linalg.solve(a, b[:, 0]) * value if len(a) else np.zeros(0)
    before: Array | None = None

    def step(reading: float, ground: float) -> float:
        nonlocal state, before
        now = np.array([reading, ground])
        if before is not None:
            state = phi @ state + held @ before + risen @ (now - before)
        before = now
        return float((c @ state + d @ now)[0])

    return step
