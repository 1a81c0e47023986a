"""What pictures show: the numbers in their lines, and the surface that they draw."""

from dataclasses import replace

import matplotlib.pyplot as plt
import netgen.occ as occ
import numpy as np
import pytest
import scipy
from arguments import assert_all_tried, table
from conftest import STEEL, make_bar
from matplotlib.container import BarContainer

import nassim.plotting
from nassim import FRF, RemotePoint, Solid, Superelement, TimeHistory, build_fe_model, craig_bampton, studies
from nassim.base.rigid_motion import rigid_transfer
from nassim.identification.modal_fit import ModalFit
from nassim.plotting import (
    plot_frf,
    plot_frf_error,
    plot_inspection,
    plot_modal_fit,
    plot_noise_budget,
    plot_nyquist,
    plot_pareto,
    plot_root_locus,
    plot_scatter,
    plot_singular_values,
    plot_sobol,
    plot_time_history,
    plot_tornado,
    responses,
    save_figure,
)
from nassim.systems.noise_budgets import NoiseBudget
from nassim.systems.root_loci import Optimum, RootLocus


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


def test_responses_without_a_label_are_named_in_legends():
    unnamed, estimate = replace(delayed(0.0), label=""), replace(delayed(0.0, np.ones((1, 400))), label="")
    for several, expected in (
        ([unnamed], ["FRF"]),
        ([unnamed, delayed(1e-3), estimate], ["FRF 1", "late by 0.001 s", "estimated 3"]),
    ):
        axes = plot_frf(several, output="y", input="u", unit="1")
        assert [text.get_text() for text in axes[0].get_legend().get_texts()] == expected
        error = plot_frf_error(several, [delayed(1e-3)] * len(several), output="y", input="u")[0]
        assert [text.get_text() for text in error.get_legend().get_texts()] == expected


def test_models_that_lie_on_each_other_are_both_visible():
    frfs = [delayed(0.0, np.ones((1, 400))), delayed(0.0), delayed(1e-3), delayed(2e-3)]
    axes = plot_frf(frfs, output="y", input="u", unit="1", markers=["late by 0.002 s"])
    for ax in axes[:2]:
        assert [line.get_linestyle() for line in ax.get_lines()] == ["-", "-", "--", "None"]


def test_differences_are_shown_in_per_cent():
    frf, reference = delayed(0.0, np.full((1, 400), 0.9), factor=1.03), delayed(0.0)
    error, incoherence = plot_frf_error([frf], [reference], output="y", input="u")
    assert error.get_lines()[0].get_ydata() == pytest.approx(3.0)
    assert incoherence.get_lines()[0].get_ydata() == pytest.approx(0.1)


def test_a_reference_at_other_frequencies_is_refused():
    later = replace(delayed(0.0), frequency=np.linspace(1.0, 800.0, 400))
    with pytest.raises(ValueError, match=r"'late by 0 s' has other frequencies than 'late by 0.001 s'"):
        plot_frf_error([delayed(1e-3)], [later], output="y", input="u")


def test_the_named_entry_of_several_is_drawn():
    """Of outputs a and b by inputs u and v: b by v, which lies 180 ... 360 degrees ahead, drawn from -180 on."""
    values = np.ones((2, 2, 3), dtype=complex)
    values[1, 1] = 4 * np.exp(1j * np.radians([180, 270, 360]))
    coherence = np.array([[0.2] * 3, [0.7] * 3])
    frf = FRF([1.0, 2.0, 4.0], values, ("a", "b"), ("u", "v"), coherence, "model")
    axes = plot_frf([frf], output="b", input="v", unit="m/V")
    curves = [ax.get_lines()[0].get_ydata() for ax in axes]
    assert curves[0] == pytest.approx(4.0)
    assert curves[1] == pytest.approx(np.array([-180.0, -90.0, 0.0]))
    assert curves[2] == pytest.approx(0.7)
    assert [ax.get_yscale() for ax in axes] == ["log", "linear", "linear"]
    assert {ax.get_xscale() for ax in axes} == {"log"}
    assert [ax.get_ylabel() for ax in axes] == ["magnitude [m/V]", "phase [deg]", "coherence [-]"]
    assert (axes[0].get_title(), axes[2].get_xlabel()) == ("b / v", "frequency [Hz]")
    reference = FRF(frf.frequency, frf.values / (1 + 0.3j), frf.outputs, frf.inputs)
    error, incoherence = plot_frf_error([frf], [reference], output="b", input="v")
    assert error.get_lines()[0].get_ydata() == pytest.approx(30.0)
    assert incoherence.get_lines()[0].get_ydata() == pytest.approx(0.3)


