"""What every optional argument of the exchange with other programs does."""

from dataclasses import replace
from functools import cache, partial

import numpy as np
import pytest
import scipy.io
from arguments import assert_all_tried, is_now, table
from conftest import lattice
from scipy.spatial.transform import Rotation
from superelements import SAMPLE, sample

import nassim.exchange
from nassim import craig_bampton
from nassim.exchange import (
    Finding,
    Superelement,
    as_superelement,
    body_state_space,
    export_body,
    read_superelement,
    superelement,
    to_body,
)

TURNS = Rotation.from_rotvec([[0.3, -0.2, 0.5], [1.1, 0.7, -2.0]]).as_matrix()


@cache
def body():
    return craig_bampton(lattice(), n_modes=2, progress=False)


@cache
def matrices():
    given = as_superelement(body())
    return {"stiffness_matrix": given.stiffness_matrix, "mass_matrix": given.mass_matrix, "positions": given.positions}


def written(path):
    """The damping matrix in a file of a body."""
    return lambda **options: scipy.io.loadmat(export_body(body(), path, **options))["C"]


def ratios(damping):
    """Damping ratios of the elastic modes of the body."""
    frequency, shapes = body().eigenmodes()
    return np.einsum("ji,jk,ki->i", shapes, damping, shapes)[6:] / (4 * np.pi * frequency[6:])


def decays(model):
    poles = np.linalg.eigvals(model.A)
    poles = poles[np.abs(poles) > 1.0]
    return np.sort(-poles.real / np.abs(poles))


def are(of_result, *expected):
    return lambda *found: all(
        np.allclose(of_result(one), other, rtol=1e-9, atol=1e-9) for one, other in zip(found, expected, strict=True)
    )


def scaled(length, force, mass):
    """Whether numbers are now read in other units: of the nodes' translations, and of the modes, whose masses stay."""

    def law(before, after):
        factors = [
            (after.positions, before.positions, length),
            (after.stiffness_matrix[:3, :3], before.stiffness_matrix[:3, :3], force / length),
            (after.stiffness_matrix[3:6, 3:6], before.stiffness_matrix[3:6, 3:6], force * length),
            (after.mass_matrix[:3, :3], before.mass_matrix[:3, :3], mass),
            (after.mass_matrix[-2:, -2:], before.mass_matrix[-2:, -2:], 1.0),
        ]
        return after.units != before.units and all(np.allclose(a, b * factor) for a, b, factor in factors)

    return law


