"""Runs that are stepped one by one: against `simulate`, against own loops over matrices, from saved states."""

import gc
import math
import weakref
from dataclasses import replace

import exudyn as exu
import numpy as np
import pytest
import scipy
from conftest import lattice

from nassim import (
    AngleSensor,
    Encoder,
    FlexibleBody,
    Joint,
    Loop,
    PointForce,
    PythonController,
    RigidBody,
    Scene,
    Simulation,
    SpringDamper,
    TimeHistory,
    VoltageDrive,
    VoltageSensor,
    craig_bampton,
    linearize,
    prismatic,
    revolute,
    simulate,
    simulate_motion,
)
from nassim.bodies.piezo import PortCoupling
from nassim.scene.drives import Drive
from nassim.scene.instruments import Accelerometer, Geophone, Vibrometer
from nassim.simulation import SimulationError, assemble
from nassim.simulation.exudyn.system import build_system
from nassim.simulation.linear.closed_linearization import linearize_closed
from nassim.simulation.linear.exact_steps import ExactSteps, exact_response
from nassim.simulation.run import preparation
from nassim.systems.controllers import Controller

STEP = 1e-4
ODD = np.array([[1, 0, 0], [0, 0.8, -0.6], [0, 0.6, 0.8]])
WAYS = ("exact", "linear", "ffrf")
ACROSS = (0.6, 0.0, 0.8)


class Scheduled:
    """A velocity feedback whose gain grows with the position, with a deadband and a limit of its own."""

    def __init__(self, gain=30.0, growth=3e9, deadband=2e-4, most=0.15):
        self.gain, self.growth, self.deadband, self.most = gain, growth, deadband, most
        self.before, self.calls = 0.0, []

    def output(self, measured, time):
        (position,) = measured
        speed, self.before = (position - self.before) * 1e4, position
        self.calls.append(time)
        active = math.copysign(max(abs(speed) - self.deadband, 0.0), speed)
        return np.clip(-(self.gain + self.growth * position**2) * active, -self.most, self.most)


@pytest.fixture(scope="module")
def bar():
    return craig_bampton(lattice(stiffness=1e5), n_modes=2, progress=False)


def scene(bar, way, *loops, **options):
    """A bar in an odd direction, clamped, pushed and measured at its end, with a velocity sensor."""
    start = np.array([0.1, 0.2, 0.3])
    body = FlexibleBody(
        "bar", bar, start - ODD @ bar.point("left").position, ODD, "ffrf" if way == "ffrf" else "linear"
    )
    ground = RigidBody("ground", {"o": start, "e": body.point_position("right")}, fixed=True)
    return Scene(
        "bar",
        (ground, body),
        (Joint("clamp", "ground.o", "bar.left"),),
        springs=(SpringDamper("soft", "ground.e", "bar.right", "z", 200.0, 0.05),),
        sensors=(Encoder("x", "ground.e", "bar.right", ACROSS), Vibrometer("v", "bar.right", ACROSS)),
        actuators=(PointForce("f", "bar.right", ACROSS, "f"),),
        damping_ratio=0.02,
        loops=loops,
        **options,
    )


def test_checks_of_exact_steps_see_the_coordinates_of_whole_runs(bar):
    """At the first sample of each block, and on request now, also in the midst of a block."""
    slow = Controller(*np.array([[[0.9]], [[1.0]], [[-2.0]], [[0.0]]]), sample_rate=2500.0, delay=1)
    assembly = assemble(scene(bar, "exact", Loop("slow", slow, "v", "f")))
    n = 270
    values = excitation(n).values
    *_, expected = exact_response(assembly, values, STEP, kept=range(n + 1))
    run, known = ExactSteps(assembly, values[:, 0], STEP, hold_order=1, released=False), set()
    for k in range(1, n + 1):
        run.step(values[:, k])
        for now in (False, True):
            sample, found = run.coordinates(now=now)
            assert sample == k if now else k - 8 < sample <= k
            np.testing.assert_allclose(found, expected[:, sample], atol=1e-9 * np.abs(expected).max())
            known.add(k - sample)
    assert known == set(range(4))


