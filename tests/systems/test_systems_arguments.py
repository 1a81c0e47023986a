"""What every optional argument of the verbs of linear systems does, and limits a tenth below and above."""

import math
import warnings
from dataclasses import replace
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest
from arguments import assert_all_tried, is_now, table
from conftest import assert_limit
from test_feedback import LOOP, POLE, RATE, iff, one_mode, two_modes

from nassim import TimeHistory, systems
from nassim.systems import (
    Controller,
    LinearModel,
    NoiseBudget,
    PythonController,
    close_loop,
    controller_from_control,
    controller_model,
    controller_response,
    crossover_controller,
    damping,
    decoupled,
    family_margins,
    frequency_response,
    iff_optimum,
    integral_force_feedback,
    largest_stable_gain,
    lead,
    loop_response,
    noise_budget,
    notch,
    open_loop,
    optimum_gain,
    proportional,
    root_locus,
    sampled,
    tustin,
    unstable_poles,
    with_outputs,
    zeros,
)
from nassim.systems.step_program import step_program

F = np.array([3.0, 47.0, 310.0])
S = 2j * RATE * np.tan(np.pi * F / RATE)
"""What Tustin's rule makes of F."""
ALONE = {"sample_rate": RATE}
PLANT, PAIR = one_mode(0.02), two_modes()
KEPT = iff(60.0, corner_frequency=5.0)
GAINS = np.linspace(0.0, 40.0, 41)
BUDGET = partial(NoiseBudget, [1.0, 2.0, 4.0], np.array([[[1.0, 3.0, 3.0]]]), ("y",), ("u",))
FREE = LinearModel([[0.0, 1.0], [0.0, 0.0]], np.eye(2)[:, 1:], np.eye(2)[:1], [[0.0]], ("f",), ("x",))


def of(controller):
    """Its response but for the delay."""
    late = np.exp(2j * np.pi * F * controller.delay / RATE)
    return controller_response(controller, F).values[0, 0] * late


def are(*expected, rtol=1e-9):
    return lambda *found: all(np.allclose(a, b, rtol=rtol, atol=0) for a, b in zip(found, expected, strict=True))


def shows(of_result, *expected):
    return lambda *found: are(*expected)(*map(of_result, found))


def entry(frf):
    return frf.values[0, 0]


def says(*texts):
    return lambda before, after: all(
        text in table for text, table in zip(texts, (before, before, after, after), strict=True)
    )


def has_pole(z):
    """Whether a controller has a pole in the plane of z that it did not have."""
    return lambda *found: [np.isclose(np.linalg.eigvals(k.A), z, rtol=1e-9).any() for k in found] == [False, True]


def sizes(before, after):
    return lambda *found: tuple(len(model.A) for model in found) == (before, after)


def closed(**options):
    return close_loop(PLANT, KEPT, **LOOP, **options)


def least_damped(_, after):
    """Whether an optimum of delay order 2 has the damping of that loop."""
    frequency, ratio = damping(closed(gain=after.gain, delay_order=2))
    nearest = np.argmin(np.abs(frequency - after.frequency))
    return np.isclose(ratio[nearest], after.damping_ratio, rtol=1e-6) and np.isclose(
        frequency[nearest], after.frequency
    )


def at_the_edge(_, after):
    growth = [closed(gain=factor * after, delay_order=2).poles().real.max() for factor in (0.9999, 1.0001)]
    return growth[0] < 0 < growth[1]


def tustin_of_lag(**options):
    """1 / (s + 300) sampled by Tustin's rule, at 310 Hz."""
    a, b, c, d = tustin((np.array([[-300.0]]), np.eye(1), np.eye(1), np.zeros((1, 1))), 1 / RATE, **options)
    return (c @ b / (np.exp(2j * np.pi * 310.0 / RATE) - a) + d).item()


def from_control(time_step=0, **options):
    control = pytest.importorskip("control")
    return controller_from_control(control.ss(-3.0, 1.0, 2.0, 0.0, time_step), sample_rate=RATE, **options)


