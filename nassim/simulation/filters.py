"""What outputs pass before they are read: low-passes, band-passes, high-passes, and the ground's own acceleration."""

from collections.abc import Callable

import numpy as np

from nassim.base.checks import Array
from nassim.scene.part import Field, Filter, Reading, Row
from nassim.scene.scene import Scene
from nassim.systems.state_space import StateSpace, cascade, discretize


def output_filters(scene: Scene) -> dict[str, StateSpace]:
    """By output that passes filters, or to which the acceleration of the ground adds."""
    result = {}
    shaken = {word.output for word in scene.said(Reading) if word.inertial and scene.said(Field)}
    for output in scene.outputs:
        filters = [word for word in scene.said(Filter) if word.output == output]
        if not filters and output not in shaken:
            continue
        whole: StateSpace = (np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), np.ones((1, 1)))
        for word in filters:
            whole = cascade(whole, _section(word))
        result[output] = whole
    return result


def _section(word: Filter) -> StateSpace:
    """With states of the input's unit: what a low-pass lets through, and of second order what a band-pass does."""
    w = 2 * np.pi * word.frequency
    if word.damping_ratio is None:
        a, b = np.array([[-w]]), np.array([[w]])
    else:
        a, b = w * np.array([[0, 1.0], [-1.0, -2 * word.damping_ratio]]), np.array([[0], [w]])
    if word.passes == "high":
        return a, b, a[-1:] / w, np.ones((1, 1))
    return a, b, np.eye(len(a))[[0 if word.passes == "low" else -1]], np.zeros((1, 1))


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
    """Of a constant."""
    a, b, c, d = system
    return float((d - c @ np.linalg.solve(a, b))[0, 0]) if len(a) else float(d[0, 0])


def start_filter(system: StateSpace, time_step: float, value: float) -> Callable[[float], float]:
    """A filter to which a value has come since ever: a function to be called with what comes at every time step.

    Between the time steps it runs straight. The function returns what passes.
    """
    a, b, c, d = system
    phi, held, risen = discretize(a, b, time_step) if len(a) else (a, b, b)
    state = -np.linalg.solve(a, b[:, 0]) * value if len(a) else np.zeros(0)
    before: float | None = None

    def step(now: float) -> float:
        nonlocal state, before
        if before is not None:
            state = phi @ state + held[:, 0] * before + risen[:, 0] * (now - before)
        before = now
        return float(c[0] @ state + d[0, 0] * now)

    return step