def test_the_end_of_exact_steps_is_checked_within_a_block(bar):
    def run():
        with Simulation(scene(bar, "exact"), time_step=STEP, method="exact") as steps:
            for k in range(303):
                steps.step({"f": 1e5 * (k > 300)})

    with pytest.warns(UserWarning, match="body 'bar' is deformed by up to"):
        run()


class Break(BaseException):
    """What, like Ctrl-C, is no Exception."""


class Interrupted:
    """A controller that is broken off while it computes, after the first sample."""

    def output(self, measured, time):
        if time:
            raise Break
        return np.zeros(1)


def test_a_run_that_is_interrupted_within_a_step_cannot_go_on(bar):
    loop = Loop("own", PythonController(Interrupted(), sample_rate=1e4), "x", "f")
    with Simulation(scene(bar, "exact", loop), time_step=STEP, method="exact") as run:
        with pytest.raises(Break):
            run.step()
        with pytest.raises(RuntimeError, match="it was interrupted within a step"):
            run.step()


def excitation(n, name="f", unit="N", size=1.0):
    time = STEP * np.arange(n + 1)
    burst = np.exp(-(((time / time[-1] - 0.4) / 0.17) ** 2))
    return TimeHistory(time, size * burst * np.sin(740 * time)[None], (name,), (unit,))


def options(way):
    return {"method": "exact" if way == "exact" else "generalized_alpha"}


def stepped(run, values, name="f"):
    """Signals of a run that is stepped through values, from the present on, (n + 1, signals)."""
    return np.array([[*run.outputs.values()]] + [[*run.step({name: value}).values()] for value in values])


def scheduled_loop(law=None, **others):
    return Loop("own", PythonController(law or Scheduled(), sample_rate=1e4, **others), "x", "f")


def by_matrices(closed, push):
    """Own time loop: matrix exponential of the linear model, straight inputs, the command held in a step."""
    model = linearize(replace(closed, loops=()))
    n = len(model.A)
    whole = np.zeros((n + 2, n + 2))
    whole[:n, :n], whole[:n, n], whole[n, n + 1] = model.A, model.B[:, 0], 1.0
    phi, law, waiting, x, rows = scipy.linalg.expm(whole * STEP), Scheduled(), 0.0, np.zeros(n), []
    row = model.outputs.index("x")
    for k, now in enumerate(push):
        following = push[min(k + 1, len(push) - 1)]
        y = model.C @ x
        command, waiting = waiting, float(law.output(y[[row]], k * STEP))
        rows.append([*y, command])
        x = (phi @ [*x, now + command, (following - now) / STEP])[:n]
    return np.array(rows)


@pytest.mark.parametrize(("way", "share"), [("exact", 1e-9), ("linear", 0.02), ("ffrf", 0.02)])
def test_a_controller_in_python_against_an_own_loop_over_matrices(bar, way, share):
    push = excitation(600)
    closed = scene(bar, way, scheduled_loop())
    expected = by_matrices(closed, push.values[0])
    law = closed.loops[0].controller.law
    record = simulate(closed, push, time_step=STEP, progress=False, **options(way))
    assert law.calls == []  # the run has its own
    opened = simulate(replace(closed, loops=()), push, time_step=STEP, progress=False, **options(way))
    assert np.abs(opened["x"][-100:]).max() > 1.3 * np.abs(record["x"][-100:]).max()
    commands = record["own"]
    assert np.abs(commands).max() == 0.15
    assert 0.02 < np.mean(np.abs(commands) == 0.15) < 0.9
    for k, name in enumerate(("x", "v", "own")):
        size = np.abs(expected[:, k]).max()
        np.testing.assert_allclose(record[name], expected[:, k], rtol=0, atol=share * size)


