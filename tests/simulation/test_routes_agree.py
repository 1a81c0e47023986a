"""One machine in general position, simulated by different routes, whose results agree within the routes' errors.

It has several drives, amplifiers of unlike bandwidths on one input, dampers between bodies that move, circuits, filters
and loops of two rates; it stands, turns on a spindle, is led along a path, or is free.
"""

from dataclasses import dataclass, replace

import numpy as np
import pytest
import scipy.signal
from compiled_c import COMPILER, run_c
from scipy.spatial.transform import Rotation
from test_order_of_parts import AXIS, BOB, HELD, LOOPS, OTHER, RAIL, STEP, inertia, machine

from nassim import (
    Accelerometer,
    CurrentSensor,
    Drive,
    Encoder,
    ForceSensor,
    Geophone,
    GroundAcceleration,
    LinearActuator,
    PointForce,
    PointTorque,
    RigidBody,
    Simulation,
    SpringDamper,
    TimeHistory,
    Vibrometer,
    VoiceCoil,
    VoltageDrive,
    VoltageSensor,
    frequency_response,
    linearize,
    revolute,
    simulate,
    simulate_motion,
    static_response,
)
from nassim.bodies.piezo import PortCoupling
from nassim.bodies.readouts import by_name
from nassim.exchange import export_c
from nassim.scene import AppliedForce, Displacement, Distance, Feedthrough, Output, Sensor, point_motion
from nassim.simulation import linearize_closed
from nassim.simulation.run.scene_program import scene_program, scene_rates
from nassim.systems.step_program import run_program

DIAL = BOB + np.array([0.02, 0.03, -0.01])
NECK = DIAL + np.array([0.004, -0.002, 0.003])
SIZES = {
    "left/tug": 0.05, "right/tug": 0.04, "push": 0.05, "pull": 0.04, "torque": 1e-4, "left/voltage": 0.02,
    "right/voltage": 0.03, "quake": 0.1, "tremor": 0.07, "nod": 1e-4, "volts": 0.05, "angle": 2e-3,
}  # fmt: skip
"""Of inputs, so small that motion stays small."""
CONSTANT = {"push": 0.3, "pull": -0.2, "left/voltage": 0.5, "right/tug": 0.1, "volts": 0.4}
CONSTANT_FORCES = {name: value for name, value in CONSTANT.items() if name != "volts"}
LIGHT = 0.02
"""Share of gravity under which bodies hang so straight that models of first order hold within some 1e-3."""


@dataclass(frozen=True)
class Amplified(Sensor):
    """Forces of amplifiers by one input, along measures of moving bodies: a part of one's own."""

    def terms(self, scene):
        """Two slow ones and one that is faster than steps, beside a force that follows the input at once."""
        level = Displacement.between("table.mount", "bob.c", AXIS, axes_of="table.mount")
        return (
            AppliedForce("push", "N", level, 0.4, 60.0),
            AppliedForce("push", "N", Distance("table.rail", "bob.far"), -0.3, 25.0),
            AppliedForce("push", "N", Distance("dial.tip", "bob.far"), 0.6, 3000.0),
        )


@dataclass(frozen=True)
class Leaky(Sensor):
    """It reads the way to a bob, and an input at once and by two amplifiers."""

    def terms(self, scene):
        """Which add up."""
        level = Displacement.between("table.mount", "bob.c", OTHER[1], axes_of="table.mount")
        passed = [Feedthrough(self.name, "push", *share) for share in ((1e-4,), (-3e-4, 80.0), (2e-4, 20.0))]
        return (Output(self.name, "m", level), *passed)


def with_ports(reduced):
    """Two electrical ports, whose forces are in equilibrium."""
    wishes = np.random.default_rng(5).standard_normal((2, len(reduced.mass_matrix)))
    forces = wishes @ reduced.stiffness_matrix * 2e-9
    ports = by_name(PortCoupling(name, force, 1e-9) for name, force in zip("ab", forces, strict=True))
    return replace(reduced, readouts=ports)


