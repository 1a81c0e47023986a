"""Loops with set points and PID controllers: against own recursions of a cart, in every engine."""

import math
import re
from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import brentq

from nassim import (
    AngleSensor,
    Controller,
    Encoder,
    Loop,
    PointForce,
    PointTorque,
    RigidBody,
    Scene,
    Simulation,
    TimeHistory,
    cylindrical,
    describe,
    frequency_response,
    joined,
    linearize,
    load,
    placed,
    save,
    simulate,
)
from nassim.simulation import linearize_closed
from nassim.systems import (
    PythonController,
    close_loop,
    controller_model,
    controller_response,
    decentralised,
    decoupled,
    margins,
    open_loop,
    parallel,
    pid,
    proportional,
    series,
)

MASS, DAMPING, RATE = 2.0, 3.0, 2000.0
AXIS = np.array([2.0, -1.0, 2.0]) / 3
GAINS = {"kp": 4e4, "ki": 1e6, "kd": 600.0}
LIMIT, CORNER = 50.0, 300.0
SERVO = pid(**GAINS, sample_rate=RATE, derivative_bandwidth=CORNER, limit=LIMIT)


def stage(controller=SERVO, **loop):
    """A cart on a slide along an odd axis."""
    ground = RigidBody("ground", {"o": [0, 0, 0]}, fixed=True)
    cart = RigidBody("cart", {"o": [0, 0, 0]}, MASS, np.diag([0.01, 0.02, 0.025]))
    return Scene(
        "stage",
        (ground, cart),
        (cylindrical("slide", "ground.o", "cart.o", AXIS, damping={"z": DAMPING, "rz": 0.1}),),
        (PointForce("motor", "cart.o", AXIS, "force"),),
        (Encoder("x", "ground.o", "cart.o", AXIS), AngleSensor("turn", "ground.o", "cart.o", AXIS)),
        loops=(Loop("servo", controller, "x", "force", **{"reference": "set"} | loop),),
    )


def excitation(time, *, push=0.0, noise=0.0):
    """A set point that steps, and a disturbance that comes later; both are constant from step to step. White noise."""
    wanted = np.where(time - time[0] >= 0.01, 1e-3, 0.0) - np.where(time - time[0] >= 0.15, 3e-4, 0.0)
    given = TimeHistory(time, [push * (time - time[0] >= 0.1), wanted], ["force", "set"], ["N", "m"])
    if not noise:
        return given
    rows = [*given.values, noise * np.random.default_rng(3).standard_normal(len(time))]
    return TimeHistory(time, rows, (*given.names, "x noise"), (*given.units, "m"))


def own_run(given, steps, *, resolution=0.0, range_=math.inf, windup=False):
    """Positions and commands at all time steps: the cart by its exponential, PID as a programmer writes it."""
    period, h = 1 / RATE, float(given.time[1] - given.time[0])
    omega = 2 * math.pi * CORNER
    fade = math.exp(-DAMPING / MASS * h)
    x = v = integral = slope = before = command = coming = 0.0
    tracking = math.inf if windup else math.sqrt(GAINS["kd"] / GAINS["ki"])
    rows = []
    for k, (push, wanted, *noise) in enumerate(given.values.T):
        if k % steps == 0:
            command = coming  # computed one sample ago
            seen = x + sum(noise)
            seen = min(max(resolution * round(seen / resolution) if resolution else seen, -range_), range_)
            error = wanted - seen
            # Tustin's rule: the derivative's pole, then the trapezoidal rule of the integral.
            slope = ((2 - omega * period) * slope + 2 * omega * (error - before)) / (2 + omega * period)
            asked = GAINS["kp"] * error + GAINS["ki"] * (integral + period / 2 * error) + GAINS["kd"] * slope
            coming = min(max(asked, -LIMIT), LIMIT)
            integral += period * error + (coming - asked) * period / tracking / GAINS["ki"]
            before = error
        rows.append((x, command))
        force = push + command
        final = force / DAMPING
        x, v = x + final * h + (v - final) * MASS / DAMPING * (1 - fade), final + (v - final) * fade
    return np.array(rows).T


TIME = 0.4 + np.arange(3001) * 1e-4
HELD = {"time_step": 1e-4, "method": "exact", "hold_order": 0, "progress": False}


