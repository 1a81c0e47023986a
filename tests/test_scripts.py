"""The scripts and the README's code run as they stand, on small problems where they can be made small."""

import contextlib
import importlib
import io
import json
import os
import re
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import netgen.occ as occ
import numpy as np
import pytest
import scipy
import xarray as xr

from models.apa300ml import COARSE, calibration, reduced_apa300ml
from models.apa300ml.stack_volumes import StackFigures
from nassim import FRF, LinearModel, TimeHistory, frequency_response, linearize, load
from nassim.simulation import linearize_closed
from nassim.systems import decentralised, integral_force_feedback
from nassim.viewer import Form, Shape, View, block

ROOT = Path(__file__).parent.parent
SCRIPTS = sorted(p.name for p in (ROOT / "scripts").glob("[a-z]*.py"))


def run(*arguments, cwd=ROOT):
    return subprocess.run(
        [sys.executable, *map(str, arguments)],
        cwd=cwd,
        env={**os.environ, "MPLBACKEND": "Agg"},
        capture_output=True,
        text=True,
        check=False,
    )


@pytest.fixture
def script(monkeypatch):
    """Imports a script, or what scripts share, by name."""
    monkeypatch.syspath_prepend(str(ROOT / "scripts"))
    return importlib.import_module


def too_wide(printed):
    """Lines of more than 100 columns, but for long words (paths), which stay whole."""
    return [line for line in printed.splitlines() if len(line) > 100 and max(map(len, line.split())) < 60]


@pytest.fixture
def run_here(script, tmp_path, monkeypatch, capsys):
    """Runs a script without a process of its own, whose imports take seconds; returns its summary."""

    def run_main(name, *options, output="."):
        folder = tmp_path / output
        monkeypatch.setattr(sys, "argv", [f"{name}.py", "--output", str(folder), *options])
        script(name).main()
        assert too_wide(capsys.readouterr().out) == []
        return json.loads((folder / "summary.json").read_text())

    return run_main


@pytest.fixture
def refused(script, monkeypatch, capsys):
    """Runs a script that ends with status 2; returns the lines that it told."""

    def run_main(name, *options):
        monkeypatch.setattr(sys, "argv", [f"{name}.py", *map(str, options)])
        with pytest.raises(SystemExit) as stop:
            script("common.arguments").run(script(name).main)
        assert stop.value.code == 2
        return capsys.readouterr().err.splitlines()

    return run_main


@pytest.fixture
def coarse_actuators(monkeypatch):
    """Actuators are coarse unless a script says otherwise: reduced once for all scripts and all processes of a run."""
    monkeypatch.setattr(reduced_apa300ml, "__kwdefaults__", reduced_apa300ml.__kwdefaults__ | COARSE)


