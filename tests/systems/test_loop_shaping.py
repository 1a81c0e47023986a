"""Controllers made for a crossover: what was asked for, read from the loop around the plant by other routes."""

import numpy as np
import pytest
import scipy.signal
from test_feedback import one_mode, two_modes

from nassim.systems.controllers import controller_response, proportional
from nassim.systems.feedback import close_loop, open_loop
from nassim.systems.linear_model import LinearModel, sampled, unstable_poles
from nassim.systems.loop_shaping import crossover_controller
from nassim.systems.stability_margins import margins

RATE = 10e3
MASS = 3.0
WIRES = {"measured": "x", "driven": "force"}


def free_mass(sign=1.0):
    """A mass, its force and its position; sign: of the sensor."""
    drives = [[0.0], [1 / MASS]]
    return LinearModel([[0.0, 1.0], [0.0, 0.0]], drives, [[sign, 0.0]], np.zeros((1, 1)), ("force",), ("x",), ("m",))


def damped_stage(frequency=30.0, ratio=0.3):
    omega = 2 * np.pi * frequency
    state = [[0.0, 1.0], [-(omega**2), -2 * ratio * omega]]
    return LinearModel(state, [[0.0], [1 / MASS]], [[1.0, 0.0]], np.zeros((1, 1)), ("force",), ("x",), ("m",))


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize(
    ("integral", "low_pass", "delay", "phase_margin"),
    [(0.0, 0.0, 1, 40.0), (12.0, 1200.0, 2, 30.0), (8.0, 0.0, 0, 60.0)],
)
def test_crossover_and_phase_margin_are_those_asked_for(sign, integral, low_pass, delay, phase_margin):
    """L by hand: 1 / (m s^2), the hold, the delay and the controller run as difference equation."""
    for model in (free_mass(sign), sampled(free_mass(sign), RATE)):
        controller = crossover_controller(
            model, **WIRES, frequency=120.0, phase_margin=phase_margin, sample_rate=RATE,
            integral_frequency=integral, low_pass_frequency=low_pass, delay=delay, limit=9.0,
        )  # fmt: skip
        assert (controller.delay, controller.limit, controller.sample_rate) == (delay, 9.0, RATE)
        frequency = np.array([120.0])
        system = scipy.signal.dlti(*controller.matrices, dt=1 / RATE)
        k = scipy.signal.dfreqresp(system, 2 * np.pi * frequency / RATE)[1]
        s = 2j * np.pi * frequency
        plant = sign / (MASS * s**2) * (1 - np.exp(-s / RATE)) / (s / RATE)
        loop = (-k * plant * np.exp(-s * delay / RATE))[0]
        assert abs(loop) == pytest.approx(1.0, rel=2e-3), "aliases aside"
        assert np.degrees(np.angle(-loop)) == pytest.approx(phase_margin, abs=0.1)
        found = margins(open_loop(model, controller, np.geomspace(20.0, 900.0, 4000), **WIRES))
        assert found.phase_margin == pytest.approx(phase_margin, abs=0.02)
        assert found.phase_margin_frequency == pytest.approx(120.0, rel=1e-4)
        assert not unstable_poles(close_loop(sampled(free_mass(sign), RATE), controller, **WIRES))


def test_integral_and_low_pass_are_where_asked():
    """Without them by hand, what remains is a lead."""
    plain, shaped = (
        crossover_controller(
            damped_stage(), **WIRES, frequency=100.0, phase_margin=50.0, sample_rate=RATE,
            integral_frequency=i, low_pass_frequency=p,
        )
        for i, p in ((0.0, 0.0), (9.0, 1e3))
    )  # fmt: skip
    low = np.abs(controller_response(shaped, np.array([0.09, 0.18])).values[0, 0])
    assert low[0] / low[1] == pytest.approx(2.0, rel=1e-2), "integrates"
    assert len(plain.A) == 1
    assert np.abs(controller_response(plain, np.array([0.09, 0.18])).values[0, 0]).std() < 1e-3 * low[0]
    frequency = np.array([0.5, 9.0, 20.0, 100.0, 500.0])
    s = 2j * np.pi * frequency
    by_hand = (s + 2 * np.pi * 9.0) / s / (1 + s / (2 * np.pi * 1e3))
    rest = np.abs(controller_response(shaped, frequency).values[0, 0] / by_hand)
    assert rest[0] == pytest.approx(rest[1], rel=0.05), "a lead is flat below its corner"
    assert rest[2] * rest[4] == pytest.approx(rest[3] ** 2, rel=0.02), "and symmetric about its centre"


def test_much_phase_is_shared_by_two_leads():
    one = crossover_controller(free_mass(), **WIRES, frequency=100.0, phase_margin=50.0, sample_rate=RATE)
    two = crossover_controller(
        free_mass(), **WIRES, frequency=100.0, phase_margin=75.0, sample_rate=RATE, integral_frequency=10.0
    )
    assert (len(one.A), len(two.A)) == (1, 3)
    loop = open_loop(free_mass(), two, np.geomspace(40.0, 300.0, 3000), **WIRES)
    assert margins(loop).phase_margin == pytest.approx(75.0, abs=0.01)


def test_a_loop_inside_is_part_of_the_plant():
    """A high-authority loop around a damped mode: crossover and margin hold with the damping's loop closed."""
    damper = proportional(-30.0, sample_rate=RATE)
    plant = close_loop(sampled(two_modes(), RATE), damper, measured="v1", driven="f1")
    outer = {"measured": "v2", "driven": "f2"}
    controller = crossover_controller(plant, **outer, frequency=150.0, phase_margin=60.0, sample_rate=RATE)
    found = open_loop(plant, controller, np.array([150.0]), **outer).values[0, 0, 0]
    assert found == pytest.approx(-np.exp(1j * np.radians(60.0)), rel=1e-9)
    assert not unstable_poles(close_loop(plant, controller, **outer))


DEAF = LinearModel(-np.eye(2), [[1.0], [1e-17]], [[0.0, 1.0]], np.zeros((1, 1)), ("force",), ("x",))
"""The force moves another direction, and x by rounding."""
ASKED = {"frequency": 100.0, "phase_margin": 40.0, "sample_rate": RATE}
BAD = {
    "signal": (lambda: crossover_controller(one_mode(), **WIRES, **ASKED), "unknown output 'x'; known: force, pos"),
    "frequency": (
        lambda: crossover_controller(free_mass(), **WIRES, **{**ASKED, "frequency": 6e3}),
        "frequency must lie below half the sample rate, 5000 Hz, got 6000",
    ),
    "low pass": (
        lambda: crossover_controller(free_mass(), **WIRES, **ASKED, low_pass_frequency=5e3),
        "low_pass_frequency must lie below half the sample rate",
    ),
    "margin": (
        lambda: crossover_controller(free_mass(), **WIRES, **{**ASKED, "phase_margin": 0.0}),
        "phase_margin must",
    ),
    "deaf": (lambda: crossover_controller(DEAF, **WIRES, **ASKED), "'force' does not move 'x' at 100 Hz"),
    "late": (
        lambda: crossover_controller(free_mass(), **WIRES, **ASKED, delay=60),
        "no lead gives 'x' a stable loop with 40 deg at 100 Hz .*take a lower crossover",
    ),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_input_is_named(case):
    make, message = BAD[case]
    with pytest.raises(ValueError, match=message):
        make()
