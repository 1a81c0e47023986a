"""Steps and responses of linear systems: parts that nothing couples, defective ones, and many samples as one."""

import numpy as np
import pytest
import scipy.linalg

from nassim.systems import transfer_matrices
from nassim.systems.state_space import (
    cascade,
    discretize,
    inverse_tustin,
    repeat_step,
    transmission_zeros,
    tustin,
    uncoupled,
)
from nassim.systems.transfer_matrices import transfer_matrix

RANDOM = np.random.default_rng(3)
MODE = np.array([[0.0, 1.0], [-(300.0**2), -6.0]])
CRITICAL = np.array([[0.0, 1.0], [-(200.0**2), -400.0]])
RIGID = np.array([[0.0, 1.0], [0.0, 0.0]])
DELAYS = np.diag(np.ones(3), 1)
COUPLED = np.array([[-3.0, 40.0, 0.0], [-50.0, -1.0, 7.0], [0.0, 2.0, -20.0]])


def shuffled(*parts):
    """A system of parts whose states stand in any order: A, B, C and D."""
    a = scipy.linalg.block_diag(*parts)
    order = RANDOM.permutation(len(a))
    inputs, outputs = RANDOM.normal(size=(len(a), 2)), RANDOM.normal(size=(3, len(a)))
    return a[np.ix_(order, order)], inputs, outputs, RANDOM.normal(size=(3, 2))


def test_uncoupled_parts_are_found_in_any_order():
    a, *_ = shuffled(MODE, RIGID, COUPLED, [[-5.0]])
    parts = {tuple(part) for group in uncoupled(a) for part in group}
    assert sorted(map(len, parts)) == [1, 2, 2, 3]
    assert sorted(k for part in parts for k in part) == list(range(8))
    for part in parts:
        outside = np.setdiff1d(np.arange(8), part)
        assert not np.any(a[np.ix_(part, outside)])
        assert not np.any(a[np.ix_(outside, part)])
    assert uncoupled(np.zeros((0, 0))) == []


def test_steps_of_uncoupled_parts_are_those_of_the_whole():
    a, b, *_ = shuffled(MODE, CRITICAL, RIGID, COUPLED, [[-5.0]], MODE * [[1.0, 1.0], [4.0, 2.0]])
    joint = scipy.linalg.expm(1e-3 * np.block([[a, b], [np.zeros((2, len(a) + 2))]]))
    phi, held, risen = discretize(a, b, 1e-3)
    np.testing.assert_allclose(phi, joint[:-2, :-2], rtol=1e-10, atol=1e-13)
    np.testing.assert_allclose(held, joint[:-2, -2:], rtol=1e-10, atol=1e-13)
    times, weights = np.polynomial.legendre.leggauss(20)
    expected = sum(
        w / 2 * (1 - (t + 1) / 2) * scipy.linalg.expm(1e-3 * a * (t + 1) / 2)
        for t, w in zip(times, weights, strict=True)
    )
    np.testing.assert_allclose(risen, 1e-3 * expected @ b, rtol=1e-9, atol=1e-13)


def test_slow_modes_keep_their_digits_beside_fast_ones():
    slow, fast = np.array([[0.0, 1.0], [-1.0, 0.0]]), np.array([[0.0, 1.0], [-(1e7**2), 0.0]])
    phi, *_ = discretize(scipy.linalg.block_diag(slow, fast), np.zeros((4, 0)), 1e-3)
    assert phi[0, 1] == pytest.approx(np.sin(1e-3), rel=1e-15)


@pytest.mark.parametrize("times", [1, 2, 7, 64])
def test_many_samples_as_one(times):
    a, b, c, d = shuffled(COUPLED / 60, [[0.5]])
    whole = repeat_step((a, b, c, d), times)
    inputs, x = RANDOM.normal(size=(times, 2)), RANDOM.normal(size=4)
    start, outputs = x, []
    for u in inputs:
        outputs.append(c @ x + d @ u)
        x = a @ x + b @ u
    np.testing.assert_allclose(whole[0] @ start + whole[1] @ inputs.ravel(), x, atol=1e-12)
    np.testing.assert_allclose(whole[2] @ start + whole[3] @ inputs.ravel(), np.ravel(outputs), atol=1e-12)


NEARLY = CRITICAL - np.diag([0.0, 1e-9])


