"""Norms of linear models against closed forms, dense frequencies and impulse responses."""

import math
from dataclasses import replace

import numpy as np
import pytest

from nassim.systems import LinearModel, frequency_response, h2_norm, hinf_norm, sampled, subsystem

OMEGA, RATIO = 2 * np.pi * 37.0, 0.03


def oscillator(gain=1.0):
    """Displacement and velocity of a mass on a damped spring, over a force."""
    a = [[0.0, 1.0], [-(OMEGA**2), -2 * RATIO * OMEGA]]
    return LinearModel(a, [[0.0], [gain]], np.eye(2), np.zeros((2, 1)), ("force",), ("x", "v"))


def anything(seed, time_step=None, feedthrough=True):
    """A stable model with three inputs and two outputs."""
    rng = np.random.default_rng(seed)
    a = rng.normal(size=(6, 6))
    a = a / (1.05 * np.abs(np.linalg.eigvals(a)).max()) if time_step else 40 * (a - 3 * np.eye(6))
    d = rng.normal(size=(2, 3)) if feedthrough else np.zeros((2, 3))
    args = rng.normal(size=(6, 3)), rng.normal(size=(2, 6)), d
    return LinearModel(a, *args, ("a", "b", "c"), ("y", "z"), time_step=time_step)


def test_an_oscillator_has_the_norms_of_textbooks():
    model = oscillator(3.0)
    assert h2_norm(model, outputs="x") == pytest.approx(3.0 / math.sqrt(4 * RATIO * OMEGA**3))
    assert h2_norm(model, outputs="v") == pytest.approx(3.0 / math.sqrt(4 * RATIO * OMEGA))
    peak, frequency = hinf_norm(model, outputs="x", tolerance=1e-10)
    assert peak == pytest.approx(3.0 / (2 * RATIO * math.sqrt(1 - RATIO**2) * OMEGA**2), rel=1e-9)
    assert frequency == pytest.approx(37.0 * math.sqrt(1 - 2 * RATIO**2), rel=1e-4)


def test_units_of_states_do_not_matter_to_the_response_to_noise():
    """Four modes from 0.3 Hz to 3 kHz, each with an input and an output, of displacement and velocity in any units."""
    omega, ratio = 2 * np.pi * np.array([0.3, 8.0, 150.0, 3e3]), np.array([1e-4, 1e-3, 1e-2, 1e-3])
    a, b, c = np.zeros((8, 8)), np.eye(8)[:, 1::2], np.eye(8)[::2]
    a[::2, 1::2], a[1::2, ::2], a[1::2, 1::2] = np.eye(4), -np.diag(omega**2), -np.diag(2 * ratio * omega)
    units = 2.0 ** np.random.default_rng(0).integers(-9, 10, 8)
    for scale in (np.ones(8), units):
        args = a * scale / scale[:, None], b / scale[:, None], c * scale / omega[:, None] ** -1.5, np.zeros((4, 4))
        model = LinearModel(*args, tuple("abcd"), tuple("wxyz"))
        assert h2_norm(model) == pytest.approx(math.sqrt(np.sum(1 / (4 * ratio))), rel=1e-6)


@pytest.mark.parametrize("time_step", [None, 2e-3])
@pytest.mark.parametrize("seed", range(2))
def test_the_largest_gain_is_that_of_dense_frequencies(seed, time_step):
    model = anything(seed, time_step)
    peak, where = hinf_norm(model, tolerance=1e-9)
    dense = np.linspace(0, 250.0, 40_001) if time_step else np.append(0.0, np.geomspace(1e-2, 1e6, 40_000))
    values = frequency_response(model, np.unique(np.append(dense, min(where, dense[-1])))).values
    gains = np.linalg.svd(values.transpose(2, 0, 1), compute_uv=False)[:, 0]
    assert gains.max() == pytest.approx(peak, rel=1e-6)
    if where < math.inf:
        assert np.linalg.norm(frequency_response(model, [where]).values[:, :, 0], 2) == pytest.approx(peak, rel=1e-6)
    part, _ = hinf_norm(model, inputs=["c", "a"], outputs="z")
    assert part == pytest.approx(np.linalg.norm(values[1, [0, 2]], axis=0).max(), rel=1e-5)


