"""Closed loops against other routes: python-control, time stepping, closed forms."""

import math
from dataclasses import replace

import numpy as np
import pytest
import scipy.signal

from nassim.signals.frf import FRF
from nassim.simulation.linear.linearization import linearize
from nassim.systems.control_conversion import to_control
from nassim.systems.controller_models import controller_model
from nassim.systems.controllers import Controller, integral_force_feedback, notch, proportional, series
from nassim.systems.feedback import close_loop, loop_response, open_loop, sensitivity
from nassim.systems.linear_model import LinearModel, damping, frequency_response, sampled, unstable_poles
from nassim.systems.stability_margins import Margins, margins

RATE = 2000.0
POLE, ZERO = 100.0, 40.0
LOOP = {"measured": "force", "driven": "stroke"}


def one_mode(damping_ratio=0.0):
    """A mass on a spring, with an actuator (a stroke behind a stiffness) and force sensor in line beside the spring."""
    mass = 2.0
    spring, leg = mass * (2 * np.pi * ZERO) ** 2, mass * (2 * np.pi) ** 2 * (POLE**2 - ZERO**2)
    dashpot = 2 * damping_ratio * mass * 2 * np.pi * POLE
    return LinearModel(
        np.array([[0.0, 1.0], [-(spring + leg) / mass, -dashpot / mass]]),
        np.array([[0.0, 0.0], [leg / mass, 1 / mass]]),
        np.array([[-leg, 0.0], [1.0, 0.0]]),
        np.array([[leg, 0.0], [0.0, 0.0]]),
        ("stroke", "push"),
        ("force", "position"),
        ("N", "m"),
    )


def iff(share, *, delay=1, rate=RATE, **options):
    """Integral force feedback by its gain over the loop's high-frequency gain [rad/s]."""
    return integral_force_feedback(share / one_mode().D[0, 0], sample_rate=rate, delay=delay, **options)


def two_modes():
    """Two modes seen and driven by two pairs, each a little by the other's."""
    omega = 2 * np.pi * np.array([60.0, 90.0])
    shapes = np.array([[1.0, 0.3], [-0.4, 1.0]])
    state = np.block([[np.zeros((2, 2)), np.eye(2)], [-np.diag(omega**2), -np.diag(0.02 * omega)]])
    forces = np.vstack([np.zeros((2, 2)), shapes.T])
    readings = np.hstack([np.zeros((2, 2)), shapes])
    return LinearModel(state, forces, readings, np.zeros((2, 2)), ("f1", "f2"), ("v1", "v2"))


def step_by_step(model, controller, n, *, push):
    """The loop as a computer runs it: read, compute, keep for the delay. Outputs, (outputs, n); the plant by SciPy."""
    state, held, *_ = scipy.signal.cont2discrete(model.matrices, 1 / controller.sample_rate, method="zoh")
    x, xk, waiting = np.zeros(len(state)), np.zeros(len(controller.A)), [0.0] * controller.delay
    record = np.empty((len(model.outputs), n))
    for k in range(n):
        u = np.array([waiting.pop(0), push if k == 0 else 0.0])
        record[:, k] = model.C @ x + model.D @ u
        y = record[:1, k]
        waiting.append((controller.C @ xk + controller.D @ y).item())
        xk = controller.A @ xk + controller.B @ y
        x = state @ x + held @ u
    return record


def sorted_poles(values):
    return np.sort_complex(np.round(values, 9))


@pytest.mark.parametrize("delay", [1, 2, 5])
def test_sampled_loop_is_python_controls(delay):
    control = pytest.importorskip("control")
    plant, controller = one_mode(0.01), iff(50.0, delay=delay)
    ours = close_loop(sampled(plant, RATE), controller, **LOOP)
    k = to_control(controller_model(controller, inputs="force", outputs="stroke", time_step=1 / RATE))
    z = control.tf([1.0], [1.0] + [0.0] * delay, 1 / RATE)
    by_hand = control.ss(*controller.matrices, 1 / RATE) * control.ss(z)
    g = to_control(plant).sample(1 / RATE, method="zoh")
    for theirs in (k, by_hand):
        closed = control.feedback(g[0, 0], theirs, sign=+1)
        assert sorted_poles(np.linalg.eigvals(ours.A)) == pytest.approx(sorted_poles(closed.poles()), abs=1e-6)
        frequency = np.array([3.0, 99.0, 300.0])
        there = closed(np.exp(2j * np.pi * frequency / RATE))
        assert frequency_response(ours, frequency).response("force", "stroke") == pytest.approx(there, rel=1e-8)


@pytest.mark.parametrize("share", [5.0, 20.0, 60.0])
@pytest.mark.parametrize("delay", [1, 2])
def test_logarithmic_decrement_is_the_predicted_damping(share, delay):
    plant, controller = one_mode(0.005), iff(share, delay=delay)
    frequency, ratio = damping(close_loop(sampled(plant, RATE), controller, **LOOP))
    mode = np.argmin(np.abs(frequency - POLE))
    record = step_by_step(plant, controller, 400, push=1.0)[1]
    # Two oscillating states and one drift: three samples in a row fix their recursion once the delays have died out.
    rows = np.lib.stride_tricks.sliding_window_view(record[60:160], 4)
    z = np.roots([1.0, *-np.linalg.lstsq(rows[:, 2::-1], rows[:, 3], rcond=None)[0]])
    s = np.log(z.astype(complex)) * RATE
    s = s[np.argmin(np.abs(s - 2j * np.pi * POLE))]
    assert -s.real / abs(s) == pytest.approx(ratio[mode], rel=1e-5)
    assert abs(s) / (2 * np.pi) == pytest.approx(frequency[mode], rel=1e-5)
    assert ratio[mode] > 0.005 + 0.3 * share / (4 * np.pi * POLE)


