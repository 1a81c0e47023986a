"""Readings of a steady rotation by outputs, and gravity across its axis, for runs about the rotation.

A linear model's outputs are deviations from the steady rotation, those of a run are absolute: an angle sensor between
stator and rotor reads the rotor's angle, a vibrometer on the rotor the speed of its point. With J the Jacobian of a
measure, q the coordinates and r(q) the velocities of the rotation itself, a rate reads

    J(q) (q' + r(q)) = J q' + J r + (d(J r)/dq) q     to first order,

and an acceleration in the rotor's frame likewise, with Coriolis and centrifugal accelerations. The angular acceleration
of a body on the rotor, whose small rotation is e, is e'' + W x e'.
"""

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from nassim.base.checks import Array
from nassim.base.rigid_motion import rigid_transfer, rotated_motion, skew
from nassim.scene.field_kinds import body_of
from nassim.scene.measures import PointMeasure
from nassim.scene.terms import Output
from nassim.simulation.loaded.rotor_frame import CHECKED_ANGLES, ChangesWithAngle, FrameView, RotorPartition
from nassim.simulation.loaded.rotor_stator import ROTATION_TOLERANCE, rigid_coordinates, rotation_about
from nassim.simulation.model.assembly import Assembly
from nassim.simulation.model.initial_velocities import initial_twists
from nassim.simulation.model.moved_coordinates import MovedCoordinates
from nassim.simulation.model.steady_rotation import SteadyRotation

READING_TOLERANCE = 1e-7
"""Difference of readings, over that by a radian of the rotor, up to which they count as equal."""
ALONG_AXIS = 1e-12
"""Share of gravity across the axis that is rounding."""
STEP = 1e-5
"""Displacement [m] and rotation [rad] of difference quotients of velocities."""


def with_rotation(assembly: Assembly, partition: RotorPartition, gravity: Array, *, released: bool) -> Assembly:
    """Add the steady rotation of a rotor to an assembled scene, for runs.

    Args:
        assembly: the assembled scene about the rotation.
        partition: rotor and stator, with the frame of the assembly's loads.
        gravity: gravity of the scene, (3,) [m/s2]; its part along the axis is one of the constant loads.
        released: whether the run starts in the reference configuration and not in equilibrium.

    Returns:
        The assembly, whose outputs are absolute.

    Raises:
        ChangesWithAngle: for an output (by name) that changes with the angle other than in proportion to it.
        ValueError: for angular velocities at the start that joints do not allow.
    """
    scene, modes, coordinates = assembly.scene, assembly.modal.modes, assembly.coordinates
    axis = partition.velocity / np.linalg.norm(partition.velocity)
    force = np.zeros((modes.shape[1], 2))
    if partition.frame == "rotor":  # where gravity rotates backwards
        across = np.cross(gravity, axis)
        across = across * (np.linalg.norm(across) > ALONG_AXIS * np.linalg.norm(gravity))
        force = np.column_stack([modes.T @ coordinates.weight(g) for g in (np.cross(axis, across), across)])
    assembly = with_rates(assembly, partition)
    view, readings = FrameView(assembly, partition), np.zeros((len(scene.outputs), 2))
    for term in assembly.terms:
        if isinstance(term, Output):
            constant, per_radian = (_of_rate(view, term)[0], 0.0) if term.derivative else (0.0, _per_radian(view, term))
            readings[scene.outputs.index(term.name)] += term.gain * np.array([constant, per_radian])
    rotor = frozenset(body.name for body in scene.bodies) - partition.stator
    start = modes.T @ coordinates.mass @ _released(assembly, partition) if released else np.zeros(len(force))
    rotation = SteadyRotation(partition.velocity, partition.point, rotor, partition.frame, force, readings, start)
    return replace(assembly, rotation=rotation)


def with_rates(assembly: Assembly, partition: RotorPartition) -> Assembly:
    """Let outputs that are velocities and accelerations read what a deflection adds to those of the rotation itself.

    Args:
        assembly: the assembled scene about the rotation.
        partition: rotor and stator, with the frame of the assembly's loads.

    Returns:
        The assembly, whose velocities and accelerations are deviations of those against the ground.
    """
    view, outputs = FrameView(assembly, partition), assembly.scene.outputs
    displacements, velocities = assembly.signals.output_matrix.copy(), assembly.signals.velocity_matrix.copy()
    for term in assembly.terms:
        if isinstance(term, Output) and term.derivative:
            k = outputs.index(term.name)
            displacements[k] += term.gain * _of_rate(view, term)[1]
            if term.derivative == 2:
                velocities[k] += term.gain * _coriolis(view, term)
    signals = replace(assembly.signals, output_matrix=displacements, velocity_matrix=velocities, against_ground=True)
    return replace(assembly, signals=signals)


def _released(assembly: Assembly, partition: RotorPartition) -> Array:
    """Return the rates of all coordinates at the start of a scene that is released, beside the rotation, (n_all,).

    Bodies on springs do not turn with their rotor from the start unless they have its angular_velocity.
    """
    motions = {}
    for name, twist in initial_twists(assembly.scene).items():
        place = assembly.scene.body(name).position
        turning = np.concatenate([np.cross(partition.velocity, place - partition.point), partition.velocity])
        motions[name] = rigid_transfer(place) @ twist - turning * (name not in partition.stator)
    return rigid_coordinates(assembly.coordinates, motions)