@pytest.fixture
def children_here(script, monkeypatch):
    """Lets a script do the work of its own processes in this one; `benchmark_reduction` shows that they work."""

    def patch(name):
        module = script(name)
        for variable in ("NASSIM_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
            monkeypatch.setenv(variable, "1")

        def child(_, *arguments):
            with monkeypatch.context() as given, contextlib.redirect_stdout(io.StringIO()) as told:
                given.setattr(sys, "argv", [f"{name}.py", "--child", *map(str, arguments)])
                module.main()
            return json.loads(told.getvalue().splitlines()[-1])

        monkeypatch.setattr(module, "run_in_own_process", child)

    return patch


def assert_drawn(pictures, folder):
    for picture in pictures:
        assert (folder / picture).stat().st_size > 10_000


@pytest.mark.parametrize("name", SCRIPTS)
def test_help(name, script, capsys):
    with pytest.raises(SystemExit) as stop:
        script(Path(name).stem).arguments.parse_args(["--help"])
    assert stop.value.code == 0
    told = capsys.readouterr().out
    assert too_wide(told) == []
    for option in ("--output", "--no-plot"):
        assert option in told


@pytest.mark.parametrize("name", SCRIPTS)
@pytest.mark.parametrize("value", ["-1", "nan", "inf", "text"])
def test_wrong_numbers_are_refused_at_the_start(name, value, script, capsys):
    arguments, common = script(Path(name).stem).arguments, script("common.arguments")
    for action in arguments._actions:
        if action.type in (None, Path, common.writable_folder):
            continue
        option = action.option_strings[0]
        with pytest.raises(SystemExit) as stop:
            arguments.parse_args([option, *[value] * (action.nargs or 1)])
        assert stop.value.code == 2
        (line,) = capsys.readouterr().err.splitlines()
        assert f"{option}: must be a" in line
        assert f"got '{value}'" in line


@pytest.mark.parametrize(
    ("kind", "good", "bad"),
    [
        ("positive", {"1e-9": 1e-9}, ["0", "-0.0", "1,5", ""]),
        ("not_negative", {"0": 0.0, "2.5": 2.5}, ["-1e-9"]),
        ("fraction", {"0": 0.0, "0.999": 0.999}, ["1", "-0.01"]),
    ],
)
def test_limits_of_arguments(kind, good, bad, script):
    read = getattr(script("common.arguments"), kind)
    assert {text: read(text) for text in good} == good
    for text in bad:
        with pytest.raises(script("common.arguments").argparse.ArgumentTypeError, match="must be a number"):
            read(text)


def test_whole_numbers(script):
    read = script("common.arguments").whole(2)
    assert read("2") == 2
    for text in ("1", "2.5", "2.0"):
        with pytest.raises(
            script("common.arguments").argparse.ArgumentTypeError, match="whole number of at least 2, got"
        ):
            read(text)


def test_lists_of_numbers(script):
    common = script("common.arguments")
    read = common.several(common.whole(2))
    assert read("2,30") == [2, 30]
    assert read("") == []
    with pytest.raises(common.argparse.ArgumentTypeError, match="whole number of at least 2, got '1'; all: '4,1'"):
        read("4,1")


def test_exponents_of_known_growth(script):
    """Exact powers; with scatter, the standard error by the normal equations; a cost that vanishes has none."""
    report = script("benchmark_scaling")
    sizes, scatter = np.array([1e3, 4e3, 2e4, 7e4, 3e5]), np.array([0.1, -0.2, 0.15, 0.05, -0.1])
    rows = {
        str(k): {"size": n, "work_s": 2e-4 * n**1.3, "other_s": np.exp(0.7 * np.log(n) + e), "grown_B": k - 1.0}
        for k, (n, e) in enumerate(zip(sizes, scatter, strict=True))
    }
    found = report.exponents(rows)
    assert set(found) == {"work_s", "other_s"}
    assert found["work_s"]["exponent"] == pytest.approx(1.3)
    assert found["work_s"]["cost_of_1"] == pytest.approx(2e-4)
    assert found["work_s"]["std"] == pytest.approx(0.0, abs=1e-7)
    matrix = np.column_stack([np.log(sizes), np.ones(5)])
    values, (rest,), _, _ = np.linalg.lstsq(matrix, 0.7 * np.log(sizes) + scatter, rcond=None)
    spread = np.sqrt(rest / 3 * np.linalg.inv(matrix.T @ matrix)[0, 0])
    assert found["other_s"]["exponent"] == pytest.approx(values[0])
    assert found["other_s"]["std"] == pytest.approx(spread)
    assert report.exponents(dict(list(rows.items())[:2])) == report.exponents({}) == {}


def test_a_picture_of_growth_with_and_without_exponents(script, tmp_path):
    report = script("benchmark_scaling")
    keys = [key for curves in report.CURVES.values() for key in curves]
    rows = {
        kind: {str(n): {"size": n, "grown_B": 1e6, **dict.fromkeys(keys, n)} for n in (1, 2)} for kind in report.CURVES
    }
    rows["nodes"]["4"] = rows["nodes"]["2"] | {"size": 4}
    rows["samples"] = {}
    fits = {kind: report.exponents(rows[kind]) for kind in rows}
    assert {kind for kind, found in fits.items() if found} == {"nodes"}
    report.save_picture(tmp_path / "scaling.png", rows, fits)
    assert (tmp_path / "scaling.png").stat().st_size > 10_000


def test_steps_cost_what_more_of_them_take(script, monkeypatch):
    """A run of 0.5 s and 3 ms a step; only the first input moves."""
    steps = script("benchmark_scaling")
    scene = script("benchmark_scaling").chain(2)
    given = []

    def cpu_time(work, scene, excitation, **options):
        given.append((len(excitation.time), np.any(excitation.values, axis=1).tolist(), options["method"]))
        return None, 0.5 + 3e-3 * (len(excitation.time) - 1)

    monkeypatch.setattr(steps, "cpu_time", cpu_time)
    assert steps.stepped(scene, "exact", 100) == pytest.approx(3000.0)
    assert given == [(101, [True], "exact")] * 3 + [(501, [True], "exact")] * 3


def test_a_ring_of_struts_shares_its_load(script, monkeypatch):
    """Twice as many upright struts side by side give way by half."""
    from models.strut import two_mass_strut

    scenes = script("benchmark_scaling")
    monkeypatch.setattr(scenes, "fe_strut", lambda fidelity, apa: two_mass_strut())
    three, six = (linearize(scenes.ring("linear", None, count)) for count in (3, 6))
    static = [abs(frequency_response(m, [1e-3]).response("strut_0/encoder", "force")[0]) for m in (three, six)]
    assert static[0] == pytest.approx(2 * static[1], rel=1e-6)


def test_output_that_cannot_be_written_is_refused_before_any_work(tmp_path, run_here, monkeypatch, capsys):
    (tmp_path / "taken").write_text("a file")
    monkeypatch.delitem(sys.modules, "run_bench", raising=False)  # a parser takes its name when it is made
    with pytest.raises(SystemExit) as left:
        run_here("run_bench", output="taken/folder")
    printed = capsys.readouterr()
    assert left.value.code == 2
    assert printed.out == ""
    assert printed.err.splitlines() == [
        f"run_bench.py: argument --output: {tmp_path / 'taken'} is a file, not a folder; see --help"
    ]


def test_output_is_tried_and_left_as_it_was(tmp_path, script, monkeypatch):
    common = script("common.arguments")
    assert common.writable_folder(str(tmp_path / "a" / "b")) == tmp_path / "a" / "b"
    assert list(tmp_path.iterdir()) == []

    def refuse(**_):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(common.tempfile, "TemporaryFile", refuse)
    with pytest.raises(common.argparse.ArgumentTypeError, match=r"cannot write to .*b \(Permission denied\)"):
        common.writable_folder(str(tmp_path / "a" / "b"))


@pytest.mark.parametrize(
    ("error", "status", "said"),
    [
        (ValueError("two\nlines"), 2, "script.py: two lines"),
        (RuntimeError("diverged"), 2, "script.py: diverged"),
        (FileNotFoundError("no such file: x"), 2, "script.py: no such file: x"),
        (KeyboardInterrupt(), 130, "script.py: interrupted"),
    ],
)
def test_what_stops_a_script_is_told_in_one_line(error, status, said, script, capsys, monkeypatch):
    monkeypatch.setattr(sys, "argv", ["folder/script.py"])

    def main():
        raise error

    with pytest.raises(SystemExit) as stop:
        script("common.arguments").run(main)
    assert stop.value.code == status
    assert capsys.readouterr().err.strip() == said


def test_errors_of_the_script_itself_keep_their_traceback(script, monkeypatch):
    with pytest.raises(TypeError):
        script("common.arguments").run(lambda: len(3))
    monkeypatch.setattr(sys, "flags", SimpleNamespace(dev_mode=True))
    with pytest.raises(ValueError, match="invalid literal"):
        script("common.arguments").run(lambda: int("x"))


def test_summaries_name_their_command_and_are_plain_json(tmp_path, script, monkeypatch):
    common = script("common.report")
    options = ["--band", "20", "30", "--output", str(tmp_path), "--no-plot", "--seed=3", "a file"]
    monkeypatch.setattr(sys, "argv", ["/somewhere/scripts/identify_damping.py", *options])
    figures = {
        "a_Hz": np.array([1.5, np.nan]),
        "b": np.float64(np.inf),
        "c": {"n": np.int64(3)},
        "d": (True, "x", None),
    }
    common.write_summary(tmp_path / "new", figures)
    text = (tmp_path / "new" / "summary.json").read_text()
    summary = json.loads(text, parse_constant=lambda name: pytest.fail(f"{name} is not JSON"))
    assert summary.pop("command") == "python scripts/identify_damping.py --band 20 30 --seed=3 'a file'"
    assert summary.pop("script_time_s") > 0
    assert summary == {"a_Hz": [1.5, None], "b": None, "c": {"n": 3}, "d": [True, "x", None]}
    assert common.command_line(["s.py", "--output=x", "y"]) == "python scripts/s.py y"


def test_a_report_prints_figures_of_a_summary(script, capsys):
    report = script("common.report")
    summary = {"gain_m_per_V": 2.19e-5, "modes_Hz": [94.9, 876.0], "none": None, "mesh": "5 mm", "n": {"all": 3}}
    report.print_report("{mesh}, {n/all}: {gain_m_per_V*1e6:.2f} um/V, {modes_Hz/1:.0f} Hz, {none:.1f}", summary)
    assert capsys.readouterr().out == "5 mm, 3: 21.90 um/V, 876 Hz, -\n"
    small = {"below": -1e-5, "above": 1e-5, "not_small": -0.02, "unknown": float("nan")}
    report.print_report("{below:.1f} {below:+.0f} {above:+.1f} {not_small*10:.1f} {unknown:.2f}", small)
    assert capsys.readouterr().out == "0.0 0 +0.0 -0.2 -\n"
    with pytest.raises(KeyError, match="gain_V"):
        report.print_report("{gain_V:.1f}", summary)


def test_a_table_prints_rows_of_a_flat_summary(script, capsys):
    report = script("common.report")
    names = ("linear", "full model, 5 kg", "left out")
    summary = report.with_prefix(names[0], {"zero_Hz": 37.4}) | report.with_prefix(names[1], {"zero_Hz": None})
    assert list(summary) == ["linear_zero_Hz", "full_model_5_kg_zero_Hz"]
    report.print_table("V_s/V_a", report.rows_of(summary, names), {"zero [Hz]": "zero_Hz:.2f"})
    assert capsys.readouterr().out.splitlines() == [
        "",
        "V_s/V_a           zero [Hz]",
        "linear                37.40",
        "full model, 5 kg          -",
    ]


def test_rows_across_mappings(script):
    summary = {"fitted": {"a": 1.0, "b": 2.0}, "truth": {"a": 1.5}}
    rows = script("common.report").across(summary, ["a", "b"], ["fitted", "truth"])
    assert rows == {"a": {"fitted": 1.0, "truth": 1.5}, "b": {"fitted": 2.0, "truth": None}}


def test_views_go_on_without_pictures(script, tmp_path, monkeypatch, capsys):
    """Where PyVista is missing, the page is written and one line says what is not."""
    monkeypatch.setitem(sys.modules, "pyvista", None)
    view = View("block", (Shape("block", Form(block((1, 1, 1)))),))
    script("common.views").show(view, tmp_path / "block")
    assert [path.name for path in tmp_path.iterdir()] == ["block.html"]
    assert capsys.readouterr().out.startswith("no block.png: pictures of bodies need PyVista")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "options", "figures", "pictures"),
    [
        (
            "reduce_apa.py",
            ["--order", "2", "--element-size", "12", "--tetrahedra"],
            ["mass_kg", "axial_stiffness_N_per_m", "bottom_clamped_full_Hz"],
            ["mesh_and_remote_points.png", "mesh_and_remote_points.html", "modes.png", "modes.html"],
        ),
        (
            "excitation_study.py",
            ["--duration", "1.5", "--period", "0.5"],
            ["multisine_encoder_magnitude_error_dB", "noise_wall_time_s"],
            ["frf.png"],
        ),
        (
            "hexapod_fidelity.py",
            ["--coarse", "--duration", "0.02"],
            ["exact_frf_error", "ffrf_600_Hz_length_error", "two_masses_exact_us_per_step"],
            [],
        ),
        (
            "active_damping.py",
            ["--coarse", "--duration", "5"],
            ["pole_Hz", "zero_Hz", "optimum_gain_per_s", "trials", "IFF_transmissibility_500_Hz"],
            ["root_locus.png", "frf.png", "isolation.png", "step.png"],
        ),
        (
            "spin_hexapod.py",
            ["--points", "4", "--duration", "1"],
            ["speeds_rpm", "published", "own struts"],
            ["poles.png", "maps.png", "trials_published.png", "published_pure.html"],
        ),
        (
            "nass_budget.py",
            ["--highest", "200"],
            ["modes", "rms", "least_damping", "largest_sensitivity", "spinning"],
            ["budget.png", "sensitivity.png"],
        ),
        (
            "nass_experiment.py",
            [
                "--payloads",
                "50",
                "--speeds",
                "60",
                "--duration",
                "0.5",
                "--sample-rate",
                "5000",
                "--scan-payloads",
                "50",
                "--step",
                "3",
                "--stand",
                "0.1",
                "--amplitude",
                "1e-4",
                "--scan-speed",
                "5e-4",
                "--piece",
                "0.03",
            ],
            [
                "tomography_60_rpm_50_kg_closed_rms_Dy_nm",
                "least_modulus_margin",
                "closed_runs_over_budget",
                "aims",
                "tilt_scan_50_kg_closed_rms_Ry_nrad",
                "translation_scan_50_kg_closed_by_stages_rms_Dz_nm",
                "step_and_turn_scan_50_kg_open_rms_Rx_nrad",
                "step_and_turn_scan_50_kg_closed_settling_s",
                "floating_differences",
            ],
            [
                "tomography.png",
                "spectra.png",
                "shares.png",
                "tomography.html",
                "translation_scan_50_kg.png",
                "tilt_scan_50_kg.png",
                "step_and_turn_scan_50_kg.png",
            ],
        ),
        ("piezo_ports.py", ["--coarse"], ["pair_of_forces_pole_Hz", "ports_sensor_open_zero_Hz"], ["frf.png"]),
        (
            "import_body.py",
            [
                *sorted(map(str, (ROOT / "tests" / "data" / "ansys_listing").glob("*.txt"))),
                "--units",
                "mm-N-t",
                "--repair",
            ],
            ["mass_kg", "rigid_motions_residual", "elastic_after_Hz", "free_Hz"],
            ["inspection.png"],
        ),
        ("speed_vs_error.py", ["--quick"], ["reference", "variants", "modes"], ["pareto.png"]),
        ("speed_vs_error_time.py", ["--quick", "--duration", "0.2"], ["first_mode_Hz", "variants"], ["pareto.png"]),
        (
            "benchmark_reduction.py",
            ["--sizes", "2.5k", "--paper-size", "0", "--points", "2"],
            ["2.5k", "2.5k_speed_ratio_to_exudyn", "points"],
            [],
        ),
        (
            "benchmark_stepping.py",
            ["--steps", "200", "--turns", "1"],
            ["ffrf_limit_us_per_step", "exact_speed_over_peer", "exact_speed_over_ffrf", "trimmed_frf_error"],
            [],
        ),
        ("benchmark_spinning.py", ["--steps", "20", "--turns", "1"], ["reference", "routes"], []),
        (
            "benchmark_signals.py",
            ["--samples", "20000", "--states", "40", "--turns", "1"],
            ["exact_loop_speed_over_peer", "estimate_frf_difference", "identify_modes_limit_s", "memory_B"],
            [],
        ),
        (
            "benchmark_studies.py",
            ["--runs", "4", "--empty-runs", "10", "--processes", "1"],
            ["ratio", "difference", "start_s", "overhead"],
            [],
        ),
        (
            "benchmark_scaling.py",
            ["--nodes", "10", "--struts", "1", "--states", "1", "--samples", "20000"],
            ["exponents", "nodes", "struts", "states", "samples"],
            ["scaling.png"],
        ),
        (
            "benchmark_loaded.py",
            ["--steps", "20", "--turns", "1"],
            ["reduction of the actuator", "step of a blade, present stress", "linear model of the hexapod"],
            [],
        ),
        ("benchmark_export.py", ["--steps", "2000", "--turns", "1"], ["bench", "hexapod"], []),
        (
            "benchmark_stress.py",
            ["--steps", "20", "--turns", "1"],
            ["reduction", "step in ffrf", "step in exact", "memory_B"],
            [],
        ),
        ("benchmark_import.py", ["--repetitions", "1"], ["import nassim", "every public name"], []),
        ("make_blind_record.py", ["--duration", "1"], ["payload_mass_kg", "encoder_gain_2_m_per_V"], []),
        (
            "identification_coverage.py",
            ["--repetitions", "2", "--duration", "4"],
            ["covered_in_percent", "parameters"],
            [],
        ),
    ],
)
@pytest.mark.usefixtures("coarse_actuators")
def test_script_writes_its_results(
    name, options, figures, pictures, run_here, children_here, script, monkeypatch, tmp_path
):
    """All but those that have tests of their own below and in other files."""
    if name in ("benchmark_scaling.py", "speed_vs_error.py"):
        children_here(Path(name).stem)
    if name == "nass_experiment.py":  # steps of the whole machine in floating frames cost much
        for constant, seconds in {"SPIN_UP": 0.1, "CALM": 0.02}.items():
            monkeypatch.setattr(script("nass_experiment"), constant, seconds)
    summary = run_here(Path(name).stem, *options)
    assert summary["command"].split()[:2] == ["python", f"scripts/{name}"]
    for figure in figures:
        assert figure in summary
    assert_drawn(pictures, tmp_path)