def test_closed_loop_steps_like_the_loop_itself():
    plant, controller = one_mode(0.01), iff(80.0, delay=3, corner_frequency=2.0)
    closed = close_loop(sampled(plant, RATE), controller, **LOOP)
    assert (closed.inputs, closed.outputs, closed.units) == (plant.inputs, plant.outputs, plant.units)
    pushes = np.zeros((300, 2))
    pushes[0, 1] = 1.0
    _, record, _ = scipy.signal.dlsim((*closed.matrices, 1 / RATE), pushes)
    expected = step_by_step(plant, controller, 300, push=1.0)
    assert pytest.approx(expected, abs=1e-10 * np.abs(expected).max()) == record.T


def test_wrong_sign_and_long_delay_are_unstable():
    plant = one_mode(0.01)
    discrete = sampled(plant, RATE)

    def growing(controller):
        return unstable_poles(close_loop(discrete, controller, **LOOP))

    assert growing(iff(60.0)) == ()
    assert unstable_poles(discrete) == ()
    assert len(growing(iff(-60.0))) == 2, "the mode, and the integrator with the wrong sign"
    (late,) = growing(iff(60.0, delay=10))
    assert late.frequency == pytest.approx(POLE, rel=0.1)
    assert f"oscillation at {late.frequency:.4g} Hz" in str(late)
    record = step_by_step(plant, iff(60.0, delay=10), 2000, push=1.0)[1]
    growth = np.log(np.abs(record[1800:]).max() / np.abs(record[800:1000]).max()) / (1000 / RATE)
    assert growth == pytest.approx(late.growth_rate, rel=0.02)
    drift = unstable_poles(LinearModel(np.eye(1), np.eye(1), np.eye(1), np.zeros((1, 1)), ("u",), ("y",)))
    assert (drift[0].frequency, drift[0].growth_rate) == (0.0, 1.0)
    assert str(drift[0]) == "a drift that grows e-fold in 1 s"
    both = LinearModel(np.diag([1.0, 5.0]), np.eye(2), np.eye(2), np.zeros((2, 2)), ("u", "v"), ("x", "y"))
    assert [pole.growth_rate for pole in unstable_poles(both)] == [5.0, 1.0], "the fastest first"
    free = LinearModel(np.eye(2, k=1), np.eye(2), np.eye(2), np.zeros((2, 2)), ("u", "v"), ("x", "y"))
    assert unstable_poles(free) == (), "rigid motion is at rest"
    for angle in np.linspace(0.1, 2.1, 11):  # a free mass, sampled, in other states: rounding divides its double pole
        turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        assert unstable_poles(replace(free, A=turn @ [[1, 1 / RATE], [0, 1]] @ turn.T, time_step=1 / RATE)) == ()


def test_continuous_loop_approaches_the_sampled_one():
    plant, pair = two_modes(), {"measured": "v1", "driven": "f1"}

    def mode(model, controller, **options):
        poles = close_loop(model, controller, **pair, **options).poles()
        return poles[np.argmin(np.abs(poles - 2j * np.pi * 60.0))]

    errors = []
    for rate in (2000.0, 4000.0):
        controller = proportional(-100.0, sample_rate=rate)
        exact = mode(sampled(plant, rate), controller)
        errors.append(abs(mode(plant, controller) - exact))
        assert errors[-1] < 0.05 * abs(mode(plant, controller, delay_order=0) - exact)
    assert errors[1] < errors[0] / 3, "what is left of the hold falls with the square of the sample period"


def test_pade_approximates_the_delay():
    frequency = np.array([5.0, 50.0, 250.0])
    for delay in (0, 1, 3):
        controller = iff(60.0, delay=delay, corner_frequency=4.0)
        ideal = controller_model(controller, inputs="force", outputs="stroke", delay_order=0)
        late = np.exp(-2j * np.pi * frequency * (delay + 0.5) / RATE)
        expected = frequency_response(ideal, frequency).values * late
        for order, error in ((6, 1e-6), (5, 2e-5)):
            model = controller_model(controller, inputs="force", outputs="stroke", delay_order=order)
            assert frequency_response(model, frequency).values == pytest.approx(expected, rel=error)
        s = 2j * np.pi * frequency
        formula = -60.0 / one_mode().D[0, 0] / (s + 2 * np.pi * 4.0)
        assert frequency_response(ideal, frequency).values[0, 0] == pytest.approx(formula, rel=1e-9)


def test_several_signals_at_once_or_one_after_the_other():
    plant = sampled(two_modes(), RATE)
    one, two = (proportional(-gain, sample_rate=RATE) for gain in (30.0, 50.0))
    both = proportional(np.diag([-30.0, -50.0]), sample_rate=RATE)
    first = close_loop(plant, one, measured="v1", driven="f1")
    after = close_loop(first, two, measured="v2", driven="f2")
    together = close_loop(plant, both, measured=("v1", "v2"), driven=("f1", "f2"))
    crossed = close_loop(plant, proportional(np.diag([-50.0, -30.0]), sample_rate=RATE),
                         measured=("v2", "v1"), driven=("f2", "f1"))  # fmt: skip
    frequency = np.array([1.0, 60.0, 88.0, 500.0])
    expected = frequency_response(after, frequency).values
    for closed in (together, crossed):
        assert frequency_response(closed, frequency).values == pytest.approx(expected, rel=1e-9)
    assert damping(together)[1].min() > damping(plant)[1].min()


def test_sensitivity_is_what_the_loop_does():
    plant, frequency = sampled(two_modes(), RATE), np.array([1.0, 60.0, 88.0, 500.0])
    controller = proportional([[-30.0, 4.0], [-8.0, -50.0]], sample_rate=RATE)
    pair = {"measured": ("v1", "v2"), "driven": ("f1", "f2")}
    s, t = sensitivity(open_loop(plant, controller, frequency, **pair))
    before = frequency_response(plant, frequency).values
    after = frequency_response(close_loop(plant, controller, **pair), frequency).values
    assert np.einsum("abf,bcf->acf", s.values, before) == pytest.approx(after, rel=1e-9)
    assert s.values + t.values == pytest.approx(np.broadcast_to(np.eye(2)[:, :, None], s.values.shape))
    assert (s.outputs, s.inputs) == (("v1", "v2"), ("v1", "v2"))


