"""Sensors of force, velocity and acceleration: closed forms, every engine against the linear model, large motion."""

import warnings
from dataclasses import dataclass, replace

import numpy as np
import pytest
import scipy.integrate
import scipy.signal
from conftest import lattice, turned_by
from newton_euler import integrate, wrench
from scipy.spatial.transform import Rotation

from nassim import (
    Accelerometer,
    AngleSensor,
    Bushing,
    Controller,
    Drive,
    Encoder,
    FlexibleBody,
    ForceSensor,
    Geophone,
    GroundAcceleration,
    Joint,
    Loop,
    PointForce,
    RigidBody,
    Scene,
    SpringDamper,
    TimeHistory,
    Vibrometer,
    craig_bampton,
    describe,
    frequency_response,
    linearize,
    load,
    placed,
    save,
    simulate,
    static_response,
)
from nassim.scene.forces import PointTorque
from nassim.scene.joints import prismatic, revolute
from nassim.scene.measures import Displacement
from nassim.scene.part import Sensor
from nassim.scene.rotation_measures import RelativePose
from nassim.scene.terms import Output, OutputFilter, Spring, SpringForce

STEP = 2e-5
ALONG = np.array([0.48, -0.6, 0.64])
ODD = np.array([2.0, -1.0, 2.0]) / 3


SKEWED = turned_by(0.7, -0.4, 1.2)
INERTIA = turned_by(0.3, 0.5, -0.2) @ np.diag([2e-3, 3e-3, 4e-3]) @ turned_by(0.3, 0.5, -0.2).T
MASS, STIFFNESS, DAMPING = 2.0, 8e3, 12.0


def slider(*sensors, axis=ALONG, **parts):
    """A turned block on a spring and a guide along an odd axis, pushed along it."""
    ground = RigidBody("ground", {"o": (0, 0, 0), "away": 0.2 * ALONG}, fixed=True)
    block = RigidBody("block", {"o": (0, 0, 0), "tip": (0.1, 0.2, 0.3)}, MASS, INERTIA, rotation=SKEWED)
    given = {
        "joints": (prismatic("guide", "ground.o", "block.o", axis),),
        "springs": (SpringDamper("spring", "ground.o", "block.o", tuple(axis), STIFFNESS, DAMPING),),
        "actuators": (PointForce("push", "block.tip", tuple(axis), "push"),),
        "damping_ratio": 0.0,
    }
    return Scene("slider", (ground, block), sensors=sensors, **{**given, **parts})


FREQUENCY = np.geomspace(0.3, 3e3, 40)
S = 2j * np.pi * FREQUENCY


def section(frequency, ratio, power):
    """Second order: power 0 for a low-pass, 2 for a high-pass."""
    w = 2 * np.pi * frequency
    return (S if power else w) ** 2 / (S**2 + 2 * ratio * w * S + w**2)


def test_closed_forms_of_one_mass():
    """Force to velocity, acceleration and the force in the spring, through the sensors' own dynamics."""
    other = np.array([0.6, 0.8, 0.0])
    scene = slider(
        Geophone("geophone", "block.tip", tuple(other), "", 4.5, 0.56, 28.8),
        Accelerometer("accelerometer", "block.tip", tuple(-ALONG), "block.o", 900.0, 0.03, 0.8, 0.1),
        Accelerometer("acceleration", "block.tip", tuple(ALONG)),
        Vibrometer("velocity", "block.tip", tuple(ALONG)),
        ForceSensor("force", "spring"),
    )
    assert scene.output_units == ("V", "V", "m/s2", "m/s", "N")
    model = linearize(scene)
    assert len(model.poles()) == 2 + 2 + 3
    assert np.all(model.poles().real < 0)
    assert [bool(row[0]) for row in model.D] == [False, False, True, False, False]
    found = frequency_response(model, FREQUENCY)
    moved = 1 / (MASS * S**2 + DAMPING * S + STIFFNESS)
    expected = {
        "geophone": 28.8 * (other @ ALONG) * section(4.5, 0.56, 2) * S * moved,
        "accelerometer": -0.1 * section(900.0, 0.03, 0) * S / (S + 2 * np.pi * 0.8) * S**2 * moved,
        "acceleration": S**2 * moved,
        "velocity": S * moved,
        "force": (STIFFNESS + DAMPING * S) * moved,
    }
    for name, answer in expected.items():
        np.testing.assert_allclose(found.response(name, "push"), answer, rtol=1e-8, err_msg=name)
    text = " ".join(describe(scene).split())
    assert "geophone geophone [V]: block.tip along (" in text
    assert "above 4.5 Hz" in text
    assert "accelerometer accelerometer [V]: block.tip along (" in text
    assert "above 0.8 Hz, resonance 900 Hz" in text


