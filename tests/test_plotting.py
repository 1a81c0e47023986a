"""What pictures show: the numbers in their lines, and the surface that they draw."""

import matplotlib.pyplot as plt
import netgen.occ as occ
import numpy as np
import pytest
import scipy
from conftest import STEEL, make_bar
from matplotlib.container import BarContainer

from nassim import FRF, RemotePoint, Solid, Superelement, TimeHistory, build_fe_model, craig_bampton, studies
from nassim.base.rigid_motion import rigid_transfer
from nassim.plotting import (
    plot_frf,
    plot_frf_error,
    plot_inspection,
    plot_noise_budget,
    plot_pareto,
    plot_scatter,
    plot_sobol,
    plot_time_history,
    plot_tornado,
    save_figure,
)
from nassim.systems.noise_budget import NoiseBudget


@pytest.fixture(autouse=True)
def _close():
    yield
    plt.close("all")


@pytest.fixture(scope="module")
def bar():
    model = build_fe_model(make_bar(), element_size=0.01, order=2, progress=False)
    return craig_bampton(model, n_modes=2, progress=False)


def delayed(delay, coherence=None, factor=1.0):
    frequency = np.linspace(1.0, 400.0, 400)
    values = factor * np.exp(-2j * np.pi * frequency * delay)
    return FRF(frequency, values[None, None], ("y",), ("u",), coherence, f"late by {delay:g} s")


def test_phase_of_a_delay_falls_without_jumps():
    axes = plot_frf([delayed(5e-3, np.full((1, 400), 0.75), factor=3.0)], output="y", input="u", unit="V/V")
    (magnitude,), (phase,), (coherence,) = (ax.get_lines() for ax in axes)
    frequency = np.linspace(1.0, 400.0, 400)
    assert magnitude.get_xydata() == pytest.approx(np.column_stack([frequency, np.full(400, 3.0)]))
    assert phase.get_xydata() == pytest.approx(np.column_stack([frequency, -360 * 5e-3 * frequency]))
    assert coherence.get_xydata() == pytest.approx(np.column_stack([frequency, np.full(400, 0.75)]))


def test_differences_are_shown_in_per_cent():
    frf, reference = delayed(0.0, np.full((1, 400), 0.9), factor=1.03), delayed(0.0)
    error, incoherence = plot_frf_error([frf], [reference], output="y", input="u")
    assert error.get_lines()[0].get_ydata() == pytest.approx(3.0)
    assert incoherence.get_lines()[0].get_ydata() == pytest.approx(0.1)


def test_signals_stand_over_their_time():
    time = 0.5 + np.arange(5) * 0.1
    history = TimeHistory(time, np.arange(10.0).reshape(2, 5), ("a", "b"), ("V", "m"))
    (axis,) = plot_time_history(history, names=["b"])
    assert axis.get_lines()[0].get_xydata() == pytest.approx(np.column_stack([time, np.arange(5.0, 10.0)]))
    assert axis.get_ylabel() == "b\n[m]"


def test_a_budgets_largest_part_comes_first_and_the_total_last():
    frequency = np.linspace(1.0, 5.0, 5)
    psd = np.array([[[9e-18] * 5, [16e-18] * 5, [0.0] * 5]])
    budget = NoiseBudget(frequency, psd, ("top_x",), ("floor", "dac_noise", "quiet"), ("m",))
    density, cumulative = plot_noise_budget(budget, output="top_x", limit=3e-8)
    assert [line.get_label() for line in cumulative.get_lines()] == [
        "dac noise: 8e-09 m", "floor: 6e-09 m", "quiet: 0 m", "total: 1e-08 m", "limit: 3e-08 m"
    ]  # fmt: skip
    assert density.get_lines()[0].get_ydata() == pytest.approx(4e-9)
    assert density.get_lines()[-1].get_ydata() == pytest.approx(5e-9)
    total = cumulative.get_lines()[3].get_xydata()
    assert total == pytest.approx(np.column_stack([frequency, 5e-9 * np.sqrt(5 - frequency)])[:-1])
    assert density.get_ylabel() == "amplitude density [m/√Hz]"
    with pytest.raises(ValueError, match="unknown output 'y'; known: top_x"):
        plot_noise_budget(budget, output="y")


def test_points_of_a_pareto_plot_are_joined_in_the_order_of_their_cost():
    axis = plot_pareto({"order 2": [(3.0, 0.1, "2 mm"), (1.0, 0.4, "5 mm")]}, "time [s]", "error [-]")
    (line,) = axis.get_lines()
    assert line.get_xydata() == pytest.approx(np.array([[1.0, 0.4], [3.0, 0.1]]))
    assert [(text.get_text(), *text.xy) for text in axis.texts] == [("5 mm", 1.0, 0.4), ("2 mm", 3.0, 0.1)]


