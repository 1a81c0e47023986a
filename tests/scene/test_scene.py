"""Scenes check themselves: names, gaps, stacks, encoders."""

import copy
import pickle
from dataclasses import replace

import numpy as np
import pytest
from conftest import lattice
from scipy.spatial.transform import Rotation

from nassim import (
    AngleSensor,
    Bushing,
    Drive,
    Encoder,
    FlexibleBody,
    ForceSensor,
    GroundAcceleration,
    Joint,
    LinearActuator,
    Loop,
    PointForce,
    PointTorque,
    Pose,
    ReducedBody,
    RemotePoint,
    RigidBody,
    Scene,
    SpringDamper,
    StackActuator,
    StackSensor,
    Vibrometer,
    VoiceCoil,
    VoltageSensor,
    craig_bampton,
)
from nassim.bodies.projection import trim_body
from nassim.scene.measures import PointVelocity
from nassim.scene.rotation_measures import RelativePose
from nassim.scene.terms import Constraint, NonlinearSpring, Output, Spring
from nassim.simulation.model.assembly import assemble
from nassim.simulation.model.description import describe
from nassim.systems import damping

LENGTH, MASS = 0.1, 2.0
NOTHING = {"mass_matrix": np.zeros((0, 0)), "stiffness_matrix": np.zeros((0, 0)), "gram": np.zeros((4, 4))}
TURN = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])  # z axis of the body: world's x


def reduced(top=(0.0, 0.0, LENGTH)):
    """Half of the mass at each of two remote points, joined by springs: a reduced body made by hand."""
    points = (RemotePoint("bottom", "floor", (0, 0, 0)), RemotePoint("top", "roof", top))
    basis = np.zeros((2, 3, 12))  # displacement of the two masses per coordinate
    for k in range(2):
        basis[k, :, 6 * k : 6 * k + 3] = np.eye(3)
    fields = np.array([[1.0, *points[k].position, *basis[k].T.ravel()] for k in range(2)])
    stiffness = 1e6 * np.kron([[1, -1], [-1, 1]], np.eye(6))
    mass = np.einsum("kci,kcj->ij", basis, basis) * MASS / 2
    gram = fields.T @ fields * MASS / 2
    return ReducedBody("spring", remote_points=points, mass_matrix=mass, stiffness_matrix=stiffness, gram=gram)


RATE = PointVelocity((("a.b", np.array([0.0, 0.0, 1.0])),))
BASE = RigidBody("base", {"mount": (0, 0, 0.02)}, position=(0, 0, -0.02), fixed=True)
LOAD_POINTS = {"foot": (0, 0, -0.05), "side": (0.1, 0, 0)}
LOAD = RigidBody("load", LOAD_POINTS, 5.0, 0.01 * np.eye(3), position=(0, 0, LENGTH + 0.05))
STRUT = FlexibleBody("strut", reduced())
SCENE = Scene(
    "bench",
    bodies=(BASE, STRUT, LOAD),
    joints=(Joint("low", "base.mount", "strut.bottom"), Joint("high", "strut.top", "load.foot", free="z")),
    actuators=(StackActuator("stack", "strut.bottom", "strut.top", 5.0, "voltage", gain=20.0),),
    sensors=(
        StackSensor("sensor", "strut.bottom", "strut.top", 1e6),
        Encoder("encoder", "base.mount", "load.side"),
    ),
)


def test_hand_made_body_is_consistent():
    assert STRUT.reduced.mass == pytest.approx(MASS)
    np.testing.assert_allclose(STRUT.reduced.center_of_mass, [0, 0, LENGTH / 2])


def test_scene_tells_its_inputs_outputs_and_points():
    assert SCENE.inputs == ("voltage",)
    assert SCENE.outputs == ("sensor", "encoder")
    assert [sensor.unit for sensor in SCENE.sensors] == ["V", "m"]
    assert SCENE.flexible_bodies == (STRUT,)
    assert SCENE.joints[1].free == ("z",)
    np.testing.assert_allclose(SCENE.point_position("load.side"), [0.1, 0, LENGTH + 0.05])
    assert SCENE.damping_ratio is None
    np.testing.assert_allclose(SCENE.mode_ratios, [0.01])