OMEGA = 2 * np.pi
DELAYED = {
    "integral_force_feedback": partial(integral_force_feedback, 5.0, **ALONE),
    "proportional": partial(proportional, 5.0, **ALONE),
    "lead": partial(lead, 47.0, phase=30.0, **ALONE),
    "notch": partial(notch, 47.0, zero_damping=0.1, pole_damping=0.5, **ALONE),
    "crossover_controller": partial(
        crossover_controller, FREE, measured="x", driven="f", frequency=20.0, phase_margin=30.0, **ALONE
    ),
    "controller_from_control": from_control,
    "Controller": partial(Controller, **dict(zip("ABCD", KEPT.matrices, strict=True)), **ALONE),
}
CALLS = {
    **DELAYED,
    "decoupled": partial(decoupled, KEPT, KEPT, measure=np.eye(2), drive=np.eye(2)),
    "controller_response": partial(controller_response, KEPT, F),
    "controller_model": partial(controller_model, KEPT, inputs="y", outputs="u"),
    "close_loop": closed,
    "open_loop": partial(open_loop, PLANT, KEPT, F, **LOOP),
    "loop_response": partial(loop_response, frequency_response(PLANT, F), KEPT, **LOOP),
    "root_locus": partial(root_locus, PLANT, KEPT, [0.0, 1.0], **LOOP),
    "optimum_gain": partial(optimum_gain, PLANT, KEPT, GAINS, **LOOP, frequency=POLE),
    "largest_stable_gain": partial(largest_stable_gain, PLANT, KEPT, GAINS, **LOOP),
    "noise_budget": partial(noise_budget, PAIR, {"f1": 1.0}, F),
    "NoiseBudget": BUDGET,
    "rms": BUDGET().rms,
    "table": BUDGET().table,
    "tustin": tustin_of_lag,
    "with_outputs": partial(with_outputs, replace(PAIR, units=("m", "m")), "sum", [[1.0, 1.0]], of=PAIR.outputs),
    "frequency_response": partial(frequency_response, PAIR, F),
    "LinearModel": partial(LinearModel, *PAIR.matrices, PAIR.inputs, PAIR.outputs),
    "PythonController": partial(PythonController, SimpleNamespace(output=lambda measured, time: measured), **ALONE),
}
G = frequency_response(PLANT, F).response("force", "stroke")
K = of(KEPT) * np.exp(-2j * np.pi * F / RATE)
PADE = frequency_response(controller_model(KEPT, inputs="y", outputs="u"), F).values[0, 0]
HOLD = (1 - np.exp(-2j * np.pi * F / RATE)) / (2j * np.pi * F / RATE)
ARGUMENTS = table(
    CALLS,
    [
        *((verb, "delay", 1, 3, is_now("delay", 3)) for verb in DELAYED),
        *((verb, "limit", math.inf, 4.0, is_now("limit", 4.0)) for verb in (*DELAYED, "decoupled")),
        ("integral_force_feedback", "corner_frequency", 0.0, 20.0, shows(of, -5 / S, -5 / (S + 20 * OMEGA))),
        ("integral_force_feedback", "high_pass", 0.0, 20.0, shows(of, -5 / S, -5 / (S + 20 * OMEGA))),
        ("lead", "gain", 1.0, -3.0, lambda before, after: np.allclose(of(after), -3 * of(before))),
        ("crossover_controller", "integral_frequency", 0.0, 2.0, has_pole(1.0)),
        ("crossover_controller", "low_pass_frequency", 0.0, 200.0, has_pole((1 - 0.05 * OMEGA) / (1 + 0.05 * OMEGA))),
        ("controller_response", "hold", False, True, lambda _, after: np.allclose(after.values[0, 0], K * HOLD)),
        ("controller_response", "inputs", ("input_1",), ("y",), is_now("inputs", ("y",))),
        ("controller_response", "outputs", ("output_1",), ("u",), is_now("outputs", ("u",))),
        ("controller_response", "label", "controller", "here", is_now("label", "here")),
        ("controller_model", "time_step", None, 1 / RATE, is_now("time_step", 1 / RATE)),
        ("controller_model", "delay_order", 4, 2, sizes(5, 3)),
        (
            "close_loop",
            "gain",
            1.0,
            2.5,
            shows(
                lambda model: frequency_response(model, F).response("force", "stroke"),
                G / (1 - G * PADE),
                G / (1 - 2.5 * G * PADE),
            ),
        ),
        ("close_loop", "delay_order", 4, 2, sizes(7, 5)),
        ("close_loop", "noise", False, True, is_now("inputs", ("stroke", "push", "force noise"))),
        ("open_loop", "gain", 1.0, 2.5, shows(entry, -G * K * HOLD, -2.5 * G * K * HOLD)),
        ("open_loop", "label", "open loop", "here", is_now("label", "here")),
        ("loop_response", "gain", 1.0, 2.5, shows(entry, -G * K * HOLD, -2.5 * G * K * HOLD)),
        ("loop_response", "hold", True, False, shows(entry, -G * K * HOLD, -G * K)),
        ("loop_response", "label", "open loop", "here", is_now("label", "here")),
        (
            "root_locus",
            "delay_order",
            4,
            2,
            lambda before, after: (before.poles.shape[1], after.poles.shape[1]) == (7, 5),
        ),
        ("optimum_gain", "delay_order", 4, 2, least_damped),
        ("largest_stable_gain", "delay_order", 4, 2, at_the_edge),
        ("noise_budget", "outputs", ("v1", "v2"), "v2", is_now("outputs", ("v2",))),
        ("NoiseBudget", "units", ("",), ("m",), is_now("units", ("m",))),
        # Between 1 and 2 Hz from 1 to 3, then 3 up to 4 Hz.
        ("rms", "low", 1.0, 2.0, are(np.sqrt([[2.0 + 6.0]]), np.sqrt([[6.0]]))),
        ("rms", "high", 4.0, 3.0, are(np.sqrt([[2.0 + 6.0]]), np.sqrt([[2.0 + 3.0]]))),
        ("table", "low", 1.0, 2.0, says("rms from 1 to 4 Hz", "2.83", "rms from 2 to 4 Hz", "2.45")),
        ("table", "high", 4.0, 3.0, says("rms from 1 to 4 Hz", "2.83", "rms from 1 to 3 Hz", "2.24")),
        ("tustin", "prewarp", 0.0, 310.0 * OMEGA, are(1 / (S[2] + 300), 1 / (310j * OMEGA + 300))),
        ("with_outputs", "units", ("",), ("m",), is_now("units", ("m", "m", "m"))),
        ("frequency_response", "label", "linear model", "here", is_now("label", "here")),
        ("LinearModel", "units", (), ("m", "m"), is_now("units", ("m", "m"))),
        ("LinearModel", "time_step", None, 0.1, is_now("time_step", 0.1)),
        ("LinearModel", "unsupported", (), [0, 0, 9, 9], lambda _, after: after.unsupported.tolist() == [0, 0, 9, 9]),
        ("PythonController", "delay", 1, 3, is_now("delay", 3)),
        ("PythonController", "limit", math.inf, 4.0, is_now("limit", 4.0)),
    ],
)


