"""What the scripts of studies compute: laws, figures, tables, on runs whose answers are known."""

import functools
import importlib
import json
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import xarray as xr

from models.apa300ml import COARSE, PORTS, APAGeometry, reduced_apa300ml
from nassim import linearize
from nassim.studies import saltelli_points, sweep
from nassim.systems import damping

ROOT = Path(__file__).parent.parent


@pytest.fixture
def script(monkeypatch):
    """Imports a script, or what scripts share, by name."""
    monkeypatch.syspath_prepend(str(ROOT / "scripts"))
    return importlib.import_module


@pytest.fixture
def summary_of(script, tmp_path, monkeypatch):
    """Runs a script here, its studies too, with other functions in the place of some; returns its summary."""

    def run(name, *options, **others):
        module = script(name)
        monkeypatch.setattr(module, "sweep", functools.partial(sweep, executor="serial", progress=False))
        for other, function in others.items():
            monkeypatch.setattr(module, other, function)
        monkeypatch.setattr(sys, "argv", [f"{name}.py", "--output", str(tmp_path), *options])
        module.main()
        return json.loads((tmp_path / "summary.json").read_text())

    return run


def test_tolerances_of_the_actuator_are_those_assumed(script):
    """Means and standard deviations; glue spreads evenly over 10 ... 50 um and 3 ... 7 GPa."""
    tolerances = script("tolerance_study")
    laws = {name: law for name, (law, _) in tolerances.TOLERANCES.items()}
    steel, ceramic = tolerances.STEEL.young_modulus, tolerances.PURE_CERAMIC
    deviations = {
        "arm_thickness": 10e-6,
        **dict.fromkeys(("relief", "hole_diameter", "depth"), 25e-6),
        "steel_modulus": 0.015 * steel,
        "ceramic_modulus": 0.025 * ceramic,
        "glue_thickness": 40e-6 / np.sqrt(12),
        "glue_modulus": 4e9 / np.sqrt(12),
    }
    assert {name: law.std() for name, law in laws.items()} == pytest.approx(deviations)
    drawn = {name: getattr(tolerances.APAGeometry(), name) for name in list(deviations)[:4]}
    means = {**drawn, "steel_modulus": steel, "ceramic_modulus": ceramic, "glue_thickness": 30e-6, "glue_modulus": 5e9}
    assert {name: law.mean() for name, law in laws.items()} == pytest.approx(means)
    assert [laws[name].ppf(share) for name in ("glue_thickness", "glue_modulus") for share in (0, 1)] == pytest.approx(
        [10e-6, 50e-6, 3e9, 7e9]
    )


def test_a_run_of_the_tolerances_draws_and_reads_what_it_says(script, monkeypatch):
    """The actuator's own solid; a body whose modes and figures are written here."""
    tolerances = script("tolerance_study")
    solids = []
    body = SimpleNamespace(
        coordinate_names=("top.uz", "top.uy", "top.ux"),
        eigenmodes=lambda fixed, n: (
            np.array([100.0, 200.0, 300.0]),
            np.array([[0.1, 0.2, -0.9], [-0.8, 0.1, 0.1], [0.1, -0.7, 0.3]]),
        ),
    )
    figures = SimpleNamespace(pole=1.0, zero=2.0, stiffness=3.0, shorted_stiffness=4.0, stroke=-5e-9)
    monkeypatch.setattr(tolerances, "build_fe_model", lambda solid, **mesh: solids.append((solid, mesh)))
    monkeypatch.setattr(tolerances, "craig_bampton", lambda model, **options: body)
    monkeypatch.setattr(tolerances, "actuator_figures", lambda body: figures)
    sizes = {name: law.mean() for name, (law, _) in tolerances.TOLERANCES.items()}
    given = {"steel_modulus": 200e9, "ceramic_modulus": 50e9, "glue_thickness": 40e-6, "glue_modulus": 4e9}
    found = tolerances.apa_figures(**{**sizes, **given}, mesh={"order": 2})
    assert found == pytest.approx(
        {"pole": 1.0, "zero": 2.0, "axial_stiffness": 4.0, "stroke": 5e-9 * 170, "lateral_x": 200.0, "lateral_y": 100.0}
    )
    ((solid, mesh),) = solids
    assert mesh == {"order": 2, "progress": False}
    moduli = {name: material.young_modulus for name, material in solid.materials.items()}
    stacks = dict.fromkeys(("sensor_stack", "actuator_stack_1", "actuator_stack_2"), 50e9)
    # Five layers of 40 um at 4 GPa in line with a spacer of 5 mm of steel.
    spacer = 5e-3 / (5e-3 / 200e9 + 5 * 40e-6 / 4e9)
    assert moduli == pytest.approx({"frame": 200e9, "spacer": spacer, **stacks})