@pytest.mark.parametrize("way", WAYS)
def test_steps_one_by_one_are_those_of_simulate(bar, way):
    push = excitation(300, size=0.5)
    closed = scene(bar, way, scheduled_loop(delay=0), gravity=(0.0, 0.3, -0.2))
    whole = simulate(closed, push, time_step=STEP, progress=False, **options(way))
    with Simulation(closed, time_step=STEP, **options(way)) as run:
        assert run.time == 0.0
        assert run.outputs == {name: whole[name][0] for name in ("x", "v", "own")}
        rows = stepped(run, push.values[0][1:])
        assert run.time == pytest.approx(300 * STEP)
    for name, row in zip(("x", "v", "own"), rows.T, strict=True):
        np.testing.assert_array_equal(row, whole[name])
    for name in whole.names:
        np.testing.assert_array_equal(run.record[name], whole[name])
    assert run.record.units == whole.units


@pytest.mark.parametrize("order", [0, 1])
@pytest.mark.parametrize("limit", [math.inf, 1e-4])
def test_exact_steps_one_by_one_are_those_of_blocks(bar, order, limit):
    """Here `simulate` takes many samples at once; with a linear loop at a slower rate that meets its limit, too."""
    gain = Controller(np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), [[-10.0]], 5e3, limit=limit)
    closed = scene(bar, "exact", Loop("p", gain, "x", "f"), gravity=(0.0, 0.3, -0.2))
    push = excitation(700)
    whole = simulate(closed, push, time_step=STEP, progress=False, method="exact", hold_order=order)
    assert 0 < np.mean(np.abs(whole["p"]) < 1e-4 * (1 - 1e-9)) < 1
    with Simulation(closed, time_step=STEP, method="exact", hold_order=order) as run:
        stepped(run, push.values[0][1:])
    for name in whole.names:
        np.testing.assert_array_equal(run.record[name], whole[name])


class Amplified(PointForce):
    """A force behind an amplifier."""

    def terms(self, scene):
        return tuple(replace(term, bandwidth=20.0) for term in super().terms(scene))


def turning_scene():
    """A pendulum pushed by an amplifier beside a motor, with all kinds of readings that are no sums of columns."""
    ground = RigidBody("ground", {"o": np.zeros(3), "m": np.array([0.3, 0.0, 0.0])}, fixed=True)
    arm = RigidBody(
        "arm", {"o": np.array([0.0, 0.0, 0.2]), "e": np.array([0.05, 0.0, -0.1])}, 0.5, np.diag([2e-3, 3e-3, 2e-3])
    )
    arm = replace(arm, position=np.array([0.0, 0.0, -0.2]))
    rotor = RigidBody("rotor", {"o": np.zeros(3)}, 0.2, np.diag([1e-3, 2e-3, 1e-3]), np.array([0.3, 0.0, 0.0]))
    return Scene(
        "turning",
        (ground, arm, rotor),
        (revolute("hinge", "ground.o", "arm.o", (0.0, 0.8, 0.6)), revolute("axle", "ground.m", "rotor.o", "y")),
        springs=(SpringDamper("s", "arm.e", "rotor.o", "x", 3.0, 0.2),),
        sensors=(
            AngleSensor("a", "ground.o", "arm.o", (0.0, 0.8, 0.6)),
            Accelerometer("acc", "arm.e", "x", resonance=80.0, damping_ratio=0.5),
            Encoder("d", "rotor.o", "arm.e", "z"),
            AngleSensor("r", "ground.m", "rotor.o", "y"),
        ),
        actuators=(
            Amplified("f", "arm.e", "x", "f"),
            Drive("motor", "axle", "rz", "angle"),
        ),
        gravity=(0.0, 0.0, -9.81),
    )