@pytest.mark.parametrize("case", ARGUMENTS)
def test_an_optional_argument_does_what_it_should(case):
    ARGUMENTS[case].check()


SYNTHESIS = {
    "test_norms.py::test_the_largest_gain_is_that_of_dense_frequencies": ("hinf_norm: inputs", "hinf_norm: outputs"),
    "test_norms.py::test_parts_and_tolerances_of_norms": (
        "h2_norm: inputs",
        "h2_norm: outputs",
        "hinf_norm: tolerance",
        "subsystem: inputs",
        "subsystem: outputs",
    ),
    "test_interconnection.py::test_a_weight_has_its_three_gains_and_its_slope": (
        "weighting_filter: gain",
        "weighting_filter: name",
        "weighting_filter: order",
    ),
    "test_model_reduction.py::test_the_error_lies_between_the_next_singular_value_and_the_bound": (
        "balanced_truncation: error",
        "balanced_truncation: n_states",
    ),
    "test_model_reduction.py::test_the_worst_plant_of_each_loop_is_named": ("family_margins: gain",),
    "test_synthesis.py::test_a_synthesised_controller_is_sampled_and_closes_a_loop": (
        "controller_from_model: delay",
        "controller_from_model: limit",
    ),
    "test_synthesis.py::test_a_tolerance_is_the_distance_from_the_least_norm": (
        "hinf_synthesis: tolerance",
        "hinf_complementary_filters: tolerance",
        "mixed_sensitivity: tolerance",
    ),
    "test_synthesis.py::test_mixed_sensitivity_bounds_the_three_weighted_responses": ("mixed_sensitivity: robustness",),
    "test_synthesis.py::test_integrals_remove_the_offset_of_their_outputs_only": ("lqg: integral",),
    "test_noise_budget.py::test_a_record_has_the_budget_of_its_model": (
        "recorded_budget: name",
        "recorded_budget: outputs",
    ),
    "test_rotating_budget.py::test_narrow_noise_moves_a_rotor_as_a_sine_does": (
        "rotating_noise_budget: fixed_inputs",
        "rotating_noise_budget: fixed_outputs",
    ),
    "test_rotating_budget.py::test_without_pairs_or_speed_it_is_the_budget_itself": ("rotating_noise_budget: outputs",),
    "test_synthesis.py::test_closed_forms_of_complementary_filters": (
        "ComplementaryFilters: norm",
        "complementary_filters: order",
    ),
}
"""Optional arguments of syntheses and of what they use, by their test."""