@pytest.mark.parametrize("resolution", [0.0, 2e-6])
def test_a_servo_follows_its_set_point_as_an_own_recursion(resolution):
    given = excitation(TIME, push=20.0)
    x, command = own_run(given, 5, resolution=resolution)
    assert abs(command).max() == LIMIT
    assert x[990] == pytest.approx(1e-3, rel=1e-2)
    record = simulate(stage(input_step=resolution), given, **HELD)
    np.testing.assert_allclose(record["x"], x, atol=1e-9 * abs(x).max())
    np.testing.assert_allclose(record["servo"], command, atol=1e-8 * LIMIT)


@pytest.mark.parametrize("noise", [0.0, 1e-6])
def test_exudyn_and_single_steps_follow_too(noise):
    """Noise is white up to half of the steps' rate: only forces need steps that resolve them."""
    scene, given = stage(noise=("x noise",) * bool(noise)), excitation(TIME[:1001], push=20.0, noise=noise)
    x, _ = own_run(given, 5)
    stepped = simulate(scene, given, time_step=1e-4, method="generalized_alpha", progress=False)
    np.testing.assert_allclose(stepped["x"], x, atol=2e-4 * abs(x).max())
    first, *others = [dict(zip(given.names, row, strict=True)) for row in given.values.T]
    with Simulation(scene, time_step=1e-4, method="exact", hold_order=0, inputs=first) as run:
        for inputs in others:
            run.step(inputs)
        assert run.outputs["x"] == pytest.approx(x[-1], rel=1e-9)


@pytest.mark.parametrize("converter", [{}, {"input_step": 2e-6}, {"input_limit": 1.1965e-3}])
def test_loops_read_noise_before_their_converters_and_it_is_not_recorded(converter):
    given = excitation(TIME, push=10.0, noise=1e-6)
    resolution, range_ = converter.get("input_step", 0.0), converter.get("input_limit", math.inf)
    x, command = own_run(given, 5, resolution=resolution, range_=range_)
    record = simulate(stage(noise="x noise", **converter), given, **HELD)
    np.testing.assert_allclose(record["x"], x, atol=1e-9 * abs(x).max())
    np.testing.assert_allclose(record["servo"], command, atol=1e-8 * LIMIT)
    read = (x + given["x noise"])[::5]
    assert max(x[::5]) < 1.1965e-3 < max(read)
    first = given.elapsed[5 * np.argmax(read >= range_)]
    at_limit = rf"'x' was at its limit .* {100 * np.mean(read >= range_):.2g} % of the run, first at t = {first:.6g} s"
    assert bool(re.search(at_limit, " ".join(record.notes))) == ("input_limit" in converter)


@pytest.mark.filterwarnings("ignore:loop .servo.. .servo. was at its limit")
def test_the_integrator_does_not_wind_up():
    """A set point too far for the motor: the overshoot is a fraction of that with an integrator that winds up."""
    given = excitation(TIME)
    given = replace(given, values=100 * given.values)
    free = pid(**GAINS, sample_rate=RATE, derivative_bandwidth=CORNER, limit=LIMIT, anti_windup_time=math.inf)
    for controller, windup in ((SERVO, False), (free, True)):
        x, command = own_run(given, 5, windup=windup)
        record = simulate(stage(controller), given, **HELD)
        np.testing.assert_allclose(record["x"], x, atol=1e-9 * abs(x).max())
        np.testing.assert_allclose(record["servo"], command, atol=1e-7 * LIMIT)


@pytest.mark.parametrize("method", ["exact", "generalized_alpha"])
def test_two_servos_of_one_scene_do_not_wind_up_either(method):
    """With limits of their own, which both meet: each as if it were alone."""
    limits, given = {"weak": 0.5 * LIMIT, "strong": LIMIT}, excitation(TIME[:1201])
    given = replace(given, values=20 * given.values)
    alone = {name: placed(stage(replace(SERVO, limit=limit)), name) for name, limit in limits.items()}
    renamed = [replace(given, names=tuple(f"{name}/{signal}" for signal in given.names)) for name in alone]
    both = replace(
        given,
        values=np.vstack([one.values for one in renamed]),
        names=tuple(signal for one in renamed for signal in one.names),
        units=2 * given.units,
    )
    options = {"time_step": 1e-4, "method": method, "progress": False}
    record = simulate(joined("both", *alone.values()), both, **options)
    for (name, scene), push in zip(alone.items(), renamed, strict=True):
        expected = simulate(scene, push, **options)
        assert np.abs(expected[f"{name}/servo"]).max() == limits[name]
        for signal in ("x", "servo"):
            size = np.abs(expected[f"{name}/{signal}"]).max()
            np.testing.assert_allclose(record[f"{name}/{signal}"], expected[f"{name}/{signal}"], atol=1e-7 * size)