def two_modes(frequency):
    """Output b of two modes whose gains have opposite signs, so that its phase falls to -360 degrees."""
    shares = ((3.0, 50.0, 0.02), (-1.0, 120.0, 0.01))
    return sum(gain * f**2 / (f**2 - frequency**2 + 2j * z * f * frequency) for gain, f, z in shares)


def test_a_fit_is_drawn_over_what_was_recorded():
    """All phases beside that of the fit, whatever their turns; lines that are mostly noise have none."""
    lines = np.linspace(20.0, 200.0, 181)
    residual = 0.1 * np.exp(1j * lines)
    noise = np.array([np.full(181, 9.0), np.where(np.arange(181) < 100, 0.02, 50.0)])
    noise[1, 3] = 100.0
    recorded = FRF(lines, [[0 * lines], [two_modes(lines) + residual]], ("a", "b"), ("u",))
    fit = ModalFit(
        input="u", outputs=("a", "b"), frequency=[50.0, 120.0], damping_ratio=[0.02, 0.01],
        gains=[[1.0, 1.0], [3.0, -1.0]], covariance=np.eye(8), residual_terms=np.zeros((2, 0)), residual_powers=[],
        recorded=recorded, noise=noise, criterion=[0.0], how={},
    )  # fmt: skip
    late = FRF(lines, [[0 * lines], [two_modes(lines) * np.exp(-1j * np.pi / 6)]], ("a", "b"), ("u",), None, "late")
    axes = plot_modal_fit(fit, [late], output="b", unit="m/N")
    dots, own, other = (line.get_xydata() for line in axes[0].get_lines())
    assert dots == pytest.approx(np.column_stack([lines, np.abs(two_modes(lines) + residual)]))
    assert own[:, 1] == pytest.approx(np.abs(two_modes(own[:, 0])))
    assert other[:, 1] == pytest.approx(np.abs(two_modes(lines)))
    dots, own, other = (line.get_xydata() for line in axes[1].get_lines())
    fine = np.linspace(20.0, 200.0, 20001)
    phase = np.degrees(np.unwrap(np.angle(two_modes(fine))))
    assert phase[-1] < -355
    assert own[:, 1] == pytest.approx(np.interp(own[:, 0], fine, phase), abs=0.1)
    assert other[:, 1] == pytest.approx(np.interp(lines, fine, phase) - 30, abs=0.1)
    clear = np.flatnonzero((np.arange(181) < 100) & (np.arange(181) != 3))
    assert dots[:, 0] == pytest.approx(lines[clear])
    beside = np.degrees(np.angle(1 + residual / two_modes(lines)))[clear]
    assert dots[:, 1] == pytest.approx(np.interp(lines[clear], fine, phase) + beside, abs=0.1)
    left, level, _ = (line.get_xydata() for line in axes[2].get_lines())
    assert left[:, 1] == pytest.approx(0.1)
    assert (level[0, 1], level[-1, 1]) == (0.02, 50.0)
    middle = responses._running_median(np.array([1.0, 1.01, 1.03, 1e3]), np.array([5.0, 90.0, 7.0, 8.0]))
    assert middle == (pytest.approx([3.04 / 3, 1e3]), pytest.approx([7.0, 8.0]))
    assert [ax.get_ylabel() for ax in axes] == ["magnitude [m/N]", "phase [deg]", "residual [m/N]"]
    assert axes[2].get_xlabel() == "frequency [Hz]"


def test_models_from_0_hz_on_are_drawn_beside_fits_that_are_infinite_there():
    fit = replace(a_fit(), residual_terms=np.ones((1, 1)), residual_powers=[-2.0])
    model = FRF([0.0, 50.0, 100.0], np.ones((1, 1, 3)), ("b",), ("u",))
    for ax in plot_modal_fit(fit, [model], output="b", unit="m/N")[:2]:
        assert ax.get_lines()[-1].get_xdata() == pytest.approx([50.0, 100.0])


