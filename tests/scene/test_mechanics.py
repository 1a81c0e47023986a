"""Mechanical parts and joints refuse what has no meaning, before any long work."""

from dataclasses import fields, replace

import numpy as np
import pytest
from conftest import assert_limit
from scipy.spatial.transform import Rotation

from nassim import Encoder, Joint, PointForce, RigidBody, Scene, SpringDamper, linearize
from nassim.base.rigid_motion import axes_along
from nassim.scene.forces import GroundAcceleration, LinearActuator, PointTorque
from nassim.scene.joints import cylindrical, fixed, planar, prismatic, revolute, spherical, universal
from nassim.scene.measures import BodyCoordinates, Displacement, PointVelocity
from nassim.scene.motion_sensors import AngleSensor, Pose
from nassim.scene.rotation_measures import RelativePose, RotationAngle, RotationDeviation
from nassim.scene.scene import KINDS
from nassim.scene.springs import Bushing
from nassim.scene.terms import AppliedForce, CoilForce, Constraint, Output
from nassim.scene.voice_coil import VoiceCoil
from nassim.simulation.model.assembly import assemble

MIRROR = np.diag([1.0, 1.0, -1.0])
SHEARED = np.eye(3) + 0.1 * np.eye(3, k=1)
ODD = np.array([2.0, -1.0, 2.0]) / 3


def bodies():
    points = {"o": (0, 0, 0), "away": (0.1, 0, 0)}
    return RigidBody("base", points, fixed=True), RigidBody("body", points, 1.0, 0.01 * np.eye(3))


def scene(**parts):
    return Scene("s", bodies(), **{kind: (part,) for kind, part in parts.items()})


@pytest.mark.parametrize(
    "make",
    [
        lambda path: SpringDamper("s", path, path, "z", 1.0),
        lambda path: Bushing("s", path, path, np.ones(6)),
        lambda path: LinearActuator("s", path, path, "u"),
        lambda path: Encoder("s", path, path, "z"),
        lambda path: AngleSensor("s", path, path),
        lambda path: Pose("s", path, path),
    ],
)
def test_nothing_ties_a_point_to_itself(make):
    with pytest.raises(ValueError, match=r"'s' connects 'body\.o' with itself"):
        make("body.o")


@pytest.mark.parametrize(
    "part",
    [
        SpringDamper("s", "base.o", "body.away", "x", 1.0, frame="base.o"),
        Bushing("s", "base.o", "body.o", np.ones(6)),
        Joint("s", "base.o", "body.o"),
        PointForce("s", "body.o", "x", "i", frame="body.o"),
        PointTorque("s", "body.o", "x", "i", frame="body.o"),
        LinearActuator("s", "base.o", "body.away", "i"),
        VoiceCoil("s", "base.o", "body.o", "x", 1.0, 1.0, 1.0, "i", frame="base.o"),
        GroundAcceleration("s", "x", "i", frame="body.o"),
        Encoder("s", "base.o", "body.o", "x", frame="base.o"),
        AngleSensor("s", "base.o", "body.o"),
        Pose("s", "base.o", "body.o"),
    ],
    ids=lambda part: type(part).__name__,
)
def test_a_point_that_no_body_has_is_named(part):
    (kind,) = (kind for kind in KINDS if isinstance(part, KINDS[kind]))
    scene(**{kind: part})
    given = {field.name: str(getattr(part, field.name)) for field in fields(part)}
    paths = {field: text for field, text in given.items() if text.startswith(("base.", "body."))}
    assert paths
    for field, path in paths.items():
        body = path.partition(".")[0]
        with pytest.raises(ValueError, match=f"unknown point of '{body}': 'nowhere'; known: o, away"):
            scene(**{kind: replace(part, **{field: f"{body}.nowhere"})})


@pytest.mark.parametrize(
    "make",
    [
        lambda measure: AppliedForce("u", "N", measure),
        lambda measure: CoilForce("c", "u", measure, 1.0, 1.0, 1.0),
        lambda measure: Output("o", "m", measure),
    ],
)
def test_a_force_and_an_output_have_one_component(make):
    with pytest.raises(ValueError, match="has the components x, y, z, rx, ry, rz; give a measure of one"):
        make(RelativePose("base.o", "body.o"))