def test_the_linear_closed_loop_has_the_reference_as_input():
    """T = G K z^-1 / (1 + G K z^-1) with the cart's own pulse transfer function G."""
    scene = stage(replace(SERVO, limit=math.inf))
    assert scene.inputs == ("force", "set")
    assert scene.input_unit("set") == "m"
    assert linearize(scene).inputs == ("force",)
    closed = linearize_closed(scene, noise=True)
    assert set(closed.inputs) == {"force", "set", "x noise"}
    frequency = np.geomspace(0.1, 900.0, 40)
    z = np.exp(2j * np.pi * frequency / RATE)
    a, period = DAMPING / MASS, 1 / RATE
    fade = np.exp(-a * period)
    plant = ((a * period - 1 + fade) * z + 1 - fade - a * period * fade) / (a**2 * MASS * (z - 1) * (z - fade))
    law = -controller_response(SERVO, frequency).values[0, 0]  # its delay included
    expected = plant * law / (1 + plant * law)
    found = frequency_response(closed, frequency)
    np.testing.assert_allclose(found.response("x", "set"), expected, rtol=1e-7)
    np.testing.assert_allclose(found.response("x", "x noise"), -expected, rtol=1e-7)
    named = linearize_closed(replace(scene, loops=(replace(scene.loops[0], noise="hiss"),)), noise=True)
    assert named.inputs == ("force", "hiss", "set")
    np.testing.assert_allclose(frequency_response(named, frequency).response("x", "hiss"), -expected, rtol=1e-7)
    alone = close_loop(
        linearize(scene), scene.loops[0].controller, measured="x", driven="force", reference="set", delay_order=4
    )
    low = frequency[:20]
    expected = expected[:20]
    np.testing.assert_allclose(frequency_response(alone, low).response("x", "set"), expected, rtol=2e-3)


def test_margins_of_a_pid_stage_are_those_of_its_closed_form():
    """L = K(z) / z H(s) / (m s^2 + c s), with Tustin's rule: where |L| = 1 and where its phase is -180 deg."""

    def loop(frequency):
        s, tustin = 2j * np.pi * frequency, 2j * RATE * np.tan(np.pi * frequency / RATE)
        law = GAINS["kp"] + GAINS["ki"] / tustin + GAINS["kd"] * tustin / (1 + tustin / (2 * np.pi * CORNER))
        hold = np.exp(-s / (2 * RATE)) * np.sinc(frequency / RATE)
        return law * np.exp(-s / RATE) * hold / (MASS * s**2 + DAMPING * s)

    scene = stage()
    frequency = np.geomspace(1.0, 900.0, 4000)
    found = margins(open_loop(linearize(scene), SERVO, frequency, measured="x", driven="force"))
    crossover = brentq(lambda f: abs(loop(f)) - 1, 10.0, 200.0)
    turning = brentq(lambda f: loop(f).imag, 100.0, 400.0)
    places = found.phase_margin_frequency, found.gain_margin_frequency
    assert places == pytest.approx((crossover, turning), rel=1e-5)
    assert found.phase_margin == pytest.approx(180 + math.degrees(np.angle(loop(crossover))), rel=1e-5)
    assert found.gain_margin == pytest.approx(-1 / loop(turning).real, rel=1e-5)
    assert 20 < found.phase_margin < 70


def test_step_and_overshoot_of_a_pd_stage_are_those_of_its_closed_form():
    """x = 1 - exp(-a t) (cos w t - a / w sin w t) with 2 a = kd / m: fast sampling without delay."""
    kp, kd, rate = 4e4, 150.0, 2e4
    fast = pid(kp, kd=kd, sample_rate=rate, derivative_bandwidth=8e3, delay=0)
    decay = kd / (2 * MASS)
    omega = math.sqrt(kp / MASS - decay**2)
    scene = replace(stage(fast), joints=(cylindrical("slide", "ground.o", "cart.o", AXIS),))
    time = np.arange(2001) / rate
    given = TimeHistory(time, [0 * time, np.full(2001, 1e-3)], ["force", "set"])
    x = simulate(scene, given, time_step=1 / rate, method="exact", hold_order=0, progress=False)["x"] / 1e-3
    expected = 1 - np.exp(-decay * time) * (np.cos(omega * time) - decay / omega * np.sin(omega * time))
    np.testing.assert_allclose(x, expected, atol=5e-3)
    peak = (np.pi - math.atan2(2 * decay, omega - decay**2 / omega)) / omega
    overshoot = -math.exp(-decay * peak) * (math.cos(omega * peak) - decay / omega * math.sin(omega * peak))
    assert overshoot > 0.3
    assert x.max() - 1 == pytest.approx(overshoot, rel=0.01)
    assert time[np.argmax(x)] == pytest.approx(peak, abs=2 / rate)


