"""Loops, amplifiers, forces, ground acceleration and dampers in simulations, against closed forms and each other."""

import warnings
from contextlib import contextmanager
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from conftest import lattice

from models.bench import make_bench
from nassim import (
    AngleSensor,
    Encoder,
    FlexibleBody,
    GroundAcceleration,
    Joint,
    Loop,
    PointForce,
    RigidBody,
    Scene,
    SpringDamper,
    TimeHistory,
    craig_bampton,
    frequency_response,
    linearize,
    simulate,
    static_response,
)
from nassim.base.modal import decay_poles
from nassim.scene.forces import PointTorque
from nassim.scene.springs import Bushing
from nassim.signals.excitations import low_pass
from nassim.simulation.exudyn import solver
from nassim.simulation.linear.closed_linearization import linearize_closed
from nassim.simulation.model.assembly import assemble
from nassim.simulation.model.description import describe
from nassim.simulation.model.digital_controllers import RunningControllers, RunningLoops, samples_per_period, span
from nassim.simulation.model.step_errors import command_error, describe_commands
from nassim.simulation.run import simulate as time_domain
from nassim.simulation.run.simulate import exudyn_eigenfrequencies
from nassim.systems.controllers import Controller
from nassim.systems.python_controller import PythonController

STEP = 1e-4
GAIN = Controller(np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), [[2.0]], 1e4, delay=0)


def integrator(gain, **options):
    """gain / s by Tustin's rule at 10 kHz."""
    return Controller([[1.0]], [[STEP]], [[gain]], [[gain * STEP / 2]], 1 / STEP, **options)


def pulse(name="actuator_voltage", unit="V", duration=0.2, size=0.05, time_step=STEP):
    time = np.arange(round(duration / time_step) + 1) * time_step
    return TimeHistory(time, size * np.exp(-(((time - 0.02) / 0.004) ** 2)), (name,), (unit,))


def with_iff(gain=-20.0, apa=None, fidelity="linear", **options):
    bench = make_bench(apa=apa, fidelity=fidelity, damping_ratio=0.002)
    loop_options = {key: options.pop(key) for key in ("input_step", "input_limit", "output_step") if key in options}
    loop = Loop("iff", integrator(gain, **options), "sensor_voltage", "actuator_voltage", **loop_options)
    return replace(bench, loops=(loop,))


def test_controller_computes_delays_and_saturates():
    loop = Loop("p", replace(GAIN, delay=2, limit=5.0), "y", "u", input_step=0.5, output_step=2.0)
    step = RunningControllers(loop)
    put_out = [float(step(np.array([y]))[0][0]) for y in (1.2, 0.1, -9.0, 0.0, 0.0)]
    # Read as 1.0, 0.0, -9.0; times 2, limited to 5, rounded to even numbers, two samples late.
    assert put_out == [0.0, 0.0, 2.0, 0.0, -4.0]


def test_converters_stay_within_their_range():
    step = RunningControllers(Loop("p", replace(GAIN, limit=11.0), "y", "u", output_step=4.0))
    assert [float(step(np.array([y]))[0][0]) for y in (50.0, -50.0, 4.6)] == [8.0, -8.0, 8.0]
    step = RunningControllers(Loop("p", replace(GAIN, limit=0.3), "y", "u", output_step=0.1))
    assert float(step(np.array([1.0]))[0][0]) == pytest.approx(0.3)  # 0.3 / 0.1 is 2.9999999999999996
    step = RunningControllers(Loop("p", replace(GAIN, limit=0.4), "y", "u", 0.3, 0.3, 0.4))  # one step on either side
    assert [float(step(np.array([y]))[0][0]) for y in (1.0, -1.0, 0.04)] == [0.4, -0.4, 0.0]
    with pytest.raises(ValueError, match=r"an output_step of 0\.4 has no step within the limit of 0\.3, only 0"):
        Loop("p", replace(GAIN, limit=0.3), "y", "u", output_step=0.4)