def test_open_loop_of_a_continuous_model_has_delay_and_hold():
    plant, controller, frequency = one_mode(0.01), iff(60.0), np.array([20.0, 95.0, 300.0])
    # By hand: the leg's force at rest of the mass, less what its motion takes off; Tustin's integrator; delay and hold.
    s, period, mass = 2j * np.pi * frequency, 1 / RATE, 2.0
    leg = mass * (2 * np.pi) ** 2 * (POLE**2 - ZERO**2)
    dashpot = 2 * 0.01 * mass * 2 * np.pi * POLE
    g = leg - leg**2 / (mass * s**2 + dashpot * s + mass * (2 * np.pi * POLE) ** 2)
    k = -60.0 / leg * period / 2 / np.tanh(s * period / 2)
    late = np.exp(-s * period) * (1 - np.exp(-s * period)) / (s * period)
    loop = open_loop(plant, controller, frequency, **LOOP, gain=2.0)
    assert loop.values[0, 0] == pytest.approx(-2.0 * g * k * late, rel=1e-9)
    response = frequency_response(plant, frequency)
    assert np.array_equal(loop_response(response, controller, **LOOP, gain=2.0).values, loop.values)
    pair = {"measured": "v1", "driven": "f1"}
    controller = proportional(-9.0, sample_rate=RATE)
    exact = open_loop(sampled(two_modes(), RATE), controller, frequency, **pair).values[0, 0]
    # What a sampler sees is the sum over all frequencies that it cannot tell apart.
    shifts = RATE * np.arange(-400, 401)
    folded = []
    for one in frequency:
        every = one + shifts
        order = np.argsort(np.abs(every))
        values = open_loop(two_modes(), controller, np.abs(every)[order], **pair).values[0, 0]
        folded.append(np.sum(np.where(every[order] < 0, values.conj(), values)))
    assert exact == pytest.approx(folded, rel=1e-4)


def test_margins_of_an_integrator_with_delay():
    frequency, crossover, delay = np.geomspace(0.1, 1000, 20001), 2 * np.pi * 20.0, 1e-3
    s = 2j * np.pi * frequency
    found = margins(FRF(frequency, (crossover / s * np.exp(-s * delay))[None, None], ("y",), ("y",)))
    assert found.phase_margin == pytest.approx(90 - np.degrees(crossover * delay), rel=1e-6)
    assert found.phase_margin_frequency == pytest.approx(20.0, rel=1e-6)
    assert found.gain_margin == pytest.approx(np.pi / (2 * crossover * delay), rel=1e-6)
    assert found.gain_margin_frequency == pytest.approx(250.0, rel=1e-6)


def test_the_smallest_of_several_margins_counts():
    """Loops whose magnitude and phase are written down: five crossings, of which that in the middle is nearest."""
    f = np.linspace(1.0, 59.0, 20001)

    def of(magnitude, degrees):
        return margins(FRF(f, (magnitude * np.exp(1j * np.radians(degrees)))[None, None], ("y",), ("y",)))

    # |L| = 1 at 10, 30 and 50 Hz, where the phase is 60, 20 and 60 deg away from -180 deg.
    found = of(np.exp(np.cos(2 * np.pi * f / 40)), -160 + 0.1 * (f - 30) ** 2)
    assert (found.phase_margin, found.phase_margin_frequency) == pytest.approx((20.0, 30.0), rel=1e-5)
    # -180 deg at 10, 20, 30, 40 and 50 Hz, where |L| is largest in the middle.
    found = of(0.2 + 0.5 * np.exp(-(((f - 30) / 8) ** 2)), -180 + 30 * np.sin(2 * np.pi * f / 20))
    assert (found.gain_margin, found.gain_margin_frequency) == pytest.approx((1 / 0.7, 30.0), rel=1e-5)


def of_polynomials(numerator, denominator, frequency):
    s = 2j * np.pi * frequency
    return FRF(frequency, (np.polyval(numerator, s) / np.polyval(denominator, s))[None, None], ("y",), ("y",))


def test_margins_of_an_unstable_loop_are_negative_and_below_one():
    """30 / (s (s + 1) (s / 5 + 1)): -5 at w^2 = 5, and |L| = 1 at a phase found by its arcs."""
    found = margins(of_polynomials([30.0], [0.2, 1.2, 1.0, 0.0], np.geomspace(1e-2, 1e2, 20001)))
    crossing = scipy.optimize.brentq(lambda w: w * np.hypot(w, 1) * np.hypot(w / 5, 1) - 30, 1.0, 10.0)
    phase = 90 - np.degrees(np.arctan(crossing) + np.arctan(crossing / 5))
    assert phase == pytest.approx(-30.67, abs=0.01)
    assert (found.phase_margin, found.phase_margin_frequency) == pytest.approx((phase, crossing / 2 / np.pi), rel=1e-5)
    assert (found.gain_margin, found.gain_margin_frequency) == pytest.approx((1 / 5, np.sqrt(5) / 2 / np.pi), rel=1e-5)


def test_a_loop_beyond_the_critical_point_at_zero_frequency_is_unstable():
    """L = -2 / (s + 1), as 1 + L = 0 at s = 1: half of the gain would be stable, 60 deg are lacking at w^2 = 3."""
    for first in (0.0, 0.001):
        found = margins(of_polynomials([-2.0], [1.0, 1.0], np.linspace(first, 10.0, 2001)))
        assert (found.gain_margin, found.gain_margin_frequency) == (pytest.approx(0.5, rel=1e-4), 0.0)
        assert found.phase_margin == pytest.approx(-60.0, abs=1e-2)
    always = margins(of_polynomials([-2.0], [1.0], np.linspace(1.0, 10.0, 20)))
    assert (always.gain_margin, always.phase_margin) == (pytest.approx(0.5), -np.inf)  # no phase helps