def test_feedforward_of_the_mass_follows_without_error():
    """A smooth path in the excitation and, on the motor, m a + c v: what the loop has left is nearly nothing."""
    time = np.arange(2001) * 1e-4
    turn = 2 * np.pi * 10.0
    wanted = 1e-3 * (turn * time - np.sin(turn * time))  # at rest at the start
    speed, acceleration = 1e-3 * turn * (1 - np.cos(turn * time)), 1e-3 * turn**2 * np.sin(turn * time)
    force = MASS * acceleration + DAMPING * speed
    errors = []
    for share in (0.0, 1.0):
        given = TimeHistory(time, [share * force, wanted], ["force", "set"], ["N", "m"])
        for method in ("exact", "generalized_alpha"):
            record = simulate(stage(), given, time_step=1e-4, method=method, progress=False)
            errors.append(np.abs(record["x"] - wanted).max())
    assert errors[0] == pytest.approx(errors[1], rel=0.01)
    assert max(errors[2:]) < 1e-4 * errors[0]
    pair = frequency_response(linearize_closed(stage(replace(SERVO, limit=math.inf))), np.array([10.0]))
    s = 2j * np.pi * 10.0
    both = pair.response("x", "set") + (MASS * s**2 + DAMPING * s) * pair.response("x", "force")
    assert both == pytest.approx(1.0, abs=5e-3)


AHEAD = Controller(
    [[0.0, 0.0], [1.0, 0.0]],
    [[1.0], [0.0]],
    [[-2 * MASS * RATE**2, MASS * RATE**2]],
    [[MASS * RATE**2]],
    RATE,
)
"""Feedforward of the mass: m (1 - 2 / z + 1 / z^2) / T^2, one sample late as the controller."""


def path(time):
    return 1e-3 * (1 - np.cos(2 * np.pi * 8.0 * time)) + 1e-4 * np.sin(2 * np.pi * 30.0 * time) ** 2


def test_a_feedforward_adds_what_it_makes_of_the_set_point():
    """Against a run whose excitation has the same forces."""
    servo = replace(SERVO, limit=math.inf)
    time = np.arange(1501) * 1e-4
    wanted = path(time)
    samples = np.concatenate([np.zeros(3), wanted[::5]])[:-1]  # one sample late
    force = np.repeat(MASS * RATE**2 * np.diff(samples, 2), 5)[: len(time)]
    plain, pushed = (TimeHistory(time, [one, wanted], ["force", "set"]) for one in (0 * time, force))
    found, alone = simulate(stage(servo, feedforward=AHEAD), plain, **HELD), simulate(stage(servo), pushed, **HELD)
    np.testing.assert_allclose(found["x"], alone["x"], atol=1e-9 * wanted.max())
    np.testing.assert_allclose(found["servo"], alone["servo"] + force, atol=1e-7 * abs(force).max())
    without = simulate(stage(servo), plain, **HELD)
    assert np.abs(found["x"] - wanted).max() < 0.5 * np.abs(without["x"] - wanted).max()
    stepped = simulate(stage(servo, feedforward=AHEAD), plain, time_step=1e-4, progress=False)
    np.testing.assert_allclose(stepped["x"], found["x"], atol=2e-3 * wanted.max())