def test_steps_in_large_motion_with_filters_amplifiers_and_drives():
    n, rated = 180, 40.0
    time = 1e-3 * np.arange(n + 1)
    values = np.array([3 * np.sin(20 * time), rated * time])
    push = TimeHistory(time, values, ("f", "angle"), ("N", "rad"))
    some = turning_scene()
    setting = {"time_step": 1e-3, "start": "released", "spectral_radius": 0.75}
    whole = simulate(some, push, progress=False, **setting)
    assert whole["r"][-1] > 2 * np.pi
    with Simulation(some, **setting, input_rates={"angle": rated}) as run:
        for f, angle in values[:, 1:].T[:60]:
            run.step({"f": f, "angle": angle})
        saved = run.state
        for f, angle in values[:, 61:].T:
            run.step({"f": f, "angle": angle})
    with Simulation(some, **setting) as other:
        other.restore(saved)
        for f, angle in values[:, 61:].T:
            other.step({"f": f, "angle": angle})
    for name in whole.names:
        np.testing.assert_array_equal(run.record[name], whole[name])  # reading the state has changed nothing
        np.testing.assert_array_equal(other.record[name], whole[name])


@pytest.fixture(scope="module")
def piezo_bar():
    """A bar with two electrical ports, which stretch a layer each."""
    plain = lattice(stiffness=1e5)
    x, ports = plain.fields[1], []
    for name, start, end in (("drive", 0.0, 0.01), ("sense", 0.02, 0.03)):
        along = (np.isclose(x, end).astype(float) - np.isclose(x, start)) / 9
        ports.append(PortCoupling(name, np.concatenate([along, 0 * along, 0 * along]), 1e-6))
    return craig_bampton(replace(plain, ports=tuple(ports)), n_modes=2, progress=False)


def piezo_scene(body, way):
    """The bar in an odd direction: an amplifier drives one port, a resistance drains the other; filters and loops."""
    lag = Controller([[0.9]], [[0.1]], [[-5.0]], [[0.0]], 5e3, delay=2)
    some = scene(body, way, scheduled_loop(delay=1), Loop("lag", lag, "x", "f"))
    return replace(
        some,
        sensors=(
            some.sensors[0],
            Geophone("v", "bar.right", ACROSS),
            VoltageSensor("charge", "bar.sense", resistance=300.0),
        ),
        actuators=(*some.actuators, VoltageDrive("stack", "bar.drive", "voltage", gain=3.0, bandwidth=150.0)),
    )


@pytest.mark.parametrize("way", WAYS)
def test_a_restored_state_goes_on_to_the_last_bit(piezo_bar, way):
    """In the same run and in another one, as without a state; amplifiers, charges, filters and controllers with it.

    Steps give one of two inputs by turns, so that the other keeps its value.
    """
    closed, values = piezo_scene(piezo_bar, way), excitation(160).values[0]

    def run_through(run, part):
        for k in range(len(values))[part]:
            run.step({"f": values[k]} if k % 2 else {"voltage": 2 * values[k] ** 2})

    def unbroken(run):
        run_through(run, slice(1, None))
        return run.record

    with Simulation(closed, time_step=STEP, **options(way)) as run:
        whole = unbroken(run)
    with Simulation(closed, time_step=STEP, **options(way)) as run:
        run_through(run, slice(1, 61))
        saved = run.state
        run_through(run, slice(61, None))
        first = run.record
        run.restore(saved)
        assert run.time == pytest.approx(60 * STEP)
        run_through(run, slice(61, None))
    with Simulation(closed, time_step=STEP, **options(way)) as other:
        run_through(other, slice(80, 20, -1))
        other.restore(saved)
        run_through(other, slice(61, None))
    for name in whole.names:
        assert np.ptp(whole[name][60:]) > 0.1 * np.ptp(whole[name]) > 0.0
        for record in (first, run.record, other.record):
            np.testing.assert_array_equal(record[name], whole[name])


def test_a_restored_state_knows_the_inputs_of_its_block_of_linear_steps(bar):
    values = excitation(160).values[0]
    with Simulation(scene(bar, "exact"), time_step=STEP, method="exact") as run:
        stepped(run, values[1:62])
        saved = run.state
        whole = stepped(run, values[62:])
        run.restore(saved)
        np.testing.assert_array_equal(stepped(run, values[62:]), whole)


