"""Active damping from end to end: the damping that simulations show against the linear prediction; isolation."""

import warnings
from dataclasses import replace

import numpy as np
import pytest
import scipy.linalg
import scipy.signal
from exported_scenes import STEP, excited, hanging, record
from test_running_loops import DAMPING, MASS, STIFFNESS, oscillator

from models.bench import make_bench
from nassim import Loop, TimeHistory, frequency_response, linearize, simulate
from nassim.base.modal import decay_poles
from nassim.simulation.linear.closed_linearization import linearize_closed
from nassim.systems.controllers import integral_force_feedback, pid, proportional
from nassim.systems.linear_model import transmissibility, unstable_poles

RATE = 1e4


def looped(apa, gain, fidelity="linear", delay=1, **options):
    """The bench with integral force feedback at 10 kHz."""
    bench = replace(make_bench(apa=apa, fidelity=fidelity, damping_ratio=0.005), **options)
    controller = integral_force_feedback(gain, sample_rate=RATE, corner_frequency=2.0, delay=delay)
    return replace(bench, loops=(Loop("iff", controller, "sensor_voltage", "actuator_voltage"),))


def slowest(poles):
    """The oscillation below 300 Hz that decays slowest."""
    within = poles[(poles.imag > 0) & (np.abs(poles) < 2 * np.pi * 300)]
    pole = within[np.argmax(within.real)]
    return abs(pole) / (2 * np.pi), -pole.real / abs(pole)


def by_python_control(apa, gain):
    """Poles of the loop put together by python-control: the plant held, the formula by Tustin's rule, a sample late."""
    control = pytest.importorskip("control")
    model, period = linearize(make_bench(apa=apa, fidelity="linear", damping_ratio=0.005)), 1 / RATE
    row, column = model.outputs.index("sensor_voltage"), model.inputs.index("actuator_voltage")
    # Displacements by millions of rad/s: SciPy's exponential wants the states balanced.
    a, scale = scipy.linalg.matrix_balance(model.A, permute=False, separate=True)
    b, c = model.B[:, [column]] / scale[0][:, None], model.C[[row]] * scale[0]
    plant = control.ss(
        *scipy.signal.cont2discrete((a, b, c, model.D[[row]][:, [column]]), period, method="zoh")[:4], period
    )
    formula = control.sample_system(control.tf([-gain], [1, 2 * np.pi * 2.0]), period, method="bilinear")
    closed = control.feedback(plant, control.ss(formula) * control.ss(control.tf([1], [1, 0], period)), sign=+1)
    return np.log(closed.poles().astype(complex)) / period


def pulse(duration, time_step):
    time = np.arange(round(duration / time_step) + 1) * time_step
    return TimeHistory(time, 0.1 * np.exp(-(((time - 0.01) / 0.002) ** 2)), ("actuator_voltage",), ("V",))


def simulated(scene, method, time_step):
    record = simulate(scene, pulse(0.2, time_step), time_step=time_step, method=method, progress=False).after(0.02)
    stride = round(5e-4 / time_step)
    return slowest(decay_poles(record.values[1:3, ::stride], stride * time_step, n_poles=16))


@pytest.mark.parametrize("gain", [5.0, 180.0])
def test_damping_in_the_time_simulation(apa, gain):
    """Sampled at 10 kHz with one sample of delay: by exact steps, as predicted, at damping ratios of 2 to 50 %.

    Predicted twice: by the closed linear model, and by python-control, which shares neither its loop nor its sampling;
    with all modes. Where those beyond the reduction are quasi-static, prediction and run go together as well, and
    differ from those with all modes by little.
    """
    scene = looped(apa, gain, quasi_static_above=np.inf)
    frequency, ratio = slowest(linearize_closed(scene).poles())
    elsewhere = slowest(by_python_control(apa, gain))
    assert (frequency, ratio) == (pytest.approx(elsewhere[0], rel=1e-6), pytest.approx(elsewhere[1], rel=1e-5))
    found = simulated(scene, "exact", 1e-4)
    assert found[1] == pytest.approx(ratio, rel=1e-4)
    assert found[0] == pytest.approx(frequency, rel=1e-5)
    usual = looped(apa, gain)
    predicted, found = slowest(linearize_closed(usual).poles()), simulated(usual, "exact", 1e-4)
    assert found == (pytest.approx(predicted[0], rel=1e-5), pytest.approx(predicted[1], rel=1e-4))
    assert predicted == (pytest.approx(frequency, rel=4e-3), pytest.approx(ratio, rel=4e-3))