def test_signals_stand_over_their_time():
    time = 0.5 + np.arange(5) * 0.1
    history = TimeHistory(time, np.arange(10.0).reshape(2, 5), ("a", "b"), ("V", "m"))
    (axis,) = plot_time_history(history, names=["b"])
    assert axis.get_lines()[0].get_xydata() == pytest.approx(np.column_stack([time, np.arange(5.0, 10.0)]))
    assert axis.get_ylabel() == "b\n[m]"


@pytest.mark.parametrize(
    ("largest", "unit", "shown", "label"),
    [
        (0.11, "m", 0.11, "m"),
        (-0.09, "m", -90.0, "mm"),
        (2e-6, "m/s", 2.0, "um/s"),
        (9e-7, "N", 900.0, "nN"),
        (3e-12, "rad", 3e-3, "nrad"),
        (2e-6, "V/V", 2e-6, "V/V"),
        (0.0, "m", 0.0, "m"),
    ],
)
def test_small_signals_are_drawn_in_smaller_units(largest, unit, shown, label):
    (axis,) = plot_time_history(TimeHistory([0.0, 1.0, 2.0], [[0.0, largest, 0.1 * largest]], ["a"], [unit]))
    assert axis.get_lines()[0].get_ydata()[1] == pytest.approx(shown)
    assert axis.get_ylabel() == f"a\n[{label}]"


def test_a_budgets_largest_part_comes_first_and_the_total_last():
    frequency = np.linspace(1.0, 5.0, 5)
    psd = np.array([[[9e-18] * 5, [16e-18] * 5, [0.0] * 5]])
    budget = NoiseBudget(frequency, psd, ("top_x",), ("floor", "dac_noise", "quiet"), ("m",))
    density, cumulative = plot_noise_budget(budget, output="top_x", limit=3e-8)
    assert [line.get_label() for line in cumulative.get_lines()] == [
        "dac noise: 8 nm", "floor: 6 nm", "quiet: 0 nm", "total: 10 nm", "limit: 30 nm"
    ]  # fmt: skip
    assert density.get_lines()[0].get_ydata() == pytest.approx(4)
    assert density.get_lines()[-1].get_ydata() == pytest.approx(5)
    total = cumulative.get_lines()[3].get_xydata()
    assert total == pytest.approx(np.column_stack([frequency, 5 * np.sqrt(5 - frequency)])[:-1])
    assert density.get_ylabel() == "amplitude density [nm/√Hz]"
    with pytest.raises(ValueError, match="unknown output 'y'; known: top_x"):
        plot_noise_budget(budget, output="y")


def test_a_budget_of_one_of_several_outputs():
    """Its own order, unit with a prefix and density; a limit above the total is within the picture."""
    psd = np.array([[[4.0] * 3, [1.0] * 3], [[9e-18] * 3, [16e-18] * 3]])
    budget = NoiseBudget(np.array([1.0, 2.0, 3.0]), psd, ("force", "top"), ("one", "other"), ("N", "m"))
    density, cumulative = plot_noise_budget(budget, output="top", limit=1e-6)
    assert [line.get_label().partition(":")[0] for line in cumulative.get_lines()][:2] == ["other", "one"]
    assert density.get_lines()[0].get_ydata() == pytest.approx(4)
    assert cumulative.get_lines()[1].get_ydata() == pytest.approx(3 * np.sqrt([2, 1]))
    assert cumulative.get_ylabel() == "rms above the frequency [nm]"
    assert 1e3 < cumulative.get_ylim()[1] < 1e4
    assert 5 < density.get_ylim()[1] < 50
    assert {density.get_xscale(), density.get_yscale(), cumulative.get_yscale()} == {"log"}


def test_points_of_a_pareto_plot_are_joined_in_the_order_of_their_cost():
    many = plot_pareto({f"order {k}": [(k, 0.1, "2 mm"), (k + 1, 0.05, "1 mm")] for k in range(1, 12)}, "s", "-")
    looks = {(line.get_color(), line.get_marker()) for line in many.get_lines()}
    assert len(looks) == 11
    axis = plot_pareto({"order 2": [(3.0, 0.1, "2 mm"), (1.0, 0.4, "5 mm")]}, "time [s]", "error [-]")
    (line,) = axis.get_lines()
    assert line.get_xydata() == pytest.approx(np.array([[1.0, 0.4], [3.0, 0.1]]))
    assert [(text.get_text(), *text.xy) for text in axis.texts] == [("5 mm", 1.0, 0.4), ("2 mm", 3.0, 0.1)]
    assert (axis.get_xlabel(), axis.get_ylabel()) == ("time [s]", "error [-]")
    assert (axis.get_xscale(), axis.get_yscale()) == ("log", "log")


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


