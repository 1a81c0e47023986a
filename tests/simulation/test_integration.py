"""Time integration against rules and recursions written out by hand: springs, sensors, rho, loops, small motion."""

import re
import warnings
from dataclasses import replace

import numpy as np
import pytest
import scipy.linalg
from conftest import make_bar

from models.bench import make_bench
from nassim import (
    Encoder,
    FlexibleBody,
    Joint,
    Loop,
    PointForce,
    RigidBody,
    Scene,
    SpringDamper,
    TimeHistory,
    build_fe_model,
    craig_bampton,
    linearize,
    simulate,
    static_response,
)
from nassim.systems.controllers import Controller

MASSES, STIFFNESS, DAMPING = np.diag([2.0, 0.7]), (4e4, 9e3), (30.0, 6.0)
"""Two masses in a row, each on a spring and damper: ground to first, first to second."""


@pytest.fixture(scope="module")
def bar():
    return craig_bampton(build_fe_model(make_bar(), element_size=0.02, order=2, progress=False), progress=False)


def row_of_masses(beside=None, loops=(), axis="z"):
    """The ends of the springs lie apart, along the springs and across; with a flexible body beside, in small motion."""

    def at(*position):
        return np.roll(position, {"x": 1, "y": 2, "z": 0}[axis])

    foot, far = at(0.01, -0.02, -0.3), at(0.2, 0, 0.5)
    ground = RigidBody("ground", {"foot": foot, "a": np.zeros(3), "b": far, "c": at(5, 0, 0)}, fixed=True)
    points = {"centre": np.zeros(3), "low": at(0.03, 0, -0.1), "top": at(0, 0.04, 0.1)}
    first = RigidBody("first", points, 2.0, 0.01 * np.eye(3))
    second = RigidBody("second", {"centre": np.zeros(3), "low": at(0, -0.02, -0.2)}, 0.7, 0.01 * np.eye(3), far)
    joints = [Joint("a", "ground.a", "first.centre", free=axis), Joint("b", "ground.b", "second.centre", free=axis)]
    bodies = [ground, first, second]
    if beside is not None:
        bodies.append(FlexibleBody("beside", beside, position=at(5, 0, 0), fidelity="linear"))
        joints.append(Joint("c", "ground.c", "beside.left"))
    return Scene(
        "row",
        bodies,
        joints,
        (PointForce("push", "first.centre", axis, "force"),),
        (Encoder("first", "ground.a", "first.top", axis), Encoder("between", "first.low", "second.low", axis)),
        (
            SpringDamper("lower", "ground.foot", "first.low", axis, STIFFNESS[0], DAMPING[0]),
            SpringDamper("upper", "second.low", "first.top", axis, STIFFNESS[1], DAMPING[1]),
        ),
        loops,
        damping_ratio=0.0,
        cutoff_frequency=2e3,
    )


def matrix(lower, upper):
    return np.array([[lower + upper, -upper], [-upper, upper]])


def by_hand(force, step, rho):
    """Generalized alpha on the two masses: outputs "first" and "between", (2, n)."""
    alpha_m, alpha_f = (2 * rho - 1) / (rho + 1), rho / (rho + 1)
    gamma, beta = 0.5 - alpha_m + alpha_f, 0.25 * (1 - alpha_m + alpha_f) ** 2
    stiffness, damping = matrix(*STIFFNESS), matrix(*DAMPING)
    push = np.array([1.0, 0.0])
    x, v = np.zeros(2), np.zeros(2)
    now = np.linalg.solve(MASSES, push * force[0])
    inner, rows = now.copy(), [x]
    # Forces balance at the new state; the accelerations that are integrated are an average (Arnold, Bruels, 2007).
    scaled = (1 - alpha_f) / (1 - alpha_m)
    system = MASSES + scaled * (gamma * step * damping + beta * step**2 * stiffness)
    for value in force[1:]:
        x_part = x + step * v + step**2 * (0.5 - beta) * inner
        v_part = v + step * (1 - gamma) * inner
        inner_part = (alpha_f * now - alpha_m * inner) / (1 - alpha_m)
        x_known, v_known = x_part + beta * step**2 * inner_part, v_part + gamma * step * inner_part
        new = np.linalg.solve(system, push * value - damping @ v_known - stiffness @ x_known)
        following = inner_part + scaled * new
        x, v = x_part + beta * step**2 * following, v_part + gamma * step * following
        now, inner = new, following
        rows.append(x)
    x = np.array(rows).T
    return np.array([x[0], x[1] - x[0]])


def excitation(step, n=300):
    time = np.arange(n + 1) * step
    return TimeHistory(time, 5 * np.sin(2 * np.pi * 25 * time) * np.exp(-time / 0.03) + 2, ("force",), ("N",))