def sledge(law):
    """A mass of 1 kg on a guide, with a loop whose controller has a law in Python."""
    body = RigidBody("sledge", {"o": np.zeros(3)}, 1.0, 1e-3 * np.eye(3))
    ground = RigidBody("ground", {"o": np.zeros(3)}, fixed=True)
    return Scene(
        "sledge",
        (ground, body),
        (prismatic("guide", "ground.o", "sledge.o", "z"),),
        (PointForce("f", "sledge.o", "z", "f"),),
        (Encoder("x", "ground.o", "sledge.o", "z"),),
        loops=(scheduled_loop(law),),
    )


def test_a_restored_state_knows_how_far_the_forces_until_then_moved_bodies():
    """A sledge that a loop drives away: as soon as without the large pushes before its state is restored."""

    class Late:
        def output(self, measured, time):
            return (time > 0.01) * 1e5 * measured

    ends = []
    for push in (0.0, 1e4):
        with Simulation(sledge(Late()), time_step=STEP, method="exact") as run:
            saved = run.state
            stepped(run, push * (-1.0) ** np.arange(100))
            run.restore(saved)
            with pytest.raises(SimulationError, match="runs away") as caught:
                stepped(run, np.full(1000, 0.01))
        ends.append(caught.value.record.time[-1])
    assert 0.01 < ends[0] == ends[1] < 0.1


@pytest.mark.parametrize("method", ["exact", "generalized_alpha"])
def test_the_last_look_at_a_run_counts_all_pushes_since_the_one_before(method):
    """They account for where the sledge is when the block ends, so no loop has run away."""

    class Idle:
        def output(self, measured, time):
            return 0.0 * measured

    with Simulation(sledge(Idle()), time_step=STEP, method=method) as run:
        stepped(run, np.full(49, 1e4))
    assert run.record["x"][-1] == pytest.approx(0.5 * 1e4 * (49 * STEP) ** 2, rel=0.05)


def test_two_runs_at_once(bar):
    values = excitation(60).values[0]
    with (
        Simulation(scene(bar, "ffrf"), time_step=STEP) as one,
        Simulation(scene(bar, "ffrf"), time_step=STEP) as two,
        Simulation(scene(bar, "linear"), time_step=STEP),
    ):
        for value in values[1:]:
            one.step({"f": value})
            two.step({"f": -2 * value})
            if value == values[30]:  # a whole run within the block of another
                simulate(scene(bar, "ffrf"), excitation(60), time_step=STEP, progress=False)
    with Simulation(scene(bar, "ffrf"), time_step=STEP) as alone:
        stepped(alone, values[1:])
    np.testing.assert_array_equal(one.record["x"], alone.record["x"])
    assert np.abs(two.record["x"]).max() > 1.5 * np.abs(one.record["x"]).max()


@pytest.mark.parametrize("way", ["linear", "ffrf"])
def test_a_run_leaves_no_system_behind(bar, way, monkeypatch):
    systems = []

    def build(*arguments):
        system = build_system(*arguments)
        systems.append(weakref.ref(system))
        return system

    monkeypatch.setattr(preparation, "build_system", build)
    simulate(scene(bar, way, scheduled_loop()), excitation(60), time_step=STEP, progress=False)
    with Simulation(scene(bar, way, scheduled_loop()), time_step=STEP) as run:
        run.step({"f": 1.0})
        assert systems[1]()
    gc.collect()
    assert [system() for system in systems] == [None, None]


def test_inputs_keep_their_value_and_start_where_told(bar):
    with Simulation(scene(bar, "exact"), time_step=STEP, method="exact", inputs={"f": 2.0}) as run:
        run.step()
        run.step({"f": 3.0})
        run.step({})
    np.testing.assert_array_equal(run.record["f"], [2.0, 2.0, 3.0, 3.0])