def test_an_integrator_of_the_wrong_sign_is_unstable_from_a_frequency_on_where_its_delay_counts():
    """-2 / s, late by a second: by 18 deg at the first frequency. Every gain drifts away."""
    f = np.geomspace(0.05, 20.0, 4001)
    loop = -2 / (2j * np.pi * f) * np.exp(-2j * np.pi * f)
    assert margins(FRF(f, loop[None, None], ("y",), ("y",))).gain_margin == 0.0


def test_positive_feedback_below_one_may_grow_to_one():
    """-0.5 / (s^2 + 0.1 s + 1) drifts from twice the gain on, a limit at 0 Hz that no crossing above it shows."""
    for first in (0.0, 1e-3):
        found = margins(of_polynomials([-0.5], [1.0, 0.1, 1.0], np.linspace(first, 10.0, 20001)))
        assert (found.gain_margin, found.gain_margin_frequency) == (pytest.approx(2.0, rel=1e-4), 0.0)


def test_an_unstable_loop_lacks_the_least_of_what_its_crossings_lack():
    """|L| falls through 1 at 10 and 50 Hz, at 70 and 20 deg beyond -180 deg, and rises through it between."""
    f = np.linspace(1.0, 59.0, 20001)
    phase = np.interp(f, [1.0, 10.0, 30.0, 50.0, 59.0], [-100.0, -250.0, -220.0, -200.0, -200.0])
    loop = np.exp(np.cos(2 * np.pi * f / 40) + 1j * np.radians(phase))
    found = margins(FRF(f, loop[None, None], ("y",), ("y",)))
    assert (found.phase_margin, found.phase_margin_frequency) == pytest.approx((-20.0, 50.0), rel=1e-4)
    assert found.gain_margin < 1


def test_a_resonance_late_by_a_third_of_its_period_lacks_least_where_its_magnitude_rises():
    """g w^2 / (s^2 + 2 z w s + w^2) exp(-s d) is 1 at x^2 = 1 - 2 z^2 -+ sqrt((1 - 2 z^2)^2 - 1 + g^2), x = s / i w."""
    gain, ratio, center, delay = 0.3, 0.02, 100.0, 3e-3
    middle = 1 - 2 * ratio**2
    low = np.sqrt(middle - np.sqrt(middle**2 - 1 + gain**2))
    late = np.degrees(np.arctan2(2 * ratio * low, 1 - low**2)) + 360 * low * center * delay
    f = np.geomspace(1.0, 1e3, 20001)
    x = f / center
    loop = gain / (1 - x**2 + 2j * ratio * x) * np.exp(-2j * np.pi * f * delay)

    def turned(degrees):
        return margins(FRF(f, (loop * np.exp(1j * np.radians(degrees)))[None, None], ("y",), ("y",)))

    found = turned(0.0)
    assert late == pytest.approx(96.9, abs=0.1)  # so -180 deg lies farther than the magnitude falls
    assert (found.phase_margin, found.phase_margin_frequency) == pytest.approx((late - 180, low * center), rel=1e-4)
    stable = [turned(found.phase_margin + beyond).gain_margin > 1 for beyond in (1.0, -1.0)]
    assert stable == [False, True]


def test_a_conditionally_stable_loop_of_too_much_gain_lacks_the_larger_factor():
    """400 (s + 1)^2 / (s^3 (s / 100 + 1)^2) is real where w - w / 100 = 1 + w^2 / 100; too little gain fails too."""
    low, high = np.sort(np.roots([0.01, -0.99, 1.0]))
    factor = high**3 * (1 + high**2 / 1e4) / (400 * (1 + high**2))
    found = margins(
        of_polynomials([400.0, 800.0, 400.0], [1e-4, 0.02, 1.0, 0.0, 0.0, 0.0], np.geomspace(1e-2, 1e3, 20001))
    )
    assert (found.gain_margin, found.gain_margin_frequency) == pytest.approx((factor, high / 2 / np.pi), rel=1e-5)
    assert low**3 < 400 * factor * (1 + low**2)


@pytest.mark.parametrize("time_step", [None, 0.5])
def test_signs_of_margins_tell_stability(time_step):
    """Random loops, with resonances, integrators of either sign and zeros on both sides, by the roots of 1 + L = 0.

    Sampled ones have the same poles and zeros in the s-plane; at half of their rate, they end on the axis.
    """
    random, told = np.random.default_rng(8), {True: 0, False: 0}
    frequency = np.geomspace(1e-5, 1e3 if time_step is None else 0.5 / time_step, 20001)

    def growing(polynomial):
        roots = np.roots(polynomial)
        return int(np.sum(roots.real > 0 if time_step is None else np.abs(roots) > 1))

    for _ in range(200):
        poles = np.concatenate([-(10 ** random.uniform(-1, 1, random.integers(1, 3))), np.zeros(random.integers(0, 3))])
        for omega, ratio in zip(10 ** random.uniform(-1, 1, 2), 10 ** random.uniform(-1.5, -0.3, 2), strict=True):
            poles = np.append(poles, omega * (-ratio + 1j * np.sqrt(1 - ratio**2) * np.array([1, -1])))
        zeros = random.choice([-1, -1, -1, 1], 3) * 10 ** random.uniform(-1, 1, 3)
        gain = 10 ** random.uniform(-3, 1) * random.choice([-1, 1, 1])
        if time_step is not None:
            lasting, poles, zeros = poles[poles != 0], np.exp(poles * time_step), np.exp(zeros * time_step)
            gain *= abs(np.prod(1 - np.exp(lasting * time_step)) / np.prod(1 - zeros))
        denominator, numerator = np.poly(poles).real, gain * np.poly(zeros)
        at = 2j * np.pi * frequency if time_step is None else np.exp(2j * np.pi * frequency * time_step)
        values = np.polyval(numerator, at) / np.polyval(denominator, at)
        if abs(values[0]) < 1 and np.any(poles == (0 if time_step is None else 1)):
            continue
        found = margins(FRF(frequency, values[None, None], ("y",), ("y",)))
        stable = not growing(np.polyadd(denominator, numerator))
        if np.isfinite(found.phase_margin):
            assert (found.phase_margin > 0) == stable
            told[stable] += 1
        assert (found.gain_margin > 1) == stable
        if 0 < found.gain_margin < np.inf:
            less, more = (growing(np.polyadd(denominator, k * found.gain_margin * numerator)) for k in (0.999, 1.001))
            assert less != more, "a pole crosses there"
    assert min(told[True], told[False]) > 20