def turned(before, after):
    """Whether forces and moments of the nodes are now along the body's axes."""
    change = np.eye(len(before.stiffness_matrix))
    for k in range(4):
        change[3 * k : 3 * k + 3, 3 * k : 3 * k + 3] = TURNS[k // 2]
    return np.allclose(after.stiffness_matrix, change @ before.stiffness_matrix @ change.T) and np.allclose(
        after.mass_matrix, change @ before.mass_matrix @ change.T
    )


ARGUMENTS = table(
    {
        "body_state_space": lambda **options: body_state_space(body(), **options),
        "superelement": lambda **options: superelement(**matrices(), **options),
        "Superelement": lambda **options: Superelement("s", **matrices(), names=("a", "b"), **options),
        "read_superelement": partial(read_superelement, *sorted(SAMPLE.glob("*.txt"))),
        "Finding": partial(Finding, "mass", "ok", "text"),
    },
    [
        ("body_state_space", "damping_ratio", 0.0, [0.01, 0.02], are(decays, 0.0, [0.01] * 2 + [0.02] * 14)),
        ("superelement", "name", "superelement", "leg", is_now("name", "leg")),
        ("superelement", "names", None, ("p", "q"), is_now("names", ("p", "q"))),
        ("superelement", "units", "m-N-kg", "mm-kN-t", scaled(1e-3, 1e3, 1e3)),
        ("superelement", "orientations", None, TURNS, turned),
        ("superelement", "source", "arrays", "mail", is_now("source", "mail")),
        ("Superelement", "source", "arrays", "mail", is_now("source", "mail")),
        ("Superelement", "units", "m-N-kg", "mm-N-t", is_now("units", "mm-N-t")),
        ("Superelement", "digits", 0, 4, is_now("digits", 4)),
        (
            "read_superelement",
            "units",
            "m-N-kg",
            "mm-N-t",
            lambda _, after: np.allclose(after.positions[1], [0.1, 0, 0]),
        ),
        ("Finding", "figures", {}, {"kg": 2}, is_now("figures", {"kg": 2.0})),
    ],
)
HERE, IN_FILES = "exchange/test_exchange_arguments.py", "exchange/test_superelement.py"
C_CODE, FMU = "exchange/test_c_code.py", "exchange/test_fmu.py"
RUNS = "exchange/test_python_fmu.py"
OTHERS = "exchange/test_other_programs.py"
ELSEWHERE = {
    "export_c: time_step": f"{C_CODE}::test_what_is_refused",
    "export_c: hold_order": f"{C_CODE}::test_c_code_equals_exact_steps",
    "export_c: precision": f"{C_CODE}::test_single_precision_tells_its_error",
    "export_c: start": f"{C_CODE}::test_c_code_starts_as_runs_do",
    "export_c: constant_inputs": f"{C_CODE}::test_c_code_starts_as_runs_do",
    "export_c: input_sizes": f"{C_CODE}::test_sizes_of_inputs_are_those_of_the_run_that_tells_the_error",
    "export_c: allow_unstable": f"{C_CODE}::test_growing_models_are_refused_and_drifting_ones_are_not",
    "export_fmu: version": f"{FMU}::test_co_simulation_equals_exact_steps",
    "export_fmu: interface": f"{FMU}::test_model_exchange_equals_exact_steps_to_the_tolerance_of_the_solver",
    "export_fmu: time_step": f"{FMU}::test_an_fmu_holds_the_code_of_export_c",
    "export_fmu: method": f"{RUNS}::test_runs_equal_those_of_simulation",
    "export_fmu: spectral_radius": f"{RUNS}::test_options_are_taken_along",
    "export_fmu: stress": f"{RUNS}::test_options_are_taken_along",
    "export_fmu: hold_order": f"{FMU}::test_an_fmu_holds_the_code_of_export_c",
    "export_fmu: binaries": f"{FMU}::test_what_is_refused_and_that_nothing_is_written",
    "export_fmu: description": f"{FMU}::test_the_description_is_that_given",
    "export_fmu: start": f"{FMU}::test_an_fmu_holds_the_code_of_export_c",
    "export_fmu: constant_inputs": f"{FMU}::test_an_fmu_holds_the_code_of_export_c",
    "export_fmu: input_sizes": f"{FMU}::test_sizes_of_inputs_give_those_of_the_states",
    "export_fmu: allow_unstable": f"{FMU}::test_what_is_refused_and_that_nothing_is_written",
    "export_body: damping_ratio": f"{HERE}::test_a_body_is_written_with_the_damping_asked_for",
    "to_body: any_size": f"{HERE}::test_each_confirmation_is_of_one_fault",
    "to_body: any_coordinates": f"{HERE}::test_each_confirmation_is_of_one_fault",
    "read_superelement: name": f"{IN_FILES}::test_every_argument_of_arrays_and_files_counts",
    "read_superelement: names": f"{IN_FILES}::test_every_argument_of_arrays_and_files_counts",
    "read_superelement: orientations": f"{IN_FILES}::test_every_argument_of_arrays_and_files_counts",
    "read_superelement: variables": f"{IN_FILES}::test_names_of_variables_are_free",
    "read_superelement: positions": f"{OTHERS}::test_mtx_as_abaqus_writes_it",
    "read_superelement: dofs": f"{OTHERS}::test_mtx_as_abaqus_writes_it",
    "read_calculix: n_modes": f"{OTHERS}::test_calculix_stored_matrices_are_reduced",
    "read_calculix: names": f"{OTHERS}::test_calculix_stored_matrices_are_reduced",
    "read_calculix: name": f"{OTHERS}::test_calculix_stored_matrices_are_reduced",
}


@pytest.mark.parametrize("case", ARGUMENTS)
def test_an_optional_argument_does_what_it_should(case):
    ARGUMENTS[case].check()


def test_every_optional_argument_is_tried():
    assert_all_tried(nassim.exchange, ARGUMENTS, ELSEWHERE)


def test_a_body_is_written_with_the_damping_asked_for(tmp_path):
    write = written(tmp_path / "body.mat")
    np.testing.assert_array_equal(write(), 0.0)
    np.testing.assert_allclose(ratios(write(damping_ratio=[0.01, 0.02])), [0.01] + [0.02] * 7, rtol=1e-9)


def test_each_confirmation_is_of_one_fault():
    """A beam of N/km, and one whose last node lies elsewhere: neither confirmation is of the other's fault."""
    sound = sample()
    faults = {
        "any_size": replace(sound, stiffness_matrix=1e-12 * sound.stiffness_matrix),
        "any_coordinates": replace(sound, positions=sound.positions * [[1], [1], [1.1]]),
    }
    for option, faulty in faults.items():
        for given in {}, {option: False}, dict.fromkeys(set(faults) - {option}, True):
            with pytest.raises(ValueError, match=f"confirm by {option}=True"):
                to_body(faulty, **given)
        np.testing.assert_array_equal(to_body(faulty, **{option: True}).positions, faulty.positions)


def test_units_count_in_files_of_arrays_too(tmp_path):
    given = matrices()
    np.savez(tmp_path / "body.npz", K=given["stiffness_matrix"], M=given["mass_matrix"], P=given["positions"])
    expected = superelement(**given, units="in-lbf-slinch")
    found = read_superelement(tmp_path / "body.npz", units="in-lbf-slinch")
    assert found.units == expected.units
    for name in given:
        np.testing.assert_allclose(getattr(found, name), getattr(expected, name), rtol=1e-12)
