"""No result depends on the order in which parts are listed, nor on which of two equal bodies is a placed copy.

One machine, at rest, on a spindle and in large motion; every verb that takes a scene gives the same figures by name.
"""

import functools
import re
import warnings
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import pytest
from conftest import lattice, turn

from nassim import (
    Accelerometer,
    AngleSensor,
    Bushing,
    Drive,
    Encoder,
    FlexibleBody,
    Geophone,
    GroundAcceleration,
    Loop,
    PointForce,
    PointTorque,
    RigidBody,
    Scene,
    SpringDamper,
    StackActuator,
    StackSensor,
    TimeHistory,
    Vibrometer,
    craig_bampton,
    fixed,
    frequency_response,
    linearize,
    prismatic,
    revolute,
    simulate,
    static_response,
)
from nassim.scene import (
    BodyCoordinates,
    Combination,
    Displacement,
    ForceSensor,
    Output,
    Path,
    Sensor,
    joined,
    placed,
    point_motion,
)
from nassim.simulation import (
    Simulation,
    buckling_factors,
    describe,
    exudyn_eigenfrequencies,
    linearize_closed,
    loaded_equilibrium,
    mode_motion,
    numerical_damping,
    period_errors,
    reduce_scene,
    scene_modes,
    simulate_motion,
    spinning_equilibrium,
    static_motion,
    truncation_error,
)
from nassim.systems import Controller, noise_budget

AXIS = np.array([2.0, -1.0, 2.0]) / 3
RAIL = np.array([0.48, 0.6, 0.64])
TILT, OTHER = turn([0.3, 1.0, 0.7], 0.8), turn([1.0, -2.0, 0.5], 1.1)
TABLE = np.array([0.05, -0.03, 0.02])
LEFT, RIGHT, LOAD, BOB = (
    TABLE + place for place in ([0.04, 0.0, 0.01], [-0.03, 0.05, 0.0], [0.0, 0.04, 0.06], [0.03, -0.06, 0.05])
)
STEP = 5e-4


@functools.cache
def bar(points=("left", "right"), _copy=0):
    return craig_bampton(lattice(stiffness=3e5), n_modes=2, remote_points=points, progress=False)


def inertia(size, x, y, z):
    """Principal moments about skew axes."""
    matrix = OTHER @ np.diag([x, y, z]) @ OTHER.T * size
    return 0.5 * (matrix + matrix.T)


X = np.array([1.0, 0.0, 0.0])
"""Along the bars."""


def unit(fidelity, reduced, frame, spinning):
    """A bar with stacks, which the machine has twice: its left point is the origin."""
    shake = (
        Vibrometer("shake", "bar.right", X, frame="bar.right")
        if spinning  # linear models of what spins read nothing against inertial space
        else Geophone("shake", "bar.right", X, corner_frequency=6.0, sensitivity=30.0)
    )
    body = FlexibleBody("bar", reduced, -reduced.point("left").position, fidelity=fidelity, frame=frame)
    return Scene(
        "unit",
        (body,),
        actuators=(
            StackActuator("stack", "bar.left", "bar.right", 3.0, "voltage", gain=2.0, bandwidth=400.0),
            PointForce("tug", "bar.right", X, "tug", frame="bar.right"),
        ),
        sensors=(StackSensor("sense", "bar.left", "bar.right", 2e4), shake),
    )


@dataclass(frozen=True)
class Levelled(Sensor):
    """Several terms of unlike gains that add to one output."""

    def terms(self, scene):
        """Of the load and of the bob."""
        load, bob = (
            Displacement.between("table.mount", f"{name}.c", AXIS, axes_of="table.mount") for name in ("load", "bob")
        )
        return (Output(self.name, "m", load, -3.0), Output(self.name, "m", Combination(((1.0, bob), (0.5, load))), 0.7))


@dataclass(frozen=True)
class Inner(Sensor):
    """How far the modes with held points deform a bar, weighted by their inertia against a shift along an axis."""

    body: Path
    axis: int

    def terms(self, scene):
        """Of one bar, which another one does not need."""
        (reduced,) = (body.reduced for body in scene.bodies if body.name == self.body)
        weights = 1e5 * reduced.mass_matrix @ reduced.motion("right")[self.axis]
        weights[: 6 * len(reduced.point_names)] = 0.0
        return (Output(self.name, "1", BodyCoordinates(self.body, weights)),)


