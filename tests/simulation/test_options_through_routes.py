"""Options of a verb that another one passes on: closed loops of linear models, runs with motions and step by step."""

import numpy as np
import pytest
from test_order_of_parts import AXIS, HELD, LOOPS, STEP, TABLE, held, machine, pulses, responses

from nassim import Simulation, frequency_response, linearize, simulate
from nassim.simulation import linearize_closed, simulate_motion
from nassim.systems import close_loop, controller_model, sampled, subsystem

SPIN = {"angular_velocity": 6.0 * AXIS, "axis_point": TABLE}
PUSHED = {"push": 0.4, "pull": -0.3, "torque": 2e-4}


def assert_same(found, expected, within=1e-8):
    assert set(found) == set(expected)
    for name, values in expected.items():
        size = np.abs(values).max() + 1e-9
        np.testing.assert_allclose(found[name], values, rtol=0, atol=within * size, err_msg=name)


def differs(one, other):
    return any(np.abs(one[name] - values).max() > 1e-6 * np.abs(values).max() for name, values in other.items())


@pytest.mark.parametrize(
    ("kind", "options"),
    [
        ("resting", {"constant_inputs": {"push": 30.0, "pull": -20.0, "left/tug": 20.0}}),
        ("resting", {"loaded": False}),
        ("locked", SPIN),
    ],
)
def test_closed_loops_are_about_what_linear_models_are_about(kind, options):
    """As loops closed by hand about the same model; another model has other responses."""
    scene = machine("resting" if kind == "resting" else "spinning", loops=[one for one in LOOPS if one.name in HELD])
    scene = scene if kind == "resting" else held(scene)
    plain = {"angular_velocity": SPIN["angular_velocity"]} if options == SPIN else {}

    def by_hand(options):
        model = sampled(linearize(scene, **options), 1e3)
        for loop in scene.loops:
            model = close_loop(
                model, loop.controller, measured=loop.measured, driven=loop.driven, reference=loop.reference
            )
        return subsystem(model, inputs=[name for name in model.inputs if not name.endswith(" set")])

    found = linearize_closed(scene, **options)
    found = responses(subsystem(found, inputs=[name for name in found.inputs if not name.endswith(" set")]))
    assert_same(found, responses(by_hand(options)))
    assert differs(found, responses(by_hand(plain)))


@pytest.mark.parametrize("options", [{"noise": True}, {"reference": ("way set", "turn set")}])
@pytest.mark.parametrize(("gain", "delay_order"), [(-0.3, 1)])
def test_further_inputs_of_a_closed_loop_leave_its_gain_and_delay(options, gain, delay_order):
    """From the others all is as in the loop without them; theirs is by the controller what the driven inputs' is."""
    model = linearize(machine("resting"))
    law, signals = LOOPS[0].controller, {"measured": ("way", "turn"), "driven": ("push", "torque")}
    loop = {**signals, "gain": gain, "delay_order": delay_order}
    plain, more = close_loop(model, law, **loop), close_loop(model, law, **loop, **options)
    assert_same(responses(subsystem(more, inputs=model.inputs)), responses(plain))
    control = controller_model(law, inputs=signals["measured"], outputs=signals["driven"], delay_order=delay_order)
    lines = [0.5, 8.0, 300.0]
    frf, through, law_frf = (frequency_response(one, lines) for one in (more, plain, control))
    for k, name in enumerate(signals["measured"]):
        added = options["reference"][k] if "reference" in options else f"{name} noise"
        sign = -1.0 if "reference" in options else 1.0
        for out in ("level", "left/sense"):
            expected = sum(through.response(out, by) * law_frf.response(by, name) for by in signals["driven"])
            np.testing.assert_allclose(frf.response(out, added), sign * gain * expected, rtol=1e-6)


@pytest.mark.parametrize(
    ("kind", "options"),
    [
        (
            "resting",
            {"spectral_radius": 0.4, "start": "released", "period_correction": False, "constant_inputs": PUSHED},
        ),
        ("spinning", {"method": "exact", "start": "released", "hold_order": 0, "constant_inputs": PUSHED}),
    ],
)
def test_runs_of_all_kinds_take_the_same_options(kind, options):
    """With floating frames: with motions, step by step, and for some of the outputs; each option counts."""
    scene = machine(kind, "ffrf", loops=LOOPS)
    given = pulses(scene, tuple, 18)

    def ran(**options):
        return simulate(scene, given, time_step=STEP, progress=False, **options)

    record = ran(**options)
    again = simulate_motion(scene, given, time_step=STEP, progress=False, **options, frames=2)[0]
    some = ran(**options, outputs=["turn", "left/sense", "motion.push"])
    with Simulation(scene, time_step=STEP, **options) as steps:
        for values in given.values.T[1:]:
            steps.step(dict(zip(given.names, values.tolist(), strict=True)))
    for other in (again, steps.record, some):
        for name in other.names[len(scene.inputs) :]:
            size = np.abs(record[name]).max() + 1e-9
            np.testing.assert_allclose(other[name], record[name], rtol=0, atol=1e-8 * size, err_msg=name)
    found = {name: record[name] for name in scene.outputs}
    for left_out in (name for name in options if name != "method"):
        without = ran(**{name: value for name, value in options.items() if name != left_out})
        assert differs(found, {name: without[name] for name in scene.outputs}), left_out