def test_versions_of_a_body_stand_side_by_side():
    """A point on springs along and about all axes but z, where only half of a coupling was written down."""
    stiffness = np.diag([4.0, 4.0, 1.0, 1.0, 1.0, 0.0]) * (2 * np.pi * 10) ** 2
    lopsided = stiffness.copy()
    lopsided[0, 1] = 2 * (2 * np.pi * 10) ** 2
    bodies = {
        name: Superelement(name, stiffness_matrix=k, mass_matrix=np.eye(6), positions=np.zeros((1, 3)), names=("a",))
        for name, k in (("even", stiffness), ("lopsided", lopsided))
    }
    frequencies, residuals = plot_inspection(bodies)
    stable = [line.get_xydata() for line in frequencies.get_lines() if len(line.get_xdata()) == 5]
    assert stable[0][:, 1] == pytest.approx([10, 10, 10, 20, 20])
    assert stable[1][:, 1] == pytest.approx([10, 10, 10, 10 * np.sqrt(3), 10 * np.sqrt(5)])
    assert stable[1][:, 0] - stable[0][:, 0] == pytest.approx(0.2, abs=0.1)
    assert [tick.get_text() for tick in residuals.get_xticklabels()] == ["x", "y", "z", "rx", "ry", "rz"]
    even, other = residuals.containers
    assert [bar.get_height() for bar in even] == pytest.approx([1, 1, 1, 1, 1, 1e-18])
    for k, (left, right) in enumerate(zip(even, other, strict=True)):
        assert k - 0.5 < left.get_x() < left.get_x() + left.get_width() <= right.get_x() + 1e-9
        assert right.get_x() + right.get_width() < k + 0.5


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
    points = build_fe_model(solid, element_size=0.005, order=order, progress=False).surface.points
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
    data.f_m.attrs["units"], data.c.attrs["units"] = "m", "N"
    return data


def test_runs_are_dots_and_correlations_their_titles(plane):
    found = studies.correlations(plane)
    rows = plot_scatter(plane, found)
    (line,) = rows[0][1].get_lines()
    assert line.get_xydata() == pytest.approx(np.column_stack([plane.b, plane.f_m]))
    titles = [float(ax.get_title().removeprefix("rank correlation ")) for ax in rows[0]]
    assert titles == pytest.approx(found.spearman.values[0], abs=0.006)
    assert (rows[0][0].get_ylabel(), rows[0][2].get_xlabel()) == ("f m\n[m]", "c\n[N]")


def test_ranks_of_three_tenths_are_strong():
    xr = pytest.importorskip("xarray")
    data = xr.Dataset({"f": ("run", [0.0, 1.0])}, {name: ("run", [0.0, 1.0]) for name in "ab"})
    ranks = xr.Dataset(
        {"spearman": (("result", "parameter"), [[0.27, -0.33]])}, {"result": ["f"], "parameter": ["a", "b"]}
    )
    weak, strong = plot_scatter(data, ranks)[0]
    assert [ax.title.get_fontweight() == "bold" for ax in (weak, strong)] == [False, True]
    assert weak.get_lines()[0].get_color() != strong.get_lines()[0].get_color()


def test_phases_are_drawn_where_responses_are_three_times_the_noise():
    fit = a_fit()
    share = np.where(np.arange(50) < 20, 0.9, 1.1)
    noisy = replace(fit, noise=np.abs(fit.recorded.values[0]) * share / 3)
    dots = plot_modal_fit(noisy, [], output="b", unit="m/N")[1].get_lines()[0]
    assert dots.get_xdata() == pytest.approx(fit.recorded.frequency[:20])