def controller(gains, corner, **options):
    """A lag of given corner [Hz] on each of its inputs, (outputs, inputs)."""
    gains = np.atleast_2d(gains)
    n, pole = gains.shape[1], np.exp(-2 * np.pi * corner / options["sample_rate"])
    return Controller(pole * np.eye(n), (1 - pole) * np.eye(n), gains, 0.3 * gains, **options)


ONE, TWO, SLOW = ({"sample_rate": rate, "delay": delay} for rate, delay in ((1e3, 1), (1e3, 2), (500.0, 1)))
LOOPS = (
    Loop(
        "motion",
        controller([[-900.0, 2.0], [0.4, -0.03]], 60.0, **ONE),
        ("way", "turn"),
        ("push", "torque"),
        reference=("way set", "turn set"),
        feedforward=controller([[800.0, 1.0], [-0.5, 0.02]], 200.0, **ONE),
    ),
    Loop("left", controller(-0.02, 80.0, **TWO, limit=1e-5), "left/sense", "left/voltage"),
    Loop("right", controller(0.01, 30.0, **ONE, limit=3e-5, anti_windup=[[0.2]]), "right/sense", "right/voltage"),
    Loop("slow", controller(-400.0, 20.0, **SLOW), "level", "pull", reference="level set"),
)
"""Two of equal rate and delay, one of another delay, one of another rate."""


def machine(kind, fidelity="linear", copies=(True, True), points=("left", "right"), **options):
    """The machine of a kind with other options of its scene."""
    return replace(plain_machine(kind, fidelity, copies, points), **options)


@functools.cache
def plain_machine(kind, fidelity, copies, points):
    """A table with two bars, a load on a rail with a wheel, and a bob.

    kind: "resting" on bushings, "spinning" by a drive about an axis along gravity, "led" by a drive with an input, or
    "turning" by it, with a wheel that nothing holds
    copies: which of the bars is a placed copy; the other one is made where it stands
    """
    units = tuple(bars(fidelity, copies, points, spinning=kind == "spinning"))
    joints, springs, actuators = JOINTS, SPRINGS, ACTUATORS
    felt = {"spinning": Vibrometer("felt", "bob.far", AXIS, "bob.far")}.get(kind, FELT)
    if kind != "turning":
        springs = (*springs, SpringDamper("coil", "load.rim", "wheel.rim", OTHER[1], 5e3, 0.5, frame="load.rim"))
    if kind == "resting":
        springs = (
            *springs,
            Bushing("mount", "ground.p", "table.mount", [4e4, 5e4, 6e4, 60.0, 50.0, 40.0], 2.0 * np.ones(6)),
            SpringDamper("prop", "ground.o", "table.mount", "line", 3e3, 5.0),
        )
        quakes = GroundAcceleration("quake", RAIL, "quake"), GroundAcceleration("tremor", AXIS, "tremor")
        actuators = (*actuators, *quakes)
    else:
        joints = (*joints, revolute("spindle", "ground.q", "table.mount", AXIS))
        drive = {"speed": 9.0} if kind == "spinning" else {"input": "angle"}
        actuators = (*actuators, Drive("motor", "spindle", **drive))
    return joined(
        "machine",
        *units,
        bodies=rigid_bodies(*(one.bodies[0].point_position("right") for one in units)),
        joints=joints,
        actuators=actuators,
        sensors=(*SENSORS[:3], felt, *SENSORS[3:]),
        springs=springs,
        damping_ratio=0.0,
        gravity=-9.81 * AXIS if kind == "spinning" else np.array([1.0, -2.0, -9.0]),
    )


def bars(fidelity, copies, points, *, spinning):
    """The two units, each placed or made where it stands."""
    for copied, name, place, rotation in zip(copies, ("left", "right"), (LEFT, RIGHT), (TILT, OTHER), strict=True):
        reduced = bar(points) if copied else bar(points, 1)
        # Only one bar that floats has its frame on the table, which the first one that had would carry.
        frame = name if fidelity == "ffrf" else "left"
        there = placed(unit(fidelity, reduced, frame, spinning), name, position=place, rotation=rotation)
        corner = place - rotation @ reduced.point("left").position
        own = FlexibleBody(f"{name}/bar", reduced, corner, rotation, fidelity, frame)
        yield there if copied else replace(there, bodies=(own,))


