"""Plans against their definitions: where points must lie, what they have in common, what is refused."""

import numpy as np
import pytest
from scipy import stats

from nassim.studies import latin_hypercube, random_points, saltelli_points, sobol_points

PLANS = (random_points, latin_hypercube, sobol_points, saltelli_points)
DISTRIBUTIONS = {
    "thickness": stats.norm(1.25e-3, 0.02e-3),
    "modulus": stats.uniform(60e9, 4e9),
    "glue": stats.lognorm(0.3, scale=1e9),
}


def shares(samples):
    """Values of the distribution functions, (n_runs, n_parameters)."""
    return np.column_stack([distribution.cdf(samples[name]) for name, distribution in DISTRIBUTIONS.items()])


@pytest.mark.parametrize("plan", PLANS)
def test_a_seed_gives_a_plan(plan):
    samples = plan(DISTRIBUTIONS, 16, seed=3)
    assert samples.names == tuple(DISTRIBUTIONS)
    assert "16" in samples.plan
    np.testing.assert_array_equal(plan(DISTRIBUTIONS, np.int64(16), seed=3).values, samples.values)
    assert not np.any(plan(DISTRIBUTIONS, 16, seed=4).values == samples.values)


@pytest.mark.parametrize("plan", PLANS)
def test_parameters_are_distributed_as_asked_and_independent(plan):
    found = shares(plan(DISTRIBUTIONS, 1024, seed=0))
    for column in found.T:
        # Of 1024 random points, the largest of three deviations passes 0.06 once in 300 seeds.
        assert stats.kstest(column, "uniform").statistic < 0.06
    assert np.abs(np.corrcoef(found.T) - np.eye(3)).max() < 0.1


def test_tails_are_whole():
    """One of a thousand values beyond 3.09 deviations of a normal distribution, on each side."""
    values = latin_hypercube({"x": stats.norm(5.0, 2.0)}, 8000, seed=0)["x"]
    assert [np.sum(values < 5 - 2 * 3.0902), np.sum(values > 5 + 2 * 3.0902)] == [8, 8]
    assert np.abs(values - 5).max() > 2 * 3.6


def test_a_latin_hypercube_has_one_run_in_each_stretch():
    stretch = np.floor(shares(latin_hypercube(DISTRIBUTIONS, 50, seed=1)) * 50)
    np.testing.assert_array_equal(np.sort(stretch, axis=0), np.arange(50)[:, None] * np.ones(3))


def test_sobol_points_fill_every_box():
    """64 points of three parameters: one in each of 64 stretches, and eight in each octant."""
    found = shares(sobol_points(DISTRIBUTIONS, 64, seed=5))
    np.testing.assert_array_equal(np.sort(np.floor(found * 64), axis=0), np.arange(64)[:, None] * np.ones(3))
    assert np.unique(found > 0.5, axis=0, return_counts=True)[1].tolist() == [8] * 8


def test_a_larger_plan_begins_with_the_smaller_one():
    small, large = (sobol_points(DISTRIBUTIONS, n, seed=2).values for n in (32, 64))
    np.testing.assert_array_equal(large[:32], small)


def test_a_larger_plan_for_indices_holds_the_smaller_one():
    small, large = (saltelli_points(DISTRIBUTIONS, n, seed=2).values for n in (8, 16))
    assert {tuple(row) for row in small} < {tuple(row) for row in large}


def test_columns_of_b_take_turns_in_a():
    values = saltelli_points(DISTRIBUTIONS, 8, seed=0).values.reshape(5, 8, 3)
    a, b = values[:2]
    assert not np.any(a == b)
    for k, block in enumerate(values[2:]):
        for column in range(3):
            np.testing.assert_array_equal(block[:, column], (b if column == k else a)[:, column])


def test_points_at_the_edge_stay_finite(monkeypatch):
    class Edges:
        """Stands for a generator that hits 0."""

        def random(self, shape):
            return np.zeros(shape)

    monkeypatch.setattr(np.random, "default_rng", lambda seed: Edges())
    assert np.all(np.isfinite(random_points({"a": stats.norm(0, 1)}, 2, seed=0).values))


@pytest.mark.parametrize("plan", PLANS)
@pytest.mark.parametrize(
    ("distributions", "n", "message"),
    [
        ({}, 8, "at least one parameter, got none"),
        ({"arm thickness": stats.norm()}, 8, "must be Python's"),
        ({"a": (4.9, 5.1)}, 8, r"'a' needs a frozen distribution of scipy.stats, .* got \(4.9, 5.1\)"),
        ({"a": 5.0}, 8, "got 5.0"),
        ({"a": stats.gamma}, 8, "of 'a' is not frozen"),
        ({"a": stats.norm(1.0, -0.1)}, 8, "of 'a' gives no finite values"),
        (DISTRIBUTIONS, 0, "n must be a whole number of at least 1, got 0"),
        (DISTRIBUTIONS, 8.5, "n must be a whole number of at least 1, got 8.5"),
        (DISTRIBUTIONS, True, "got True"),
    ],
)
def test_what_is_no_plan_is_refused(plan, distributions, n, message):
    with pytest.raises(ValueError, match=message):
        plan(distributions, n, seed=0)


@pytest.mark.parametrize("plan", PLANS)
@pytest.mark.parametrize("seed", [None, -1, 1.5, "a"])
def test_a_plan_without_a_seed_is_refused(plan, seed):
    """With None, the same call would not give the same plan."""
    with pytest.raises(ValueError, match="seed must be a whole number of at least 0, got"):
        plan(DISTRIBUTIONS, 8, seed=seed)


@pytest.mark.parametrize("plan", PLANS)
def test_a_number_of_runs_may_be_written_with_a_point(plan):
    found, expected = (plan(DISTRIBUTIONS, n, seed=3) for n in (8.0, 8))
    np.testing.assert_array_equal(found.values, expected.values)
    assert found.plan == expected.plan


@pytest.mark.parametrize("plan", [sobol_points, saltelli_points])
def test_sobol_points_come_in_powers_of_two(plan):
    with pytest.raises(ValueError, match="power of two for Sobol' points, got 100; take 64 or 128"):
        plan(DISTRIBUTIONS, 100, seed=0)
