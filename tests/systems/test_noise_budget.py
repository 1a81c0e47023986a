"""Noise budgets against Lyapunov's equation, closed forms, loops run sample by sample with a converter that rounds."""

import warnings
from dataclasses import replace

import numpy as np
import pytest
import scipy.integrate
import scipy.linalg
from test_feedback import LOOP, RATE, iff, one_mode, two_modes
from test_zeros import platform

from nassim.signals import TimeHistory, differentiate_spectrum, spectral_noise
from nassim.signals.spectra import TabulatedSpectrum, quantisation_noise
from nassim.systems.controllers import controller_response, proportional
from nassim.systems.feedback import close_loop
from nassim.systems.linear_model import LinearModel, frequency_response, sampled
from nassim.systems.noise_budgets import PROBES, NoiseBudget, noise_budget, recorded_budget, with_lines
from nassim.systems.transformed_signals import with_inputs

BAND = np.geomspace(1e-2, 1e5, 120)
FINE = np.geomspace(1e-2, 1e5, 2000)


def machine(damping_ratio=1e-4):
    """Five coupled, gyroscopic modes from 1 to 400 Hz with three inputs; read are two positions and a rate."""
    random = np.random.default_rng(12)
    omega = 2 * np.pi * np.array([1.0, 7.0, 7.3, 90.0, 400.0])
    turn = random.normal(size=(5, 5))
    state = np.block([[np.zeros((5, 5)), np.eye(5)], [-np.diag(omega**2), -2 * damping_ratio * np.diag(omega)]])
    state[5:, 5:] += turn - turn.T
    readings = np.zeros((3, 10))
    readings[:2, :5], readings[2, 5:] = random.normal(size=(2, 5)), random.normal(size=5)
    drives = np.vstack([np.zeros((5, 3)), random.normal(size=(5, 3))])
    names = (("floor", "current", "runout"), ("x", "y", "speed"), ("m", "m", "m/s"))
    return LinearModel(state, drives, readings, np.zeros((3, 3)), *names)


def exact_rms(model, column, density, corner=None):
    """Of white noise with a one-sided density, through a first-order low-pass at a corner [Hz] if one is given."""
    a, b = model.A, model.B[:, [column]]
    if corner is not None:
        rate = 2 * np.pi * corner
        a = np.block([[a, b], [np.zeros((1, len(a))), np.array([[-rate]])]])
        b = np.vstack([0 * b, [[rate]]])
    # In modal coordinates: of lightly damped modes of very different frequencies, SciPy's solution depends on rounding.
    poles, shapes = np.linalg.eig(a)
    drives = np.linalg.solve(shapes, b)
    readings = model.C @ shapes[: len(model.A)]
    covariance = -density / 2 * drives @ drives.conj().T / (poles[:, None] + poles.conj())
    return np.sqrt(np.diag(readings @ covariance @ readings.conj().T).real)


@pytest.mark.parametrize("damping_ratio", [1e-5, 1e-3, 0.3])
def test_rms_is_that_of_lyapunovs_equation(damping_ratio):
    model = machine(damping_ratio)
    shaped = 4.0 / (1 + (BAND / 30.0) ** 2)
    spectra = {"runout": lambda f: 0.2 / (1 + (f / 5.0) ** 2), "floor": 3.0, "current": shaped}
    budget = noise_budget(model, spectra, BAND)
    assert (budget.inputs, budget.outputs, budget.units) == (model.inputs, model.outputs, model.units)
    expected = [exact_rms(model, 0, 3.0), exact_rms(model, 1, 4.0, 30.0), exact_rms(model, 2, 0.2, 5.0)]
    assert budget.rms() == pytest.approx(np.transpose(expected), rel=3e-3)
    assert budget.total.rms()[:, 0] == pytest.approx(np.linalg.norm(expected, axis=0), rel=2e-3)
    assert budget.integration_error.max() < 2e-3
    speed = noise_budget(model, spectra, BAND, outputs="speed")
    assert (speed.outputs, speed.units) == (("speed",), ("m/s",))


