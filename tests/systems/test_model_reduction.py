"""Balanced truncation, decoupling, and controllers on families of plants."""

from dataclasses import replace

import numpy as np
import pytest
import scipy
from scipy.spatial.transform import Rotation

from nassim.kinematics import StewartPlatform, jacobian
from nassim.signals import FRF
from nassim.systems import (
    FamilyMargins,
    LinearModel,
    balanced_truncation,
    decoupled,
    family_margins,
    frequency_response,
    hinf_norm,
    integral_force_feedback,
    interconnect,
    loop_at_a_time,
    margins,
    modal_decoupling,
    open_loop,
    proportional,
    relative_gain_array,
    sampled,
    static_gain,
    svd_decoupling,
    uncoupled_point,
)


def chain(n=6, *, free=False):
    """Masses between springs with 2 % of damping, forces on two of them, three outputs."""
    mass = np.diag(1.0 + np.arange(n) / 3)
    stiffness = 1e5 * (2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1))
    if free:
        stiffness[0, 0] = stiffness[-1, -1] = 1e5
    a = np.block(
        [[np.zeros((n, n)), np.eye(n)], [-np.linalg.solve(mass, stiffness), -2e-4 * np.linalg.solve(mass, stiffness)]]
    )
    b = np.vstack([np.zeros((n, 2)), np.linalg.inv(mass)[:, [0, n - 2]]])
    c = 1e5 * np.hstack([np.eye(n)[[0, 2, n - 1]], np.zeros((3, n))])
    return LinearModel(a, b, c, np.zeros((3, 2)), ("f", "g"), ("p", "q", "r"))


def difference(first, second):
    seconds = replace(second, outputs=tuple(f"{name}'" for name in second.outputs))
    less = [static_gain([[1.0, -1.0]], inputs=(y, f"{y}'"), outputs=f"{y} error") for y in first.outputs]
    return interconnect(first, seconds, *less, inputs=first.inputs, outputs=[f"{y} error" for y in first.outputs])


@pytest.mark.parametrize("time_step", [None, 4e-3])
@pytest.mark.parametrize("n", [2, 5, 8])
def test_the_error_lies_between_the_next_singular_value_and_the_bound(n, time_step):
    model = chain() if time_step is None else sampled(chain(), 1 / time_step)
    found = balanced_truncation(model, n)
    assert len(found.model.A) == n
    error = hinf_norm(difference(model, found.model))[0]
    assert found.hankel_singular_values[n] * (1 - 1e-6) <= error <= found.error_bound * (1 + 1e-6)
    assert found.error_bound == pytest.approx(2 * found.hankel_singular_values[n:].sum())
    by_error = balanced_truncation(model, error=found.error_bound * 1.001)
    assert len(by_error.model.A) == n
    assert len(balanced_truncation(model, error=found.error_bound * 0.999).model.A) == n + 1


def test_hankel_singular_values_are_those_of_the_gramians():
    """And no state of the result belongs to a single mode, so none to one beyond the range of validity."""
    model = replace(chain(), unsupported=np.full(12, 1e3))
    reach = scipy.linalg.solve_continuous_lyapunov(model.A, -model.B @ model.B.T)
    show = scipy.linalg.solve_continuous_lyapunov(model.A.T, -model.C.T @ model.C)
    expected = np.sort(np.sqrt(np.linalg.eigvals(reach @ show).real))[::-1]
    found = balanced_truncation(model, 4)
    assert found.hankel_singular_values == pytest.approx(expected, rel=1e-6)
    assert not found.model.unsupported.any()