@pytest.mark.parametrize(("rho", "axis"), [(1.0, "z"), (0.6, "x"), (0.0, "y")])
@pytest.mark.parametrize("kind", ["large motion", "small motion"])
@pytest.mark.usefixtures("plain_steps")
def test_generalized_alpha_by_hand(bar, kind, rho, axis):
    """The same rule, step by step, in a scene of rigid bodies and joints and in minimal coordinates."""
    push = excitation(1e-3)
    scene = row_of_masses(bar if kind == "small motion" else None, axis=axis)
    record = simulate(scene, push, time_step=1e-3, spectral_radius=rho, progress=False)
    expected = by_hand(push.values[0], 1e-3, rho)
    other = by_hand(push.values[0], 1e-3, 0.3)
    scale = np.abs(expected).max()
    assert np.abs(record.values[1:] - expected).max() < 1e-5 * scale
    assert np.abs(other - expected).max() > 1e-3 * scale, "so rho counts"


def test_a_relaxed_row_stays_where_it_is():
    """Springs are relaxed wherever their ends are."""
    record = simulate(
        row_of_masses(), replace(excitation(1e-3), values=np.zeros((1, 301))), time_step=1e-3, progress=False
    )
    assert np.abs(record.values).max() < 1e-12


@pytest.mark.parametrize("fidelity", [None, "linear"])
def test_static_springs_in_series(bar, fidelity):
    found = static_response(row_of_masses(bar if fidelity else None), {"force": 8.0})
    assert found["first"] == pytest.approx(8.0 / STIFFNESS[0], rel=1e-9)
    assert found["between"] == pytest.approx(0.0, abs=1e-9 * found["first"])


