"""Measures of parts, and frames of bodies, in configurations that are rare."""

from dataclasses import replace

import numpy as np
import pytest
from conftest import Given, lattice
from scipy.spatial.transform import Rotation

from nassim import Bushing, FlexibleBody, RigidBody, Scene, SpringDamper, craig_bampton, fixed
from nassim.base.rigid_motion import skew
from nassim.scene import Combination, Loop, RotationAngle, StackActuator, StackSensor
from nassim.scene.measures import BodyCoordinates
from nassim.scene.rotation_measures import RelativePose, inverse_right_jacobian
from nassim.scene.terms import Spring
from nassim.simulation.model.states import RigidState
from nassim.systems import proportional

NORMAL = np.array([1.0, 2.0, -2.0]) / 3
TURN = Rotation.from_rotvec([0.5, -0.9, 0.4])
BODIES = tuple(RigidBody(name, {"p": np.zeros(3)}, 1.0, np.eye(3)) for name in "ab")


def test_what_turns_together_has_no_angle_between_it():
    """Of a rate of both the deviation sees nothing, of that of b its component along an axis that turns with a."""
    deviation = RotationAngle("b.p", NORMAL, "a.p").deviation
    assert deviation.points == ("b.p", "a.p", "a.p")
    turned = (np.zeros(3), TURN.as_matrix())
    _, rows = deviation.at([turned] * 3, [np.zeros(3)] * 3)
    rates = rows[0].reshape(3, 6)[:, 3:]
    np.testing.assert_allclose(rates[0], TURN.as_matrix() @ NORMAL, atol=1e-12)
    np.testing.assert_allclose(rates.sum(axis=0), 0.0, atol=1e-12)


def test_small_turns_of_a_screw_beside_a_large_one_count_about_its_axis():
    """Of b against a, wherever b has turned already: a combination deviates as its parts do."""
    screw = Combination(((-2.0, RotationAngle("b.p", NORMAL, "a.p")),)).deviation
    turns = np.zeros(3), TURN.as_rotvec()
    states = {
        body.name: RigidState(body, np.append(np.zeros(3), turn)) for body, turn in zip(BODIES, turns, strict=True)
    }
    _, rows = screw.evaluate(states)
    np.testing.assert_allclose([rows["b"][0, 3:], rows["a"][0, 3:]], [-2.0 * NORMAL, 2.0 * NORMAL], atol=1e-12)


@pytest.mark.parametrize(
    ("turning", "expected"),
    [
        ((1.0, 1.0, 1.0), TURN.as_rotvec()),
        ((1.0, 1.0, 0.0), np.cross([0.0, 0, 1], TURN.as_matrix()[:, 2])),
        (3 * [0], np.zeros(3)),
    ],
    ids=["bushing", "bearing", "spherical bearing"],
)
def test_a_bushing_twists_by_the_rotation_vector_and_a_bearing_tilts_at_any_angle_of_its_shaft(turning, expected):
    """The tilt is that of the shaft's axis; a spherical bearing has none."""
    (law,) = Bushing("bushing", "a.p", "b.p", (1.0, 1.0, 1.0, *turning)).terms(Scene("scene", BODIES))
    value, _ = law.measure.at([(np.zeros(3), np.eye(3)), (np.zeros(3), TURN.as_matrix())], [np.zeros(3)] * 2)
    np.testing.assert_allclose(value[3:], expected, atol=1e-12)


def test_a_frame_rides_where_a_joint_holds_before_where_a_spring_does():
    """Whatever the order of the points of the body."""
    reduced = craig_bampton(lattice(), n_modes=1, progress=False)
    body = FlexibleBody("bar", reduced)
    places = {name: reduced.point(name).position for name in ("left", "right")}
    ground = RigidBody("ground", {**places, "o": np.array([0.0, 0.0, -0.1])}, fixed=True)
    for held, sprung in (("left", "right"), ("right", "left")):
        parts = {
            "joints": (fixed("clamp", f"ground.{held}", f"bar.{held}"),),
            "springs": (SpringDamper("spring", "ground.o", f"bar.{sprung}", stiffness=1.0),),
        }
        assert Scene("both", (ground, body), **parts).frame_point(body) == held
        assert Scene("sprung", (ground, body), springs=parts["springs"]).frame_point(body) == sprung
        assert Scene("free", (ground, body)).frame_point(body) == "left"
    inner = SpringDamper("inner", "bar.right", "bar.left", "line", stiffness=1.0)
    along = Given("along", (Spring(BodyCoordinates.between(body, "right", "left", NORMAL), 1.0),))
    found = [Scene("own", (ground, body), springs=(spring,)).frame_point(body) for spring in (inner, along)]
    assert found == ["right", "left"], "a law of the coordinates of a body holds no point"


