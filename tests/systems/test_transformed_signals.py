"""Loops in other coordinates than the sensors', one loop at a time, all at once: explicit products and closed forms."""

import numpy as np
import pytest
from test_feedback import RATE, two_modes
from test_zeros import platform, same

from nassim.signals.frf import FRF
from nassim.systems.controllers import (
    controller_response,
    decentralised,
    decoupled,
    integral_force_feedback,
    lead,
    notch,
    proportional,
)
from nassim.systems.feedback import close_loop, loop_at_a_time, open_loop, sensitivity, singular_values
from nassim.systems.linear_model import frequency_response, sampled, unstable_poles
from nassim.systems.root_loci import root_locus
from nassim.systems.stability_margins import margins
from nassim.systems.transformed_signals import with_inputs, with_outputs

FREQUENCY = np.array([0.4, 31.0, 62.0, 250.0])
MEASURE = np.array([[1.0, 0.5, -0.2], [0.3, -1.0, 2.0]])
DRIVE = np.array([[0.7, 0.1], [-0.4, 1.5], [0.2, -0.6], [1.0, 1.0]])
WIRES = {"measured": ("v1", "v2"), "driven": ("f1", "f2")}


def pair(**options):
    """Two unlike controllers."""
    return (
        integral_force_feedback(40.0, sample_rate=RATE, corner_frequency=3.0, **options),
        notch(90.0, zero_damping=0.1, pole_damping=0.6, sample_rate=RATE, **options),
    )


@pytest.mark.parametrize("delay", [0, 1, 3])
def test_decoupled_controllers_are_the_product_of_three_matrices(delay):
    controllers = pair(delay=delay)
    found = decoupled(*controllers, measure=MEASURE, drive=DRIVE, limit=7.0)
    assert (found.delay, found.sample_rate, found.limit) == (delay, RATE, 7.0)
    inner = [controller_response(c, FREQUENCY).values[0, 0] for c in controllers]
    expected = np.einsum("uc,cf,cy->uyf", DRIVE, np.array(inner), MEASURE)
    assert controller_response(found, FREQUENCY).values == pytest.approx(expected, rel=1e-12)


def test_a_decoupled_controller_closes_as_single_loops_in_its_coordinates():
    """Around a plant given the coordinates as inputs and outputs, one loop after the other."""
    measure, drive = np.array([[1.0, 0.5], [-0.3, 2.0]]), np.array([[0.7, -0.4], [0.1, 1.5]])
    one, two = proportional(-30.0, sample_rate=RATE), lead(90.0, phase=30.0, gain=-20.0, sample_rate=RATE)
    for plant in (two_modes(), sampled(two_modes(), RATE)):
        closed = close_loop(plant, decoupled(one, two, measure=measure, drive=drive), **WIRES)
        model = with_outputs(plant, ("x", "rx"), measure, of=("v1", "v2"), units=("m", "rad"))
        model = with_inputs(model, ("fx", "tx"), drive, of=("f1", "f2"))
        after = close_loop(model, one, measured="x", driven="fx")
        after = close_loop(after, two, measured="rx", driven="tx")
        values = frequency_response(after, FREQUENCY).values
        assert frequency_response(closed, FREQUENCY).values == pytest.approx(values[:2, :2], rel=1e-8)
        assert (after.outputs, after.inputs) == (("v1", "v2", "x", "rx"), ("f1", "f2", "fx", "tx"))
        assert after.units == ("", "", "m", "rad")
        assert values[2:, 2:] == pytest.approx(np.einsum("cy,yuf,ud->cdf", measure, values[:2, :2], drive), rel=1e-9)


def test_new_signals_are_sums_of_old_ones_feedthrough_included():
    plant = platform(0.3, share=0.2)
    outputs, inputs = np.array([[1.0, 2.0], [0.5, -3.0], [0.0, 1.0]]), np.array([[0.2, -1.0, 4.0], [3.0, 0.5, 0.0]])
    model = with_outputs(plant, ("a", "b", "c"), outputs, of=("fv", "fu"))
    model = with_inputs(model, ("p", "q", "r"), inputs, of=("Fv", "Fu"))
    old = frequency_response(plant, FREQUENCY).values
    found = frequency_response(model, FREQUENCY).values
    assert found[:2, :2] == pytest.approx(old)
    assert found[2:, 2:] == pytest.approx(np.einsum("ab,bcf,cd->adf", outputs, old[::-1, ::-1], inputs), rel=1e-9)


def test_coordinates_of_turned_axes_change_no_pole():
    """Two equal loops along axes turned by any angle are the same loops, on a plant that turns too."""
    one = integral_force_feedback(1.0, sample_rate=1e3, corner_frequency=0.02)
    turn = np.array([[np.cos(0.7), -np.sin(0.7)], [np.sin(0.7), np.cos(0.7)]])
    wires = {"measured": ("fu", "fv"), "driven": ("Fu", "Fv")}
    straight = root_locus(platform(0.1), decentralised(one, one), [0.5, 2.0], **wires)
    turned = root_locus(platform(0.1), decoupled(one, one, measure=turn.T, drive=turn), [0.5, 2.0], **wires)
    for k in range(2):
        assert same(turned.poles[k], straight.poles[k], 1e-6)


def loop_of_two(gains=((-30.0, 4.0), (-8.0, -50.0)), model=None):
    model = sampled(two_modes(), RATE) if model is None else model
    return model, proportional(np.array(gains), sample_rate=RATE)