def test_loops_of_signals_in_metres_and_newtons_are_regular():
    """They were taken for singular: entries of 1e-9 and 1e9 beside each other, with determinants of 5 and 21."""
    loop = FRF([10.0], np.array([[1.0, 1e-9], [1e9, 2.0]])[..., None], ("x", "f"), ("x", "f"))
    found, _ = sensitivity(loop)
    np.testing.assert_allclose(found.values[..., 0], [[0.6, -2e-10], [-2e8, 0.4]], rtol=1e-12)
    direct, gains = np.array([[1e-6, 3e-10], [2e3, 0.4]]), np.array([[-1e5, -0.01], [-1e4, -0.5]])
    plant = LinearModel([[0.5]], np.zeros((1, 2)), np.zeros((2, 1)), direct, ("u", "v"), ("x", "f"), time_step=1e-3)
    controller = proportional(gains, sample_rate=1e3, delay=0)
    closed = close_loop(plant, controller, measured=("x", "f"), driven=("u", "v"))
    np.testing.assert_allclose(closed.D, np.linalg.solve(np.eye(2) - direct @ gains, direct), rtol=1e-9)


def test_margins_are_the_same_from_beyond_the_first_crossing_on():
    """2e5 (1 + s / 30)^2 / (1 + s)^3, stable by its high gain only: its phase falls below -180 deg and comes back."""
    late = np.geomspace(0.4, 1e3, 4000)
    found, whole = (
        margins(of_polynomials(np.poly([-30, -30]) * 2e5 / 900, np.poly([-1, -1, -1]), f))
        for f in (late, np.append(np.geomspace(1e-3, 0.39, 500), late))
    )
    assert found.gain_margin == whole.gain_margin == np.inf
    assert found.phase_margin == whole.phase_margin > 60


@pytest.mark.parametrize(("slope", "delay"), [(0, 10e-3), (1, 6e-3)], ids=["flat", "integrator"])
def test_a_loop_that_begins_between_180_and_360_degrees_late_is_unstable(slope, delay):
    """It is below one where it is late by a turn and a half: no smaller gain is stable."""
    f = np.linspace(60.0, 400.0, 2001)
    loop = 2 * (60 / (1j * f)) ** slope / np.sqrt(1 + (f / 100) ** 8) * np.exp(-2j * np.pi * f * delay)
    found = margins(FRF(f, loop[None, None], ("y",), ("y",)))
    assert found.gain_margin == 0.0
    assert found.phase_margin < 0


def test_a_static_limit_below_the_first_frequency_is_told(recwarn):
    """-0.5 / (1 + s / w), a leaky integrator of positive feedback, drifts away at twice the gain, at 0 Hz."""
    loop = [-0.5], [1 / (2 * np.pi), 1.0]
    assert margins(of_polynomials(*loop, np.geomspace(1e-2, 1e2, 401))).gain_margin == pytest.approx(2.0, rel=1e-3)
    with pytest.warns(UserWarning, match="begins at 0.3 Hz, 17 deg from .* gain margin of 2.09 or less"):
        margins(of_polynomials(*loop, np.geomspace(0.3, 1e2, 401)))
    below = of_polynomials(*loop, np.geomspace(0.3, 1e2, 401))
    with pytest.warns(UserWarning, match="begins at 0.3 Hz, 17 deg from .* gain margin of 2.09 or less"):
        margins(replace(below, values=below.values.conj()))  # on the other side of the axis
    margins(of_polynomials([0.5], loop[1], np.geomspace(0.2, 1e2, 401)))  # begins far from the negative axis
    assert margins(of_polynomials(*loop, np.geomspace(3.0, 1e2, 401))).gain_margin == np.inf  # no integrator: |L| < 1
    f = np.linspace(0.3, 9.0, 401)
    near = np.linspace(0.5, 0.9, 401) * np.exp(1j * np.radians(np.linspace(163.0, -200.0, 401)))
    assert margins(FRF(f, near[None, None], ("y",), ("y",))).gain_margin < 1.2  # what may lie below matters less
    assert not recwarn.list


