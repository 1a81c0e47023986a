"""Every optional argument of the package's foundations is in a test that fails where it is ignored."""

from arguments import assert_all_tried

import nassim.base

ELSEWHERE = {
    "eigenmodes: n_modes": "base/test_modal.py::test_number_of_modes",
    "mac: mass": "base/test_modal.py::test_mac_of_modes_with_themselves_is_the_identity",
    "load_or_compute: progress": "base/test_storage.py::test_cached_keeps_silent_when_asked",
    "stage: enabled": "base/test_progress.py::test_a_stage_that_is_switched_off_prints_nothing",
    "stage: total": "base/test_progress.py::test_on_a_terminal_a_bar_moves",
    "stage: unit": "base/test_progress.py::test_on_a_terminal_a_bar_moves",
}


def test_every_optional_argument_is_tried():
    assert_all_tried(nassim.base, (), ELSEWHERE)
