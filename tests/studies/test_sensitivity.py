"""Sensitivities against closed forms: Ishigami's function, a bench's frequency, linear functions."""

import functools
import re
import warnings

import numpy as np
import pytest
import scipy
import xarray as xr
from scipy import stats

from nassim.studies import correlations, latin_hypercube, linear_effects, saltelli_points, sensitivity, sobol_indices


def study(samples, **results):
    """What a sweep gives of functions of the parameters."""
    parameters = {name: ("run", samples[name]) for name in samples.names}
    values = {name: ("run", np.asarray(function(*samples.values.T))) for name, function in results.items()}
    return xr.Dataset(values, {"run": np.arange(len(samples)), **parameters})


def ishigami(x, y, z):
    return np.sin(x) + 7.0 * np.sin(y) ** 2 + 0.1 * z**4 * np.sin(x)


@pytest.fixture(scope="module")
def three_angles():
    return saltelli_points(dict.fromkeys("xyz", stats.uniform(-np.pi, 2 * np.pi)), 2048, seed=1)


def test_ishigami_within_two_hundredths_of_its_closed_form(three_angles):
    """T. Ishigami, T. Homma, Proc. ISUMA (1990), with a = 7 and b = 0.1."""
    found = sobol_indices(study(three_angles, f=ishigami), n_resamples=200).sel(result="f")
    of_x, of_y, together = (
        0.5 * (1 + 0.1 * np.pi**4 / 5) ** 2,
        7**2 / 8,
        0.1**2 * np.pi**8 * (1 / 18 - 1 / 50),
    )
    variance = of_x + of_y + together
    first = np.array([of_x, of_y, 0.0]) / variance
    total = np.array([of_x + together, of_y, together]) / variance
    np.testing.assert_allclose(found.first_order, first, atol=0.02)
    np.testing.assert_allclose(found.total, total, atol=0.02)
    for kind, truth in (("first_order", first), ("total", total)):
        interval = found[f"{kind}_interval"]
        assert np.all(interval.sel(bound="low") <= truth)
        assert np.all(truth <= interval.sel(bound="high"))
        assert np.all(interval.sel(bound="high") - interval.sel(bound="low") < 0.2)


def test_indices_equal_scipys(three_angles):
    data = study(three_angles, f=ishigami, g=lambda x, y, z: x + 2 * y)
    found = sobol_indices(data, n_resamples=2)
    assert found.attrs == {"confidence": 0.95, "n": 2048}
    blocks = np.array([data.f.values, data.g.values]).reshape(2, 5, 2048).swapaxes(0, 1)
    scipys = stats.sobol_indices(func={"f_A": blocks[0], "f_B": blocks[1], "f_AB": blocks[2:]}, n=2048)
    np.testing.assert_allclose(found.first_order, scipys.first_order, atol=1e-12)
    np.testing.assert_allclose(found.total, scipys.total_order, atol=1e-12)


def test_shares_of_a_benchs_frequency_are_those_of_its_logarithm():
    """Of sqrt(k / m) / 2 pi with lognormal k and m: a lognormal of variance a^2 + b^2, whose shares are known.

    E[f | k] goes with exp(a x), so that the shares are (exp(a^2) - 1) / (exp(a^2 + b^2) - 1), and the rest is joint.
    """
    a, b = 0.4, 0.25
    distributions = {"stiffness": stats.lognorm(2 * a, scale=2e6), "mass": stats.lognorm(2 * b, scale=5.0)}
    data = study(saltelli_points(distributions, 4096, seed=0), frequency=lambda k, m: np.sqrt(k / m) / (2 * np.pi))
    found = sobol_indices(data, n_resamples=50).sel(result="frequency")
    whole = np.expm1(a**2 + b**2)
    first = np.array([np.expm1(a**2), np.expm1(b**2)]) / whole
    np.testing.assert_allclose(found.first_order, first, atol=0.01)
    np.testing.assert_allclose(found.total, 1 - first[::-1], atol=0.01)


def test_intervals_hold_the_truth_about_as_often_as_they_say():
    """Of x + 2 y, shares 0.2 and 0.8: random pairs of points, for which the bootstrap's probability is right."""
    held = []
    for seed in range(30):
        a, b = np.random.default_rng(seed).standard_normal((2, 64, 2))
        rows = np.vstack([a, b, np.column_stack([b[:, 0], a[:, 1]]), np.column_stack([a[:, 0], b[:, 1]])])
        data = xr.Dataset({"f": ("run", rows @ [1.0, 2.0])}, {"x": ("run", rows[:, 0]), "y": ("run", rows[:, 1])})
        interval = sobol_indices(data, confidence=0.8, n_resamples=100).total_interval.sel(result="f")
        held.append((interval.sel(bound="low") <= [0.2, 0.8]) & (interval.sel(bound="high") >= [0.2, 0.8]))
    assert 0.65 < np.mean(held) < 0.95