def fitted_out(kind, fidelity="linear", *, nods="by a torque", circuits=True, gravity=1.0, **options):
    """The machine with ports on its bars, a dial on its bob, and a damped spring between the dial and the load.

    nods: how the dial turns on the bob, "by a torque" on a spring, "by a servo" or "steadily"
    """
    plain = machine(kind, fidelity)
    bodies = []
    for body in plain.bodies:
        changes = {}
        if body.deforms:
            ratio = [0.02, 0.05] if body.name.startswith("left") else None
            changes = {"reduced": with_ports(body.reduced), "damping_ratio": ratio}
        elif body.name == "bob":
            changes = {"points": {**body.points, "axle": NECK - BOB}}
        bodies.append(replace(body, **changes))
    points = {"axle": NECK - DIAL, "tip": np.array([0.0, 0.01, 0.02])}
    bodies.append(RigidBody("dial", points, 0.15, inertia(3e-5, 1.0, 1.3, 0.9), DIAL))
    springs = [*plain.springs, SpringDamper("bind", "dial.tip", "load.rim", "line", 800.0, 1.5)]
    moved = {"by a servo": {"input": "nod", "bandwidth": 70.0}, "steadily": {"speed": 4.0}}.get(nods)
    if moved:
        nod = Drive("nod", "neck", **moved)
    else:
        nod = PointTorque("nod", "dial.tip", OTHER[:, 1], "nod", frame="dial.tip")
        springs.append(SpringDamper("catch", "bob.far", "dial.tip", OTHER[:, 0], 2e4, 3.0, frame="bob.far"))
    still = "table.mount" if kind == "spinning" else "ground.q"  # linear models read nothing along the world's axes
    sensors = [
        *plain.sensors,
        Amplified("amplified"),
        VoltageSensor("open", "right/bar.b", gain=2.0),
        replace(ForceSensor("bound", "bind"), bandwidth=150.0, order=2),
        Encoder("lagging", still, "dial.tip", RAIL, frame="table.mount", bandwidth=80.0),
        Encoder("there", still, "dial.tip", OTHER[0], frame="" if kind == "resting" else "table.mount"),
    ]
    if kind == "resting":  # other linear models have no feedthrough
        sensors.append(Leaky("leaky"))
    actuators = [
        *plain.actuators,
        nod,
        LinearActuator("leg", "dial.tip", "load.a", "push"),
        VoltageDrive("amplifier", "left/bar.b", "left/voltage", gain=3.0, bandwidth=90.0),
    ]
    if circuits:
        actuators.append(VoiceCoil("coil", "table.rail", "load.c", RAIL, 5.0, 2.0, 0.01, "volts", frame="table.rail"))
        shunted = VoltageSensor("shunted", "left/bar.a", resistance=2e5, capacitance=3e-9, gain=-0.5)
        sensors += [CurrentSensor("current", "coil"), shunted]
    scene = replace(
        plain,
        bodies=bodies,
        joints=(*plain.joints, revolute("neck", "bob.axle", "dial.axle", OTHER[:, 1])),
        springs=springs,
        actuators=actuators,
        sensors=sensors,
        gravity=gravity * plain.gravity,
        quasi_static_above=np.inf,
    )
    return replace(scene, **options)


def without(scene, *kinds):
    """The scene without its sensors of some kinds."""
    return replace(scene, sensors=[one for one in scene.sensors if not isinstance(one, kinds)])


def signals(scene, n, fine=1, path=None):
    """Unlike courses of all inputs that start at rest, straight between n + 1 samples; fine: steps per sample.

    path: course of the input "angle" by the phase from 0 to 1, smooth between samples too.
    """
    time, steps = STEP * np.arange(n + 1), STEP / fine * np.arange(fine * n + 1)
    phase, values = np.pi * time / time[-1], []
    for k, name in enumerate(sorted(scene.inputs)):
        course = SIZES.get(name, 1e-5) * np.sin(phase) ** 3 * np.cos(k % 3 * phase + 0.3 * k)
        values.append(path(steps / time[-1]) if name == "angle" and path else np.interp(steps, time, course))
    return TimeHistory(steps, values, sorted(scene.inputs), [scene.input_unit(name) for name in sorted(scene.inputs)])


def read(record, scene):
    return {name: record[name] for name in (*scene.outputs, *scene.commands)}