@pytest.mark.parametrize("unit", [1.0, 1e4, 1e-9])
def test_units_of_uncoupled_states_do_not_matter(unit):
    """Four modes whose states differ in units, and their Gramians in one unit."""
    omega, rng = np.array([10.0, 70.0, 300.0, 900.0]), np.random.default_rng(2)
    a = scipy.linalg.block_diag(*([[0.0, w], [-w, -0.04 * w]] for w in omega))
    b, c = rng.normal(size=(8, 2)), rng.normal(size=(2, 8))
    reach, show = (scipy.linalg.solve_continuous_lyapunov(m, -w @ w.T) for m, w in ((a, b), (a.T, c.T)))
    expected = np.sort(np.sqrt(np.linalg.eigvals(reach @ show).real))[::-1]
    size = np.repeat(unit ** np.array([0.0, 1.0, -1.0, 2.0]), 2)
    model = LinearModel(a, b / size[:, None], c * size, np.zeros((2, 2)), ("u", "v"), ("y", "z"))
    found = balanced_truncation(model, 4)
    assert found.hankel_singular_values == pytest.approx(expected, rel=1e-6)
    assert hinf_norm(difference(model, found.model))[0] <= found.error_bound


@pytest.mark.parametrize("time_step", [None, 1e-3])
def test_free_motions_are_kept(time_step):
    model = chain(free=True) if time_step is None else sampled(chain(free=True), 1 / time_step)
    found = balanced_truncation(model, 8)
    assert found.n_kept == 2
    frequency = np.array([0.01, 1.0, 20.0])
    exact, near = (frequency_response(m, frequency).values for m in (model, found.model))
    assert np.abs(near - exact).max() <= found.error_bound
    assert near[:, :, 0] == pytest.approx(exact[:, :, 0], rel=1e-5)
    with pytest.raises(ValueError, match="2 states belong to growing or undamped motions"):
        balanced_truncation(model, 1)
    free = LinearModel([[0, 1], [0, 0]], [[0], [3]], [[1, 0]], [[0]], ("u",), ("y",))
    kept = balanced_truncation(free, 2)
    assert (kept.error_bound, kept.n_kept, len(kept.hankel_singular_values)) == (0.0, 2, 0)
    np.testing.assert_allclose(frequency_response(kept.model, [2.0]).values, -3 / (4 * np.pi) ** 2)


@pytest.mark.parametrize("time_step", [None, 1e-3])
def test_undamped_oscillations_are_kept(time_step):
    """One of 40 Hz beside a chain: the rest is truncated as without it."""
    swing = LinearModel([[0, 1], [-((80 * np.pi) ** 2), 0]], [[0], [1]], [[5.0, 0]], [[0]], ("h",), ("s",))
    both = interconnect(chain(), swing, inputs=("f", "g", "h"), outputs=("p", "q", "r", "s"))
    both, alone = (model if time_step is None else sampled(model, 1 / time_step) for model in (both, chain()))
    found, expected = balanced_truncation(both, 8), balanced_truncation(alone, 6)
    assert found.n_kept == 2
    np.testing.assert_allclose(found.hankel_singular_values, expected.hankel_singular_values, rtol=1e-6)
    frequency = np.array([1.0, 30.0, 55.0])
    np.testing.assert_allclose(
        frequency_response(found.model, frequency).values[3, 2], frequency_response(both, frequency).values[3, 2], 1e-6
    )


@pytest.mark.parametrize("time_step", [None, 1e-3])
@pytest.mark.parametrize(("rate", "kept"), [(1.1e-7, 0), (0.9e-7, 1)])
def test_a_decay_is_slow_below_a_ten_millionth_of_the_fastest(rate, kept, time_step):
    """Of motions that step by step keep all but that share."""
    poles = np.array([-rate, -1.0]) if time_step is None else np.array([1 - rate, 0.5])
    model = LinearModel(np.diag(poles), np.ones((2, 1)), np.ones((1, 2)), [[0]], ("u",), ("y",), time_step=time_step)
    assert balanced_truncation(model, 1).n_kept == kept