@pytest.mark.filterwarnings("error")
def test_one_parameter_brings_all_and_what_stays_brings_nothing():
    data = study(saltelli_points({"x": stats.norm()}, 64, seed=0), f=lambda x: x, still=lambda x: 0.1 + 0 * x)
    found = sobol_indices(data, n_resamples=20)
    assert found.total.sel(result="f").values == pytest.approx([1.0], abs=0.05)
    assert np.all(np.isnan(found.first_order.sel(result="still")))
    assert np.all(np.isnan(found.total_interval.sel(result="still")))


def test_named_results_alone_are_analysed(three_angles):
    data = study(three_angles, f=ishigami, g=lambda x, y, z: x + 2 * y, h=lambda x, y, z: z)
    for analysis in (functools.partial(sobol_indices, n_resamples=2), correlations, linear_effects):
        assert analysis(data).result.values.tolist() == ["f", "g", "h"]
        named = analysis(data, results=["h", "f"])
        assert named.result.values.tolist() == ["h", "f"]
        assert named.identical(analysis(data[["h", "f"]]))


def test_the_same_seed_gives_the_same_intervals(three_angles):
    data = study(three_angles, f=ishigami)
    first, again, other = (sobol_indices(data, n_resamples=20, seed=seed) for seed in (1, 1, 2))
    assert first.identical(again)
    assert not first.identical(other)


def test_correlations_of_a_linear_function():
    """f = 3 u - 4 v of two uniform parameters: 0.6 and -0.8, and by rank 6 / pi asin(r / 2) of two normal ones."""
    uniform = {"u": stats.uniform(0, 1), "v": stats.uniform(-5, 1), "idle": stats.uniform(0, 1)}
    found = correlations(study(latin_hypercube(uniform, 4000, seed=0), f=lambda u, v, idle: 3 * u - 4 * v))
    np.testing.assert_allclose(found.pearson.sel(result="f"), [0.6, -0.8, 0.0], atol=0.03)
    normal = {"u": stats.norm(2, 1), "v": stats.norm(0, 1)}
    found = correlations(study(latin_hypercube(normal, 4000, seed=0), f=lambda u, v: 3 * u - 4 * v))
    np.testing.assert_allclose(found.spearman.sel(result="f"), 6 / np.pi * np.arcsin([0.3, -0.4]), atol=0.03)


def test_ranks_see_through_bends_and_stray_runs_are_left_out():
    data = study(latin_hypercube({"x": stats.norm()}, 50, seed=0), bent=lambda x: np.exp(5 * x), still=lambda x: 0 * x)
    data.bent[3] = np.nan
    found = correlations(data)
    assert found.spearman.sel(result="bent").values == pytest.approx([1.0])
    kept = np.arange(50) != 3
    pearson = scipy.stats.pearsonr(data.x.values[kept], data.bent.values[kept]).statistic
    assert found.pearson.sel(result="bent").values == pytest.approx([pearson])
    assert found.n_runs.values.tolist() == [49, 50]
    assert np.isnan(found.pearson.sel(result="still", parameter="x"))


def test_effects_are_those_of_the_plane():
    """4 + 3 u - 2 v, u over 10 TPa and v over 0.5 nm of which four fifths count; w idle; no plane explains z^2."""
    distributions = {
        "u": stats.uniform(0, 1e13),
        "v": stats.uniform(7e-9, 0.5e-9),
        "w": stats.uniform(),
        "z": stats.norm(),
    }
    functions = {
        "f": lambda u, v, w, z: 4 + 3e-12 * u - 2e9 * v + 0 * w,
        "bowl": lambda u, v, w, z: z**2,
        "half": lambda u, v, w, z: 1e-12 * u + z**2 * np.sqrt(100 / 24),
        "still": lambda u, v, w, z: 0 * u,
    }
    data = study(latin_hypercube(distributions, 400, seed=0), **functions)
    data.f[:100] = np.nan
    found = linear_effects(data, coverage=0.8)
    np.testing.assert_allclose(found.effect.sel(result="f"), [24, -0.8, 0, 0], atol=0.15)
    np.testing.assert_allclose(found.explained, [1.0, 0.0, 0.5, np.nan], atol=0.1)
    assert float(found["mean"].sel(result="f")) == pytest.approx(float(data.f.mean()))
    slopes = found.effect.sel(result="f").values[:2] / np.ptp(np.quantile([data.u, data.v], [0.1, 0.9], axis=1), axis=0)
    assert slopes == pytest.approx([3e-12, -2e9], rel=1e-10)