def ran(scene, n, fine=1, path=None, **options):
    """Outputs and commands of a run, whose images show the dial where a sensor without a filter reads it."""
    given = signals(scene, n, fine, path)
    record, motion = simulate_motion(scene, given, time_step=STEP / fine, frames=3, progress=False, **options)
    (there,) = (one for one in scene.sensors if one.name == "there")
    (a, _), (b, _) = (point_motion(scene, motion, path) for path in (there.a, there.b))
    turned = point_motion(scene, motion, there.frame)[1] if there.frame else np.eye(3)
    seen = np.einsum("ni,ni->n", np.broadcast_to(turned @ there.axis, a.shape), b - a)
    seen -= there.axis @ (scene.point_position(there.b) - scene.point_position(there.a))
    small = options.get("method") == "exact" or scene.in_small_motion  # rotations by some 0.01 rad of arms of 0.1 mm
    at = np.rint(motion.time * fine / STEP).astype(int)
    np.testing.assert_allclose(seen, record["there"][at], rtol=0, atol=3e-7 if small else 1e-13)
    return read(record, scene)


def extrapolated(scene, n, path=None, fine=1, **options):
    """A run of a rule of second order with steps of no length, from two lengths, at the samples."""
    long, short = (ran(scene, n, k, path, **options) for k in (fine, 2 * fine))
    return {name: (4 * short[name][:: 2 * fine] - long[name][::fine]) / 3 for name in long}


def assert_same(found, expected, within, but=None):
    """By name, relative to the changes; but: errors of some outputs."""
    assert set(found) == set(expected)
    for name, values in expected.items():
        error = (but or {}).get(name, within) * np.ptp(values)
        np.testing.assert_allclose(found[name], values, rtol=0, atol=error + 1e-12, err_msg=name)


def in_floating_frames(scene):
    return replace(scene, bodies=[replace(one, fidelity="ffrf") if one.deforms else one for one in scene.bodies])


@pytest.mark.parametrize(
    ("nods", "options", "floats", "within"),
    [
        ("by a torque", {"constant_inputs": CONSTANT}, True, 1e-2),
        ("by a servo", {}, False, 2e-2),
        ("by a torque", {"start": "released"}, False, 2e-2),
    ],
)
def test_engines_at_rest(nods, options, floats, within):
    """Exact steps, generalized-alpha in small motion and in floating frames; released with loops.

    Fast modes of the bars ring at a coarse step, and a drive's inertia is that of masses without their correction.
    """
    scene = fitted_out("resting", nods=nods, gravity=LIGHT, loops=LOOPS if "start" in options else ())
    if nods == "by a servo":
        scene = without(scene, Accelerometer)
    exact = ran(scene, 30, method="exact", **options)
    assert_same(extrapolated(scene, 30, **options), exact, within)
    if floats:
        floating = ran(in_floating_frames(scene), 30, 2, **options)
        assert_same({name: values[::2] for name, values in floating.items()}, exact, within)


def test_engines_on_a_spindle():
    """With loops, and with a servo on the rotor whose input starts at a rate."""
    scene = fitted_out("spinning", "ffrf", nods="by a servo", circuits=False, loops=LOOPS)
    scene = without(scene, Amplified)  # whose general items take half of the time
    floating, exact = ran(scene, 24, fine=4), ran(scene, 24, method="exact")
    found = {name: values[::4] for name, values in floating.items()}
    assert_same(found, exact, 4e-2, {"left inside": 0.1})  # a ten thousandth of it changes


def test_engines_along_a_path():
    """By displacements, which exact steps read there; both ends of the path are smooth to its third derivative."""
    scene = fitted_out("led", "ffrf", circuits=False, gravity=LIGHT)
    scene = without(scene, Accelerometer, Geophone, Vibrometer)

    def path(phase):
        return 4e-3 * np.sin(np.pi * phase) ** 4

    options = {"path": path, "constant_inputs": CONSTANT_FORCES}
    assert_same(ran(scene, 60, 2, method="exact", **options), ran(scene, 60, 2, **options), 3e-2)