@pytest.mark.slow
def test_speed_against_error_of_a_step_file(run_here, script, children_here, tmp_path):
    """Of a wedge, clamped at its thick end; finer elements are better, and a tolerance is kept."""
    children_here("speed_vs_error")
    solid = script("common.hard_solids").make_wedge()
    solid.shape.Scale(occ.Pnt(0, 0, 0), 1e3).WriteStep(str(tmp_path / "wedge.step"))
    points = ["--point=0,7.5,5", "--point=60,7.5,5"]
    summary = run_here("speed_vs_error", "--cad", str(tmp_path / "wedge.step"), *points, "--quick", "--no-plot")
    coarse, tolerance = summary["variants"]
    assert coarse["stiffness_error"] > tolerance["stiffness_error"]
    assert tolerance["estimate"] < 0.1
    assert coarse["estimate"] is None
    height = np.sqrt(10.0 / 0.5)  # the first frequency of a wedge is far above that of a bar of its thin end
    assert summary["reference"][0]["clamped_Hz"][0] > height * 0.1615 * np.sqrt(200e9 / 7800) * 0.5e-3 / 0.06**2


def test_a_cad_file_needs_places_of_its_points(refused):
    assert "needs two --point=X,Y,Z or more" in refused("speed_vs_error", "--cad", "part.step", "--point=0,0,0")[0]
    told = refused("speed_vs_error", "--cad", "part.step", "--point=0,0,0", "--point=0,1")
    assert "--point must be three numbers" in told[0]