def together(own, n=200):
    """u, w, and v that goes along with u: of its variance only a share is its own."""
    drawn = np.random.default_rng(5).normal(size=(n, 3))
    u, rest, w = scipy.linalg.orth(drawn - drawn.mean(axis=0)).T
    v = np.sqrt(1 - own) * u + np.sqrt(own) * rest
    columns = {"u": 2e-3 * u + 1, "v": 5e4 * v, "w": w}
    data = {"f": ("run", 3 * columns["u"] - 1e-4 * columns["v"]), "g": ("run", np.r_[[np.nan] * 9, w[9:]])}
    return xr.Dataset(data, {name: ("run", column) for name, column in columns.items()})


def test_parameters_that_go_together_have_no_effects_of_their_own():
    """Proportional ones: least squares would give each a half, with the plane explaining all."""
    for own in (0.0, 0.9e-8):
        refused_for(together(own), "parameters 'u', 'v' follow from each other in the runs with a", linear_effects)
    refused_for(
        together(0.5).assign_coords(v=lambda data: 7 - 3 * data.u + 1e-6 * data.w),
        "'u', 'v', 'w' follow",
        linear_effects,
    )
    with pytest.warns(UserWarning, match="hardly vary independently"):
        linear_effects(together(1.1e-8), results=["f"])


def test_effects_scatter_by_the_least_own_share():
    with pytest.warns(UserWarning, match=r"'a' 1 %, 'b' 4 %\. Their effects scatter 10 times as much"):
        sensitivity._check_own_shares({"a": 0.01, "b": 0.04, "c": 1.0}, "f")


@pytest.mark.parametrize("own", [0.09, 0.11])
def test_parameters_that_nearly_go_together_are_named_with_how_much(own):
    data = together(own)
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        found = linear_effects(data, results=["f"])
    text = rf"'f'; own shares of their variance: 'u' {100 * own:.2g} %, 'v' {100 * own:.2g} %\. .* scatter 3\.3 times"
    assert [bool(re.search(text, str(each.message))) for each in told] == ([True] if own < 0.1 else [])
    np.testing.assert_allclose(found.own_share.values[0], [own, own, 1.0], rtol=1e-9)
    lost = data.isel(run=[0, 1]).assign(f=("run", [np.nan] * 2)).assign_coords(v=("run", [50.0, -70.0]))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        again = linear_effects(xr.concat([data, lost], "run"), results=["f"])
    np.testing.assert_allclose(again.own_share, found.own_share, rtol=1e-9)  # of runs with a result
    spread = np.ptp(np.quantile([data.u, data.v], [0.05, 0.95], axis=1), axis=0)
    np.testing.assert_allclose(found.effect.values[0], [*(spread * [3, -1e-4]), 0.0], atol=1e-12 * abs(spread[1]))


def test_what_a_sweep_adds_and_what_has_no_number_counts_for_nothing(recwarn):
    """Wall times are no result, and infinite results no numbers; whole numbers are parameters like others.

    Of f = n^2 at 1 ... 4 beside one without end: n - 2.5 and f - 7.5 give 25 / sqrt(5 * 129), and a slope of 5.
    """
    data = xr.Dataset(
        {
            "f": ("run", [1.0, 4.0, 9.0, 16.0, np.inf]),
            "wall_time": ("run", np.arange(5.0)),
            "status": ("run", np.array(["ok"] * 5, object)),
            "pose": (("run", "axis"), np.ones((5, 3))),
        },
        {
            "n": ("run", [1, 2, 3, 4, 100]),
            "still": ("run", np.full(5, 7.0)),
            "name": ("run", list("abcde")),
            "axis": list("xyz"),
        },
    )
    found = correlations(data)
    assert found.result.values.tolist() == ["f"]
    assert found.parameter.values.tolist() == ["n", "still"]
    assert found.n_runs.values.tolist() == [4]
    assert found.pearson.values[0, 0] == pytest.approx(25 / np.sqrt(5 * 129))
    assert found.spearman.values[0, 0] == pytest.approx(1.0)
    effects = linear_effects(data, coverage=1.0)
    assert effects.effect.values[0] == pytest.approx([5 * 99, 0.0])
    assert float(effects["mean"][0]) == 7.5
    assert float(effects.explained[0]) == pytest.approx(25**2 / (5 * 129))
    assert not recwarn.list


