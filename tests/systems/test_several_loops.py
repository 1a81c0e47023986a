"""Several loops closed with one gain: published numbers of the rotating platform, closed forms, brute force."""

import math
from pathlib import Path

import numpy as np
import pytest
import scipy.linalg
from test_zeros import platform, same

from nassim.plotting import plot_root_locus, save_figure
from nassim.systems.controllers import controller_response, decentralised, integral_force_feedback, proportional
from nassim.systems.feedback import close_loop
from nassim.systems.linear_model import LinearModel, sampled, unstable_poles
from nassim.systems.root_loci import largest_stable_gain, optimum_gain, root_locus

BOTH = {"measured": ("fu", "fv"), "driven": ("Fu", "Fv")}
GAINS = np.concatenate([[0.0], np.geomspace(1e-3, 1e3, 80)])
MODES = np.array([0.899974, 1.100035]) / (2 * np.pi)


def two(leak=0.0, *, rate=1e3):
    """Integral force feedback with a leak [rad/s] in both directions."""
    return decentralised(*2 * [integral_force_feedback(1.0, sample_rate=rate, corner_frequency=leak / (2 * np.pi))])


def by_hand(gain, speed, leak, share=0.0, damping=0.05):
    """Poles of the platform's two loops by z = u + j v, in which it is one equation; not those conjugate to them."""
    plant = [1.0, damping + 2j * speed, 1 - speed**2]
    return np.roots(np.polysub(np.polymul(plant, [1.0, leak + gain]), [gain * damping, gain * (1 - share)]))


@pytest.mark.parametrize(("gain", "speed", "leak", "share"), [(2.0, 0.1, 0.1, 0.0), (7.0, 0.4, 0.0, 0.2)])
def test_poles_of_both_loops(gain, speed, leak, share):
    expected = by_hand(gain, speed, leak, share)
    model = platform(speed, share=share)
    closed = close_loop(model, two(leak), **BOTH, gain=gain, delay_order=0)
    assert same(closed.poles(), [*expected, *expected.conj()], 1e-9)
    locus = root_locus(model, two(leak), [0.0, gain], **BOTH, delay_order=0)
    assert same(locus.poles[1], closed.poles(), 1e-9)
    assert same(locus.zeros[np.abs(locus.zeros) > 0.01], [
        sign * 1j * (np.sqrt(share) + way * speed) for sign in (1, -1) for way in (1, -1)
    ], 1e-6)  # fmt: skip


@pytest.mark.parametrize(("speed", "leak"), [(0.1, 0.1), (0.5, 0.1), (0.02, 0.1), (0.3, 2.0)])
def test_leaky_integrators_on_a_turning_platform_have_a_largest_gain(speed, leak):
    found = largest_stable_gain(platform(speed), two(leak), GAINS, **BOTH, delay_order=0)
    assert found == pytest.approx(leak * (1 / speed**2 - 1), rel=1e-8)


@pytest.mark.parametrize("speed", [0.02, 0.1, 0.6])
def test_pure_integrators_need_a_stiffness_in_parallel(speed):
    wires = {**BOTH, "delay_order": 0}
    assert largest_stable_gain(platform(speed), two(), GAINS, **wires) == pytest.approx(0.0, abs=1e-9)
    assert largest_stable_gain(platform(speed, share=0.9 * speed**2), two(), GAINS, **wires) < 1e-9
    assert largest_stable_gain(platform(speed, share=1.1 * speed**2), two(), GAINS, **wires) == math.inf


@pytest.mark.parametrize(
    ("leak", "share", "damping_ratio", "gain"), [(0.1, 0.0, 0.829, 1.99), (0.0, 0.05, 0.825, 2.02)]
)
def test_largest_common_damping_of_a_turning_platform_is_the_published_one(leak, share, damping_ratio, gain):
    gains = np.concatenate([[0.0], np.geomspace(0.1, 9.0, 40)])
    found = optimum_gain(platform(0.1, share=share), two(leak), gains, **BOTH, frequency=MODES, delay_order=0)
    assert found.damping_ratio == pytest.approx(damping_ratio, abs=5e-4)
    assert found.gain == pytest.approx(gain, abs=5e-3)

    def least(gain):
        poles = by_hand(gain, 0.1, leak, share)
        return (-poles.real / np.abs(poles)).min()

    around = found.gain * np.linspace(0.9, 1.1, 401)
    assert least(found.gain) == pytest.approx(found.damping_ratio, rel=1e-9)
    assert max(map(least, around)) <= found.damping_ratio + 1e-9