def test_integrator_state():
    step = RunningControllers(Loop("i", integrator(3.0, delay=0), "y", "u"))
    total = [float(step(np.array([1.0]))[0][0]) for _ in range(5)]
    assert np.allclose(total, 3.0 * STEP * (np.arange(5) + 0.5))


def test_loops_of_several_periods_and_delays_keep_apart():
    """Each as if it were alone, also where two drive one input: limits, anti-windup, converters and set points."""
    lag = Controller([[0.5, 0.1], [0.0, 0.3]], [[1.0], [0.4]], [[1.0, -2.0]], [[0.7]], 1e4, delay=0)
    late = replace(lag, delay=1, limit=0.8, anti_windup=[[0.3], [0.1]])
    loops = (
        Loop("a", late, "y1", "u1"),
        Loop("b", lag, "y2", "u2", reference="r1"),
        Loop("c", replace(lag, sample_rate=2.5e3, delay=2, limit=1.5), "y3", "u1", output_step=0.01, reference="r2"),
        Loop("d", replace(late, D=[[0.2]], limit=1.3), "y2", "u3", input_step=0.25, reference="r1"),
        Loop(
            "e", replace(late, limit=np.inf, anti_windup=[[0.1], [0.2]]), "y3", "u2", input_limit=0.9, output_step=0.1
        ),
    )
    inputs, outputs = ("u1", "u2", "u3", "r1", "r2"), ("y1", "y2", "y3")

    def scene(*loops):
        commands = tuple(name for loop in loops for name in loop.driven)
        return SimpleNamespace(
            loops=loops, inputs=inputs, outputs=outputs, commands=commands, commanded_inputs=commands
        )

    together, alone = RunningLoops(scene(*loops), STEP), [RunningLoops(scene(loop), STEP) for loop in loops]
    mirrored = RunningLoops(scene(*loops), STEP)  # limits and resolutions are the same to both sides
    for n, values in enumerate(np.random.default_rng(1).normal(size=(40, 8))):
        measured, given = values[:3], values[3:]
        held, end, commands = together(n, lambda measured=measured: measured, given)
        each = [step(n, lambda measured=measured: measured, given) for step in alone]
        np.testing.assert_allclose(held, sum(one[0] for one in each), atol=1e-14)
        np.testing.assert_allclose(end, sum(one[1] for one in each), atol=1e-14)
        np.testing.assert_allclose(commands, np.concatenate([one[2] for one in each]), atol=1e-14)
        opposite = mirrored(n, lambda measured=measured: -measured, -given)
        np.testing.assert_allclose(np.concatenate(opposite), -np.concatenate([held, end, commands]), atol=1e-14)


def test_a_loop_without_effect_changes_nothing(apa):
    free = make_bench(apa=apa, fidelity="linear", damping_ratio=0.002)
    idle = with_iff(0.0, apa)
    plain, looped = (simulate(s, pulse(), time_step=STEP, method="exact", progress=False) for s in (free, idle))
    assert looped.names == (*plain.names, "iff")
    assert not np.any(looped["iff"])
    size = np.abs(plain["encoder"]).max()
    assert np.allclose(looped["encoder"], plain["encoder"], atol=1e-9 * size), "modal and dense steps agree"


def test_fidelities_agree_in_closed_loop(apa):
    """Exact steps against Exudyn's in both fidelities; the difference is the integrator's."""

    def run(fidelity, method, h):
        record = simulate(with_iff(apa=apa, fidelity=fidelity), pulse(), time_step=h, method=method, progress=False)
        return record.values[1:, :: round(STEP / h)]

    reference = run("linear", "exact", STEP)
    size = np.abs(reference).max(axis=1)
    for fidelity in ("linear", "ffrf"):
        error = np.abs(run(fidelity, "generalized_alpha", STEP / 2) - reference).max(axis=1) / size
        assert np.all(error < 1e-2), error
        assert error[1] < 5e-3


