"""Models connected by names, and weighting filters."""

import numpy as np
import pytest

from nassim.systems import LinearModel, frequency_response, interconnect, sampled, static_gain, weighting_filter

FREQUENCY = np.array([0.3, 4.0, 71.0])


def random_model(seed, inputs, outputs, states=3, units=()):
    rng = np.random.default_rng(seed)
    shapes = ((states, states), (states, len(inputs)), (len(outputs), states), (len(outputs), len(inputs)))
    return LinearModel(*(rng.normal(size=shape) for shape in shapes), inputs, outputs, units)


def values(model, outputs, inputs):
    frf = frequency_response(model, FREQUENCY)
    return np.array([[frf.response(y, u) for u in inputs] for y in outputs]).transpose(2, 0, 1)


def test_a_loop_of_two_models_is_that_of_their_responses():
    """y = G (w + u) + G_d d and u = K y, with a disturbance d that both models see."""
    plant = random_model(1, ("u", "d"), ("y1", "y2"), units=("m", "V"))
    controller = random_model(2, ("y2", "d", "y1"), ("u",))
    joined = interconnect(plant, controller, inputs=["d", "u"], outputs=["y2", "u", "y1"])
    assert joined.units == ("V", "", "m")
    g, gd = values(plant, ("y1", "y2"), ("u",)), values(plant, ("y1", "y2"), ("d",))
    k, kd = values(controller, ("u",), ("y1", "y2")), values(controller, ("u",), ("d",))
    y = np.linalg.solve(np.eye(2) - g @ k, np.concatenate([g @ kd + gd, g], axis=2))
    u = k @ y + np.concatenate([kd, np.zeros_like(kd)], axis=2)
    assert values(joined, ("y1", "y2", "u"), ("d", "u")) == pytest.approx(np.concatenate([y, u], axis=1))


def test_sums_and_unconnected_inputs():
    mix = static_gain([[1.0, -2.0]], inputs=("a", "b"), outputs="sum")
    plant = random_model(3, ("sum", "other"), ("y",))
    joined = interconnect(plant, mix, inputs=("a", "b"), outputs=("y", "sum"))
    direct = values(plant, ("y",), ("sum",))
    assert values(joined, ("y",), ("a", "b")) == pytest.approx(np.concatenate([direct, -2 * direct], axis=2))
    assert values(joined, ("sum",), ("a", "b")) == pytest.approx(np.tile([[[1.0, -2.0]]], (3, 1, 1)))


def test_modes_that_a_model_does_not_support_stay_so():
    """They become quasi-static when the connected model is sampled: a mode of 900 Hz, behind a sensor's low-pass."""
    w = 2 * np.pi * np.array([20.0, 900.0])
    state = np.array([[0, 1, 0, 0], [-(w[0] ** 2), -2, 0, 0], [0, 0, 0, 1], [0, 0, -(w[1] ** 2), -90]])
    drive, read = np.array([[0.0], [1], [0], [1]]), np.array([[1.0, 0, 3, 0]])
    modes = LinearModel(state, drive, read, [[0.0]], ("F",), ("x",), unsupported=[0, 0, 900, 900])
    sensor = LinearModel([[-30.0]], [[30.0]], [[1.0]], [[0.0]], ("x",), ("y",))
    joined = interconnect(sensor, modes, inputs="F", outputs=("y", "x"))
    assert joined.unsupported.tolist() == [0, 0, 0, 900, 900]
    at = np.array([3.0, 100.0])
    directly, through = (frequency_response(sampled(m, 1e3), at).response("x", "F") for m in (modes, joined))
    np.testing.assert_allclose(through, directly, rtol=1e-9)


def test_a_sum_connects_to_sampled_models():
    """2 / (z - 0.5) behind a gain of 3; a sum alone has no time step."""
    plant = LinearModel([[0.5]], [[1]], [[2]], [[0]], ("u",), ("y",), time_step=0.1)
    joined = interconnect(static_gain([[3.0]], inputs="w", outputs="u"), plant, inputs="w", outputs="y")
    assert joined.time_step == 0.1
    z = np.exp(2j * np.pi * 0.1 * 4.0)
    assert frequency_response(joined, [4.0]).values.item() == pytest.approx(6 / (z - 0.5))
    assert interconnect(static_gain([[3.0]], inputs="w", outputs="u"), inputs="w", outputs="u").time_step is None
    with pytest.raises(ValueError, match="one time step"):  # a sampled gain is not that of a continuous model
        interconnect(plant, LinearModel([[-1]], [[1]], [[2]], [[0]], ("v",), ("x",)), inputs="u", outputs="y")


@pytest.mark.parametrize(
    ("models", "options", "message"),
    [
        ((), {}, "at least one model"),
        ((static_gain([[1.0]], inputs="y", outputs="y"),), {}, "direct feedthrough around a loop is 1"),
        ((random_model(0, ("u",), ("y",)),), {"inputs": "v"}, "unknown input 'v'; known: u"),
        ((random_model(0, ("u",), ("y",)),), {"outputs": "v"}, "unknown output 'v'; known: y"),
        (
            (random_model(0, ("u",), ("y",)), random_model(1, ("v",), ("y",))),
            {},
            "output names must differ; used more than once: y",
        ),
        (
            (random_model(0, ("u",), ("y",)), LinearModel([[0.5]], [[1]], [[1]], [[0]], ("v",), ("z",), time_step=0.1)),
            {},
            r"one time step, got \['0.1', 'None'\]",
        ),
    ],
)
def test_what_cannot_be_connected(models, options, message):
    with pytest.raises(ValueError, match=message):
        interconnect(*models, **{"inputs": (), "outputs": (), **options})


@pytest.mark.parametrize(
    ("low", "high", "gain", "order"), [(0.1, 1000.0, 0.5, 2), (80.0, 0.02, 1.0, 3), (1e-3, 2.0, 1, 1)]
)
def test_a_weight_has_its_three_gains_and_its_slope(low, high, gain, order):
    weight = weighting_filter(13.0, low=low, high=high, gain=gain, order=order, name="w")
    assert (weight.inputs, weight.outputs) == (("w",), ("weighted w",))
    assert len(weight.A) == order
    found = np.abs(frequency_response(weight, np.array([1e-7, 13.0, 1e9])).values[0, 0])
    assert found == pytest.approx([low, gain, high], rel=1e-6)
    steep = weighting_filter(13.0, low=1e-9, high=1e9, order=order)
    slope = np.abs(frequency_response(steep, np.array([6.5, 26.0])).values[0, 0])
    assert slope[1] / slope[0] == pytest.approx(4.0**order, rel=1e-3)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"low": 2.0, "high": 3.0}, "gain must lie between low and high, got low 2, gain 1, high 3"),
        ({"low": 0.1, "high": 3.0, "order": 0}, "order must be a whole number of at least 1, got 0"),
        ({"low": 0.1, "high": 3.0, "order": 1.5}, "order must be a whole number"),
        ({"low": 0.0, "high": 3.0}, "low"),
    ],
)
def test_weights_that_cannot_be(options, message):
    with pytest.raises(ValueError, match=message):
        weighting_filter(10.0, **options)