@pytest.mark.slow
def test_estimated_against_true_errors_of_two_solids(run_here):
    """Between half and three times, as the page of errors says, and what a tolerance promises is kept."""
    options = ["--solids", "bar,wedge", "--reference", "30000", "--tolerance", "0.03"]
    rows = {row["name"]: row for row in run_here("mesh_accuracy", *options)["rows"]}
    assert len(rows) == 6
    efficiencies = np.array([value for row in rows.values() for value in row["efficiencies"].values()])
    assert len(efficiencies) > 15
    assert np.all((efficiencies > 0.5) & (efficiencies < 3)), rows
    for name in ("bar", "wedge"):
        assert rows[f"{name}, by tolerance"]["true_error"] < 0.03
        assert float(rows[f"{name}, by tolerance"]["gain"]) > 1.5


@pytest.mark.slow
def test_the_main_job_writes_its_results(
    run_here, script, monkeypatch, apa_with_ports, apa_with_ports_condensed, tmp_path
):
    """On the coarse actuator of other tests; continuous integration runs the job as it stands."""
    main_job = script("run_bench")
    monkeypatch.setattr(main_job, "build_fe_model", lambda solid, **mesh: apa_with_ports_condensed.fe_model)
    monkeypatch.setattr(main_job, "condense", lambda model: apa_with_ports_condensed)
    monkeypatch.setattr(main_job, "reduced_apa300ml", lambda ports, condensed: apa_with_ports)
    summary = run_here("run_bench", "--duration", "4", "--gravity")
    for route in ("time_simulation", "full_FE_model"):
        for figure, spacing in (("pole_Hz", 0.01), ("zero_Hz", 0.02)):
            assert summary[f"{route}_{figure}"] == pytest.approx(summary[f"linear_model_{figure}"], rel=spacing)
    assert summary["encoder_magnitude_error_dB"] < 1.0
    assert_drawn(["frf.png", "record.png", "bench.html"], tmp_path)


@pytest.mark.slow
@pytest.mark.usefixtures("coarse_actuators")
def test_routes_are_compared(run_here, script, monkeypatch):
    """Volumes by figures that are written here: they are computed among the tests of models."""
    volumes = StackFigures(*(float(k) for k in range(1, 10)))
    monkeypatch.setattr(script("compare_routes"), "stack_figures", lambda **_: volumes)
    summary = run_here("compare_routes", "--coarse")
    assert [summary[f"volume_stress_{figure}"] for figure in ("zero_Hz", "pole_Hz", "sensor_V_per_V")] == [
        1.0,
        3.0,
        5.0,
    ]
    assert summary["axial_stress_zero_Hz"] == volumes.axial_zero
    assert 1.0 < summary["ports_zero_Hz"] / summary["beam_model_zero_Hz"] < 1.2
    assert summary["beam_model_stroke_m"] == pytest.approx(300e-6, rel=0.2)


def test_calibration_writes_its_results(run_here, monkeypatch):
    """Of an actuator whose figures are powers of its parameters, one of which is fitted."""
    powers = {"pzt_modulus": 0.5, "arm_thickness": 2.0, "pad_fillet": 0.1, "relief": -0.4}
    start = {name: parameter.start for name, parameter in calibration.PARAMETERS.items()}

    def figures(values):
        changed = (start | dict(values)).items()
        factor = np.prod([(value / start[name]) ** powers[name] for name, value in changed])
        return dict.fromkeys(calibration.FIGURES, 1.0) | {"axial_stiffness": 1.8e6 * factor, "frequency_5kg": 95.0}

    circuits = []
    monkeypatch.setattr(calibration, "make_model", lambda **given: circuits.append(given["circuit"]) or figures)
    options = "--to axial_stiffness=1.89e6 --tolerance 4 --circuit open"
    summary = run_here("calibrate_apa", *options.split())
    assert summary["command"] == f"python scripts/calibrate_apa.py {options}"
    assert [summary["circuit"], *circuits] == ["open"] * 3
    assert summary["parameters"] == pytest.approx(start | {"pzt_modulus": 1.05**2 * start["pzt_modulus"]}, rel=1e-4)
    assert summary["relative_deviations"] == pytest.approx({"pzt_modulus": 2 * 0.04}, rel=0.05)
    assert summary["sensitivities"]["axial_stiffness"] == pytest.approx(powers, rel=1e-2)


def test_import_body_puts_a_body_of_two_ends_on_the_bench(tmp_path, run_here):
    from conftest import lattice

    from nassim import craig_bampton
    from nassim.exchange import export_body

    path = export_body(craig_bampton(lattice(), n_modes=12, progress=False), tmp_path / "box.mat")
    summary = run_here("import_body", str(path), "--no-plot")
    assert summary["verdict"] == "ok"
    assert summary["bench_ffrf_Hz"] == pytest.approx(summary["bench_linear_Hz"], rel=1e-6)
    assert summary["bench_ffrf_sag_m"] < 0


def test_import_body_refuses_in_words(tmp_path, refused):
    (tmp_path / "bad.mat").write_bytes(b"no matrices in here")
    (line,) = refused("import_body", tmp_path / "bad.mat", "--output", tmp_path, "--no-plot")
    assert "bad.mat: damaged or of another format" in line


