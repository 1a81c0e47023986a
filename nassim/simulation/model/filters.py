"""Filters of outputs, and the acceleration of the ground in inertial outputs."""

import numpy as np

from nassim.base.checks import Array
from nassim.scene.measures import Measure
from nassim.scene.scene import Scene
from nassim.scene.terms import BaseAcceleration, Output, OutputFilter
from nassim.systems.state_space import StateSpace, cascade, discretize


def output_filters(scene: Scene) -> dict[str, StateSpace]:
    """Collect the filters of a scene's outputs.

    Args:
        scene: the scene.

    Returns:
        State space by output, for outputs with filters or to which the ground's acceleration adds.
    """
    result = {}
    shaken = {term.name for term in scene.terms_of(Output) if term.inertial and scene.terms_of(BaseAcceleration)}
    for output in scene.outputs:
        filters = [term for term in scene.terms_of(OutputFilter) if term.output == output]
        if not filters and output not in shaken:
            continue
        whole: StateSpace = (np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), np.ones((1, 1)))
        for term in filters:
            whole = cascade(whole, _section(term))
        result[output] = whole
    return result


def _section(term: OutputFilter) -> StateSpace:
    """Return one filter with states in the input's unit: a low-pass, and for second order also a band-pass."""
    w = 2 * np.pi * term.frequency
    if term.damping_ratio is None:
        a, b = np.array([[-w]]), np.array([[w]])
    else:
        a, b = w * np.array([[0, 1.0], [-1.0, -2 * term.damping_ratio]]), np.array([[0], [w]])
    if term.passes == "high":
        return a, b, a[-1:] / w, np.ones((1, 1))
    return a, b, np.eye(len(a))[[0 if term.passes == "low" else -1]], np.zeros((1, 1))


def ground_accelerations(scene: Scene) -> Array:
    """Return the ground's acceleration along the directions of inertial outputs, per unit input, (outputs, inputs).

    The base translates as a whole, so each measure is evaluated for a common translation of its points.
    """
    result = np.zeros((len(scene.outputs), len(scene.inputs)))
    for term in scene.terms_of(Output):
        if term.inertial:
            common = term.gain * common_translation(scene, term.measure)
            for base in scene.terms_of(BaseAcceleration):
                place = scene.outputs.index(term.name), scene.inputs.index(base.input)
                result[place] += float(common @ base.direction)
    return result


def common_translation(scene: Scene, measure: Measure) -> Array:
    """Evaluate a measure's rate per unit of a common velocity of all its points, world axes, (3,)."""
    result = np.zeros(3)
    for factor, part in measure.point_measures:
        places = [scene.point_position(path) for path in part.points]
        rows = part.at([(place, np.eye(3)) for place in places], places)[1]
        result += factor * rows[0].reshape(-1, 6)[:, :3].sum(axis=0)
    return result


def static_gain(system: StateSpace) -> float:
    """Return the gain of a state space at zero frequency."""
    a, b, c, d = system
    return float((d - c @ np.linalg.solve(a, b))[0, 0]) if len(a) else float(d[0, 0])


class RunningFilter:
    """A filter to which a value has come since ever, to be called with what comes at every time step."""

    def __init__(self, system: StateSpace, time_step: float, value: float) -> None:
        a, b, self._c, self._d = system
        self._phi, self._held, self._risen = discretize(a, b, time_step) if len(a) else (a, b, b)
        self.state: tuple[Array, float | None] = (
            -np.linalg.solve(a, b[:, 0]) * value if len(a) else np.zeros(0),
            None,
        )
        """States and what came last; arrays in it are never changed."""

    def __call__(self, now: float) -> float:
        """Filter what comes, which runs straight between the time steps; returns what passes."""
        state, before = self.state
        if before is not None:
            state = self._phi @ state + self._held[:, 0] * before + self._risen[:, 0] * (now - before)
        self.state = state, now
        return float(self._c[0] @ state + self._d[0, 0] * now)


def start_filter(system: StateSpace, time_step: float, value: float) -> RunningFilter:
    """Start a filter to which a value has come since ever; time_step [s]."""
    return RunningFilter(system, time_step, value)