@pytest.mark.parametrize("gain", [0.3, 0.8, 1.7, 40.0])
@pytest.mark.parametrize("delay", [0, 1, 2])
@pytest.mark.parametrize("beside", [[], [0.5 * (1 - 1e-15)]], ids=["", "beside"])
def test_a_sampled_loop_may_cross_the_axis_at_half_of_its_rate(gain, delay, beside):
    """A gain late by a sample, x_(k+1) = -g x_k, is unstable from 1 on, as is 1 / (z - 1) without a delay from 2 on.

    Two samples late, a gain has its margin of 1 at a quarter of the rate, and 1 / (z - 1) late by a sample at a sixth.
    A frequency within rounding of half of the rate, as resonances there need, changes nothing.
    """
    wire = LinearModel(
        np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), [[1.0]], ("stroke",), ("force",), time_step=1.0
    )
    total = LinearModel([[1.0]], [[1.0]], [[1.0]], [[0.0]], ("stroke",), ("force",), time_step=1.0)
    f = np.sort([*np.linspace(1e-3, 0.5, 6001), *beside])
    for plant, most, at in (
        (wire, 1.0, {1: 0.5, 2: 0.25}),
        (total, {0: 2.0, 1: 1.0, 2: (np.sqrt(5) - 1) / 2}, {0: 0.5, 1: 1 / 6, 2: 0.1}),
    ):
        if delay not in at:
            continue
        limit = most[delay] if isinstance(most, dict) else most
        loop = open_loop(plant, proportional(-gain, sample_rate=1.0, delay=delay), f, **{**LOOP, "measured": "force"})
        found = margins(loop)
        assert found.gain_margin == pytest.approx(limit / gain, rel=1e-4)
        assert found.gain_margin_frequency == pytest.approx(at[delay], abs=1e-3)
        assert (found.phase_margin > 0) == (gain < limit)


def test_an_oscillation_almost_without_damping_stays_beside_the_axis():
    """1 / (s^2 + 2 z s + 1) is real within rounding above its resonance, and stable with every gain."""
    found = margins(of_polynomials([1.0], [1.0, 2e-11, 1.0], np.geomspace(1e-2, 0.9, 400)))
    assert found.gain_margin == np.inf


@pytest.mark.parametrize(("pole", "zero"), [(0.5, 0.4), (0.4, 0.5)])
def test_positive_feedback_without_delay_may_be_stable_beyond_the_critical_point(pole, zero):
    """L = -2 (z - a) / (z - p) is real below -1 at both ends, and 1 + L = 0 at z = 2 a - p only."""
    f = np.linspace(0.0, 0.5, 2001)
    z = np.exp(2j * np.pi * f)
    found = margins(FRF(f, (-2 * (z - zero) / (z - pole))[None, None], ("y",), ("y",)))
    assert (found.gain_margin, found.phase_margin) == (np.inf, np.inf)


def test_a_loop_that_ends_near_the_axis_is_told(recwarn):
    """1 / (z - 1) has the real part -1/2 everywhere, and comes to the axis at half of the sample rate only."""
    total = LinearModel([[1.0]], [[1.0]], [[1.0]], [[0.0]], ("stroke",), ("force",), time_step=1.0)

    def ending(at, gain=0.8):
        controller = proportional(-gain, sample_rate=1.0, delay=0)
        return open_loop(total, controller, np.linspace(1e-3, at, 2000), **{**LOOP, "measured": "force"})

    with pytest.warns(
        UserWarning, match="ends at 0.45 Hz, 9 deg from the negative real axis .* gain margin of about 2.47;"
    ):
        assert margins(ending(0.45)).gain_margin == np.inf
    margins(ending(0.5))
    margins(ending(0.45, gain=0.19))  # a crossing above is far from -1
    assert not recwarn.list


def test_margins_agree_with_the_closed_loop():
    plant, controller = sampled(one_mode(0.01), RATE), iff(60.0, delay=2)
    loop = open_loop(plant, controller, np.linspace(0.1, RATE / 2, 50001), **LOOP)
    found = margins(loop)
    for factor, stable in ((0.999, True), (1.001, False)):
        closed = close_loop(plant, controller, **LOOP, gain=factor * found.gain_margin)
        assert (unstable_poles(closed) == ()) == stable
    assert unstable_poles(closed)[0].frequency == pytest.approx(found.gain_margin_frequency, rel=1e-3)
    s, _ = sensitivity(loop)
    assert found.modulus_margin == pytest.approx(1 / np.abs(s.values).max(), rel=1e-9)
    assert 0 < found.modulus_margin <= 1
    for first in (0.1, 0.0):  # a band may begin at an undamped zero
        steady = np.append(first, np.full(9, 0.1))[None, None]
        calm = margins(FRF(np.arange(1.0, 11.0), steady, ("y",), ("y",)))
        assert (calm.gain_margin, calm.phase_margin) == (np.inf, np.inf)
        assert calm.modulus_margin == pytest.approx(1 + first)


def test_closed_loop_by_its_difference_equations():
    """Oscillator, integrator and delay written out: no matrices, no discretisation but the closed form of the swing."""
    controller = iff(80.0, delay=2, corner_frequency=3.0)
    closed = close_loop(sampled(one_mode(0.02), RATE), controller, **LOOP)
    n, mass, period = 400, 2.0, 1 / RATE
    leg = mass * (2 * np.pi) ** 2 * (POLE**2 - ZERO**2)
    omega, decay = 2 * np.pi * POLE, 0.02 * 2 * np.pi * POLE
    turn = np.sqrt(omega**2 - decay**2)
    fade, sine, cosine = np.exp(-decay * period), np.sin(turn * period), np.cos(turn * period)
    corner = 2 * np.pi * 3.0
    over, under = 2 / period + corner, 2 / period - corner
    x = v = drive = before = 0.0
    waiting, expected = [0.0, 0.0], np.empty((n, 2))
    for k in range(n):
        stroke, push = waiting.pop(0), 1.0 if k < 3 else 0.0
        force = leg * (stroke - x)
        expected[k] = force, x
        # (2/T (1 - 1/z) + corner (1 + 1/z)) drive = -80 / leg (1 + 1/z) force
        drive = (under * drive - 80.0 / leg * (force + before)) / over
        before = force
        waiting.append(drive)
        rest = (leg * stroke + push) / (mass * omega**2)
        away = x - rest
        x = rest + fade * (away * cosine + (v + decay * away) / turn * sine)
        v = fade * (v * cosine - (decay * v + omega**2 * away) / turn * sine)
    pushes = np.zeros((n, 2))
    pushes[:3, 1] = 1.0
    _, found, _ = scipy.signal.dlsim((*closed.matrices, period), pushes)
    np.testing.assert_allclose(found, expected, atol=1e-10 * np.abs(expected).max(axis=0).min())