@pytest.mark.parametrize("delay", [0, 1, 3])
def test_command_is_tustins_integral_of_the_record(apa, delay):
    """gain (sum of all readings before + half of the present one) h, `delay` samples late."""
    record = simulate(with_iff(-20.0, apa, delay=delay), pulse(), time_step=STEP, method="exact", progress=False)
    y = record["sensor_voltage"]
    integral = -20.0 * STEP * (np.cumsum(y) - y / 2)
    expected = np.concatenate([np.zeros(delay), integral[: len(integral) - delay]])
    assert np.allclose(record["iff"], expected, rtol=1e-9, atol=1e-12 * np.abs(expected).max())


@pytest.mark.parametrize("delay", [0, 1, 3])
def test_a_loop_by_its_difference_equations(delay):
    """A mass on a spring, a proportional and integrating controller: the swing in closed form, the loop written out."""
    rate, stiffness, damping, gain, integral = 2000.0, 3e5, 40.0, -4e4, -6e5
    controller = Controller([[1.0]], [[1.0]], [[integral / rate]], [[gain]], rate, delay=delay)
    spring = SpringDamper("spring", "ground.top", "mass.centre", "z", stiffness, damping)
    bar = craig_bampton(lattice(), n_modes=0, progress=False)
    beside = FlexibleBody("beside", bar, fidelity="linear", frame="left")
    scene = oscillator()
    ground = replace(scene.bodies[0], points={"top": np.zeros(3), "beside": bar.point("left").position})
    scene = replace(
        scene,
        bodies=(ground, scene.bodies[1], beside),  # exact steps are those of a scene with a flexible body
        joints=(*scene.joints, Joint("clamp", "ground.beside", "beside.left")),
        springs=(spring,),
        damping_ratio=0.0,
        loops=(Loop("pi", controller, "position", "force"),),
    )
    noise = np.random.default_rng(4).normal(size=(2, 300))
    push, quake = low_pass(noise, cutoff_frequency=80.0, sample_rate=rate)
    history = TimeHistory(np.arange(300) / rate, [push, quake], ("force", "acceleration"), ("N", "m/s2"))
    record = simulate(scene, history, time_step=1 / rate, method="exact", hold_order=0, progress=False)

    omega, decay = np.sqrt(stiffness / MASS), damping / (2 * MASS)
    turn = np.sqrt(omega**2 - decay**2)
    fade, sine, cosine = (f(a / rate) for f, a in ((np.exp, -decay), (np.sin, turn), (np.cos, turn)))
    x = v = total = 0.0
    waiting, position, command = [0.0] * delay, [], []
    for force, ground in zip(push, quake, strict=True):
        waiting.append(gain * x + integral / rate * total)
        total += x
        position.append(x)
        command.append(waiting.pop(0))
        rest = (force + command[-1] - MASS * ground) / stiffness
        away = x - rest
        x = rest + fade * (away * cosine + (v + decay * away) / turn * sine)
        v = fade * (v * cosine - (decay * v + omega**2 * away) / turn * sine)
    for found, expected in ((record["position"], position), (record["pi"], command)):
        assert np.allclose(found, expected, atol=1e-9 * np.abs(expected).max())


