"""Geometric stiffness of forces in measures: against difference quotients of the rows and of the work."""

import numpy as np
import pytest
from conftest import lattice
from scipy.spatial.transform import Rotation

from nassim import FlexibleBody, RigidBody, Scene, craig_bampton
from nassim.scene.measures import Displacement, Distance, PointMeasure, PointVelocity
from nassim.scene.rotation_measures import ROTATIONS, RelativePose, RotationAngle
from nassim.simulation.loaded.geometric_stiffness import GeometricStiffness
from nassim.simulation.model.assembly import assemble

A, B, C = "block.corner", "bar.right", "block.top"
U, V = np.array([0.48, -0.6, 0.64]), np.array([-0.7, 1.1, 0.4])
TURN = Rotation.from_rotvec([0.5, -0.4, 0.9]).as_matrix()
WITH_VALUE = [
    Displacement(((A, U), (B, V))),
    Displacement(((A, U), (B, V)), C),
    Distance(A, B),
    RotationAngle(B, V),
    RotationAngle(B, V, A),
    *(RelativePose(A, B, TURN, kind, U) for kind in ROTATIONS),
]
ALL = [*WITH_VALUE, *(PointVelocity(((A, U), (B, V)), C, angular) for angular in (False, True))]


def forces_on(measure):
    """Any force in a measure."""
    return np.random.default_rng(3).normal(size=len(measure.components))


def conservative_force_on(measure):
    """Any force that has an energy: in a tilt, one without a moment about the shaft."""
    force = forces_on(measure)
    if getattr(measure, "rotation", None) == "tilt":
        force[3:] -= measure.shaft * (measure.shaft @ force[3:])
    return force


@pytest.mark.parametrize("measure", ALL)
def test_closed_forms_are_the_derivative_of_the_rows(measure):
    force, places = forces_on(measure), np.random.default_rng(4).normal(size=(len(measure.points), 3))
    still = [(place, np.eye(3)) for place in places]
    expected = PointMeasure.stiffness_at(measure, force, still, places)
    assert measure.geometric_stiffness(force, places) == pytest.approx(expected, abs=1e-10)
    for shift, turn in ((V, TURN), (V, np.eye(3)), (0 * V, TURN)):
        moved = [(place + shift, turn) for place, _ in still[:1]] + still[1:]
        expected = PointMeasure.stiffness_at(measure, force, moved, places)
        assert measure.stiffness_at(force, moved, places) == pytest.approx(expected, abs=1e-10)


@pytest.fixture(scope="module")
def geometric():
    bar = craig_bampton(lattice(), n_modes=1, progress=False)
    turned = Rotation.from_rotvec([-0.3, 0.8, 0.2]).as_matrix()
    points = {"corner": np.array([0.03, -0.02, 0.05]), "top": np.array([-0.04, 0.01, 0.02])}
    block = RigidBody("block", points, mass=1.0, inertia=np.eye(3), position=[0.1, 0.2, -0.1])
    bodies = (block, FlexibleBody("bar", bar, position=[0.3, 0.1, 0.2], rotation=turned, frame="left"))
    return GeometricStiffness.of(assemble(Scene("two", bodies)))


def work(geometric, measure, force, q):
    """Work of a force by finite motion: frames turn by rotation vectors, and carry their points' small deformation."""
    coordinates, scene, poses = geometric.assembly.coordinates, geometric.assembly.scene, []
    places = [scene.point_position(path) for path in measure.points]
    for path, place in zip(measure.points, places, strict=True):
        frame = geometric.frames[path.partition(".")[0]]
        (shift, turn), (u, v) = (np.split(motion @ q, 2) for motion in (frame.motion, coordinates.motion(path)))
        arm, rotation = place - frame.position, Rotation.from_rotvec(turn).as_matrix()
        beside = arm + u - shift - np.cross(turn, arm)
        bend = Rotation.from_rotvec(v - turn).as_matrix()
        poses.append((frame.position + shift + rotation @ beside, rotation @ bend))
    return force @ measure.at(poses, places)[0]


@pytest.mark.parametrize("measure", WITH_VALUE)
def test_stiffness_is_the_second_derivative_of_the_work(geometric, measure):
    force = conservative_force_on(measure)
    stiffness = geometric.of_measure(measure, force)
    assert stiffness == pytest.approx(stiffness.T, abs=1e-12 * np.abs(stiffness).max())
    motion = geometric.assembly.coordinates.motion(B)
    for q in np.random.default_rng(5).normal(size=(4, len(stiffness))):
        h = 2e-3 / np.linalg.norm(np.append(motion @ q, q[:6]))
        shares = ((-2, -1), (-1, 16), (0, -30), (1, 16), (2, -1))
        second = sum(share * work(geometric, measure, force, k * h * q) for k, share in shares) / (12 * h**2)
        assert q @ stiffness @ q == pytest.approx(second, rel=1e-6, abs=1e-8)


def test_a_moment_about_the_shaft_of_a_bearing_turns_with_its_housing(geometric):
    """It has no energy: its stiffness is that of a motor's moment between the points, and not symmetric."""
    bearing = RelativePose(A, B, TURN, "tilt", U)
    moment = geometric.of_measure(bearing, np.append(np.zeros(3), 0.7 * U))
    motor = geometric.of_measure(PointVelocity(((B, TURN @ U), (A, -TURN @ U)), A, angular=True), np.array([0.7]))
    assert moment == pytest.approx(motor, abs=1e-12)
    assert np.abs(moment - moment.T).max() > 0.1
