"""Scenes placed in scenes: names, directions and matrices follow, whatever kinds of parts there are."""

import importlib
import re
from dataclasses import dataclass, field, fields, replace
from typing import get_args, get_origin, get_type_hints

import numpy as np
import pytest
from conftest import lattice
from scipy.spatial.transform import Rotation

import nassim
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
    RigidBody,
    Scene,
    SpringDamper,
    StackActuator,
    StackSensor,
    TimeHistory,
    craig_bampton,
    describe,
    frequency_response,
    joined,
    linearize,
    load,
    placed,
    register,
    revolute,
    save,
    simulate,
    static_response,
)
from nassim.base.file_registry import DATA_CLASSES, find
from nassim.base.rigid_motion import unit_vector
from nassim.scene import (
    AppliedForce,
    Axes,
    BaseAcceleration,
    BodyCoordinates,
    Constraint,
    Direction,
    Displacement,
    Distance,
    ForceElement,
    NonlinearSpring,
    Output,
    OutputFilter,
    Part,
    Path,
    PointVelocity,
    Position,
    PrescribedMotion,
    RelativePose,
    RotationAngle,
    Sensor,
    Shunt,
    Signal,
    Spring,
    SpringForce,
)
from nassim.scene.field_kinds import FieldKind
from nassim.systems import proportional

ODD = np.array([[2.0, -3.0, 6.0], [-6.0, 2.0, 3.0], [-3.0, -6.0, -2.0]]).T / 7
PLACE = np.array([0.3, -0.2, 0.1])
CROOKED = np.array([[6.0, 2.0, 3.0], [-3.0, 6.0, 2.0], [-2.0, -3.0, 6.0]]).T / 7
assert np.linalg.det(ODD) > 0
assert np.linalg.det(CROOKED) > 0


@pytest.fixture(scope="module")
def soft():
    return craig_bampton(lattice(stiffness=1e5), n_modes=2, progress=False)


def strut(body, fidelity="linear"):
    """A flexible body hinged to the ground, a mass at its end, and one part of every kind that needs no port."""
    right = CROOKED @ (body.point("right").position - body.point("left").position)
    ground = RigidBody("ground", {"o": np.zeros(3), "p": np.array([0.02, 0.03, -0.01])}, fixed=True, rotation=CROOKED)
    inertia = np.array([[3e-5, 4e-6, -2e-6], [4e-6, 4e-5, 5e-6], [-2e-6, 5e-6, 5e-5]])
    points = {"c": np.zeros(3), "m": -CROOKED.T @ np.array([0.004, 0.003, 0.006]), "n": np.array([0.01, 0.02, 0.03])}
    tip = RigidBody("tip", points, 0.1, inertia, right + np.array([0.004, 0.003, 0.006]), rotation=CROOKED)
    return Scene(
        "strut",
        (ground, FlexibleBody("apa", body, -CROOKED @ body.point("left").position, CROOKED, fidelity), tip),
        (revolute("hinge", "ground.o", "apa.left", (1, 2, -1)), Joint("weld", "apa.right", "tip.m")),
        (
            StackActuator("stacks", "apa.left", "apa.right", 3.0, "voltage"),
            PointForce("push", "tip.n", "y", "force"),
            PointForce("pull", "apa.right", (1, -2, 2), "pull", frame="apa.right"),
            PointTorque("twist", "tip.c", (0, 1, 1), "torque"),
            LinearActuator("leg", "ground.p", "tip.n", "leg"),
            GroundAcceleration("quake", "x", "quake"),
        ),
        (
            StackSensor("sensor", "apa.left", "apa.right", 1e4),
            Encoder("scale", "ground.o", "tip.n", "z"),
            Encoder("gap", "ground.p", "tip.n", "line"),
            Encoder("seen", "ground.p", "tip.n", (1, 2, 3), frame="apa.left"),
            AngleSensor("angle", "ground.o", "tip.c", "x"),
            Pose("pose", "apa.left", "tip.n", CROOKED),
        ),
        (
            SpringDamper("side", "ground.p", "tip.n", "x", 2e3, 1.0),
            SpringDamper("stay", "ground.p", "tip.m", "line", 3e3, 1.0),
            SpringDamper("rider", "apa.left", "tip.n", (3, 1, 0), 4e3, 0.5, frame="apa.left"),
            Bushing("pad", "ground.p", "apa.right", [1e3, 2e3, 3e3, 1.0, 2.0, 3.0], np.full(6, 1e-2), CROOKED),
        ),
        damping_ratio=0.02,
    )