@pytest.mark.filterwarnings("error")
def test_what_no_input_moves_is_removed():
    still = replace(chain(), B=np.zeros((12, 2)), D=np.ones((3, 2)))
    found = balanced_truncation(still, 4)
    assert len(found.model.A) == 0
    assert found.error_bound == 0.0
    assert frequency_response(found.model, [1.0, 50.0]).values == pytest.approx(np.ones((3, 2, 2)))


@pytest.mark.parametrize("options", [{}, {"n_states": 3, "error": 1.0}])
def test_a_truncation_has_one_aim(options):
    with pytest.raises(ValueError, match="give either n_states or error"):
        balanced_truncation(chain(), **options)


def test_modes_of_a_platform_are_decoupled():
    """A hexapod with unequal struts and a skew payload, encoders and forces in the struts."""
    rng = np.random.default_rng(3)
    angles = {"base_angles": [10, 110, 130, 230, 250, 350], "platform_angles": [55, 65, 175, 185, 295, 305]}
    sizes = {"height": 0.095, "base_radius": 0.1, "base_height": 0.01, "platform_radius": 0.08, "platform_depth": 0.02}
    rows = jacobian(StewartPlatform.from_angles(**angles, **sizes))
    root = rng.normal(size=(6, 6))
    mass = 0.1 * root @ root.T + np.diag([5, 5, 5, 0.1, 0.1, 0.1])
    stiffness = rows.T @ np.diag(1e6 * (1 + rng.random(6))) @ rows
    measure, drive = modal_decoupling(mass, stiffness, measured=rows, driven=rows.T)
    for s in (1j * 30.0, 1j * 4e3):
        plant = rows @ np.linalg.solve(mass * s**2 + stiffness, rows.T)
        inner = measure @ plant @ drive
        assert inner == pytest.approx(np.diag(np.diag(inner)), abs=1e-9 * np.abs(inner).max())
    with pytest.raises(ValueError, match="measured and driven must have an inverse"):
        modal_decoupling(mass, stiffness, measured=np.ones((6, 6)), driven=rows.T)


def test_singular_vectors_decouple_at_their_frequency():
    rng = np.random.default_rng(7)
    real, other = rng.normal(size=(2, 3, 2))
    other -= np.sum(other * real) / np.sum(real**2) * real
    line = (real + 0.2j * other) * np.exp(2.1j)
    values = np.stack([rng.normal(size=(3, 2)) + 0j, line, rng.normal(size=(3, 2)) + 0j], axis=2)
    plant = FRF([1.0, 10.0, 100.0], values, ("a", "b", "c"), ("u", "v"))
    with pytest.raises(ValueError, match="goes from 1 to 100 Hz, and does not hold 101 Hz"):
        svd_decoupling(plant, 101.0)
    measure, drive = svd_decoupling(plant, 11.0)
    inner = np.abs(measure @ real @ drive)
    assert inner == pytest.approx(np.diag(np.linalg.svd(real, compute_uv=False)), abs=1e-12)
    controller = decoupled(*2 * [proportional(1.0, sample_rate=1e3)], measure=measure, drive=drive)
    assert controller.D.shape == (2, 3)


def test_a_body_is_uncoupled_at_its_centre_of_mass():
    centre, turn = np.array([0.02, -0.05, 0.11]), Rotation.from_rotvec([0.4, 1.0, -0.3]).as_matrix()
    inertia = turn @ np.diag([1, 2, 3]) @ turn.T
    mass = np.block([[4.0 * np.eye(3), -4.0 * _cross(centre)], [4.0 * _cross(centre), inertia]])
    point, rest = uncoupled_point(mass)
    assert point == pytest.approx(centre)
    assert rest < 1e-12
    screw = np.diag([0.3, -0.1, 0.2])  # no point takes off a symmetric coupling
    mass[:3, 3:] += screw
    point, rest = uncoupled_point(mass)
    assert point == pytest.approx(centre)
    assert rest == pytest.approx(np.linalg.norm(screw) / (4.0 * np.sqrt(3)))
    with pytest.raises(ValueError, match="free along some axis"):
        uncoupled_point(np.diag([1.0, 0, 0, 1, 1, 1]))


