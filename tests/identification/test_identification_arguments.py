"""What every optional argument of the verbs of identification does, and limits a tenth below and above."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from arguments import optional_arguments, table
from test_calibration import HEIGHT, WIDTH, cantilever
from test_modal_fit import blocks, plain_fit

from nassim import FRF, identification
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
from nassim.simulation.model.assembly import assemble

F = np.arange(60.0, 160.25, 0.5)
RATE = 1000.0


def mode(frequency, ratio=0.02, at=F):
    return 1 / (1 - (at / frequency) ** 2 + 2j * ratio * at / frequency)


def frf(values):
    return FRF(F, np.reshape(values, (1, 1, -1)), ("y",), ("u",))


TWO = frf(mode(90.0) - 0.5 * mode(120.0))
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
    """Damping ratios that an identified mode of 1 % gives a scene of 3 %; None if no mode matches."""
    try:
        scene, _ = apply_identification(SCENE, fit_of(frequency, gain * GAIN), trusted="gap", **options)
    except ValueError as error:
        assert "no identified mode" in str(error)
        return None
    return assemble(scene).modal.damping.ratio


NEAR = Parameter("height", 0.005, 0.0045, 0.006)
TARGET = Target("stiffness", cantilever({"width": 0.012, "height": 0.005})["stiffness"], 0.01)


def cantilever_of_width(values):
    return cantilever({"height": 0.005, **values})


def fitted(tolerance, **options):
    """Width of a fit to a target of a tolerance; None if that is said not to determine it."""
    try:
        target = replace(TARGET, tolerance=tolerance)
        return calibrate(cantilever_of_width, [WIDTH], [target], sensitivity=[[1.0]], **options).values["width"]
    except ValueError as error:
        assert "cannot determine" in str(error)
        return None


def undamped_first(before, after):
    """Whether no mode matches before; after, the first has the identified damping ratio."""
    return before is None and np.allclose(after, [0.01, 0.03])


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
        ("calibrate", "largest_deviation", 0.1, 0.3, lambda *r: r[0] is None and np.isclose(r[1], 0.012)),
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
    assert rows | {"identify_modes: sample_rate"} == optional_arguments(identification)