def test_truth_values_are_numbers_and_texts_are_told():
    """f = n + 10 b, where b is mostly true at small n: without b, the slope of n would be -3 / 7."""
    n, shut = np.arange(1.0, 7.0), np.array([True, False, True, True, False, False])
    data = xr.Dataset({"f": ("run", n + 10 * shut)}, {"n": ("run", n), "shut": ("run", shut)})
    effects = linear_effects(data, coverage=1.0)
    assert effects.parameter.values.tolist() == ["n", "shut"]
    np.testing.assert_allclose(effects.effect.values[0], [5.0, 10.0], rtol=1e-12)
    assert correlations(data).pearson.values[0, 1] == pytest.approx(np.corrcoef(shut, n + 10 * shut)[0, 1])
    alone = xr.Dataset({"closed": ("run", shut)}, {"n": ("run", n)})
    assert correlations(alone).pearson.values[0, 0] == pytest.approx(np.corrcoef(shut, n)[0, 1])
    named = data.assign_coords(shut=("run", np.where(shut, "shut", "open")))
    with pytest.warns(UserWarning, match="parameters 'shut' are texts and left out"):
        assert linear_effects(named, coverage=1.0).effect.values[0] == pytest.approx([-15 / 7])


def test_a_switch_that_is_rarely_on_keeps_its_part_of_the_plane():
    """f = 10 b, where b is on in two of forty runs, at large x: without b, the slope of x would not be 0."""
    x, on = np.arange(40.0), np.arange(40) >= 38
    data = xr.Dataset({"f": ("run", 10.0 * on)}, {"x": ("run", x), "on": ("run", on)})
    with pytest.warns(UserWarning, match="parameters 'on' are the same in all but a few runs"):
        effects = linear_effects(data, coverage=0.8)
    np.testing.assert_allclose(effects.effect.values, [[0.0, 0.0]], atol=1e-12)
    assert effects.explained.values == pytest.approx([1.0])
    np.testing.assert_allclose(effects.own_share.values[0], 1 - np.corrcoef(x, on)[0, 1] ** 2)
    assert linear_effects(data, coverage=1.0).effect.values[0, 1] == pytest.approx(10.0)


def test_each_parameter_is_ranked_by_itself():
    """Ranks of 1, 2, 4, 8, 7 and of 3, 1, 2, 5, 4: 1 - 6 * (4 + 1 + 1 + 0 + 0) / (5 * 24)."""
    data = xr.Dataset(
        {"f": ("run", [1.0, 2.0, 4.0, 8.0, 7.0])},
        {"x": ("run", [3.0, 1.0, 2.0, 50.0, 4.0]), "y": ("run", [2.5, 3.5, 1.5, 60.0, 0.5])},
    )
    assert correlations(data).spearman.values[0, 0] == pytest.approx(1 - 6 * 6 / 120)


def refused_for(data, message, analysis=sobol_indices, **options):
    with pytest.raises(ValueError, match=message):
        analysis(data, **options)


def test_what_has_no_indices_is_refused():
    data = study(saltelli_points({"x": stats.norm(), "y": stats.norm()}, 8, seed=0), f=lambda x, y: x + y)
    holes = data.copy(deep=True)
    holes.f[[2, 5]] = np.nan
    refused_for(holes, r"2 of 32 runs lack a result \(run 2, 5\); .* or take correlations")
    refused_for(data.isel(run=slice(31)), "the 31 runs are not those of saltelli_points")
    for mixed in (np.r_[1, 0, 2:32], np.r_[0:30, 31, 30]):  # two of the first or the last block change places
        refused_for(data.isel(run=mixed), "not those of saltelli_points")
    refused_for(data.isel(run=slice(None, None, 8)), "the 4 runs are not those of saltelli_points of at least two")
    refused_for(data, "unknown result of one number a run 'g'; known: f", results=["g"])
    refused_for(data, "unknown result of one number a run 'g'; known: f", correlations, results=["g"])
    for analysis in (sobol_indices, correlations, linear_effects):
        refused_for(data, "name at least one result; known: f", analysis, results=[])
        refused_for(data, "result names must be a list of them, got the text 'f'", analysis, results="f")
    assert sobol_indices(data, n_resamples=2.0).sizes["bound"] == 2
    refused_for(data, "seed must be a whole number of at least 0, got None", seed=None)
    for count in (0, 2.5):
        refused_for(data, f"n_resamples must be a whole number of at least 1, got {count}", n_resamples=count)
    refused_for(data, "confidence must lie between 0 and 1, got 95", confidence=95)
    refused_for(data.isel(run=slice(2)), "2 runs have a result 'f'; a correlation needs at least three", correlations)
    refused_for(data.isel(run=slice(3)), "3 runs have a result 'f'; for 2 parameters a plane needs 4", linear_effects)
    refused_for(data, "coverage must lie in 0 ... 1", linear_effects, coverage=0.0)
    refused_for(data.drop_vars(["x", "y"]), "no parameters along 'run'")
    refused_for(data.drop_vars("f"), "no result of one number a run")