def test_a_tornado_has_the_largest_effect_on_top_and_tells_its_sign(plane):
    """Ninety per cent of the range: 1.8 from low to high a, -2.7 of b, about a mean of 0.5."""
    axis = plot_tornado(studies.linear_effects(plane), result="f_m", unit="m")
    assert [label.get_text() for label in axis.get_yticklabels()] == ["c", "a", "b"]
    low, high = (np.array([bar.get_x() + bar.get_width() for bar in bars]) for bars in axis.containers)
    assert low == pytest.approx([0.5, 0.5 - 0.9, 0.5 + 1.35], abs=0.02)
    assert high == pytest.approx([0.5, 0.5 + 0.9, 0.5 - 1.35], abs=0.02)
    assert axis.get_xlabel() == "f m [m]"
    assert axis.get_title() == "mean 0.5 m, a linear fit explains 100 %"
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


def test_shares_of_several_results_stand_in_one_order():
    """By the largest total share in any of them; an interval need not lie evenly about its estimate."""
    xr = pytest.importorskip("xarray")
    total = np.array([[0.1, 0.6, 0.5], [0.2, 0.0, 0.9]])
    first = total * [1.0, 0.0, 0.5]
    ends = {"low": -0.01, "high": 0.03}
    axes = ("result", "parameter")
    variables = {"total": (axes, total), "first_order": (axes, first)}
    for name, value in (("total", total), ("first_order", first)):
        variables[f"{name}_interval"] = ((*axes, "bound"), np.stack([value + e for e in ends.values()], axis=-1))
    indices = xr.Dataset(variables, {"result": ["f", "g"], "parameter": ["a", "b", "c"], "bound": list(ends)})
    drawn = plot_sobol(indices)
    assert [label.get_text() for label in drawn[0].get_yticklabels()] == ["a", "b", "c"]
    for ax, row in zip(drawn, (0, 1), strict=True):
        assert ax.get_title() == "fg"[row]
        bars = [c for c in ax.containers if isinstance(c, BarContainer)]
        for container, values in zip(bars, (total, first), strict=True):
            assert [bar.get_width() for bar in container] == pytest.approx(values[row])
            segments = np.array(container.errorbar.lines[2][0].get_segments())[:, :, 0]
            assert segments == pytest.approx(values[row][:, None] + [-0.01, 0.03])
        assert [c.get_label() for c in bars] == ["total", "first order"]
    (alone,) = plot_sobol(indices, results=["f"])
    assert [label.get_text() for label in alone.get_yticklabels()] == ["a", "c", "b"]


def test_a_figure_of_rows_of_axes_is_written(plane, tmp_path):
    path = save_figure(plot_scatter(plane, studies.correlations(plane)), tmp_path / "scatter.png")
    assert path.stat().st_size > 10_000


def a_fit():
    lines = np.linspace(20.0, 200.0, 50)
    recorded = FRF(lines, two_modes(lines)[None, None], ("b",), ("u",))
    return ModalFit(
        input="u", outputs=("b",), frequency=[50.0, 120.0], damping_ratio=[0.02, 0.01], gains=[[3.0, -1.0]],
        covariance=np.eye(6), residual_terms=np.zeros((1, 0)), residual_powers=[], recorded=recorded,
        noise=np.ones((1, 50)), criterion=[0.0], how={},
    )  # fmt: skip


LOCUS = RootLocus(np.array([0.0, 1.0]), np.array([[-1 + 9j, -1 - 9j], [-2 + 9j, -2 - 9j]]), np.array([5j, -5j]))
HISTORY = TimeHistory(np.arange(3.0), np.zeros((1, 3)), ("a",), ("V",))
SIX = Superelement("s", stiffness_matrix=np.eye(6), mass_matrix=np.eye(6), positions=np.zeros((1, 3)), names=("a",))
BUDGET = NoiseBudget(np.array([1.0, 2.0]), np.ones((1, 1, 2)), ("y",), ("n",), ("m",))
IN_A_FIGURE = {
    "frf": lambda _, **into: plot_frf([delayed(0.0)], output="y", input="u", unit="1", **into),
    "frf_error": lambda _, **into: plot_frf_error([delayed(1e-3)], [delayed(0.0)], output="y", input="u", **into),
    "modal_fit": lambda _, **into: plot_modal_fit(a_fit(), [], output="b", unit="m/N", **into),
    "time_history": lambda _, **into: plot_time_history(HISTORY, **into),
    "noise_budget": lambda _, **into: plot_noise_budget(BUDGET, output="y", **into),
    "inspection": lambda _, **into: plot_inspection({"s": SIX}, **into),
    "scatter": lambda plane, **into: plot_scatter(plane, studies.correlations(plane), **into),
    "sobol": lambda plane, **into: plot_sobol(studies.sobol_indices(plane, n_resamples=2), **into),
}
IN_AXES = {
    "pareto": lambda _, **into: plot_pareto({"order 2": [(3.0, 0.1, "2 mm")]}, "s", "-", **into),
    "tornado": lambda plane, **into: plot_tornado(studies.linear_effects(plane), result="f_m", **into),
    "root_locus": lambda _, **into: plot_root_locus(LOCUS, frequency=3.0, **into),
    "nyquist": lambda _, **into: plot_nyquist([delayed(0.0)], **into),
    "singular_values": lambda _, **into: plot_singular_values([delayed(0.0)], unit="-", **into),
}