def named(name, names):
    return tuple(f"{name}/{other}" for other in names)


def test_a_placed_scene_answers_as_the_original(soft):
    """Whatever it is made of: the same poles and responses, from inputs to outputs of the same names behind a "/"."""
    scene = strut(soft)
    copy = placed(placed(scene, "leg", position=PLACE, rotation=ODD), "left", position=-PLACE, rotation=CROOKED)
    assert copy.inputs == named("left/leg", scene.inputs)
    assert copy.outputs == named("left/leg", scene.outputs)
    assert [body.name for body in copy.bodies] == ["left/leg/ground", "left/leg/apa", "left/leg/tip"]
    assert copy.flexible_bodies[0].reduced is soft
    for point in ("apa.right", "tip.n", "ground.p"):
        expected = CROOKED @ (PLACE + ODD @ scene.point_position(point)) - PLACE
        np.testing.assert_allclose(copy.point_position(f"left/leg/{point}"), expected, atol=1e-15)
    frequency = np.geomspace(1.0, 3e3, 50)
    expected, found = (frequency_response(linearize(s), frequency).values for s in (scene, copy))
    scale = np.abs(expected).max(axis=2, keepdims=True) + 1e-12 * np.abs(expected).max()
    np.testing.assert_allclose(found / scale, expected / scale, rtol=0, atol=1e-9)
    assert "left/leg/apa" in describe(copy)


def unfolded(text):
    return re.sub(r"\n {6,}", " ", text)


def test_a_summary_tells_scenes_that_read_the_same_once(soft):
    """Not one that lacks a signal, and not one with another spring."""
    scene = replace(strut(soft), springs=strut(soft).springs[1::2])
    lacking = placed(replace(scene, sensors=scene.sensors[1:]), "a", position=-PLACE)
    side = placed(replace(scene, springs=strut(soft).springs[:1]), "c", rotation=ODD)
    pair = placed(joined("pair", placed(scene, "a"), placed(scene, "b", position=PLACE)), "arm")
    first, *lines = unfolded(describe(joined("four", pair, lacking, side))).splitlines()
    assert "arm/a/voltage (x 2), arm/a/force (x 2), " in first
    assert "arm/a/pose.rz (x 2), a/scale, " in first
    assert "arm/b" not in first
    assert lines[0] == "  arm/a/, and the same again arm/b/:"
    alone = unfolded(describe(scene)).splitlines()[1:-2]
    assert lines[1 : 1 + len(alone)] == [f"  {line}" for line in alone]
    assert [line for line in lines[1 + len(alone) :] if "weld" in line] == [
        "  joint a/weld: a/apa.right to a/tip.m, rigid",
        "  joint c/weld: c/apa.right to c/tip.m, rigid",
    ]


def test_turned_directions_are_those_of_the_world_turned(soft):
    """A placed strut against the same one with all its directions turned by hand, so that no error cancels."""
    copy = placed(strut(soft), "a", rotation=ODD)
    world = replace(
        copy,
        actuators=(PointForce("f", "a/tip.n", ODD[:, 1], "f"), GroundAcceleration("g", ODD[:, 0], "g")),
        sensors=(
            Encoder("e", "a/ground.o", "a/tip.n", ODD[:, 2]),
            AngleSensor("r", "a/ground.o", "a/tip.c", ODD[:, 0]),
        ),
    )
    frequency = np.geomspace(1.0, 3e3, 20)
    expected, found = (frequency_response(linearize(s), frequency) for s in (world, copy))
    for y, other in (("a/scale", "e"), ("a/angle", "r")):
        for u, own in (("a/force", "f"), ("a/quake", "g")):
            np.testing.assert_allclose(found.response(y, u), expected.response(other, own), rtol=1e-9)


