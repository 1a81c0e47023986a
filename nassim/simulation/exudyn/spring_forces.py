"""Forces of springs and dampers as outputs, from the motions of their points, equal to those of their connectors."""

from collections.abc import Sequence

import exudyn as exu
import numpy as np
from scipy.spatial.transform import Rotation

from nassim.base.checks import Array
from nassim.scene.measures import Displacement
from nassim.scene.rotation_measures import VECTOR, RelativePose
from nassim.scene.terms import ForceLaw, Output, Spring, SpringForce
from nassim.simulation.exudyn.general_items import general_term
from nassim.simulation.exudyn.items import Items
from nassim.simulation.exudyn.outputs import add_output
from nassim.simulation.exudyn.springs import opposite_ends
from nassim.simulation.exudyn.summands import Summand, dot

Kind = exu.OutputVariableType
POSE_AND_VELOCITY = (Kind.Position, Kind.RotationMatrix, Kind.Velocity, Kind.AngularVelocity)
"""Exudyn's variables of each point of a spring."""


def add_spring_force(items: Items, term: SpringForce) -> list[Summand]:
    """Add the sensors of a spring's force, damper included.

    Args:
        items: Exudyn's items of the scene.
        term: the output.

    Returns:
        The summands of the output.
    """
    law, measure = term.spring, term.spring.measure
    k = measure.components.index(term.component)
    if isinstance(law, Spring) and items.has_markers(measure):
        if isinstance(measure, RelativePose) and measure.rotation == VECTOR:
            return [_of_six(items, law, measure, k)]
        if isinstance(measure, Displacement) and items.moves(measure.axes_of):
            ends = opposite_ends(measure)
            if ends and measure.axes_of in ends[:2]:
                return [_along(items, law, measure)]
    if isinstance(law, Spring) and len(measure.components) == 1:
        pulls = enumerate(law.scalars)
        outputs = [Output(term.name, term.unit, measure, gain, derivative) for derivative, gain in pulls if gain]
        return [part for output in outputs for part in add_output(items, output)]
    return [_general(items, law, k)]


def _general(items: Items, law: ForceLaw, k: int) -> Summand:
    """Read a component of any force law."""
    evaluate = items.evaluator(law.measure)
    return general_term(items.mbs, evaluate, lambda value, rate: float(law.resistance(value, rate)[k]), 1)


def _along(items: Items, law: Spring, measure: Displacement) -> Summand:
    """Read the force along axes that rotate with one of two points; the damper resists the rate along these axes."""
    (a, _), (b, along) = measure.weights
    stiffness, damping = law.scalars
    markers = items.marker(a), items.marker(b)
    frame = (a, b).index(measure.axes_of)
    start = along @ (items.scene.point_position(b) - items.scene.point_position(a))

    def value(*columns: Array) -> Array:
        apart, speed, axes, spins = _relative(columns)
        grows = speed - np.cross(spins[frame], apart)
        now = dot(axes[frame], along)
        stretched, rate = dot(now, apart) - start, dot(now, grows)
        return stiffness * stretched + damping * rate

    return Summand(_sensors(items, markers), value)


def _of_six(items: Items, law: Spring, measure: RelativePose, k: int) -> Summand:
    """Read one of six components, along axes halfway between the two points, at the place of b."""
    axes, (stiffness, damping) = measure.axes, law.matrices
    markers = (
        items.marker(measure.a, axes=axes, at=items.scene.point_position(measure.b)),
        items.marker(measure.b, axes=axes),
    )
    both = items.moves(measure.a) and items.moves(measure.b)

    def value(*columns: Array) -> Array:
        apart, speed, (first, second), spins = _relative(columns)
        turned = Rotation.from_matrix(np.swapaxes(first, 1, 2) @ second).as_rotvec()
        halfway = first @ Rotation.from_rotvec(turned / 2).as_matrix()
        # As the connector: against the ground it takes the difference of velocities unchanged.
        grows = speed - both * np.cross((spins[0] + spins[1]) / 2, apart)
        back = np.swapaxes(halfway, 1, 2)
        moved, rates = (
            np.hstack([dot(back, shift[:, None]), turn])
            for shift, turn in ((apart, turned), (grows, dot(back, (spins[1] - spins[0])[:, None])))
        )
        return dot(moved, stiffness[k]) + dot(rates, damping[k])

    return Summand(_sensors(items, markers), value)


def _sensors(items: Items, markers: Sequence[int]) -> tuple[int, ...]:
    """Return sensors of the motions of markers."""
    return tuple(items.sensor(marker, kind) for marker in markers for kind in POSE_AND_VELOCITY)


def _relative(columns: Sequence[Array]) -> tuple[Array, Array, tuple[Array, Array], tuple[Array, Array]]:
    """Return relative position and velocity of two points, (n, 3), and axes (n, 3, 3) and spins (n, 3) of both."""
    (p, r, v, w), (q, s, u, x) = columns[:4], columns[4:]
    return q - p, u - v, (r.reshape(-1, 3, 3), s.reshape(-1, 3, 3)), (w, x)
