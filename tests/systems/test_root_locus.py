"""Root loci and optimum gains against closed forms, brute force and each other."""

from pathlib import Path

import numpy as np
import pytest
import scipy.linalg
from test_feedback import LOOP, POLE, RATE, ZERO, iff, one_mode, two_modes

from nassim.plotting import plot_root_locus, save_figure
from nassim.simulation.linear.linearization import linearize
from nassim.systems.controllers import decentralised, integral_force_feedback, proportional
from nassim.systems.feedback import close_loop
from nassim.systems.linear_model import LinearModel, damping, frequency_response, sampled, unstable_poles
from nassim.systems.root_loci import RootLocus, iff_optimum, largest_stable_gain, optimum_gain, root_locus
from nassim.systems.state_space import transmission_zeros

GAINS = np.concatenate([[0.0], np.geomspace(0.01, 60.0, 140)])
BENCH = {"measured": "sensor_voltage", "driven": "actuator_voltage"}


@pytest.mark.parametrize("zero", [40.0, 90.0])
def test_optimum_of_one_mode_is_the_closed_form(zero):
    formula = iff_optimum(POLE, zero)
    assert formula.damping_ratio == pytest.approx((POLE - zero) / (2 * zero), rel=1e-12)
    omega_p, omega_z = 2 * np.pi * POLE, 2 * np.pi * zero
    # The loop g / s (s^2 + w_z^2) / (s^2 + w_p^2), whose feedthrough is 1.
    plant = LinearModel(
        np.array([[0.0, 1.0], [-(omega_p**2), 0.0]]),
        np.array([[0.0], [1.0]]),
        np.array([[omega_z**2 - omega_p**2, 0.0]]),
        np.eye(1),
        ("stroke",),
        ("force",),
    )
    controller = integral_force_feedback(100.0, sample_rate=1e4)
    gains = np.concatenate([[0.0], np.geomspace(0.1, 100.0, 80), [1e6]])
    found = optimum_gain(plant, controller, gains, **LOOP, frequency=POLE, delay_order=0)
    assert 100.0 * found.gain == pytest.approx(formula.gain, rel=1e-3)
    assert found.damping_ratio == pytest.approx(formula.damping_ratio, rel=1e-6)
    assert found.frequency == pytest.approx(formula.frequency, rel=1e-3)


@pytest.mark.parametrize("order", [(0, 1), (1, 0)])
def test_the_optimum_of_two_modes_tells_the_least_damped_one(order):
    """Two loops that do not touch: the one whose pole and zero lie closer together limits, whichever is named first."""
    poles, zeros = (2 * np.pi * np.array(f)[list(order)] for f in ([100.0, 150.0], [40.0, 110.0]))
    still = np.zeros((2, 2))
    plant = LinearModel(
        np.block([[still, np.eye(2)], [-np.diag(poles**2), still]]),
        np.vstack([still, np.eye(2)]),
        np.hstack([np.diag(zeros**2 - poles**2), still]),
        np.eye(2),
        ("u1", "u2"),
        ("y1", "y2"),
    )
    controller = decentralised(*2 * [integral_force_feedback(1.0, sample_rate=1e4)])
    wires = {"measured": plant.outputs, "driven": plant.inputs, "frequency": poles / (2 * np.pi), "delay_order": 0}
    found = optimum_gain(plant, controller, np.concatenate([[0.0], np.geomspace(10.0, 3e3, 80)]), **wires)
    assert found.damping_ratio == pytest.approx((150 - 110) / (2 * 110), rel=1e-6)
    assert found.frequency == pytest.approx(np.sqrt(150 * 110), rel=1e-3)
    assert found.gain == pytest.approx(2 * np.pi * 150 * np.sqrt(150 / 110), rel=1e-3)


def test_closed_form_is_a_root_of_the_loop():
    found = iff_optimum(POLE, ZERO)
    s = 2 * np.pi * found.frequency * (-found.damping_ratio + 1j * np.sqrt(1 - found.damping_ratio**2))
    omega_p, omega_z = 2 * np.pi * POLE, 2 * np.pi * ZERO
    assert s * (s**2 + omega_p**2) == pytest.approx(-found.gain * (s**2 + omega_z**2), rel=1e-10)


