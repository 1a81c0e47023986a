"""What every optional argument of scenes and their parts does, in general positions."""

from dataclasses import dataclass, replace
from functools import cache, partial

import numpy as np
import pytest
from arguments import assert_all_tried, is_now, table
from conftest import assert_limit, lattice
from scipy.spatial.transform import Rotation

import nassim.scene
from nassim import TimeHistory, craig_bampton, frequency_response, linearize, simulate
from nassim.bodies.piezo import PortCoupling
from nassim.scene import (
    Accelerometer,
    AngleSensor,
    AppliedForce,
    BodyCoordinates,
    Bushing,
    CircuitState,
    Constraint,
    Displacement,
    Drive,
    Encoder,
    Feedthrough,
    FlexibleBody,
    Geophone,
    GroundAcceleration,
    Joint,
    Loop,
    NonlinearSpring,
    Output,
    OutputFilter,
    PointForce,
    PointTorque,
    PointVelocity,
    Pose,
    PrescribedMotion,
    RelativePose,
    RigidBody,
    RotationAngle,
    RotationDeviation,
    Scene,
    Sensor,
    Spring,
    SpringDamper,
    SpringForce,
    StackActuator,
    Vibrometer,
    VoltageDrive,
    VoltageSensor,
    cylindrical,
    fixed,
    joined,
    placed,
    planar,
    prismatic,
    revolute,
    spherical,
    universal,
)
from nassim.systems import proportional

SKEWED = Rotation.from_rotvec([0.7, -0.4, 1.2]).as_matrix()
TURN = Rotation.from_rotvec([-0.3, 0.9, 0.2]).as_matrix()
NORMAL = np.array([1.0, 2.0, -2.0]) / 3
ACROSS = np.array([2.0, 1.0, 2.0]) / 3
UPRIGHT = np.eye(3)
PLACE, SHIFT = np.array([0.3, -0.2, 0.5]), np.array([0.04, 0.02, -0.01])
A, B = np.array([0.1, 0.2, -0.1]), np.array([0.05, -0.03, 0.08])
INERTIA = np.diag([2e-3, 3e-3, 4e-3])
SIX, OTHERS = np.array([1e4, 2e4, 3e4, 10.0, 20.0, 30.0]), np.array([6.0, 5.0, 4.0, 0.3, 0.2, 0.1])
Z = np.array([0.0, 0.0, 1.0])
MASS, STIFFNESS, DAMPING = 2.0, 3e4, 40.0
F = np.array([3.0, 17.0, 40.0])
S = 2j * np.pi * F
COMPLIANCE = 1 / (STIFFNESS + DAMPING * S + MASS * S**2)

GROUND = RigidBody("ground", {"a": A, "p": PLACE + B}, fixed=True)
BODY = RigidBody("body", {"p": B}, MASS, INERTIA, PLACE)
PLAIN = Scene("plain", (GROUND, BODY))
SLIDE = Scene(
    "slide",
    (GROUND, BODY),
    (prismatic("guide", "ground.p", "body.p", NORMAL),),
    (PointForce("push", "body.p", NORMAL, "push"), GroundAcceleration("shake", ACROSS, "shake")),
    (Encoder("way", "ground.p", "body.p", NORMAL),),
    (SpringDamper("spring", "ground.p", "body.p", NORMAL, STIFFNESS, DAMPING),),
    damping_ratio=0.0,
)
ALONG = Displacement.between("ground.p", "body.p", NORMAL)


@dataclass(frozen=True)
class Given(Sensor):
    """A part of given terms."""

    of: tuple = ()

    def terms(self, scene):
        """The given ones."""
        return self.of


def with_terms(*terms, **changes):
    return replace(SLIDE, sensors=(Given("given", terms),), **changes)


def response(scene, input="push", output="way"):
    return frequency_response(linearize(scene), F).response(output, input)


@cache
def bar():
    return craig_bampton(lattice(), n_modes=1, progress=False)


@cache
def ported():
    """A body with an electrical port of a microfarad."""
    port = PortCoupling("port", np.linspace(1.0, 2.0, len(bar().mass_matrix)), 1e-6)
    return Scene("ported", (GROUND, FlexibleBody("bar", replace(bar(), readouts={**bar().readouts, "port": port}))))