def test_every_optional_argument_is_here():
    here = "systems/test_systems_arguments.py::test_zeros_of_some_inputs_and_outputs"
    gains = "test_gains_vary_smoothly_with_the_sample_rate_and_folding_modes_tell_which_are_safe"
    elsewhere = {"zeros: inputs": here, "zeros: outputs": here}
    for of_pid in ("ki", "kd", "derivative_bandwidth", "anti_windup_time", "delay"):
        elsewhere[f"pid: {of_pid}"] = "simulation/test_references.py::test_pid_is_the_sampled_law_of_textbooks"
    elsewhere["RootLocus: time_step"] = "systems/test_root_locus.py::test_a_sampled_drift_by_rounding_is_stable"
    elsewhere["pid: limit"] = "simulation/test_references.py::test_the_integrator_does_not_wind_up"
    elsewhere["Controller: anti_windup"] = elsewhere["pid: limit"]
    closed = "simulation/test_references.py::test_the_linear_closed_loop_has_the_reference_as_input"
    elsewhere["close_loop: reference"] = closed
    for place, arguments in SYNTHESIS.items():
        elsewhere |= dict.fromkeys(arguments, f"systems/{place}")
    fatigue = {
        "WoehlerLine: endurance_limit": "a_sine_does_the_damage_of_its_cycles",
        "damage_rate: output": "spectra_that_are_no_stress_are_refused",
        "damage_rate: method": "narrow_noise_has_amplitudes_of_rayleigh",
    }
    elsewhere |= {name: f"systems/test_fatigue.py::test_{test}" for name, test in fatigue.items()}
    assert_all_tried(
        systems, ARGUMENTS, elsewhere | {"folding_modes: gain": f"simulation/test_quasi_static.py::{gains}"}
    )


def test_zeros_of_some_inputs_and_outputs():
    """With direct feedthrough D they are the eigenvalues of A - B D^-1 C."""
    direct = np.array([[1e-4, -2e-5], [3e-5, 2e-4]])
    plant = replace(PAIR, D=direct)
    for rows, columns in (([0, 1], [0, 1]), ([0], [1]), ([1], [0])):
        gone = PAIR.A - PAIR.B[:, columns] @ np.linalg.solve(direct[np.ix_(rows, columns)], PAIR.C[rows])
        outputs, inputs = ([names[k] for k in which] for names, which in ((PAIR.outputs, rows), (PAIR.inputs, columns)))
        found = zeros(plant, inputs=inputs, outputs=outputs) if len(rows) == 1 else zeros(plant)
        assert np.sort_complex(found) == pytest.approx(np.sort_complex(np.linalg.eigvals(gone)), rel=1e-8)


def first_order(*rates):
    n = len(rates)
    return LinearModel(np.diag(rates), np.ones((n, 1)), np.ones((1, n)), np.zeros((1, 1)), ("u",), ("y",))


def nearly_undamped(ratio):
    return replace(FREE, A=[[0.0, 1.0], [-9.0, -6.0 * ratio]])


def at_another_rate(share):
    return replace(sampled(PLANT, RATE), time_step=(1 + share) / RATE)