def test_what_is_unstable_is_drawn_open():
    """Mode 2, of six springs in a row one of which pushes."""
    omega = 2 * np.pi * np.array([10.0, 20.0, 30.0, 40.0, 50.0, 60.0])
    stiffness = np.diag(np.sign([1, -1, 1, 1, 1, 1]) * omega**2)
    body = Superelement(
        "body", stiffness_matrix=stiffness, mass_matrix=np.eye(6), positions=np.zeros((1, 3)), names=("a",)
    )
    frequencies, _ = plot_inspection({"as read": body})
    stable, unstable = (line for line in frequencies.get_lines() if len(line.get_xdata()))
    assert stable.get_xydata() == pytest.approx(np.array([[k, 10.0 * k] for k in (1, 3, 4, 5, 6)]))
    assert unstable.get_xydata() == pytest.approx(np.array([[2.0, 20.0]]))
    assert (stable.get_markerfacecolor() == "none", unstable.get_markerfacecolor() == "none") == (False, True)


def test_a_figure_is_written_and_closed(tmp_path):
    time = np.arange(5) * 0.1
    axes = plot_time_history(TimeHistory(time, np.zeros((2, 5)), ("a", "b"), ("V", "m")))
    path = save_figure(axes, tmp_path / "new" / "record.png")
    assert path.stat().st_size > 5_000
    assert plt.get_fignums() == []


def test_the_surface_moves_with_the_body(bar):
    """Rigid motions of all coordinates are rigid motions of every point of the surface."""
    motions = np.vstack([*(rigid_transfer(point.position) for point in bar.remote_points), np.zeros((2, 6))])
    expected = np.stack([rigid_transfer(point)[:3] for point in bar.surface.points])
    assert np.allclose(bar.surface_modes @ motions, expected, atol=1e-10)


@pytest.mark.parametrize("order", [2, 3])
def test_the_surface_of_a_cylinder_is_round(order):
    """Midpoints of curved edges lie on the circle, not on its chords."""
    shape = occ.Cylinder(occ.Pnt(0, 0, 0), occ.X, r=0.01, h=0.04)
    shape.name = "rod"
    shape.faces.Min(occ.X).name = "end"
    solid = Solid("rod", shape, {"rod": STEEL}, (RemotePoint("end", "end", np.zeros(3)),))
    points = build_fe_model(solid, element_size=0.006, order=order, progress=False).surface.points
    radius = np.hypot(points[:, 1], points[:, 2])
    outside = (points[:, 0] > 1e-6) & (points[:, 0] < 0.04 - 1e-6)
    assert outside.sum() > 20
    assert np.allclose(radius[outside], 0.01, rtol=2e-3)


@pytest.fixture(scope="module")
def plane():
    """A study of f = 1 + 2 a - 3 b, with c idle, on points whose shares are those of the squares 4 and 9."""
    xr = pytest.importorskip("xarray")
    samples = studies.saltelli_points(dict.fromkeys("abc", scipy.stats.uniform(0, 1)), 256, seed=0)
    a, b, _ = samples.values.T
    data = xr.Dataset({"f_m": ("run", 1 + 2 * a - 3 * b)}, {name: ("run", samples[name]) for name in samples.names})
    data.f_m.attrs["units"] = "m"
    return data


def test_runs_are_dots_and_correlations_their_titles(plane):
    found = studies.correlations(plane)
    rows = plot_scatter(plane, found)
    (line,) = rows[0][1].get_lines()
    assert line.get_xydata() == pytest.approx(np.column_stack([plane.b, plane.f_m]))
    titles = [float(ax.get_title()) for ax in rows[0]]
    assert titles == pytest.approx(found.spearman.values[0], abs=0.006)
    assert (rows[0][0].get_ylabel(), rows[0][2].get_xlabel()) == ("f m\n[m]", "c")


def test_a_tornado_has_the_largest_effect_on_top_and_tells_its_sign(plane):
    """Ninety per cent of the range: 1.8 from low to high a, -2.7 of b, about a mean of 0.5."""
    axis = plot_tornado(studies.linear_effects(plane), result="f_m", unit="m")
    assert [label.get_text() for label in axis.get_yticklabels()] == ["c", "a", "b"]
    low, high = (np.array([bar.get_x() + bar.get_width() for bar in bars]) for bars in axis.containers)
    assert low == pytest.approx([0.5, 0.5 - 0.9, 0.5 + 1.35], abs=0.02)
    assert high == pytest.approx([0.5, 0.5 + 0.9, 0.5 - 1.35], abs=0.02)
    assert axis.get_xlabel() == "f m [m]"
    with pytest.raises(ValueError, match="unknown result 'g'; known: f_m"):
        plot_tornado(studies.linear_effects(plane), result="g")


def test_shares_are_bars_with_their_intervals(plane):
    indices = studies.sobol_indices(plane, n_resamples=50)
    (axis,) = plot_sobol(indices)
    assert [label.get_text() for label in axis.get_yticklabels()] == ["c", "a", "b"]
    total, first = (c for c in axis.containers if isinstance(c, BarContainer))
    assert [bar.get_width() for bar in total] == pytest.approx([0.0, 4 / 13, 9 / 13], abs=0.03)
    assert [bar.get_width() for bar in first] == pytest.approx([0.0, 4 / 13, 9 / 13], abs=0.03)
    segments = np.array(total.errorbar.lines[2][0].get_segments())[:, :, 0]
    assert segments == pytest.approx(indices.total_interval.sel(parameter=["c", "a", "b"]).values[0])


def test_a_figure_of_rows_of_axes_is_written(plane, tmp_path):
    path = save_figure(plot_scatter(plane, studies.correlations(plane)), tmp_path / "scatter.png")
    assert path.stat().st_size > 10_000