def piezo(kind, *arguments):
    """Terms of a part at that body, by its options."""
    return lambda **options: kind("part", *arguments, **options).terms(ported())


def moved(measure):
    """Value and rows of a measure where the body has moved by SHIFT and turned by TURN about its centre."""
    reference = [PLAIN.point_position(path) for path in measure.points]
    poses = [
        (PLACE + SHIFT + TURN @ (point - PLACE), TURN) if path.startswith("body") else (point, np.eye(3))
        for path, point in zip(measure.points, reference, strict=True)
    ]
    return measure.at(poses, reference)


def rows(*which):
    """What a term is along, where the body has moved: of its measure's rows on the points' velocities."""
    return lambda terms: moved(terms[0].measure)[1][0, slice(*which)]


def value(terms):
    return moved(terms[0].measure)[0]


TO = PLACE + SHIFT + TURN @ B
"""Where the body's point is then."""


def along(axis, turn=UPRIGHT):
    """Displacement of the body's point against the ground's one along an axis that turns or does not."""
    return (TO - A) @ turn @ axis - (PLACE + B - A) @ axis


def angle_about(axis, turn=TURN):
    """Twice the arc tangent of the quaternion's component along the axis over its scalar."""
    *v, c = Rotation.from_matrix(turn).as_quat()
    return 2 * np.arctan2(np.dot(v, axis), c)


def deviations(direction, axis, turn=TURN):
    """Rotation that is left where its twist about an axis is taken off before it, and after it."""
    whole, twist = Rotation.from_matrix(turn), Rotation.from_rotvec(angle_about(axis, turn) * axis)
    return [left.as_rotvec() @ direction for left in (twist.inv() * whole, whole * twist.inv())]


def are(*expected):
    return lambda *found: all(
        np.allclose(one, other, rtol=1e-9, atol=1e-12) for one, other in zip(found, expected, strict=True)
    )


def shows(of_result, *expected):
    return lambda *found: are(*expected)(*map(of_result, found))


def reads(name):
    """The value of a first term's field."""
    return lambda terms: getattr(terms[0], name)


def own(name):
    return lambda result: getattr(result, name)


def has(*filters):
    return lambda before, after: before[1:] == () and after[1:] == filters


def free(joint):
    """Projector on the directions in which a joint leaves its second point free, and its dampers' matrix."""
    twice = np.kron(np.eye(2), joint.axes)
    columns = twice[:, [("x", "y", "z", "rx", "ry", "rz").index(d) for d in joint.free]]
    return columns @ columns.T


def freedom(*directions):
    """Projector on displacements along, and rotations about, vectors."""
    return sum((np.outer(d, d) for d in map(np.array, directions)), np.zeros((6, 6)))


def damped(*figures):
    """Whether a joint gets dampers of these figures and had none."""

    def law(before, after):
        return [len(one.terms(PLAIN)) for one in (before, after)] == [1, 1 + len(figures)] and np.allclose(
            [term.damping for term in after.terms(PLAIN)[1:]], figures
        )

    return law


def poses_at(rotation):
    """Six components of the body's pose in a parametrisation."""
    vector = Rotation.from_matrix(TURN).as_rotvec()
    entries = np.array([-TURN[1, 2], TURN[0, 2], -TURN[0, 1]])
    return {"vector": vector, "matrix": entries}[rotation]


def stuck(**options):
    """The slide, with what holds it given as a constraint."""
    return response(with_terms(Output("y", "m", ALONG), Constraint("hold", ALONG, **options)), output="y")


def driven(**options):
    """The slide on a servo in place of its spring."""
    return with_terms(
        Output("y", "m", ALONG),
        PrescribedMotion("guide", "z", options.pop("input", "way in"), "m", **options),
        springs=(),
        actuators=(),
    )


def at_speed(**options):
    idle = TimeHistory(1e-3 * np.arange(6), np.zeros((1, 6)), ("push",), ("N",))
    scene = replace(driven(input="", **options), actuators=(PointForce("push", "body.p", ACROSS, "push"),))
    return simulate(scene, idle, time_step=1e-3, progress=False)["y"]