def test_without_the_period_correction_steps_are_the_trapezoidal_rule(bar):
    """Against the rule on the linear model; with the correction, against exact steps, at 8 steps a period."""
    free = replace(scene(bar, "linear"), damping_ratio=0.0, springs=())
    model, values = linearize(free), np.exp(-(((np.arange(161) - 24) / 4) ** 2))
    step = 2 * np.pi / np.min(np.abs(model.poles())) / 8
    half, x, rows = np.eye(len(model.A)) * 2 / step, np.zeros(len(model.A)), []
    for now, following in zip(values, [*values[1:], 0.0], strict=True):
        rows.append((model.C @ x)[0])
        x = np.linalg.solve(half - model.A, (half + model.A) @ x + model.B[:, 0] * (now + following))
    exact, plain, corrected = [], [], []
    for found, setting in (
        (exact, {"method": "exact"}),
        (plain, {"period_correction": False}),
        (corrected, {"period_correction": True}),
    ):
        with Simulation(free, time_step=step, **setting) as run:
            found.extend(stepped(run, values[1:])[:, 0].tolist())
    size = np.abs(rows).max()
    np.testing.assert_allclose(plain, rows, rtol=0, atol=1e-6 * size)
    errors = [np.abs(np.subtract(found, exact)[-40:]).max() / np.abs(exact).max() for found in (plain, corrected)]
    assert errors[0] > 0.5
    assert errors[1] < 0.2 * errors[0]
    push = excitation(40)
    whole = simulate(free, push, time_step=STEP, period_correction=False, progress=False)
    with Simulation(free, time_step=STEP, period_correction=False) as run:
        np.testing.assert_array_equal(stepped(run, push.values[0][1:])[:, 0], whole["x"])
    with pytest.raises(ValueError, match=r'period_correction is of "generalized_alpha"; method .exact. has none'):
        Simulation(free, time_step=step, method="exact", period_correction=False)


class Faulty:
    """Works for a while."""

    def __init__(self, value, after=20):
        self.value, self.after = value, after

    def output(self, measured, time):
        if time < (self.after - 0.5) * STEP:
            return 0.0
        if isinstance(self.value, Exception):
            raise self.value
        return self.value


@pytest.mark.parametrize(
    ("way", "value", "told"),
    [
        (
            "exact",
            math.nan,
            r"loop 'own': its controller, a Faulty in Python, returned \[nan\] at t = 0\.002 s; commands must",
        ),
        ("linear", np.zeros(2), r"returned an array of shape \(2,\) at t = 0\.002 s; it must return one command"),
        ("ffrf", KeyError("gain"), r"raised KeyError at t = 0\.002 s: 'gain'"),
    ],
    ids=["nan", "shape", "error"],
)
def test_a_controller_that_fails_keeps_the_record(bar, way, value, told):
    closed, push = scene(bar, way, scheduled_loop(Faulty(value))), excitation(50)
    with pytest.raises(SimulationError, match=told) as caught:
        simulate(closed, push, time_step=STEP, progress=False, **options(way))
    assert len(caught.value.record.time) == 20
    assert isinstance(caught.value.__cause__, KeyError if isinstance(value, KeyError) else type(None))
    with Simulation(closed, time_step=STEP, **options(way)) as run:
        stepped(run, push.values[0][1:20])
        with pytest.raises(SimulationError, match=told) as again:
            run.step({"f": push.values[0][20]})
        with pytest.raises(RuntimeError, match=r"this Simulation cannot go on: it has failed at t = 0\.0019 s"):
            run.step()
    for name in ("x", "v", "own"):
        np.testing.assert_array_equal(again.value.record[name], caught.value.record[name])
    at_once = scene(bar, way, scheduled_loop(Faulty(value, after=0)))
    with (
        pytest.raises(SimulationError, match="at t = 0 s") as first,
        Simulation(at_once, time_step=STEP, **options(way)),
    ):
        pass
    assert first.value.record is None
    for after in (1, 2):  # a record has two samples at least
        with pytest.raises(SimulationError) as early:
            simulate(scene(bar, way, scheduled_loop(Faulty(value, after))), push, time_step=STEP, **options(way))
        assert (early.value.record is None) == (after == 1)