@pytest.mark.parametrize("steps", [1, 4])
@pytest.mark.parametrize("delay", [0, 1, 2])
def test_the_implicit_rule_adds_no_delay_to_a_held_command(steps, delay):
    """A mass whose loop takes damping away by its delay: half a step more would take 3 % of it at one step a sample.

    What is left is of second order in the step.
    """
    rate = 2000.0
    gain = np.array([[-((2 * np.pi * 30.0) ** 2)]])
    controller = Controller(np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), gain, rate, delay=delay)
    spring = SpringDamper("spring", "ground.top", "mass.centre", "z", 4e4, 300.0)
    scene = replace(oscillator(), springs=(spring,), damping_ratio=0.0)
    scene = replace(scene, loops=(Loop("p", controller, "position", "force"),))
    time = np.arange(round(0.4 * rate * steps) + 1) / (rate * steps)
    push = np.exp(-(((time - 0.01) / 0.003) ** 2))
    both = TimeHistory(time, np.vstack([push, 0 * push]), ("force", "acceleration"), ("N", "m/s2"))
    record = simulate(scene, both, time_step=time[1], progress=False).after(0.03)
    found = decay_poles(record.values[2:3, ::steps], 1 / rate, n_poles=4)
    expected = linearize_closed(scene).poles()
    expected = expected[(expected.imag > 0) & (np.abs(expected) < 1e3)][0]
    assert np.abs(found - expected).min() < 4e-3 / steps**2 * abs(expected.real)


class Sine:
    """A law whose commands are a sine of time."""

    def output(self, measured, time):
        """Return the command."""
        return [np.sin(2 * np.pi * 730.0 * time)]


@pytest.mark.parametrize("delay", [0, 1, 2])
def test_the_mean_force_of_a_step_is_off_by_the_share_that_is_told(delay):
    """Of commands at a frequency, by the forces at both ends of each step."""
    step = 1e-4
    loop = Loop("sine", PythonController(Sine(), 1 / step, delay=delay), "position", "force")
    scene = replace(oscillator(), loops=(loop,))
    loops, place = RunningLoops(scene, step), scene.inputs.index("force")
    stepped = [loops(n, lambda: np.zeros(9), np.zeros(2))[:2] for n in range(400)]
    held, end = np.array(stepped)[:, :, place].T
    missed = (0.5 * (end[:-1] + end[1:]) - held[1:])[3:]
    expected = -held[4:] if delay else held[3:-1]
    np.testing.assert_allclose(missed, command_error(730.0, step) * expected, atol=1e-12)


def test_the_slowest_mode_that_is_driven_wrongly_is_told():
    """Where that is by more than a hundredth, and the mode is below half of the fastest loop's sample rate."""
    slow, fast = (Loop(f"at {rate}", replace(GAIN, sample_rate=rate), "position", "force") for rate in (100.0, 1e3))
    shaken = np.sqrt(STIFFNESS / MASS) / (2 * np.pi)
    share = 100 * np.sin(np.pi * shaken * 1e-3) ** 2
    for loops, step in (((slow, fast), 1e-3), ((fast,), 5e-4), ((slow,), 1e-3), ((), 1e-3)):
        assembly = assemble(replace(oscillator(), loops=loops))
        beside = replace(assembly.modal, frequency=np.append(assembly.modal.frequency, 1.01 * shaken))
        line = describe_commands(replace(assembly, modal=beside), step)
        told = f"the mode of {shaken:.4g} Hz by {share:.2g} %" in line
        assert told == bool(line) == (loops == (slow, fast))


def test_a_record_holds_all_commands_the_last_one_too():
    controller = Controller(np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), [[-1e3]], 2000.0, delay=0)
    scene = replace(oscillator(), damping_ratio=0.0, loops=(Loop("p", controller, "position", "force"),))
    push = TimeHistory(np.arange(20) / 2000.0, np.ones((2, 20)), ("force", "acceleration"), ("N", "m/s2"))
    record = simulate(scene, push, time_step=1 / 2000.0, progress=False)
    assert record["position"][-1] != 0
    np.testing.assert_allclose(record["p"], -1e3 * record["position"], rtol=1e-12)


def test_held_between_samples(apa):
    bench = with_iff(apa=apa)
    record = simulate(bench, pulse(), time_step=STEP / 4, method="exact", progress=False)
    blocks = record["iff"][:-1].reshape(-1, 4)
    assert np.ptp(blocks, axis=1).max() == 0.0
    assert np.any(blocks)