def test_the_spread_of_runs(script, told):
    values = {"pole": ("run", [3.0, np.nan, 1.0, 5.0]), "zero": ("run", [1.0, 1.0, 1.0, 1.0])}
    effects = xr.Dataset({"explained": ("result", [0.25, np.nan])}, {"result": ["pole", "zero"]})
    tables = script("common.study_tables")
    rows = tables.spread(xr.Dataset(values), effects)
    row = {"mean": 3.0, "deviation": np.sqrt(8 / 3), "lowest": 1.0, "highest": 5.0, "explained": 0.25}
    assert rows["pole"] == pytest.approx(row)
    assert rows["zero"]["deviation"] == 0.0
    tables.print_spread("spread", rows)
    assert "pole 3.0 1.6 1.0 5.0 25.0" in told()


@pytest.mark.slow
def test_the_tolerance_study_tells_effects_in_per_cent(summary_of, tmp_path):
    """Of figures in proportion to one parameter: 1.645 deviations up and down, and nine tenths of what glue spreads."""

    def figures(depth, arm_thickness, glue_modulus, *, mesh, **others):
        finer = 1.1 if mesh["order"] == 4 else 1.0
        shares = {"pole": depth, "zero": 1 / arm_thickness, "stroke": glue_modulus, "axial_stiffness": depth**2}
        return {name: finer * share for name, share in {**shares, "lateral_x": depth, "lateral_y": depth}.items()}

    found = summary_of("tolerance_study", "--runs", "64", "--refined", "4", apa_figures=figures)
    assert (found["runs"], found["finished"]) == (64, 64)
    effects = found["effects_percent"]
    depth = 100 * 2 * 1.645 * 25e-6 / APAGeometry().depth
    assert effects["depth"]["pole"] == pytest.approx(depth, rel=0.05)
    assert effects["depth"]["axial_stiffness"] == pytest.approx(2 * depth, rel=0.05)
    assert effects["glue_modulus"]["stroke"] == pytest.approx(100 * 0.9 * 4 / 5, rel=0.03)
    assert effects["arm_thickness"]["zero"] < 0
    assert found["rank_correlations"]["arm_thickness"]["zero"] == pytest.approx(-1.0)
    assert found["figures"]["pole"]["explained"] == pytest.approx(1.0)
    assert found["refined"]["stroke"]["offset_percent"] == pytest.approx(10.0)
    assert {"tornado.png", "scatter.png"} < {path.name for path in tmp_path.iterdir()}


@pytest.mark.slow
def test_a_run_of_the_tolerances_on_a_coarse_mesh(script):
    """All parameters in the middle: near the actuator without glue, which is stiffer and stronger by some per cent."""
    tolerances = script("tolerance_study")
    middle = {name: law.mean() for name, (law, _) in tolerances.TOLERANCES.items()}
    found = tolerances.apa_figures(**middle, mesh={"element_size": 8e-3, "order": 2})
    without = tolerances.actuator_figures(reduced_apa300ml(ports=PORTS, **COARSE, progress=False))
    assert found["axial_stiffness"] == pytest.approx(without.shorted_stiffness, rel=0.03)
    assert found["pole"] == pytest.approx(without.pole, rel=0.03)
    assert 0.5 < found["lateral_x"] / found["lateral_y"] < 2.0


def test_tolerances_of_the_hexapod_are_those_assumed(script):
    """Stiffnesses by 5 %; upper joints by 0.05 mm on struts of 82.5 mm, within one in a hundred."""
    runs = script("common.hexapod_machines")
    assert len(runs.JOINTS) == len(runs.TILTS) == 12
    assert {(law.mean(), law.std()) for law in runs.JOINTS.values()} == {(1.0, 0.05)}
    for law in runs.TILTS.values():
        assert law.mean() == 0.0
        assert law.std() * 82.5e-3 == pytest.approx(0.05e-3, rel=0.011)


def test_a_joint_that_deviates_is_that_joint(script):
    runs = script("common.hexapod_machines")
    drawn, other = ({s.name: s.stiffness for s in runs._hexapod(10.0, d).springs} for d in ({}, {"joint_3_top": 1.5}))
    assert [name for name in drawn if np.any(other[name] != drawn[name])] == ["strut_3/top_joint"]
    np.testing.assert_allclose(other["strut_3/top_joint"], 1.5 * drawn["strut_3/top_joint"])