def struts(parallel=0.0):
    """A body with three coordinates on three stiff struts askew, each with an actuator and a force sensor in line.

    parallel: share of the stiffness that stands beside both; the modes' own damping is none. Returns the model and its
    natural frequencies [rad/s]. With equal struts the same gain in every loop damps every mode by itself.
    """
    random = np.random.default_rng(8)
    mass = np.diag([1.0, 2.0, 0.3]) + 0.1
    directions, stiffness = random.normal(size=(3, 3)), 20e6
    carried = (1 - parallel) * stiffness
    state = np.zeros((6, 6))
    state[:3, 3:] = np.eye(3)
    state[3:, :3] = -np.linalg.solve(mass, stiffness * directions.T @ directions)
    forces = np.vstack([np.zeros((3, 3)), np.linalg.solve(mass, directions.T)])
    readings = np.hstack([-carried * directions, np.zeros((3, 3))])
    model = LinearModel(state, forces, readings, np.eye(3), ("u1", "u2", "u3"), ("f1", "f2", "f3"))
    return model, np.sqrt(scipy.linalg.eigvalsh(stiffness * directions.T @ directions, mass))


WIRES = {"measured": ("f1", "f2", "f3"), "driven": ("u1", "u2", "u3"), "delay_order": 0}
THREE = decentralised(*3 * [integral_force_feedback(1.0, sample_rate=1e6)])


def test_struts_whose_sensors_carry_all_damp_every_mode_critically():
    """s^2 + g s + w^2: critical at g = 2 w."""
    model, omega = struts()
    gains = np.linspace(0.0, 4.0, 41) * omega.max()
    for mode in omega:
        found = optimum_gain(model, THREE, gains, **WIRES, frequency=mode / (2 * np.pi))
        assert found.gain == pytest.approx(2 * mode, rel=1e-5)
    together = optimum_gain(model, THREE, gains, **WIRES, frequency=omega / (2 * np.pi))
    assert (together.gain, together.damping_ratio) == pytest.approx((2 * omega.max(), 1.0), rel=1e-5)


def test_stiffness_beside_the_struts_limits_every_modes_damping():
    """(w - z) / (2 z) at g = w sqrt(w / z), with z = w sqrt(0.3) for a stiffness of 30 % beside the struts."""
    model, omega = struts(0.3)
    gains = np.linspace(0.0, 4.0, 41) * omega.max()
    ratio = np.sqrt(0.3)
    for mode in omega:
        found = optimum_gain(model, THREE, gains, **WIRES, frequency=mode / (2 * np.pi))
        assert found.gain == pytest.approx(mode / np.sqrt(ratio), rel=1e-4)
        assert found.damping_ratio == pytest.approx((1 - ratio) / (2 * ratio), rel=1e-6)


def test_sampled_loops_closed_together_or_one_by_one():
    model, single = sampled(platform(0.3), 20.0), integral_force_feedback(1.0, sample_rate=20.0, corner_frequency=0.05)
    together = close_loop(model, decentralised(single, single), **BOTH, gain=1.5)
    one_by_one = close_loop(model, single, measured="fu", driven="Fu", gain=1.5)
    one_by_one = close_loop(one_by_one, single, measured="fv", driven="Fv", gain=1.5)
    moving = np.abs(np.linalg.eigvals(together.A)) > 1e-3
    assert moving.sum() == 8, "four of the platform, two of the integrators, two of the delay by one sample"
    assert same(np.linalg.eigvals(together.A), np.linalg.eigvals(one_by_one.A), 1e-6)
    edge = largest_stable_gain(model, decentralised(single, single), GAINS, **BOTH)
    for share, grows in ((0.999, False), (1.001, True)):
        closed = close_loop(model, decentralised(single, single), **BOTH, gain=share * edge)
        assert bool(unstable_poles(closed)) == grows