def test_a_record_until_a_controller_fails_is_trusted_while_motion_is_small(bar):
    """Until a growing force has moved the bar's end by a hundredth of its radius of gyration; the failure is later."""
    push = excitation(400)
    push = replace(push, values=100.0 * np.linspace(0.0, 1.0, 401)[None] ** 2)
    closed = scene(bar, "exact", scheduled_loop(Faulty(math.nan, after=300)))
    with pytest.raises(SimulationError, match=r"returned \[nan\] at t = 0\.03 s") as caught:
        simulate(closed, push, time_step=STEP, progress=False, method="exact")
    _, motion = simulate_motion(scene(bar, "exact"), push, time_step=STEP, method="exact", frames=401, progress=False)
    radius = np.sqrt(np.trace(bar.gram[1:4, 1:4]) / bar.mass - bar.center_of_mass @ bar.center_of_mass)
    large = np.abs(motion.coordinates["bar"][:, 6:9]).max(axis=1) > 0.01 * radius
    last = motion.time[np.argmax(large) - 1]
    assert last - 2.5 * STEP < caught.value.trusted_until <= last < 0.02
    assert caught.value.record.time[-1] == pytest.approx(0.0299)


@pytest.mark.parametrize("way", WAYS)
def test_a_loop_that_runs_away_is_told(bar, way):
    class Wrong:
        def output(self, measured, time):
            return 2e6 * (measured[0] + 1e-9)

    def run_away(run):
        for _ in range(3000):
            run.step({"f": 0.01})

    with (
        Simulation(scene(bar, way, scheduled_loop(Wrong())), time_step=STEP, **options(way)) as run,
        pytest.raises(SimulationError, match=r"runs away|integration failed") as caught,
    ):
        run_away(run)
    push = TimeHistory(STEP * np.arange(3001), np.append(0.0, np.full(3000, 0.01))[None], ("f",), ("N",))
    with pytest.raises(SimulationError, match=r"runs away|integration failed") as at_once:
        simulate(scene(bar, way, scheduled_loop(Wrong())), push, time_step=STEP, progress=False, **options(way))
    records = caught.value.record, at_once.value.record
    n = min(len(record.time) for record in records)
    assert n > 20
    for name in records[0].names:
        np.testing.assert_array_equal(records[0][name][:n], records[1][name][:n])


@pytest.mark.parametrize("way", ["linear", "ffrf"])
def test_a_run_that_diverges_keeps_its_record(bar, way):
    message = r"diverges: at t = \S+ s body 'bar' is deformed|integration failed"
    with Simulation(scene(bar, way), time_step=STEP) as run, pytest.raises(SimulationError, match=message) as caught:
        stepped(run, np.full(200, 1e6))
    assert len(caught.value.record.time) == len(run.record.time) > 5
    assert caught.value.trusted_until < run.record.time[-1]
    with pytest.raises(RuntimeError, match="cannot go on: it has failed at t ="):
        run.step()
    with (
        pytest.raises(SimulationError, match=message) as at_end,
        Simulation(scene(bar, way), time_step=STEP) as short,
    ):
        stepped(short, np.full(3, 1e6))
    assert len(at_end.value.record.time) == 4


@pytest.mark.parametrize("way", WAYS)
def test_a_step_that_is_interrupted_ends_the_run_and_keeps_the_record(bar, way):
    class Stopping:
        def output(self, measured, time):
            if time > 9.5 * STEP:
                raise KeyboardInterrupt
            return 0.0

    with Simulation(scene(bar, way, scheduled_loop(Stopping())), time_step=STEP, **options(way)) as run:
        stepped(run, np.ones(9))
        with pytest.raises(KeyboardInterrupt):
            run.step()
        with pytest.raises(RuntimeError, match="cannot go on: it was interrupted within a step"):
            run.step()
    assert len(run.record.time) == 10