def rigid_bodies(left, right):
    """The other bodies; left, right: ends of the bars."""
    hook = BOB - TABLE + 0.01 * RAIL
    table = {"mount": 0 * TABLE, "left": LEFT - TABLE, "right": RIGHT - TABLE, "rail": LOAD - TABLE, "hook": hook}
    load = {"c": np.zeros(3), "hub": 0.01 * AXIS, "a": left - LOAD, "b": right - LOAD, "rim": 0.03 * RAIL}
    wheel = {"hub": np.zeros(3), "rim": 0.01 * OTHER[0]}
    return (
        RigidBody("ground", {"o": np.zeros(3), "p": TABLE - [0.0, 0.0, 0.01], "q": TABLE}, fixed=True),
        RigidBody("table", table, 1.5, inertia(2e-3, 1.0, 1.5, 1.2), TABLE),
        RigidBody("load", load, 0.6, inertia(3e-4, 1.0, 0.7, 1.3), LOAD),
        RigidBody("wheel", wheel, 0.2, inertia(2e-5, 1.0, 1.4, 1.8), LOAD + 0.01 * AXIS),
        RigidBody("bob", {"c": np.zeros(3), "far": 0.02 * OTHER[1]}, 0.3, inertia(1e-4, 1.2, 0.8, 1.0), BOB),
    )


JOINTS = (
    fixed("left foot", "table.left", "left/bar.left"),
    fixed("right foot", "table.right", "right/bar.left"),
    prismatic("slide", "table.rail", "load.c", RAIL),
    revolute("hinge", "load.hub", "wheel.hub", OTHER[:, 2], damping=1e-5),
)
SPRINGS = (
    SpringDamper("return", "table.rail", "load.c", RAIL, 2e4, 4.0, frame="table.rail"),
    SpringDamper("left tie", "load.a", "left/bar.right", RAIL, 3e3, 0.5, frame="load.a"),
    SpringDamper("right tie", "load.b", "right/bar.right", RAIL, 5e3, 0.7, frame="load.b"),
    Bushing("hang", "table.hook", "bob.c", [5e3, 7e3, 6e3, 5.0, 4.0, 6.0], 0.3 * np.ones(6), TILT),
    SpringDamper("stay", "table.rail", "bob.far", "line", 900.0, 2.0),
)
ACTUATORS = (
    PointForce("push", "load.c", RAIL, "push", frame="load.c"),
    PointForce("pull", "bob.c", AXIS, "pull", frame="bob.c"),
    PointTorque("torque", "wheel.hub", OTHER[:, 2], "torque", frame="wheel.hub"),
    StackActuator("helper", "right/bar.left", "right/bar.right", -2.0, "left/voltage", bandwidth=120.0),
)
FELT = Accelerometer("felt", "bob.far", AXIS, "bob.far", resonance=500.0, damping_ratio=0.3, sensitivity=0.2)
SENSORS = (
    Encoder("way", "table.rail", "load.c", RAIL, frame="table.rail"),
    AngleSensor("turn", "load.hub", "wheel.hub", OTHER[:, 2]),
    Levelled("level"),
    Vibrometer("fast", "load.rim", OTHER[0], frame="load.rim"),
    Inner("left inside", "left/bar", 1),
    Inner("right inside", "right/bar", 2),
    ForceSensor("pulled", "hang"),
    ForceSensor("returned", "return"),
)


def as_is(items):
    return tuple(items)


def backwards(items):
    return tuple(items)[::-1]


def oddly(items):
    """The first one becomes the last one."""
    return (*tuple(items)[1::2], *tuple(items)[::2][::-1])


def listed(scene, order):
    """The scene with all that it lists, and all that these list, in another order."""
    parts = {kind: order(getattr(scene, kind)) for kind in ("joints", "actuators", "sensors", "springs")}
    bodies = [
        replace(body, points=dict(order(body.points.items()))) if isinstance(body, RigidBody) else body
        for body in order(scene.bodies)
    ]
    return replace(scene, bodies=bodies, loops=[channels(loop, order) for loop in order(scene.loops)], **parts)