def test_gravity_stays_the_worlds_and_velocities_turn(soft):
    spinning = replace(strut(soft).bodies[1], fidelity="ffrf", angular_velocity=np.array([1.0, 2.0, 3.0]))
    scene = Scene("free", (spinning,), gravity=np.array([0, 0, -9.81]))
    copy = placed(scene, "b", position=PLACE, rotation=ODD)
    np.testing.assert_array_equal(copy.gravity, scene.gravity)
    np.testing.assert_allclose(copy.bodies[0].angular_velocity, ODD @ [1, 2, 3], rtol=1e-14)
    np.testing.assert_allclose(copy.bodies[0].rotation, ODD @ CROOKED, atol=1e-14)


def test_loops_are_placed(soft):
    """Two placed copies, each with its own digital loop, do what the one does."""
    loop = Loop("damper", proportional([[-40.0]], sample_rate=1e4), ("scale",), ("force",))
    scene = replace(strut(soft), loops=(loop,), actuators=strut(soft).actuators[:2], sensors=strut(soft).sensors[:2])
    both = joined("both", placed(scene, "a", rotation=ODD), placed(scene, "b", position=PLACE))
    assert both.loops[1].measured == ("b/scale",)
    records = {}
    for s, prefix in ((scene, ""), (both, "a/"), (both, "b/")):
        names = tuple(name for name in s.inputs if name.endswith("voltage"))
        time = np.arange(100) * 1e-4
        values = np.array([np.sin(300 * time) * (name == f"{prefix}voltage") for name in names])
        push = TimeHistory(time, values, names, ("V",) * len(names))
        records[prefix] = simulate(s, push, time_step=1e-4, method="exact", progress=False)
    for prefix in ("a/", "b/"):
        for name in ("scale", "damper"):
            expected = records[""][name]
            np.testing.assert_allclose(records[prefix][prefix + name], expected, atol=1e-9 * np.abs(expected).max())


def test_drives_are_placed(soft):
    """A motor in the copy's own joint, beside the original, which stands still meanwhile."""
    scene = replace(strut(soft, "ffrf"), actuators=(Drive("motor", "hinge", "rz", "way"),), damping_ratio=0.0)
    both = joined("both", scene, placed(scene, "a", position=PLACE, rotation=ODD))
    time = np.arange(41) * 1e-3
    way, still = 0.02 * np.sin(np.pi * time / 0.08) ** 2, 0 * time

    def run(of, *ways):
        push = TimeHistory(time, np.array(ways), of.inputs, ("rad",) * len(ways))
        return simulate(of, push, time_step=1e-3, outputs=of.outputs, progress=False)

    alone, found = run(scene, way), run(both, still, way)
    for name in ("scale", "gap", "seen"):
        size = np.abs(alone[name]).max()
        assert size > 1e-5
        np.testing.assert_allclose(found[f"a/{name}"], alone[name], rtol=0, atol=1e-4 * size)
        assert np.abs(found[name]).max() < 1e-6 * size


def test_placed_scenes_are_saved(soft, tmp_path):
    copy = placed(strut(soft), "a", position=PLACE, rotation=ODD)
    save(copy, tmp_path / "a.h5")
    again = load(tmp_path / "a.h5")
    assert again.outputs == copy.outputs
    np.testing.assert_array_equal(again.bodies[1].rotation, copy.bodies[1].rotation)