@pytest.mark.parametrize("method", ["exact", "generalized_alpha"])
def test_unstable_loop_stops_and_says_what_grows(apa, method):
    text = (
        r"runs away: at t = 0\.\d+ s 'sensor_voltage' has grown to .* V and body 'apa' .*sign, gain and delay of loop"
    )
    with pytest.raises(RuntimeError, match=text):
        simulate(with_iff(+40.0, apa), pulse(duration=0.8), time_step=STEP, method=method, progress=False)


@pytest.mark.parametrize("n_steps", [7, 200, 463])
@pytest.mark.parametrize(("method", "module"), [("exact", time_domain), ("generalized_alpha", solver)])
def test_progress_ends_where_the_run_does(monkeypatch, n_steps, method, module):
    """What a bar is told adds up to its total, whatever the number of steps."""
    told = []

    @contextmanager
    def stage(label, *, total, unit, enabled):
        told.append([label, total, unit, enabled])
        yield lambda n=1: told.append(n)

    monkeypatch.setattr(module, "stage", stage)
    scene = replace(oscillator(), damping_ratio=0.0)
    push = TimeHistory(STEP * np.arange(n_steps + 1), np.zeros((2, n_steps + 1)), ("force", "acceleration"))
    simulate(scene, push, time_step=STEP, method=method, progress=True)
    first, *rest = told
    assert first == ["simulate", n_steps, "steps", True]
    assert min(rest) >= 0
    assert sum(rest) == n_steps


def test_what_has_grown_most_is_told():
    """Of two rotors that a loop measures, it drives one away, and turns the other by a push that does not grow."""
    names = ("calm", "wild")
    base = RigidBody("base", {name: (0.0, 0.1 * k, 0.0) for k, name in enumerate(names)}, fixed=True)
    inertia = np.diag([1e-3, 2e-3, 2.5e-3])
    rotors = [RigidBody(name, {"c": np.zeros(3)}, 1.0, inertia, base.points[name]) for name in names]
    gain = Controller(np.zeros((0, 0)), np.zeros((0, 2)), np.zeros((1, 0)), [[0.0, 3.0]], 1e4, delay=0)
    scene = Scene(
        "rotors",
        (base, *rotors),
        tuple(Joint(f"hinge {name}", f"base.{name}", f"{name}.c", free="rz") for name in names),
        tuple(PointTorque(f"torque {name}", f"{name}.c", "z", f"push {name}") for name in names),
        tuple(AngleSensor(f"angle {name}", f"base.{name}", f"{name}.c") for name in names),
        tuple(Bushing(f"spring {n}", f"base.{n}", f"{n}.c", [0, 0, 0, 0, 0, 1.0]) for n in names),
        (Loop("bad", gain, ("angle calm", "angle wild"), "push wild"),),
        damping_ratio=0.0,
    )
    time = STEP * np.arange(5001)
    push = TimeHistory(time, [0.05 * np.sin(20 * time) ** 2, np.full(5001, 1e-3)], scene.inputs, ("N m",) * 2)
    with pytest.raises(RuntimeError, match=r"'angle wild' has grown to [\d.e-]+ rad and body 'wild'") as caught:
        simulate(scene, push, time_step=STEP, method="exact", progress=False)
    grown = float(str(caught.value).split("has grown to ")[1].split()[0])
    assert grown == pytest.approx(np.abs(caught.value.record["angle wild"]).max(), rel=5e-3)


def test_saturation_keeps_an_unstable_loop_bounded(apa):
    record = simulate(with_iff(+40.0, apa, limit=0.2), pulse(), time_step=STEP, method="exact", progress=False)
    assert np.abs(record["iff"]).max() == pytest.approx(0.2)


def test_quantisation_is_seen(apa):
    coarse = with_iff(apa=apa, output_step=1e-3)
    record = simulate(coarse, pulse(), time_step=STEP, method="exact", progress=False)
    steps = record["iff"] / 1e-3
    assert np.allclose(steps, np.round(steps), atol=1e-9)
    assert np.any(steps)