def test_a_constraint_holds_each_component_once_in_the_order_of_its_measure():
    pose = RelativePose("base.o", "body.o")
    assert Constraint("c", pose, ["rz", "x", "ry", "x"]).held == ("x", "ry", "rz")
    with pytest.raises(ValueError, match="unknown component of constraint 'c' 'r'; known: x, y, z, rx, ry, rz"):
        Constraint("c", pose, ("x", "r"))


@pytest.mark.parametrize("axis", [(0, 0, 0), "w", (1, 0), (np.nan, 0, 0)], ids=str)
def test_axes_that_are_none(axis):
    makers = (
        lambda: SpringDamper("p", "base.o", "body.o", axis, 1.0),
        lambda: PointForce("p", "body.o", axis, "i"),
        lambda: PointTorque("p", "body.o", axis, "i"),
        lambda: Encoder("p", "base.o", "body.o", axis),
        lambda: AngleSensor("p", "base.o", "body.o", axis),
        lambda: GroundAcceleration("p", axis, "i"),
        lambda: revolute("p", "base.o", "body.o", axis),
        lambda: prismatic("p", "base.o", "body.o", axis),
        lambda: cylindrical("p", "base.o", "body.o", axis),
        lambda: planar("p", "base.o", "body.o", axis),
        lambda: universal("p", "base.o", "body.o", axis, "x"),
    )
    for make in makers:
        with pytest.raises(ValueError, match="axis"):
            make()


@pytest.mark.parametrize(
    "wrong", [[1.0, np.nan, 0.0], np.eye(2), [1.0, 0.0], np.ones(4)], ids=["nan", "shape", "two", "four"]
)
def test_measures_of_wrong_directions_are_refused(wrong):
    """And so are the weights on coordinates that a gauge of one's own may have."""
    right, pair = np.ones(3), ("base.o", "body.o")
    for make in (
        lambda: Displacement((("body.o", wrong),)),
        lambda: PointVelocity((("body.o", wrong),)),
        lambda: RotationAngle("body.o", wrong),
        lambda: RotationDeviation(*pair, wrong, *pair, right),
        lambda: RotationDeviation(*pair, right, *pair, wrong),
        lambda: RelativePose(*pair, wrong),
        lambda: BodyCoordinates("body", [wrong]),
        lambda: BodyCoordinates("body", [np.nan]),
    ):
        with pytest.raises(ValueError, match=r"direction|axis|axes|weights of coordinates"):
            make()
    with pytest.raises(ValueError, match="unknown rotation of a relative pose"):
        RelativePose(*pair, rotation="Euler")


@pytest.mark.parametrize("axes", [MIRROR, SHEARED, 2 * np.eye(3)], ids=["mirrored", "sheared", "long"])
def test_axes_that_are_no_rotation(axes):
    for make in (
        lambda: Bushing("p", "base.o", "body.o", np.ones(6), axes=axes),
        lambda: Pose("p", "base.o", "body.o", axes),
        lambda: Joint("p", "base.o", "body.o", "rz", axes),
        lambda: RigidBody("p", {}, 1.0, np.eye(3), rotation=axes),
    ):
        with pytest.raises(ValueError, match="proper orthogonal"):
            make()


def test_axes_of_a_universal_joint_are_perpendicular():
    with pytest.raises(ValueError, match="must be perpendicular"):
        universal("p", "base.o", "body.o", "x", (1, 1, 0))
    with pytest.raises(ValueError, match="span no plane"):
        axes_along("z", (0, 0, -2))


def with_entry(value, *places):
    """A unit matrix (6, 6) with another value at some places."""
    matrix = np.eye(6)
    for place in places:
        matrix[place] = value
    return matrix


def with_gap(gap):
    """Bodies that a joint connects, so far apart [m]."""
    base, body = bodies()
    return Scene("s", (base, replace(body, position=gap * ODD)), (fixed("p", "base.o", "body.o"),))


def with_inertia(inertia):
    return RigidBody("p", {}, 1.0, inertia)