@pytest.mark.filterwarnings("ignore:loop .servo.. .servo. was at its limit")
def test_the_limit_holds_the_sum_with_the_feedforward():
    """A gain from the set point to the force: at rest kp (set - x) + gain set = 0."""
    kp, gain = 4e4, 2e4
    servo = pid(kp, 0.0, 600.0, sample_rate=RATE, limit=LIMIT)
    scene = stage(servo, feedforward=proportional(gain, sample_rate=RATE))
    given = excitation(0.4 + np.arange(1401) * 1e-4)
    found = simulate(scene, given, **HELD)
    assert np.abs(found["servo"]).max() == LIMIT
    assert found["x"][-1] == pytest.approx(1e-3 * (1 + gain / kp), rel=0.02)
    stepped = simulate(scene, given, time_step=1e-4, progress=False)
    np.testing.assert_allclose(stepped["x"], found["x"], atol=2e-3 * np.abs(found["x"]).max())
    both = stage(feedforward=AHEAD).loops[0].law
    np.testing.assert_array_equal(both.anti_windup, np.vstack([SERVO.anti_windup, np.zeros((2, 1))]))


def test_the_linear_closed_loop_has_the_feedforward():
    frequency = np.geomspace(0.5, 800.0, 30)
    servo = replace(SERVO, limit=math.inf)
    plain = frequency_response(linearize_closed(stage(servo)), frequency)
    found = frequency_response(linearize_closed(stage(servo, feedforward=AHEAD)), frequency)
    z = np.exp(2j * np.pi * frequency / RATE)
    ahead = MASS * RATE**2 * (1 - 1 / z) ** 2 / z
    expected = plain.response("x", "set") + ahead * plain.response("x", "force")
    np.testing.assert_allclose(found.response("x", "set"), expected, rtol=1e-8)
    np.testing.assert_allclose(found.response("x", "force"), plain.response("x", "force"), rtol=1e-8)
    assert linearize_closed(stage(servo, feedforward=AHEAD)).outputs == ("x", "turn")


@pytest.mark.parametrize("delay_order", [1, 3])
def test_the_continuous_closed_loop_has_the_feedforward_with_the_same_order_of_delay(delay_order):
    frequency = np.geomspace(0.5, 800.0, 30)
    servo, options = replace(SERVO, limit=math.inf), {"continuous": True, "delay_order": delay_order}
    plain = frequency_response(linearize_closed(stage(servo), **options), frequency)
    found = frequency_response(linearize_closed(stage(servo, feedforward=AHEAD), **options), frequency)
    ahead = controller_model(AHEAD, inputs="set", outputs="force", delay_order=delay_order)
    ahead = frequency_response(ahead, frequency).response("force", "set")
    expected = plain.response("x", "set") + ahead * plain.response("x", "force")
    np.testing.assert_allclose(found.response("x", "set"), expected, rtol=1e-8)


def test_two_loops_feed_forward_side_by_side(tmp_path):
    """Loops with and without feedforward share a group of samples; a stored scene keeps it."""
    twist = pid(0.5, kd=0.02, sample_rate=RATE, derivative_bandwidth=CORNER)
    turning = Loop("turning", twist, "turn", "torque", reference="turn_set")
    both = stage(feedforward=AHEAD)
    both = replace(
        both,
        actuators=(*both.actuators, PointTorque("twist", "cart.o", AXIS, "torque")),
        loops=(turning, both.loops[0]),
    )
    time = np.arange(501) * 1e-4
    given = TimeHistory(time, [0 * time, 0 * time, 0.01 * path(time) / 1e-3, path(time)], both.inputs)
    alone = simulate(stage(feedforward=AHEAD), given.select(["force", "set"]), **HELD)
    for scene in (both, load(save(both, tmp_path / "scene.h5"))):
        np.testing.assert_allclose(simulate(scene, given, **HELD)["x"], alone["x"], rtol=1e-9, atol=1e-12)
    stepped = simulate(both, given, time_step=1e-4, progress=False)
    np.testing.assert_allclose(stepped["x"], alone["x"], atol=2e-3 * np.abs(alone["x"]).max())
    assert "1 sample of delay, reference set, with feedforward" in " ".join(describe(both).split())


def test_feedforward_that_does_not_fit_is_refused():
    for change, message in (
        ({"reference": ()}, "loop 'servo': a feedforward reads references, but the loop has none"),
        ({"feedforward": 3.0}, "feedforward must be a Controller, got float; nassim.systems.proportional makes one"),
        ({"feedforward": proportional([[1.0, 2.0]], sample_rate=RATE)}, r"feedforward has 2 input.s. and 1 output.s."),
        ({"feedforward": replace(AHEAD, delay=0)}, "2000 Hz and the delay 1 of the controller, not 2000 Hz and 0"),
        ({"feedforward": replace(AHEAD, sample_rate=1e3)}, "rate 2000 Hz and the delay 1 of .*, not 1000 Hz and 1"),
        ({"feedforward": replace(AHEAD, limit=3.0)}, "its feedforward has a limit of 3; leave it out"),
    ):
        with pytest.raises(ValueError, match=message):
            stage(**{"feedforward": AHEAD} | change)
    both, ahead = (proportional(gain, sample_rate=RATE) for gain in ([[1.0], [1.0]], [[1.0, 2.0]]))
    with pytest.raises(ValueError, match=r"loop has 1 reference.s. and drives 2 signal.s."):
        Loop("two", both, "x", ("force", "other"), reference="set", feedforward=ahead)
    with pytest.raises(ValueError, match="has no linear model"):
        stage(PythonController(Law(), RATE), feedforward=AHEAD)