def _cross(vector):
    return np.array([np.cross(vector, axis) for axis in np.eye(3)]).T


def test_relative_gains_of_two_loops():
    g = np.array([[2.0, 1.0 + 1j], [0.5, -3.0]])
    plant = FRF([1.0, 2.0], np.stack([g, np.eye(2)], axis=2), ("y", "z"), ("u", "v"))
    gains = relative_gain_array(plant)
    first = 1 / (1 - g[0, 1] * g[1, 0] / (g[0, 0] * g[1, 1]))
    assert gains[:, :, 0] == pytest.approx(np.array([[first, 1 - first], [1 - first, first]]))
    assert gains[:, :, 1] == pytest.approx(np.eye(2))
    with pytest.raises(ValueError, match="1 outputs and 2 inputs"):
        relative_gain_array(FRF([1.0], g[:1, :, None], ("y",), ("u", "v")))
    with pytest.raises(ValueError, match="singular at 3 Hz"):
        relative_gain_array(FRF([1.0, 3.0], np.stack([g, np.ones((2, 2))], axis=2), ("y", "z"), ("u", "v")))


def test_a_plant_that_is_singular_within_rounding_has_no_relative_gains():
    """Of 0.1 ... 0.9 in three rows, the second row is half of the sum of the others. Small receptances are regular."""
    names, rows = ("a", "b", "c"), np.arange(1, 10).reshape(3, 3) / 10
    for scale in (1.0, np.outer([1e-9, 1.0, 1e6], [1e-3, 1.0, 1e3])):
        with pytest.raises(ValueError, match="singular at 2 Hz"):
            relative_gain_array(
                FRF([1.0, 2.0, 9.0], np.stack([np.eye(3), scale * rows, 1e-9 * np.eye(3)], 2), names, names)
            )


def force_sensors(frequency):
    """Two force sensors in line with their drives, with resonances above their zeros and a little coupling."""
    w = 2 * np.pi * frequency
    a = scipy.linalg.block_diag(*([[0, 1], [-((k * w) ** 2), -0.02 * k * w]] for k in (1.0, 1.3)))
    b = np.array([[0, 0], [1, 0.1], [0, 0], [0.1, 1.0]]) * w**2
    return LinearModel(a, b, -0.8 * np.eye(4)[::2], np.eye(2), ("u1", "u2"), ("f1", "f2"))


def test_no_sharp_resonance_is_missed_between_frequencies():
    """Margins by three hundred frequencies are those of dense ones about a resonance with a damping ratio of 2e-4."""
    w, slow = 2 * np.pi * 93.0, 2 * np.pi * 8.0
    a = scipy.linalg.block_diag([[0, 1], [-(w**2), -4e-4 * w]], [[0, 1], [-(slow**2), -0.4 * slow]])
    plant = LinearModel(a, [[0.0], [1.0], [0.0], [1.0]], [[0.1, 0, 1.0, 0]], [[0.0]], ("u",), ("y",))
    controller, loop = proportional(-400.0, sample_rate=5e3), {"measured": "y", "driven": "u"}
    found = family_margins({"one": plant}, controller, np.geomspace(0.5, 2e3, 300), **loop).margins["one"]["y"]
    dense = np.sort(np.concatenate([np.geomspace(0.5, 2e3, 2000), 93.0 + np.linspace(-3.0, 3.0, 20001)]))
    expected = margins(open_loop(sampled(plant, 5e3), controller, dense, **loop))
    assert found.modulus_margin == pytest.approx(expected.modulus_margin, rel=1e-2)
    assert found.phase_margin == pytest.approx(expected.phase_margin, abs=1.0)


