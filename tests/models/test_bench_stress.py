"""Rms von Mises stress of the bench under noise of the voltage and of the floor: linear model against 60 s of steps."""

from dataclasses import replace

import numpy as np
import pytest

from models.apa300ml import COARSE, PORTS, make_apa300ml
from models.bench import make_bench
from nassim import (
    StressAt,
    StressPoint,
    TimeHistory,
    build_fe_model,
    craig_bampton,
    frequency_response,
    linearize,
    simulate,
    von_mises,
    von_mises_budget,
)
from nassim.bodies.stress import COMPONENTS, VON_MISES_ROOT
from nassim.scene.stress_peaks import sensor_stress
from nassim.signals import multisine, spectral_noise

PLACES = (
    StressPoint("arm", (21.3e-3, 6.7e-3, 8.9e-3)),
    StressPoint("root", (35.31e-3, 1.7e-3, -6.3e-3)),
    StressPoint("stack", (7.3e-3, 1.3e-3, 2.1e-3), "actuator_stack_1"),
)
"""None lies in a plane of symmetry."""
NAMES = tuple(place.name for place in PLACES)
OUTPUTS = tuple(f"{name}.{component}" for name in NAMES for component in COMPONENTS)
STEP, DURATION, PERIOD, LOW, HIGH = 5e-5, 60.0, 15.0, 5.0, 1200.0
DENSITIES = {"actuator_voltage": 1e-4, "ground_acceleration": 3.6e-3}
"""Both matter; the first two modes lie in the band."""


@pytest.fixture(scope="module")
def stressed_apa():
    model = build_fe_model(
        make_apa300ml(ports=PORTS), element_size=COARSE["element_size"], order=COARSE["order"], progress=False
    )
    return craig_bampton(model, stress=PLACES, discretization=False, progress=False)


def noisy_bench(body, fidelity):
    bench = make_bench(apa=body, fidelity=fidelity, disturbances=True)
    actuators = tuple(part for part in bench.actuators if part.name != "push")
    sensors = (*bench.sensors, *(StressAt(name, f"apa.{name}") for name in NAMES))
    return replace(bench, actuators=actuators, sensors=sensors)


def mean_squares(record):
    return np.array([np.mean(von_mises(sensor_stress(record, name)) ** 2) for name in NAMES])


def exact_record(scene, excitation):
    return simulate(scene, excitation, time_step=STEP, method="exact", outputs=OUTPUTS, progress=False)


@pytest.fixture(scope="module")
def bench(stressed_apa):
    return noisy_bench(stressed_apa, "linear")


@pytest.fixture(scope="module")
def expected(bench):
    """Mean squares by the budget, (places, disturbances) [Pa^2]."""
    budget = von_mises_budget(linearize(bench), DENSITIES, np.linspace(LOW, HIGH, 1000), sensors=NAMES)
    assert budget.inputs == bench.inputs
    return budget.rms() ** 2


@pytest.mark.slow
def test_rms_under_noise_without_sampling_error_is_that_of_a_period(bench, expected):
    """Sines of random phases, thirty in the width of the first mode, have the spectrum itself: no chance is left."""
    for k, name in enumerate(bench.inputs):
        rms = np.sqrt(DENSITIES[name] * (HIGH - LOW))
        signal = multisine(
            PERIOD + 3.0, 1 / STEP, lowest_frequency=LOW, highest_frequency=HIGH, period=PERIOD, rms=rms, name=name
        )
        values = np.zeros((2, len(signal.time)))
        values[k] = signal[name]
        record = exact_record(bench, TimeHistory(signal.time, values, bench.inputs, ("V", "m/s2")))
        last = slice(-round(PERIOD / STEP), None)
        settled = replace(record, time=record.time[last], values=record.values[:, last])
        np.testing.assert_allclose(mean_squares(settled), expected[:, k], rtol=0.01)
    share = expected[:, 1] / expected.sum(axis=1)
    assert np.all((share > 0.2) & (share < 0.4))


@pytest.mark.slow
def test_rms_under_gaussian_noise_scatters_by_length_and_damping(bench, expected):
    """The variance of a mean square over T is the integral of |S(f)|^2 / T over the spectra of all components."""
    frequency = np.arange(round(LOW * DURATION), round(HIGH * DURATION) + 1) / DURATION
    model = linearize(bench)
    gains = frequency_response(model, frequency).values
    noise = spectral_noise(
        {name: lambda f, density=density: density + 0 * f for name, density in DENSITIES.items()},
        DURATION,
        1 / STEP,
        band=(LOW, HIGH),
        seed=3,
    )
    found = mean_squares(exact_record(bench, noise))
    for k, name in enumerate(NAMES):
        rows = [model.outputs.index(f"{name}.{component}") for component in COMPONENTS]
        spectra = np.zeros((len(frequency), 6, 6), dtype=complex)
        for j, density in enumerate(DENSITIES.values()):
            own = VON_MISES_ROOT @ gains[rows, j]
            spectra += density * np.einsum("if,jf->fij", own, own.conj())
        mean = expected[k].sum()
        scatter = 0.5 * np.sqrt(np.sum(np.abs(spectra) ** 2)) / DURATION / mean
        one_mode = 0.5 / np.sqrt(0.0101 * 2 * np.pi * 101.4 * DURATION)
        assert scatter == pytest.approx(one_mode, rel=0.15)  # 2.5 %
        assert abs(np.sqrt(found[k] / mean) - 1) < 2.5 * scatter


@pytest.mark.slow
def test_floating_frames_have_the_stress_of_exact_steps_under_noise(bench, stressed_apa):
    time = np.arange(1501) * STEP
    rng = np.random.default_rng(5)
    risen = np.minimum(time / 0.01, 1.0) ** 2
    phases, lines = rng.uniform(0, 2 * np.pi, (2, 60, 1)), np.linspace(20.0, HIGH, 60)[:, None]
    values = risen * np.cos(2 * np.pi * lines * time + phases).sum(axis=1) * [[0.05], [0.3]]
    noise = TimeHistory(time, values, bench.inputs, ("V", "m/s2"))
    exact = exact_record(bench, noise)
    floating = simulate(noisy_bench(stressed_apa, "ffrf"), noise, time_step=STEP, outputs=OUTPUTS, progress=False)
    for name in NAMES:
        a, b = (sensor_stress(record, name) for record in (exact, floating))
        assert von_mises(a - b).max() < 3e-3 * von_mises(a).max()