@pytest.mark.parametrize(("fidelity", "gain"), [("linear", 100.0), ("ffrf", 50.0)])
def test_damping_in_exudyn(apa, fidelity, gain):
    """By generalized-alpha with a quarter of the sample period: within 0.2 %, where 2 % is required."""
    scene = looped(apa, gain, fidelity)
    _, ratio = slowest(linearize_closed(scene).poles())
    assert simulated(scene, "generalized_alpha", 2.5e-5)[1] == pytest.approx(ratio, rel=0.002)


@pytest.mark.parametrize("fidelity", ["linear", "ffrf"])
def test_damping_of_the_bench_with_ports_in_exudyn(apa_with_ports, fidelity):
    """One step a sample, trimmed: else modes near multiples of the sample rate, which the integrator moves, fold in."""
    bench = make_bench(apa=apa_with_ports, fidelity=fidelity, resistance=np.inf, cutoff_frequency=1500.0)
    controller = integral_force_feedback(80.0, sample_rate=RATE, corner_frequency=2.0)
    scene = replace(bench, loops=(Loop("iff", controller, "sensor_voltage", "actuator_voltage"),))
    _, ratio = slowest(linearize_closed(scene).poles())
    assert ratio > 0.2
    assert simulated(scene, "generalized_alpha", 1e-4)[1] == pytest.approx(ratio, rel=0.005)


def test_damping_grows_with_the_gain_and_needs_the_delay(apa):
    ratios = [slowest(linearize_closed(looped(apa, gain)).poles())[1] for gain in (5.0, 20.0, 50.0, 100.0)]
    assert ratios == sorted(ratios)
    ideal = slowest(linearize_closed(looped(apa, 100.0), continuous=True, delay_order=0).poles())[1]
    continuous = slowest(linearize_closed(looped(apa, 100.0), continuous=True).poles())[1]
    assert continuous == pytest.approx(ratios[-1], rel=0.01)
    assert ideal < 0.98 * ratios[-1], "the delay counts, so the test above is not one of continuous time"


@pytest.mark.parametrize(("gain", "delay"), [(-20.0, 1), (150.0, 40)])
def test_instability_is_predicted_and_stops_the_run(apa, gain, delay):
    """Wrong sign; 4 ms of delay."""
    scene = looped(apa, gain, delay=delay)
    worst = unstable_poles(linearize_closed(scene))
    assert worst
    assert max(pole.growth_rate for pole in worst) > 1.0
    with pytest.raises(RuntimeError, match=r"runs away: at t = .* has grown to"):
        simulate(scene, pulse(2.0, 1e-4), time_step=1e-4, method="exact", progress=False)
    assert not unstable_poles(linearize_closed(looped(apa, 20.0)))


def test_transmissibility_in_closed_form():
    """A mass on a spring and damper: (c s + k) / (m s^2 + c s + k)."""
    frequency = np.geomspace(1, 500, 50)
    s = 2j * np.pi * frequency
    scene = replace(oscillator(), damping_ratio=0.0)
    found = transmissibility(frequency_response(linearize(scene), frequency), output="position", ground="acceleration")
    expected = (DAMPING * s + STIFFNESS) / (MASS * s**2 + DAMPING * s + STIFFNESS)
    assert np.allclose(found.response("absolute motion", "ground"), expected, rtol=1e-8)