def with_feedthrough(share):
    """A loop whose direct feedthrough times gain is 1 but for a share."""
    return close_loop(replace(FREE, D=[[1 - share]]), proportional(1.0, **ALONE, delay=0), measured="x", driven="f")


BEST = iff_optimum(POLE, 40.0)
LIMITS = {
    "phase of a lead": (lambda x: lead(47.0, phase=90 * x, **ALONE), "phase must lie within"),
    "phase of a lag": (lambda x: lead(47.0, phase=-90 * x, **ALONE), "phase must lie within"),
    "lead at Nyquist": (lambda x: lead(RATE / 2 * x, phase=30, **ALONE), "below half"),
    "notch at Nyquist": (lambda x: notch(RATE / 2 * x, zero_damping=0, pole_damping=1, **ALONE), "below half"),
    "leak at Nyquist": (lambda x: integral_force_feedback(1.0, corner_frequency=RATE / 2 * x, **ALONE), "below half"),
    "high-pass at Nyquist": (lambda x: integral_force_feedback(1.0, high_pass=RATE / 2 * x, **ALONE), "below half"),
    "low-pass at Nyquist": (lambda x: DELAYED["crossover_controller"](low_pass_frequency=RATE / 2 * x), "below half"),
    # A free mass needs as much lead as margin and delay, 0.036 deg at a crossover of a fifteen-thousandth of the rate.
    "two leads": (
        lambda x: crossover_controller(FREE, measured="x", driven="f", frequency=0.01, phase_margin=130 * x, **ALONE),
        "no lead gives",
    ),
    "another rate": (lambda x: open_loop(at_another_rate(1e-9 * x), KEPT, F, **LOOP), "sampled at"),
    "another rate of python-control": (
        lambda x: from_control(time_step=(1 + 1e-9 * x) / RATE),
        "is not the sample rate's",
    ),
    "a loop at once": (lambda x: with_feedthrough(1e-9 / x), "no solution within a sample"),
    "growing by rounding": (lambda x: noise_budget(first_order(1e-8 * x, -1.0), {"u": 1.0}, F), "unstable model"),
    "at rest": (lambda x: noise_budget(first_order(-1e-8 / x, -1.0), {"u": 1.0}, [0.0, 1.0]), "pole at s = 0"),
    "undamped": (lambda x: noise_budget(nearly_undamped(1e-9 / x), {"f": 1.0}, [0.1, 1.0]), "has no bound"),
    "above half the rate": (
        lambda x: noise_budget(sampled(PLANT, RATE), {"push": 1.0}, [1.0, RATE / 2 * (1 + 1e-9 * x)]),
        "end at",
    ),
    "prewarping": (lambda x: tustin(PLANT.matrices, 1e-3, prewarp=np.pi / 1e-3 * (x / 1.05)), "prewarp must lie below"),
    "an aperiodic optimum": (lambda x: iff_optimum(3 * 40.0 * x, 40.0), "between one and three times"),
    "an optimum beyond": (
        lambda x: optimum_gain(
            one_mode(), iff(BEST.gain), np.linspace(0, 1 / x, 41), **LOOP, frequency=POLE, delay_order=0
        ),
        "give larger gains",
    ),
}