@pytest.mark.parametrize(("defective", "digits"), [(RIGID, 10), (CRITICAL, 8), (NEARLY, 8), (DELAYS, 10)])
def test_responses_of_defective_parts_beside_others(defective, digits, monkeypatch):
    """Where eigenvectors do not span, each point is solved, of that part alone; where they hardly do, digits go.

    Blocks of few points are joined again.
    """
    monkeypatch.setattr(transfer_matrices, "AT_ONCE", 30)
    system = a, b, c, d = shuffled(MODE, defective, COUPLED, MODE * [[1.0, 1.0], [4.0, 2.0]], [[-5.0]])
    points = 1j * np.geomspace(0.1, 1e4, 60)
    expected = [c @ np.linalg.solve(s * np.eye(len(a)) - a, b) + d for s in points]
    np.testing.assert_allclose(
        transfer_matrix(system, points).transpose(2, 0, 1), expected, rtol=10.0**-digits, atol=1e-12
    )


@pytest.mark.parametrize("state", [np.array([[-1.0]]), np.array([[0.0]]), RIGID])
def test_responses_are_infinite_at_poles(state):
    inputs, outputs = np.eye(len(state))[:, -1:], np.eye(len(state))[:1]
    value = transfer_matrix((state, inputs, outputs, np.zeros((1, 1))), np.array([state[0, 0] + 0j]))
    assert not np.isfinite(value).any()


def test_only_the_pole_itself_is_infinite():
    value = transfer_matrix((RIGID, np.eye(2)[:, 1:], np.eye(2), np.zeros((2, 1))), np.array([0, 2j, 5j]))[:, 0]
    assert not np.isfinite(value[:, 0]).any()
    np.testing.assert_allclose(value[:, 1:], [[-1 / 4, -1 / 25], [1 / 2j, 1 / 5j]], rtol=1e-15)


@pytest.mark.parametrize("loss", [0.0, 1e-17, 1e-14, 1e-11, 1e-8, 1e-4, 1.0])
def test_a_free_mass_with_hardly_any_damper(loss):
    """1 / (s (s + loss)): two poles at nearly one place, whose eigenvectors are as nearly parallel."""
    points = 2j * np.pi * np.geomspace(1e-2, 1e4, 50)
    a = np.array([[0.0, 1.0], [0.0, -loss]])
    found = transfer_matrix((a, np.eye(2)[:, 1:], np.eye(2)[:1], np.zeros((1, 1))), points)
    np.testing.assert_allclose(found[0, 0], 1 / (points * (points + loss)), rtol=1e-9)


def test_two_poles_apart_by_less_and_less_keep_digits_between_the_checked_points():
    """1 / ((s + 1)^2 - apart^2): its modal sum loses digits bit by bit, and some of the checks happen to be right."""
    points = 1j * np.geomspace(0.1, 1e3, 3000)
    for apart in np.geomspace(1e-3, 1e-9, 61):
        a = np.array([[-1.0, 1.0], [apart**2, -1.0]])
        found = transfer_matrix((a, np.eye(2)[:, 1:], np.eye(2)[:1], np.zeros((1, 1))), points)
        np.testing.assert_allclose(found[0, 0], 1 / ((points + 1) ** 2 - apart**2), rtol=1.5e-9)


@pytest.mark.parametrize("loss", [0.0, 1e-17, 1e-14, 1e-8, 1.0])
def test_zero_of_a_free_mass_with_hardly_any_damper(loss):
    """Position and half of the velocity read together: -2, whatever brakes."""
    a = np.array([[0.0, 1.0], [0.0, -loss]])
    found = transmission_zeros((a, np.eye(2)[:, 1:], np.array([[1.0, 0.5]]), np.zeros((1, 1))))
    assert found == pytest.approx([-2.0], rel=1e-12)


def test_free_carriages_with_damped_payloads():
    """In modal coordinates, as products of matrices leave them: rounding couples the free motion to the payload's."""
    for _ in range(40):
        carriage, payload, k, c = 10 ** RANDOM.uniform([-1, -1, 2, -1], [1, 2, 7, 2])
        mass, pair = np.diag([carriage, payload]), np.array([[1.0, -1.0], [-1.0, 1.0]])
        squares, shapes = scipy.linalg.eigh(k * pair, mass)
        damper = shapes.T @ (c * pair) @ shapes
        damper += 1e-16 * damper[1, 1] * RANDOM.normal(size=(2, 2))
        a = np.block([[np.zeros((2, 2)), np.eye(2)], [-np.diag([0.0, squares[1]]), -damper]])
        b, c_ = np.vstack([np.zeros((2, 2)), shapes.T]), np.hstack([shapes, np.zeros((2, 2))])
        s = 1j * np.sqrt(squares[1]) * np.geomspace(0.1, 1e2, 30)
        spring, free = c * s + k, s**2 * (carriage * payload * s**2 + (carriage + payload) * (c * s + k))
        expected = np.array([[payload * s**2 + spring, spring], [spring, carriage * s**2 + spring]]) / free
        np.testing.assert_allclose(transfer_matrix((a, b, c_, np.zeros((2, 2))), s), expected, rtol=1e-8)