def test_rms_of_an_oscillator_in_closed_form():
    """S / (8 zeta omega^3 m^2), and what of it lies above a band in which it follows its force at rest."""
    omega, ratio, mass, density = 50.0, 3e-6, 2.0, 7.0
    state = np.array([[0.0, 1.0], [-(omega**2), -2 * ratio * omega]])
    model = LinearModel(state, [[0.0], [1 / mass]], [[1.0, 0.0]], np.zeros((1, 1)), ("force",), ("x",), ("m",))
    budget = noise_budget(model, {"force": density}, [1e-3, 0.1, 1.0, 5.0, 20.0, 1e3])
    assert budget.rms()[0, 0] ** 2 == pytest.approx(density / (8 * ratio * omega**3 * mass**2), rel=3e-3)
    slow = budget.rms(high=0.1)[0, 0] ** 2
    assert slow == pytest.approx(density * (0.1 - 1e-3) / (mass * omega**2) ** 2, rel=1e-3)


def test_sampled_closed_loop_is_that_of_the_discrete_equation():
    model = close_loop(sampled(one_mode(0.002), RATE), iff(20.0, corner_frequency=3.0, delay=2), **LOOP, noise=True)
    assert model.inputs == ("stroke", "push", "force noise")
    levels = {"push": 2.0, "force noise": 3e5}
    budget = noise_budget(model, levels, np.linspace(0.0, RATE / 2, 400))
    columns = [1, 2]
    for k, (column, density) in enumerate(zip(columns, levels.values(), strict=True)):
        power = density * RATE / 2
        b, d = model.B[:, [column]], model.D[:, [column]]
        covariance = scipy.linalg.solve_discrete_lyapunov(model.A, power * b @ b.T)
        expected = np.sqrt(np.diag(model.C @ covariance @ model.C.T + power * d @ d.T))
        assert budget.rms()[:, k] == pytest.approx(expected, rel=1e-3)


@pytest.mark.parametrize("rate", [None, RATE])
def test_noise_of_sensors_goes_through_the_controller_only(rate):
    """G K / (1 - G K) and G (1 - K G)^-1 K for two loops at once, one after the other, and with a feedthrough."""
    frequency = np.array([3.0, 61.0, 88.0, 400.0])
    for plant in (two_modes(), platform(0.3)):
        model = plant if rate is None else sampled(plant, rate)
        gains = np.array([[-0.3, 0.1], [0.2, -0.5]])
        wires = {"measured": plant.outputs, "driven": plant.inputs}
        controller = proportional(gains, sample_rate=RATE)
        closed = close_loop(model, controller, **wires, noise=True, delay_order=12, gain=0.7)
        g = frequency_response(model, frequency).values.transpose(2, 0, 1)
        k = 0.7 * controller_response(controller, frequency, hold=rate is None).values.transpose(2, 0, 1)
        if rate is None:
            k = k / np.sinc(frequency / RATE)[:, None, None]  # the continuous equivalent has the hold's delay only
        expected = g @ np.linalg.solve(np.eye(2) - k @ g, k)
        found = frequency_response(closed, frequency).values
        assert found[:, 2:].transpose(2, 0, 1) == pytest.approx(expected, rel=1e-7)
        quiet = frequency_response(close_loop(model, controller, **wires, delay_order=12, gain=0.7), frequency).values
        assert found[:, :2] == pytest.approx(quiet, rel=1e-9)
        assert closed.outputs == plant.outputs
    one, two = (proportional(x, sample_rate=RATE) for x in (-30.0, -50.0))
    both = proportional([[-30.0, 0.0], [0.0, -50.0]], sample_rate=RATE)
    pair = two_modes()
    after = close_loop(pair, one, measured="v1", driven="f1", noise=True)
    after = close_loop(after, two, measured="v2", driven="f2", noise=True)
    together = close_loop(pair, both, measured=("v1", "v2"), driven=("f1", "f2"), noise=True)
    assert after.inputs == together.inputs == ("f1", "f2", "v1 noise", "v2 noise")
    values = [frequency_response(m, frequency).values for m in (after, together)]
    assert values[0] == pytest.approx(values[1], rel=1e-9)


def test_loops_that_measure_the_same_share_its_noise():
    one, two = (proportional(x, sample_rate=RATE) for x in (-30.0, -50.0))
    crossed = proportional([[-30.0], [-50.0]], sample_rate=RATE)
    after = close_loop(two_modes(), one, measured="v1", driven="f1", noise=True)
    after = close_loop(after, two, measured="v1", driven="f2", noise=True)
    together = close_loop(two_modes(), crossed, measured="v1", driven=("f1", "f2"), noise=True)
    assert after.inputs == together.inputs == ("f1", "f2", "v1 noise")
    frequency = np.array([3.0, 61.0, 88.0])
    values = [frequency_response(m, frequency).values for m in (after, together)]
    assert values[0] == pytest.approx(values[1], rel=1e-9)