def test_physical_mode_reaches_the_closed_form(recwarn):
    """Mass, spring and actuator with force sensor: the gain is the formula's over the high-frequency response."""
    formula = iff_optimum(POLE, ZERO)
    found = optimum_gain(one_mode(), iff(100.0), GAINS, **LOOP, frequency=POLE, delay_order=0)
    assert found.damping_ratio == pytest.approx(formula.damping_ratio, rel=1e-3)
    assert 100.0 * found.gain == pytest.approx(formula.gain, rel=1e-3)
    assert not recwarn.list


@pytest.mark.parametrize("model", [one_mode(0.01), sampled(one_mode(0.01), RATE)], ids=["continuous", "sampled"])
def test_branches_hold_the_closed_loops_poles_and_stay_whole(model):
    locus = root_locus(model, iff(100.0), GAINS, **LOOP)
    for k in (0, 40, 90):
        closed = close_loop(model, iff(100.0), **LOOP, gain=GAINS[k]).poles()
        distance = np.abs(locus.poles[k][:, None] - closed).min(axis=1)
        assert distance.max() < 1e-6 * np.abs(closed).max()
    column = locus.branch(POLE)
    assert locus.frequency[0, column] == pytest.approx(POLE, rel=1e-6)
    assert locus.damping_ratio[0, column] == pytest.approx(0.01, rel=1e-6)
    steps = np.abs(np.diff(locus.poles[:80, column]))
    assert steps.max() < 0.15 * 2 * np.pi * POLE
    first = locus.stable.argmin()
    assert 0 < first < len(GAINS), "the delay makes high gains unstable"
    for k in (first - 1, first):
        closed = close_loop(model, iff(100.0), **LOOP, gain=GAINS[k])
        assert (unstable_poles(closed) == ()) == locus.stable[k]


@pytest.mark.parametrize("gains", [[0.0, 0.7, 1.5, 2.5, 3.5], [0.0, 0.2, 1.6, 1.7, 3.0, 3.01, 9.0]])
def test_branches_that_cross_go_straight_on(gains):
    """One pole moves to the right, another one up; between two gains, however spaced, both pass the same place."""
    turn = np.array([[0.0, 1.0], [-1.0, 0.0]])
    state = scipy.linalg.block_diag(20 * turn - 3 * np.eye(2), 18 * turn - np.eye(2))
    names = tuple("abcd"), tuple("efgh")
    plant = LinearModel(state, np.eye(4), np.eye(4), np.zeros((4, 4)), *names)
    controller = proportional(scipy.linalg.block_diag(np.eye(2), turn), sample_rate=RATE)
    gains = np.array(gains)
    locus = root_locus(plant, controller, gains, measured=names[1], driven=names[0], delay_order=0)
    right, up = (locus.poles[:, np.argmin(np.abs(locus.poles[0] - start))] for start in (-3 + 20j, -1 + 18j))
    np.testing.assert_allclose(right, -3 + 20j + gains, atol=1e-9)
    np.testing.assert_allclose(up, -1 + 18j + 1j * gains, atol=1e-9)


def test_zeros_end_the_branches():
    locus = root_locus(one_mode(), iff(100.0), GAINS, **LOOP, delay_order=0)
    assert np.sort(locus.zeros.imag) == pytest.approx(2 * np.pi * ZERO * np.array([-1, 1]), rel=1e-9)
    assert np.abs(locus.zeros.real).max() < 1e-6
    far = root_locus(one_mode(), iff(100.0), [0.0, 1e3], **LOOP, delay_order=0).poles[-1]
    assert np.abs(far[:, None] - locus.zeros).min(axis=0) == pytest.approx(0, abs=0.01 * 2 * np.pi * ZERO)


def test_transmission_zeros_of_several_signals():
    """Where a square system cannot answer: its transfer matrix is singular there."""
    random = np.random.default_rng(5)
    a, b, c, d = (random.normal(size=shape) for shape in ((5, 5), (5, 3), (3, 5), (3, 3)))
    for direct, count in ((d, 5), (np.diag([0.0, 1.0, 0.0]) @ d, 3), (np.zeros((3, 3)), 2)):
        zeros = transmission_zeros((a, b, c, direct))
        assert len(zeros) == count
        for zero in zeros:
            response = c @ np.linalg.solve(zero * np.eye(5) - a, b) + direct
            assert np.linalg.svd(response, compute_uv=False)[-1] < 1e-8 * np.linalg.norm(response)
    nothing = np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), np.ones((1, 1))
    assert len(transmission_zeros(nothing)) == 0