def test_inertial_sensors_feel_the_ground():
    """An isolator on a shaking ground: what they read is absolute, what a vibrometer reads is against the ground."""
    shake = np.array([0.0, 0.6, 0.8])
    scene = slider(
        Geophone("geophone", "block.tip", tuple(ALONG), "", 2.0, 0.6),
        Geophone("across", "block.tip", tuple(np.cross(ALONG, shake)), "", 2.0, 0.6),
        Accelerometer("soft", "block.tip", tuple(ALONG), resonance=300.0, damping_ratio=0.1),
        Accelerometer("stiff", "block.tip", tuple(ALONG)),
        Accelerometer("high", "block.tip", tuple(ALONG), corner_frequency=3.0),
        Vibrometer("velocity", "block.tip", tuple(ALONG)),
        actuators=(GroundAcceleration("shake", tuple(shake), "shake"),),
    )
    found = frequency_response(linearize(scene), FREQUENCY)
    share = ALONG @ shake
    relative = -share * MASS / (MASS * S**2 + DAMPING * S + STIFFNESS)
    absolute = share * (DAMPING * S + STIFFNESS) / (MASS * S**2 + DAMPING * S + STIFFNESS)
    for name, answer in {
        "geophone": section(2.0, 0.6, 2) * absolute / S,
        "soft": section(300.0, 0.1, 0) * absolute,
        "stiff": absolute,
        "high": S / (S + 6 * np.pi) * absolute,
        "velocity": S * relative,
    }.items():
        np.testing.assert_allclose(found.response(name, "shake"), answer, rtol=1e-7, err_msg=name)
    # The guide takes the ground along: the block follows it across.
    assert np.abs(found.response("across", "shake")).max() < 1e-9


@pytest.fixture(scope="module")
def body():
    return craig_bampton(lattice(stiffness=1e5), n_modes=4, progress=False)


TURN = turned_by(*(0.7 / 3 * np.array([1.0, -2.0, 2.0])))
STIFF = np.diag([2e5, 3e5, 4e5, 60.0, 90.0, 75.0])
STIFF[0, 1] = STIFF[1, 0] = 5e4
STIFF[0, 4] = STIFF[4, 0] = 300.0
INSTRUMENTS = (
    ForceSensor("along", "along"),
    ForceSensor("line", "line"),
    ForceSensor("six", "bushing"),
    Geophone("geophone", "load.c", tuple(ALONG), "", 40.0, 0.6, 30.0),
    Geophone("turning", "load.c", tuple(ODD), "load.c", 40.0, 0.6),
    Accelerometer("soft", "load.c", tuple(ALONG), "load.c", 900.0, 0.2, 20.0, 0.1),
    Accelerometer("inside", "body.right", "y", resonance=1200.0, damping_ratio=0.3),
    Vibrometer("velocity", "load.c", "x"),
)


def machine(body, fidelity, **parts):
    """A flexible body askew on the ground, whose tip carries a load on a bushing, and springs beside."""
    flexible = FlexibleBody("body", body, -TURN @ body.point("left").position, TURN, fidelity)
    tip = flexible.point_position("right")
    ground = RigidBody("ground", {"o": (0, 0, 0), "wall": tip + np.array([0.05, 0.1, -0.04])}, fixed=True)
    centre = tip + np.array([0.02, -0.01, 0.03])
    points = {"c": (0, 0, 0), "mount": SKEWED.T @ (tip - centre)}
    load = RigidBody("load", points, 0.3, 0.1 * INERTIA, centre, rotation=SKEWED)
    given = {
        "joints": (revolute("foot", "ground.o", "body.left", ODD),),
        "springs": (
            Bushing("bushing", "body.right", "load.mount", STIFF, 2e-5 * STIFF, turned_by(0.5, 0.2, -1.0)),
            SpringDamper("along", "load.c", "ground.wall", tuple(ODD), 3e4, 4.0, "load.c"),
            SpringDamper("line", "ground.wall", "load.mount", "line", 2e4, 5.0),
        ),
        "actuators": (PointForce("push", "load.c", tuple(ODD), "push"),),
        "sensors": INSTRUMENTS,
        "damping_ratio": 0.0,
    }
    return Scene("machine", (ground, flexible, load), **{**given, **parts})