TURNING = partial(systems.rotating_noise_budget, PAIR, frequency=F, rotation_frequency=1.0)
SHAPED = partial(systems.mixed_sensitivity, PLANT, measured="position", driven="push", performance=1.0, effort=1.0)
SQUARED = partial(systems.lqg, PLANT, acceptable={"position": 1.0}, disturbances={"push": 1.0}, noise={"force": 1.0})
REFUSED = {
    "frequencies of more states": (
        lambda: replace(PLANT, unsupported=np.ones(9)),
        "unsupported has 9 frequencies for 2",
    ),
    "a name used twice": (
        lambda: replace(PLANT, B=np.ones((2, 2)), D=np.ones((len(PLANT.D), 2)), inputs=("u", "u")),
        "input names must differ; used more than once: u",
    ),
    "a name read as its letters": (
        lambda: replace(PLANT, C=np.ones((2, 2)), D=np.ones((2, len(PLANT.inputs))), outputs="xy", units=()),
        "output names must be a list of them, got the text 'xy'",
    ),
    "units of other outputs": (
        lambda: replace(PLANT, units=("m",) * (len(PLANT.outputs) + 1)),
        "one unit per output, or none: got .* units for",
    ),
    "units read as letters": (
        lambda: replace(PAIR, units="mm"),
        "units must be a list of them, got the text 'mm'",
    ),
    "units of new outputs read as letters": (
        lambda: with_outputs(PLANT, ["a", "b"], np.ones((2, 1)), of="force", units="mm"),
        "units must be a list of them, got the text 'mm'",
    ),
    "units of a budget read as letters": (
        lambda: NoiseBudget([1.0, 2.0], np.ones((2, 1, 2)), ("y", "z"), ("u",), "mm"),
        "units must be a list of them, got the text 'mm'",
    ),
    "a number for a matrix": (
        lambda: LinearModel(1.0, [[1.0]], [[1.0]], [[0.0]], ("u",), ("y",)),
        "A must have shape any x any, got a number",
    ),
    "a controller at its pole": (
        lambda: controller_response(iff(60.0), [1.0, 0.0]),
        "the response is infinite at 0 Hz",
    ),
    "a budget of no signal": (
        lambda: systems.recorded_budget(SILENT, segment_duration=0.1, outputs=[]),
        "name at least one output; known signals: y",
    ),
    "a budget of no output": (
        lambda: noise_budget(PLANT, {PLANT.inputs[0]: 1.0}, [1.0, 2.0], outputs=[]),
        "at least one output and one disturbance",
    ),
    "no frequencies": (
        lambda: frequency_response(PLANT, []),
        "frequency must be ascending, not negative and not empty",
    ),
    "one input along two axes": (
        lambda: TURNING({"push": np.ones_like}, fixed_inputs=[("f1", "f1")]),
        "input names must differ; used more than once: f1",
    ),
    "a pair that is none": (
        lambda: TURNING({"push": np.ones_like}, fixed_inputs=("push", "push")),
        "inputs along two axes must be pairs of names",
    ),
    "margins of falling frequencies": (
        lambda: family_margins({"a": PLANT}, KEPT, [2.0, 1.0], **LOOP),
        "frequency must be ascending",
    ),
    "margins above half the rate": (
        lambda: family_margins({"a": PLANT}, KEPT, [1.0, RATE], **LOOP),
        "its responses and spectra end at",
    ),
    "a stiffness that is not symmetric": (
        lambda: systems.modal_decoupling(np.eye(2), [[2.0, 1.0], [0.0, 2.0]], measured=np.eye(2), driven=np.eye(2)),
        "stiffness must be symmetric",
    ),
    "a response without bound": (lambda: frequency_response(FREE, [1.0, 0.0]), "is infinite at 0 Hz"),
    "a delay below zero": (lambda: python(delay=-1), "delay must be a whole number of at least 0, got -1"),
    "half a sample": (lambda: python(delay=0.5), "delay must be a whole number of at least 0, got 0.5"),
    "no command": (lambda: python(limit=0.0), "limit must be positive, got 0.0"),
    "a delay that is no number": (lambda: python(delay=np.nan), "delay must be a whole number of at least 0, got nan"),
    "no noise": (lambda: TURNING({}), "at least one input"),
    "noise of no input": (lambda: TURNING({"a": np.ones_like}), "unknown input 'a'"),
    "a pair of no inputs": (lambda: TURNING({}, fixed_inputs=[("a", "b")]), "unknown input 'a'"),
    "a pair of no outputs": (lambda: TURNING({}, fixed_outputs=[("a", "b")]), "unknown output 'a'"),
    "a rotation without number": (
        lambda: TURNING({"push": np.ones_like}, rotation_frequency=np.nan),
        r"rotation_frequency holds 1 .*NaN or infinite",
    ),
    "a loop from no output": (lambda: SHAPED(measured="a"), "unknown output 'a'"),
    "a controller of no output": (
        lambda: systems.hinf_synthesis(PLANT, measured="a", driven="push"),
        "unknown output 'a'",
    ),
    "a controller for no input": (
        lambda: systems.hinf_synthesis(PLANT, measured="position", driven="a"),
        "unknown input 'a'",
    ),
    "effort without size": (lambda: SQUARED(effort={"push": 0.0}), "input 'push' must be positive, got 0"),
    "effort of no input": (lambda: SQUARED(effort={"a": 1.0}), "unknown input 'a'"),
    "gains of other signals": (
        lambda: systems.static_gain(np.eye(2), inputs="u", outputs="y"),
        "matrix must have shape 1 x 1, got 2 x 2",
    ),
    "stiffness of more coordinates": (
        lambda: systems.modal_decoupling(np.eye(2), np.eye(3), measured=np.eye(2), driven=np.eye(2)),
        "stiffness must have shape 2 x 2, got 3 x 3",
    ),
    "signals of fewer coordinates": (
        lambda: systems.modal_decoupling(np.eye(3), np.eye(3), measured=np.eye(2), driven=np.eye(3)),
        "measured must have shape 3 x 3, got 2 x 2",
    ),
    "a matrix without rotations": (
        lambda: systems.uncoupled_point(np.eye(3)),
        "matrix must have shape 6 x 6",
    ),
    "several stresses": (lambda: systems.count_cycles(np.ones((2, 9))), "stress history must have shape"),
    "an output of nothing": (
        lambda: with_outputs(PLANT, "new", [[np.nan]], of="force"),
        r"matrix for outputs new holds 1 .*NaN",
    ),
    "one and a half states": (
        lambda: systems.balanced_truncation(PLANT, n_states=1.5),
        "n_states must be a whole number of at least 1",
    ),
}