def exactly(force, step, hold_order, control=None, period=1):
    """The two masses by matrix exponentials, (2, n); control: what a controller adds to the force, from "between"."""
    rates = np.zeros((6, 6))
    rates[:2, 2:4] = np.eye(2)
    rates[2:4, :2], rates[2:4, 2:4] = (-np.linalg.solve(MASSES, matrix(*kind)) for kind in (STIFFNESS, DAMPING))
    rates[2:4, 4] = [1 / MASSES[0, 0], 0.0]
    rates[4, 5] = 1.0
    forward = scipy.linalg.expm(rates * step)
    x, rows, command = np.zeros(4), [], 0.0
    for n, value in enumerate(force):
        rows.append([x[0], x[1] - x[0]])
        if control is not None and n % period == 0:
            command = control(n // period, rows[-1][1])
        slope = (force[n + 1] - value) / step * hold_order if n + 1 < len(force) else 0.0
        x = forward[:4] @ [*x, value + command, slope]
    return np.array(rows).T


@pytest.mark.parametrize(
    ("method", "options", "hold_order", "tolerance"),
    [
        ("exact", {}, 1, 1e-7),
        ("exact", {"hold_order": 0}, 0, 1e-7),
        ("explicit", {}, 0, 1e-7),
        ("generalized_alpha", {}, 1, 1e-5),
    ],
)
def test_all_methods_agree_with_matrix_exponentials(bar, method, options, hold_order, tolerance):
    """An input that jumps at the start and moves on, so half a step of time shows in every one."""
    step = 2e-5
    push = excitation(step, 1500)
    expected, other = (exactly(push.values[0], step, order) for order in (hold_order, 1 - hold_order))
    record = simulate(row_of_masses(bar), push, time_step=step, method=method, progress=False, **options)
    scale = np.abs(expected).max(axis=1, keepdims=True)
    assert np.abs(record.values[1:] - expected).max() < tolerance * scale.min()
    assert np.abs(other - expected).max() > 2 * tolerance * scale.max(), "so the hold counts"


@pytest.mark.parametrize(("method", "steps"), [("exact", 1), ("exact", 3), ("explicit", 3), ("generalized_alpha", 3)])
@pytest.mark.parametrize("delay", [0, 2])
def test_commands_act_when_they_should(bar, method, steps, delay):
    """A digital low-pass with gain: y[n] enters at sample n, its command acts from n + delay on."""
    rate, gain = 5e3, 8e3
    controller = Controller([[0.9]], [[0.1]], [[gain]], [[0.3 * gain]], rate, delay=delay)
    scene = row_of_masses(bar, (Loop("loop", controller, "between", "force"),))
    step = 1 / (rate * steps)
    push = excitation(step, 400 * steps)
    record = simulate(scene, push, time_step=step, method=method, progress=False)
    state, commands = 0.0, []

    def control(n, measured):
        nonlocal state
        commands.append(gain * (state + 0.3 * measured))
        state = 0.9 * state + 0.1 * measured
        return commands[n - delay] if n >= delay else 0.0

    expected = exactly(push.values[0], step, int(method != "explicit"), control, steps)
    scale = np.abs(expected).max(axis=1, keepdims=True)
    tolerance = 1e-3 if method == "generalized_alpha" else 1e-6
    assert np.all(np.abs(record.values[1:3] - expected) < tolerance * scale)
    held = np.repeat([0.0] * delay + commands, steps)[: len(record.time)]
    assert np.abs(record["loop"] - held).max() < tolerance * np.abs(held).max()
    assert np.abs(held).max() > 0.5


def hinged(bar, fidelity, axis):
    """A bar on a hinge along y or z, level, with gravity across both."""
    gravity = np.array([0, 0, -9.81]) if axis == "ry" else np.array([0, -9.81, 0])
    base = RigidBody("base", {"hook": np.zeros(3)}, fixed=True)
    body = FlexibleBody("bar", bar, fidelity=fidelity)
    joint = Joint("hinge", "base.hook", "bar.left", free=axis)
    return Scene("hinged", (base, body), (joint,), damping_ratio=0.0, gravity=gravity)


def warned(scene, duration, step, **options):
    quiet = TimeHistory(np.arange(round(duration / step) + 1) * step, np.zeros((0, round(duration / step) + 1)), (), ())
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        simulate(scene, quiet, time_step=step, start="released", progress=False, **options)
    return [str(w.message) for w in caught if "turned by" in str(w.message)]


@pytest.mark.parametrize("axis", ["ry", "rz"])
@pytest.mark.parametrize("method", ["exact", "generalized_alpha"])
def test_large_rotation_of_a_linear_body_is_told(bar, axis, method):
    """Falling from level, a bar turns by 3 g t^2 / 4 L: 0.066 rad in 30 ms, of which small motion misses 1 - cos."""
    options = {} if method == "exact" else {"spectral_radius": 0.8}
    (message,) = warned(hinged(bar, "linear", axis), 0.03, 1e-4, method=method, **options)
    angle, share = re.search(
        r"'bar' turned by up to (\S+) rad, where small motion is wrong by some (\S+) %", message
    ).groups()
    expected = 0.75 * 9.81 / 0.1 * 0.03**2
    assert float(angle) == pytest.approx(expected, rel=0.05)
    assert float(share) == pytest.approx(100 * (1 - np.cos(expected)), rel=0.1)
    assert warned(hinged(bar, "linear", axis), 0.01, 1e-4, method=method, **options) == []


def test_large_rotation_of_a_floating_body_is_not_told(bar):
    assert warned(hinged(bar, "ffrf", "ry"), 0.15, 5e-4, spectral_radius=0.8) == []


@pytest.mark.parametrize("fidelity", ["linear", "ffrf"])
def test_static_answers_beyond_small_motion_are_told(bar, fidelity):
    """A cantilever under a force at its end, bent by 78 mm on its 100 mm in the linear answer; and by 0.078 mm."""
    base = RigidBody("base", {"hook": np.zeros(3)}, fixed=True)
    tip = RigidBody("tip", {"centre": np.zeros(3)}, 1.0, 1e-3 * np.eye(3), (0.1, 0, 0))
    joints = (Joint("clamp", "base.hook", "bar.left"), Joint("bolt", "bar.right", "tip.centre"))
    scene = Scene(
        "cantilever",
        (base, FlexibleBody("bar", bar, fidelity=fidelity), tip),
        joints,
        (PointForce("push", "tip.centre", "z", "force"),),
        (Encoder("position", "base.hook", "tip.centre"),),
    )
    force = 0.078 * 3 * 200e9 * 0.01**4 / 12 / 0.1**3
    if fidelity == "linear":
        with pytest.raises(ValueError, match=r"comes to rest rotated by 1\.2 rad .* which is no small motion"):
            static_response(scene, {"force": force})
    else:
        with pytest.warns(UserWarning, match="'bar' is deformed by up to") as caught:
            found = static_response(scene, {"force": force})["position"]
        assert not any("'bar' turned by up to" in str(w.message) for w in caught)
        assert found == pytest.approx(0.078, rel=0.3)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert static_response(scene, {"force": 1e-3 * force})["position"] == pytest.approx(7.8e-5, rel=0.02)


@pytest.mark.parametrize("fidelity", ["linear", "ffrf"])
@pytest.mark.parametrize("resistance", [3.0, 1e4])
@pytest.mark.usefixtures("plain_steps")
def test_a_jump_at_the_start_with_a_loaded_sensor(apa_with_ports, fidelity, resistance):
    """The trapezoidal rule on the state space, whose charge is a state: nothing lost of the first step, nor of V_s."""
    bench = make_bench(
        apa=apa_with_ports, fidelity=fidelity, resistance=resistance, cutoff_frequency=500.0, damping_ratio=0.05
    )
    step, n = 4e-4, 60
    jump = TimeHistory(np.arange(n) * step, np.full((1, n), 0.01), bench.inputs, ("V",))
    record = simulate(bench, jump, time_step=step, progress=False)
    model = linearize(bench)
    half = step / 2 * model.A
    x, expected = np.zeros(len(half)), []
    for _ in range(n):
        expected.append(model.C @ x)
        x = np.linalg.solve(np.eye(len(half)) - half, x + half @ x + step * model.B[:, 0] * 0.01)
    expected = np.array(expected).T
    assert np.all(np.abs(record.values[1:] - expected) < 1e-4 * np.abs(expected).max(axis=1, keepdims=True))