@pytest.mark.parametrize("name", [*IN_A_FIGURE, *IN_AXES])
def test_pictures_are_drawn_where_they_are_asked_for(plane, name):
    """Half of a figure, or the axes at hand, and nowhere else; by default in a new figure."""
    halves = plt.figure().subfigures(1, 2)
    if name in IN_AXES:
        ax = halves[1].subplots()
        assert IN_AXES[name](plane, ax=ax) is ax
        assert ax.has_data()
    else:
        drawn = np.ravel(np.array(IN_A_FIGURE[name](plane, figure=halves[1]), dtype=object))
        assert set(drawn) <= set(halves[1].axes)
    assert halves[0].axes == []
    assert len(plt.get_fignums()) == 1
    {**IN_A_FIGURE, **IN_AXES}[name](plane)
    assert len(plt.get_fignums()) == 2


@pytest.mark.parametrize(("name", "shown"), [("late by 0.001 s", "late by 0.001 s"), ("", "FRF 2")])
def test_frfs_of_named_labels_are_points(name, shown):
    frfs = [delayed(0.0), replace(delayed(1e-3), label=name)]
    axes = plot_frf(frfs, output="y", input="u", unit="1", markers=[shown])
    for ax in axes:
        assert [(line.get_linestyle(), line.get_marker()) for line in ax.get_lines()] == [("-", "None"), ("None", "o")]
        shown_at = frfs[1].frequency[ax.get_lines()[1].get_markevery()]
        gaps = np.diff(np.log(shown_at[shown_at > 30.0]))  # below, the lines themselves lie farther apart
        assert len(shown_at) < 50
        assert np.ptp(gaps) < 2 * (frfs[1].frequency[1] - frfs[1].frequency[0]) / 30.0


def test_a_root_locus_has_its_branches_zeros_and_optimum_where_they_are():
    """Of the upper half plane over 2 pi, in Hz; what lies beyond 1.1 times the largest frequency is left out."""
    poles = 2 * np.pi * np.array([[-1 + 9j, -1 - 9j, -30 + 0j], [-2 + 8j, -2 - 8j, -11.5 + 0j]])
    locus = RootLocus(np.array([0.0, 3.0]), poles, 2 * np.pi * np.array([-0.5 + 5j, -0.5 - 5j, -4.0, 2.0]))
    axis = plot_root_locus(locus, frequency=10.0, optimum=Optimum(2.0, 0.6, 5.0))
    by_marker = {line.get_marker(): line.get_xydata() for line in axis.get_lines()}
    branches = [line.get_xydata() for line in axis.get_lines() if line.get_marker() == "."]
    assert len(branches) == 2
    for branch in branches:
        assert branch == pytest.approx(np.array([[-1.0, 9.0], [-2.0, 8.0]]))
    places = {"x": [(-1.0, 9.0)], "o": [(-0.5, 5.0), (-4.0, 0.0), (2.0, 0.0)], "*": [(-3.0, 4.0)]}
    for marker, expected in places.items():
        assert by_marker[marker] == pytest.approx(np.array(expected))
    told = [text.get_text() for text in axis.get_legend().get_texts()]
    assert told == [
        "poles at gain 0", "zeros of the open loop", "poles up to gain 3", "gain 2: damping 0.6 at 5 Hz"
    ]  # fmt: skip
    assert len(plot_root_locus(locus, frequency=10.0).get_legend().get_texts()) == 3
    wider = plot_root_locus(locus, frequency=11.0)
    assert sum(line.get_marker() == "." for line in wider.get_lines()) == 3
    rays = [line.get_xydata() for line in axis.get_lines() if line.get_color() == "0.85" and len(line.get_xdata()) == 2]
    ratios = [float(text.get_text()) for text in axis.texts]
    assert ratios == pytest.approx(np.arange(1, 10) / 10)
    for (start, end), ratio in zip(rays, ratios, strict=True):
        assert not np.any(start)
        assert end == pytest.approx([-10.0 * ratio, 10.0 * np.sin(np.arccos(ratio))])