def test_pid_is_the_sampled_law_of_textbooks():
    frequency = np.geomspace(0.1, 30.0, 9)
    s = 2j * np.pi * frequency
    expected = -(4e4 + 1e6 / s + 600.0 * s / (1 + s / (2 * np.pi * CORNER)))
    found = controller_response(replace(SERVO, delay=0), frequency).values[0, 0]
    np.testing.assert_allclose(found, expected, rtol=1e-3)
    default = pid(0.0, 0.0, 1.0, sample_rate=1e3, delay=0)
    assert controller_response(default, np.array([100.0])).values[0, 0] == pytest.approx(
        -2j * np.tan(np.pi * 0.1) * 1e3 / (1 + 2j * np.tan(np.pi * 0.1) * 1e3 / (200 * np.pi)), rel=1e-9
    )
    integral = pid(0.0, 2.0, sample_rate=100.0)
    assert integral.C @ integral.anti_windup == pytest.approx(np.ones((1, 1)))  # one sample
    both = pid(4.0, 2.0, sample_rate=100.0)
    assert both.C @ both.anti_windup == pytest.approx(np.full((1, 1), 0.01 / 2.0))
    for options, message in (
        ({"derivative_bandwidth": 60.0}, "derivative_bandwidth must lie below half the sample rate"),
        ({"anti_windup_time": 0.0}, "anti_windup_time must be positive"),
        ({"sample_rate": 0.0}, "sample_rate must be positive"),
        ({"kd": math.nan}, "kd holds 1 value"),
    ):
        with pytest.raises(ValueError, match=message):
            pid(1.0, 1.0, **{"sample_rate": 100.0} | options)


def test_combined_controllers_keep_their_anti_windup():
    plain = Controller(0.5 * np.eye(2), np.ones((2, 1)), np.ones((1, 2)), np.eye(1), RATE)
    servo = replace(SERVO, limit=math.inf)
    back = SERVO.anti_windup
    nothing = np.zeros((2, 1))
    np.testing.assert_array_equal(series(plain, servo).anti_windup, np.vstack([nothing, back]))
    np.testing.assert_array_equal(parallel(servo, plain).anti_windup, np.vstack([back, nothing]))
    both = decentralised(servo, plain).anti_windup
    np.testing.assert_array_equal(both, np.block([[back, np.zeros(back.shape)], [nothing, nothing]]))
    drive = np.array([[2.0, 1.0], [1.0, 3.0]])
    turned = decoupled(servo, servo, measure=np.eye(2), drive=drive).anti_windup
    np.testing.assert_allclose(turned @ drive, np.kron(np.eye(2), back), atol=1e-12)
    assert series(plain, plain).anti_windup is None
    two = Controller(np.eye(1), np.ones((1, 1)), np.ones((2, 1)), np.ones((2, 1)), RATE)
    with pytest.raises(ValueError, match=r"1 output.s. and anti_windup cannot know what the limit takes from 2"):
        series(servo, two)
    with pytest.raises(ValueError, match="anti_windup"):
        replace(SERVO, anti_windup=np.zeros((3, 3)))


class Law:
    """A proportional law in Python."""

    def output(self, measured, time):
        return -1e4 * measured


def test_controllers_in_python_read_the_error_too():
    given = excitation(TIME[:501])
    linear = Controller(np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), np.array([[-1e4]]), RATE)
    for method in ({"method": "exact"}, {"method": "generalized_alpha"}):
        records = [
            simulate(stage(one), given, time_step=1e-4, progress=False, **method)
            for one in (linear, PythonController(Law(), RATE))
        ]
        np.testing.assert_allclose(records[1]["x"], records[0]["x"], rtol=1e-9, atol=1e-15)
    assert abs(records[0]["x"]).max() > 1e-5