def test_several_signals_share_a_gain():
    plant = sampled(two_modes(), RATE)
    controller = proportional(np.diag([-1.0, -2.0]), sample_rate=RATE)
    pair = {"measured": ("v1", "v2"), "driven": ("f1", "f2")}
    gains = np.linspace(0.0, 40.0, 9)
    locus = root_locus(plant, controller, gains, **pair)
    for k, gain in enumerate(gains):
        ratio = damping(close_loop(plant, controller, **pair, gain=gain))[1]
        assert locus.damping_ratio[k].min() == pytest.approx(ratio.min(), rel=1e-6)
    assert np.all(np.diff(locus.damping_ratio[:, locus.branch(60.0)]) > 0)
    for near, mode in ((50.0, 60.0), (74.0, 60.0), (76.0, 90.0), (500.0, 90.0)):
        assert locus.frequency[0, locus.branch(near)] == pytest.approx(mode, rel=1e-6)


def test_optimum_on_the_bench_beats_every_other_gain(bench):
    plant = sampled(linearize(bench), 1e4)
    controller = integral_force_feedback(1.0, sample_rate=1e4, corner_frequency=40.0)
    mode = damping(plant)[0][0]
    gains = np.concatenate([[0.0], np.geomspace(5.0, 2000.0, 60)])
    found = optimum_gain(plant, controller, gains, **BENCH, frequency=mode)
    # Brute force needs no branches: the least damped pole below 150 Hz, in small steps about the answer.
    around = found.gain * np.linspace(0.9, 1.1, 41)

    def least(gain):
        frequency, ratio = damping(close_loop(plant, controller, **BENCH, gain=gain))
        return ratio[(frequency > 20) & (frequency < 150)].min()

    ratios = [least(gain) for gain in around]
    assert max(ratios) <= found.damping_ratio + 1e-9
    assert least(found.gain) == pytest.approx(found.damping_ratio, rel=1e-9)
    assert abs(around[int(np.argmax(ratios))] / found.gain - 1) < 0.006
    assert unstable_poles(close_loop(plant, controller, **BENCH, gain=found.gain)) == ()


def test_bench_without_delay_is_its_first_mode(bench):
    """The bench's optimum by its first pole and zero alone, and the closed form that leaves their own damping out."""
    plant = linearize(bench)
    controller = integral_force_feedback(1.0, sample_rate=1e4)
    gains = np.concatenate([[0.0], np.geomspace(5.0, 1000.0, 60)])
    locus = root_locus(plant, controller, gains, **BENCH, delay_order=0)
    pole = locus.poles[0, locus.branch(damping(plant)[0][0])]
    zero = locus.zeros[np.argmin(np.abs(locus.zeros))]
    found = optimum_gain(plant, controller, gains, **BENCH, frequency=abs(pole) / (2 * np.pi), delay_order=0)

    at = np.array([300.0])
    s = 2j * np.pi * at
    shape = (s**2 - 2 * zero.real * s + abs(zero) ** 2) / (s**2 - 2 * pole.real * s + abs(pole) ** 2)
    above = (frequency_response(plant, at).response("sensor_voltage", "actuator_voltage") / shape).real.item()
    one = LinearModel(
        np.array([[0.0, 1.0], [-(abs(pole) ** 2), 2 * pole.real]]),
        np.array([[0.0], [above]]),
        np.array([[abs(zero) ** 2 - abs(pole) ** 2, 2 * pole.real - 2 * zero.real]]),
        np.array([[above]]),
        ("actuator_voltage",),
        ("sensor_voltage",),
    )
    alone = optimum_gain(one, controller, gains, **BENCH, frequency=abs(pole) / (2 * np.pi), delay_order=0)
    assert found.gain == pytest.approx(alone.gain, rel=5e-3)
    assert found.damping_ratio == pytest.approx(alone.damping_ratio, rel=5e-3)

    formula = iff_optimum(abs(pole) / (2 * np.pi), abs(zero) / (2 * np.pi))
    assert 0 < found.damping_ratio - formula.damping_ratio < -4 * pole.real / abs(pole)
    assert found.gain == pytest.approx(formula.gain / above, rel=0.02)