@pytest.mark.parametrize(("fidelity", "method"), [("linear", "generalized_alpha"), ("ffrf", "generalized_alpha")])
def test_amplifier_bandwidth(apa, fidelity, method):
    """Against the exact solution, whose transfer function is that without amplifier times its low-pass."""

    def bench(kind, bandwidth):
        scene = make_bench(apa=apa, fidelity=kind)
        return replace(scene, actuators=(replace(scene.actuators[0], bandwidth=bandwidth),))

    frequency = np.geomspace(10, 1000, 20)
    ideal = frequency_response(linearize(bench("linear", np.inf)), frequency).values
    real = frequency_response(linearize(bench("linear", 300.0)), frequency).values
    assert np.allclose(real, ideal / (1 + 1j * frequency / 300.0), rtol=1e-9)
    reference = simulate(bench("linear", 300.0), pulse(), time_step=STEP, method="exact", progress=False)
    found = simulate(bench(fidelity, 300.0), pulse(), time_step=STEP, method=method, progress=False)
    assert np.abs(found["encoder"] - reference["encoder"]).max() < 0.02 * np.abs(reference["encoder"]).max()


MASS, STIFFNESS, DAMPING = 2.0, 3e5, 40.0


def oscillator(fidelity=None):
    """A mass on a spring-damper above the ground, guided along z; with a fidelity, a free flexible body beside it."""
    bodies = (
        RigidBody("ground", {"top": np.zeros(3)}, fixed=True),
        RigidBody("mass", {"centre": np.zeros(3)}, MASS, 0.01 * np.eye(3)),
    )
    return Scene(
        "oscillator",
        bodies,
        joints=(Joint("guide", "ground.top", "mass.centre", free=("z",)),),
        actuators=(
            PointForce("push", "mass.centre", "z", "force"),
            GroundAcceleration("quake", "z", "acceleration"),
        ),
        sensors=(Encoder("position", "ground.top", "mass.centre"),),
        springs=(SpringDamper("spring", "ground.top", "mass.centre", "z", STIFFNESS, DAMPING),),
    )


def test_spring_damper_force_and_ground_in_closed_form():
    frequency = np.geomspace(1, 500, 40)
    s = 2j * np.pi * frequency
    receptance = 1 / (MASS * s**2 + (DAMPING + 0.02 * np.sqrt(STIFFNESS * MASS)) * s + STIFFNESS)
    frf = frequency_response(linearize(oscillator()), frequency)
    assert np.allclose(frf.response("position", "force"), receptance, rtol=1e-10, atol=0)
    assert np.allclose(frf.response("position", "acceleration"), -MASS * receptance, rtol=1e-10, atol=0)


@pytest.mark.parametrize("name", ["force", "acceleration"])
def test_spring_damper_in_exudyn(name):
    """A scene of rigid bodies only, by Exudyn's connectors and loads, without modal damping."""
    scene = replace(oscillator(), damping_ratio=0.0)
    assert exudyn_eigenfrequencies(scene)[-1] == pytest.approx(np.sqrt(STIFFNESS / MASS) / (2 * np.pi), rel=1e-6)
    unit = {"force": "N", "acceleration": "m/s2"}[name]
    zero = {"force": "acceleration", "acceleration": "force"}[name]
    drive = pulse(name, unit, size=1.0)
    both = TimeHistory(drive.time, np.vstack([drive.values, 0 * drive.values]), (name, zero), (unit, ""))
    record = simulate(scene, both, time_step=STEP, progress=False)
    omega, decay = np.sqrt(STIFFNESS / MASS), DAMPING / (2 * MASS)
    turn = np.sqrt(omega**2 - decay**2)
    impulse = (
        np.exp(-decay * drive.time) * np.sin(turn * drive.time) / (MASS * turn) * (1 if name == "force" else -MASS)
    )
    expected = np.convolve(drive.values[0], impulse)[: len(drive.time)] * STEP
    assert np.abs(record["position"] - expected).max() < 5e-3 * np.abs(expected).max()