def test_a_nyquist_plot_has_both_halves_of_the_loop_and_the_circle_of_its_modulus():
    loop = delayed(1e-3, factor=0.7)
    ax = plot_nyquist([loop], modulus=0.4)
    above, below = (line.get_xydata() for line in ax.get_lines()[1:3])
    np.testing.assert_allclose(above @ [1, 1j], loop.values[0, 0])
    np.testing.assert_allclose(below @ [1, -1j], loop.values[0, 0])
    circle = ax.patches[0].get_xy()
    np.testing.assert_allclose(np.hypot(circle[:, 0] + 1, circle[:, 1]), 0.4)


def test_singular_values_are_the_largest_and_the_smallest():
    """Of a diagonal matrix whose rows are exchanged, its entries."""
    values = np.zeros((3, 3, 2), complex)
    values[0, 1], values[1, 0], values[2, 2] = [2j, 3.0], [-5.0, 1.0], [0.5, -4.0]
    ax = plot_singular_values([FRF([1.0, 2.0], values, tuple("abc"), tuple("abc"))], unit="m/V")
    assert [list(np.round(line.get_ydata(), 12)) for line in ax.get_lines()] == [[5.0, 4.0], [0.5, 1.0]]
    assert ax.get_ylabel() == "singular values [m/V]"


def markers(axes):
    return tuple(str(line.get_marker()) for line in axes[0].get_lines())


def two_signals(**options):
    history = TimeHistory(np.arange(3.0), np.zeros((2, 3)), ("a", "b"), ("V", "m"))
    return tuple(ax.get_ylabel() for ax in plot_time_history(history, **options))


def shares(**options):
    """Titles of the pictures of two results."""
    xr = pytest.importorskip("xarray")
    axes = ("result", "parameter")
    variables = {name: (axes, np.ones((2, 1))) for name in ("total", "first_order")}
    variables |= {f"{name}_interval": ((*axes, "bound"), np.ones((2, 1, 2))) for name in variables}
    indices = xr.Dataset(variables, {"result": ["f", "g"], "parameter": ["a"]})
    return tuple(ax.get_title() for ax in plot_sobol(indices, **options))


def tornado(**options):
    xr = pytest.importorskip("xarray")
    figures = {name: ("result", [0.5]) for name in ("mean", "explained")}
    effects = xr.Dataset(
        {"effect": (("result", "parameter"), [[1.0]]), **figures}, {"result": ["f"], "parameter": ["a"]}
    )
    return plot_tornado(effects, result="f", **options).get_xlabel()