def test_controllers_side_by_side_do_not_touch():
    one, other = integral_force_feedback(3.0, sample_rate=1e3, limit=5.0), proportional([[1.0, 2.0]], sample_rate=1e3)
    frequency = np.array([3.0, 70.0])
    with pytest.raises(ValueError, match="limits must agree, got 5, inf"):
        decentralised(one, other)
    with pytest.raises(ValueError, match="sample rates"):
        decentralised(other, proportional(1.0, sample_rate=2e3))
    with pytest.raises(ValueError, match="at least one"):
        decentralised()
    assert decentralised(one, one).limit == 5.0
    free = integral_force_feedback(3.0, sample_rate=1e3)
    pair = controller_response(decentralised(free, other), frequency).values
    assert pair.shape == (2, 3, 2)
    assert pair[0, 0] == pytest.approx(controller_response(free, frequency).values[0, 0])
    assert pair[1, 1:] == pytest.approx(controller_response(other, frequency).values[0])
    assert not pair[0, 1:].any()
    assert not pair[1, 0].any()


def test_double_modes_are_two_branches():
    locus = root_locus(platform(0.0), two(), [0.0, 1.0], **BOTH, delay_order=0)
    first, second = locus.branches([0.159, 0.159])
    assert first != second
    assert locus.frequency[0, [first, second]] == pytest.approx(1 / (2 * np.pi), rel=1e-9)
    with pytest.raises(ValueError, match="only 2 poles oscillate at the first gain, asked for 3"):
        locus.branches([0.1, 0.2, 0.3])


def test_a_first_gain_that_is_unstable_has_no_edge_above():
    with pytest.raises(ValueError, match=r"unstable at the first gain, 10\.5"):
        largest_stable_gain(platform(0.1), two(0.1), [10.5, 11.0], **BOTH, delay_order=0)


def test_idle_loops_leave_the_locus_without_zeros():
    """One of two loops is off: every s is a zero of both, and the poles are those of the other alone."""
    off = proportional(0.0, sample_rate=1e3)
    single = integral_force_feedback(1.0, sample_rate=1e3)
    locus = root_locus(platform(0.1), decentralised(single, off), GAINS, **BOTH, delay_order=0)
    alone = root_locus(platform(0.1), single, GAINS, measured="fu", driven="Fu", delay_order=0)
    assert len(locus.zeros) == 0
    assert len(alone.zeros) == 4
    assert same(locus.poles[-1], alone.poles[-1], 1e-9)


@pytest.mark.parametrize("gains", [[[1.0, 0.3]], [[1.0], [0.3]]])
def test_loops_with_more_signals_on_one_side_end_at_zeros(gains):
    """Two sensors added up for one actuator, or one sensor for two: zeros of the loop cut at the single signal."""
    model, controller = platform(0.1), proportional(np.array(gains) * -1.0, sample_rate=1e3)
    n_out, n_in = np.shape(gains)
    wires = {"measured": BOTH["measured"][:n_in], "driven": BOTH["driven"][:n_out], "delay_order": 0}
    locus = root_locus(model, controller, [0.0, 1e6], **wires)
    assert len(locus.zeros) == 4
    assert same(locus.poles[-1], locus.zeros, 1e-4)


def test_picture_of_two_loops(tmp_path):
    gains = np.concatenate([[0.0], np.geomspace(0.02, 30.0, 120)])
    model = platform(0.1, share=0.05)
    best = optimum_gain(model, two(), gains, **BOTH, frequency=MODES, delay_order=0)
    locus = root_locus(model, two(), gains, **BOTH, delay_order=0)
    ax = plot_root_locus(locus, frequency=0.25, optimum=best)
    curves = [line.get_xydata() for line in ax.get_lines() if line.get_marker() == "."]
    for column in locus.branches(MODES):
        branch = locus.poles[:, column] / (2 * np.pi)
        inside = np.abs(branch) < 1.1 * 0.25
        drawn = np.column_stack([branch.real, np.abs(branch.imag)])[inside]
        assert any(curve[inside] == pytest.approx(drawn) for curve in curves)
    assert Path(save_figure(ax, tmp_path / "locus.png")).stat().st_size > 10_000