def channels(loop, order):
    """A loop with its signals, and the states of its controllers, in another order."""
    reads, drives = (list(order(range(len(names)))) for names in (loop.measured, loop.driven))

    def turned(law):
        n, (a, b, c, d) = list(order(range(len(law.A)))), law.matrices
        return replace(law, A=a[n][:, n], B=b[n][:, reads], C=c[drives][:, n], D=d[drives][:, reads])

    return replace(
        loop,
        controller=turned(loop.controller),
        measured=[loop.measured[k] for k in reads],
        driven=[loop.driven[k] for k in drives],
        reference=[loop.reference[k] for k in reads if loop.reference],
        feedforward=loop.feedforward and turned(loop.feedforward),
    )


ORDERS = (
    (as_is, (True, True), ("left", "right")),
    (oddly, (False, True), ("right", "left")),
    (backwards, (True, False), ("left", "right")),
)
"""Of all that is listed; of copies, and of points of the bars."""


def machines(kind, fidelity="linear", *, n=2, **options):
    """The machine as it is and in n - 1 other orders, with functions that list its signals in the same order."""
    for order, copies, points in ORDERS[:n]:
        yield listed(machine(kind, fidelity, copies, points, **options), order), order


UNSEEN, UNSEEN_VOLTAGE = 1e-3, 1.0
"""Sizes to which smaller signals are compared, in each unit. A rigid bar's voltage is the rounding of 20 kV/m."""
WORDS = re.compile(r"[\w./+-]+")


def assert_alike(make, kind, fidelity="linear", within=1e-9, **options):
    """Figures by name, and warnings, of the machines; make: function of a scene and an order, that returns figures."""
    found, told = [], []
    for scene, order in machines(kind, fidelity, **options):
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            found.append(make(scene, order))
        told.append(sorted(sorted(WORDS.findall(str(one.message))) for one in caught))
    assert told[1:] == told[:1] * (len(told) - 1)
    for figures in found[1:]:
        assert set(figures) == set(found[0])
        for name, expected in found[0].items():
            size = np.abs(expected).max() + (UNSEEN_VOLTAGE if name.endswith("sense") else UNSEEN)
            np.testing.assert_allclose(figures[name], expected, rtol=0, atol=within * size, err_msg=name)


def pulses(scene, order, n=24, **own):
    """Unlike pulses of all inputs, listed in an order; own: signals of some."""
    time, inputs = STEP * np.arange(n + 1), order(sorted(scene.inputs))
    unlike = {name: 15 + 2 * k for k, name in enumerate(sorted(scene.inputs))}
    values = [own.get(name, 2e-4 * unlike[name] * np.sin(2 * np.pi * unlike[name] * time) ** 2) for name in inputs]
    return TimeHistory(time, values, inputs, [scene.input_unit(name) for name in inputs])


def by_name(record):
    return dict(zip(record.names, record.values, strict=True))


def responses(model):
    """Of each output by the inputs in alphabetical order, and what grows or decays how fast."""
    frf = frequency_response(model, [0.5, 3.0, 8.0, 40.0, 300.0])
    found = {name: np.array([frf.response(name, by) for by in sorted(frf.inputs)]) for name in frf.outputs}
    return found | ({} if model.time_step else {"poles": np.sort(np.abs(model.poles()))})


LOADS = {"push": 0.3, "pull": -0.2, "torque": 1e-4, "left/voltage": 0.5, "right/tug": 0.1, "quake": 0.2, "tremor": -0.1}


def loads(scene, order):
    """Those of them that the machine has, listed in an order."""
    return {name: LOADS[name] for name in order(sorted(LOADS)) if name in scene.inputs}


PUSHES = {name: LOADS[name] for name in LOADS if name not in ("quake", "tremor")}
"""Those that may be there at the start of a run."""
HELD = ("motion", "left", "right")
"""Loops of one rate."""


@pytest.mark.parametrize(
    ("kind", "fidelity", "n", "options"),
    [
        ("resting", "linear", 3, {"cutoff_frequency": 400.0, "damping_ratio": [0.01, 0.03]}),
        ("resting", "rigid", 2, {}),
        ("spinning", "ffrf", 2, {}),
    ],
)
def test_linear_models(kind, fidelity, n, options):
    def make(scene, order):
        return responses(linearize(scene, constant_inputs=loads(scene, order)))

    assert_alike(make, kind, fidelity, n=n, **options)