def python(sample_rate=1e3, **options):
    return PythonController(SimpleNamespace(output=np.add), sample_rate, **options)


@pytest.mark.parametrize("make", [python, lambda **figures: proportional(1.0, **figures)])
def test_a_controller_counts_its_delay_and_may_saturate_at_less_than_one(make):
    controller = make(sample_rate=np.int64(500), delay=2.0, limit=np.float32(0.25))
    figures = controller.sample_rate, controller.delay, controller.limit
    assert figures == (500.0, 2, 0.25)
    assert [type(figure) for figure in figures] == [float, int, float]


@pytest.mark.parametrize("case", REFUSED)
def test_what_has_no_meaning_is_refused(case):
    make, message = REFUSED[case]
    with pytest.raises(ValueError, match=message):
        make()


WEIGHT = {"frequency": 10.0, "low": 0.1, "high": 1e3, "gain": 0.5, "order": 2}
CROSSED = partial(crossover_controller, PLANT, frequency=1.0, phase_margin=40.0, sample_rate=RATE, **LOOP)
SILENT = TimeHistory(np.arange(100) * 0.01, np.zeros((1, 100)), ("y",), ("m",))
OUT_OF_RANGE = {
    **{
        f"weighting_filter: {name}": partial(systems.weighting_filter, **(WEIGHT | {name: -WEIGHT[name]}))
        for name in ("frequency", "low", "high", "gain")
    },
    **{
        f"crossover_controller: {name}": partial(CROSSED, **{name: -1.0})
        for name in ("frequency", "sample_rate", "integral_frequency", "low_pass_frequency")
    },
    "mixed_sensitivity: weight": partial(SHAPED, effort=0.0),
    "recorded_budget: segment_duration": partial(systems.recorded_budget, SILENT, segment_duration=0.0),
    "step_program: time_step": partial(step_program, PLANT, -1.0),
    "PythonController: sample_rate": partial(python, 0.0),
    "WoehlerLine: endurance_limit": partial(systems.WoehlerLine, [1e3, 1e6], [2e8, 1e8], -1.0),
    "complementary_filters: frequency": partial(systems.complementary_filters, -5.0),
    "balanced_truncation: error": partial(systems.balanced_truncation, two_modes(), error=-1.0),
    "hinf_norm: tolerance": partial(systems.hinf_norm, two_modes(), tolerance=math.nan),
    "pid: derivative_bandwidth": partial(systems.pid, 1.0, kd=2.0, sample_rate=1e3, derivative_bandwidth=-10.0),
    "pid: anti_windup_time": partial(systems.pid, 1.0, 2.0, sample_rate=1e3, anti_windup_time=-1.0),
    "notch: zero_damping": partial(notch, 50.0, zero_damping=-0.1, pole_damping=0.5, sample_rate=1e3),
    "tustin: time_step": partial(tustin, PLANT.matrices, -1e-3),
    "tustin: prewarp": partial(tustin, PLANT.matrices, 1e-3, prewarp=-1.0),
    "inverse_tustin: time_step": partial(systems.inverse_tustin, PLANT.matrices, 0.0),
    "discretize: time_step": partial(systems.discretize, PLANT.A, PLANT.B, 0.0),
    "iff_optimum: pole_frequency": partial(iff_optimum, -5.0, -3.0),
    "iff_optimum: zero_frequency": partial(iff_optimum, 5.0, -3.0),
}