def run(scene, n_steps=300, method="generalized_alpha", offset=0.0, size=1.0, **options):
    time = STEP * np.arange(n_steps + 1)
    shape = size * np.sin(np.pi * np.minimum(time / (150 * STEP), 1.0)) ** 2 + offset
    excitation = TimeHistory(time, np.tile(shape, (len(scene.inputs), 1)), scene.inputs, ())
    record = simulate(scene, excitation, time_step=STEP, method=method, progress=False, **options)
    return dict(zip(record.names, record.values, strict=True))


def sampled(scene, offset=0.0, n_steps=300):
    """Outputs of the linear model between straight lines, by SciPy's own exact steps."""
    model = linearize(scene)
    time = STEP * np.arange(n_steps + 1)
    shape = np.sin(np.pi * np.minimum(time / (150 * STEP), 1.0)) ** 2 + offset
    _, found, _ = scipy.signal.lsim(
        (model.A, model.B, model.C, model.D), np.tile(shape, (len(model.inputs), 1)).T, time
    )
    return dict(zip(model.outputs, found.T, strict=True))


ENGINES = [
    ("linear", "exact", 1e-7),
    ("linear", "generalized_alpha", 1e-2),
    ("ffrf", "generalized_alpha", 1e-2),
    ("rigid", "generalized_alpha", 1e-2),
]


@pytest.mark.parametrize(("fidelity", "method", "tolerance"), ENGINES)
def test_engines_agree(body, fidelity, method, tolerance):
    """A force that jumps at the start and then changes; gravity bends the machine before, and is not felt."""
    scene = machine(body, fidelity)
    expected = sampled(scene, 0.3)
    found = run(scene, method=method, offset=0.3, **({} if method == "exact" else {"spectral_radius": 0.8}))
    for name in scene.outputs:
        size = np.abs(expected[name]).max()
        assert size > 0
        assert np.abs(found[name] - expected[name]).max() < tolerance * size, name


@pytest.mark.parametrize("fidelity", ["linear", "ffrf"])
def test_loops_measure_what_passes_the_filters(body, fidelity):
    """Two filtered sensors in one loop of a slower sampler, beside one that nothing filters; against exact steps."""
    gains = np.array([[-60.0, -0.8, -2e3]])
    controller = Controller(np.zeros((0, 0)), np.zeros((0, 3)), np.zeros((1, 0)), gains, 1 / (4 * STEP), delay=1)
    loop = Loop("loop", controller, ("turning", "inside", "velocity"), ("push",))
    scenes = [machine(body, kind, loops=(loop,)) for kind in ("linear", fidelity)]
    expected, calm = (run(scene, 500, method="exact", offset=0.3) for scene in (scenes[0], machine(body, "linear")))
    found = run(scenes[1], 500, offset=0.3)
    assert np.abs(calm["velocity"] - expected["velocity"]).max() > 0.05 * np.abs(expected["velocity"]).max()
    for name in ("turning", "inside", "soft", "six.fy", "loop"):
        size = np.abs(expected[name]).max()
        assert np.abs(found[name] - expected[name]).max() < 5e-3 * size, name


@pytest.mark.parametrize("fidelity", ["linear", "ffrf"])
def test_ground_that_shakes_in_time(body, fidelity):
    """From its first sample on, and with a cutoff that condenses the body."""
    shake = (GroundAcceleration("shake", tuple(ODD), "shake"),)
    sensors = tuple(s for s in INSTRUMENTS if s.name in ("geophone", "inside", "six"))
    sensors += (Geophone("first", "load.c", "x", corner_frequency=80.0), Accelerometer("bare", "load.c", "z"))
    scene = machine(body, fidelity, actuators=shake, sensors=sensors)
    expected = sampled(machine(body, "linear", actuators=shake, sensors=sensors), 0.4)
    for found, tolerance in (
        (run(scene, offset=0.4), 2e-3),
        (run(replace(scene, cutoff_frequency=3e4), offset=0.4), 2e-3),
        (run(scene, offset=0.4, method="exact") if fidelity == "linear" else expected, 1e-7),
    ):
        for name in expected:
            size = np.abs(expected[name]).max()
            assert np.abs(found[name] - expected[name]).max() < tolerance * size, name


