"""Controllers against the formulas of their field, their connection, and bad input."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.signal

from nassim.systems.controllers import (
    Controller,
    controller_response,
    decentralised,
    integral_force_feedback,
    lead,
    notch,
    parallel,
    pid,
    proportional,
    series,
)
from nassim.systems.state_space import inverse_tustin, tustin

RATE = 5000.0
FREQUENCY = np.array([0.3, 7.0, 60.0, 410.0, 1900.0])


def response(controller, frequency=FREQUENCY, **options):
    return controller_response(controller, frequency, **options).values[0, 0]


def laplace(frequency, *, prewarp=0.0):
    """The s that Tustin's rule puts in place of 2 pi j f."""
    scale = 2 * np.pi * prewarp / np.tan(np.pi * prewarp / RATE) if prewarp else 2 * RATE
    return 1j * scale * np.tan(np.pi * frequency / RATE)


def late(frequency, delay):
    return np.exp(-2j * np.pi * frequency * delay / RATE)


@pytest.mark.parametrize("corner", [0.0, 3.0])
@pytest.mark.parametrize("high_pass", [0.0, 11.0])
@pytest.mark.parametrize("delay", [0, 1, 3])
def test_iff_is_its_formula(corner, high_pass, delay):
    controller = integral_force_feedback(
        40.0, sample_rate=RATE, corner_frequency=corner, high_pass=high_pass, delay=delay
    )
    s = laplace(FREQUENCY)
    formula = -40.0 / (s + 2 * np.pi * corner) * s / (s + 2 * np.pi * high_pass)
    assert response(controller) == pytest.approx(formula * late(FREQUENCY, delay), rel=1e-11)
    # A hidden integrator would drift with the sensor's offset.
    assert len(controller.A) == (2 if corner and high_pass else 1)


def test_iff_approaches_continuous_time_below_the_sample_rate():
    slow = np.array([0.5, 2.0])
    assert response(integral_force_feedback(40.0, sample_rate=RATE, delay=0), slow) == pytest.approx(
        -40.0 / (2j * np.pi * slow), rel=1e-6
    )


def test_pure_integrator_steps_by_the_trapezoidal_rule():
    c = integral_force_feedback(6.0, sample_rate=RATE)
    x, outputs = np.zeros(1), []
    for y in (1.0, 1.0, 1.0):
        outputs.append((c.C @ x + c.D[:, 0] * y).item())
        x = c.A @ x + c.B[:, 0] * y
    assert outputs == pytest.approx(-6.0 / RATE * np.array([0.5, 1.5, 2.5]), rel=1e-12)


@pytest.mark.parametrize(("kd", "time"), [(0.0, 3.0 / 2.0), (0.5, np.sqrt(0.5 / 2.0))])
def test_times_of_anti_windup_have_no_sign(kd, time):
    """As an integral against the sign of the other gains, which an unstable plant may need, has such a time too."""
    one, other = (pid(sign * 3.0, 2.0, sign * kd, sample_rate=RATE) for sign in (1, -1))
    np.testing.assert_allclose(other.anti_windup, one.anti_windup, rtol=1e-12)
    assert (one.C @ one.anti_windup).item() == pytest.approx(1 / RATE / time)


@pytest.mark.parametrize("phase", [-50.0, 0.0, 30.0, 75.0])
def test_lead_is_exact_at_its_centre(phase):
    controller = lead(1100.0, phase=phase, gain=2.5, sample_rate=RATE, delay=0)
    assert response(controller, np.array([1100.0])) == pytest.approx(2.5 * np.exp(1j * np.radians(phase)), rel=1e-12)
    root = np.sqrt((1 + np.sin(np.radians(phase))) / (1 - np.sin(np.radians(phase))))
    s = laplace(FREQUENCY, prewarp=1100.0) / (2 * np.pi * 1100.0)
    assert response(controller) == pytest.approx(2.5 / root * (1 + s * root) / (1 + s / root), rel=1e-11)


def test_notch_is_exact_at_its_centre():
    controller = notch(1300.0, zero_damping=0.02, pole_damping=0.5, sample_rate=RATE, delay=0)
    assert response(controller, np.array([0.0, 1300.0])) == pytest.approx([1.0, 0.04], rel=1e-10)
    s = laplace(FREQUENCY, prewarp=1300.0) / (2 * np.pi * 1300.0)
    assert response(controller) == pytest.approx((s**2 + 0.04 * s + 1) / (s**2 + s + 1), rel=1e-10)
    deep = notch(1300.0, zero_damping=0.0, pole_damping=0.5, sample_rate=RATE)
    assert abs(response(deep, np.array([1300.0]))[0]) < 1e-12