def test_a_race_tells_limits_peers_and_differences(script, monkeypatch):
    """Routes whose times a clock of their own counts: 4 steps in 8 s, with 2 s of start in 3 s; the peer in 40 s."""
    races = script("benchmark_stepping")
    clock = SimpleNamespace(now=0.0)

    def work(seconds, result):
        def run():
            clock.now += seconds
            return np.array(result)

        return run

    def cpu_time(work):
        before = clock.now
        return work(), clock.now - before

    monkeypatch.setattr(races, "cpu_time", cpu_time)
    ours = races.Route(
        work(8.0, [0, 1, 2, 3, 4.4]), 0.25, "true", work(3.0, [0, 1]), limit=work(2.0, []), peer="theirs"
    )
    routes = {
        "ours": ours,
        "theirs": races.Route(work(40.0, [0, 1, 1.5]), 0.25, "true"),
        "true": races.Route(work(1.0, [0, 1, 2, 3, 4]), 0.25, "true"),
    }
    found = races.race(routes, turns=2)
    row = found["ours"]
    assert row["us_per_step"] == pytest.approx(5e6 / 3)
    assert row["speed_over_real_time"] == pytest.approx(0.15)
    assert row["limit_us_per_step"] == pytest.approx(0.5e6)
    assert row["peer_us_per_step"] == pytest.approx(20e6)
    assert row["speed_over_peer"] == pytest.approx(12.0)
    assert row["difference"] == pytest.approx(0.5 / 1.5)
    assert row["encoder_error"] == pytest.approx(0.1)
    assert found["theirs"]["limit_us_per_step"] is found["true"]["difference"] is None
    assert found["theirs"]["encoder_error"] == pytest.approx(0.25)


def test_scans_of_the_end_station_and_what_its_drives_cannot_follow(script):
    """Steps with stands between them that settle where their error does; a turn that is too fast, and no place."""
    experiment = script("nass_experiment")
    at = np.arange(4001) * 1e-3
    scan = experiment.step_and_turn_scan(at, np.radians(10.0), 0.8, 0.4, 1.0)
    assert np.degrees(scan.angle[[1000, 1400, 2199, 2600, 4000]]) == pytest.approx([0, 10, 10, 20, 20], abs=1e-6)
    assert scan.measured[at > 1].sum() == pytest.approx(3000 - 800, abs=3)
    with pytest.raises(ValueError, match=r"path 'spindle_angle': its speed reaches 7.*limit is 6.28 rad/s"):
        experiment.step_and_turn_scan(at, 2 * np.pi, 0.1, 1.95, 1.0)
    with pytest.raises(ValueError, match=r"path 'target.uy': its travel reaches 0.0006 m, but its limit is 0.0005 m"):
        experiment.translation_scan(at, 0.6e-3, 1e-3, 1.0)
    with pytest.raises(ValueError, match=r"path 'tilt_angle': its travel reaches 0.06 rad, but its limit is 0.051 rad"):
        experiment.tilt_scan(10 * at, 0.06, 10e-3, 1.0)
    tilt = experiment.tilt_scan(at, 20e-3, 10e-3, 1.0)
    assert (tilt.follows, np.ptp(tilt.drives["tilt_angle"]) > 5e-3) == ("tilt_angle", True)
    np.testing.assert_array_equal(tilt.targets["ry"], tilt.drives["tilt_angle"])
    with pytest.raises(ValueError, match="do not fit into 3 s"):
        experiment.step_and_turn_scan(at, 0.1, 2.8, 0.4, 1.0)
    later = at[at >= 1.0]
    from common.station_experiments import Experiment

    ringing = 1e-6 * np.exp(-20 * np.maximum(later - np.where(later < 2.2, 1.4, 2.6), 0.0))
    quiet = experiment.TimeHistory(later, np.outer([0, 0, 1, 0, 0, 1], ringing), experiment.POSE)
    found = Experiment(scan, 1.0, "closed", quiet, quiet, None)
    assert experiment.settling_time(found) == pytest.approx(np.log(1e-6 / 1.5e-9) / 20, abs=2e-3)


def test_loops_that_are_unstable_on_all_plants_are_told_before_the_runs(script, monkeypatch):
    experiment = script("nass_experiment")
    from nassim.systems import FamilyMargins, UnstablePole

    unstable = FamilyMargins({}, {"1 kg at 0 rpm": UnstablePole(3.0, 2.0)})
    monkeypatch.setattr(experiment, "family_margins", lambda *_, **__: unstable)
    with pytest.raises(ValueError, match=r"unstable on all plants.*1 kg at 0 rpm, an oscillation at 3 Hz"):
        experiment.schedule_figures({}, [60.0], experiment.arguments.parse_args([]))


def test_the_scatter_of_an_rms_is_that_of_a_mode_under_noise(script):
    """Of the mean square of a mode by 1 / sqrt(z w T), and of its root by half of it; a sine without noise has none."""
    experiment = script("nass_experiment")
    from common.station_experiments import Experiment
    from nassim.systems import NoiseBudget

    ratio, omega = 0.01, 2 * np.pi * 12.0
    frequency = np.sort(np.append(np.linspace(0.01, 500.0, 20001), 12.0 + 12.0 * np.linspace(-0.3, 0.3, 20001)[1:-1]))
    s = 2j * np.pi * np.unique(frequency)
    density = np.abs(1 / (s**2 + 2 * ratio * omega * s + omega**2)) ** 2
    budget = NoiseBudget(np.unique(frequency), np.tile(density, (6, 1, 1)), experiment.POSE, ("floor_x",))
    at = np.linspace(0.0, 20.0, 2001)
    scan = experiment.tomography(at, 60.0, 0.0)
    rms = np.sqrt(budget.total.rms()[:, 0])
    turn = np.arange(64) / 64
    for sine, expected in ((0.0, 0.5 / np.sqrt(ratio * omega * 20.0)), (1e3, 0.0)):
        quiet = experiment.TimeHistory(turn, np.outer(rms, sine * np.sin(6 * np.pi * turn)), experiment.POSE)
        errors = experiment.TimeHistory(at, np.zeros((6, len(at))), experiment.POSE)
        found = Experiment(scan, 1.0, "open", errors, quiet, budget).scatter
        assert found == pytest.approx(expected, rel=0.03, abs=1e-3)