@pytest.mark.parametrize("fidelity", ["linear", "ffrf"])
def test_sensors_in_equilibrium(body, fidelity):
    """A force sensor bears the weight, others read nothing, at rest and when the run starts from there."""
    gravity = np.array([0.3, -0.5, -2.0])
    sensors = (ForceSensor("six", "bushing"), *INSTRUMENTS[3:])
    scene = machine(body, fidelity, sensors=sensors, gravity=gravity)
    scene = replace(scene, springs=scene.springs[:1], joints=(Joint("foot", "ground.o", "body.left"),), actuators=())
    still = static_response(scene)
    weight = [still[f"six.f{letter}"] for letter in "xyz"]
    # The axes turn by some mrad.
    off = np.linalg.norm(turned_by(0.5, 0.2, -1.0) @ weight - 0.3 * gravity)
    assert off < 2e-3 * 0.3 * np.linalg.norm(gravity)
    time = STEP * np.arange(11)
    record = simulate(scene, TimeHistory(time, np.zeros((0, 11)), (), ()), time_step=STEP, progress=False)
    for name, unit in zip(scene.outputs, scene.output_units, strict=True):
        if unit in ("N", "N m"):
            np.testing.assert_allclose(record[name], still[name], rtol=1e-6, atol=1e-9)
        else:
            assert still[name] == 0
            assert np.abs(record[name]).max() < 1e-7


def lag(numerator, denominator, values, time):
    """What a filter lets pass that has stood on its first value for long, by SciPy."""
    _, moved, _ = scipy.signal.lsim((numerator, denominator), values - values[0], time)
    return moved + values[0] * numerator[-1] / denominator[-1]


class TurningTable:
    """A load on bushing and springs with dampers, on a table that turns about an odd axis at constant speed."""

    rate, mass, step = 50.0, 0.7, 5e-5
    axes = turned_by(0.5, 0.2, -1.0)
    stiffness = STIFF / 10
    damping = 4e-4 * stiffness
    place, centre = 0.1 * ODD + [0.03, -0.02, 0.01], 0.1 * ODD + [0.0, 0.006, 0.004]
    far, near = np.array([-0.05, 0.12, 0.1]), np.array([0.12, 0.05, -0.03])
    spins = rate * ODD, rate * ODD + [0.0, 0.8, 0.5]
    k, c = 500.0, 2.0

    def scene(self):
        table = RigidBody("table", {"axis": (0, 0, 0), "o": self.place, "far": self.far}, 5.0, INERTIA)
        offsets = {"o": self.place - self.centre, "near": self.near - self.centre}
        points = {"c": (0, 0, 0), **{name: SKEWED.T @ offset for name, offset in offsets.items()}}
        load = RigidBody(
            "load", points, self.mass, INERTIA, self.centre, rotation=SKEWED, angular_velocity=self.spins[1]
        )
        along, ends, values = tuple(ALONG), ("table.far", "load.near"), (self.k, self.c)
        springs = (
            Bushing("bushing", "table.o", "load.o", self.stiffness, self.damping, self.axes),
            SpringDamper("of table", *ends, along, *values, "table.far"),
            SpringDamper("of load", *ends, along, *values, "load.near"),
            SpringDamper("line", *ends, "line", *values),
        )
        sensors = (
            ForceSensor("six", "bushing"),
            *(ForceSensor(f"force {name}", name) for name in ("of table", "of load", "line")),
            Geophone("world", "load.c", along, "", 4.0, 0.6, 2.0),
            Geophone("turning", "load.c", along, "load.c", 4.0, 0.6),
            Accelerometer("soft", "load.c", along, "load.c", 200.0, 0.3),
            Geophone("circle", "table.far", along, "", 6.0, 0.4),
            Accelerometer("at rest", "table.far", along, "table.axis", 300.0, 0.1),
        )
        joints = (revolute("bearing", "ground.o", "table.axis", ODD),)
        ground = RigidBody("ground", {"o": (0, 0, 0)}, fixed=True)
        drives = (Drive("spindle", "bearing", "rz", speed=self.rate),)
        return Scene("table", (ground, table, load), joints, drives, sensors, springs, damping_ratio=0.0)

    def pulls(self, t, body):
        """The bushing's six, its axes, and the tensions of springs with their directions on the load and places."""
        base, spin, axes = Rotation.from_rotvec(self.rate * t * ODD).as_matrix(), self.spins[0], self.axes
        here, there = base @ self.place, body.at(self.place - self.centre)
        turned = Rotation.from_matrix(axes.T @ base.T @ body.R @ axes).as_rotvec()
        now, middle = base @ axes @ turned_by(*turned / 2), (here + there) / 2
        slip = body.v + np.cross(body.w, middle - body.p) - np.cross(spin, middle)
        moved = np.concatenate([now.T @ (there - here), turned])
        rates = np.concatenate([now.T @ slip, now.T @ (body.w - spin)])
        six = self.stiffness @ moved + self.damping @ rates
        a, b = base @ self.far, body.at(self.near - self.centre)
        gap, speed, start = b - a, body.speed(self.near - self.centre) - np.cross(spin, a), self.near - self.far
        tensions = []
        for R, w, at in ((base, spin, b), (body.R, body.w, a)):
            stretch = R @ ALONG @ gap - ALONG @ start
            tensions.append((self.k * stretch + self.c * (R @ ALONG) @ (speed - np.cross(w, gap)), R @ ALONG, at))
        length = np.linalg.norm(gap)
        stretch = length - np.linalg.norm(start)
        tensions.append((self.k * stretch + self.c * gap @ speed / length, gap / length, b))
        return six, now, middle, tensions

    def forces(self, t, bodies):
        (body,) = bodies
        six, now, middle, tensions = self.pulls(t, body)
        total = -wrench(now @ six[:3], middle, body) - np.concatenate([np.zeros(3), now @ six[3:]])
        return [total - sum(wrench(tension * direction, at, body) for tension, direction, at in tensions)]