@pytest.mark.parametrize("fidelity", ["linear", "ffrf"])
def test_forces_ground_and_dampers_with_a_flexible_body(apa, fidelity):
    def scene(kind):
        bench = make_bench(apa=apa, fidelity=kind)
        return replace(
            bench,
            actuators=(
                PointForce("push", "payload.bottom", "z", "force"),
                GroundAcceleration("quake", "z", "acceleration"),
            ),
            springs=(SpringDamper("damper", "base.guide", "payload.bottom", "z", 2e5, 300.0),),
        )

    force, quake = pulse("force", "N", size=1.0), pulse("acceleration", "m/s2", size=0.1)
    both = TimeHistory(force.time, np.vstack([force.values, -quake.values]), ("force", "acceleration"), ("N", "m/s2"))
    reference = simulate(scene("linear"), both, time_step=STEP, method="exact", progress=False)
    found = simulate(scene(fidelity), both, time_step=STEP, progress=False)
    for name in ("encoder", "sensor_voltage"):
        assert np.abs(found[name] - reference[name]).max() < 0.01 * np.abs(reference[name]).max()


def test_ground_acceleration_is_an_opposite_gravity(apa):
    bench = make_bench(apa=apa, fidelity="linear")
    pushed = replace(bench, actuators=(GroundAcceleration("quake", "z", "acceleration"),))
    static = frequency_response(linearize(pushed), np.array([1e-3])).values[:, 0, 0].real
    still = make_bench(apa=apa, fidelity="linear", gravity=True)
    quiet = TimeHistory([0.0, 1e-3], np.zeros(2), ("actuator_voltage",), ("V",))
    sag = simulate(still, quiet, time_step=STEP, method="exact", progress=False).values[1:, 0]
    assert np.allclose(9.81 * static, sag, rtol=1e-6, atol=0)


def test_bad_loops(apa):
    bench = make_bench(apa=apa, fidelity="linear")
    for loop, problem in (
        (Loop("l", GAIN, "force", "actuator_voltage"), "output that loop 'l' measures: 'force'; known: sensor_voltage"),
        (Loop("l", GAIN, "encoder", "current"), "input that loop 'l' drives: 'current'; known: actuator_voltage"),
    ):
        with pytest.raises(ValueError, match=problem):
            replace(bench, loops=(loop,))
    with pytest.raises(ValueError, match=r"has 1 input\(s\) and 1 output\(s\), but it measures 2"):
        Loop("l", GAIN, ("encoder", "sensor_voltage"), "actuator_voltage")
    for options, problem in (
        ({"input_step": -1.0}, "input_step must not be"),
        ({"output_step": -1.0}, "output_step must not be"),
        ({"input_limit": 0.0}, "input_limit must be"),
    ):
        with pytest.raises(ValueError, match=problem):
            Loop("l", GAIN, "encoder", "actuator_voltage", **options)
    looped = replace(bench, loops=(Loop("l", GAIN, "encoder", "actuator_voltage"),))
    for method in ("exact", "generalized_alpha"):
        with pytest.raises(ValueError, match=r"samples at 10000 Hz, every 1\.42857 time steps"):
            simulate(looped, pulse(), time_step=0.7e-4, method=method, progress=False)
    with pytest.raises(ValueError, match="delay must be a whole number"):
        replace(GAIN, delay=0.5)
    with pytest.raises(ValueError, match="limit must be positive"):
        replace(GAIN, limit=0.0)


