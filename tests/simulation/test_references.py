"""Loops with set points and PID controllers: against own recursions of a cart, in every engine."""

import math
from dataclasses import replace

import numpy as np
import pytest

from nassim import (
    AngleSensor,
    Controller,
    Encoder,
    Loop,
    PointForce,
    RigidBody,
    Scene,
    Simulation,
    TimeHistory,
    cylindrical,
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
    controller_response,
    decentralised,
    decoupled,
    parallel,
    pid,
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


def excitation(time, *, push=0.0):
    """A set point that steps, and a disturbance that comes later; both are constant from step to step."""
    wanted = np.where(time - time[0] >= 0.01, 1e-3, 0.0) - np.where(time - time[0] >= 0.15, 3e-4, 0.0)
    return TimeHistory(time, [push * (time - time[0] >= 0.1), wanted], ["force", "set"], ["N", "m"])


def own_run(given, steps, *, resolution=0.0, windup=False):
    """Positions and commands at all time steps: the cart by its exponential, PID as a programmer writes it."""
    period, h = 1 / RATE, float(given.time[1] - given.time[0])
    omega = 2 * math.pi * CORNER
    fade = math.exp(-DAMPING / MASS * h)
    x = v = integral = slope = before = command = coming = 0.0
    tracking = math.inf if windup else math.sqrt(GAINS["kd"] / GAINS["ki"])
    rows = []
    for k, (push, wanted) in enumerate(given.values.T):
        if k % steps == 0:
            command = coming  # computed one sample ago
            seen = resolution * round(x / resolution) if resolution else x
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


def test_exudyn_and_single_steps_follow_too():
    scene, given = stage(), excitation(TIME[:1001], push=20.0)
    x, _ = own_run(given, 5)
    stepped = simulate(scene, given, time_step=1e-4, method="generalized_alpha", progress=False)
    np.testing.assert_allclose(stepped["x"], x, atol=2e-4 * abs(x).max())
    with Simulation(scene, time_step=1e-4, method="exact", hold_order=0, inputs={"force": 0.0, "set": 0.0}) as run:
        for push, wanted in given.values.T[1:]:
            run.step({"force": push, "set": wanted})
        assert run.outputs["x"] == pytest.approx(x[-1], rel=1e-9)


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
    alone = close_loop(
        linearize(scene), scene.loops[0].controller, measured="x", driven="force", reference="set", delay_order=4
    )
    low = frequency[:20]
    expected = expected[:20]
    np.testing.assert_allclose(frequency_response(alone, low).response("x", "set"), expected, rtol=2e-3)


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


def test_set_points_far_away_are_no_runaway():
    """The scene is a few centimetres large; the set point lies metres away, and the loop has no limit."""
    time = np.arange(4001) * 1e-3
    given = TimeHistory(time, [0 * time, 5.0 * (1 - np.cos(np.pi * time / 4))], ["force", "set"], ["N", "m"])
    slow = pid(200.0, 0.0, 60.0, sample_rate=1e3)
    record = simulate(stage(slow), given, time_step=1e-3, method="exact", progress=False)
    assert record["x"][-1] == pytest.approx(10.0, rel=0.05)


def test_references_are_placed_described_and_stored(tmp_path):
    scene = load(save(stage(), tmp_path / "scene.h5"))
    assert scene.loops[0].reference == ("set",)
    copy = placed(scene, "a")
    assert copy.loops[0].reference == ("a/set",)
    assert copy.inputs == ("a/force", "a/set")


def test_references_that_do_not_fit_are_refused():
    scene = stage()
    with pytest.raises(ValueError, match=r"measures 1 signal.s., but has 2 reference.s."):
        stage(reference=("set", "other"))
    with pytest.raises(ValueError, match="reference 'force' of a loop is also the input of an actuator"):
        stage(reference="force")
    other = Loop("other", SERVO, "turn", "force", reference="set")
    with pytest.raises(ValueError, match="reference 'set' cannot be both"):
        replace(scene, loops=(*scene.loops, other))
    with pytest.raises(ValueError, match="unknown input 'set'; known: force"):
        replace(scene, loops=(*scene.loops, Loop("other", SERVO, "turn", "set")))
    with pytest.raises(ValueError, match=r"lacks the input\(s\) set"):
        simulate(scene, TimeHistory(TIME, [0 * TIME], ["force"], ["N"]), **HELD)
    with pytest.raises(ValueError, match=r"1 measured signal.s. need as many references, got 2"):
        close_loop(linearize(scene), SERVO, measured="x", driven="force", reference=("a", "b"))