def test_linear_models_of_a_given_spin():
    """Of a table on which all turns, with the ground beside it as the stator."""

    def make(scene, order):
        return responses(linearize(scene, angular_velocity=6.0 * AXIS, axis_point=TABLE))

    def still(scene, order):
        return spinning_equilibrium(scene, angular_velocity=6.0 * AXIS, axis_point=TABLE)

    gravity = -9.81 * AXIS
    assert_alike(lambda scene, order: make(held(scene), order), "spinning", gravity=gravity)
    assert_alike(lambda scene, order: still(held(scene), order), "spinning", gravity=gravity)


def held(scene):
    """The machine without its motor and its ground: the spindle is locked."""
    return replace(
        scene,
        joints=[fixed("spindle", "ground.q", "table.mount") if one.name == "spindle" else one for one in scene.joints],
        actuators=[one for one in scene.actuators if one.name != "motor"],
    )


@pytest.mark.parametrize(("kind", "fidelity", "continuous"), [("resting", "linear", True), ("spinning", "ffrf", False)])
def test_closed_loops(kind, fidelity, continuous):
    def make(scene, order):
        loops = order([loop.name for loop in scene.loops if continuous or loop.name in HELD])
        return responses(linearize_closed(scene, loops=loops, continuous=continuous, noise=True, delay_order=3))

    assert_alike(make, kind, fidelity, loops=LOOPS)


@pytest.mark.parametrize(
    ("kind", "fidelity", "options"),
    [
        ("resting", "linear", {"method": "exact"}),
        ("resting", "linear", {"constant_inputs": PUSHES}),
        ("resting", "ffrf", {"spectral_radius": 0.7}),
        ("spinning", "ffrf", {"method": "exact"}),
        ("turning", "ffrf", {}),
        ("turning", "rigid", {}),
    ],
)
def test_runs_with_loops(kind, fidelity, options):
    """Newton's iterations leave 1e-8 of motion and forces: some 1e-7 of forces that are differences of others."""

    def make(scene, order):
        return by_name(simulate(scene, pulses(scene, order), time_step=STEP, progress=False, **options))

    assert_alike(make, kind, fidelity, 1e-9 if "method" in options else 1e-7, loops=LOOPS)


def test_steps_of_the_explicit_rule():
    """Without readings of acceleration."""

    def make(scene, order):
        scene = replace(scene, sensors=[one for one in scene.sensors if not isinstance(one, Geophone | Accelerometer)])
        return by_name(
            simulate(
                scene, pulses(scene, order), time_step=STEP / 10, duration=8 * STEP, method="explicit", progress=False
            )
        )

    assert_alike(make, "resting", loops=LOOPS)


@pytest.mark.parametrize(
    ("kind", "fidelity", "options"), [("resting", "linear", {"method": "exact"}), ("turning", "ffrf", {})]
)
def test_runs_step_by_step(kind, fidelity, options):
    def make(scene, order):
        given = pulses(scene, order, 20)
        with Simulation(scene, time_step=STEP, constant_inputs={"push": 0.5}, **options) as run:
            for values in given.values.T[1:]:
                run.step(dict(zip(given.names, values.tolist(), strict=True)))
        return by_name(run.record)

    assert_alike(make, kind, fidelity, 1e-9 if options else 1e-7, loops=LOOPS)


@pytest.mark.slow
def test_exact_steps_along_the_path_of_a_drive():
    """By a twentieth of a radian and back, read by displacements, which such steps take."""
    path = 0.05 * np.sin(np.pi * np.arange(25) / 24) ** 2

    def make(scene, order):
        scene = replace(scene, sensors=[one for one in scene.sensors if one.name not in READ_AS_RATES])
        given = pulses(scene, order, angle=path)
        return by_name(simulate(scene, given, time_step=STEP, method="exact", progress=False))

    assert_alike(make, "led", "ffrf", loops=LOOPS)


READ_AS_RATES = ("left/shake", "right/shake", "felt", "fast")


@pytest.mark.parametrize("fidelity", ["linear", "ffrf"])
def test_statics(fidelity):
    def make(scene, order):
        return static_response(scene, loads(scene, order))

    assert_alike(make, "resting", fidelity)