def test_undelayed_loop_through_feedthrough():
    plant = sampled(one_mode(0.01), RATE)
    closed = close_loop(plant, proportional(-0.5 / plant.D[0, 0], sample_rate=RATE, delay=0), **LOOP)
    frequency = np.array([5.0, 80.0, 400.0])
    g = frequency_response(plant, frequency).response("force", "stroke")
    expected = g / (1 + 0.5 * g / plant.D[0, 0])
    assert frequency_response(closed, frequency).response("force", "stroke") == pytest.approx(expected, rel=1e-9)
    with pytest.raises(ValueError, match="add a delay"):
        close_loop(plant, proportional(1 / plant.D[0, 0], sample_rate=RATE, delay=0), **LOOP)


def test_positive_gain_damps_the_bench(bench):
    """The bench's force sensor: in phase with the drive above the resonance, so the damping sign is negative."""
    plant = linearize(bench)
    pair = {"measured": "sensor_voltage", "driven": "actuator_voltage"}
    above = frequency_response(plant, np.array([300.0])).response("sensor_voltage", "actuator_voltage")
    assert abs(np.angle(above[0], deg=True)) < 5
    first = damping(plant)[1][0]
    for rate, model in ((1e4, plant), (1e4, sampled(plant, 1e4))):
        ratios = {}
        for gain in (-20.0, 20.0):
            controller = integral_force_feedback(gain, sample_rate=rate)
            poles = close_loop(model, controller, **pair).poles()
            mode = poles[np.argmin(np.abs(poles - 2j * np.pi * damping(plant)[0][0]))]
            ratios[gain] = -mode.real / abs(mode)
        assert ratios[-20.0] < first - 0.03 < first + 0.03 < ratios[20.0]
    long = integral_force_feedback(150.0, sample_rate=1e4, delay=40)
    assert unstable_poles(close_loop(sampled(plant, 1e4), long, **pair))