def test_spectra_of_a_file_and_assumed_ones(script, tmp_path):
    spectra = script("nass_budget")
    path = tmp_path / "spectra.csv"
    path.write_text("# of a floor\nfrequency, floor_x\n1, 1e-10\n100, 1e-6\n")
    found = spectra.read_spectra(path, ("floor_x", "runout_x"))
    assert list(found) == ["floor_x"]
    assert found["floor_x"](np.array([10.0])) == pytest.approx(1e-8)
    for text, match in (
        ("frequency, flor_x\n1, 2\n", "unknown input 'flor_x'; known: floor_x"),
        ("1, 2\n3, 4\n", "must name the columns, frequency"),
        ("", "must name the columns"),
        ("frequency, floor_x\n1, two\n", "2 numbers"),
        ("frequency, floor_x\n1\n2, 3\n", "2 numbers"),
    ):
        path.write_text(text)
        with pytest.raises(ValueError, match=match):
            spectra.read_spectra(path, ("floor_x",))
    from common import station_spectra

    frequency = np.linspace(1e-3, 5e3, 2_000_000)
    spectrum = station_spectra.low_passed(3.0, 20.0)(frequency)
    assert np.sqrt(scipy.integrate.trapezoid(spectrum, frequency)) == pytest.approx(3.0, rel=1e-3)
    third = np.linspace(2 ** (-1 / 6), 2 ** (1 / 6), 2000)
    velocity = station_spectra.floor_spectrum(1e-6)(third) / (2 * np.pi * third) ** 2
    assert np.sqrt(scipy.integrate.trapezoid(velocity, third)) == pytest.approx(1e-6, rel=0.01)


@pytest.mark.slow
def test_blind_identification_meets_its_accuracy(run_here, tmp_path):
    """Another seed than the default, with 5 % noise: frequencies to 0.1 %, damping to 5 %, gains to 2 %."""
    summary = run_here("identify_damping", "--seed", "7")
    assert {"damping_ratio_std", "unmodelled_Hz"} <= set(summary)
    assert_drawn(["fit.png"], tmp_path)
    errors = summary["errors_in_percent"]
    assert len(errors) == 10
    for name, error in errors.items():
        limit = 0.1 if name.startswith("frequency") else 5.0 if name.startswith("damping") else 2.0
        assert abs(error) < limit, name


IN_STEPS = ["--damping-ratio", "0.05", "--payload-mass", "1"]
"""A quick end of transients, as integrated steps cost much."""


@pytest.mark.slow
@pytest.mark.parametrize(
    "options",
    [
        ["--settling", "3", "--period", "0.5", "--damping-ratio", "0.02"],
        [*IN_STEPS, "--settling", "1.2", "--period", "0.1", "--method", "linear", "--no-plot"],
    ],
    ids=["exact", "linear"],
)
def test_one_record_of_six_inputs_gives_all_72_responses(options, run_here, tmp_path):
    """10 to 500 Hz: within 0.5 dB and 5 degrees of the linear model, in zeros and faint responses too."""
    summary = run_here("run_hexapod", "--coarse", *options)
    assert {"suspension_Hz", "us_per_step"} <= set(summary)
    drawn = ["sensor_voltage.png", "encoder.png", "machine.png", "machine.html", "hexapod.html"]
    assert_drawn([] if "--no-plot" in options else drawn, tmp_path)
    for kind in ("force_sensors", "encoders"):
        assert summary[f"{kind}_coherent_share"] > 0.99
        assert summary[f"{kind}_magnitude_error_dB"] < 0.5
        assert summary[f"{kind}_phase_error_deg"] < 5.0


@pytest.mark.slow
def test_a_record_in_floating_frames_gives_the_same_responses(run_here, tmp_path):
    """Each of the twelve outputs within 2 % of the exact one, transients included, in zeros and faint responses too.

    A short record will do, since what comes after it is as above. Little voltage: at 0.1 V the strong motions at 10 Hz
    bend the faintest responses by 2 dB, in proportion to it.
    """
    short = [*IN_STEPS, "--settling", "0.05", "--period", "0.05", "--voltage", "0.003"]
    for method in ("exact", "ffrf"):
        run_here("run_hexapod", "--coarse", "--no-plot", *short, "--method", method, output=method)
    exact, found = (load(tmp_path / method / "record.h5") for method in ("exact", "ffrf"))
    assert len(found.names) == 6 + 12
    for name in found.names:
        assert np.std(found[name] - exact[name]) < 0.02 * np.std(exact[name]), name


SHORT, UNSEEN = ["--duration", "0.15"], ["--duration", "0.15", "--no-plot"]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("options", "percent"),
    [
        ([*SHORT, "--method", "exact"], 0.1),
        ([*UNSEEN, "--method", "exact", "--payload-mass", "1", "--corner", "10", "--delay", "2"], 0.1),
        ([*UNSEEN, "--method", "linear"], 3.0),
        ([*UNSEEN, "--method", "ffrf"], 3.0),
    ],
    ids=["exact", "exact, leaky", "linear", "ffrf"],
)
def test_six_loops_damp_six_modes_as_predicted(options, percent, run_here, tmp_path):
    """Three gains up to 0.6 of the optimum, in exact steps as good as equal.

    Integrated steps pass through an output's jump halfway, and the sensors feel half of it at once where the structure
    follows at once: sample time times gain times the sensors' response far above the modes, over two, is 2.4 % here.
    """
    summary = run_here("hexapod_damping", "--coarse", *options)
    assert {"optimum_gain_per_s", "optimum_damping_ratio"} <= set(summary)
    drawn = ["root_locus.png", "plants.png", "compliance.png", "decays.png"]
    assert_drawn([] if "--no-plot" in options else drawn, tmp_path)
    assert len(summary["trials"]) == 3
    for trial in summary["trials"].values():
        assert min(trial["damping_predicted"]) > 3 * summary["least_damping_ratio"]
        for figure in ("damping_{}", "frequency_{}_Hz"):
            simulated, predicted = (trial[figure.format(how)] for how in ("simulated", "predicted"))
            np.testing.assert_allclose(simulated, predicted, rtol=percent / 100)


@pytest.mark.slow
def test_modes_under_load(run_here, tmp_path):
    """All engines have the hexapod's modes under 50 kg; blades stiffen by Southwell's coefficients for a hub."""
    summary = run_here("loaded_modes", "--coarse", "--payloads", "50", "--preloads", "50", "--speeds", "0,50")
    for row in summary["hexapod"].values():
        assert abs(row["ffrf_over_linear_percent"]) < 0.1
        assert -2.5 < row["change_percent"] < -0.9
    pressed, pulled = (summary["bench"][f"50 kg, {force} N"]["loaded_Hz"] for force in ("-50", "+50"))
    assert pressed < summary["bench"]["50 kg"]["loaded_Hz"] < pulled
    still, spun = summary["rotor"].values()
    assert still["loaded_0"] == pytest.approx(still["without_0"], rel=1e-6)
    southwell = (spun["loaded_0"] ** 2 - still["loaded_0"] ** 2) / 50**2
    assert southwell == pytest.approx(1.19 + 1.57 * 0.05 / 0.3, rel=0.06)
    assert {path.name for path in tmp_path.rglob("*.png")} == {"campbell.png", "frf.png"}


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:.*comes to rest rotated")
def test_stress_of_flexures(run_here, tmp_path):
    """A beam's stress in the leaf, Paros and Weisbord's stiffness of the hinge; fillets cost a part of the stroke."""
    summary = run_here("flexure_stress")
    leaf, hinge = summary["leaf"], summary["hinge"]
    assert leaf["stress at a quarter [MPa]"]["difference_percent"] == pytest.approx(0, abs=3)
    assert -15 < leaf["stroke at the limit [mm]"]["difference_percent"] < 0
    assert hinge["stiffness [N m/rad]"]["difference_percent"] == pytest.approx(0, abs=10)
    assert hinge["stress of the neck [MPa]"]["difference_percent"] == pytest.approx(0, abs=5)
    assert hinge["mesh error of the peak [%]"]["elements"] < 5
    assert (tmp_path / "stress.png").exists()


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:.*deformed by")
def test_stress_of_the_actuator(run_here, tmp_path):
    """Forces and voltages add up; the coarse mesh is within a fifth of the converged slots (55.8 and 199 MPa)."""
    summary = run_here("apa_stress", "--coarse")
    assert summary["elongation_100_N_um"] == pytest.approx(100 / 1.79, rel=0.01)
    assert summary["elongation_three_stacks_170_V_um"] == pytest.approx(-304, rel=0.12)
    assert summary["slot_end_100_N_MPa"] == pytest.approx(55.8, rel=0.2)
    assert summary["slot_end_three_stacks_170_V_MPa"] == pytest.approx(199, rel=0.2)
    assert summary["fillet_three_stacks_170_V_MPa"] > 1.4 * summary["fillet_two_stacks_170_V_MPa"]
    assert summary["glued_edge_three_stacks_170_V_verdict"] in ("grows", "unresolved")
    assert (tmp_path / "stress.png").exists()