@pytest.mark.parametrize("copied", [copy.deepcopy, lambda scene: pickle.loads(pickle.dumps(scene))])
def test_scenes_can_be_copied_and_sent_to_other_processes(copied):
    again = copied(SCENE)
    assert describe(again) == describe(SCENE)
    with pytest.raises(TypeError):
        again.bodies[0].points["new"] = np.zeros(3)


def test_a_scene_in_place_of_its_linear_model_is_told():
    with pytest.raises(AttributeError, match="'Scene' object has no attribute 'poles'; its linear model has: "):
        damping(SCENE)
    assert not hasattr(SCENE, "other")


def test_actuators_may_share_an_input():
    two = (SCENE.actuators[0], replace(SCENE.actuators[0], name="second"))
    assert replace(SCENE, actuators=two).inputs == ("voltage",)


def test_drives_at_constant_speed_share_no_input():
    joints = (replace(SCENE.joints[0], free=("rz",)), SCENE.joints[1])
    drives = (Drive("motor", "low", "rz", speed=3.0), Drive("stage", "high", "z", speed=0.1))
    assert replace(SCENE, joints=joints, actuators=drives).inputs == ()


def test_placement_of_flexible_bodies():
    body = FlexibleBody("strut", reduced(), position=(1, 2, 3), rotation=TURN)
    np.testing.assert_allclose(body.point_position("top"), [1 + LENGTH, 2, 3])
    assert Scene("turned", (body,)).split("strut.top") == (body, "top")


def test_frame_rides_on_the_first_jointed_point():
    assert SCENE.frame_point(STRUT) == "bottom"
    hanging = replace(SCENE, joints=SCENE.joints[1:])
    assert hanging.frame_point(STRUT) == "top"
    assert replace(SCENE, joints=()).frame_point(STRUT) == "bottom"
    chosen = replace(STRUT, frame="top")
    assert replace(SCENE, bodies=(BASE, chosen, LOAD)).frame_point(chosen) == "top"


SHIFTED = replace(STRUT, position=(1e-6, 0, 0))
NO_PARTS = {"joints": (), "actuators": (), "sensors": ()}


def with_joint(a, b):
    return {"joints": (Joint("j", a, b),)}


def with_stack(start, end, kind="actuators"):
    if kind == "actuators":
        return {kind: (StackActuator("stack", start, end, 5.0, "voltage"),)}
    return {kind: (StackSensor("stack", start, end, 1e6),)}


