"""Force feedback on a hexapod that spins: unstable, and stabilised, as predicted, in runs of bodies that turn."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import least_squares

from models.hexapods import DEFAULT_PLATFORM
from models.nano_hexapod import make_nano_hexapod, rigid_plate
from models.strut import controller_in_line, sensors_in_line, spring_strut
from nassim import Loop, TimeHistory, linearize, simulate
from nassim.kinematics import strut_lengths
from nassim.simulation import linearize_closed
from nassim.systems import close_loop, decentralised, integral_force_feedback, sampled

STIFFNESS, GAIN, RATE = 1.846e6, 100.0, 500.0
SENSORS, ACTUATORS = ([f"strut_{k}/{name}_force" for k in range(1, 7)] for name in ("sensor", "actuator"))


def published(share):
    """Case of 50 kg on springs without mass at 60 rpm; share: of their stiffness beside the sensors."""
    length = float(strut_lengths(DEFAULT_PLATFORM)[0])
    strut = spring_strut((1 - share) * STIFFNESS, parallel_stiffness=share * STIFFNESS, length=length)
    return make_nano_hexapod(
        strut,
        platform=DEFAULT_PLATFORM,
        plate=rigid_plate(DEFAULT_PLATFORM, mass=1.0, radius=0.1, height=0.01),
        payload_mass=50.0,
        payload_centre=(0, 0, 0.2),
        payload_inertia=np.eye(3),
        spindle_rpm=60.0,
    )


def with_loops(scene, controller):
    each = controller_in_line(controller)
    pairs = zip(SENSORS, ACTUATORS, strict=True)
    return replace(scene, loops=tuple(Loop(f"iff_{k}", each, y, u) for k, (y, u) in enumerate(pairs)))


def feedback(leak=0.0):
    return integral_force_feedback(-GAIN, sample_rate=RATE, corner_frequency=leak)


def slow(poles):
    """Where the integrators go, one of the pair."""
    found = poles[(np.abs(poles) < 2 * np.pi) & (poles.imag >= 0)]
    return found[np.argmax(found.real)]


def test_a_controller_in_line_is_one_of_a_sensor_in_line():
    scene = published(0.0)
    found = linearize_closed(with_loops(scene, feedback(1.0))).poles()
    model = sampled(sensors_in_line(linearize(scene)), RATE)
    expected = close_loop(model, decentralised(*[feedback(1.0)] * 6), measured=SENSORS, driven=ACTUATORS).poles()
    apart = np.abs(found[:, None] - expected[np.abs(expected) < 1e4]).min(axis=0)
    assert len(apart) >= 18
    assert apart.max() < 1e-6
    with pytest.raises(ValueError, match="delay of 1 sample here, got 2"):
        controller_in_line(replace(feedback(), delay=2))


@pytest.mark.parametrize(
    ("share", "leak", "published_growth"),
    [
        pytest.param(0.0, 0.0, 0.552, id="pure"),
        pytest.param(0.0, 1.0, None, id="leaky", marks=pytest.mark.slow),
        pytest.param(0.05, 0.0, None, id="parallel stiffness", marks=pytest.mark.slow),
    ],
)
def test_growth_and_decay_in_time(share, leak, published_growth):
    """The slow motion after a push, once all others have died out, as one exponential with its turn."""
    scene = with_loops(published(share), feedback(leak))
    pole = slow(linearize_closed(scene).poles())
    assert (pole.real > 0) == (not share and not leak)
    if published_growth:
        assert pole.real == pytest.approx(published_growth, rel=0.1)  # without the loops' delay
    time = np.arange(501) / RATE
    push = np.array([[1.0], [0.3]]) * np.sin(np.pi * np.minimum(time / 0.1, 1.0)) ** 2
    quiet = [name for name in scene.inputs if name.startswith("payload") and name[-7:] not in ("force_x", "force_y")]
    names = ("payload_force_x", "payload_force_y", *quiet)
    values = np.vstack([push, np.zeros((len(quiet), len(time)))])
    forces = TimeHistory(time, values, names, tuple(map(scene.input_unit, names)))
    record = simulate(scene, forces, time_step=1 / RATE, progress=False).after(0.4)
    moved = record.select(["pose.ux", "pose.uy"]).values.T
    moved = moved / np.abs(moved).max(axis=0)

    def left(law):
        waves = np.exp((law[0] + 1j * law[1]) * (record.time - record.time[0]))
        waves = np.column_stack([waves.real, waves.imag, np.ones(len(waves))])  # a drift along z hardly moves
        return (waves @ np.linalg.lstsq(waves, moved, rcond=None)[0] - moved).ravel()

    fit = least_squares(left, [pole.real + 0.2, pole.imag + 0.1])
    assert np.abs(fit.fun).max() < 0.02
    assert fit.x[0] == pytest.approx(pole.real, rel=0.03)