@register
@dataclass(frozen=True)
class Tripod(ForceElement):
    """A user's kind: springs from one point to several others, one of them along a given direction, and a hinge."""

    name: str
    hub: Path
    feet: tuple[Path, ...]
    pulls: tuple[tuple[Path, Direction], ...]
    hinge: tuple[Path, Path]
    input: Signal | None
    axes: Axes | None = None
    kind: str = "soft"

    def terms(self, scene):
        terms = [nassim.scene.Spring(nassim.scene.Distance(self.hub, foot), 1e3) for foot in self.feet]
        terms += [
            nassim.scene.Spring(Displacement.between(self.hub, p, unit_vector(axis)), 2e3) for p, axis in self.pulls
        ]
        terms.append(AppliedForce(self.input, "N", Displacement(((self.hub, self.axes[:, 1]),))))
        axes = nassim.base.rigid_motion.axes_along(self.axes[:, 0])
        terms.append(Constraint(self.name, RelativePose(*self.hinge, axes, "matrix"), ("rz",)))
        return tuple(terms)


@pytest.mark.filterwarnings("ignore:Tripod .* acts at two points")  # its directions are any, and so have arms
def test_a_users_kind_is_placed_by_its_annotations(soft):
    pulls = (("ground.p", "x"), ("apa.right", (1, 1, 0)))
    tripod = Tripod("t", "tip.n", ("ground.o", "ground.p"), pulls, ("ground.o", "tip.m"), "u", ODD)
    scene = replace(strut(soft), springs=(tripod,))
    copy = placed(scene, "a", position=PLACE, rotation=ODD)
    found = copy.springs[0]
    assert (found.hub, found.feet, found.input) == ("a/tip.n", ("a/ground.o", "a/ground.p"), "a/u")
    assert found.kind == "soft"
    np.testing.assert_allclose(found.pulls[1][1], ODD @ [1, 1, 0], rtol=1e-14)
    frequency = np.geomspace(1.0, 3e3, 20)
    expected, answer = (frequency_response(linearize(s), frequency).values for s in (scene, copy))
    np.testing.assert_allclose(answer, expected, rtol=1e-7, atol=1e-9 * np.abs(expected).max(axis=2).min())


@dataclass(frozen=True)
class Careless(Sensor):
    """A user's kind of which the test says how its fields are annotated."""

    name: str
    point: Path
    axis: tuple[float, ...]

    def terms(self, scene):
        return (Output(self.name, "m", Displacement(((self.point, np.array(self.axis)),))),)


@dataclass(frozen=True)
class Nameless(Careless):
    """It names its point without saying so."""

    point: str
    axis: Direction


@dataclass(frozen=True)
class Shared(Sensor):
    """Its output would have one name in all copies."""

    name: str
    point: Path

    def terms(self, scene):
        return (Output("height", "m", Displacement(((self.point, np.array([0, 0, 1.0])),))),)


@dataclass(frozen=True)
class Sleeve(ForceElement):
    """Equally soft in all directions across its axis; the directions are any that it finds in the world."""

    name: str
    a: Path
    b: Path
    axis: Direction

    def terms(self, scene):
        along = unit_vector(self.axis)
        across = unit_vector(np.cross(along, np.eye(3)[np.argmin(np.abs(along))]))
        axes = np.column_stack([along, across, np.cross(along, across)])
        return (Spring(RelativePose(self.a, self.b, axes), np.diag([9e3, 2e3, 2e3, 7.0, 3.0, 3.0]), np.zeros((6, 6))),)


def test_a_bushing_may_find_axes_of_its_own_in_each_place(soft):
    """What counts is its stiffness along the axes of the world."""
    scene = replace(strut(soft), springs=(Sleeve("sleeve", "ground.p", "tip.n", (1.0, 2.0, -2.0)),))
    copy = placed(scene, "a", position=PLACE, rotation=ODD)
    frequency = np.geomspace(1.0, 3e3, 20)
    expected, answer = (frequency_response(linearize(s), frequency).values for s in (scene, copy))
    np.testing.assert_allclose(answer, expected, rtol=1e-7, atol=1e-9 * np.abs(expected).max(axis=2).min())