@pytest.mark.parametrize(("gains", "commands"), [([[1.0, 2.0]], ("l",)), ([[1.0], [2.0]], ("l.u0", "l.u1"))])
def test_commands_of_a_loop_are_called_by_what_it_drives(gains, commands):
    n_driven, n_measured = np.shape(gains)
    names = (tuple(f"y{k}" for k in range(n_measured)), tuple(f"u{k}" for k in range(n_driven)))
    assert Loop("l", proportional(gains, sample_rate=1e3), *names).commands == commands


@pytest.mark.parametrize("angle", [1e-9, 1.5e-4, 0.9e-2, 1.1e-2, 0.8, 3.0])
def test_rates_of_rotation_vectors_of_any_size(angle):
    """Inverse of the right Jacobian I - (1 - cos t) / t^2 [v] + (t - sin t) / t^3 [v]^2, and of the left one, J^T."""
    cross = angle * skew(NORMAL)
    squares = 0.5 * np.sinc(angle / (2 * np.pi)) ** 2
    cubes = 1 / 6 - angle**2 / 120 + angle**4 / 5040 if angle < 0.1 else (angle - np.sin(angle)) / angle**3
    forth = np.eye(3) - squares * cross + cubes * cross @ cross
    np.testing.assert_allclose(inverse_right_jacobian(NORMAL * angle) @ forth, np.eye(3), atol=1e-13)
    poses = [(np.zeros(3), turned) for turned in (np.eye(3), Rotation.from_rotvec(NORMAL * angle).as_matrix())]
    _, rows = RelativePose("a.p", "b.p").at(poses, [np.zeros(3)] * 2)
    np.testing.assert_allclose(rows[3:, 9:] @ forth.T, np.eye(3), atol=1e-13)


def test_stacks_push_apart_and_tell_compression_by_a_positive_voltage():
    """A body squeezed by 2 um between its points: 5 V/m and -3 N/V of them, along the oblique line through both."""
    reduced = craig_bampton(lattice(), n_modes=1, progress=False)
    left, right = reduced.remote_points
    oblique = replace(right, position=left.position + np.array([0.02, -0.01, 0.02]))
    reduced = replace(reduced, remote_points=(left, oblique))
    scene = Scene("scene", (FlexibleBody("bar", reduced),))
    along = oblique.position - left.position
    squeezed = np.zeros(len(reduced.mass_matrix))
    squeezed[6:9] = -2e-6 * along / np.linalg.norm(along)
    (output,) = StackSensor("s", "bar.left", "bar.right", 5.0).terms(scene)
    (force,) = StackActuator("a", "bar.left", "bar.right", -3.0, "u").terms(scene)
    assert output.gain * (output.measure.weights @ squeezed) == pytest.approx(1e-5)
    assert force.gain * (force.measure.weights @ squeezed) == pytest.approx(6e-6)


def test_small_motion_is_of_linear_bodies_and_of_nothing_that_spins():
    reduced = craig_bampton(lattice(), n_modes=1, progress=False)
    linear, floating = (FlexibleBody(kind, reduced, fidelity=kind) for kind in ("linear", "ffrf"))
    rigid, still = FlexibleBody("rigid", reduced, fidelity="rigid"), BODIES[0]
    spinning = replace(still, angular_velocity=(0.0, 0.0, 1.0))
    for bodies, small in (
        ((linear, still), True),
        ((linear, rigid), True),
        ((rigid, still), False),
        ((linear, floating), False),
        ((linear, spinning), False),
    ):
        assert Scene("scene", bodies).in_small_motion == small