LATE, NAMES = delayed(1e-3), {"output": "y", "input": "u"}
REFUSED = {
    "no FRF": (lambda: plot_frf([], unit="1", **NAMES), "frfs must hold at least one FRF"),
    "one FRF": (lambda: plot_frf(LATE, unit="1", **NAMES), r"frfs must be a tuple of FRF, got FRF; write \(part,\)"),
    "one reference": (lambda: plot_frf_error([LATE], LATE, **NAMES), "references must be a tuple of FRF"),
    "several signals": (
        lambda: plot_nyquist([FRF([1.0], np.ones((2, 2, 1)), ("x", "y"), ("x", "y"))]),
        "of one signal, got 2: loop_at_a_time",
    ),
    "no radius": (lambda: plot_nyquist([LATE], modulus=0.0), "modulus must be positive, got 0"),
    "few references": (lambda: plot_frf_error([LATE] * 2, [LATE], **NAMES), "one reference per FRF: got 1 for 2"),
    "one model": (lambda: plot_modal_fit(a_fit(), LATE, output="x", unit="1"), "models must be a tuple of FRF"),
    "no signal": (lambda: two_signals(names=[]), "name at least one signal; known: a, b"),
    "a text": (lambda: two_signals(names="ab"), "signal names must be a list of them, got the text"),
    "other signals": (lambda: two_signals(names=["c"]), "unknown signal 'c'; known: a, b"),
    "other outputs": (lambda: plot_noise_budget(BUDGET, output="z"), "unknown output 'z'; known: y"),
    "no body": (lambda: plot_inspection({}), "at least one superelement by its label"),
    "no point": (lambda: plot_pareto({"order 2": []}, "s", "-"), "lines without a point: order 2; leave them out"),
    "no frequency": (lambda: plot_root_locus(LOCUS, frequency=0.0), "frequency must be positive, got 0 Hz"),
    "no result": (lambda: shares(results=[]), "name at least one result; known: f, g"),
    "results in a text": (lambda: shares(results="fg"), "result names must be a list of them, got the text"),
    "other results": (lambda: shares(results=["h"]), "unknown result 'h'; known: f, g"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_cannot_be_drawn_is_refused_before_a_figure_is_made(case):
    call, message = REFUSED[case]
    with pytest.raises(ValueError, match=message):
        call()
    assert not plt.get_fignums()


def are(*expected):
    return lambda *found: found == expected


ARGUMENTS = table(
    {
        "plot_frf": lambda **options: markers(plot_frf([delayed(0.0)], output="y", input="u", unit="1", **options)),
        "plot_noise_budget": lambda **options: len(plot_noise_budget(BUDGET, output="y", **options)[1].get_lines()),
        "plot_nyquist": lambda **options: plot_nyquist([LATE], **options).patches[0].get_label(),
        "plot_root_locus": lambda **options: markers([plot_root_locus(LOCUS, frequency=3.0, **options)])[-3],
        "plot_sobol": shares,
        "plot_time_history": two_signals,
        "plot_tornado": tornado,
    },
    [
        ("plot_frf", "markers", (), ["late by 0 s"], are(("None",), ("o",))),
        ("plot_noise_budget", "limit", None, 2.0, are(2, 3)),
        ("plot_nyquist", "modulus", 0.5, 0.25, are("modulus margin below 0.5", "modulus margin below 0.25")),
        ("plot_root_locus", "optimum", None, Optimum(2.0, 0.6, 5.0), are("o", "*")),
        ("plot_sobol", "results", None, ["g"], are(("f", "g"), ("g",))),
        ("plot_time_history", "names", None, ["b"], are(("a\n[V]", "b\n[m]"), ("b\n[m]",))),
        ("plot_tornado", "unit", "", "m", are("f", "f [m]")),
    ],
)


@pytest.mark.parametrize("case", ARGUMENTS)
def test_an_optional_argument_does_what_it_should(case):
    ARGUMENTS[case].check()


def test_every_optional_argument_is_tried():
    drawn = (*(f"plot_{name}: figure" for name in IN_A_FIGURE), *(f"plot_{name}: ax" for name in IN_AXES))
    there = dict.fromkeys(drawn, "test_plotting.py::test_pictures_are_drawn_where_they_are_asked_for")
    assert_all_tried(nassim.plotting, ARGUMENTS, there)


@pytest.mark.parametrize(
    ("band", "labels"),
    [
        ((60.0, 300.0), ["60", "80", "100", "200", "300"]),
        ((60.0, 95.0), ["60", "80"]),
        ((1.0, 300.0), ["1", "2", "5", "10", "20", "50", "100", "200"]),
        ((0.01, 500.0), ["0.01", "0.1", "1", "10", "100"]),
    ],
)
def test_frequencies_have_plain_numbers(band, labels):
    frequency = np.geomspace(*band, 20)
    frf = FRF(frequency, np.ones((1, 1, 20)), ["y"], ["u"])
    axes = plot_frf([frf], output="y", input="u", unit="m/N")
    axes[-1].figure.canvas.draw()
    low, high = axes[-1].get_xlim()
    shown = [
        text.get_text()
        for x, text in zip(axes[-1].get_xticks(), axes[-1].get_xticklabels(), strict=True)
        if low <= x <= high
    ]
    assert shown == labels