def with_input(actuator):
    """A force and an actuator by one input."""
    return {"actuators": (PointForce("push", "load.foot", "x", "u"), actuator)}


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (with_joint("base.mount", "strut.top"), "'base.mount' and 'strut.top' are 0.1 m apart; .* coincide"),
        ({"bodies": (BASE, SHIFTED, LOAD)}, "joint 'low': .* are 1e-06 m apart"),
        (with_joint("floor.mount", "strut.top"), "unknown body 'floor'; known: base, strut, load"),
        (with_joint("base.foot", "strut.top"), "unknown point of 'base': 'foot'; known: mount"),
        (with_joint("base.mount", "strut.side"), "unknown point of 'strut': 'side'; known: bottom, top"),
        (with_joint("base", "strut.top"), "a point is written 'body.point', got 'base'"),
        ({"bodies": (BASE, STRUT, LOAD, BASE)}, "body names must differ; used more than once: base"),
        ({"joints": SCENE.joints[:1] * 2}, "joint names must differ; used more than once: low"),
        ({"actuators": SCENE.actuators * 2}, "actuator names must differ"),
        ({"sensors": SCENE.sensors[:1] * 2}, "sensor names must differ"),
        ({"bodies": (BASE,), **NO_PARTS}, "'bench' has no body that can move"),
        ({"bodies": (), **NO_PARTS}, "'bench' has no body that can move"),
        ({"damping_ratio": -0.01}, "damping_ratio must not be negative, got -0.01"),
        ({"damping_ratio": [0.01, np.nan]}, "damping_ratio holds 1 value.* NaN"),
        ({"gravity": (0, 0, np.nan)}, "gravity holds 1 value.* NaN"),
        ({"gravity": -9.81}, "gravity must have shape 3, got a number"),
        (with_stack("strut.top", "strut.top"), "stack 'stack': .* must be two points of one flexible body"),
        (with_stack("strut.top", "load.foot"), "must be two points of one flexible body"),
        (with_stack("load.foot", "load.side"), "must be two points of one flexible body"),
        (with_stack("strut.top", "load.foot", "sensors"), "must be two points of one flexible body"),
        (with_stack("strut.top", "strut.side"), "unknown remote point 'side'; known: bottom, top"),
        (with_stack("strut.top", "beam.side", "sensors"), "unknown body 'beam'; known: base, strut, load"),
        ({"sensors": (Encoder("e", "base.mount", "load.top"),)}, "'load': 'top'; known: foot, side"),
        ({"sensors": (Encoder("e", None, "load.foot"),)}, "a point is written 'body.point', got None"),
        ({"name": ""}, "scene names must be non-empty strings"),
        ({"bodies": STRUT}, r"bodies must be a tuple of Body, got FlexibleBody; write \(part,\)"),
        ({"bodies": {"strut": STRUT}}, "bodies must be a tuple of Body, got mappingproxy|got dict"),
        ({"joints": None}, "joints must be a tuple of Connection, got NoneType"),
        ({"joints": ("low",)}, "joints must be of Connection, got 'low', a str"),
        ({"sensors": SCENE.actuators}, "sensors must be of Sensor, got StackActuator"),
        ({"actuators": SCENE.sensors}, "actuators must be of Actuator, got StackSensor"),
        ({"springs": SCENE.joints}, "springs must be of ForceElement, got Joint"),
        ({"bodies": (BASE, replace(STRUT, name="a.b"), LOAD)}, "body 'a.b': no dot in a body's name"),
        ({"damping_ratio": "little"}, "damping_ratio must be numbers, got"),
        ({"damping_ratio": ()}, "damping_ratio needs at least one value"),
        ({"damping_ratio": [[0.01]]}, "damping_ratio must have shape any, got 1 x 1"),
        ({"springs": (SpringDamper("s", "load.foot", "load.side", "z", 1.0),)}, "'s': .* belong to one rigid body"),
        ({"joints": (Joint("j", "load.foot", "load.foot"),)}, "joint 'j' connects 'load.foot' with itself"),
        (
            {
                "bodies": (*SCENE.bodies, replace(BASE, name="floor")),
                "springs": (SpringDamper("s", "base.mount", "floor.mount", "z", 1.0),),
            },
            "'s': 'base.mount' and 'floor.mount' belong to fixed bodies",
        ),
        (
            {
                "joints": (*SCENE.joints[:-1], replace(SCENE.joints[-1], free=("z",))),
                "actuators": tuple(Drive(name, SCENE.joints[-1].name, "z", input=name) for name in "uv"),
            },
            "z of joint '.*' is driven more than once",
        ),
        (with_input(GroundAcceleration("quake", "x", "u")), "input 'u' cannot be both m/s2 and N"),
        (with_input(Drive("motor", "high", "z", input="u")), "input 'u' cannot be both m and N"),
        (with_input(VoiceCoil("coil", "base.mount", "load.foot", "x", 1.0, 1.0, 1.0, "u")), "cannot be both V and N"),
    ],
)
def test_scene_checks_itself(change, message):
    with pytest.raises(ValueError, match=message):
        replace(SCENE, **change)


def test_percent_taken_for_a_ratio_is_told():
    with pytest.warns(UserWarning, match="damping_ratio 2 is critical damping or more.* one percent is the ratio 0.01"):
        replace(SCENE, damping_ratio=(0.01, 2.0))