def _per_radian(view: FrameView, term: Output) -> float:
    """Return the change of an output's measure per radian of the rotor; it must be constant, as must its rows."""
    partition, coordinates, measure = view.partition, view.assembly.coordinates.reference, term.measure
    if not measure.has_value:  # its value in small motion is that of the deviation alone
        return 0.0
    moving = coordinates.slices.keys() - partition.stator
    rows = coordinates.jacobian(measure)
    rotation = rotation_about(coordinates, moving, partition.velocity, partition.point)
    slope, size = float((rows @ rotation)[0]), float((np.abs(rows) @ (np.abs(rotation) + 1e-3))[0])
    if abs(slope) < ROTATION_TOLERANCE * size:
        slope = 0.0
    start = float(measure.evaluate(view.states(0.0))[0][0])  # loads may strain a body there
    for angle in CHECKED_ANGLES:
        states = view.states(angle)
        change = float(measure.evaluate(states)[0][0]) - start - slope * angle
        if measure.period:
            change -= measure.period * np.round(change / measure.period)
        turned = float(np.linalg.norm((coordinates.jacobian(measure, states) - rows) * view.scale))
        if abs(change) > READING_TOLERANCE * size or turned > READING_TOLERANCE * np.linalg.norm(rows * view.scale):
            raise ChangesWithAngle(
                f"output {term.name!r} changes with the angle of the rotor, other than in proportion to it: read along "
                'the axis, or along a direction whose frame is a point of the rotor: frame="body.point"'
            )
    return slope


def _of_rate(view: FrameView, term: Output) -> tuple[float, Array]:
    """Return the rate of an output's measure by the rotation alone, and per unit of all coordinates, (n_all,).

    For an output of an acceleration, it is the measure's second rate.
    """
    coordinates, scene = view.assembly.coordinates, view.assembly.scene
    constant, slopes = 0.0, np.zeros(coordinates.size)
    for factor, measure in term.measure.point_measures:
        n = 6 * len(measure.points)
        constant += factor * _rate(view, measure, np.zeros(n), term.derivative)
        for k, path in enumerate(measure.points):
            if scene.split(path)[0].moves:
                steps = STEP * np.eye(n)[6 * k : 6 * k + 6]
                changes = [
                    (_rate(view, measure, step, term.derivative) - _rate(view, measure, -step, term.derivative))
                    / (2 * STEP)
                    for step in steps
                ]
                slopes += factor * np.array(changes) @ coordinates.motion(path)
    if isinstance(coordinates, MovedCoordinates):  # at rest, but coordinates are from the reference configuration
        assert view.assembly.loads is not None
        constant -= float(slopes @ view.assembly.modal.modes @ view.assembly.loads.equilibrium)
    return constant, slopes


def _coriolis(view: FrameView, term: Output) -> Array:
    """Return Coriolis accelerations along an output's measure per unit rate of all coordinates, (n_all,)."""
    partition, coordinates = view.partition, view.assembly.coordinates
    turn, result = skew(partition.velocity), np.zeros(coordinates.size)
    for factor, measure in term.measure.point_measures:
        rows = measure.at_states(coordinates.states)[1][0].reshape(-1, 2, 3)
        for (along, around), path in zip(rows, measure.points, strict=True):
            on_stator = body_of(path) in partition.stator
            if partition.frame == "rotor":
                wrench = np.concatenate([2 * along @ turn, (1.0 + on_stator) * around @ turn])
            else:  # the points of the rotor that outputs read are on its axis
                wrench = np.concatenate([0 * along, (on_stator - 1.0) * around @ turn])
            result += factor * wrench @ coordinates.motion(path)
    return result


def _rate(view: FrameView, measure: PointMeasure, moves: Array, order: int) -> float:
    """Return a rate of a measure, of order 1 or 2, by the rotation alone, with small motions of points, (6 points,)."""
    at_rest, reference = measure.poses(view.assembly.coordinates.states)
    moved = moves.reshape(-1, 6)
    poses = [
        (place + move[:3], Rotation.from_rotvec(move[3:]).as_matrix() @ rotation)
        for (place, rotation), move in zip(at_rest, moved, strict=True)
    ]
    velocities = [
        (_velocity if order == 1 else _acceleration)(view.partition, body_of(path), place, move)
        for path, (place, _), move in zip(measure.points, at_rest, moved, strict=True)
    ]
    return float((measure.at(poses, reference)[1] @ np.concatenate(velocities))[0])


def _velocity(partition: RotorPartition, body: str, place: Array, move: Array) -> Array:
    """Return velocity and angular velocity of a point by the rotation alone, beside the rates of its motion, (6,).

    Args:
        partition: rotor and stator.
        body: name of the point's body.
        place: position of the point about which its motion is small, (3,) [m].
        move: this motion in the describing frame, (6,).
    """
    turn = skew(partition.velocity)
    if body in partition.stator:
        # The motion v in the rotor's frame is R^T u, hence u' = v' + W x v.
        moving = partition.frame == "rotor"
        return np.concatenate([turn @ move[:3], turn @ move[3:]]) * moving
    if partition.frame == "rotor":
        return np.concatenate([turn @ (place + move[:3] - partition.point), partition.velocity])
    # Small rotations e change the rotation's velocities: W + e x W, W x r + e x (W x r).
    spun = np.concatenate([turn @ (place - partition.point), partition.velocity])
    return spun + rotated_motion(skew(move[3:])) @ spun


def _acceleration(partition: RotorPartition, body: str, place: Array, move: Array) -> Array:
    """Return acceleration and angular acceleration of a point by the rotation alone, (6,); arguments as `_velocity`."""
    if partition.frame == "stator":  # points of the stator, or on the axis
        return np.zeros(6)
    twice = skew(partition.velocity) @ skew(partition.velocity)
    if body in partition.stator:
        return np.concatenate([twice @ move[:3], twice @ move[3:]])
    return np.concatenate([twice @ (place + move[:3] - partition.point), np.zeros(3)])