@pytest.fixture(scope="module")
def turned_table():
    """The table, a record of a turn by a radian, its times, and the load's motion there by Newton and Euler."""
    table = TurningTable()
    time = table.step * np.arange(401)
    nothing = TimeHistory(time, np.zeros((0, 401)), (), ())
    record = simulate(table.scene(), nothing, time_step=table.step, progress=False, spectral_radius=0.8)
    start = (table.centre,), (table.spins[1],)
    found = integrate((table.mass,), (SKEWED @ INERTIA @ SKEWED.T,), *start, time, table.forces)
    return table, record, time, [motion for (motion,) in found]


def test_force_sensors_of_a_load_on_a_turning_table(turned_table):
    table, record, time, found = turned_table
    seen = slice(None, None, 20)
    expected = [table.pulls(t, m) for t, m in zip(time[seen], found[seen], strict=True)]
    names = [f"six.{name}" for name in ("fx", "fy", "fz", "mx", "my", "mz")]
    forces = {name: np.array([six[j] for six, *_ in expected]) for j, name in enumerate(names)}
    for j, name in enumerate(("of table", "of load", "line")):
        forces[f"force {name}"] = np.array([tensions[j][0] for *_, tensions in expected])
    for name, force in forces.items():
        assert np.abs(record[name][seen] - force).max() < 2e-3 * np.abs(force).max(), name


def test_inertial_sensors_of_a_load_on_a_turning_table(turned_table):
    """Against filters by SciPy of the accelerations."""
    table, record, time, found = turned_table

    def coil(w, ratio):
        return [1, 0], [1, 2 * ratio * w, w**2]

    velocity = np.array([m.v for m in found])
    acceleration = scipy.interpolate.CubicSpline(time, velocity).derivative()(time)
    turning = np.array([m.R @ ALONG for m in found])
    turns = Rotation.from_rotvec(table.rate * np.outer(time, ODD)).as_matrix()
    circle = np.cross(table.spins[0], turns @ table.far)
    centripetal = np.cross(table.spins[0], circle)
    low = [(400 * np.pi) ** 2], [1, 0.6 * 400 * np.pi, (400 * np.pi) ** 2]
    for name, values in {
        "world": 2.0 * lag(*coil(8 * np.pi, 0.6), acceleration @ ALONG, time),
        "turning": lag(*coil(8 * np.pi, 0.6), np.einsum("ni,ni->n", turning, acceleration), time),
        "soft": lag(*low, np.einsum("ni,ni->n", turning, acceleration), time),
        "circle": lag(*coil(12 * np.pi, 0.4), centripetal @ ALONG, time),
        "at rest": np.einsum("nij,j,ni->n", turns, ALONG, centripetal),
    }.items():
        assert np.abs(record[name] - values).max() < 1e-3 * np.abs(values).max(), name