def element(**options):
    return SpringDamper("s", "ground.a", "body.p", stiffness=1e3, **options).terms(PLAIN)


def force(terms):
    """What resists where the value is one millimetre and the rate is two, or these times one to six."""
    size = len(terms[0].measure.components)
    return terms[0].resistance(1e-3 * np.arange(1, size + 1), 2e-3 * np.arange(1, size + 1))


ONE_TO_SIX = np.arange(1.0, 7.0)


def part(kind, *arguments, **given):
    """Terms of a part by its options."""
    return lambda **options: kind("part", *arguments, **given, **options).terms(PLAIN)


def whole(**options):
    return Scene("scene", (GROUND, BODY), **options)


def both(**options):
    pair = (placed(whole(**AGREED), "one"), placed(whole(**AGREED), "two", position=ACROSS))
    return joined("both", *pair, **options)


AGREED = {
    "damping_ratio": 0.03,
    "gravity": np.array([0.0, 1.0, -9.0]),
    "cutoff_frequency": 300.0,
    "quasi_static_above": 400.0,
}
EXTRA = {
    "joints": (fixed("clamp", "ground.p", "body.p"),),
    "actuators": (PointForce("push", "body.p", "x", "push"),),
    "sensors": (Encoder("way", "ground.p", "body.p"),),
    "springs": (SpringDamper("spring", "ground.p", "body.p", "x", 1.0),),
}
IDLE = (Loop("idle", proportional(1.0, sample_rate=1e4), "way", "push"),)


def at_one(parts):
    """The same parts at the first of two copies."""
    there = {"a": "one/ground.p", "b": "one/body.p", "point": "one/body.p"}
    return tuple(replace(one, **{k: v for k, v in there.items() if hasattr(one, k)}) for one in parts)


def adds(kind, name):
    return lambda before, after: (
        [one.name for one in getattr(after, kind)] == [*(one.name for one in getattr(before, kind)), name]
    )


POINTS = ("ground.a", "body.p")
TOUCHING = ("ground.p", "body.p")
HALF = np.eye(3)[:, [1, 2, 0]]
CALLS = {
    "RigidBody": partial(RigidBody, "body", {"p": B}, MASS, INERTIA),
    "FlexibleBody": lambda **options: FlexibleBody("bar", bar(), **options),
    "Vibrometer": part(Vibrometer, "body.p"),
    "Geophone": part(Geophone, "body.p"),
    "Accelerometer": part(Accelerometer, "body.p"),
    "Joint": partial(Joint, "joint", *TOUCHING),
    "revolute": partial(revolute, "joint", *TOUCHING),
    "prismatic": partial(prismatic, "joint", *TOUCHING),
    "cylindrical": partial(cylindrical, "joint", *TOUCHING),
    "universal": partial(universal, "joint", *TOUCHING, NORMAL, ACROSS),
    "spherical": partial(spherical, "joint", *TOUCHING),
    "planar": partial(planar, "joint", *TOUCHING),
    "Loop": partial(Loop, "loop", proportional(1.0, sample_rate=1e4), "y", "u"),
    "Displacement": lambda **options: moved(Displacement((("body.p", NORMAL),), **options)),
    "between": lambda **options: moved(Displacement.between(*POINTS, NORMAL, **options)),
    "PointVelocity": lambda **options: moved(PointVelocity((("body.p", NORMAL),), **options)),
    "RotationAngle": lambda **options: moved(RotationAngle("ground.a", NORMAL, **options)),
    "RotationDeviation": lambda **options: moved(RotationDeviation(*POINTS, NORMAL, *POINTS, 3 * ACROSS, **options)),
    "RelativePose": lambda **options: moved(RelativePose("ground.p", "body.p", **options))[0],
    "BodyCoordinates": lambda **options: BodyCoordinates("bar", np.ones(3), **options),
    "SpringDamper": element,
    "Bushing": part(Bushing, *POINTS, SIX),
    "PointForce": part(PointForce, "body.p", NORMAL, "u"),
    "PointTorque": part(PointTorque, "body.p", NORMAL, "u"),
    "Encoder": part(Encoder, *POINTS),
    "AngleSensor": part(AngleSensor, *POINTS),
    "Pose": part(Pose, *POINTS),
    "StackActuator": piezo(StackActuator, "bar.left", "bar.right", 5.0, "u"),
    "VoltageDrive": piezo(VoltageDrive, "bar.port", "u"),
    "VoltageSensor": piezo(VoltageSensor, "bar.port"),
    "placed": partial(placed, SLIDE, "new"),
    "joined": both,
    "Scene": whole,
    "AppliedForce": lambda **options: response(with_terms(Output("y", "m", ALONG), pushing(**options)), "u", "y"),
    "Output": lambda **options: response(with_terms(Output("y", "m", ALONG, **options)), "shake", "y"),
    "CircuitState": partial(CircuitState, "y", "coil"),
    "Feedthrough": lambda **options: response(
        with_terms(Output("y", "m", ALONG), pushing(), Feedthrough("y", "u", **options)), "u", "y"
    ),
    "Spring": partial(Spring, ALONG),
    "NonlinearSpring": lambda **options: np.ravel(
        NonlinearSpring(ALONG, force=lambda x, v: 5e3 * x**3 + 2 * v, **options).tangents(
            np.array([0.2]), np.array([0.3])
        )
    ),
    "SpringForce": partial(SpringForce, "y", "N", SpringDamper("s", *POINTS, stiffness=1.0).terms(PLAIN)[0]),
    "OutputFilter": lambda **options: response(
        with_terms(Output("y", "m", ALONG), OutputFilter("y", "low", 20.0, **options)), output="y"
    ),
    "Constraint": stuck,
    "PrescribedMotion": lambda **options: frequency_response(linearize(driven(**options)), F).values[0, 0],
}