def test_explicit_steps():
    """They hold inputs from step to step, and so do exact steps of order 0."""
    scene = without(fitted_out("resting", circuits=False, loops=LOOPS), Accelerometer, Geophone)
    given = signals(scene, 24, 8)
    options = {"time_step": STEP / 8, "progress": False, "constant_inputs": CONSTANT_FORCES}
    exact, explicit = (
        read(simulate(scene, given, method=method, **options, **more), scene)
        for method, more in (("exact", {"hold_order": 0}), ("explicit", {}))
    )
    assert_same(explicit, exact, 2e-4, {"right inside": 1e-3, "open": 1e-3})  # the fastest modes


def test_programs_and_steps_of_ones_own(tmp_path):
    """The records of exact steps, of steps one by one and of C code are one, with loops at two rates.

    The fastest modes are quasi-static, whose outputs show the commands of this sample.
    """
    scene = fitted_out("resting", loops=LOOPS, quasi_static_above=300.0)
    given = signals(scene, 24)
    options = {"time_step": STEP, "hold_order": 1, "constant_inputs": CONSTANT}
    exact = read(simulate(scene, given, method="exact", progress=False, **options), scene)
    with Simulation(scene, method="exact", **options) as run:
        for values in given.values.T[1:]:
            run.step(dict(zip(given.names, values.tolist(), strict=True)))
    assert_same(read(run.record, scene), exact, 1e-12)
    inputs = np.array([given[name] for name in scene.inputs])
    found = [run_program(scene_program(scene, **options), inputs)]
    if COMPILER:
        found.append(run_c(export_c(scene, tmp_path, "machine", allow_unstable=True, **options), inputs))
    for values in found:
        assert_same(dict(zip(exact, values, strict=True)), exact, 1e-9)


def by_scipy(matrices, given, names, start):
    """The outputs of a linear model whose inputs start at zero and run straight between samples."""
    *system, _ = scipy.signal.cont2discrete(matrices, STEP, "foh")
    return scipy.signal.dlsim((*system, STEP), np.transpose([given[name] for name in names]), x0=start)[1].T


@pytest.mark.parametrize("kind", ["resting", "spinning"])
def test_linear_models_step_as_runs_do(kind):
    """From their equilibrium."""
    scene = fitted_out(kind, "ffrf" if kind == "spinning" else "linear")
    given = signals(scene, 24)
    constant = {name: value for name, value in CONSTANT.items() if kind == "resting"}
    options = {"time_step": STEP, "progress": False, "method": "exact", "constant_inputs": constant}
    exact = read(simulate(scene, given, **options), scene)
    model = linearize(scene, constant_inputs=constant)
    found = by_scipy((model.A, model.B, model.C, model.D), given, model.inputs, 0 * model.A[0])
    moves = {name: values - values[0] for name, values in exact.items()}
    assert_same(dict(zip(model.outputs, found, strict=True)), moves, 1e-6)


def test_continuous_programs_run_as_steps_do():
    """From their start; modes that steps do not follow are quasi-static in both."""
    scene = fitted_out("resting", quasi_static_above=0.5 / STEP)
    given = signals(scene, 24)
    rates = scene_rates(scene, constant_inputs=CONSTANT)
    found = by_scipy(rates.matrices, given, scene.inputs, rates.start)
    options = {"time_step": STEP, "progress": False, "constant_inputs": CONSTANT}
    exact = read(simulate(scene, given, method="exact", **options), scene)
    assert_same(dict(zip(scene.outputs, found, strict=True)), exact, 1e-6)


def test_sampled_closed_loops_step_as_runs_do():
    """With set points, feedforward and loops of two delays; both keep their inputs from sample to sample.

    Without gravity, whose deflection loops would answer at the start, without limits, and without an output that a
    command moves at once: a run reads it before the command jumps, the model after it.
    """
    loops = [replace(one, controller=replace(one.controller, limit=np.inf)) for one in LOOPS if one.name in HELD]
    scene = without(fitted_out("resting", gravity=0.0, loops=loops), Leaky)
    model, given = linearize_closed(scene), signals(scene, 80)
    given = replace(given, time=given.time[::2], values=given.values[:, ::2])
    run = simulate(scene, given, time_step=model.time_step, method="exact", hold_order=0, progress=False)
    system = model.A, model.B, model.C, model.D, model.time_step
    found = scipy.signal.dlsim(system, np.transpose([given[name] for name in model.inputs]))[1].T
    moves = {name: run[name] - run[name][0] for name in model.outputs}
    assert_same(dict(zip(model.outputs, found, strict=True)), moves, 1e-6)