def test_white_noise_through_a_sampled_model_is_the_sum_of_its_impulse_response():
    model = anything(1, 1e-3)
    state, total = model.B, np.sum(model.D**2)
    for _ in range(600):
        total += np.sum((model.C @ state) ** 2)
        state = model.A @ state
    assert h2_norm(model) == pytest.approx(math.sqrt(total))


def test_slow_coupled_states_of_a_sampled_model_keep_their_digits():
    """Two slow states and a fast one in coordinates that mix them: sums of products of modes, which do not."""
    z, b, c = np.array([1 - 1e-4, 1 - 2e-3, 0.4]), np.array([1.0, -2.0, 0.5]), np.array([3.0, 1.0, -1.0])
    mixed = np.array([[1.0, 1, 1], [1, 1 + 2.0**-8, 1], [1, 1, 1 + 2.0**-8]])
    back = np.linalg.inv(mixed)
    model = LinearModel(
        mixed @ np.diag(z) @ back, (mixed @ b)[:, None], (c @ back)[None], [[0.25]], ("u",), ("y",), time_step=1e-3
    )
    exact = 0.25**2 + np.sum(np.outer(b * c, b * c) / (1 - np.outer(z, z)))
    assert h2_norm(model) == pytest.approx(math.sqrt(exact), rel=1e-4)
    gain = LinearModel(np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), [[3.0]], ("u",), ("y",), time_step=1.0)
    assert h2_norm(gain) == 3.0


def test_parts_and_tolerances_of_norms():
    model = anything(2, feedthrough=False)
    part = LinearModel(model.A, model.B[:, [2, 0]], model.C[1:], [[0.0, 0.0]], ("c", "a"), ("z",))
    assert h2_norm(model, inputs=["c", "a"], outputs="z") == pytest.approx(h2_norm(part))
    found = subsystem(replace(model, units=("m", "V")), inputs=["c", "a"], outputs="z")
    assert (found.inputs, found.outputs, found.units) == (("c", "a"), ("z",), ("V",))
    assert np.array_equal(found.B, part.B)
    assert np.array_equal(found.C, part.C)
    tops = [[hinf_norm(anything(seed), tolerance=t)[0] for seed in range(6)] for t in (0.5, 1e-9)]
    ratios = np.divide(*tops)
    assert ratios.max() <= 1
    assert 1 / 1.5 < ratios.min() < 1 - 1e-6


def test_norms_without_a_finite_value():
    falling = LinearModel([[1.0]], [[1.0]], [[1.0]], [[0.0]], ("u",), ("y",))
    assert hinf_norm(falling)[0] == h2_norm(falling) == math.inf
    free = LinearModel([[0, 1], [0, 0]], [[0], [1]], [[1, 0]], [[0]], ("u",), ("y",))
    assert hinf_norm(free)[0] == h2_norm(sampled(free, 1e3)) == math.inf
    mixed = np.random.default_rng(3).normal(size=(3, 3))
    for poles, time_step in (([0.0, -1.0, -2.0], None), ([1.0, 0.5, 0.2], 0.1)):  # an integrator, within rounding
        state = mixed @ np.diag(poles) @ np.linalg.inv(mixed)
        summing = LinearModel(state, np.ones((3, 1)), np.ones((1, 3)), [[0.0]], ("u",), ("y",), time_step=time_step)
        assert hinf_norm(summing)[0] == h2_norm(summing) == math.inf
    assert h2_norm(anything(0)) == math.inf
    assert math.isfinite(h2_norm(anything(0, feedthrough=False)))
    wire = LinearModel(np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), [[-3.0]], ("u",), ("y",))
    assert hinf_norm(wire) == (3.0, math.inf)
    change = LinearModel([[0.0]], [[1.0]], [[-1.0]], [[1.0]], ("u",), ("y",), time_step=1e-3)  # |1 - 1/z|, 2 at z = -1
    assert hinf_norm(change) == pytest.approx((2.0, 500.0))
    assert hinf_norm(replace(anything(0, feedthrough=False), B=np.zeros((len(anything(0).A), 3))))[0] == 0.0
    assert hinf_norm(anything(0), inputs=[]) == (0.0, math.inf)
    assert h2_norm(anything(0), inputs=[]) == 0.0
    with pytest.raises(ValueError, match="unknown input 'd'; known: a, b, c"):
        hinf_norm(anything(0), inputs="d")
