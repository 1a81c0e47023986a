"""Budgets of a rotor along fixed axes, against its motion by integration in time."""

import numpy as np
import pytest
import scipy

from nassim import LinearModel, TimeHistory
from nassim.signals import TabulatedSpectrum, turned
from nassim.systems import noise_budget, rotating_noise_budget, sampled

TURN = 0.7
"""Turns per second [Hz]."""
SPEED = 2 * np.pi * TURN
PAIR = [("fx", "fy")], [("x", "y")]


@pytest.fixture(scope="module")
def rotor():
    """A mass of 1 kg on unequal springs in a frame that turns, with forces and displacements along its axes."""
    stiffness, damping, w = np.array([[90.0, 5.0], [5.0, 40.0]]), 2.0 * np.eye(2), SPEED * np.array([[0, -1], [1, 0]])
    a = np.block([[np.zeros((2, 2)), np.eye(2)], [-stiffness - w @ w, -damping - 2 * w]])
    b, c = np.vstack([np.zeros((2, 3)), [[1, 0, 1.0], [0, 1, 0.5]]]), np.hstack([np.eye(2), np.zeros((2, 2))])
    c = np.vstack([c, [0.3, -0.8, 0.0, 0.0]])
    return LinearModel(a, b, c, np.zeros((3, 3)), ("fx", "fy", "own"), ("x", "y", "seen"), ("m", "m", "m"))


def mean_squares(rotor, name, frequency):
    """Mean squares of outputs along fixed axes by a sine of mean square 1, over its phases and whole periods."""
    step = 1 / 400
    time = step * np.arange(round(50 / step))
    result = np.zeros(3)
    for phase in (0.0, np.pi / 2):
        values = np.zeros((3, len(time)))
        values[rotor.inputs.index(name)] = np.sqrt(2) * np.cos(2 * np.pi * frequency * time + phase)
        given = turned(TimeHistory(time, values, rotor.inputs), PAIR[0], -SPEED * time)
        found = scipy.signal.lsim((rotor.A, rotor.B, rotor.C, rotor.D), given.values.T, time)[1]
        fixed = turned(TimeHistory(time, found.T, rotor.outputs), PAIR[1], SPEED * time)
        result += (fixed.values[:, time >= 40] ** 2).mean(axis=1) / 2
    return result


@pytest.mark.parametrize(("name", "frequency"), [("fx", 1.3), ("own", 0.5)])
def test_narrow_noise_moves_a_rotor_as_a_sine_does(rotor, name, frequency):
    """Below the speed and above it; the turn shifts the noise to as many as five frequencies."""
    width = 1e-4
    band = frequency + width * np.array([-0.5, 0, 0.5])
    budget = rotating_noise_budget(rotor, {name: lambda f: np.full(len(f), 1 / width)}, band, rotation_frequency=TURN,
                                   fixed_inputs=PAIR[0], fixed_outputs=PAIR[1])  # fmt: skip
    np.testing.assert_allclose(budget.rms()[:, 0] ** 2, mean_squares(rotor, name, frequency), rtol=2e-3)


def test_without_pairs_or_speed_it_is_the_budget_itself(rotor):
    spectra = {"fy": lambda f: 1 / (1 + f**2), "own": lambda f: 0.1 + 0 * f}
    band = np.linspace(0.3, 20.0, 200)
    expected = noise_budget(rotor, spectra, band, outputs=["seen", "x"])
    at_rest = rotating_noise_budget(rotor, spectra, band, rotation_frequency=0.0, fixed_inputs=PAIR[0],
                                    fixed_outputs=PAIR[1], outputs=["seen", "x"])  # fmt: skip
    moving = rotating_noise_budget(rotor, spectra, band, rotation_frequency=TURN, outputs=["seen", "x"])
    for found in (at_rest, moving):
        assert (found.outputs, found.inputs, found.units) == (expected.outputs, expected.inputs, expected.units)
        np.testing.assert_allclose(found.rms(), expected.rms(), rtol=2e-3)