def test_a_users_kind_without_annotations_is_refused(soft):
    """What would be a silent error in the copy: a direction that stays, a point of the original, a shared signal."""
    scene = strut(soft)
    axis = (1.0, 2.0, 3.0)
    for sensor in (Careless("c", "tip.n", axis), Nameless("c", "tip.n", axis), Shared("c", "tip.n")):
        bad = replace(scene, sensors=(sensor,))
        with pytest.raises(ValueError, match=r"cannot be placed.*Path, Signal, Direction, Axes") as refused:
            placed(bad, "a", rotation=ODD)
        cure = re.search(r"annotation: (.*) of (\S+)$", str(refused.value))
        assert all(hasattr(importlib.import_module(cure[2]), kind) for kind in cure[1].split(", "))
    straight = placed(replace(scene, sensors=(Careless("c", "tip.n", axis),)), "a", position=PLACE)
    assert straight.sensors[0].point == "a/tip.n"
    # A summary does not describe such a sensor, but it tells its signal.
    other = placed(replace(scene, sensors=()), "b", position=-PLACE)
    assert "the same again" not in describe(joined("two", straight, other))


@dataclass(frozen=True)
class Rope(ForceElement):
    """As stiff as it is short, which rounding makes another in every place; its type is there for checkers only."""

    name: str
    a: Path
    b: Path
    tie: "Missing | None" = None  # noqa: F821

    def terms(self, scene):
        length = np.linalg.norm(scene.point_position(self.b) - scene.point_position(self.a))
        return (nassim.scene.Spring(nassim.scene.Distance(self.a, self.b), 1e5 / length),)


def test_types_must_be_there_when_a_kind_is_placed(soft, monkeypatch):
    scene = replace(strut(soft), springs=(Rope("r", "ground.p", "tip.n"),))
    with pytest.raises(ValueError, match=r"Rope cannot be placed: .*Missing.*; import them for running"):
        placed(scene, "a", rotation=ODD)
    monkeypatch.setitem(globals(), "Missing", str)
    assert placed(scene, "a", rotation=ODD).springs[0].b == "a/tip.n"


ALL_TERMS = (
    *(AppliedForce, BaseAcceleration, Constraint, NonlinearSpring, Output, OutputFilter, PrescribedMotion, Shunt),
    *(Spring, SpringForce, Displacement, PointVelocity, Distance, RotationAngle, RelativePose, BodyCoordinates),
)
KINDS = [noun for noun in map(find, DATA_CLASSES) if issubclass(noun, (Part, Loop, RigidBody, FlexibleBody))]
PLAIN_TEXT = {
    "name",
    "unit",
    "fidelity",
    "frame",
    "free",
    "held",
    "direction",
    "component",
    "rotation",
    "constraint",
    "passes",
}
"""Texts that are no points and no signals, "frame" of a flexible body being a remote point's bare name."""


VECTORS = ("axis", "axes", "direction", "position", "rotation", "angular_velocity", "normal")


def test_texts_and_vectors_of_every_kind_are_annotated():
    """A new kind of part in nassim can be placed."""
    for part in (*KINDS, *ALL_TERMS):
        hints = {name: getattr(kind, "held", kind) for name, kind in get_type_hints(part).items()}
        for f in fields(part):
            kind = get_args(hints[f.name])[0] if get_origin(hints[f.name]) is tuple else hints[f.name]
            assert kind is not str or f.name in PLAIN_TEXT, f"annotate {part.__name__}.{f.name}"
            if kind is not str and f.name in VECTORS:
                assert isinstance(kind, FieldKind), f"annotate {part.__name__}.{f.name}"


@pytest.mark.parametrize(("name", "message"), [("", "^placed scene names must be non-empty"), ("a.b", "no dot")])
def test_names_of_placed_scenes(soft, name, message):
    with pytest.raises(ValueError, match=message):
        placed(strut(soft), name)