def test_proportional_takes_numbers_and_matrices():
    assert response(proportional(-3.0, sample_rate=RATE, delay=2)) == pytest.approx(-3.0 * late(FREQUENCY, 2))
    matrix = np.array([[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]])
    frf = controller_response(proportional(matrix, sample_rate=RATE, delay=0), FREQUENCY)
    assert np.all(frf.values == matrix[:, :, None])
    assert (frf.outputs, frf.inputs) == (("output_1", "output_2"), ("input_1", "input_2", "input_3"))


def test_hold_is_the_mean_delay_of_a_kept_sample():
    controller = proportional(1.0, sample_rate=RATE, delay=0)
    s = 2j * np.pi * FREQUENCY
    assert response(controller, hold=True) == pytest.approx((1 - np.exp(-s / RATE)) / (s / RATE), rel=1e-9)


def test_series_multiplies_and_parallel_adds_with_one_delay():
    parts = (
        integral_force_feedback(40.0, sample_rate=RATE, corner_frequency=2.0),
        notch(900.0, zero_damping=0.1, pole_damping=0.6, sample_rate=RATE),
        lead(200.0, phase=40.0, sample_rate=RATE, limit=5.0),
    )
    first, second, third = (response(part) / late(FREQUENCY, 1) for part in parts)
    chain = series(*parts)
    assert response(chain) == pytest.approx(first * second * third * late(FREQUENCY, 1), rel=1e-10)
    assert (chain.delay, chain.limit) == (1, 5.0)
    side = parallel(*parts[:2])
    assert response(side) == pytest.approx((first + second) * late(FREQUENCY, 1), rel=1e-10)
    assert (side.delay, side.limit) == (1, np.inf)
    later = [replace(part, delay=3, limit=np.inf) for part in parts]
    assert [connect(*later).delay for connect in (series, parallel, decentralised)] == [3, 3, 3]


def test_series_of_several_signals_multiplies_in_order():
    left, right = np.array([[1.0, 2.0], [3.0, 4.0], [0.5, 0.0]]), np.array([[0.0, 1.0, 1.0], [1.0, -1.0, 2.0]])
    chain = series(proportional(left, sample_rate=RATE), proportional(right, sample_rate=RATE))
    assert np.all(right @ left == chain.D)


@pytest.mark.parametrize("prewarp", [0.0, 31.0])
def test_tustin_is_scipys_and_python_controls(prewarp):
    control = pytest.importorskip("control")
    random = np.random.default_rng(1)
    system = tuple(random.normal(size=shape) for shape in ((4, 4), (4, 2), (3, 4), (3, 2)))
    z = np.exp(1j * np.array([0.1, 1.3, 2.9]))
    found = control.ss(*tustin(system, 0.05, prewarp=prewarp), 0.05)(z)
    if not prewarp:
        theirs = scipy.signal.cont2discrete(system, 0.05, method="bilinear")[:4]
        assert found == pytest.approx(control.ss(*theirs, 0.05)(z), rel=1e-11)
    options = {"prewarp_frequency": prewarp} if prewarp else {}
    theirs = control.sample_system(control.ss(*system), 0.05, method="bilinear", **options)
    assert found == pytest.approx(theirs(z), rel=1e-11)


def test_tustin_of_a_mode_of_sixteen_megahertz():
    """Displacement and velocity differ by 1e8 rad/s; that is no pole at 2 / T."""
    w = 1e8
    system = np.array([[0.0, 1.0], [-(w**2), -0.02 * w]]), np.eye(2)[:, 1:], np.eye(2)[:1], np.zeros((1, 1))
    a, b, c, d = tustin(system, 1e-4)
    z = np.exp(2j * np.pi * 100.0 * 1e-4)
    s = 2e4 * (z - 1) / (z + 1)
    assert (c @ np.linalg.solve(z * np.eye(2) - a, b) + d).item() == pytest.approx(1 / (s * s + 0.02 * w * s + w * w))