def test_a_converter_that_rounds_makes_the_budgets_noise():
    """The loop of a computer run with and without rounding; what is different is the noise."""
    plant, controller, step = sampled(one_mode(0.02), RATE), iff(60.0, corner_frequency=20.0), 2e3
    pushes = 3e5 * np.random.default_rng(3).normal(size=15_000)
    a, b, c, d = plant.matrices

    def run(step):
        x, xk, waiting, found = np.zeros(2), np.zeros(1), 0.0, []
        ka, kb, kc, kd = (m[0, 0] for m in controller.matrices)
        for push in pushes:
            u = np.array([waiting, push])
            y = c @ x + d @ u
            found.append(y[1])
            read = step * np.round(y[0] / step) if step else y[0]
            waiting = (kc * xk[0] + kd * read).item()
            xk = ka * xk + kb * read
            x = a @ x + b @ u
        return np.array(found)

    difference = run(step) - run(0.0)
    closed = close_loop(plant, controller, **LOOP, noise=True)
    spectra = {"force noise": quantisation_noise(step, sample_rate=RATE)}
    budget = noise_budget(closed, spectra, np.linspace(0.1, RATE / 2, 2000), outputs="position")
    assert np.std(difference[2000:]) == pytest.approx(budget.rms()[0, 0], rel=0.04)


def test_cumulative_amplitude_is_summed_from_high_to_low():
    frequency = np.array([1.0, 2.0, 5.0, 9.0])
    psd = np.array([[[3.0, 3.0, 3.0, 3.0], [0.0, 4.0, 1.0, 1.0]]])
    budget = NoiseBudget(frequency, psd, ("x",), ("a", "b"), ("m",))
    assert budget.cumulative()[0, 0] ** 2 == pytest.approx(3 * (9 - frequency))
    assert budget.cumulative()[0, 1] ** 2 == pytest.approx([2 + 7.5 + 4, 7.5 + 4, 4, 0])
    for k, f in enumerate(frequency):
        assert budget.rms(low=f)[0] == pytest.approx(budget.cumulative()[0, :, k])
    assert budget.rms(low=1.5, high=3.0)[0] ** 2 == pytest.approx([4.5, 0.5 * (2 + 4) / 2 + (4 + 3) / 2])
    assert budget.rms(low=3.0, high=4.0)[0, 1] ** 2 == pytest.approx(2.5), "between two frequencies of the grid"
    assert budget.rms(low=3.0, high=3.0)[0] == pytest.approx([0.0, 0.0])
    assert (budget.rms(1.0, 3.3) ** 2 + budget.rms(3.3) ** 2) == pytest.approx(budget.rms() ** 2)
    total = budget.total
    assert (total.inputs, total.outputs) == (("total",), ("x",))
    assert total.cumulative()[0, 0] == pytest.approx(np.linalg.norm(budget.cumulative()[0], axis=0))


def test_the_error_of_wide_steps_is_estimated_and_told():
    """A resonance on a grid with steps of some tenths of its distance, integrated in closed form."""
    for step in (0.2, 0.4):
        away = np.sinh(step * np.arange(-12, 13))
        budget = NoiseBudget(200.0 + away, np.array([[[1.0]], [[1e6]]]) / (1 + away**2), ("x", "y"), ("a",))
        actual = budget.rms()[0, 0] / np.sqrt(2 * np.arctan(away[-1])) - 1
        assert budget.integration_error[:, 0] == pytest.approx(2 * [actual], rel=0.2)
    with pytest.warns(UserWarning, match=r"too coarse .* rms of '\w+' may be off by \d+ %; take closer ones"):
        noise_budget(machine(0.01), {"floor": [1e-9, 1e-9, 1.0, 1e-9, 1e-9]}, [1.0, 48.0, 50.0, 52.0, 1e3])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        noise_budget(machine(1e-5), {"floor": 1.0}, np.geomspace(0.1, 1e3, 60))


def test_a_pole_at_rest_by_rounding_may_lie_in_the_band():
    """A free mass against rounding's spring, 1e-9 of the fastest pole: its response is 1 / omega^2 well above."""
    state = scipy.linalg.block_diag([[0.0, 1.0], [-1e-10, 0.0]], [[-1e4]])
    free = LinearModel(state, [[0.0], [1.0], [0.0]], [[1.0, 0.0, 0.0]], [[0.0]], ("force",), ("x",))
    budget = noise_budget(free, {"force": 3.0}, np.geomspace(1e-7, 1.0, 20))
    assert budget.psd[0, 0, -1] == pytest.approx(3.0 / (2 * np.pi) ** 4)


