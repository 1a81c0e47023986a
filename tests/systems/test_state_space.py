"""Steps and responses of linear systems: parts that nothing couples, defective ones, and many samples as one."""

import numpy as np
import pytest
import scipy.linalg

from nassim.systems.state_space import discretize, repeated, transfer_matrix, uncoupled

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
    whole = repeated((a, b, c, d), times)
    inputs, x = RANDOM.normal(size=(times, 2)), RANDOM.normal(size=4)
    start, outputs = x, []
    for u in inputs:
        outputs.append(c @ x + d @ u)
        x = a @ x + b @ u
    np.testing.assert_allclose(whole[0] @ start + whole[1] @ inputs.ravel(), x, atol=1e-12)
    np.testing.assert_allclose(whole[2] @ start + whole[3] @ inputs.ravel(), np.ravel(outputs), atol=1e-12)


NEARLY = CRITICAL - np.diag([0.0, 1e-9])


@pytest.mark.parametrize(("defective", "digits"), [(RIGID, 10), (CRITICAL, 8), (NEARLY, 8), (DELAYS, 10)])
def test_responses_of_defective_parts_beside_others(defective, digits):
    """Where eigenvectors do not span, each point is solved, of that part alone; where they hardly do, digits go."""
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


def test_a_system_without_states_is_its_feedthrough():
    system = np.zeros((0, 0)), np.zeros((0, 2)), np.zeros((3, 0)), np.arange(6.0).reshape(3, 2)
    response = transfer_matrix(system, np.array([1j, 2j]))
    np.testing.assert_array_equal(response, np.repeat(system[3][:, :, None], 2, axis=2))