def test_the_least_damping_is_that_of_slow_motions(script):
    """Below 300 Hz, of one of each pair, and none of what only decays."""
    poles = np.array([-3 + 400j, -3 - 400j, -50 + 100j, -1 + 1900j, -5 + 0j])
    assert script("common.hexapod_machines")._least_damping(poles) == pytest.approx(3 / np.hypot(3, 400))


def test_figures_of_a_hexapod_are_those_of_its_modes_and_its_statics(script, monkeypatch):
    runs = script("common.hexapod_machines")
    push = runs.nominal_push(10.0)
    np.testing.assert_allclose(push, push[0], rtol=1e-6)
    drawn = linearize(runs._hexapod(10.0, {}))
    np.testing.assert_allclose(runs._statics(drawn, runs.own_machine(10.0)) @ push, [0, 0, 1, 0, 0, 0], atol=1e-9)
    soft = {f"joint_{k}_{end}": 0.5 for k in range(1, 7) for end in ("bottom", "top")}
    modes = np.sort(damping(linearize(runs._hexapod(10.0, soft)))[0])
    assert modes[0] < 0.999 * damping(drawn)[0].min()
    monkeypatch.setattr(runs, "_statics", lambda model, machine: np.outer(np.arange(6.0), np.ones(6)))
    found = runs.toleranced(payload_mass=10.0, gain=50.0, sample_rate=1e4, push=np.full(6, 0.5), **soft)
    assert [found[name] for name in ("shift_x", "shift_y", "tilt_x")] == [0.0, 3.0, 9.0]
    assert [found["lowest_mode"], found["highest_mode"]] == pytest.approx([modes[0], modes[5]], rel=1e-6)
    assert set(found) == set(runs.RESULTS)


@pytest.mark.slow
def test_the_largest_stable_gain_parts_what_decays_from_what_grows(script):
    """Turning, which lets motions live longer, or at rest; there a machine without tolerances is that of the grid."""
    runs = script("common.hexapod_machines")
    for rpm in (0.0, 300.0):
        edge = runs.edge(10.0, rpm, sample_rate=1e4)["largest_stable_gain"]
        growth = [runs.damped(10.0, rpm, factor * edge, sample_rate=1e4)["growth"] for factor in (0.99, 1.01)]
        assert growth[0] < 0 < growth[1]
    still, turning = (runs.damped(10.0, rpm, 50.0, sample_rate=1e4) for rpm in (0.0, 300.0))
    assert still["growth"] + 0.3 < turning["growth"] < 0
    drawn = runs.toleranced(payload_mass=10.0, gain=50.0, sample_rate=1e4, push=np.zeros(6))
    assert drawn["damping_ratio"] == pytest.approx(still["damping_ratio"], rel=1e-9)


def test_growth_is_that_of_the_fastest(script, monkeypatch):
    runs = script("common.hexapod_machines")
    poles = np.array([-3 + 400j, 2 + 50j, -8 + 100j])
    machine = SimpleNamespace(closed=lambda plant, gain, leak: SimpleNamespace(poles=lambda: poles))
    monkeypatch.setattr(runs, "_sampled", lambda *given: (machine, None))
    found = runs.damped(10.0, 0.0, 5.0, sample_rate=1e4)
    assert found == pytest.approx({"damping_ratio": -2 / np.hypot(2, 50), "growth": 2.0})


@pytest.mark.slow
def test_the_hexapod_study_tells_shares_and_the_best_that_is_stable(summary_of, script, tmp_path):
    """Gains of 5, 50, 500, 5000, of which two are stable, and more damp more.

    Figures add up from two sources, half of the variance each, but one, their product: all of it by both together.
    """

    def sources(parameters):
        return (parameters["joint_1_top"] - 1) / 0.05, parameters["tilt_2_x"] / 0.6e-3

    def toleranced(*, payload_mass, gain, push, sample_rate, **deviations):
        one, two = sources(deviations)
        return {**dict.fromkeys(runs.RESULTS, one + two), "tilt_x": one * two}

    runs = script("common.hexapod_machines")
    found = summary_of(
        "hexapod_study",
        *("--runs", "64", "--gains", "4", "--speeds", "2"),
        edge=lambda payload_mass, spindle_rpm, sample_rate: {"largest_stable_gain": payload_mass + spindle_rpm},
        damped=lambda payload_mass, spindle_rpm, gain, sample_rate: {
            "damping_ratio": gain / 1000,
            "growth": -1.0 if gain < 100 else 1.0,
        },
        nominal_push=lambda payload_mass: np.zeros(6),
        toleranced=toleranced,
    )
    assert found["largest_damping_ratio"]["10"] == pytest.approx({"0": 0.05, "500": 0.05})
    assert found["largest_stable_gain_per_s"]["25"] == {"0": 25.0, "500": 525.0}
    assert (found["runs"], found["points"], found["failed"]) == (26 * 64, 64, 0)
    for shares in found["shares"].values():
        assert [shares["shift_x"], shares["tilt_x"]] == pytest.approx([0.5, 1.0], abs=0.15)
    independent = sum(sources(saltelli_points(runs.JOINTS | runs.TILTS, 64, seed=0)))[:128]
    row = found["tolerances"]["shift_x"]
    assert [row["mean"], row["highest"]] == pytest.approx([independent.mean(), independent.max()])
    assert {"damping.png", "tolerances.png", "sobol.png"} < {path.name for path in tmp_path.iterdir()}