def test_an_error_of_two_per_cent_is_told():
    """Three frequencies: without the middle one, the rms falls by three times the error."""
    still = LinearModel(-1e3 * np.eye(1), [[0.0]], np.eye(1), np.eye(1), ("u",), ("y",))
    for error in (0.9 * 0.02, 1.1 * 0.02):
        with warnings.catch_warnings(record=True) as told:
            warnings.simplefilter("always")
            budget = noise_budget(still, {"u": [1.0, 2 / (1 - 3 * error) ** 2 - 1, 1.0]}, [0.0, 1.0, 2.0])
        assert budget.integration_error[0, 0] == pytest.approx(error)
        assert len(told) == (error > 0.02)


def test_points_at_resonances_keep_the_band():
    band = np.geomspace(2.0, 90.0, 30)
    frequency = noise_budget(machine(), {"floor": 1.0}, band).frequency
    assert (frequency[0], frequency[-1]) == (2.0, 90.0)
    assert set(band) <= set(frequency)
    poles = machine().poles()
    for f in poles[(poles.imag > 2 * np.pi * 2) & (poles.imag < 2 * np.pi * 89)].imag / (2 * np.pi):
        assert np.abs(frequency - f).min() < 1e-9 * f
    assert np.array_equal(noise_budget(machine(0.5), {"floor": 1.0}, FINE).frequency, FINE), "wide enough already"


def test_lines_of_a_table_are_not_stepped_over():
    table = TabulatedSpectrum(np.arange(1.0, 101.0), np.where(np.arange(1, 101) == 33, 5.0, 1e-9))
    assert table.frequency[32] == 33.0
    still = LinearModel(-1e3 * np.eye(1), np.eye(1), np.eye(1), np.eye(1), ("u",), ("y",))
    with pytest.warns(UserWarning, match="too coarse"):
        budget = noise_budget(still, {"u": table}, [2.0, 20.0, 90.0])
    assert {33.0, 34.0, 2.0, 90.0, 89.0} <= set(budget.frequency)
    assert budget.frequency[[0, -1]] == pytest.approx([2.0, 90.0])
    assert budget.rms()[0, 0] ** 2 == pytest.approx(5.0, rel=0.01)


def test_tables_are_integrated_as_they_are_interpolated():
    """A power law over six decades has its integral, a line its bin, also of the rate of a signal."""
    still = LinearModel(np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), np.eye(1), ("u",), ("y",))
    law = TabulatedSpectrum([1e-2, 1e4], [1e6, 1e-12])
    for spectrum in (law, lambda f: f**-3.0):
        found = noise_budget(still, {"u": spectrum}, law.frequency).rms()[0, 0]
        assert found**2 == pytest.approx((1e4 - 1e-8) / 2, rel=2e-3)
    bins = np.arange(1, 8001) * 0.01
    line = TabulatedSpectrum(bins, np.where(np.arange(8000) == 3332, 5.0, 1e-12))
    for times in (0, 1):
        budget = noise_budget(still, {"u": differentiate_spectrum(line, times)}, [1.0, 80.0])
        assert budget.rms()[0, 0] ** 2 == pytest.approx(5 * 0.01 * (2 * np.pi * 33.33) ** (2 * times), rel=1e-4)


@pytest.mark.parametrize(("place", "width"), [(47.31, 0.05), (3.217, 2e-3), (199.9, 0.2)])
def test_lines_of_a_function_are_not_stepped_over(place, width):
    """A line narrow beside all distances adds its area times the response there squared."""
    model, area = machine(0.3), width * np.sqrt(np.pi)
    quiet = noise_budget(model, {"floor": 1e-9}, BAND)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        budget = noise_budget(model, {"floor": lambda f: 1e-9 + np.exp(-(((f - place) / width) ** 2))}, BAND)
    line = area * np.abs(frequency_response(model, [place]).values[:, 0, 0]) ** 2
    assert budget.rms()[:, 0] ** 2 == pytest.approx(quiet.rms()[:, 0] ** 2 + line, rel=4e-3)
    assert len(budget.frequency) < 4 * len(quiet.frequency)


