"""What every optional argument of the verbs of identification does, and limits a tenth below and above."""

import re
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
import scipy
from arguments import optional_arguments, table
from conftest import assert_limit, lattice
from test_calibration import HEIGHT, WIDTH, cantilever
from test_modal_fit import blocks, plain_fit

from nassim import (
    FRF,
    Encoder,
    FlexibleBody,
    Joint,
    RigidBody,
    Scene,
    TimeHistory,
    craig_bampton,
    identification,
)
from nassim.identification import (
    Parameter,
    Target,
    apply_identification,
    at_bounds,
    calibrate,
    identify_modes,
    modal_gains,
    sensitivities,
)
from nassim.identification.apply import _with_std
from nassim.identification.measured_lines import lines_of_frf
from nassim.identification.pole_fit import (
    Solution,
    correlation,
    describe_misfit,
    describe_similar_modes,
    misfit,
    strongest_pole,
)
from nassim.identification.spectral_lines import Lines
from nassim.scene.piezo import StackActuator, StackSensor
from nassim.simulation.model.assembly import assemble

F = np.arange(60.0, 160.25, 0.5)
RATE = 1000.0


def mode(frequency, ratio=0.02, at=F):
    return 1 / (1 - (at / frequency) ** 2 + 2j * ratio * at / frequency)


def frf(values):
    return FRF(F, np.reshape(values, (1, 1, -1)), ("y",), ("u",))


TWO = frf(mode(90.0) - 0.5 * mode(120.0))
"""Two modes. The damping ratio of a fit of one of them alone has a standard deviation above a quarter of it."""
S = 2j * np.pi * F
OPTIONS = {"input": "u", "outputs": ["y"], "band": (60.0, 160.0)}


def identified(data=TWO, **options):
    """Frequencies, damping ratios, gains, residual terms and powers of a fit; "refused" without one."""
    try:
        fit = identify_modes(data, **OPTIONS, **options)
    except ValueError:
        return "refused"
    return fit.frequency, fit.damping_ratio, fit.gains[0], fit.residual_powers, fit.residual_terms[0]


def held(hold_order):
    """An FRF of samples: an input at rest between them, or straight, by the zero-order or triangle hold's spectrum."""
    alias = F + RATE * np.arange(-400, 401)[:, None]
    shape = (
        np.sinc(alias / RATE) * np.exp(-1j * np.pi * alias / RATE) if hold_order == 0 else np.sinc(alias / RATE) ** 2
    )
    return frf(np.sum(shape * mode(90.0, at=alias), axis=0))


def finds(*modes):
    """Whether the modes are those of frequency, damping ratio and gain."""
    return lambda _, after: np.allclose(np.transpose(after[:3]), modes, rtol=1e-6)


def misses(*modes):
    return lambda before, after: not np.allclose(np.transpose(before[:3]), modes, rtol=1e-3) and finds(*modes)(0, after)


def powers(*expected):
    return lambda *results: [tuple(result[3]) for result in results] == list(expected)


def fit_of(frequency, gains):
    return plain_fit([frequency], gains, "force", ("gap",), (1.0, 100.0))


SCENE = blocks(0.5)
GAIN = modal_gains(assemble(SCENE))[:, 0, :1]


def applied(frequency=10.0, gain=1.0, **options):
    """Damping ratios that an identified mode of 1 % gives a scene of 3 %, or the first words of a refusal."""
    try:
        scene, _ = apply_identification(SCENE, fit_of(frequency, gain * GAIN), trusted="gap", **options)
    except ValueError as error:
        return str(error)[:18]
    return assemble(scene).modal.damping.ratio


NEAR = Parameter("height", 0.005, 0.0045, 0.006)
TARGET = Target("stiffness", cantilever({"width": 0.012, "height": 0.005})["stiffness"], 0.01)


def cantilever_of_width(values):
    return cantilever({"height": 0.005, **values})