@dataclass(frozen=True)
class Meter(Sensor):
    """A sensor that says given words."""

    words: tuple = ()

    def terms(self, scene):
        return self.words


def mixed(*gains, name="mixed"):
    """An output of displacement, velocity and acceleration, along different directions."""
    axes = (ALONG, [1.0, 0.0, 0.0], ODD)
    readings = zip(gains, axes, strict=True)
    return Meter(
        name,
        tuple(Output(name, "V", Displacement((("load.c", np.array(w)),)), g, k) for k, (g, w) in enumerate(readings)),
    )


def test_sensors_measure_along_axes_of_any_length():
    """A vector says the direction alone, whatever its length."""
    ground = RigidBody("ground", {"o": (0, 0, 0)}, fixed=True)
    block = RigidBody("block", {"o": (0, 0, 0), "tip": (0.1, 0.2, 0.3)}, MASS, INERTIA, rotation=SKEWED)
    answers = []
    for length in (1.0, 2.5):
        axis, options = (
            tuple(length * ALONG),
            {"springs": (SpringDamper("s", "ground.o", "block.o", tuple(ALONG), 1.0),)},
        )
        sensors = (
            Encoder("way", "ground.o", "block.tip", axis),
            AngleSensor("angle", "ground.o", "block.tip", axis),
            Vibrometer("speed", "block.tip", axis),
            Geophone("geophone", "block.tip", axis),
            Accelerometer("acceleration", "block.tip", axis),
        )
        actuators = (
            PointForce("force", "block.tip", axis, "force"),
            PointTorque("torque", "block.tip", axis, "torque"),
            GroundAcceleration("ground", axis, "ground"),
        )
        scene = Scene("free", (ground, block), (), actuators, sensors, damping_ratio=0.0, **options)
        answers.append(frequency_response(linearize(scene), [0.5, 7.0]).values)
    np.testing.assert_allclose(*answers, rtol=1e-9, atol=1e-12 * np.abs(answers[0]).max())
    assert np.all(np.abs(answers[0][0]) > 0)


def test_forces_of_a_bushing_have_their_units_and_add_up():
    """Six outputs in N and N m; an output of two of them and of a displacement is their sum, in every engine."""
    six = np.diag([STIFFNESS, 2 * STIFFNESS, 3 * STIFFNESS, 90.0, 70.0, 80.0])
    six[0, 5] = six[5, 0] = 200.0
    pad = Bushing("pad", "ground.o", "block.o", six, 1e-3 * six)
    spring = Spring(RelativePose("ground.o", "block.o", np.eye(3)), pad.stiffness, pad.damping)
    row = Displacement((("block.tip", ALONG),))
    both = Meter(
        "both",
        (SpringForce("both", "V", spring, "x"), SpringForce("both", "V", spring, "rz"), Output("both", "V", row, 5e3)),
    )
    sensors = (ForceSensor("pull", "pad"), both, Encoder("way", "ground.o", "block.tip", tuple(ALONG)))
    scene = slider(*sensors, joints=(), springs=(pad,), axis=np.array([0.6, 0.0, 0.8]))
    assert scene.output_units == ("N", "N", "N", "N m", "N m", "N m", "V", "m")
    time = 4.0 + 2e-4 * np.arange(401)
    push = TimeHistory(time, np.sin(60.0 * (time - 4.0))[None], ("push",), ("N",))
    for method in ("exact", "generalized_alpha"):
        record = simulate(scene, push, time_step=2e-4, method=method, progress=False)
        expected = record["pull.fx"] + record["pull.mz"] + 5e3 * record["way"]
        assert min(np.abs(record[name]).max() for name in ("pull.fx", "pull.mz")) > 0.01
        np.testing.assert_allclose(record["both"], expected, atol=1e-9 * np.abs(expected).max())