@pytest.mark.parametrize("width", [0.01, 0.0005, 5e-7])
def test_a_line_counts_for_the_output_that_it_moves(width):
    """However much larger another output is, elsewhere; the narrow line fits between two probes, beside one."""
    points = np.linspace(1.0, 200.0, 400)
    place = points[93] + 37 * (points[1] - points[0]) / PROBES
    gain = np.array([np.where(points < 20.0, 1e9, 0.0), np.where(points > 40.0, 1.0, 0.0)])
    fine = np.sort(
        with_lines("u", lambda f: np.where(f < 30.0, 1.0, 1e-9) + np.exp(-(((f - place) / width) ** 2)), points, gain)
    )
    assert scipy.integrate.trapezoid(np.exp(-(((fine - place) / width) ** 2)), fine) == pytest.approx(
        width * np.sqrt(np.pi), rel=0.01
    )


def test_one_disturbance_at_several_inputs_adds_amplitudes():
    model = machine(0.01)
    together = with_inputs(model, "everywhere", [[1.0], [2.0], [-1.0]], of=model.inputs)
    budget = noise_budget(together, {"everywhere": 2.0}, [3.0, 20.0])
    at = frequency_response(model, budget.frequency).values
    expected = 2.0 * np.abs(at[:, 0] + 2 * at[:, 1] - at[:, 2]) ** 2
    assert budget.psd[:, 0] == pytest.approx(expected, rel=1e-9, abs=0)


def test_a_sine_has_its_line_and_its_mean_square_in_the_budget_of_a_record():
    """Whole periods in a segment; lines are an inverse of its duration apart, from the first one on."""
    time = np.arange(8000) / 1000.0
    record = TimeHistory(time, 3.0 * np.sin(2 * np.pi * 7.0 * time)[None], ("x",), ("um",))
    found = recorded_budget(record, segment_duration=2.0)
    np.testing.assert_allclose(found.frequency, np.arange(1, 1001) / 2.0, rtol=1e-12)
    assert found.frequency[np.argmax(found.psd[0, 0])] == pytest.approx(7.0)
    assert found.rms(5.0, 9.0)[0, 0] == pytest.approx(3.0 / np.sqrt(2), rel=1e-6)


def test_table_says_who_makes_what():
    frequency = np.linspace(1.0, 5.0, 5)
    psd = np.array([[[9e-18] * 5, [16e-18] * 5], [[0.0] * 5, [25.0] * 5]])
    budget = NoiseBudget(frequency, psd, ("lateral", "tilt"), ("floor", "amplifier"), ("m", ""))
    assert str(budget).splitlines() == [
        "rms from 1 to 5 Hz    lateral [m]  tilt",
        "floor                       6e-09     0",
        "amplifier                   8e-09    10",
        "total                       1e-08    10",
        "error by integration          0 %   0 %",
    ]
    uneven = replace(budget, psd=psd * np.array([[1.0, 1, 1, 1, 1], [1, 9, 1, 9, 1]]))
    errors = [f"{100 * x:.2g}" for x in uneven.total.integration_error[:, 0]]
    assert str(uneven).splitlines()[-1].split() == ["error", "by", "integration", errors[0], "%", errors[1], "%"]
    assert not uneven.integration_error[:, 0].any()  # that of the floor alone
    narrow = budget.table(low=2.0, high=3.0).splitlines()  # a quarter of the powers
    assert narrow[0].startswith("rms from 2 to 3 Hz")
    assert [line.split() for line in narrow[1:4]] == [
        ["floor", "3e-09", "0"],
        ["amplifier", "4e-09", "5"],
        ["total", "5e-09", "5"],
    ]


