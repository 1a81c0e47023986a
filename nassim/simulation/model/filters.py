"""Filters of outputs, and the acceleration of the ground in inertial outputs."""

from collections.abc import Callable

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


def start_filter(system: StateSpace, time_step: float, value: float) -> Callable[[float], float]:
    """Make a filter that is in steady state at a value at the start.

    Between time steps its input is linear.

    Args:
        system: state space of the filter.
        time_step: time step [s].
        value: constant input before the start.

    Returns:
        A function that takes the input at each time step and returns the filtered value.
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