@pytest.mark.parametrize(("passes", "power"), [("low", 0), ("band", 1), ("high", 2)])
def test_filters_of_second_order(passes, power):
    """s^power w^(2 - power) over s^2 + 2 d w s + w^2 of a displacement, and what a ramp that starts makes of it."""
    w, ratio = 2 * np.pi * 30.0, 0.3
    row = Displacement((("block.tip", ALONG),))
    scene = slider(Meter("m", (Output("m", "m", row), OutputFilter("m", passes, 30.0, ratio))))
    found = frequency_response(linearize(scene), FREQUENCY).response("m", "push")
    passed = S**power * w ** (2 - power) / (S**2 + 2 * ratio * w * S + w**2)
    np.testing.assert_allclose(found, passed / (MASS * S**2 + DAMPING * S + STIFFNESS), rtol=1e-8)
    held = static_response(scene, {"push": 2.0})["m"]
    assert held == pytest.approx(2.0 / STIFFNESS if passes == "low" else 0.0, abs=1e-12 / STIFFNESS)


@pytest.mark.parametrize(("fidelity", "method", "tolerance"), ENGINES)
def test_readings_of_one_output_add_up(body, fidelity, method, tolerance):
    """Also what a loop measures."""
    gains = 2e3, -3.0, 0.02
    single = tuple(mixed(*(g * (j == k) for j, g in enumerate(gains)), name=f"one {k}") for k in range(3))
    scene = machine(body, fidelity, sensors=(*single, mixed(*gains)))
    model = linearize(scene)
    np.testing.assert_allclose(model.C[3], model.C[:3].sum(axis=0), rtol=1e-12)
    np.testing.assert_allclose(model.D[3], model.D[:3].sum(axis=0), rtol=1e-12)
    found = run(scene, n_steps=200, method=method)
    sizes = [np.abs(found[f"one {k}"]).max() for k in range(3)]
    assert min(sizes) > 0.02 * max(sizes)
    np.testing.assert_allclose(found["mixed"], sum(found[f"one {k}"] for k in range(3)), atol=1e-9 * max(sizes))


def test_readings_of_one_derivative_add_up(body):
    """Two directions are one between them."""
    rows = [Displacement((("load.c", axis),)) for axis in (*np.eye(3)[:2], np.array([0.6, 0.8, 0.0]))]
    two, one = (
        Meter(n, tuple(Output(n, "m", rows[k], g) for k, g in gs))
        for n, gs in (("two", ((0, 3.0), (1, 4.0))), ("one", ((2, 5.0),)))
    )
    for fidelity in ("linear", "ffrf"):
        found = run(machine(body, fidelity, sensors=(two, one)), n_steps=160)
        np.testing.assert_allclose(found["two"], found["one"], atol=1e-9 * np.abs(found["one"]).max())


def test_a_runaway_loop_on_a_filtered_sensor_is_told(body):
    gains = Controller(np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), [[1e4]], 1 / STEP, delay=1)
    loop = Loop("loop", gains, ("geophone",), ("push",))
    with pytest.raises(RuntimeError, match=r"runs away: at t = .* 'geophone' has grown"):
        run(machine(body, "ffrf", loops=(loop,)))


def test_only_an_acceleration_that_follows_at_once_rings(body):
    """A low resonance calms it, and so does the default radius; a loop cannot measure what it drives at once."""
    calm = (Accelerometer("calm", "load.c", resonance=2e3), Geophone("geophone", "load.c"))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        run(machine(body, "ffrf", sensors=calm), n_steps=160)
    for sensor in (Accelerometer("high", "load.c", resonance=2e4), Accelerometer("bare", "load.c", corner_frequency=1)):
        with pytest.warns(UserWarning, match=f"'{sensor.name}' reads an acceleration"):
            run(machine(body, "ffrf", sensors=(sensor,)), n_steps=160, spectral_radius=0.9)
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            run(machine(body, "ffrf", sensors=(sensor,)), n_steps=160)
    gains = Controller(np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), [[1e-6]], 1 / STEP)
    for sensor in (*calm, Accelerometer("bare", "load.c", corner_frequency=1)):
        loop = Loop("loop", gains, (sensor.name,), ("push",))
        scene = machine(body, "linear", sensors=(sensor,), loops=(loop,))
        if sensor.name == "bare":
            with pytest.raises(ValueError, match="follows what the loop drives at once"):
                run(scene, n_steps=160)
        else:
            run(scene, n_steps=160)


def test_no_linear_model_of_inertial_sensors_that_spin(body):
    scene = machine(body, "linear", actuators=(), sensors=(INSTRUMENTS[0], INSTRUMENTS[7]))
    linearize(scene, angular_velocity=(0, 0, 0.1))
    for sensor in (Geophone("s", "load.c"), Accelerometer("s", "load.c")):
        with pytest.raises(ValueError, match="'s' reads motion against inertial space"):
            linearize(replace(scene, sensors=(sensor,)), angular_velocity=(0, 0, 0.1))