def test_critical_damping_is_reached_at_the_least_gain():
    """Undelayed velocity feedback on one mode: critical at the gain 2 w, flat beyond."""
    omega = 2 * np.pi * POLE
    plant = LinearModel(
        np.array([[0.0, 1.0], [-(omega**2), 0.0]]), np.array([[0.0], [1.0]]), np.array([[0.0, 1.0]]), [[0.0]],
        ("f",), ("v",),
    )  # fmt: skip
    controller = proportional(-1.0, sample_rate=1e4)
    for gains in (np.linspace(0.0, 5.0, 12) * omega, np.linspace(0.0, 2.1, 12) * omega):  # or only at the last of them
        found = optimum_gain(plant, controller, gains, measured="v", driven="f", frequency=POLE, delay_order=0)
        assert found.gain == pytest.approx(2 * omega, rel=1e-6)
        assert (found.damping_ratio, found.frequency) == (pytest.approx(1.0), pytest.approx(POLE, rel=1e-2))


def test_optimum_ends_where_another_mode_becomes_unstable():
    """Two oscillators, each with a rate feedback of its own: the one's gain damps it, the other's drives it.

    The second loses its damping 2 zeta w at a gain of 2 zeta w / 0.2, where the first one's has grown by so much.
    """
    omega, ratio = 2 * np.pi * np.array([60.0, 90.0]), np.array([0.01, 0.03])
    own = 2 * ratio * omega
    state = np.block([[np.zeros((2, 2)), np.eye(2)], [-np.diag(omega**2), -np.diag(own)]])
    forces, readings = np.eye(4)[:, 2:], np.eye(4)[2:]
    plant = LinearModel(state, forces, readings, np.zeros((2, 2)), ("f1", "f2"), ("v1", "v2"))
    controller = proportional(np.diag([-1.0, 0.2]), sample_rate=1e4)
    pair = {"measured": plant.outputs, "driven": plant.inputs}
    gains = np.linspace(0.0, 300.0, 31)
    with pytest.warns(UserWarning, match="at the limit of stability, where a motion of 90 Hz begins to grow"):
        found = optimum_gain(plant, controller, gains, **pair, frequency=60.0, delay_order=0)
    edge = own[1] / 0.2
    assert found.gain == pytest.approx(edge, rel=1e-5)
    assert found.damping_ratio == pytest.approx((own[0] + edge) / (2 * omega[0]), rel=1e-5)


def test_a_sampled_drift_by_rounding_is_stable():
    """As a free mass's, whose growth `unstable_poles` does not count."""
    plant = LinearModel([[1 + 1e-9]], [[1e-9]], [[1.0]], [[0.0]], ("f",), ("x",), time_step=1e-3)
    loop = {"controller": proportional(1.0, sample_rate=1e3, delay=0), "measured": "x", "driven": "f"}
    locus = root_locus(plant, gains=[0.0, 100.0], **loop)
    assert [unstable_poles(close_loop(plant, **loop, gain=gain)) == () for gain in locus.gains] == [True, False]
    assert locus.stable.tolist() == [True, False]
    assert largest_stable_gain(plant, gains=[0.0, 100.0], **loop) == 0.0


def test_a_free_mass_that_a_late_loop_drives_slowly_apart_is_stable_at_no_gain():
    """Its growth is below the threshold at the first gains of a fine grid."""
    mass = LinearModel([[0.0, 1.0], [0.0, 0.0]], [[0.0], [1.0]], [[1.0, 0.0]], [[0.0]], ("f",), ("x",))
    loop = {"controller": proportional(-1.0, sample_rate=1e4), "measured": "x", "driven": "f"}
    gains = np.concatenate([[0.0], np.geomspace(1e-4, 1e3, 200)])
    quiet = [unstable_poles(close_loop(sampled(mass, 1e4), **loop, gain=gain)) == () for gain in gains]
    assert sum(quiet) > 50
    assert largest_stable_gain(sampled(mass, 1e4), gains=gains, **loop) == pytest.approx(0.0, abs=1e-9)


def test_no_gain_better_than_none():
    with pytest.warns(UserWarning, match=r"no gain raises the damping ratio of the mode at 100 Hz above 0\.02, which"):
        found = optimum_gain(one_mode(0.02), iff(-1.0), GAINS, **LOOP, frequency=POLE)
    assert found.gain == pytest.approx(0.0, abs=1e-6)
    assert found.damping_ratio == pytest.approx(0.02, rel=1e-6)