def cubic(value, rate):
    return 5e3 * value**3 + 2 * rate


def pushing(**options):
    return AppliedForce("u", "N", PointVelocity((("body.p", NORMAL),)), **options)


LAG = 1 / (1 + 1j * F / 20.0)
SHAKEN = -MASS * NORMAL @ ACROSS * COMPLIANCE
SOFT = np.array([4.0, 0.0, 0.0, 0.0, 0.0, 0.0])
ARGUMENTS = table(
    CALLS,
    [
        ("RigidBody", "position", np.zeros(3), PLACE, shows(lambda b: b.point_position("p"), B, PLACE + B)),
        ("RigidBody", "rotation", np.eye(3), SKEWED, shows(lambda b: b.point_position("p"), B, SKEWED @ B)),
        ("RigidBody", "angular_velocity", np.zeros(3), ACROSS, is_now("angular_velocity", ACROSS)),
        ("RigidBody", "fixed", False, True, lambda before, after: before.moves and not after.moves),
        (
            "FlexibleBody",
            "position",
            np.zeros(3),
            PLACE,
            lambda before, after: np.allclose(after.point_position("left"), before.point_position("left") + PLACE),
        ),
        (
            "FlexibleBody",
            "rotation",
            np.eye(3),
            SKEWED,
            lambda before, after: np.allclose(after.point_position("right"), SKEWED @ before.point_position("right")),
        ),
        ("FlexibleBody", "fidelity", "ffrf", "rigid", lambda before, after: before.deforms and not after.deforms),
        (
            "FlexibleBody",
            "frame",
            None,
            "right",
            lambda *found: [Scene("s", (body,)).frame_point(body) for body in found] == ["left", "right"],
        ),
        ("FlexibleBody", "angular_velocity", np.zeros(3), ACROSS, is_now("angular_velocity", ACROSS)),
        (
            "FlexibleBody",
            "damping_ratio",
            None,
            0.02,
            lambda *found: [Scene("s", (body,)).mode_ratios.item() for body in found] == [0.01, 0.0],
        ),
        ("Vibrometer", "axis", "z", NORMAL, shows(rows(3), Z, NORMAL)),
        ("Geophone", "axis", "z", NORMAL, shows(rows(3), Z, NORMAL)),
        ("Accelerometer", "axis", "z", NORMAL, shows(rows(3), Z, NORMAL)),
        *(
            (verb, "frame", "", "body.p", shows(rows(3), Z, TURN @ Z))
            for verb in ("Vibrometer", "Geophone", "Accelerometer")
        ),
        ("Geophone", "corner_frequency", 4.5, 2.0, lambda _, after: after[1] == OutputFilter("part", "band", 2.0, 0.7)),
        ("Geophone", "damping_ratio", 0.7, 0.5, lambda _, after: after[1] == OutputFilter("part", "band", 4.5, 0.5)),
        (
            "Geophone",
            "sensitivity",
            None,
            28.0,
            shows(reads("gain"), 1 / (9 * np.pi), 28 / (9 * np.pi)),
        ),
        ("Accelerometer", "resonance", None, 300.0, has(OutputFilter("part", "low", 300.0, 0.02))),
        ("Accelerometer", "corner_frequency", 0.0, 0.5, has(OutputFilter("part", "high", 0.5))),
        ("Accelerometer", "sensitivity", None, 0.1, shows(reads("gain"), 1.0, 0.1)),
        ("Joint", "free", (), ("x", "rz"), shows(free, 0 * np.eye(6), freedom([1, 0, 0, 0, 0, 0], [0, 0, 0, 0, 0, 1]))),
        ("Joint", "axes", np.eye(3), SKEWED, is_now("axes", SKEWED)),
        *(
            (verb, "axis", "z", NORMAL, shows(free, freedom(*before), freedom(*after)))
            for verb, before, after in (
                ("revolute", ([0, 0, 0, *Z],), ([0, 0, 0, *NORMAL],)),
                ("prismatic", ([*Z, 0, 0, 0],), ([*NORMAL, 0, 0, 0],)),
                ("cylindrical", ([*Z, 0, 0, 0], [0, 0, 0, *Z]), ([*NORMAL, 0, 0, 0], [0, 0, 0, *NORMAL])),
            )
        ),
        (
            "planar",
            "normal",
            "z",
            NORMAL,
            lambda _, after: np.allclose(free(after)[:3, :3] @ NORMAL, 0) and np.isclose(np.trace(free(after)), 3),
        ),
        ("revolute", "damping", 0.0, 3.0, damped(3.0)),
        ("prismatic", "damping", 0.0, 3.0, damped(3.0)),
        ("cylindrical", "damping", 0.0, {"rz": 3.0, "z": 2.0}, damped(2.0, 3.0)),
        ("universal", "damping", 0.0, {"rx": 3.0, "ry": 2.0}, damped(3.0, 2.0)),
        ("spherical", "damping", 0.0, {"rx": 3.0, "ry": 2.0, "rz": 1.0}, damped(3.0, 2.0, 1.0)),
        ("planar", "damping", 0.0, {"x": 3.0, "y": 2.0, "rz": 1.0}, damped(3.0, 2.0, 1.0)),
        ("Loop", "input_step", 0.0, 0.1, is_now("input_step", 0.1)),
        ("Loop", "input_limit", np.inf, 0.1, is_now("input_limit", 0.1)),
        ("Loop", "output_step", 0.0, 0.1, is_now("output_step", 0.1)),
        ("Loop", "reference", (), ("wanted",), is_now("reference", ("wanted",))),
        ("Loop", "noise", (), ("hiss",), is_now("noise", ("hiss",))),
        ("Displacement", "axes_of", "", "body.p", shows(lambda m: m[1][0, :3], NORMAL, TURN @ NORMAL)),
        (
            "between",
            "axes_of",
            "",
            "body.p",
            shows(lambda m: m[0], along(NORMAL), along(NORMAL, TURN)),
        ),
        ("PointVelocity", "axes_of", "", "body.p", shows(lambda m: m[1][0, :3], NORMAL, TURN @ NORMAL)),
        (
            "PointVelocity",
            "angular",
            False,
            True,
            shows(lambda m: m[1][0], [*NORMAL, 0, 0, 0], [0, 0, 0, *NORMAL]),
        ),
        ("RotationAngle", "a", "", "body.p", shows(lambda m: m[0], 0.0, -angle_about(NORMAL))),
        ("RotationDeviation", "turning", True, False, shows(lambda m: m[0], *deviations(NORMAL, ACROSS))),
        (
            "RelativePose",
            "rotation",
            "vector",
            "matrix",
            shows(lambda six: six[3:], poses_at("vector"), poses_at("matrix")),
        ),
        (
            "RelativePose",
            "axes",
            np.eye(3),
            HALF,
            lambda before, after: np.allclose(after, before.reshape(2, 3)[:, [1, 2, 0]].ravel()),
        ),
        ("BodyCoordinates", "ends", (), ("bar.left",), is_now("points", ("bar.left",))),
        ("SpringDamper", "axis", "z", NORMAL, shows(value, along(Z), along(NORMAL))),
        ("SpringDamper", "damping", 0.0, 7.0, shows(force, 1.0, 1.014)),
        ("SpringDamper", "frame", "", "body.p", shows(value, along(Z), along(Z, TURN))),
        ("SpringDamper", "preload", 0.0, 4.0, shows(force, 1.0, 5.0)),
        (
            "Bushing",
            "damping",
            np.zeros(6),
            OTHERS,
            shows(force, 1e-3 * SIX * ONE_TO_SIX, (1e-3 * SIX + 2e-3 * OTHERS) * ONE_TO_SIX),
        ),
        ("Bushing", "axes", np.eye(3), SKEWED, lambda _, after: np.array_equal(after[0].measure.axes, SKEWED)),
        (
            "Bushing",
            "preload",
            np.zeros(6),
            SOFT,
            lambda *found: np.allclose(np.diff(list(map(force, found)), axis=0), SOFT),
        ),
        ("PointForce", "frame", "", "body.p", shows(rows(3), NORMAL, TURN @ NORMAL)),
        ("PointTorque", "frame", "", "body.p", shows(rows(3, 6), NORMAL, TURN @ NORMAL)),
        ("Encoder", "axis", "z", NORMAL, shows(value, along(Z), along(NORMAL))),
        ("Encoder", "frame", "", "body.p", shows(value, along(Z), along(Z, TURN))),
        ("AngleSensor", "axis", "z", NORMAL, shows(value, angle_about(Z), angle_about(NORMAL))),
        (
            "Pose",
            "axes",
            np.eye(3),
            SKEWED,
            shows(
                lambda terms: [moved(term.measure)[0].item() for term in terms],
                *(
                    [*(along(axis) for axis in axes), *(angle_about(axis) for axis in axes)]
                    for axes in (np.eye(3), SKEWED.T)
                ),
            ),
        ),
        *(
            (verb, "gain", 1.0, -20.0, shows(reads("gain"), one, -20 * one))
            for verb, one in (("StackActuator", 5.0), ("VoltageDrive", 1.0))
        ),
        *(
            (verb, "bandwidth", np.inf, 300.0, shows(reads("bandwidth"), np.inf, 300.0))
            for verb in ("StackActuator", "VoltageDrive")
        ),
        ("VoltageSensor", "gain", 1.0, -20.0, shows(reads("gain"), -1e6, 20e6)),
        (
            "VoltageSensor",
            "capacitance",
            0.0,
            3e-6,
            shows(lambda terms: (terms[0].gain, terms[1].stiffness), (-1e6, 1e6), (-0.25e6, 0.25e6)),
        ),
        (
            "VoltageSensor",
            "resistance",
            np.inf,
            1e5,
            lambda before, after: len(before) == 2 and (after[2].resistance, after[2].capacitance) == (1e5, 1e-6),
        ),
        (
            "placed",
            "position",
            (0, 0, 0),
            SHIFT,
            shows(lambda scene: scene.point_position("new/body.p"), PLACE + B, SHIFT + PLACE + B),
        ),
        (
            "placed",
            "rotation",
            None,
            TURN,
            shows(lambda scene: scene.point_position("new/body.p"), PLACE + B, TURN @ (PLACE + B)),
        ),
        ("joined", "bodies", (), (replace(BODY, name="third"),), adds("bodies", "third")),
        *(("joined", kind, (), at_one(parts), adds(kind, parts[0].name)) for kind, parts in EXTRA.items()),
        *(("joined", name, value, 2 * value, shows(own(name), value, 2 * value)) for name, value in AGREED.items()),
        *(("Scene", kind, (), parts, adds(kind, parts[0].name)) for kind, parts in EXTRA.items()),
        (
            "Scene",
            "damping_ratio",
            None,
            0.03,
            shows(own("mode_ratios"), 0.01, 0.03),
        ),
        ("Scene", "gravity", np.zeros(3), ACROSS, is_now("gravity", ACROSS)),
        ("Scene", "cutoff_frequency", None, 300.0, is_now("cutoff_frequency", 300.0)),
        ("Scene", "quasi_static_above", None, 300.0, is_now("quasi_static_above", 300.0)),
        ("AppliedForce", "gain", 1.0, -3.0, are(COMPLIANCE, -3 * COMPLIANCE)),
        ("AppliedForce", "bandwidth", np.inf, 20.0, are(COMPLIANCE, LAG * COMPLIANCE)),
        ("CircuitState", "gain", 1.0, -3.0, is_now("gain", -3.0)),
        ("Feedthrough", "gain", 1.0, -3.0, are(COMPLIANCE + 1, COMPLIANCE - 3)),
        ("Feedthrough", "bandwidth", np.inf, 20.0, are(COMPLIANCE + 1, COMPLIANCE + LAG)),
        ("Output", "gain", 1.0, -3.0, are(SHAKEN, -3 * SHAKEN)),
        ("Output", "derivative", 0, 1, are(SHAKEN, S * SHAKEN)),
        ("Spring", "stiffness", 0.0, 3.0, shows(lambda law: force((law,)), 0.0, 3e-3)),
        ("Spring", "damping", 0.0, 3.0, shows(lambda law: force((law,)), 0.0, 6e-3)),
        (
            "NonlinearSpring",
            "tangent",
            None,
            lambda x, v: (7.0 * x, 8.0 * v),
            lambda before, after: np.allclose([before, after], [[600.0, 2.0], [1.4, 2.4]], rtol=1e-6),
        ),
        ("SpringForce", "component", "value", "rz", is_now("component", "rz")),
        (
            "OutputFilter",
            "damping_ratio",
            None,
            0.3,
            are(COMPLIANCE * LAG, COMPLIANCE / (1 - (F / 20.0) ** 2 + 0.6j * F / 20.0)),
        ),
        ("Constraint", "held", ("value",), (), are(0 * F, COMPLIANCE)),
        ("PrescribedMotion", "bandwidth", np.inf, 20.0, are(np.ones(3), LAG)),
    ],
) | table(
    {
        "Accelerometer": part(Accelerometer, "body.p", resonance=300.0),
        "Drive": lambda **options: Drive("part", "guide", "z", **{"input": "u"} | options).terms(SLIDE),
        "Joint": partial(Joint, "joint", *TOUCHING, "ry"),
        "Output": lambda **options: response(
            with_terms(Output("y", "m/s2", ALONG, derivative=2, **options)), "shake", "y"
        ),
        "PrescribedMotion": at_speed,
        "RigidBody": partial(RigidBody, "body", {"p": B}, fixed=True),
        "SpringDamper": part(SpringDamper, *POINTS, damping=5.0),
        "joined": lambda **options: both(
            **{"actuators": at_one(EXTRA["actuators"]), "sensors": at_one(EXTRA["sensors"])} | options
        ),
        "Scene": lambda **options: whole(**{kind: EXTRA[kind] for kind in ("actuators", "sensors")} | options),
    },
    [
        (
            "Accelerometer",
            "damping_ratio",
            0.02,
            0.1,
            lambda _, after: after[1] == OutputFilter("part", "low", 300.0, 0.1),
        ),
        ("Drive", "bandwidth", np.inf, 300.0, shows(reads("bandwidth"), np.inf, 300.0)),
        ("Joint", "damping", 0.0, 3.0, damped(3.0)),
        ("Output", "inertial", False, True, are(S**2 * SHAKEN, S**2 * SHAKEN + NORMAL @ ACROSS)),
        ("PrescribedMotion", "speed", 0.0, 0.3, are(np.zeros(6), 3e-4 * np.arange(6))),
        ("RigidBody", "mass", None, 3.0, is_now("mass", 3.0)),
        ("RigidBody", "inertia", None, INERTIA, is_now("inertia", INERTIA)),
        ("SpringDamper", "stiffness", 0.0, 1e3, shows(force, 0.01, 1.01)),
        ("joined", "loops", (), IDLE, adds("loops", "idle")),
        ("Scene", "loops", (), IDLE, adds("loops", "idle")),
    ],
)