def fitted(tolerance, **options):
    """Width of a fit to a target of a tolerance, or the first words of a refusal."""
    try:
        target = replace(TARGET, tolerance=tolerance)
        return calibrate(cantilever_of_width, [WIDTH], [target], sensitivity=[[1.0]], **options).values["width"]
    except ValueError as error:
        return str(error)[: len(CANNOT)]


def undamped_first(before, after):
    """Whether no mode matches before; after, the first has the identified damping ratio."""
    return before == "no identified mode" and np.allclose(after, [0.01, 0.03])


CANNOT = "the figures cannot determine"
ONE = (90.0, 0.02, 1.0)
TRUTH = ONE, (120.0, 0.02, -0.5)
CALLS = {
    "ModalFit.response": lambda **o: fit_of(10.0, GAIN).response([5.0, 9.0], **o).label,
    "identify_modes": identified,
    "identify_modes of late samples": partial(identified, frf(TWO.values * np.exp(-S * 1e-3)), n_modes=2),
    "identify_modes of held samples": partial(identified, held(0), sample_rate=RATE, n_modes=1),
    "apply_identification": partial(applied, 10.0 / 1.15),
    "apply_identification of a larger gain": partial(applied, gain=7.0),
    "apply_identification of one mode": applied,
    "calibrate": partial(fitted, 0.2),
    "calibrate by either": lambda **o: calibrate(cantilever_of_width, [WIDTH], [TARGET], **o).deviations["width"],
}
ARGUMENTS = table(
    CALLS,
    [
        ("ModalFit.response", "label", "fit", "model", lambda *r: list(r) == ["fit", "model"]),
        ("identify_modes", "n_modes", None, 1, lambda *r: [len(result[0]) for result in r] == [2, 1]),
        ("identify_modes", "residual_powers", (0, 1, 2, 3), (0, -2), powers((0, 1, 2, 3), (0, -2))),
        ("identify_modes of late samples", "delay", 0.0, 1e-3, misses(*TRUTH)),
        ("identify_modes of held samples", "hold_order", None, 0, lambda *r: r[0] == "refused" and finds(ONE)(*r)),
        ("apply_identification", "distance", 0.1, 0.2, undamped_first),
        ("apply_identification of a larger gain", "factor", 5.0, 10.0, undamped_first),
        ("apply_identification of one mode", "unmeasured_damping_ratio", None, 0.02,
         lambda *r: np.allclose(r, [[0.01, 0.03], [0.01, 0.02]])),
        ("calibrate", "largest_deviation", 0.1, 0.3, lambda *r: r[0] == CANNOT and np.isclose(r[1], 0.012)),
        ("calibrate by either", "sensitivity", None, [[0.8]], lambda *r: np.allclose(r, [0.01, 0.0125])),
    ],
)  # fmt: skip


@pytest.mark.filterwarnings("ignore:the fit is poor")
@pytest.mark.parametrize("case", ARGUMENTS)
def test_an_optional_argument_does_what_it_should(case):
    ARGUMENTS[case].check()


@pytest.mark.filterwarnings("ignore:the fit is poor")
@pytest.mark.parametrize("hold_order", [0, 1])
def test_the_hold_of_samples_at_a_rate(hold_order):
    """Against sums over aliases; another rate or the other hold gives another damping ratio."""
    read = partial(identified, held(hold_order), n_modes=1)
    found = read(hold_order=hold_order, sample_rate=RATE)
    assert finds(ONE)(None, found)
    for other in (
        {"hold_order": hold_order, "sample_rate": 1.3 * RATE},
        {"hold_order": 1 - hold_order, "sample_rate": RATE},
    ):
        assert not finds(ONE)(None, read(**other))