def test_what_is_no_place_is_refused(soft):
    with pytest.raises(ValueError, match="scene 'a': rotation must be a proper"):
        placed(strut(soft), "a", rotation=np.diag([1.0, 1.0, -1.0]))
    with pytest.raises(ValueError, match="scene 'a': position must have shape 3"):
        placed(strut(soft), "a", position=(0, 0))


def test_joined_scenes_have_names_and_figures_of_their_own(soft):
    scene = strut(soft)
    a, b = placed(scene, "a"), placed(scene, "b", position=PLACE)
    with pytest.raises(ValueError, match=r"'strut' and 'strut' both have 'ground' among their bodies.*placed"):
        joined("whole", scene, scene)
    with pytest.raises(ValueError, match="'b' and 'whole' both have 'b/hinge' among their joints"):
        joined("whole", a, b, joints=(revolute("b/hinge", "a/ground.o", "b/apa.left"),))
    force = PointForce("other", "a/tip.n", "x", "b/force")
    with pytest.raises(ValueError, match="both have 'b/force' among their inputs"):
        joined("whole", replace(a, actuators=(force,)), b)
    assert joined("whole", a, b, actuators=(force,)).inputs == a.inputs + b.inputs  # named on purpose
    with pytest.raises(ValueError, match="at least one scene"):
        joined("whole")
    with pytest.raises(ValueError, match=r"joints must be a tuple of Connection, got Joint; write \(part,\)"):
        joined("whole", a, joints=Joint("j", "a/tip.n", "a/tip.n"))


@pytest.mark.parametrize(
    ("figure", "other", "given"),
    [("damping_ratio", 0.5, 0.0), ("gravity", np.array([0, 0, -9.81]), np.zeros(3)), ("cutoff_frequency", 1e3, 2e3)],
)
def test_joined_scenes_agree_or_are_told(soft, figure, other, given):
    a, b = placed(strut(soft), "a"), placed(replace(strut(soft), **{figure: other}), "b", position=PLACE)
    own, others = (re.escape(str(getattr(scene, figure))) for scene in (a, b))
    with pytest.raises(ValueError, match=f"{figure} is {own} in 'a' and {others} in 'b'; .*{figure}=..."):
        joined("whole", a, b)
    for value in (other, given):
        np.testing.assert_array_equal(getattr(joined("whole", a, b, **{figure: value}), figure), value)
    np.testing.assert_array_equal(getattr(joined("whole", b), figure), other)


def test_ratios_by_mode_belong_to_a_part(soft):
    by_mode = placed(replace(strut(soft), damping_ratio=[0.01, 0.02]), "a")
    for scenes in ((by_mode,), (placed(strut(soft), "b", position=PLACE), by_mode)):
        with pytest.raises(ValueError, match="ratios by mode"):
            joined("whole", *scenes)
    assert joined("whole", by_mode, damping_ratio=0.03).damping_ratio == 0.03


def apart(gap, axes=ODD):
    """Two bodies whose points lie apart by a gap [m], in a direction that is none of the world's."""
    base = RigidBody("base", {"p": (0.1, -0.2, 0.3)}, fixed=True)
    block = RigidBody("block", {"p": np.zeros(3)}, 1.0, np.eye(3), base.points["p"] + gap * np.array([0.36, 0.48, 0.8]))
    return Scene("gap", (base, block), (Joint("rail", "base.p", "block.p", "x", axes),))


