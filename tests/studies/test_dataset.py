"""The labelled results: every figure beside its run, what differs is told."""

import functools
import warnings

import numpy as np
import pytest
import tiny_functions

from nassim import FRF
from nassim.studies import sweep

quiet = functools.partial(sweep, progress=False, executor="serial")


def test_wall_times_stand_beside_their_runs(tmp_path):
    """Also where the longer one was carried out first."""
    quiet(tiny_functions.sleepy, grid={"duration": [0.5]}, folder=tmp_path)
    found = quiet(tiny_functions.sleepy, grid={"duration": [0.01, 0.5]}, folder=tmp_path)
    assert 0.01 < found.wall_time[0] < 0.5 < found.wall_time[1]


@pytest.mark.parametrize(("order", "shape"), [([5, 8], (2, 3)), ([8, 5], (2,))])
def test_of_equally_frequent_layouts_that_of_the_earlier_run_counts(order, shape):
    found = quiet(tiny_functions.troublesome, grid={"n": order})
    assert found.status.values.tolist() == ["ok", "other shape"]
    assert found.x.shape == shape


def test_real_results_among_complex_ones_are_kept():
    """A pole of a damped oscillator, which is real where the damping is above critical: NumPy's roots tell by type.

    Its results have another order there.
    """

    def pole(ratio):
        root = np.roots([1.0, 2 * ratio, 1.0])[0]
        named = {"pole": root, "size": abs(root), "n": [1] * (2 + (ratio > 2))}
        return named if ratio < 1.3 else dict(reversed(named.items()))

    for order in ([0.1, 0.2, 1.25, 3.0], [3.0, 1.25, 1.25, 0.2]):
        found = quiet(pole, samples={"ratio": order})
        expected = np.array([-r - np.emath.sqrt(r**2 - 1) for r in order])
        assert [s for s, r in zip(found.status.values, order, strict=True) if r != 3.0] == ["ok"] * 3
        assert found.status.values[order.index(3.0)] == "other shape"
        assert found.message.values[order.index(3.0)] == "n is 3, in most runs 2"
        kept = np.array(order) != 3.0
        assert found.pole.dtype.kind == "c"
        left_out = found.pole.values[~kept]
        assert np.isnan([left_out.real, left_out.imag]).all()
        np.testing.assert_allclose(found.pole.values[kept].real, expected[kept].real, rtol=1e-9)
        np.testing.assert_allclose(abs(found.pole.values[kept].imag), abs(expected[kept].imag), rtol=1e-9)
        np.testing.assert_allclose(found["size"].values[kept], abs(expected[kept]), rtol=1e-9)
    found = quiet(pole, samples={"ratio": [1.5, 1.25]})
    assert found.pole.dtype.kind == "f"
    np.testing.assert_allclose(found.pole, [-1.5 - 1.25**0.5, -2.0])


def test_units_of_axes_and_times_are_those_given():
    def response(a):
        return FRF([1.0, 2.0], a * np.ones((1, 1, 2), complex), ("y",), ("u",))

    units = {"frequency": "kHz", "wall_time": "d"}
    for given, expected in (({}, ("Hz", "s")), (units, ("kHz", "d"))):
        found = quiet(response, samples={"a": [3.0]}, units=given)
        assert (found.frequency.attrs["units"], found.wall_time.attrs["units"]) == expected


@pytest.mark.parametrize("seed", [0, 7])
def test_a_studys_seed_is_kept(seed):
    found = quiet(lambda a, seed: a, samples={"a": [3.0]}, seed=seed)
    assert found.attrs["seed"] == seed
    assert "seed" not in quiet(lambda a: a, samples={"a": [3.0]}).attrs


def test_an_axis_that_differs_is_named():
    def response(a):
        return FRF([1.0, 2.0, a], np.ones((1, 1, 3), complex), ("y",), ("u",))

    found = quiet(response, samples={"a": [3.0, 3.0, 4.0]})
    assert found.status.values.tolist() == ["ok", "ok", "other shape"]
    assert found.message.values[2] == "the axis frequency has other values than in most runs"
    assert np.isnan(found.frf[2]).all()
    found = quiet(lambda a: {"x": a} | ({"y": [a]} if a < 4 else {}), samples={"a": [3.0, 3.0, 4.0]})
    assert found.message.values[2] == "y is absent, in most runs 1"


def test_runs_that_diverge_keep_the_numbers_they_have():
    def halfway(a):
        return {"x": [a, np.nan], "y": a}

    with warnings.catch_warnings():
        warnings.simplefilter("error")  # nor is a study without a result told of
        found = quiet(halfway, grid={"a": [3.0]})
    assert found.status.values.tolist() == ["diverged"]
    np.testing.assert_array_equal(found.x, [[3.0, np.nan]])
    assert float(found.y[0]) == 3.0


def test_results_tell_their_seed():
    assert quiet(tiny_functions.noisy, grid={"a": [1.0]}, seed=np.int64(4)).attrs["seed"] == 4
    assert "seed" not in quiet(tiny_functions.product, grid={"a": [1.0]}).attrs


def test_what_is_done_and_what_is_left_is_told(tmp_path, capsys, monkeypatch):
    study = functools.partial(sweep, tiny_functions.troublesome, folder=tmp_path, executor="serial")
    study(grid={"n": [1, 2]})
    study(grid={"n": [1, 2, 3, 8, 9]})
    lines = capsys.readouterr().out.splitlines()
    assert lines[1] == f"  2 of 5 runs are in {tmp_path}"
    assert lines[3] == "  4 runs ok, 1 failed: see the results' status and message"
    study(grid={"n": [1, 5, 8]})
    assert capsys.readouterr().out.splitlines()[-1].startswith("  2 runs ok, 1 other shape:")
    monkeypatch.setattr("sys.stderr.isatty", lambda: True)
    study(grid={"n": [1, 2, 10, 11, 12, 14]})
    assert "4/4 runs" in capsys.readouterr().err


def test_messages_are_short_and_the_folder_has_them_whole(tmp_path):
    def talks(a):
        raise RuntimeError("word " * 1000)

    with pytest.warns(UserWarning, match="no run of the study"):
        found = quiet(talks, grid={"a": [1.0]}, folder=tmp_path)
    assert len(found.message.values[0]) == 300
    assert "word " * 1000 in (tmp_path / "manifest.jsonl").read_text()