def test_what_a_simulation_refuses(bar):
    some = scene(bar, "exact")
    run = Simulation(some, time_step=STEP, method="exact")
    with pytest.raises(RuntimeError, match=r"cannot go on: it has not begun: use it as `with Simulation"):
        run.step()
    with pytest.raises(ValueError, match="a run has a record after its first step"):
        _ = run.record
    with run:
        for wrong, told in (({"g": 1.0}, "unknown input 'g'"), ({"f": math.nan}, "input 'f' holds 1 value")):
            with pytest.raises(ValueError, match=told):
                run.step(wrong)
        run.step({"f": 1.0})
        state = run.state
    for late in (run.step, lambda: run.outputs, lambda: run.state, lambda: run.restore(state)):
        with pytest.raises(RuntimeError, match="cannot go on: its block has ended"):
            late()
    with pytest.raises(RuntimeError, match="a Simulation runs once"):
        run.__enter__()
    for other in (Simulation(scene(bar, "exact"), time_step=STEP, method="exact"), Simulation(some, time_step=STEP)):
        with other, pytest.raises(ValueError, match="restore it in a run of the same scene and options"):
            other.restore(state)
    with (
        Simulation(some, time_step=STEP, method="exact") as other,
        pytest.raises(ValueError, match="restore takes a state that a Simulation gave, got a int"),
    ):
        other.restore(1)
    with pytest.raises(ValueError, match="unknown method 'explicit'"):
        Simulation(some, time_step=STEP, method="explicit")
    for option, name, reason in (("inputs", "h", "input 'h'"), ("input_rates", "f", "input of a drive 'f'")):
        with pytest.raises(ValueError, match=f"unknown {reason}"):
            Simulation(some, time_step=STEP, **{option: {name: 1.0}})


def test_linear_models_refuse_controllers_in_python(bar):
    closed = scene(bar, "linear", scheduled_loop())
    with pytest.raises(ValueError, match=r"loop 'own': its controller, a Scheduled in Python, has no linear model"):
        linearize_closed(closed)
    with pytest.raises(ValueError, match=r"a PythonController \(Scheduled\) has no matrices, which linear models need"):
        _ = closed.loops[0].controller.A
    with pytest.raises(ValueError, match=r"law must be an object with a method output\(measured, time\), got a float"):
        PythonController(3.0, sample_rate=1e4)
    with pytest.raises(ValueError, match="controller must be a Controller or a PythonController, got a Scheduled"):
        Loop("own", Scheduled(), "x", "f")
    assert linearize(closed).inputs == ("f",)


@pytest.mark.parametrize("flexible", [True, False])
def test_newtons_iterations_of_a_step_restart_at_its_start(bar, flexible):
    """With a body whose Jacobian is renewed, and without one."""
    block = RigidBody("block", {"c": [0.1, 0.0, 0.0]}, 1.0, 1e-3 * np.eye(3), angular_velocity=(0, 0, 5.0))
    free = FlexibleBody("bar", bar, angular_velocity=(0, 0, 5.0))
    ground = RigidBody("ground", {"o": np.zeros(3)}, fixed=True)
    spring = SpringDamper("tie", "ground.o", "block.c", "z", 200.0)
    one = Scene("one", (ground, block, *((free,) if flexible else ())), springs=(spring,), damping_ratio=0.0)
    with Simulation(one, time_step=STEP) as simulation:
        data = simulation._engine.run.system.mbs.systemData
        for _ in range(2):
            before = data.GetODE2Coordinates()
            simulation.step()
        np.testing.assert_array_equal(data.GetODE2Coordinates(exu.ConfigurationType.StartOfStep), before)


def test_a_block_that_fails_tells_nothing_else(bar, monkeypatch):
    """Its run is not checked at the end, as that of a block which ends by itself is."""
    ends = []
    monkeypatch.setattr(Simulation, "_end", lambda *_: ends.append("checked"))
    with Simulation(scene(bar, "exact"), time_step=STEP, method="exact") as simulation:
        simulation.step()
    assert ends == ["checked"]
    with pytest.raises(KeyError), Simulation(scene(bar, "exact"), time_step=STEP, method="exact"):
        raise KeyError
    assert ends == ["checked"]