def test_a_joint_that_is_accepted_is_accepted_wherever_it_is_placed():
    """Rounding of places metres away makes a gap at the tolerance larger or smaller."""
    turns = Rotation.random(30, random_state=1).as_matrix()
    for k, turn in enumerate(turns):
        copy = placed(apart(1e-9), "copy", position=30.0 * turns[-k - 1][0], rotation=turn)
        placed(copy, "again", position=-copy.bodies[0].point_position("p"))
    with pytest.raises(ValueError, match=r"are 1\.1e-09 m apart; they must coincide to 1e-09 m"):
        apart(1.1e-9)
    with pytest.raises(
        ValueError, match=r"add \(-0.0036, -0.0048, -0.008\) m to the position of 'block', or move 'base'"
    ):
        apart(0.01)
    # Axes typed with nine digits, in a scene that is turned by a matrix of as many.
    rough = ODD @ (np.eye(3) + 0.45e-9 * np.diag([1, -1, 1]))
    np.testing.assert_allclose(placed(apart(0.0, rough), "copy", rotation=rough).joints[0].axes, ODD @ ODD, atol=1e-9)


@dataclass(frozen=True)
class Buffer(ForceElement):
    """A spring along a direction that resists pressure only; `into` shifts it to where it begins."""

    name: str
    a: Path
    b: Path
    axis: Direction
    into: float = 0.0

    def terms(self, scene):
        along = Displacement.between(self.a, self.b, np.array(self.axis))
        return (NonlinearSpring(along, force=lambda value, _: -5e3 * np.maximum(self.into - value, 0.0)),)


@dataclass(frozen=True)
class Wind(ForceElement):
    """A law of a part's own that knows where it stands in the world."""

    name: str
    a: Path
    b: Path
    place: Position = field(default_factory=lambda: np.zeros(3))

    def terms(self, scene):
        law = NonlinearSpring(RelativePose(self.a, self.b, np.eye(3)), force=lambda v, _: (1 + self.place[0]) * v)
        return (law,)


@dataclass(frozen=True)
class Fence(Wind):
    """A part with one spring more far from where it was drawn."""

    def terms(self, scene):
        spring = Spring(RelativePose(self.a, self.b, np.eye(3)), 1.0)
        return (spring,) * (1 if np.linalg.norm(self.place) < 0.5 else 2)


def preloaded(*springs):
    """A block on a mount with a preload, along axes of its own."""
    ground = RigidBody("ground", {"o": np.zeros(3), "p": np.array([0.1, 0.2, -0.1])}, fixed=True)
    block = RigidBody("block", {"o": np.zeros(3), "p": np.array([0.02, -0.01, 0.03])}, 0.5, 1e-3 * np.eye(3))
    preload = np.array([3.0, -4.0, 2.0, 0.02, -0.01, 0.03])
    mount = Bushing("mount", "ground.o", "block.o", [3e3, 4e3, 5e3, 8.0, 9.0, 7.0], axes=CROOKED, preload=preload)
    stay = SpringDamper("stay", "ground.p", "block.p", "line", 2e3, 1.0, preload=-3.0)
    rider = SpringDamper("rider", "ground.p", "block.p", (1, 2, 3), 1e3, frame="block.p", preload=2.0)
    sensors = (Pose("pose", "ground.o", "block.p", CROOKED), ForceSensor("pad", "mount"), ForceSensor("pull", "stay"))
    return Scene("preloaded", (ground, block), (), (), sensors, (mount, stay, rider, *springs), damping_ratio=0.0)


def test_preloads_and_laws_of_their_own_are_placed_too():
    """Their functions are new ones in the copy, with the same values."""
    scene = preloaded(Buffer("buffer", "ground.p", "block.p", (0.6, 0.0, 0.8), into=1e-3))
    expected = static_response(scene)
    found = static_response(placed(scene, "there", position=PLACE, rotation=ODD))
    for name, value in expected.items():
        assert found[f"there/{name}"] == pytest.approx(value, rel=1e-7, abs=1e-9)


def test_a_law_that_knows_the_world_is_not_placed():
    for kind in (Wind, Fence):
        scene = preloaded(kind("wind", "ground.o", "block.o"))
        placed(scene, "here")
        for turned in ({"rotation": ODD}, {}):
            with pytest.raises(ValueError, match=f"{kind.__name__} 'wind' cannot be placed"):
                placed(scene, "there", position=(1.0, 0, 0), **turned)