def test_summary_tells_the_wiring(apa_with_ports, apa):
    bench = make_bench(apa=apa_with_ports, fidelity="linear", resistance=1e4)
    gain = replace(GAIN, limit=7.5)
    loop = Loop("p", gain, "encoder", "actuator_voltage", input_step=1e-9, input_limit=1e-4, output_step=1e-3)
    text = " ".join(describe(replace(bench, loops=(loop,))).split())
    assert "port sensor: measured, 10000 Ohm" in text
    assert "port actuator: driven by actuator_voltage" in text
    assert "loop p: encoder to actuator_voltage at 10000 Hz, 0 samples of delay, limit 7.5 V, reads in" in text
    assert text.endswith("steps of 1e-09 m, reads up to 0.0001 m, drives in steps of 0.001 V")
    assert "port sensor: short-circuited" in describe(make_bench(apa=apa_with_ports, ports=False))


def test_damping_that_a_floating_frame_cannot_realise_is_told():
    scene = replace(oscillator(), damping_ratio=0.05)
    quiet = TimeHistory([0.0, 1e-3], np.zeros((2, 2)), ("force", "acceleration"), ("N", "m/s2"))
    with pytest.warns(UserWarning, match=r"the modes at 61\.64 Hz, in which springs rather than bodies deform, lose"):
        simulate(scene, quiet, time_step=STEP, progress=False)
    with warnings.catch_warnings():  # at rest nothing is damped
        warnings.simplefilter("error")
        static_response(scene)


def test_signals_need_names_of_their_own(apa):
    bench = make_bench(apa=apa, fidelity="linear")
    for name in ("encoder", "actuator_voltage"):
        with pytest.raises(ValueError, match="must differ; used more than once"):
            replace(bench, loops=(Loop(name, GAIN, "encoder", "actuator_voltage"),))


def test_bad_parts(apa):
    bench = make_bench(apa=apa, fidelity="linear")
    with pytest.raises(ValueError, match="unknown point of 'apa': 'roof'"):
        replace(bench, actuators=(PointForce("push", "apa.roof", "z", "force"),))
    with pytest.raises(ValueError, match="cannot be both"):
        replace(bench, actuators=(*bench.actuators, PointForce("push", "payload.bottom", "z", "actuator_voltage")))
    with pytest.raises(ValueError, match="unknown axis 'w'"):
        GroundAcceleration("quake", "w", "a")
    with pytest.raises(ValueError, match="belongs to a fixed body"):
        replace(bench, actuators=(PointForce("push", "base.top", "z", "force"),))
    with pytest.raises(ValueError, match="neither stiffness nor damping"):
        SpringDamper("d", "a.b", "c.d", "z")
    with pytest.raises(ValueError, match="resistance needs the sensor's electrical port"):
        make_bench(apa=apa, resistance=1e4)
    with pytest.raises(ValueError, match='hold_order=0 needs "exact"'):
        simulate(bench, pulse(), time_step=STEP, hold_order=0, progress=False)
    with pytest.raises(ValueError, match="damping must not be negative"):
        SpringDamper("d", "a.b", "c.d", "z", damping=-1.0)
    with pytest.raises(ValueError, match="bandwidth must be positive"):
        replace(bench.actuators[0], bandwidth=0.0)
    assert isinstance(bench.bodies[1], FlexibleBody)


def test_a_sample_period_is_a_whole_number_of_steps_but_for_rounding():
    loop = Loop("p", GAIN, "encoder", "actuator_voltage")
    assert [samples_per_period(loop, step) for step in (1e-4, 1e-4 / 3, 1e-4 * (1 + 1e-8))] == [1, 3, 1]
    for step in (1e-4 * (1 + 1e-4), 1e-4 / 3.01, 2e-4):
        with pytest.raises(ValueError, match="samples at 10000 Hz"):
            samples_per_period(loop, step)


def test_consecutive_places_are_a_slice_and_others_stay():
    assert (span([]), span([2, 3, 4])) == (slice(0, 0), slice(2, 5))
    assert span([2, 4, 3]).tolist() == [2, 4, 3]