@pytest.mark.slow
def test_six_loops_damp_what_spins_as_predicted(script):
    """30 ms in floating frames at 60 rpm against the linear model that turns, its loops closed, sample by sample.

    The push is along x and about z, so that the motion along y and about x is all by Coriolis' forces.
    """
    machine, loops, trials = (script(name) for name in ("common.hexapod", "hexapod_damping", "hexapod_damping"))
    given = script("hexapod_damping").arguments.parse_args(["--coarse"])
    six = decentralised(*[integral_force_feedback(1.0, sample_rate=machine.SAMPLE_RATE, corner_frequency=2.0)] * 6)
    push = trials.PULSES[0]

    def looped(method, gain):
        return loops.with_loops(machine.hexapod(given, method=method, spindle_rpm=60.0), six, gain)

    record = trials.decay(looped("ffrf", 200.0), push, method="ffrf", duration=0.03, n_steps=1)
    shape = np.exp(-(((record.time - trials.PULSE_TIME) / trials.PULSE_WIDTH) ** 2))
    held = 0.5 * (shape[1:] + shape[:-1])

    def error(gain):
        model = linearize_closed(looped("exact", gain))
        pushed = sum(model.B[:, model.inputs.index(name)] * size for name, size in push.items())
        states = [np.zeros(len(model.A))]
        for force in held:
            states.append(model.A @ states[-1] + pushed * force)
        predicted = model.C[[model.outputs.index(name) for name in trials.POSE]] @ np.transpose(states)
        return np.abs(predicted - record.values).max(axis=1) / np.abs(record.values).max(axis=1)

    ux, uy, _, rx, ry, rz = error(200.0)
    assert max(ux, ry, rz) < 0.03
    assert max(uy, rx) < 0.1
    assert np.delete(error(0.1), 2).min() > 1.0  # without damping


def test_maps_of_what_spins_hold_the_fastest_growth_and_the_least_damping(script, monkeypatch):
    """Growth is that of all poles, damping that of slow pairs; modes are the six lowest pairs that swing."""
    spin = script("spin_hexapod")
    monkeypatch.setattr(spin, "sampled", lambda plant, sample_rate: plant)
    swings = 2 * np.pi * np.array([9.0, 3.0, 5.0, 4.0, 8.0, 6.0, 7.0])
    still = np.array([*(-1 + 1j * swings), *(-1 - 1j * swings), -20 + 10j, -20 - 10j, -5])

    def closed(plant, gain, leak):
        pair = -gain + 300j
        return SimpleNamespace(poles=lambda: np.array([plant.rpm - 70, pair, pair.conjugate(), -90 + 30j, -1 + 1e5j]))

    machine = SimpleNamespace(
        plant=lambda rpm, parallel: SimpleNamespace(rpm=rpm, poles=lambda: still + 1j * rpm * still.imag), closed=closed
    )
    speeds, gains = np.array([0.0, 75.0, 69.5]), np.array([30.0, 400.0])
    growth, ratio = spin.growth_and_damping(machine, speeds, gains, parallel=True, leak=1.0, sample_rate=1e4)
    np.testing.assert_allclose(growth, [[-1, -1], [5, 5], [-0.5, -0.5]])
    np.testing.assert_allclose(ratio, np.tile([30 / np.hypot(30, 300), 0.8], (3, 1)))
    np.testing.assert_allclose(spin.frequencies(machine, [0.0, 1.0]), np.outer([1, 2], np.arange(3.0, 9.0)))


def test_a_trial_is_long_enough_for_the_poles_of_its_decay(refused):
    assert "--duration must be at least 0.76 s" in "".join(refused("spin_hexapod", "--duration", "0.75"))


def test_what_spins_is_not_simulated_in_small_motion(tmp_path, refused):
    (line,) = refused("hexapod_damping", "--spindle-rpm", "60", "--output", tmp_path / "out")
    said = "argument --spindle-rpm: what turns is simulated in floating frames; add --method ffrf; see --help"
    assert line.partition(": ")[2] == said


def test_errors_of_a_reduction_are_those_of_the_worst_response_and_record(script):
    """Of each response over its own largest value; of records over the largest of all, from the start values on."""
    fidelity = script("hexapod_fidelity")
    wanted = np.array([[[1.0, 2.0 + 0j]], [[30.0j, -40.0]]])
    found = wanted + np.array([[[0.3, 0.0]], [[0.0, -1.0]]])
    assert fidelity.frf_error(found, wanted) == pytest.approx(0.15)
    record = TimeHistory([0.0, 0.1, 0.2], [[5.0, 6.0, 7.0], [1.0, 0.0, -1.5]], ("a", "b"))
    expected = {"a": np.array([0.0, 9.0, 1.0, 9.0, 2.0]), "b": np.array([0.0, 9.0, -1.0, 9.0, -2.0])}
    assert fidelity.record_error(record, expected, ["a", "b"], 2) == pytest.approx(0.25)


def test_noise_of_the_end_station_is_that_of_its_seed_within_its_band(script, monkeypatch):
    """White noise of 1/Hz from 20 to 500 Hz, of which half a second is told by the spectrum to the last line."""
    station = script("common.station_experiments").Station
    monkeypatch.setattr(station, "spectra", lambda self, scene: {"floor": np.ones_like})
    first, again, other = (
        station(10.0, SimpleNamespace(sample_rate=2000.0, seed=seed)).noise(None, 0.5, 20.0) for seed in (1, 1, 2)
    )
    np.testing.assert_array_equal(first.values, again.values)
    assert (first.sample_rate, first.names) == (2000.0, ("floor",))
    for noise in (first, other):
        lines = np.abs(np.fft.rfft(noise.values[0, :1000]))
        frequency = np.fft.rfftfreq(1000, 1 / 2000.0)
        inside = (frequency >= 20.0) & (frequency <= 500.0)
        assert lines[~inside].max() < 1e-9 * lines[inside].min()
    assert np.abs(np.corrcoef(first.values[0], other.values[0])[0, 1]) < 0.3