class Clock:
    """A law that commands as many newtons as there are seconds on its clock."""

    def output(self, measured, time):
        return 0.0 * measured + time


class Counter:
    """A law that commands the same by counting its samples."""

    def __init__(self):
        self.samples = 0

    def output(self, measured, time):
        self.samples += 1
        return 0.0 * measured + (self.samples - 1) / RATE


@pytest.mark.parametrize("law", [Clock(), Counter()])
@pytest.mark.parametrize("method", ["exact", "generalized_alpha"])
def test_controllers_in_python_know_the_time_of_each_of_their_samples(method, law):
    """They sample at every fifth step, beside a loop that samples at each."""
    scene = stage(PythonController(law, RATE, delay=0))
    beside = Loop("beside", proportional(-1.0, sample_rate=1e4), "x", "force")
    scene = replace(scene, loops=(*scene.loops, beside))
    record = simulate(scene, excitation(TIME[:52]), time_step=1e-4, progress=False, method=method)
    np.testing.assert_allclose(record["servo"], np.floor(np.arange(52) / 5 + 1e-9) / RATE, rtol=1e-12)


def test_set_points_far_away_are_no_runaway():
    """The scene is a few centimetres large; the set point lies metres away, and the loop has no limit."""
    time = np.arange(4001) * 1e-3
    given = TimeHistory(time, [0 * time, 5.0 * (1 - np.cos(np.pi * time / 4))], ["force", "set"], ["N", "m"])
    slow = pid(200.0, 0.0, 60.0, sample_rate=1e3)
    record = simulate(stage(slow), given, time_step=1e-3, method="exact", progress=False)
    assert record["x"][-1] == pytest.approx(10.0, rel=0.05)


def test_references_are_placed_described_and_stored(tmp_path):
    scene = load(save(stage(noise="x noise"), tmp_path / "scene.h5"))
    assert scene.loops[0].reference == ("set",)
    copy = placed(scene, "a")
    assert copy.loops[0].reference == ("a/set",)
    assert copy.inputs == ("a/force", "a/set", "a/x noise")
    assert copy.input_unit("a/x noise") == "m"
    assert "1 sample of delay, reference set, noise x noise, limit 50 N" in " ".join(describe(scene).split())


def test_references_that_do_not_fit_are_refused():
    scene = stage()
    with pytest.raises(ValueError, match=r"measures 1 signal.s., but has 2 reference.s."):
        stage(reference=("set", "other"))
    with pytest.raises(ValueError, match=r"measures 1 signal.s., but has 2 noise input.s."):
        stage(noise=("a", "b"))
    with pytest.raises(ValueError, match="reference or noise 'force' of a loop is also the input of an actuator"):
        stage(reference="force")
    with pytest.raises(ValueError, match="reference and noise names must differ; used more than once: set"):
        stage(noise="set")
    with pytest.raises(ValueError, match="input 'set' is a reference or noise of a loop, which is no load"):
        simulate(scene, excitation(TIME), **HELD, constant_inputs={"set": 1e-3})
    other = Loop("other", SERVO, "turn", "force", reference="set")
    with pytest.raises(ValueError, match="reference or noise 'set' cannot be both"):
        replace(scene, loops=(*scene.loops, other))
    with pytest.raises(ValueError, match="'set' is a reference of one loop and the noise of another"):
        replace(scene, loops=(*scene.loops, Loop("other", SERVO, "x", "force", noise="set")))
    with pytest.raises(ValueError, match="unknown input that loop 'other' drives: 'set'; known: force"):
        replace(scene, loops=(*scene.loops, Loop("other", SERVO, "turn", "set")))
    with pytest.raises(ValueError, match=r"lacks the input\(s\) set"):
        simulate(scene, TimeHistory(TIME, [0 * TIME], ["force"], ["N"]), **HELD)
    with pytest.raises(ValueError, match="unknown input 'no loop takes it'; known: force, set"):
        simulate(scene, TimeHistory(TIME, [0 * TIME] * 3, ["force", "set", "no loop takes it"]), **HELD)
    with pytest.raises(ValueError, match="unknown input 'set'; known: force"):
        simulate(replace(scene, loops=()), excitation(TIME), **HELD)
    with pytest.raises(ValueError, match=r"1 measured signal.s. need as many references, got 2"):
        close_loop(linearize(scene), SERVO, measured="x", driven="force", reference=("a", "b"))