PLANT, SAMPLED, GAIN = one_mode(), sampled(one_mode(), RATE), proportional(1.0, sample_rate=RATE)
WIDE = Controller(np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((2, 0)), np.ones((2, 1)), RATE)
AT_NYQUIST = Controller(-np.eye(1), np.eye(1), np.eye(1), np.zeros((1, 1)), RATE)
BAD = {
    "output": (lambda: close_loop(PLANT, GAIN, measured="speed", driven="stroke"), "unknown output 'speed'; known"),
    "input": (lambda: close_loop(PLANT, GAIN, measured="force", driven="pull"), "unknown input 'pull'; known"),
    "twice": (lambda: close_loop(PLANT, GAIN, measured=("force", "force"), driven="stroke"), "used more than once"),
    "one of two": (
        lambda: close_loop(PLANT, GAIN, measured=("force", "position"), driven="stroke"),
        r"has 1 input\(s\) and 1 output\(s\), but is to measure force, position and to drive stroke",
    ),
    "two of one": (
        lambda: controller_model(WIDE, inputs=("force", "position"), outputs=("stroke",)),
        r"has 1 input\(s\) and 2 output\(s\), but is to measure force, position and to drive stroke",
    ),
    "rate": (lambda: close_loop(SAMPLED, proportional(1.0, sample_rate=1e3), **LOOP), "2000 Hz and the controller at"),
    "rate of FRF": (lambda: open_loop(SAMPLED, proportional(1.0, sample_rate=1e3), [1.0], **LOOP), "2000 Hz and the"),
    "signals of FRF": (
        lambda: open_loop(SAMPLED, GAIN, [1.0], measured=("force", "position"), driven="stroke"),
        "name as many signals",
    ),
    "order": (lambda: close_loop(PLANT, GAIN, **LOOP, delay_order=-1), "whole number"),
    "a loop": (
        lambda: close_loop(PLANT, LOOP, **LOOP),
        "controller must be a Controller, got dict; of a Loop take its",
    ),
    "a loop's FRF": (lambda: open_loop(PLANT, LOOP, [1.0], **LOOP), "controller must be a Controller, got dict"),
    "no order": (
        lambda: close_loop(PLANT, GAIN, **LOOP, delay_order=np.nan),
        "delay_order must be a whole number of at least 0, got nan",
    ),
    "no gain": (lambda: close_loop(PLANT, GAIN, **LOOP, gain=np.nan), "gain holds 1 value.*NaN"),
    "critical": (
        lambda: sensitivity(FRF([3.0, 7.0], [[[0.5, -1.0]]], ("y",), ("y",))),
        r"oscillates at 7 Hz, where det\(1 \+ L\) = 0",
    ),
    "critical beside another": (
        lambda: sensitivity(FRF([7.0], [[[-0.5], [0.5]], [[0.5], [-0.5]]], ("y", "z"), ("y", "z"))),
        "oscillates at 7 Hz",
    ),
    "no continuous form": (lambda: close_loop(PLANT, AT_NYQUIST, **LOOP), "model the loop sampled"),
    "sampled twice": (lambda: sampled(SAMPLED, RATE / 2.5), "sampled already, at .* which is 2.5 times"),
    "sampled between": (lambda: sampled(SAMPLED, RATE / 1.6), "sampled already, at .* which is 1.6 times"),
    "sampled finer": (lambda: sampled(SAMPLED, 2 * RATE), "sampled already, at .* which is 0.5 times"),
    "no time": (lambda: LinearModel(*PLANT.matrices, PLANT.inputs, PLANT.outputs, time_step=0.0), "time_step must"),
    "several": (lambda: margins(frequency_response(PLANT, [1.0])), "one signal, got 2"),
    "a plant's response": (
        lambda: margins(FRF([1.0, 2.0], [[[1.0, 1.0]]], ("position",), ("force",))),
        "same signal as input and output, got 'force' and 'position': open_loop and",
    ),
    "its own reference": (
        lambda: close_loop(PLANT, GAIN, **LOOP, reference="stroke"),
        "the loop drives stroke, so this input is no reference or noise of it",
    ),
    "noise that is a reference": (
        lambda: close_loop(PLANT, GAIN, **LOOP, reference="push", noise="push"),
        "reference and noise names must differ; used more than once: push",
    ),
    "no loop": (lambda: sensitivity(frequency_response(PLANT, [1.0])), "same inputs as outputs"),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_input_is_named(case):
    make, message = BAD[case]
    with pytest.raises(ValueError, match=message):
        make()


def test_series_with_a_notch_closes_too():
    chain = series(iff(60.0), notch(400.0, zero_damping=0.05, pole_damping=0.5, sample_rate=RATE))
    closed = close_loop(SAMPLED, chain, **LOOP)
    loop = open_loop(SAMPLED, chain, np.array([30.0, 400.0]), **LOOP).values[0, 0]
    g = frequency_response(SAMPLED, [30.0, 400.0]).response("force", "stroke")
    assert frequency_response(closed, [30.0, 400.0]).response("force", "stroke") == pytest.approx(g / (1 + loop))


def test_two_loops_that_read_one_sensor_share_its_noise():
    """As one loop of both controllers does: the sensor's noise reaches both."""
    plant, first, second = (
        one_mode(0.02),
        iff(20.0, corner_frequency=5.0),
        iff(10.0, corner_frequency=30.0, high_pass=1.0),
    )
    once = close_loop(plant, first, **LOOP, noise=True)
    both = close_loop(once, second, **LOOP, noise=True)
    assert both.inputs == ("stroke", "push", "force noise")
    frequency = np.array([20.0, 95.0, 300.0])
    g = frequency_response(plant, frequency).response("force", "stroke")
    k = sum(
        frequency_response(controller_model(one, inputs="y", outputs="u"), frequency).values[0, 0]
        for one in (first, second)
    )
    noise = frequency_response(both, frequency).response("force", "force noise")
    np.testing.assert_allclose(noise, g * k / (1 - g * k), rtol=1e-9)


def test_frequency_and_damping_of_every_kind_of_pole():
    """A drift, a decay, a growth, a slow and a fast oscillation, of which one grows: once each, by size."""
    swings = [np.array([[-0.6, 1.0], [-1.0, -0.6]]) * 5, np.array([[0.28, 0.96], [-0.96, 0.28]]) * 20]
    a = scipy.linalg.block_diag(0.0, -3.0, 8.0, *swings)
    model = LinearModel(a, np.zeros((7, 0)), np.zeros((0, 7)), np.zeros((0, 0)), (), ())
    frequency, ratio = damping(model)
    sizes = np.hypot(0.6, 1.0) * 5
    assert 2 * np.pi * frequency == pytest.approx([0.0, 3.0, sizes, 8.0, 20.0])
    assert ratio == pytest.approx([0.0, 1.0, 3.0 / sizes, -1.0, -0.28])


def test_closing_an_analog_loop_keeps_what_the_model_does_not_support():
    """Sampled afterwards, the unsupported mode is still static: the slow mode with its loop, and a constant."""
    slow, fast = 2 * np.pi * np.array([50.0, 3000.0])
    a = np.zeros((4, 4))
    a[:2, 2:], a[2:, :2], a[2:, 2:] = np.eye(2), -np.diag([slow**2, fast**2]), -np.diag([0.02 * slow, 0.02 * fast])
    model = LinearModel(
        a, [[0.0], [0], [1], [1]], [[1.0, 1, 0, 0]], [[0.0]], ("u",), ("y",), unsupported=[0.0, 3000.0, 0.0, 3000.0]
    )
    loop = proportional(-0.3 * slow**2, sample_rate=RATE)
    closed = close_loop(model, loop, measured="y", driven="u", delay_order=0)
    poles = sampled(closed, RATE).poles()
    folded = (np.abs(poles) > 2 * slow) & (np.abs(poles) < 5 * np.pi * RATE)  # beyond are values of the last samples
    assert not folded.any()
    assert np.abs(np.abs(poles) - slow * np.sqrt(1.3)).min() < 1e-3 * slow


def test_a_free_motion_with_friction_has_one_pole_at_the_origin_within_rounding():
    """A carriage of 12 kg with 4 N s/m and a payload on a spring: rounding leaves some 1e-13 rad/s of the pole at 0."""
    mass, viscous = np.diag([12.0, 1.0]), np.diag([4.0, 0.0])
    stiffness = 3.5e6 * np.array([[1, -1], [-1, 1]])
    a = np.block([[np.zeros((2, 2)), np.eye(2)], [-np.linalg.solve(mass, stiffness), -np.linalg.solve(mass, viscous)]])
    frequency, ratio = damping(LinearModel(a, np.eye(4)[:, 2:], np.eye(4), np.zeros((4, 2)), ("f", "g"), tuple("abcd")))
    assert (frequency[0], ratio[0], len(frequency)) == (0.0, 0.0, 3)
    assert frequency[1] == pytest.approx(4.0 / 13.0 / (2 * np.pi), rel=1e-3)
    assert ratio[1] == 1.0


def test_margins_read_with_their_units():
    found = Margins(10.0, 396.5, 55.7, 49.98, 0.7912, 120.0)
    assert str(found) == (
        "gain margin 10 (20 dB) at 396.5 Hz, phase margin 55.7 deg at 49.98 Hz, modulus margin 0.791 at 120 Hz"
    )
    free = Margins(math.inf, math.nan, math.inf, math.nan, 1.0, 3.0)
    assert str(free) == "gain margin inf, phase margin inf deg, modulus margin 1 at 3 Hz"