def test_tustin_and_its_inverse():
    random = np.random.default_rng(1)
    system = tuple(random.normal(size=shape) for shape in ((4, 4), (4, 2), (3, 4), (3, 2)))
    for there, back in zip(system, inverse_tustin(tustin(system, 0.05), 0.05), strict=True):
        assert back == pytest.approx(there, rel=1e-11)
    with pytest.raises(ValueError, match="Tustin's rule has no answer"):
        tustin((np.array([[2 / 0.05]]), np.ones((1, 1)), np.ones((1, 1)), np.ones((1, 1))), 0.05)
    with pytest.raises(ValueError, match="no continuous equivalent"):
        inverse_tustin((-np.eye(1), np.ones((1, 1)), np.ones((1, 1)), np.ones((1, 1))), 0.05)


GAIN = proportional(1.0, sample_rate=RATE)
BAD = {
    "no number": (lambda: integral_force_feedback(np.nan, sample_rate=RATE), "gain holds 1"),
    "negative corner": (lambda: integral_force_feedback(1.0, sample_rate=RATE, corner_frequency=-1), "corner_freq"),
    "negative high-pass": (lambda: integral_force_feedback(1.0, sample_rate=RATE, high_pass=-1.0), "high_pass"),
    "corner too high": (lambda: integral_force_feedback(1.0, sample_rate=RATE, corner_frequency=2500.0), "2500 Hz"),
    "no rate": (lambda: integral_force_feedback(1.0, sample_rate=0.0), "sample_rate must be positive"),
    "delay by halves": (lambda: proportional(1.0, sample_rate=RATE, delay=0.5), "whole number"),
    "negative delay": (lambda: proportional(1.0, sample_rate=RATE, delay=-1), "whole number"),
    "delay is no number": (
        lambda: proportional(1.0, sample_rate=RATE, delay=np.nan),
        "delay must be a whole number of at least 0, got",
    ),
    "endless delay": (
        lambda: proportional(1.0, sample_rate=RATE, delay=np.inf),
        "delay must be a whole number of at least 0, got",
    ),
    "gain is a text": (lambda: proportional("high", sample_rate=RATE), "gain must be numbers, got"),
    "gain in a block": (lambda: proportional(np.ones((1, 1, 2)), sample_rate=RATE), "gain must have shape any x any"),
    "no signal": (lambda: proportional(np.zeros((0, 0)), sample_rate=RATE), "a row for each output"),
    "no limit": (lambda: proportional(1.0, sample_rate=RATE, limit=0.0), "limit must be positive"),
    "vertical phase": (lambda: lead(10.0, phase=90.0, sample_rate=RATE), "within -90 ... 90"),
    "lead beyond": (lambda: lead(2500.0, phase=9.0, sample_rate=RATE), "below half the sample rate"),
    "notch at rest": (lambda: notch(0.0, zero_damping=0.1, pole_damping=0.1, sample_rate=RATE), "frequency must be p"),
    "no pole": (lambda: notch(9.0, zero_damping=0.1, pole_damping=0.0, sample_rate=RATE), "pole_damping"),
    "nothing": (series, "at least one"),
    "two rates": (lambda: series(GAIN, proportional(1.0, sample_rate=1.0)), "must agree"),
    "two delays": (lambda: parallel(GAIN, proportional(1.0, sample_rate=RATE, delay=2)), "must agree"),
    "limit inside": (lambda: series(proportional(1.0, sample_rate=RATE, limit=2.0), GAIN), "series: a limit of 2"),
    "limit in the middle": (lambda: series(GAIN, replace(GAIN, limit=2.0), GAIN), "series: a limit of 2"),
    "limit beside the second": (lambda: parallel(GAIN, GAIN, replace(GAIN, limit=2.0)), "parallel: a limit of 2"),
    "limit beside": (lambda: parallel(GAIN, proportional(1.0, sample_rate=RATE, limit=2.0)), "parallel: a limit"),
    "one into two": (lambda: series(GAIN, proportional(np.eye(2), sample_rate=RATE)), "cannot be the next"),
    "one beside two": (lambda: parallel(GAIN, proportional(np.eye(2), sample_rate=RATE)), "must agree"),
    "at its pole": (lambda: response(integral_force_feedback(1.0, sample_rate=RATE), np.zeros(1)), "infinite"),
    "matrices": (lambda: Controller(np.eye(2), np.ones((1, 1)), np.ones((1, 2)), np.ones((1, 1)), RATE), "B must"),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_input_is_named(case):
    make, message = BAD[case]
    with pytest.raises(ValueError, match=message):
        make()