def test_scenes_without_loops_or_with_several_rates(apa):
    with pytest.raises(ValueError, match="has no loops"):
        linearize_closed(make_bench(apa=apa, fidelity="linear"))
    scene = looped(apa, 10.0)
    slower = Loop("slow", integral_force_feedback(1.0, sample_rate=6e3), "sensor_voltage", "actuator_voltage")
    both = replace(scene, loops=(*scene.loops, slower))
    with pytest.raises(ValueError, match="sample at 10000, 6000 Hz, which are not multiples of each other"):
        linearize_closed(both)
    assert len(linearize_closed(both, continuous=True).A) > len(linearize(scene).A)


def test_a_closed_loop_of_two_rates_is_that_of_a_run():
    """The faster loop acts between the model's samples, on a mass that pulls at that of the slower one."""
    fast = pid(1e5, kd=300.0, sample_rate=1 / STEP, derivative_bandwidth=800.0)
    slow = pid(4e4, ki=1e6, kd=80.0, sample_rate=0.25 / STEP, derivative_bandwidth=300.0, delay=0)
    loops = [
        Loop("gap", slow, "tower/gap", "2nd force", noise="hiss"),
        Loop("way", fast, "tower/way", "force", reference="set", noise="hum"),
    ]
    scene = replace(hanging(), gravity=np.zeros(3), loops=loops)
    closed = linearize_closed(scene)
    assert closed.time_step == pytest.approx(4 * STEP)
    held = excited(scene, 600)[:, ::4]
    run = dict(zip(scene.outputs, record(scene, np.repeat(held, 4, axis=1), 0)[:, ::4], strict=False))
    given = held[[scene.inputs.index(name) for name in closed.inputs]]
    _, found, _ = scipy.signal.dlsim((*closed.matrices, closed.time_step), given.T)
    for name, row in zip(closed.outputs, found.T, strict=True):
        np.testing.assert_allclose(row, run[name], atol=1e-9 * np.abs(run[name]).max())


def test_what_folds_at_the_slower_of_two_loops_is_quasi_static_as_in_a_run():
    """A mode of 93 Hz; the controllers, of 125 Hz and 5 kHz, are silent, so that the plants are compared.

    A loud one of 5 kHz alone would show the mode; beside a slower one, it is told.
    """
    loops = [Loop(f"silent {n}", proportional(0.0, sample_rate=1 / (n * STEP)), "tower/way", "force") for n in (40, 1)]
    scene = replace(hanging(), gravity=np.zeros(3), loops=loops, quasi_static_above=50.0)
    closed, held = linearize_closed(scene), excited(scene, 2000)[:, ::40]
    found = scipy.signal.dlsim((*closed.matrices, closed.time_step), held.T)[1].T
    run = record(scene, np.repeat(held, 40, axis=1), 0)[: len(found), ::40]
    size = np.abs(run).max(axis=1, keepdims=True)
    np.testing.assert_allclose(found / size, run / size, atol=1e-9)
    loud = Loop("loud", proportional(-1e7, sample_rate=1 / STEP), "tower/gap", "2nd force")
    with pytest.warns(UserWarning, match="loop 'loud' may be unstable on modes that are quasi-static .* at 92.9. "):
        linearize_closed(replace(scene, loops=[loops[0], loud]))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        linearize_closed(replace(scene, loops=[loud]))


def test_poles_of_a_decay():
    time = np.arange(400) * 1e-3
    poles = np.array([-3 + 200j, -40 + 600j, -25.0])
    signals = [np.real(np.exp(np.outer(poles, time)).T @ weights) for weights in ([1, 0.3, 2], [0.5j, 1, -1])]
    found = decay_poles(np.array(signals), 1e-3, n_poles=12)
    assert len(found) == 5
    for pole in poles:
        assert np.abs(found - pole).min() < 1e-6 * abs(pole)
    with pytest.raises(ValueError, match="need at least 1600 samples, got 400"):
        decay_poles(np.array(signals), 1e-3, n_poles=400)