def test_picture_of_a_root_locus(tmp_path):
    locus = root_locus(one_mode(0.01), iff(100.0), GAINS, **LOOP, delay_order=0)
    ax = plot_root_locus(locus, frequency=120.0, optimum=iff_optimum(POLE, ZERO))
    curves = [line.get_xydata() for line in ax.get_lines() if line.get_marker() == "."]
    expected = np.column_stack([locus.poles[:, locus.branch(POLE)].real, locus.poles[:, locus.branch(POLE)].imag])
    assert any(curve == pytest.approx(expected / (2 * np.pi), nan_ok=True) for curve in curves)
    (star,) = [line.get_xydata()[0] for line in ax.get_lines() if line.get_marker() == "*"]
    assert np.hypot(*star) == pytest.approx(np.sqrt(POLE * ZERO))
    best = iff_optimum(POLE, ZERO)
    assert star[0] == pytest.approx(-best.damping_ratio * best.frequency)
    marked = {mark: [line.get_xydata() for line in ax.get_lines() if line.get_marker() == mark] for mark in "xo"}
    # The mode's damper draws its zeros to the left by as much as its poles.
    assert marked["o"][0] == pytest.approx(np.array([[-0.01 * POLE, np.sqrt(ZERO**2 - (0.01 * POLE) ** 2)]]))
    start = POLE * np.array([-0.01, np.sqrt(1 - 0.01**2)])
    assert any(points[0] == pytest.approx(start, rel=1e-6) for points in marked["x"])
    assert all(np.all(curve[:, 1][np.isfinite(curve[:, 1])] >= 0) for curve in curves)
    assert all(np.nanmax(np.hypot(*curve.T)) <= 1.1 * 120.0 for curve in curves)
    lines = [line for line in ax.get_lines() if line.get_marker() == "."]
    twins = [line.get_color() for line in lines if line.get_xdata()[0] == pytest.approx(start[0], rel=1e-6)]
    assert len(twins) == 2
    assert len(set(twins)) == 1, "a pole and its conjugate have one colour"
    rays = {text.get_text(): np.array(text.xy) for text in ax.texts}
    assert rays["0.3"] / np.hypot(*rays["0.3"]) == pytest.approx([-0.3, np.sqrt(1 - 0.3**2)])
    told = [text.get_text() for text in ax.get_legend().get_texts()]
    assert told[0] == "poles at gain 0"
    assert told[2] == "poles up to gain 60"
    assert f"damping {best.damping_ratio:.3g} at {best.frequency:.4g} Hz" in told[3]
    assert Path(save_figure(ax, tmp_path / "locus.png")).stat().st_size > 10_000


BAD = {
    "no zero": (lambda: iff_optimum(POLE, 0.0), "zero_frequency must be positive"),
    "zero above": (lambda: iff_optimum(POLE, 120.0), "between one and three times"),
    "zero far below": (lambda: iff_optimum(POLE, 30.0), "between one and three times"),
    "one gain": (lambda: root_locus(one_mode(), iff(1.0), [1.0], **LOOP), "ascending, at least two"),
    "falling": (lambda: root_locus(one_mode(), iff(1.0), [0.0, 1.0, 0.5], **LOOP), "ascending"),
    "rows": (lambda: RootLocus([0.0, 1.0], np.zeros((3, 2)), []), "a row for each of 2 gains"),
    "too little": (lambda: optimum_gain(one_mode(), iff(1.0), [0.0, 1.0], **LOOP, frequency=POLE), "still grows"),
    "unstable": (lambda: optimum_gain(one_mode(), iff(-1.0), [5.0, 6.0], **LOOP, frequency=POLE), "at every gain"),
    "no mode": (lambda: RootLocus([0.0, 1.0], -np.ones((2, 1)), []).branch(5.0), "no pole oscillates"),
    "output": (lambda: root_locus(one_mode(), iff(1.0), [0.0, 1.0], measured="v", driven="stroke"), "unknown output"),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_input_is_named(case):
    make, message = BAD[case]
    with pytest.raises(ValueError, match=message):
        make()


def test_a_root_locus_of_lists_holds_read_only_arrays():
    locus = RootLocus([0.0, 1.0], [[-3.0 + 4.0j], [-2.0]], [-1.0])
    np.testing.assert_allclose(locus.damping_ratio, [[0.6], [1.0]], rtol=1e-15)
    assert not any(array.flags.writeable for array in (locus.gains, locus.poles, locus.zeros))