def test_placed_and_kept_in_files(body, tmp_path):
    """A copy, turned with its sensors, reads the same; a file brings them back."""
    scene = machine(body, "ffrf")
    copy = placed(scene, "m", position=(1.0, 2.0, 3.0), rotation=SKEWED)
    assert copy.outputs == tuple(f"m/{name}" for name in scene.outputs)
    frequency = np.geomspace(3.0, 3e3, 20)
    keeps = [k for k, name in enumerate(scene.outputs) if name not in ("inside", "velocity")]
    found, expected = (frequency_response(linearize(s), frequency).values for s in (copy, scene))
    np.testing.assert_allclose(found[keeps], expected[keeps], rtol=1e-5)
    save(scene, tmp_path / "scene.h5")
    again = load(tmp_path / "scene.h5")
    assert again.sensors == scene.sensors


def test_a_turning_sensor_on_shaking_ground():
    """A body that spins freely on a ground that shakes is at rest but for its turns, so a sensor in its middle is.

    The ground shakes along two directions by one input.
    """
    rate, shake, directions = 40.0, np.array([0.6, 0.0, -0.8]), ["x", (0.0, 0.0, -1.0)]
    top = RigidBody("top", {"c": (0, 0, 0)}, 0.4, 3e-3 * np.eye(3), rotation=SKEWED, angular_velocity=rate * ODD)
    sensors = (
        Geophone("geophone", "top.c", "x", "top.c", 2.0),
        Accelerometer("accelerometer", "top.c", "x", "top.c", resonance=200.0, damping_ratio=0.3),
        Accelerometer("world", "top.c", tuple(ALONG)),
        Vibrometer("velocity", "top.c", tuple(shake)),
    )
    shakers = tuple(GroundAcceleration(f"shaker {k}", along, "shake") for k, along in enumerate(directions))
    scene = Scene("top", (top,), actuators=shakers, sensors=sensors)
    found = run(scene, n_steps=1500, offset=0.2, spectral_radius=0.8)
    assert np.abs(found["velocity"]).max() > 0.01
    assert np.abs(found["world"]).max() < 1e-9
    assert np.abs(found["accelerometer"]).max() < 1e-4
    assert np.abs(found["geophone"]).max() < 1e-6


def test_forces_of_a_damper_between_bodies_that_turn_apart():
    """Two free bodies, one of which a force pulls off: what the other's bushing measures is what moves this one."""
    pull, spins = np.array([0.3, -0.2, 0.25]), ((1.0, -2.0, 0.5), (-3.0, 1.0, 4.0))
    bodies = tuple(
        RigidBody(name, {"c": (0, 0, 0)}, mass, 0.1 * np.eye(3), angular_velocity=spin)
        for name, mass, spin in zip("ab", (2.0, 1.5), spins, strict=True)
    )
    bushing = Bushing("bushing", "a.c", "b.c", [20.0] * 3 + [0.0] * 3, [3.0] * 3 + [0.0] * 3)
    size = float(np.linalg.norm(pull))
    scene = Scene(
        "apart",
        bodies,
        actuators=(PointForce("pull", "b.c", tuple(pull / size), "pull"),),
        sensors=(ForceSensor("six", "bushing"), *(Accelerometer(axis, "b.c", axis) for axis in "xyz")),
        springs=(bushing,),
        damping_ratio=0.0,
    )
    time = 2e-4 * np.arange(101)  # in which they turn apart by 0.1 rad, and move apart by 50 mm
    pulls = TimeHistory(time, [1e3 * size * np.sin(60 * time) ** 2], ("pull",), ("N",))
    record = simulate(scene, pulls, time_step=2e-4, progress=False, spectral_radius=0.8)
    moved = 1.5 * np.array([record[axis] for axis in "xyz"]) - np.outer(pull / size, record["pull"])
    first = Rotation.from_rotvec(np.outer(time, spins[0]))
    found = first.apply(np.transpose([record[f"six.f{axis}"] for axis in "xyz"])).T
    assert np.abs(found).max() > 3.0
    np.testing.assert_allclose(found, -moved, atol=3e-3 * np.abs(found).max())