def test_the_busiest_process_sets_how_many_workers_are_of_use(script):
    """Half a second a run beside none at all: a run of 10 ms suits 0.02 workers, one of a minute 120."""
    readings = iter((100.0, 105.0))
    found = script("benchmark_studies").overhead(10, [lambda: 7.0, lambda: next(readings)], executor="serial")
    assert found["cpu_s"] == pytest.approx(0.5)
    assert [found[f"workers_{label}"] for label in ("10_ms", "1_s", "60_s")] == pytest.approx([0.02, 2.0, 120.0])


def test_processor_time_is_that_of_children_too(script):
    before = script("benchmark_studies").processor_time()
    code = "import time\nwhile time.process_time() < 0.4: pass"
    subprocess.run([sys.executable, "-c", code], check=True)
    assert script("benchmark_studies").processor_time() - before > 0.35


def test_shares_of_groups_add_up_and_their_intervals_as_independent_ones(script, capsys):
    report = script("common.study_tables")
    names = {"result": ["pole", "shift_x"], "parameter": ["a", "b", "c"], "bound": ["low", "high"]}
    total = xr.DataArray([[0.5, 0.2, 0.25], [0.0, 0.1, 0.9]], {n: names[n] for n in ("result", "parameter")})
    interval = xr.DataArray(np.full((2, 3, 2), 0.1), names)
    interval[0, :2] = [[0.47, 0.53], [0.16, 0.24]]
    indices = xr.Dataset({"total": total, "total_interval": interval})
    shares, uncertainties = report.group_shares(indices, {"both": ["a", "b"], "alone": ["c"]})
    assert shares["both"] == pytest.approx({"pole": 0.7, "shift_x": 0.1})
    assert uncertainties["both"] == pytest.approx({"pole": 0.05, "shift_x": 0.0})
    report.print_shares(shares, uncertainties)
    assert capsys.readouterr().out.splitlines()[1:3] == [
        "share of the variance          pole   shift x",
        "both                   0.70 +- 0.05  0.1 +- 0",
    ]


def test_ratios_of_routes_are_taken_within_a_turn(script, monkeypatch):
    """Other work makes the second turn three times slower. On default threads, nassim alone is twice as fast."""
    benchmark, calls = script("benchmark_reduction"), []

    def cost(_, route, *size, environment):
        calls.append(route)
        busy = 3.0 if calls.count("exudyn_ngsolve") in (2, 3) else 1.0  # it ends each half of a turn
        threads = 2.0 if route == "nassim" and environment["NASSIM_THREADS"] is None else 1.0
        wall = busy * {"nassim": 2.0, "limit": 1.0, "exudyn": 12.0, "exudyn_ngsolve": 18.0}[route] / threads
        return {"wall_s": wall, "time_s": 0.5 * wall}

    monkeypatch.setattr(benchmark, "run_in_own_process", cost)
    found = benchmark.in_turns((10.0, 0.1), 2)
    assert [found[threads]["nassim"]["ratio"] for threads in ("one", "default")] == [6.0, 12.0]
    assert found["one"]["limit"]["smallest_ratio"] == found["one"]["limit"]["largest_ratio"] == 12.0
    assert found["one"]["nassim"]["wall_s"] == 4.0  # the median of 2 and 6
    assert found["one"]["exudyn"]["time_s"] == 12.0
    assert benchmark.exponents([{"points": n, "errors_s": 2e-6 * n**2.7} for n in (30, 60, 120)]) == {
        "errors_s": pytest.approx(2.7)
    }