def test_a_list_of_damping_ratios_counts_elastic_modes():
    """The strut alone has six free motions, which take nothing from the list."""
    body = trimmed()
    assembly = assemble(Scene("free", (FlexibleBody("strut", body),), damping_ratio=(0.02, 0.05)))
    elastic = body.eigenfrequencies() > 0
    assert elastic.sum() == len(elastic) - 6
    expected = np.where(elastic, 0.05, 0.0)
    expected[6] = 0.02
    np.testing.assert_array_equal(assembly.modal.damping.ratio, expected)


@pytest.mark.parametrize(
    "make", [lambda ratios: replace(SCENE, damping_ratio=ratios), lambda ratios: replace(STRUT, damping_ratio=ratios)]
)
def test_damping_ratios_stay_when_the_array_that_they_were_given_by_changes(make):
    ratios = np.array([0.02, 0.05])
    made = make(ratios)
    ratios[:] = 0.5
    np.testing.assert_array_equal(made.damping_ratio, [0.02, 0.05])


def trimmed():
    """A body of two points of which one only moves along."""
    body = craig_bampton(lattice(), n_modes=2, progress=False)
    return trim_body(body, points=["left"], loads=np.zeros((14, 0)), cutoff_frequency=1e9)


@pytest.mark.parametrize("fidelity", ["linear", "ffrf"])
def test_passive_points_cannot_be_held(fidelity):
    body = trimmed()
    strut = FlexibleBody("strut", body, fidelity=fidelity)
    base = RigidBody("base", {"pin": np.zeros(3)}, position=body.point("right").position, fixed=True)
    joints = (Joint("pin", "base.pin", "strut.right"),)
    with pytest.raises(ValueError, match=r"joint 'pin': 'strut.right' is a passive point.*trim_body\(points=...\)"):
        Scene("s", (base, strut), joints)
    held = Scene("s", (base, replace(strut, fidelity="rigid")), joints)
    assert not len(assemble(held).modal.mass)
    with pytest.raises(ValueError, match="unknown remote point 'right'; known: left"):
        FlexibleBody("strut", body, frame="right")


def test_summary_tells_what_is_assumed():
    text = describe(SCENE)
    assert "joint low: base.mount to strut.bottom, rigid" in text
    assert "joint high: strut.top to load.foot, slides along z" in text
    assert "damping: 1 % of critical in every elastic mode\n" in text
    assert text.endswith("gravity: none")
    spring = SpringDamper("hold", "base.mount", "load.foot", "x", 2e3, 5.0, preload=-7.0)
    loaded = replace(SCENE, springs=(spring,), damping_ratio=(0.02, 0.005), gravity=(0, 0, -9.81))
    text = describe(loaded)
    assert "spring hold: base.mount to load.foot along x, 2000 N/m, 5 N s/m, preload -7 N" in text
    assert "damping: 2 %, 0.5 % of critical in the first elastic modes, 0.5 % in all others; plus dampers and" in text
    assert "gravity: 0 0 -9.81 m/s2" in text
    assert "damping: none in modes" in describe(replace(SCENE, damping_ratio=0.0))


def test_summary_tells_points_axes_and_units_of_what_pushes_and_reads():
    base, block = (RigidBody(name, {"a": np.zeros(3), "b": np.eye(3)[2]}, 1.0, np.eye(3)) for name in ("base", "block"))
    scene = Scene(
        "signals",
        (base, block),
        actuators=(
            PointForce("push", "block.b", (0.6, 0.0, 0.8), "f", frame="block.b"),
            PointTorque("twist", "block.b", "y", "t"),
            LinearActuator("leg", "base.a", "block.b", "l"),
            GroundAcceleration("floor", "z", "q"),
        ),
        sensors=(
            Encoder("gap", "base.a", "block.b", "line"),
            AngleSensor("angle", "base.a", "block.a", "x"),
            Pose("pose", "base.a", "block.a", TURN),
            Vibrometer("speed", "block.b", "x", frame="base.a", bandwidth=40.0),
            ForceSensor("pull", "pad"),
        ),
        springs=(
            SpringDamper("stay", "base.a", "block.b", "x", 20.0, 3.0, frame="base.a"),
            Bushing("pad", "base.a", "block.b", np.arange(1.0, 7.0), np.arange(7.0, 13.0)),
        ),
    )
    text = " ".join(describe(scene).split())
    for line in (
        "force push: on block.b along (0.6, 0, 0.8) of block.b, by f [N]",
        "torque twist: on block.b about y, by t [N m]",
        "linear actuator leg: pushes base.a and block.b apart along their line, by l [N]",
        "ground acceleration floor: along z, by q [m/s2]",
        "encoder gap [m]: block.b against base.a along their line",
        "angle sensor angle [rad]: block.a against base.a about x of base.a",
        "pose pose [m], [rad]: block.a against base.a, along axes that rotate with base.a and are not the world's at",
        "vibrometer speed [m/s]: block.b along x of base.a",
        "sensor speed: low-pass of order 1 at 40 Hz",
        "force sensor pull [N]: the pull of pad",
        "spring stay: base.a to block.b along x of base.a, 20 N/m, 3 N s/m",
        "bushing pad: base.a to block.b, diagonal 1 2 3 4 5 6 N/m and N m/rad; damping 7 8 9 10 11 12 N s/m and",
    ):
        assert line in text


