"""Published figures of the rotating platform, m = k = 1, c = 0.05, from the public model."""

import numpy as np
import pytest

from models.rotating_platform import make_rotating_platform, platform_model
from nassim import TimeHistory, simulate
from nassim.base.modal import decay_poles
from nassim.systems import (
    decentralised,
    integral_force_feedback,
    largest_stable_gain,
    optimum_gain,
    unstable_poles,
    zeros,
)

SENSORS, FORCES = ("u/sensor_force", "v/sensor_force"), ("u/actuator_force", "v/actuator_force")
WIRES = {"measured": SENSORS, "driven": FORCES, "delay_order": 0}


def feedback(leak=0.0, gain=1.0, rate=1e3):
    one = integral_force_feedback(gain, sample_rate=rate, corner_frequency=leak / (2 * np.pi))
    return decentralised(one, one)


@pytest.mark.parametrize(
    ("speed", "expected"),
    [
        (0.1, (-0.027501 + 1.099691j, -0.022499 + 0.899691j)),
        (0.7, (-0.042503 + 1.699841j, -0.007497 + 0.299841j)),
        (1.1, (0.002498 + 0.099934j,)),
    ],
)
def test_poles(speed, expected):
    model = platform_model(speed)
    for pole in expected:
        assert np.abs(model.poles() - pole).min() < 1e-6
    assert bool(unstable_poles(model)) == (speed > 1)


def test_zeros_of_one_loop_and_of_both():
    """One of them on the right; with stiffness in parallel, of both loops +-j (sqrt(kp / m) +- W)."""
    one = zeros(platform_model(0.1), inputs=FORCES[:1], outputs=SENSORS[:1])
    for zero in (-0.025009 + 1.014392j, 0.098067, -0.098048):
        assert np.abs(one - zero).min() < 1e-6
    both = zeros(platform_model(0.1, parallel_share=0.25), inputs=FORCES, outputs=SENSORS)
    for zero in (0.4j, 0.6j):
        assert np.abs(both - zero).min() < 1e-6


def test_static_gain():
    model = platform_model(0.1)
    gain = model.D - model.C @ np.linalg.solve(model.A, model.B)
    place = model.outputs.index("u/sensor_force"), model.inputs.index("u/actuator_force")
    assert abs(gain[place]) == pytest.approx(0.1**2 / (1 - 0.1**2), rel=1e-6)


def test_gains_of_leaky_and_pure_integrators():
    """A limit of 9.9 with the leak; the largest common damping of both."""
    gains = np.concatenate([[0.0], np.geomspace(0.1, 20.0, 60)])
    assert largest_stable_gain(platform_model(0.1), feedback(0.1), gains, **WIRES) == pytest.approx(9.9, rel=1e-5)
    frequency = np.array([0.9, 1.1]) / (2 * np.pi)
    for leak, share, damping_ratio, gain in ((0.1, 0.0, 0.829, 1.99), (0.0, 0.05, 0.825, 2.02)):
        found = optimum_gain(
            platform_model(0.1, parallel_share=share), feedback(leak), gains[gains < 9], **WIRES, frequency=frequency
        )
        assert found.damping_ratio == pytest.approx(damping_ratio, abs=5e-4)
        assert found.gain == pytest.approx(gain, abs=5e-3)


@pytest.mark.slow
def test_the_platform_in_time():
    """A kick, and the poles of what follows, to 1 %."""
    step = 0.02
    time = step * np.arange(1001)
    kick = TimeHistory(time, np.array([time < 3 * step, 0 * time]) * 1e-3, FORCES, ("N", "N"))
    run = simulate(make_rotating_platform(0.7), kick, time_step=step, progress=False)
    poles = decay_poles(np.array([run["u/encoder"], run["v/encoder"]])[:, 10::5], 5 * step, n_poles=8)
    for pole in (-0.042503 + 1.699841j, -0.007497 + 0.299841j):
        assert np.abs(poles - pole).min() < 0.01 * abs(pole)


def test_not_all_stiffness_is_beside_the_sensors():
    make_rotating_platform(0.1, parallel_share=0.9)
    for share in (1.1, -0.1):
        with pytest.raises(ValueError, match="parallel_share must be at least 0 and below 1"):
            make_rotating_platform(0.1, parallel_share=share)