LISTENERS = {
    "calibrate: report": (partial(calibrate, cantilever_of_width, [WIDTH], [TARGET], sensitivity=[[1.0]]), 2),
    "sensitivities: advance": (partial(sensitivities, cantilever, [WIDTH, HEIGHT], ["mass"]), 4),
    "at_bounds: advance": (
        partial(at_bounds, cantilever, [WIDTH], [NEAR], [TARGET], sensitivity=[[1.0]]), 2
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", LISTENERS)
def test_progress_is_told_to_who_wants_to_know(case):
    call, n_calls = LISTENERS[case]
    told = []
    call()
    call(**{case.split(": ")[1]: lambda *given: told.append(given)})
    assert len(told) == n_calls


def test_every_optional_argument_is_here():
    rows = {f"{case.split(': ')[0].split()[0]}: {case.split(': ')[1]}" for case in (*ARGUMENTS, *LISTENERS)}
    elsewhere = {"identify_modes: sample_rate", "UpdateReport: unwritten", "Calibration: covariance"}
    assert rows | elsewhere == optional_arguments(identification)


# Limits


def test_a_mode_is_added_where_its_damping_ratio_is_known_to_a_quarter():
    """A narrow mode that stands out of noise of two sizes; with a number of modes given, a half would do."""
    noise = np.random.default_rng(2).standard_normal((2, len(F)))
    for size, share in ((30.8, 0.9), (35.9, 1.1)):
        data = frf(mode(110.1, 1e-3) + size * (noise[0] + 1j * noise[1]))
        given = identify_modes(data, n_modes=1, **OPTIONS)
        assert given.damping_ratio_std[0] / given.damping_ratio[0] == pytest.approx(0.25 * share, rel=0.02)
        assert (identified(data) == "refused") == (share > 1)


def test_powers_of_the_residual_terms():
    for power, taken in ((-4, True), (8, True), (-5, False), (9, False)):
        assert (identified(n_modes=2, residual_powers=(0, power)) != "refused") == taken


def test_a_resonance_has_a_damping_ratio_from_a_hundred_thousandth_to_a_half():
    """The limits are kept at a distance of one per cent, where a fit would rest on them."""
    assert_limit(lambda x: identify_modes(frf(mode(100.0, 0.5 * x)), n_modes=1, **OPTIONS), "there is no resonance")
    assert_limit(lambda x: identify_modes(frf(mode(100.0, 1e-5 / x)), n_modes=1, **OPTIONS), "there is no resonance")


def test_modes_are_one_resonance_where_they_overlap_and_have_one_shape():
    """Two modes of half-widths of 1 Hz and 3 Hz, seen at two outputs: 1 - MAC by the angle between their gains."""

    def solution(distance, angle):
        gains = np.array([[1.0, np.cos(angle)], [0.0, np.sin(angle)]]) + 0.0
        turned = scipy.spatial.transform.Rotation.from_rotvec([0, 0, np.pi / 4 - angle / 2]).as_matrix()[:2, :2]
        poles = np.array([[100.0, 0.01], [100.0 + distance, 3.0 / (100.0 + distance)]])
        return Solution(poles, turned @ gains, np.zeros((2, 1)), np.ones((2, 1)), np.eye(8))

    for share in (0.9, 1.1):
        limit = np.arcsin(np.sqrt(0.01 * share))
        assert bool(describe_similar_modes(solution(3.0, limit))) == (share < 1)
        assert bool(describe_similar_modes(solution(4.0 * share, 0.0))) == (share < 1)


@pytest.mark.parametrize(("ratio", "n_near"), [(0.01, 39), (1e-4, 15)])  # five half-widths, at least eight lines
def test_a_misfit_is_systematic_from_six_standard_deviations_of_noise_on(ratio, n_near):
    """A residual with energy in four powers of a resonance, beside noise, of which these hold a share of four lines.

    The sum of 8 squares of noise of variance 1/2 has a relative deviation of sqrt(2 / 8).
    """
    frequency = np.arange(60.0, 140.1, 0.25)
    near = np.flatnonzero(np.abs(frequency - 100.0) < 0.25 * (n_near + 1) / 2)
    x = frequency[near] / 100.0
    powers = np.stack([(2j * ratio / (1 - x**2 + 2j * ratio * x)) ** k for k in (1, 2, 3, 4)], axis=1)
    basis = np.linalg.qr(powers)[0]
    random = np.random.default_rng(1)
    noise = random.standard_normal((2, len(near))) * (-1) ** np.arange(len(near))
    noise = noise[0] + 1j * noise[1]
    noise -= basis @ (basis.conj().T @ noise)
    remaining = np.sum(np.abs(noise) ** 2)
    ones = np.ones((1, len(frequency)))
    lines = Lines(
        omega=2 * np.pi * frequency, excitation=ones[0] + 0j, responses=ones, time_step=None, transient=False,
        hold_order=None, residual_powers=(),
    )  # fmt: skip

    def found(systematic):
        residual = 3.0 * (-1.0 + 0j) ** np.arange(len(frequency))[None]  # far away nothing counts
        residual[0, near] = noise + np.sqrt(systematic) * basis @ [0.5, -0.5j, 0.5, 0.5]
        solution = Solution(np.array([[100.0, ratio]]), np.zeros((1, 1)), residual, ones, np.eye(3))
        assert correlation(solution) == 1.0
        return misfit(lines, solution)[0]

    share = 4 / (n_near - 4) * remaining
    limit = share * (1 + 6 * np.sqrt(2 / 8))
    assert found(0.9 * limit) == 0.0
    assert found(1.1 * limit) == pytest.approx(2.0**2 * (1.1 * limit - share))


def test_sensitivities_are_differences_over_eight_per_cent():
    asked = []
    sensitivities(lambda values: asked.append(values["width"]) or cantilever(values), [WIDTH, HEIGHT], ["mass"])
    np.testing.assert_allclose(np.log(np.array(asked) / WIDTH.start), [-0.04, 0.04, 0.0, 0.0], atol=1e-12)


RECORD = TimeHistory(np.arange(100) / RATE, np.random.default_rng(0).normal(size=(2, 100)), ("u", "y"), ("V", "m"))
FIT = fit_of(10.0, GAIN)
APPLY = partial(apply_identification, SCENE, FIT, trusted="gap")
REFUSED = {
    "a distance of nothing": (partial(APPLY, distance=0.0), "distance must be positive, got 0"),
    "a factor of one": (partial(APPLY, factor=1.0), "factor must be above 1, got 1"),
    "any factor": (partial(APPLY, factor=np.inf), "factor holds 1 value.* infinite"),
    "a negative ratio": (
        partial(APPLY, unmeasured_damping_ratio=-0.1),
        "unmeasured_damping_ratio must not be negative",
    ),
    "an unknown ratio": (partial(APPLY, unmeasured_damping_ratio=np.nan), "unmeasured_damping_ratio holds 1 value"),
    "trust in no output": (partial(APPLY, trusted="force"), "unknown trusted output 'force'; known: gap"),
    "a start below zero": (lambda: Parameter("p", -1.0, 0.5, 2.0), "p: start must be positive, got -1"),
    "no upper bound": (lambda: Parameter("p", 1.0, 0.5, np.inf), "p: highest holds 1 value"),
    "no largest deviation": (lambda: fitted_width(largest_deviation=np.nan), "largest_deviation holds 1 value"),
    "an unknown sensitivity": (lambda: fitted_width(sensitivity=[[np.nan]]), "sensitivity holds 1 value"),
    "a figure below zero": (
        lambda: sensitivities(lambda _: {"k": -1.0}, [WIDTH], ["k"]),
        "the model's k must be positive",
    ),
    "an unknown frequency": (lambda: FIT.response([5.0, np.nan]), "frequency holds 1 value"),
    "a rigid body at rest": (
        lambda: replace(FIT, residual_terms=np.ones((1, 1)), residual_powers=[-2.0]).response([0.0, 1.0]),
        "residual_powers of -2: it is infinite at 0 Hz",
    ),
    "frequencies in a table": (lambda: FIT.response([[5.0]]), "frequency must have shape any, got 1 x 1"),
    "an unknown output": (lambda: identify_modes(RECORD, **{**OPTIONS, "outputs": ["z"]}), "unknown signal 'z'"),
    "an unknown input": (lambda: identify_modes(RECORD, **{**OPTIONS, "input": "z"}), "unknown signal 'z'"),
    "a band of one end": (lambda: identify_modes(TWO, **{**OPTIONS, "band": (60.0,)}), "band must have shape 2, got 1"),
    **{
        f"a fit of unknown {name}": (
            partial(replace, FIT, **{name: np.nan * getattr(FIT, name)}),
            f"{name} holds .* NaN",
        )
        for name in ("frequency", "damping_ratio", "gains", "covariance", "noise", "criterion")
    },
    **{
        f"a fit of other {name}": (partial(replace, FIT, **{name: values}), f"{name} must have shape")
        for name, values in {"residual_terms": np.ones((2, 1)), "residual_powers": np.ones((1, 1))}.items()
    },
}


def fitted_width(**options):
    return calibrate(cantilever_of_width, [WIDTH], [TARGET], **{"sensitivity": [[1.0]], **options})


@pytest.mark.parametrize("case", REFUSED)
def test_what_has_no_meaning_is_refused(case):
    call, message = REFUSED[case]
    with pytest.raises(ValueError, match=message):
        call()


# What errors planted here have shown


def test_factors_below_zero_have_deviations_above_it():
    """An amplifier and a sensor with reversed polarity, in the scene as in the record."""
    bar = craig_bampton(lattice(), n_modes=1, progress=False)
    scene = Scene(
        "stack",
        (
            RigidBody("ground", {"o": bar.point("left").position}, fixed=True),
            FlexibleBody("bar", bar, fidelity="linear"),
        ),
        (Joint("clamp", "ground.o", "bar.left"),),
        (StackActuator("stack", "bar.left", "bar.right", 2.0, "v", gain=-10.0),),
        (Encoder("x", "ground.o", "bar.right", "x"), StackSensor("s", "bar.left", "bar.right", -1e3)),
    )
    assembly = assemble(scene)
    gains = modal_gains(assembly)[:, 0]
    mode = np.abs(gains[0]).argmax()
    frequency = assembly.modal.frequency[mode]
    fit = plain_fit([frequency], gains[:, [mode]] * [[1.1], [0.88]], "v", ("x", "s"), (frequency - 1, frequency + 1))
    sizes = np.concatenate([[1e-3, 1e-3], 0.01 * fit.gains[:, 0]])
    _, report = apply_identification(scene, replace(fit, covariance=np.diag(sizes**2)), trusted="x")
    drive, sensor = report.changes[1:]
    assert (drive.parameter, sensor.parameter) == ("stack.gain", "s.voltage_per_elongation")
    assert (drive.after, sensor.after) == pytest.approx((-11.0, -800.0), rel=1e-6)
    assert (drive.std, sensor.std) == pytest.approx((0.11, 8.0 * np.sqrt(2)), rel=1e-6)
    assert _with_std(-2.0, 0.01) == pytest.approx((-2.0, 0.2))  # as of parts without a field for a factor


def test_outputs_of_an_frf_in_any_order_have_their_own_coherence():
    random = np.random.default_rng(0).standard_normal((2, 2, len(F)))
    values = np.stack([mode(100.0), 0.3 * mode(100.0)]) + 0.05 * (random[0] + 1j * random[1])
    coherence = np.stack([np.linspace(0.99, 0.3, len(F)), np.linspace(0.4, 0.95, len(F))])
    data = FRF(F, values[:, None], ("y", "z"), ("u",), coherence)
    there, back = (
        identify_modes(data, **{**OPTIONS, "outputs": names, "n_modes": 1}) for names in (("y", "z"), ("z", "y"))
    )
    np.testing.assert_allclose(back.noise, there.noise[::-1], rtol=1e-6)
    np.testing.assert_allclose(back.frequency, there.frequency, rtol=1e-9)


@pytest.mark.parametrize("seen", [0, 1])
def test_the_strongest_mode_may_be_seen_at_any_output(seen):
    """One output shows a mode at 120 Hz, both a weaker one at 90 Hz."""
    responses = np.tile(0.1 * mode(90.0), (2, 1))
    responses[seen] += mode(120.0)
    ones = np.ones_like(responses, dtype=float)
    lines = Lines(
        omega=2 * np.pi * F, excitation=ones[0] + 0j, responses=responses, time_step=None, transient=False,
        hold_order=None, residual_powers=(),
    )  # fmt: skip
    assert strongest_pole(lines, responses, ones)[0] == pytest.approx(120.0, rel=0.02)


def test_noise_of_a_coherence_is_averaged_over_five_lines():
    """One line with noise as large as its response; the variance of an FRF is |H|^2 (1 - c) / c times a constant."""
    coherence = np.ones((1, len(F)))
    coherence[0, 100] = 0.5
    data = FRF(F, np.full((1, 1, len(F)), 3.0), ("y",), ("u",), coherence)
    _, noise = lines_of_frf(data, "u", ("y",), (70.0, 140.0), None, None, ())
    variance = np.zeros(141)
    variance[78:83] = 3.0**2 / 5  # line 100 is at 110 Hz, the band begins at 70 Hz
    np.testing.assert_allclose(noise[0] ** 2, variance, atol=1e-6)


@pytest.mark.parametrize("unit", ["m/s", "m/s2", "N/s", "m/s^2", "m/s²", "mm / s", "m/s**2", "m s-1", "m s^-2"])
def test_rates_are_refused(unit):
    record = TimeHistory(np.arange(4.0), np.eye(2, 4), ("u", "y"), ("V", unit))
    with pytest.raises(ValueError, match=f"'y' is a rate .{re.escape(unit)}.; modes are fitted to motions"):
        identify_modes(record, **OPTIONS)


def test_a_systematic_residual_tells_how_much_it_enlarges_deviations():
    """The misfit as many times the variance of noise; in the sum of both, deviations are the root of it."""
    fitted = Solution(
        np.array([[90.0, 0.01], [100.0, 0.01]]), np.ones((1, 2)), np.zeros((1, 4)), np.ones((1, 4)), np.eye(6)
    )
    assert "near 100 Hz (7 times), deviations enlarged" in describe_misfit(fitted, np.array([0.0, 48.0]))
    assert describe_misfit(fitted, np.zeros(2)) == ""
    alike = replace(fitted, residual=np.ones((1, 40)), weights=np.ones((1, 40)))  # noise of correlated lines is larger
    assert "near 100 Hz (7 times)" in describe_misfit(alike, np.array([0.0, 48.0 * (1 + 2 * (39 + 38 + 37) / 40)]))


def test_parameters_move_by_up_to_a_factor_of_five_from_their_start():
    """Also where the fit with all others as they are has moved them already, here to twice the start."""

    def moved(share):
        other = Parameter("height", 1.0, 2 / (5 * share), 1.0)
        return at_bounds(
            lambda values: {"area": values["width"] * values["height"]},
            [Parameter("width", 1.0, 0.9, 1.1)], [other], [Target("area", 2.0, 0.01)], sensitivity=[[1.0]],
        )  # fmt: skip

    assert moved(0.9)["height"]["width"] == pytest.approx((4.5 / 2 - 1, 0.0), abs=1e-9)
    assert_limit(moved, "would need width")
