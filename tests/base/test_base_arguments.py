"""Every optional argument of the package's foundations is in a test that fails where it is ignored."""

from dataclasses import replace

from arguments import assert_all_tried
from conftest import lattice

import nassim.base
from nassim import craig_bampton
from nassim.base import load_or_compute, stage

ELSEWHERE = {
    "eigenmodes: n_modes": "base/test_modal.py::test_number_of_modes",
    "mac: mass": "base/test_modal.py::test_mac_of_modes_with_themselves_is_the_identity",
    "load_or_compute: progress": "base/test_base_arguments.py::test_a_loaded_body_tells_its_elements_unless_silent",
    "load: as_": "base/test_storage.py::test_a_file_is_loaded_as_the_class_that_is_asked_for",
    "stage: enabled": "base/test_progress.py::test_a_stage_that_is_switched_off_prints_nothing",
    "stage: total": "base/test_progress.py::test_on_a_terminal_a_bar_moves",
    "stage: unit": "base/test_base_arguments.py::test_what_is_not_counted_has_no_bar",
}


def test_every_optional_argument_is_tried():
    assert_all_tried(nassim.base, {}, ELSEWHERE)


def test_a_loaded_body_tells_its_elements_unless_silent(tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("NASSIM_CACHE", str(tmp_path))
    body = craig_bampton(lattice(), n_modes=1, progress=False)
    body = replace(body, record={"finite element model": "of ten bricks"})
    for options in {"progress": False}, {"progress": False}, {}, {"progress": True}:
        load_or_compute("part", 64 * "0", lambda: body, **options)
        told = capsys.readouterr().out
        assert ("loaded from" in told, "of ten bricks" in told, bool(told)) == (options.get("progress", True),) * 3


def test_what_is_not_counted_has_no_bar(monkeypatch, capsys):
    monkeypatch.setattr("sys.stderr.isatty", lambda: True)
    for options in {}, {"unit": ""}, {"unit": "steps"}:
        with stage("factorise", total=2, **options) as advance:
            advance(2)
        assert ("2/2 steps" in capsys.readouterr().err) == bool(options.get("unit"))
