"""The scripts and the README's code run as they stand, on small problems where they can be made small."""

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

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


@pytest.mark.parametrize("name", SCRIPTS)
def test_help(name):
    result = run(f"scripts/{name}", "--help")
    assert result.returncode == 0, result.stderr
    for option in ("--output", "--no-plot"):
        assert option in result.stdout


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "options", "figures", "pictures"),
    [
        (
            "reduce_apa.py",
            ["--order", "2", "--element-size", "8"],
            ["mass_kg", "axial_stiffness_N_per_m", "bottom_clamped_full_Hz"],
            ["mesh_and_remote_points.png", "modes.png"],
        ),
        (
            "run_bench.py",
            ["--duration", "2", "--gravity"],
            ["linear_model_pole_Hz", "full_FE_model_zero_Hz", "encoder_magnitude_error_dB"],
            ["frf.png", "record.png"],
        ),
        (
            "excitation_study.py",
            ["--duration", "1.5", "--period", "0.5"],
            ["multisine_encoder_magnitude_error_dB", "noise_wall_time_s"],
            ["frf.png"],
        ),
        (
            "calibrate_apa.py",
            [
                "--coarse-size",
                "12",
                "--element-size",
                "12",
                "--order",
                "2",
                "--to",
                "axial_stiffness=1.85e6",
                "--tolerance",
                "4",
            ],
            ["parameters", "relative_deviations", "sensitivities"],
            [],
        ),
        (
            "active_damping.py",
            ["--coarse", "--duration", "5"],
            ["optimum_gain_per_s", "trials", "IFF_transmissibility_500_Hz"],
            ["root_locus.png", "frf.png", "isolation.png", "step.png"],
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
            ["--sizes", "2.5k", "--paper-size", "0"],
            ["2.5k", "2.5k_speed_ratio_to_exudyn"],
            [],
        ),
        (
            "benchmark_stepping.py",
            ["--steps", "200", "--turns", "1"],
            ["ffrf_us_per_step", "exact_speed_over_ffrf", "trimmed_frf_error"],
            [],
        ),
        (
            "identification_coverage.py",
            ["--repetitions", "2", "--duration", "4"],
            ["covered_in_percent", "parameters"],
            [],
        ),
        ("identify_damping.py", [], ["damping_ratio_std", "unmodelled_Hz", "errors_in_percent"], ["fit.png"]),
    ],
)
def test_script_writes_its_results(name, options, figures, pictures, tmp_path):
    result = run(f"scripts/{name}", "--output", tmp_path, *options)
    assert result.returncode == 0, result.stderr
    summary = json.loads((tmp_path / "summary.json").read_text())
    for figure in figures:
        assert figure in summary
    for picture in pictures:
        assert (tmp_path / picture).stat().st_size > 10_000


def test_import_body_puts_a_body_of_two_ends_on_the_bench(tmp_path):
    from conftest import lattice

    from nassim import craig_bampton
    from nassim.export import export_body

    path = export_body(craig_bampton(lattice(), n_modes=12, progress=False), tmp_path / "box.mat")
    result = run("scripts/import_body.py", path, "--output", tmp_path, "--no-plot")
    assert result.returncode == 0, result.stderr
    summary = json.loads((tmp_path / "summary.json").read_text())
    assert summary["verdict"] == "ok"
    assert summary["bench_ffrf_Hz"] == pytest.approx(summary["bench_linear_Hz"], rel=1e-6)
    assert summary["bench_ffrf_sag_m"] < 0


def test_import_body_refuses_in_words(tmp_path):
    (tmp_path / "bad.mat").write_bytes(b"no matrices in here")
    result = run("scripts/import_body.py", tmp_path / "bad.mat", "--output", tmp_path, "--no-plot")
    assert result.returncode == 1
    assert "bad.mat: damaged or of another format" in result.stderr
    assert "Traceback" not in result.stderr


@pytest.mark.slow
def test_blind_identification_meets_its_accuracy(tmp_path):
    """Another seed than the default, with 5 % noise: frequencies to 0.1 %, damping to 5 %, gains to 2 %."""
    result = run("scripts/identify_damping.py", "--output", tmp_path, "--seed", "7", "--no-plot")
    assert result.returncode == 0, result.stderr
    errors = json.loads((tmp_path / "summary.json").read_text())["errors_in_percent"]
    assert len(errors) == 10
    for name, error in errors.items():
        limit = 0.1 if name.startswith("frequency") else 5.0 if name.startswith("damping") else 2.0
        assert abs(error) < limit, name


def test_identification_that_fails_writes_nothing(tmp_path):
    record = tmp_path / "record.csv"
    rows = "\n".join(f"{1e-3 * k:.3f}, {k % 7}, {k % 5}, {k % 3}" for k in range(2000))
    record.write_text("time [s], actuator_voltage [V], sensor_voltage [V], encoder [um]\n" + rows)
    result = run("scripts/identify_damping.py", record, "--output", tmp_path / "out", "--band", "600", "700")
    assert result.returncode == 1
    assert "band 600 ... 700 Hz must ascend within" in result.stderr
    assert "Traceback" not in result.stderr
    assert not (tmp_path / "out").exists()


def readme_blocks(language):
    return re.findall(rf"```{language}\n(.*?)```", (ROOT / "README.md").read_text(encoding="utf-8"), re.S)


def test_quick_start_has_exactly_two_commands():
    lines = readme_blocks("bash")[0].strip().splitlines()
    assert len(lines) == 2
    assert "run_bench.py" in lines[0]
    assert "pytest" in lines[1]


@pytest.mark.slow
def test_the_readmes_tour_works_when_pasted(tmp_path):
    script = tmp_path / "tour.py"
    script.write_text("\n".join(readme_blocks("python")), encoding="utf-8")
    result = run(script)
    assert result.returncode == 0, result.stderr