def on_a_line(gap):
    """An encoder between points so far apart [m]."""
    base, body = bodies()
    sensor = Encoder("e", "base.o", "body.o", "line")
    return Scene("s", (base, replace(body, position=gap * np.array([0.0, 1.0, 0.0]))), sensors=(sensor,))


def test_points_a_micrometre_apart_have_a_line_wherever_they_are():
    base, body = bodies()
    far = np.array([3.0, -4.0, 12.0])
    sensor = Encoder("e", "base.o", "body.o", "line")
    whole = replace(base, position=far), replace(body, position=far + np.array([0.0, 1e-6, 0.0]))
    assert Scene("s", whole, sensors=(sensor,)).outputs == ("e",)


LIMITS = {
    "a line between points": (lambda x: on_a_line(1e-12 / x), "lie in one place"),
    "a gap in a joint": (lambda x: with_gap(1e-9 * x), "m apart"),
    "skew axes": (lambda x: universal("p", "base.o", "body.o", "x", (1e-9 * x, 1, 0)), "must be perpendicular"),
    "a skew bushing": (
        lambda x: Bushing("p", "base.o", "body.o", with_entry(1e-9 * x, (0, 1))),
        "symmetric and not negative",
    ),
    "a negative bushing": (
        lambda x: Bushing("p", "base.o", "body.o", with_entry(1 + 1e-9 * x, (0, 1), (1, 0))),
        "symmetric and not negative",
    ),
    "a skew inertia": (lambda x: with_inertia(with_entry(1e-9 * x, (0, 1))[:3, :3]), "inertia must be symmetric"),
    "more than flat": (lambda x: with_inertia(np.diag([1.0, 3.0, 4.0 * (1 + 2e-3 * x)])), "no body has the principal"),
}


@pytest.mark.parametrize("case", LIMITS)
def test_limits_lie_where_they_should(case):
    assert_limit(*LIMITS[case])


@pytest.mark.parametrize(
    ("parts", "message"),
    [
        ({"sensors": Encoder("p", "base.o", "base.away", "x")}, "belong to fixed bodies"),
        ({"sensors": AngleSensor("p", "base.o", "base.away")}, "belong to fixed bodies"),
        ({"sensors": Pose("p", "base.o", "base.away")}, "belong to fixed bodies"),
        ({"actuators": PointForce("p", "base.o", "x", "i")}, "which no force moves"),
        ({"actuators": PointTorque("p", "base.o", "x", "i")}, "which no force moves"),
        ({"actuators": LinearActuator("p", "base.o", "base.away", "i")}, "belong to one rigid body"),
        ({"springs": SpringDamper("p", "body.o", "body.away", "x", 1.0)}, "belong to one rigid body"),
        ({"springs": Bushing("p", "body.o", "body.away", np.ones(6))}, "belong to one rigid body"),
        ({"springs": SpringDamper("p", "base.o", "body.o", "line", 1.0)}, "lie in one place"),
        ({"actuators": LinearActuator("p", "base.o", "body.o", "i")}, "lie in one place"),
        ({"sensors": Encoder("p", "base.o", "body.o", "line")}, "lie in one place"),
        ({"sensors": Encoder("p", "base.o", "body.o", "x", frame="body.nowhere")}, "unknown point"),
        ({"actuators": PointForce("p", "body.o", "x", "i", frame="body.nowhere")}, "unknown point"),
        ({"actuators": PointTorque("p", "body.o", "x", "i", frame="body.nowhere")}, "unknown point"),
        ({"springs": SpringDamper("p", "base.o", "body.o", "x", 1.0, frame="body.nowhere")}, "unknown point"),
        ({"joints": revolute("p", "base.o", "body.away", "x")}, "m apart"),
    ],
    ids=str,
)
def test_parts_that_do_nothing(parts, message):
    with pytest.raises(ValueError, match=message):
        linearize(scene(**parts))


@pytest.mark.parametrize(
    "stiffness", [np.triu(np.ones((6, 6))), -np.ones(6), np.ones(5), np.diag([1.0] * 5 + [-1.0])], ids=str
)
@pytest.mark.parametrize("size", [1e-12, 1e12])
def test_a_bushing_that_is_none(stiffness, size):
    with pytest.raises(ValueError, match="bushing 'p': stiffness"):
        Bushing("p", "base.o", "body.o", size * stiffness)