def test_stack_between_points_in_one_place():
    flat = FlexibleBody("strut", reduced(top=(0, 0, 0)))
    with pytest.raises(ValueError, match=r"its ends 'strut.bottom' and 'strut.top' lie in one place"):
        Scene("flat", (flat,), actuators=SCENE.actuators)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"mass": None}, "rigid body 'load' can move, so it needs a mass and an inertia"),
        ({"inertia": None}, r"needs a mass and an inertia \(or fixed=True\)"),
        ({"mass": 0.0}, "'load': mass must be positive, got 0 kg"),
        ({"mass": np.nan}, "'load': mass holds 1 value.* NaN"),
        ({"inertia": -np.eye(3)}, "'load': inertia must be symmetric and positive definite"),
        ({"inertia": np.triu(np.ones((3, 3))) + np.eye(3)}, "inertia must be symmetric"),
        ({"inertia": np.ones(3)}, "inertia must have shape 3 x 3, got 3"),
        ({"inertia": np.full((3, 3), np.nan)}, "inertia holds 9 value.* NaN"),
        ({"inertia": np.diag([1.0, 1.0, 2.01])}, "no body has the principal moments 1, 1, 2.01 kg m2"),
        ({"inertia": TURN @ np.diag([3.0, 1.0, 1.0]) @ TURN.T}, "no body has the principal moments"),
        ({"points": None}, "points must map names to positions"),
        ({"points": {"": (0, 0, 0)}}, "point names must be non-empty strings"),
        ({"fixed": "no"}, "fixed must be True or False, got 'no'"),
        ({"position": (0, 0, np.nan)}, "'load': position holds 1 value.* NaN"),
        ({"points": {"foot": (0, np.inf, 0)}}, "'load': point 'foot' holds 1 value.* infinite"),
    ],
)
def test_rigid_body_checks_itself(change, message):
    with pytest.raises(ValueError, match=message):
        replace(LOAD, **change)


def test_a_flat_plate_has_an_inertia_that_a_body_can_have():
    """Equality, to the digits that tables give."""
    assert replace(LOAD, inertia=np.diag([1.0, 1.33, 2.331])).mass == 5.0