@pytest.mark.parametrize("case", ARGUMENTS)
def test_an_optional_argument_does_what_it_should(case):
    ARGUMENTS[case].check()


def test_a_drive_follows_an_input_or_runs_at_a_speed():
    for given, input, speed in ({"input": "u"}, "u", 0.0), ({"speed": -2.0}, "", -2.0):
        drive = Drive("part", "guide", "z", **given)
        assert drive.terms(SLIDE) == (PrescribedMotion("guide", "z", input, "m", speed, np.inf),)


@dataclass(frozen=True)
class Rounded(Sensor):
    """Reads along an axis that is rounded in copies: a share of it points across."""

    share: float = 0.0

    def terms(self, scene):
        """The displacement of the only body that moves."""
        (body,) = (body.name for body in scene.bodies if body.moves)
        across = 0.0 if self.name == "rounded" else self.share
        return (Output(self.name, "m", Displacement(((f"{body}.p", np.array([4.0, 4.0 * across, 0.0])),))),)


def stack(length):
    """A stack between two points of a body so far apart [m]."""
    right = replace(bar().point("right"), position=bar().point("left").position + length * Z)
    reduced = replace(bar(), remote_points=(bar().point("left"), right))
    return StackActuator("s", "bar.left", "bar.right", 1.0, "u").terms(Scene("s", (FlexibleBody("bar", reduced),)))