def test_one_loop_at_a_time_has_the_others_closed():
    """Cut of a diagonal controller against the other loop closed first, and the classical formula for two loops."""
    frequency = np.geomspace(1.0, 900.0, 300)
    plant, both = loop_of_two(((-30.0, 0.0), (0.0, -500.0)))
    loop = open_loop(plant, both, frequency, **WIRES)
    single = [proportional(g, sample_rate=RATE) for g in (-30.0, -500.0)]
    for k, (signal, other) in enumerate((("v1", "v2"), ("v2", "v1"))):
        rest = close_loop(plant, single[1 - k], measured=other, driven=WIRES["driven"][1 - k])
        expected = open_loop(rest, single[k], frequency, measured=signal, driven=WIRES["driven"][k])
        found = loop_at_a_time(loop, signal)
        assert found.values[0, 0] == pytest.approx(expected.values[0, 0], rel=1e-8)
        assert margins(found).modulus_margin == pytest.approx(margins(expected).modulus_margin, rel=1e-8)
        alone = loop.response(signal, signal)
        assert np.abs(found.values[0, 0] / alone - 1).max() > 0.05, "the other loop matters"
        assert (found.outputs, found.inputs, found.label) == ((signal,), (signal,), f"{signal}, others closed")
    # A controller with cross terms, by the Schur complement.
    plant, crossed = loop_of_two()
    (a, b), (c, d) = open_loop(plant, crossed, frequency, **WIRES).values
    loop = open_loop(plant, crossed, frequency, **WIRES)
    assert loop_at_a_time(loop, "v1").values[0, 0] == pytest.approx(a - b * c / (1 + d), rel=1e-9)
    with pytest.raises(ValueError, match="unknown signal 'v3'; known: v1, v2"):
        loop_at_a_time(loop, "v3")
    with pytest.raises(ValueError, match=r"one signal, got 2; .* as loop_at_a_time does"):
        margins(loop)


def test_gain_margin_of_one_loop_is_where_that_loop_becomes_unstable():
    plant = sampled(two_modes(), RATE)
    one, two = proportional(-30.0, sample_rate=RATE, delay=2), proportional(-50.0, sample_rate=RATE, delay=2)
    frequency = np.linspace(1.0, 999.0, 20_000)
    found = margins(loop_at_a_time(open_loop(plant, decentralised(one, two), frequency, **WIRES), "v1")).gain_margin
    assert 1 < found < 100
    for share, grows in ((0.99, False), (1.01, True)):
        changed = decentralised(proportional(-30.0 * share * found, sample_rate=RATE, delay=2), two)
        assert bool(unstable_poles(close_loop(plant, changed, **WIRES))) == grows


def test_the_largest_singular_value_bounds_every_direction():
    plant, controller = loop_of_two()
    s = sensitivity(open_loop(plant, controller, FREQUENCY, **WIRES))[0]
    values = singular_values(s)
    assert values.shape == (2, len(FREQUENCY))
    angles = np.linspace(0, np.pi, 200)
    for k in range(len(FREQUENCY)):
        matrix = s.values[:, :, k]
        # Of 2 x 2 matrices in closed form: sum of squares, and product.
        assert np.sum(values[:, k] ** 2) == pytest.approx(np.sum(np.abs(matrix) ** 2))
        assert np.prod(values[:, k]) == pytest.approx(abs(np.linalg.det(matrix)))
        for phase in np.exp(1j * np.linspace(0, 2 * np.pi, 40)):
            out = np.linalg.norm(matrix @ [np.cos(angles), phase * np.sin(angles)], axis=0)
            assert values[1, k] * (1 - 1e-9) <= out.min() <= out.max() <= values[0, k] * (1 + 1e-9)
    wide = FRF([1.0], np.array([[[3.0], [0.0], [4.0]]]), ("y",), ("a", "b", "c"))
    assert singular_values(wide) == pytest.approx(np.array([[5.0]]))


PLANT = two_modes()
BAD = {
    "measure": (lambda: decoupled(*pair(), measure=np.eye(3), drive=DRIVE), "measure must have shape 2 x any, got 3 x"),
    "drive": (lambda: decoupled(*pair(), measure=MEASURE, drive=np.eye(3)), "drive must have shape any x 2, got 3 x 3"),
    "limit": (
        lambda: decoupled(*pair(limit=4.0), measure=MEASURE, drive=DRIVE),
        "decoupled: a limit of 4 inside cannot be expressed; give the result",
    ),
    "none": (lambda: decoupled(measure=MEASURE, drive=DRIVE), "at least one controller"),
    "unknown": (lambda: with_outputs(PLANT, "x", [[1.0]], of="v3"), "unknown output 'v3'; known: v1, v2"),
    "taken": (lambda: with_outputs(PLANT, "v2", [[1.0]], of="v1"), "has an output 'v2' already"),
    "taken input": (lambda: with_inputs(PLANT, "f2", [[1.0]], of="f1"), "has an input 'f2' already"),
    "shape": (lambda: with_outputs(PLANT, "x", [[1.0]], of=("v1", "v2")), "outputs x must have shape 1 x 2"),
    "twice": (lambda: with_outputs(PLANT, "x", [[1.0, 1.0]], of=("v1", "v1")), "output names must differ"),
    "shape of inputs": (lambda: with_inputs(PLANT, "x", [[1.0]], of=("f1", "f2")), "inputs x must have shape 2 x 1"),
    "nan": (lambda: with_outputs(PLANT, "x", [[np.nan]], of="v1"), "NaN"),
    "units": (lambda: with_outputs(PLANT, "x", [[1.0]], of="v1", units=("m", "m")), "got 2 units for 1 outputs"),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_input_is_named(case):
    make, message = BAD[case]
    with pytest.raises(ValueError, match=message):
        make()