def test_the_ground_shakes_along_the_axes_of_its_frame_in_the_text_too():
    assert GroundAcceleration("p", "x", "i", "body.o").describe() == (
        "ground acceleration p: along x of body.o, by i [m/s2]"
    )


@pytest.mark.parametrize("size", ["stiffness", "damping"])
def test_a_spring_damper_does_not_feed_energy(size):
    with pytest.raises(ValueError, match=f"spring-damper 'p': {size} must not be negative, got -2"):
        SpringDamper("p", "base.o", "body.o", **{"stiffness": 1e3, "damping": 1.0, size: -2.0})


def test_a_spring_damper_has_no_stiffness_and_no_damping_unless_given():
    spring = SpringDamper("p", "base.o", "body.o", "x", stiffness=3.0)
    damper = SpringDamper("p", "base.o", "body.o", "x", damping=4.0)
    matrices = [part.terms(scene(springs=part))[0].matrices for part in (spring, damper)]
    np.testing.assert_array_equal(matrices, [[[[3.0]], [[0.0]]], [[[0.0]], [[4.0]]]])


def test_a_fixed_body_does_not_spin():
    with pytest.raises(ValueError, match="cannot spin"):
        RigidBody("p", {}, fixed=True, angular_velocity=(0, 0, 1))


@pytest.mark.parametrize(
    ("make", "shifts", "turns"),
    [
        (fixed, [], []),
        (lambda *a: revolute(*a, 3 * ODD), [], [ODD]),
        (lambda *a: prismatic(*a, -ODD), [ODD], []),
        (lambda *a: cylindrical(*a, ODD), [ODD], [ODD]),
        (spherical, [], list(np.eye(3))),
        (lambda *a: planar(*a, ODD), [np.cross(ODD, [1.0, 0, 0]), np.cross(ODD, [0, 1.0, 0])], [ODD]),
        (lambda *a: universal(*a, ODD, (1, 2, 0)), [], [ODD, [1.0, 2, 0]]),
    ],
    ids=["fixed", "revolute", "prismatic", "cylindrical", "spherical", "planar", "universal"],
)
def test_what_a_joint_leaves_free(make, shifts, turns):
    """The free motions of one body on the ground span what the joint's name says."""
    basis = assemble(scene(joints=make("j", "base.o", "body.o"))).modal.basis if shifts or turns else np.zeros((6, 0))
    wanted = np.array([[*s, 0, 0, 0] for s in shifts] + [[0, 0, 0, *t] for t in turns]).reshape(-1, 6).T
    assert basis.shape[1] == wanted.shape[1]
    both = np.linalg.matrix_rank(np.hstack([basis / 1.0, wanted]), tol=1e-9)
    assert both == wanted.shape[1]


@pytest.mark.parametrize(("stiffness", "moments"), [((0, 0, 5.0), (0, 0, 5.0)), ((2.0, 3.0, 0), (0, 0, 0))])
def test_a_bushing_with_one_stiff_rotation_is_a_spiral_spring_and_one_with_two_is_a_bearing(stiffness, moments):
    """Turned by a radian about its axis, and a bearing with a tilt of 1 mrad of its shaft, which it sees as such."""
    axes = axes_along(ODD, (1.0, 0, 0))
    (law,) = Bushing("b", "base.o", "body.o", (0, 0, 0, *stiffness), axes=axes).terms(scene())
    turn = Rotation.from_rotvec(axes[:, 2]).as_matrix()
    origin = np.zeros(3)

    def resisted(rotation):
        value, _ = law.measure.at([(origin, np.eye(3)), (origin, rotation)], [origin, origin])
        return law.resistance(value, np.zeros(6))[3:]

    np.testing.assert_allclose(resisted(turn), moments, atol=1e-12)
    if not stiffness[2]:
        tilted = Rotation.from_rotvec(1e-3 * axes[:, 0]).as_matrix() @ turn
        np.testing.assert_allclose(resisted(tilted), np.array(stiffness) * [1e-3, 0, 0], atol=1e-8)