def test_limits_lie_where_they_should():
    assert_limit(lambda x: stack(1e-9 / x), "lie in one place")
    assert_limit(lambda x: placed(whole(sensors=(Rounded("rounded", 1e-9 * x),)), "new"), "cannot be placed")


def test_every_optional_argument_is_tried():
    here = "scene/test_scene_arguments.py::test_a_drive_follows_an_input_or_runs_at_a_speed"
    stress = "simulation/test_stress_outputs.py::test_optional_arguments_of_sensors_and_peaks"
    filtered = "simulation/test_sensor_filters.py::test_every_sensor_has_the_closed_form_of_its_filter"
    public = {name: getattr(nassim.scene, name) for name in nassim.scene.__all__}
    sensors = [name for name, kind in public.items() if isinstance(kind, type) and issubclass(kind, Sensor)]
    shaken = "test_a_ground_that_shakes_along_axes_of_the_rotor_does_so_at_shifted_frequencies"
    names = ("StrainGauge: gain", "StressAt: component", "PeakStress: position", "PeakStress: mesh_error")
    assert_all_tried(
        nassim.scene,
        ARGUMENTS,
        {
            **{
                f"BodyCoordinates: {name}": "simulation/test_bent_bodies.py::"
                "test_a_column_deflects_many_times_as_far_under_its_load"
                for name in ("of_strain", "constant")
            },
            "RelativePose: shaft": "simulation/test_own_laws.py::test_rates_of_a_relative_pose_at_any_angle",
            "Drive: direction": "simulation/test_drives.py::test_weight_that_is_there_before_a_slide_starts",
            "Drive: input": here,
            "Drive: speed": here,
            "GroundAcceleration: frame": f"simulation/test_rotors.py::{shaken}",
            "BaseAcceleration: axes_of": f"simulation/test_rotors.py::{shaken}",
            "Loop: feedforward": "simulation/test_references.py::test_the_linear_closed_loop_has_the_feedforward",
            "VoiceCoil: frame": "simulation/test_voice_coil.py::test_a_coil_on_a_turntable_works_along_its_axes",
            **{f"{kind}: {name}": filtered for kind in sensors for name in ("bandwidth", "order")},
            **dict.fromkeys((*names, "peak_stress: place", "peak_stress: voltages"), stress),
            "Motion: voltages": "simulation/test_stress_in_stacks.py::test_a_motion_at_rest_knows_its_voltages",
        },
    )