def test_far_above_all_resonances_small_responses_keep_their_digits():
    """A chain pushed at one end and read at the other: s^-8, the sum of eight terms of s^-1."""
    n = 4
    spring = 1e4 * (np.diag([2.0, 2.0, 2.0, 1.0]) - np.eye(n, k=1) - np.eye(n, k=-1))
    a = np.block([[np.zeros((n, n)), np.eye(n)], [-spring, -1e-5 * spring]])
    s = 1e2j * np.geomspace(0.1, 1e3, 40)
    found = transfer_matrix((a, np.eye(2 * n)[:, n:][:, :1], np.eye(2 * n)[n - 1 : n], np.zeros((1, 1))), s)
    expected = [np.linalg.solve(x**2 * np.eye(n) + (1 + 1e-5 * x) * spring, np.eye(n)[0])[-1] for x in s]
    np.testing.assert_allclose(found[0, 0], expected, rtol=1e-8)


def test_a_system_without_states_is_its_feedthrough():
    system = np.zeros((0, 0)), np.zeros((0, 2)), np.zeros((3, 0)), np.arange(6.0).reshape(3, 2)
    response = transfer_matrix(system, np.array([1j, 2j]))
    np.testing.assert_array_equal(response, np.repeat(system[3][:, :, None], 2, axis=2))


def test_beside_a_fast_filter_a_light_resonance_keeps_its_digits():
    """A mode read by a fast filter that feeds back: at its peak, and nowhere else, eigenvectors lose digits."""
    omega, ratio, fast, back = 30.0, 1e-8, 1e9, 0.5
    a = np.array([[0.0, 1.0, 0.0], [-(omega**2), -2 * ratio * omega, -back * omega**2], [fast, 0.0, -fast]])
    peak, width = omega * np.sqrt(1 + back), 7.5e-8
    s = 1j * np.array([0.01 * omega, *(peak + width * np.arange(-2, 3)), 100 * omega])
    expected = 1 / (s**2 + 2 * ratio * omega * s + omega**2 * (1 + back * fast / (s + fast)))
    found = transfer_matrix((a, np.eye(3)[:, 1:2], np.eye(3)[:1], np.zeros((1, 1))), s)
    np.testing.assert_allclose(found[0, 0], expected, rtol=1e-5)


def test_responses_that_symmetry_nearly_cancels_are_refined(monkeypatch):
    """Pairs of nearly equal modes with common dampers, pushed alike and read against each other.

    Their modal sum loses digits. Refined, it needs no direct solve at other points than those of the checks.
    """
    rng, frequency = np.random.default_rng(4), np.repeat(np.geomspace(3.0, 3e5, 20), 2)
    frequency[1::2] *= 1 + 1e-5
    rows = np.repeat(rng.standard_normal((4, 20)), 2, axis=1) * np.sqrt(frequency)
    n = len(frequency)
    stiffness, damping = np.diag(frequency**2), 1e-4 * rows.T @ rows
    a = np.block([[np.zeros((n, n)), np.eye(n)], [-stiffness, -damping]])
    size = np.repeat(rng.standard_normal(20), 2)
    b = np.concatenate([np.zeros(n), size])[:, None]
    read = size * np.tile([1.0, -1.0], 20)
    c = np.concatenate([read, np.zeros(n)])[None]
    points = 1j * np.geomspace(1.0, 1e4, 300)
    expected = [read @ np.linalg.solve(s**2 * np.eye(n) + stiffness + s * damping, size) for s in points]
    poles, vectors = np.linalg.eig(a)
    plain = (c @ vectors)[0] * np.linalg.solve(vectors, b.astype(complex))[:, 0] @ (1 / (points - poles[:, None]))
    assert np.abs(plain / expected - 1).max() > 1e-8
    solved, solve = [], transfer_matrices._solved
    monkeypatch.setattr(transfer_matrices, "_solved", lambda *of: solved.append(of[2].size) or solve(*of))
    found = transfer_matrix((a, b, c, np.zeros((1, 1))), points)[0, 0]
    np.testing.assert_allclose(found, expected, rtol=2e-9)
    assert sum(solved) < 50