GROWING = LinearModel(np.eye(1), np.eye(1), np.eye(1), np.zeros((1, 1)), ("u",), ("y",))
UNDAMPED = LinearModel([[0.0, 1.0], [-9.0, 0.0]], np.eye(2), np.eye(2), np.zeros((2, 2)), ("u", "v"), ("x", "y"))
FREE = LinearModel([[0.0, 1.0], [0.0, 0.0]], np.eye(2), np.eye(2), np.zeros((2, 2)), ("u", "v"), ("x", "y"))
PLAIN = NoiseBudget([1.0, 2.0], np.ones((1, 1, 2)), ("y",), ("u",))
BAD = {
    "input": (lambda: noise_budget(machine(), {"wind": 1.0}, BAND), "unknown input 'wind'; known: floor, current, run"),
    "none": (lambda: noise_budget(machine(), {}, BAND), "at least one input a spectrum; known inputs: floor, current"),
    "output": (lambda: noise_budget(machine(), {"floor": 1.0}, BAND, outputs="z"), "unknown output 'z'; known: x, y"),
    "negative": (lambda: noise_budget(machine(), {"floor": -1.0}, BAND), "spectrum of 'floor' is -1 at 0.01 Hz"),
    "length": (lambda: noise_budget(machine(), {"floor": [1.0, 2.0]}, BAND), r"shape \(2,\), but there are 120"),
    "one": (lambda: noise_budget(machine(), {"floor": 1.0}, [1.0]), "at least two"),
    "order": (lambda: noise_budget(machine(), {"floor": 1.0}, [1.0, 3.0, 2.0]), "ascending"),
    "before": (lambda: noise_budget(machine(), {"floor": 1.0}, [-1.0, 2.0]), "ascending and not negative"),
    "above": (lambda: noise_budget(sampled(machine(), 10.0), {"floor": 1.0}, [1.0, 6.0]), "end at 5 Hz, got 6 Hz"),
    "unstable": (lambda: noise_budget(GROWING, {"u": 1.0}, BAND), "unstable model has no spectrum: a drift"),
    "undamped": (lambda: noise_budget(UNDAMPED, {"u": 1.0}, BAND), r"undamped motion at 0\.477.* Hz has no bound"),
    "at rest": (lambda: noise_budget(FREE, {"u": 1.0}, [0.0, 1.0]), "pole at s = 0, whose spectrum is infinite at 0"),
    "band": (lambda: PLAIN.rms(0.5), "must rise within 1 ... 2 Hz, got 0.5 and 2 Hz"),
    "swapped": (lambda: PLAIN.rms(2.0, 1.0), "must rise"),
    "noun": (lambda: NoiseBudget([1.0, 2.0], -np.ones((1, 1, 2)), ("y",), ("u",)), "psd must not be negative"),
    "noun's order": (lambda: NoiseBudget([2.0, 1.0], np.ones((1, 1, 2)), ("y",), ("u",)), "ascending"),
    "units": (lambda: NoiseBudget([1.0, 2.0], np.ones((1, 1, 2)), ("y",), ("u",), ("m", "m")), "got 2 units for 1"),
    "outputs": (lambda: NoiseBudget([1.0, 2.0], np.ones((2, 1, 2)), ("y", "y"), ("u",)), "output names must differ"),
    "inputs": (lambda: NoiseBudget([1.0, 2.0], np.ones((1, 2, 2)), ("y",), ("u", "u")), "input names must differ"),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_input_is_named(case):
    make, message = BAD[case]
    with pytest.raises(ValueError, match=message):
        make()


def test_free_motion_has_a_budget_above_rest():
    budget = noise_budget(FREE, {"v": 3.0}, np.geomspace(0.5, 50.0, 400), outputs="x")
    omega = 2 * np.pi * budget.frequency
    assert budget.psd[0, 0] == pytest.approx(3.0 / omega**4, rel=1e-6, abs=0)
    assert budget.rms()[0, 0] ** 2 == pytest.approx(3.0 / (2 * np.pi) ** 4 * (0.5**-3 - 50.0**-3) / 3, rel=1e-3)


def test_a_record_has_the_budget_of_its_model():
    """White noise of 1.7 unit^2/Hz through two modes, sampled: the rms agree within their scatter."""
    model = sampled(two_modes(), RATE)
    noise = spectral_noise(dict.fromkeys(model.inputs, lambda f: np.full(len(f), 1.7)), 30.0, RATE, seed=2)
    states, outputs = np.zeros(len(model.A)), np.empty((len(model.outputs), len(noise.time)))
    for k, u in enumerate(noise.values.T):
        outputs[:, k] = model.C @ states + model.D @ u
        states = model.A @ states + model.B @ u
    record = TimeHistory(noise.time, outputs, model.outputs, ("m",) * len(model.outputs)).after(5.0)
    found = recorded_budget(record, segment_duration=1.0, name="run")
    assert (found.inputs, found.outputs, found.units) == (("run",), model.outputs, ("m",) * len(model.outputs))
    expected = noise_budget(model, dict.fromkeys(model.inputs, 1.7), np.linspace(0.5, 0.49 * RATE, 4000)).total
    band = (1.0, 0.4 * RATE)
    assert found.rms(*band)[:, 0] == pytest.approx(expected.rms(*band)[:, 0], rel=0.06)
    last = recorded_budget(record, segment_duration=1.0, outputs=model.outputs[-1])
    assert np.allclose(last.psd[0], found.psd[-1])
    assert last.inputs == ("record",)
    with pytest.raises(ValueError, match="fewer than two segments of 20 s"):
        recorded_budget(record, segment_duration=20.0)