def test_errors_of_responses_count_where_outputs_are_coherent(script):
    """Two inputs to two outputs, one line of one output in doubt, and another entry 10 % and 10 degrees off."""
    frequency = np.array([10.0, 20.0, 30.0])
    model = LinearModel([[-50.0]], [[1.0, 2.0]], [[3.0], [4.0]], np.zeros((2, 2)), ("a", "b"), ("y", "z"))
    values = frequency_response(model, frequency).values.copy()
    values[0, 1, 2] *= 5.0
    values[1, 0, 1] *= 1.1 * np.exp(1j * np.radians(-10.0))
    coherence = [[1.0, 0.99, 0.5], [0.96, 0.97, 0.98]]
    estimated = FRF(frequency, values, ("y", "z"), ("a", "b"), coherence)
    errors = script("common.responses").frf_errors
    fine = errors(estimated, model, ["y"], least_coherence=0.95)
    assert fine["coherent_share"] == pytest.approx(2 / 3)
    assert max(fine["magnitude_error_dB"], fine["phase_error_deg"]) < 1e-9
    both = errors(estimated, model, ["z", "y"], least_coherence=0.95)
    assert both["coherent_share"] == pytest.approx(5 / 6)
    assert both["magnitude_error_dB"] == pytest.approx(20 * np.log10(1.1))
    assert both["phase_error_deg"] == pytest.approx(10.0)
    assert errors(estimated, model, ["y"], least_coherence=1.0)["phase_error_deg"] is None


def test_a_finer_mesh_is_compared_with_the_coarse_one(script):
    """Changes of 1 % that come out as 1.2 % on a mesh that gives 5 % less, of runs of which one failed."""
    tables = script("common.study_tables")
    change = np.array([0.0, 0.01, -0.02, 0.01, 0.03])
    coarse = xr.Dataset({"pole": ("run", 100 * (1 + change))})
    fine = xr.Dataset({"pole": ("run", 95 * (1 + 1.2 * change[:4]))})
    fine.pole[1] = np.nan
    row = tables.refinement(coarse, fine, ["pole"])["pole"]
    assert row["offset_percent"] == pytest.approx(-5.0, abs=0.1)
    assert row["slope"] == pytest.approx(1.2, rel=0.01)
    assert row["left_over_percent"] < 1e-9
    table = xr.DataArray([[1.0, 2.0], [3.0, 4.0]], {"mass": [5.0, 7.5], "name": ["a", "b"]}, ("mass", "name"))
    assert tables.labelled(table) == {"5": {"a": 1.0, "b": 2.0}, "7.5": {"a": 3.0, "b": 4.0}}


def test_glue_and_ceramic_are_as_soft_as_the_ceramic_that_stands_for_both(script):
    """In line, per area: three stacks of 20 mm, a spacer of 5 mm, five layers of 30 um."""
    tolerances = script("tolerance_study")
    solid = tolerances.make_apa300ml()
    nominal = tolerances._glued(solid, 5 * 30e-6 / 5e9).materials["spacer"]
    softness = 60e-3 / tolerances.PURE_CERAMIC + 5e-3 / nominal.young_modulus
    expected = 60e-3 / tolerances.PZT.young_modulus + 5e-3 / tolerances.STEEL.young_modulus
    assert softness == pytest.approx(expected, rel=1e-12)
    assert nominal.density == tolerances.STEEL.density
    assert tolerances.PZT.young_modulus < tolerances.PURE_CERAMIC


@pytest.mark.parametrize(("turn", "along"), [("x", (0, -1, 0)), ("y", (1, 0, 0))])
def test_a_strut_that_leans_moves_its_upper_joint_only(turn, along, script):
    """By a turn of a milliradian about its own x: 82 um along its own -y; about y: along x."""
    runs = script("common.hexapod_machines")
    drawn, leaning = (runs._hexapod(10.0, deviations) for deviations in ({}, {f"tilt_2_{turn}": 1e-3}))
    for k in runs.SIX:
        foot, head = (
            leaning.point_position(f"strut_{k}/{end}.end") - drawn.point_position(f"strut_{k}/{end}.end")
            for end in ("bottom", "top")
        )
        expected = 82.5e-6 * runs.strut_frames(runs.NANO_HEXAPOD)[k - 1] @ along if k == 2 else np.zeros(3)
        np.testing.assert_allclose(foot, 0.0, atol=1e-12)
        np.testing.assert_allclose(head, expected, atol=0.1e-6)


def test_damping_of_known_decays(script):
    """Six modes, two of them alike, from two decays beside faster motions."""
    trials = script("hexapod_damping")
    poles = np.array([-20 + 400j, -20 + 400j, -30 + 500j, -60 + 800j, -61 + 801j, -80 + 900j])
    rng = np.random.default_rng(1)
    time = np.arange(3001) / 1e4
    reads = rng.standard_normal((6, 6))
    records = []
    for _ in range(2):
        start = rng.standard_normal(6) + 1j * rng.standard_normal(6)
        values = (reads @ (start[:, None] * np.exp(np.outer(poles, time)))).real + np.outer(
            rng.standard_normal(6), np.exp(-300 * time) * np.cos(1600 * time)
        )
        records.append(TimeHistory(time, values, trials.POSE))
    found = trials.trial(records, poles * [1.01, 1.01, 1.0, 1.0, 1.0, 1.0])
    np.testing.assert_allclose(found["damping_simulated"], -poles.real / np.abs(poles), rtol=1e-6)
    np.testing.assert_allclose(found["frequency_simulated_Hz"], np.abs(poles) / (2 * np.pi), rtol=1e-6)
    assert found["largest_difference_percent"] < 1e-3
    assert found["most_predicted"] == pytest.approx(80 / abs(poles[-1]))


def test_identification_that_fails_writes_nothing(tmp_path, refused):
    record = tmp_path / "record.csv"
    rows = "\n".join(f"{1e-3 * k:.3f}, {k % 7}, {k % 5}, {k % 3}" for k in range(2000))
    record.write_text("time [s], actuator_voltage [V], sensor_voltage [V], encoder [um]\n" + rows)
    (line,) = refused("identify_damping", record, "--output", tmp_path / "out", "--band", "600", "700")
    assert "band 600 ... 700 Hz must ascend within" in line
    assert not (tmp_path / "out").exists()


def readme_blocks(language):
    return re.findall(rf"```{language}\n(.*?)```", (ROOT / "README.md").read_text(encoding="utf-8"), re.S)


def test_quick_start_has_exactly_two_commands():
    lines = readme_blocks("bash")[0].strip().splitlines()
    assert len(lines) == 2
    assert "run_bench.py" in lines[0]
    assert "pytest" in lines[1]


@pytest.mark.slow
@pytest.mark.usefixtures("coarse_actuators")
def test_the_readmes_tour_works_when_pasted(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    exec("\n".join(readme_blocks("python")), {"__name__": "__main__"})
    assert Path("modes.html").exists()