LAG = [[-2]], [[1]], [[3]], [[0]]
"""3 / (s + 2) as lists of whole numbers."""


def test_matrices_may_be_lists():
    """T = 0.5: s = 4 (z - 1) / (z + 1), so that 3 / (s + 2) is (z + 1) / (2 z - 2 / 3)."""
    a, b, c, d = tustin(LAG, 0.5)
    assert (a.item(), d.item(), (c @ b).item()) == pytest.approx((1 / 3, 1 / 2, 2 / 3))
    assert transfer_matrix(inverse_tustin((a.tolist(), b, c, d), 0.5), [1j, 4]) == pytest.approx(
        np.array([[[3 / (1j + 2), 0.5]]])
    )
    assert transfer_matrix(cascade(LAG, LAG), [1j]) == pytest.approx(np.array([[[9 / (1j + 2) ** 2]]]))
    assert discretize([[-2]], [[1]], 0.5)[1].item() == pytest.approx((1 - np.exp(-1)) / 2)
    assert transmission_zeros(([[-2]], [[1]], [[3]], [[1]])) == pytest.approx([-5.0])
    assert transfer_matrix(LAG, []).shape == (1, 1, 0)
    assert transfer_matrix((np.zeros((2, 2)), np.zeros((2, 0)), np.zeros((1, 2)), np.zeros((1, 0))), [1j]).size == 0


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: tustin(([[-2, 1]], *LAG[1:]), 0.5), "A must have shape 1 x 1, got 1 x 2"),
        (lambda: inverse_tustin((LAG[0], [[1], [2]], *LAG[2:]), 0.5), "B must have shape 1 x 1, got 2 x 1"),
        (lambda: transmission_zeros((*LAG[:2], [[1, 2]], [[0]])), "C must have shape 1 x 1, got 1 x 2"),
        (lambda: transfer_matrix((*LAG[:3], 0), [1j]), "D must have shape any x any, got a number"),
        (lambda: transfer_matrix(LAG, 1j), "points must be a vector"),
        (lambda: tustin(LAG[:3], 0.5), r"a system is \(A, B, C, D\), got tuple; a LinearModel has them as `matrices`"),
        (lambda: tustin(([[np.nan]], *LAG[1:]), 0.5), "A holds 1 .*NaN"),
        (lambda: discretize([[-2, 1]], [[1]], 0.5), "A must have shape 1 x 1, got 1 x 2"),
        (lambda: discretize([[-2]], [[1], [1]], 0.5), "B must have shape 1 x any, got 2 x 1"),
        (
            lambda: cascade(LAG, ([[-2]], [[1, 1]], [[3]], [[0, 0]])),
            r"1 output\(s\) of the first system cannot be 2 input\(s\) of the second",
        ),
    ],
)
def test_matrices_that_do_not_agree_are_refused(make, message):
    with pytest.raises(ValueError, match=message):
        make()


def test_a_response_counts_as_rounding_below_the_effect_of_rounded_rows():
    """That of the worst change of each row of A by the same share of its length."""
    rng = np.random.default_rng(8)
    a, b, c = rng.normal(size=(4, 4)), rng.normal(size=(4, 1)), rng.normal(size=(1, 4))
    a *= np.array([1.0, 1e3, 10.0, 1e-2])[:, None]
    points = np.array([3.0, 50.0])
    found = transfer_matrices._Checks.of((a[None], b[None], c[None]), np.linalg.eigvals(a)[None], points)
    for at, expected, rounding in zip(found.points[0], found.expected[0], found.rounding[0], strict=True):
        left = at.real * np.eye(4) - a
        state, adjoint = np.linalg.solve(left, b)[:, 0], np.linalg.solve(left.T, c[0])
        lengths = 1e-8 * np.linalg.norm(a, axis=1)
        change = np.outer(lengths * np.sign(adjoint), state / np.linalg.norm(state))
        effect = (c @ np.linalg.solve(left - change, b))[0, 0] - expected[0, 0]
        assert effect * transfer_matrices.RESPONSE_ROUNDING / 1e-8 == pytest.approx(rounding[0, 0], rel=1e-3)