def test_no_resonance_of_the_closed_loop_is_missed_between_frequencies():
    """A mass with friction, which the loop makes resonate: margins by twenty frequencies are those of dense ones."""
    plant = LinearModel([[0, 1], [0, -80.0]], [[0.0], [1.0]], [[1.0, 0]], [[0.0]], ("u",), ("y",))
    controller, loop = proportional(-1.5e5, sample_rate=5e3), {"measured": "y", "driven": "u"}
    found = family_margins({"one": plant}, controller, np.geomspace(0.5, 2e3, 20), **loop).margins["one"]["y"]
    expected = margins(open_loop(sampled(plant, 5e3), controller, np.geomspace(0.5, 2e3, 50001), **loop))
    assert expected.modulus_margin < 0.1
    assert found.modulus_margin == pytest.approx(expected.modulus_margin, rel=1e-2)
    assert found.phase_margin == pytest.approx(expected.phase_margin, rel=1e-2)


def test_the_worst_plant_of_each_loop_is_named():
    plants = {"light": force_sensors(200.0), "heavy": force_sensors(60.0)}
    loop = {"measured": ["f1", "f2"], "driven": ["u1", "u2"]}
    one = integral_force_feedback(300.0, sample_rate=5e3, corner_frequency=1.0)
    controller = decoupled(one, one, measure=np.eye(2), drive=np.eye(2))
    frequency = np.geomspace(0.5, 2400.0, 3000)
    family = family_margins(plants, controller, frequency, **loop)
    assert family.stable
    assert "stable" not in str(family)
    expected = {
        case: {
            name: margins(loop_at_a_time(open_loop(sampled(plant, 5e3), controller, frequency, **loop), name))
            for name in ("f1", "f2")
        }
        for case, plant in plants.items()
    }
    assert family.margins == expected
    for name, (case, worst) in family.worst.items():
        assert worst.modulus_margin == min(found[name].modulus_margin for found in expected.values())
        assert worst == expected[case][name]
        (row,) = [line.split() for line in str(family).splitlines() if line.startswith(name)]
        assert row[1] == case
        figures = [worst.gain_margin, worst.phase_margin, worst.modulus_margin]
        np.testing.assert_allclose(np.array(row[2:], dtype=float), figures, rtol=5e-3)
    near, low = (replace(worst, gain_margin=gain, modulus_margin=least) for gain, least in ((9.0, 0.3), (2.0, 0.5)))
    assert FamilyMargins({"low": {"f": low}, "near": {"f": near}}, {}).worst == {"f": ("near", near)}
    assert str(family).splitlines()[0].split()[0::2] == ["loop", "plant", "[-]", "[deg]", "[-]"]
    # Too much gain is too much for the light plant first, and a schedule with less for it mends it.
    strong = decoupled(*2 * [integral_force_feedback(9.8e3, sample_rate=5e3)], measure=np.eye(2), drive=np.eye(2))
    failing = family_margins(plants, strong, frequency, **loop)
    assert list(failing.unstable) == ["light"]
    assert "unstable on 'light'" in str(failing)
    assert list(failing.margins) == ["heavy"]  # though each loop alone, with the other one closed, may show one
    assert family_margins({"light": plants["light"]}, strong, frequency, **loop).worst == {}
    assert family_margins(plants, strong, frequency, **loop, gain=0.05).stable
    scheduled = family_margins(plants, {"light": controller, "heavy": strong}, frequency, **loop)
    assert scheduled.stable
    assert scheduled.margins["light"] == family.margins["light"]
    assert family_margins(plants, controller, frequency, **loop, gain=0.5).margins != family.margins
    with pytest.raises(ValueError, match="sampled at 5000 Hz, so its responses and spectra end at 2500 Hz"):
        family_margins({"light": plants["light"]}, strong, [1.0, 2600.0], **loop)
    with pytest.raises(ValueError, match="the schedule has no controller for 'heavy'; it has light"):
        family_margins(plants, {"light": controller}, frequency, **loop)
    with pytest.raises(ValueError, match="at least one plant"):
        family_margins({}, controller, frequency, **loop)