def rigid_rows(reduced):
    """Momentum and angular momentum about the centre of mass per rates of a reduced body's coordinates, (6, n)."""
    moves = np.zeros((len(reduced.mass_matrix), 6))
    for k, point in enumerate(reduced.remote_points):
        moves[6 * k : 6 * k + 6] = np.eye(6)
        moves[6 * k : 6 * k + 3, 3:] = np.cross(np.eye(3), point.position - reduced.center_of_mass).T
    return moves.T @ reduced.mass_matrix


def test_a_free_machine_keeps_its_momentum():
    """Under weight, with drives, loads within it, preloads and friction: the centre of mass falls, the rest goes on.

    Within 3e-5, the error of second order of the steps and of the velocities, which are differences of images.
    """
    scene = fitted_out("resting", "ffrf", nods="steadily")
    springs = [replace(one, preload=0.1) if one.name in ("stay", "bind", "return") else one for one in scene.springs]
    outside = PointForce, PointTorque, GroundAcceleration
    scene = replace(
        scene,
        bodies=[replace(one, angular_velocity=3.0 * RAIL * (one.name == "load")) for one in scene.bodies if one.moves],
        actuators=[one for one in scene.actuators if not isinstance(one, outside)],
        springs=[one for one in springs if one.name not in ("mount", "prop")],
        sensors=[one for one in scene.sensors if one.name not in ("there", "lagging")],
    )
    options = {"time_step": STEP, "frames": 25, "start": "released", "progress": False}
    motion = simulate_motion(scene, signals(scene, 24), **options)[1]

    def rate(values):
        return (values[2:] - values[:-2]) / (2 * STEP)

    masses, places, spins = [], [], []
    for body in scene.bodies:
        mass, centre, spread = body.rigid_inertia
        place, turns = motion.positions[body.name], motion.rotations[body.name] @ body.rotation.T
        turned = Rotation.from_matrix(turns[2:] @ turns[:-2].transpose(0, 2, 1)).as_rotvec() / (2 * STEP)
        spin = np.einsum("nij,jk,nlk,nl->ni", turns[1:-1], spread, turns[1:-1], turned)
        if body.deforms:
            own, axes = motion.coordinates[body.name] @ rigid_rows(body.reduced).T, motion.rotations[body.name]
            place = place + np.einsum("nij,nj->ni", axes, own[:, :3]) / mass
            spin = spin + np.einsum("nij,nj->ni", axes[1:-1], rate(own[:, 3:]))
        masses.append(mass)
        places.append(place + turns @ (centre - body.position))
        spins.append(spin)
    middle = np.average(places, axis=0, weights=masses)
    falls = 2 * np.polynomial.polynomial.polyfit(motion.time, middle, 2)[2]
    np.testing.assert_allclose(falls, scene.gravity, rtol=0, atol=3e-5 * np.linalg.norm(scene.gravity))
    arms = [place - middle for place in places]
    momentum = sum(
        mass * np.cross(arm[1:-1], rate(arm)) + spin for mass, arm, spin in zip(masses, arms, spins, strict=True)
    )
    assert np.ptp(momentum, axis=0).max() < 3e-5 * sum(np.linalg.norm(spin, axis=1).max() for spin in spins)


def test_static_gains():
    """Of all inputs at once: linear models, statics in small motion and in floating frames, under opposite loads."""
    scene = fitted_out("resting", gravity=LIGHT)
    model = linearize(scene, constant_inputs=CONSTANT)
    gains = frequency_response(model, [0.0]).values[..., 0].real
    expected = dict(zip(model.outputs, gains @ [SIZES[name] for name in model.inputs], strict=True))
    loads = [{name: CONSTANT.get(name, 0.0) + sign * SIZES[name] for name in model.inputs} for sign in (1, -1)]
    for one in (scene, in_floating_frames(scene)):
        more, less = (static_response(one, each) for each in loads)
        for name, change in expected.items():
            assert 0.5 * (more[name] - less[name]) == pytest.approx(change, rel=5e-3, abs=1e-10), name