@pytest.mark.parametrize(("kind", "fidelity"), [("resting", "linear"), ("resting", "ffrf"), ("spinning", "ffrf")])
def test_motions_and_forces_at_rest(kind, fidelity):
    def make(scene, order):
        rest = loaded_equilibrium(scene, inputs=loads(scene, order))
        forces = {**rest.joint_forces, **rest.spring_forces}
        return rest.motions | {f"{part} {name}": f for part, each in forces.items() for name, f in each.items()}

    assert_alike(make, kind, fidelity)


def moved(scene, motion):
    """Positions of points of all bodies, by path."""
    points = [f"{body.name}.{point}" for body in scene.bodies for point in body.point_names]
    return {path: point_motion(scene, motion, path)[0] - scene.point_position(path) for path in points}


def test_motion_of_bodies():
    def make(scene, order):
        given = pulses(scene, order, 20)
        return moved(scene, simulate_motion(scene, given, time_step=STEP, frames=3, progress=False)[1])

    assert_alike(make, "resting", "ffrf", loops=LOOPS)


def test_motion_at_rest_and_in_a_mode():
    def make(scene, order):
        return moved(scene, static_motion(scene, inputs=loads(scene, order)))

    def swinging(scene, order):
        pole, motion = mode_motion(scene, 3)
        rigid = {name: places[:-1] for name, places in motion.positions.items() if not scene.body(name).deforms}
        return {"pole": pole} | {name: np.abs(np.fft.rfft(places, axis=0)[1]) for name, places in rigid.items()}

    assert_alike(make, "resting")
    assert_alike(swinging, "resting", within=1e-8)  # of an eigenvector among others


def test_modes_and_what_steps_do_to_them():
    def make(scene, order):
        frequency, shapes = scene_modes(scene)
        rigid = {name: np.abs(rows) for name, rows in shapes.items() if not scene.body(name).deforms}
        return rigid | {
            "frequency": frequency,
            "by Exudyn": exudyn_eigenfrequencies(scene),
            "periods": period_errors(scene, STEP, spectral_radius=0.8),
            "damping": numerical_damping(scene, STEP, spectral_radius=0.8),
        }

    assert_alike(make, "resting", within=1e-8)  # of eigenvectors among others


@pytest.mark.slow
def test_noise_budgets_and_errors_of_omitted_modes():
    def make(scene, order):
        model, names, band = linearize(scene), sorted(scene.inputs), np.geomspace(1.0, 300.0, 30)
        lines = {
            name: partial(lambda f, at: 1 / (1 + (2 * (f - at)) ** 2), at=30 + 20 * names.index(name)) for name in names
        }
        levels = {name: lines[name] for name in order(names)}  # with lines, whose points are in the budget of all
        budget = noise_budget(model, levels, band)
        given, rms = np.searchsorted(budget.frequency, band), budget.rms()  # rounding may add a point near a resonance
        densities, totals = {}, {}
        for k, out in enumerate(budget.outputs):
            for n, by in enumerate(budget.inputs):
                densities[f"{out} by {by}"], totals[f"{out} by {by}"] = budget.psd[k, n, given], rms[k, n]
        return densities, totals

    def left_out(scene, order):
        errors = truncation_error(scene, [100.0, 200.0], relative=False)
        columns = [scene.inputs.index(name) for name in sorted(scene.inputs)]
        return {name: errors[k, columns] for k, name in enumerate(scene.outputs)}

    assert_alike(lambda *given: make(*given)[0], "resting")
    assert_alike(lambda *given: make(*given)[1], "resting", within=1e-5)  # of the integral between points
    assert_alike(left_out, "resting", within=1e-8)  # differences of responses