def test_lines_of_spectra_are_found_and_coarse_ones_told(rotor):
    """A line a hundredth of the distance of two frequencies wide, through a turn there and back, which changes nothing,
    and through the rotor.
    """
    size, width, place = 5.0, 0.004, 3.337
    spectra = {"fx": lambda f: size / (1 + ((f - place) / width) ** 2)}
    band, through = np.linspace(0.5, 20.0, 40), LinearModel(
        np.zeros((0, 0)), np.zeros((0, 2)), np.zeros((2, 0)), np.eye(2), PAIR[0][0], PAIR[1][0]
    )  # fmt: skip
    pairs = {"fixed_inputs": PAIR[0], "fixed_outputs": PAIR[1]}
    found = rotating_noise_budget(through, spectra, band, rotation_frequency=TURN, **pairs).rms()[:, 0] ** 2
    primitive = size * width * np.arctan((band[[0, -1]] - place) / width)
    np.testing.assert_allclose(found, [np.diff(primitive)[0], 0], rtol=2e-3, atol=1e-12)
    moving = rotating_noise_budget(rotor, spectra, band, rotation_frequency=TURN, outputs="x").rms()
    np.testing.assert_allclose(moving, noise_budget(rotor, spectra, band, outputs="x").rms(), rtol=2e-3)
    table = TabulatedSpectrum([0.5, 3.3, 3.31, 3.32, 20.0], [1e-6, 1e-6, 5.0, 1e-6, 1e-6])
    with pytest.warns(UserWarning, match="frequencies are too coarse for a spectrum: the rms of 'x'"):
        rotating_noise_budget(rotor, {"fx": table}, band, rotation_frequency=TURN, outputs="x")


def test_samples_show_noise_beyond_half_of_their_rate_folded(rotor):
    """Forces along fixed x of 3.7 Hz, at 8 samples per second: what two turns shift to 5.1 Hz is seen at 2.9 Hz."""
    model, rate, n, width = sampled(rotor, 8.0), 8.0, 4000, 1e-4
    band = 3.7 + width * np.array([-0.5, 0, 0.5])
    budget = rotating_noise_budget(model, {"fx": lambda f: np.full(len(f), 1 / width)}, band, rotation_frequency=TURN,
                                   fixed_inputs=PAIR[0], fixed_outputs=PAIR[1], outputs=["x", "y"])  # fmt: skip
    assert budget.frequency[-1] <= rate / 2
    time, lines = np.arange(2 * n) / rate, np.zeros((2, 3))
    turn = np.exp(1j * SPEED * time)
    for phase in (0.0, np.pi / 2):
        push = np.sqrt(2) * np.cos(2 * np.pi * 3.7 * time + phase) * turn.conj()
        forces = np.array([push.real, push.imag, 0 * time])
        moved = scipy.signal.dlsim((*model.matrices, 1 / rate), forces.T)[1].T
        fixed = (moved[0] + 1j * moved[1]) * turn
        for row, signal in enumerate((fixed.real, fixed.imag)):
            spectrum = np.abs(np.fft.rfft(signal[n:])) ** 2 * 2 / n**2  # whole periods of 0.1 Hz
            lines[row] += [spectrum[round(f * n / rate)] / 2 for f in (2.3, 2.9, 3.7)]
    first = budget.frequency[0]
    found = np.array([budget.rms(max(f - 0.05, first), f + 0.05)[:, 0] ** 2 for f in (2.3, 2.9, 3.7)])
    np.testing.assert_allclose(found, lines.T, rtol=2e-3)


def test_what_a_rotating_budget_refuses(rotor):
    options = {"rotation_frequency": TURN}
    with pytest.raises(ValueError, match="unknown input 'fz'"):
        rotating_noise_budget(rotor, {"fx": np.ones_like}, [1.0, 2.0], fixed_inputs=[("fx", "fz")], **options)
    with pytest.raises(ValueError, match="unknown output 'z'"):
        rotating_noise_budget(rotor, {"fx": np.ones_like}, [1.0, 2.0], fixed_outputs=[("x", "z")], **options)
    with pytest.raises(ValueError, match="sampled at 10 Hz, so its responses and spectra end at 5 Hz, got 6 Hz"):
        rotating_noise_budget(sampled(rotor, 10.0), {"fx": np.ones_like}, [1.0, 6.0], **options)