@pytest.mark.parametrize("case", OUT_OF_RANGE)
def test_numbers_below_their_range_are_refused_by_name(case):
    with pytest.raises(ValueError, match=f"{case.split(': ')[1]} must"):
        OUT_OF_RANGE[case]()


@pytest.mark.parametrize("case", LIMITS)
def test_limits_lie_where_they_should(case):
    assert_limit(*LIMITS[case])


def test_growth_that_is_no_rounding_is_told():
    assert unstable_poles(first_order(0.9e-8, -1.0)) == ()
    assert len(unstable_poles(first_order(1.1e-8, -1.0))) == 1
    assert [damping(first_order(-1e-8 * share, -1.0)).ratio[0] for share in (0.9, 1.1)] == [0.0, 1.0]


@pytest.mark.parametrize(("share", "told"), [(0.9, 0), (1.1, 1)])
def test_coarse_frequencies_are_told_from_two_hundredths_on(share, told):
    """Of the rms of 1, 1 + e, 1 at 1, 2, 3 Hz, a third of what the middle adds: (1 - sqrt(2 / (2 + e))) / 3."""
    middle = 2 / (1 - 3 * 0.02 * share) ** 2 - 1
    nothing = np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), np.ones((1, 1))
    with warnings.catch_warnings(record=True) as found:
        warnings.simplefilter("always")
        noise_budget(LinearModel(*nothing, ("u",), ("y",)), {"u": [1.0, middle, 1.0]}, [1.0, 2.0, 3.0])
    assert sum("frequencies are too coarse" in str(one.message) for one in found) == told


def test_a_gain_that_destabilises_is_seen_within_the_given_ones():
    edge = largest_stable_gain(PLANT, KEPT, GAINS, **LOOP)
    for factor in (0.9, 1.1):
        found = largest_stable_gain(PLANT, KEPT, factor * edge * np.linspace(0, 1, 9), **LOOP)
        assert found == (math.inf if factor < 1 else pytest.approx(edge, rel=1e-6))


def test_responses_above_half_the_sample_rate_are_told(recwarn):
    """They mirror those below: G(rate - f) is the conjugate of G(f), as exp(2 pi i f / rate) shows."""
    model, frequency, mirrored = sampled(PLANT, RATE), np.array([3.0, RATE / 2]), np.array([RATE / 2, RATE - 3.0])
    below = frequency_response(model, frequency).values
    own = controller_response(KEPT, frequency).values
    controller_response(KEPT, mirrored, hold=True)
    open_loop(model, KEPT, frequency, **LOOP)
    open_loop(PLANT, KEPT, mirrored, **LOOP)
    assert not recwarn
    with pytest.warns(UserWarning, match="model is sampled at .* mirrors that below; the frequencies reach"):
        above = frequency_response(model, mirrored).values
    np.testing.assert_allclose(above[..., 1], below[..., 0].conj(), rtol=1e-9)
    with pytest.warns(UserWarning, match="the controller is sampled at"):
        above = controller_response(KEPT, mirrored).values
    np.testing.assert_allclose(above[..., 1], own[..., 0].conj(), rtol=1e-9)
    with pytest.warns(UserWarning, match="is sampled at") as told:
        open_loop(model, KEPT, mirrored, **LOOP)
    assert len(told) == 1


def test_above_65_deg_two_leads_share_a_phase():
    for margin, order in ((0.9 * 65, 1), (1.1 * 65, 2)):
        shaped = crossover_controller(FREE, measured="x", driven="f", frequency=0.01, phase_margin=margin, **ALONE)
        assert len(shaped.A) == order