def test_buckling_and_one_body_of_the_whole():
    """Under forces along the world's axes, which have an energy; and without the ground."""

    def factors(scene, order):
        pushes = [replace(one, frame="") for one in scene.actuators if isinstance(one, PointForce)]
        return {
            "factors": buckling_factors(replace(scene, actuators=pushes), inputs={"push": 2.0, "pull": 1.0}, n=3)[0]
        }

    def whole(scene, order):
        scene = replace(
            scene,
            bodies=[body for body in scene.bodies if body.moves],
            springs=[one for one in scene.springs if one.name not in ("mount", "prop")],
            gravity=np.zeros(3),
        )
        points = {"one": "table.mount", "other": "bob.c"}
        body = reduce_scene(scene, "whole", points={name: points[name] for name in order(points)}, cutoff_frequency=200)
        return {"held": body.eigenfrequencies(fixed=["one"], n=5), "free": body.eigenfrequencies(fixed=["other"], n=5)}

    assert_alike(factors, "resting", within=1e-8)
    assert_alike(whole, "resting")


def test_descriptions():
    """The same words in another order; of two copies that are alike, the first one is described."""
    for kind, fidelity in (("resting", "linear"), ("turning", "ffrf")):
        texts = [describe(scene).replace("right", "left") for scene, _ in machines(kind, fidelity, loops=LOOPS)]
        said = [sorted(re.findall("[a-z]{2,}", text)) for text in texts]
        assert said[1] == said[0]


def ran(scene, order, n=40, **options):
    return simulate(scene, pulses(scene, order, n), time_step=STEP, progress=False, **options)


def with_pulse(scene, order):
    """One input has a pulse between two steps, which counts in the beginning that is run."""
    time, inputs = STEP / 5 * np.arange(20001), order(sorted(scene.inputs))
    plain = (0.02 + time**2) * np.sin(20 * time)
    values = [plain + 0.3 * (np.arange(20001) == 503) * (name == "push") for name in inputs]
    excitation = TimeHistory(time, values, inputs, [scene.input_unit(name) for name in inputs])
    return simulate(scene, excitation, time_step=2 * STEP, duration=0.1, progress=False)


def with_loop(name, **changes):
    """Changes of the controller of one of the loops."""
    return [replace(one, controller=replace(one.controller, **changes)) if one.name == name else one for one in LOOPS]


def preloaded(scene, order):
    springs = [replace(one, preload=0.1) if one.name == "stay" else one for one in scene.springs]
    return ran(replace(scene, springs=springs), order, method="exact")


def started(scene, order):
    bodies = [replace(one, angular_velocity=AXIS) if one.name == "load" else one for one in scene.bodies]
    return ran(replace(scene, bodies=bodies), order)


def pushed_far(scene, order):
    return static_response(scene, {name: {"torque": 0.01, "pull": 1.0}[name] for name in order(("torque", "pull"))})


def ran_away(scene, order, **options):
    loops = listed(replace(scene, loops=with_loop("right", D=[[30.0]], limit=np.inf)), order).loops
    return ran(replace(scene, loops=loops), order, 100, **options)


TOLD = {
    "a pulse is lost": (with_pulse, "resting", "lose .* of the power of 'push'", {}),
    "a rate does not fit": (ran, "resting", "loop 'left' samples at", {"loops": with_loop("left", sample_rate=1300.0)}),
    "rates differ": (
        lambda scene, _: linearize_closed(scene),
        "resting",
        "sample at 1300, .*multiples",
        {"loops": with_loop("left", sample_rate=1300.0)},
    ),
    "a loop runs away": (ran_away, "resting", "'right/bar' is deformed", {}),
    "a loop runs away in exact steps": (partial(ran_away, method="exact"), "resting", "'right/bar' is deformed", {}),
    "a loop is at its limit": (ran, "resting", "loop 'right'", {"loops": with_loop("right", limit=1e-6)}),
    "a spring has a preload": (preloaded, "resting", "SpringDamper 'stay'", {}),
    "a body cannot turn": (started, "spinning", "body 'load' cannot start to turn", {}),
    "a body turns too far": (pushed_far, "resting", "body 'wheel' turned by", {}),
}


@pytest.mark.parametrize("what", TOLD)
def test_warnings_and_refusals(what):
    """They name the one part that they are about, wherever it stands."""
    make, kind, message, options = TOLD[what]
    told = []
    for scene, order in machines(kind, **options):
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            try:
                make(scene, order)
            except (ValueError, RuntimeError) as error:
                caught.append(error)
        texts = [str(getattr(one, "message", one)) for one in caught]
        assert any(re.search(message, text) for text in texts), texts
        told.append(sorted(sorted(WORDS.findall(text)) for text in texts))
    assert told[1] == told[0]