def test_fixed_body_needs_no_mass():
    assert RigidBody("granite", {}, fixed=True).mass is None


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"fidelity": "magic"}, "unknown fidelity 'magic'; known: .*ffrf"),
        ({"frame": "side"}, "unknown remote point 'side'; known: bottom, top"),
        ({"reduced": LOAD}, "reduced must be a ReducedBody, got a RigidBody"),
        ({"rotation": 0.5 * np.eye(3)}, "'strut': rotation must be a proper orthogonal matrix"),
        ({"rotation": np.diag([1.0, 1.0, -1.0])}, "proper orthogonal"),
        ({"rotation": np.full((3, 3), np.nan)}, "rotation holds 9 value.* NaN"),
        ({"position": (0, 0)}, "'strut': position must have shape 3, got 2"),
        ({"angular_velocity": (0, 0, np.nan)}, "'strut': angular_velocity holds 1 value.* NaN"),
        ({"angular_velocity": (0, 0, 1.0), "fidelity": "linear"}, "'strut' spins, so it needs fidelity \"ffrf\" or"),
    ],
)
def test_flexible_body_checks_itself(change, message):
    with pytest.raises(ValueError, match=message):
        replace(STRUT, **change)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Joint("j", "a.b", "c.d", free=("x", "w")), "direction 'w'; known: x, y, z, rx, ry, rz"),
        (lambda: Encoder("e", "a.b", "c.d", axis="rz"), "unknown axis 'rz'; known: x, y, z"),
        (lambda: StackActuator("s", "a.b", "a.c", np.nan, "u"), "force_per_volt holds 1 value.* NaN"),
        (lambda: StackActuator("s", "a.b", "a.c", 1.0, "u", gain=np.inf), "gain holds 1 value.* infinite"),
        (lambda: Joint("j", "a.b", "c.d", free=None), "free must be a tuple of str, got NoneType"),
        (lambda: Joint("j", "a.b", "c.d", free=("x", "x")), "free direction names must differ"),
        (
            lambda: StackActuator("s", "a.b", "a.c", 1.0, "u", bandwidth="fast"),
            "bandwidth must be positive, got 'fast'",
        ),
        (lambda: VoltageSensor("s", "a.p", resistance=np.nan), "resistance must be positive, got nan Ohm"),
        (
            lambda: Loop("l", None, ("a",), ("b",)),
            "controller must be a Controller or a PythonController, got a NoneType",
        ),
        (lambda: replace(reduced(), remote_points=reduced().remote_points[:1] * 2), "used more than once: bottom"),
        (lambda: replace(reduced(), remote_points=("bottom", "top")), "remote_points must be of RemotePoint"),
        (lambda: FlexibleBody("s", replace(reduced(), remote_points=())), "needs at least one remote point"),
        (lambda: ReducedBody("s", remote_points=(), **NOTHING), "has no coordinates"),
        (lambda: replace(reduced(), mass_matrix=-np.eye(12)), "the diagonal of the mass matrix holds -1"),
        (lambda: StackSensor("s", "a.b", "a.c", np.nan), "voltage_per_elongation holds 1 value.* NaN"),
        (
            lambda: replace(reduced(), remote_points=(*reduced().remote_points, RemotePoint("more", "x", (0, 0, 1)))),
            "3 remote points need 18 coordinates, got 12",
        ),
        (lambda: Spring(RelativePose("a.b", "c.d"), np.ones(6)), "stiffness of a Spring must have shape 6 x 6, got 6"),
        (lambda: Spring(RATE, damping=np.nan), "damping of a Spring holds 1 value.* NaN"),
        (lambda: Spring(RATE, 1.0), "rates but no value, so that a spring cannot act on it: give a damping only"),
        (lambda: NonlinearSpring(RATE, force=np.add), "rates but no value, so that a spring cannot act on it: measure"),
        (lambda: Constraint("c", RATE), "constraint 'c': a PointVelocity has no value to hold"),
        (lambda: Output("o", "m", RelativePose("a.b", "c.d")), "RelativePose has the components x, y, z, rx, ry, rz"),
    ],
)
def test_connections_check_themselves(make, message):
    with pytest.raises(ValueError, match=message):
        make()


def test_a_turned_rigid_body_along_the_worlds_axes_is_the_same():
    """Turned about an odd axis by R: its points lie at R p, its inertia is R J R^T."""
    turn = Rotation.from_rotvec([0.4, -1.1, 0.7])
    inertia, arm = np.diag([1e-3, 2e-3, 2.5e-3]), np.array([0.1, -0.2, 0.05])
    body = RigidBody("a", {"p": arm}, 2.0, inertia, position=(1.0, 2.0, 3.0), rotation=turn.as_matrix())
    same = body.along_world
    np.testing.assert_allclose(same.points["p"], turn.apply(arm), atol=1e-15)
    np.testing.assert_allclose(same.inertia, turn.apply(turn.apply(inertia).T), atol=1e-18)
    np.testing.assert_array_equal(same.rotation, np.eye(3))
