"""Fixed-interface modes and the vectors for those left out, against dense algebra on a model made by hand."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pytest
import scipy.linalg
import scipy.sparse
from conftest import lattice, make_bar

from nassim import Material, RemotePoint, build_fe_model, condense, craig_bampton
from nassim.fem.condensation import vector_dofs
from nassim.fem.fe_model import make_coupling
from nassim.fem.modes import (
    check_n_modes,
    fixed_interface_modes,
    largest_n_modes,
    mass_operator,
    modes_below,
    residual_vectors,
    with_interface_modes,
)


class Case(NamedTuple):
    """A condensed model; its dense mass and the dense fixed-interface modes, all of them."""

    condensed: object
    mass: np.ndarray
    frequency: np.ndarray
    shapes: np.ndarray

    def left_out_sum(self, first, omega=0.0):
        """The sum over j >= first of m_j m_j^T / (lambda_j - omega^2), m_j = Psi^T M phi_j."""
        return modal_sum(self, self.frequency[first:], self.shapes[:, first:], omega)


def modal_sum(case, frequency, shapes, omega=0.0, power=1):
    participation = case.condensed.constraint_modes.T @ case.mass @ shapes
    return (participation / ((2 * np.pi * frequency) ** 2 - omega**2) ** power) @ participation.T


@pytest.fixture(scope="module", params=["rbe3", "rbe2"])
def case(request):
    """Modes in the null space of what the remote points hold: six means of an rbe3 interface, all of an rbe2 one."""
    model = lattice(request.param)
    rows = np.zeros((0, model.n_dofs))
    for coupling in model.couplings:
        columns = vector_dofs(coupling, model.n_dofs)
        held = np.zeros((6 if request.param == "rbe3" else len(columns), model.n_dofs))
        held[:, columns] = coupling.averages if request.param == "rbe3" else np.eye(len(columns))
        rows = np.vstack([rows, held / np.linalg.norm(held, axis=1, keepdims=True)])
    free = scipy.linalg.null_space(rows)
    stiffness, mass = model.stiffness_matrix.toarray(), model.mass_matrix.toarray()
    squares, shapes = scipy.linalg.eigh(free.T @ stiffness @ free, free.T @ mass @ free)
    return Case(condense(model, progress=False), mass, np.sqrt(squares) / (2 * np.pi), free @ shapes)


def left_out(condensed, frequency, modes, **options):
    basis = np.hstack([condensed.constraint_modes, modes])
    mass = basis.T @ condensed.fe_model.mass_matrix @ basis
    return residual_vectors(condensed, frequency, modes, mass, **options)


def unitless(matrix, scale):
    """Metres and radians to comparable size."""
    d = 1.0 / np.sqrt(np.diag(scale))
    return d[:, None] * matrix * d


@pytest.mark.parametrize("n_modes", [1, 5, 20])
def test_fixed_interface_modes_equal_dense_ones(case, n_modes):
    frequency, modes = fixed_interface_modes(case.condensed, n_modes=n_modes)
    assert np.allclose(frequency, case.frequency[:n_modes], rtol=1e-9)
    assert np.allclose(modes.T @ case.mass @ modes, np.eye(n_modes), atol=1e-9)
    # All frequencies differ, so that each mode is one of the dense ones up to its sign.
    overlap = np.abs(modes.T @ case.mass @ case.shapes[:, :n_modes])
    assert np.allclose(overlap, np.eye(n_modes), atol=1e-4)


@pytest.mark.parametrize("n_modes", [4, 5, 6])
def test_modes_kept_before_are_not_computed_again(case, n_modes):
    solved = []
    kept = with_interface_modes(case.condensed, n_modes=5)
    frequency, modes = fixed_interface_modes(kept, n_modes=n_modes, advance=lambda n=1: solved.append(n))
    assert np.allclose(frequency, case.frequency[:n_modes], rtol=1e-9)
    assert np.allclose(modes.T @ case.mass @ modes, np.eye(n_modes), atol=1e-9)
    assert bool(solved) == (n_modes > 5)


def test_fixed_interface_modes_are_at_rest_at_the_remote_points(case):
    modes = fixed_interface_modes(case.condensed, n_modes=10)[1]
    typical = np.abs(case.condensed.averages) @ np.abs(modes)
    assert np.all(np.abs(case.condensed.averages @ modes) <= 1e-9 * typical.max(axis=1, keepdims=True))


def test_no_modes(case):
    frequency, modes = fixed_interface_modes(case.condensed, n_modes=0)
    assert frequency.shape == (0,)
    assert modes.shape == (108, 0)


@pytest.mark.parametrize("n_modes", [-1, 54, 1.5])
def test_impossible_numbers_of_modes(case, n_modes):
    with pytest.raises(ValueError, match="model with 108 unknowns must be a whole number from 0 to 53, got"):
        fixed_interface_modes(case.condensed, n_modes=n_modes)


@pytest.mark.parametrize(("coupling", "largest"), [("rbe3", 39), ("rbe2", 26)])
def test_large_interfaces_leave_modes_only_where_they_deform(coupling, largest):
    """Two interfaces of 9 of 27 nodes each: rbe2 holds all of their motion, rbe3 six averages of each."""
    condensed = condense(lattice(coupling, n=3), progress=False)
    assert len(with_interface_modes(condensed, n_modes=81)._modes[0]) == largest
    with pytest.raises(ValueError, match=f"must be a whole number from 0 to {largest}, got"):
        fixed_interface_modes(condensed, n_modes=largest + 1)


def test_reductions_of_small_models_end_with_their_last_mode():
    """Of 27 nodes, two interfaces hold 9 each, and a third one 8 more."""
    model = lattice("rbe2", n=3)
    with pytest.raises(ValueError, match="out of reach: 26 modes, more of which are not computed"):
        craig_bampton(model, tolerance=1e-9, progress=False)
    assert craig_bampton(model, n_modes=26, progress=False).n_modes == 26
    with pytest.raises(ValueError, match="model with 81 unknowns must be a whole number from 0 to 26, got 27"):
        craig_bampton(model, n_modes=27, progress=False)
    held = np.setdiff1d(np.arange(27), np.concatenate([c.dofs for c in model.couplings]))[1:]
    point = RemotePoint("middle", "middle", np.array([0.01, 0.01, 0.01]), "rbe2")
    middle = make_coupling(point, held, model.fields[:, held], model.fields[:, held])
    small = replace(model, couplings=(*model.couplings, middle))
    assert craig_bampton(small, progress=False).n_modes == largest_n_modes(condense(small, progress=False)) == 2


def test_nodes_without_mass_have_no_modes():
    """Of 18 nodes between the interfaces, four have a mass."""
    model = lattice("rbe2")
    mass = model.scalar_mass_matrix.diagonal()
    between = np.setdiff1d(np.arange(len(mass)), np.concatenate([c.dofs for c in model.couplings]))
    mass[between[4:]] = 0.0
    condensed = condense(replace(model, scalar_mass_matrix=scipy.sparse.diags(mass).tocsr()), progress=False)
    assert len(fixed_interface_modes(condensed, n_modes=12)[0]) == 12
    with pytest.raises(ValueError, match="the model has only 12 modes with all remote points fixed"):
        fixed_interface_modes(condensed, n_modes=13)


def test_limits_of_the_number_of_modes_are_allowed():
    check_n_modes(0, 108)
    check_n_modes(53, 108)
    check_n_modes(6.0, 108)


@pytest.mark.parametrize("below", [0, 3, 7, 8, 11, 19])
def test_modes_below_are_all_of_them_and_one_above(case, below):
    limit = np.concatenate([[0.0], case.frequency])[below : below + 2].mean()
    frequency, modes = modes_below(case.condensed, limit)
    assert np.allclose(frequency, case.frequency[: len(frequency)], rtol=1e-9)
    assert np.count_nonzero(frequency <= limit) == below
    assert frequency[-1] > limit
    assert modes.shape == (108, len(frequency))


def test_all_modes_but_the_last_that_the_model_can_give_are_below(case):
    last = largest_n_modes(case.condensed)
    highest = case.frequency[last - 1]
    assert len(modes_below(case.condensed, 0.9999 * highest)[0]) == last
    with pytest.raises(ValueError, match=rf"cutoff_frequency .* is above mode {last} at {highest:.4g} Hz, the last"):
        modes_below(case.condensed, 1.0001 * highest)


@pytest.mark.parametrize("n_modes", [0, 1, 6, 12])
def test_left_out_vectors_are_modes_of_what_is_left(case, n_modes):
    """At rest at the remote points, orthogonal to the modes and to each other, and never below the true modes."""
    frequency, modes = fixed_interface_modes(case.condensed, n_modes=n_modes)
    ritz, vectors = left_out(case.condensed, frequency, modes)
    k = len(ritz)
    assert 9 <= k <= 12
    assert vectors.shape == (108, k)
    assert np.allclose(vectors.T @ case.mass @ vectors, np.eye(k), atol=1e-8)
    assert np.abs(modes.T @ case.mass @ vectors).max(initial=0.0) < 1e-6
    typical = np.abs(case.condensed.averages) @ np.abs(vectors)
    assert np.all(np.abs(case.condensed.averages @ vectors) <= 1e-8 * typical.max(axis=1, keepdims=True))
    # Courant's principle: the j-th value in a subspace is at least the j-th of all.
    assert np.all(ritz >= case.frequency[n_modes : n_modes + k] * (1 - 1e-8))
    assert np.all(np.diff(ritz) >= 0)


@pytest.mark.parametrize("n_modes", [0, 6])
def test_ritz_values_are_those_of_the_stiffness(case, n_modes):
    """The vectors' energies, by the dense stiffness, are the squares of the frequencies and nothing couples them."""
    ritz, vectors = left_out(case.condensed, *fixed_interface_modes(case.condensed, n_modes=n_modes))
    projected = vectors.T @ case.condensed.fe_model.stiffness_matrix.toarray() @ vectors
    assert np.allclose(projected, np.diag((2 * np.pi * ritz) ** 2), atol=1e-6 * (2 * np.pi * ritz[-1]) ** 2)


def test_where_hardly_anything_is_left_out_the_vectors_are_still_stiff():
    """A symmetric bar of few elements, nearly all of whose inertia the modes hold, by symmetry all of one motion's."""
    solid = make_bar(material=Material("cork", 1e9, 0.0, 200.0))
    model = build_fe_model(solid, element_size=0.005, order=2, extrude="x", layer_thickness=0.05, progress=False)
    condensed = condense(model, progress=False)
    frequency, modes = fixed_interface_modes(condensed, n_modes=8)
    ritz, vectors = left_out(condensed, frequency, modes)
    following = fixed_interface_modes(condensed, n_modes=8 + len(ritz))[0][8:]
    # Courant's principle, but for rounding: what is left is 1e-5 of the solutions that it is the rest of.
    assert np.all(ritz > following * (1 - 1e-6))
    energy = np.einsum("ij,ij->j", vectors, model.stiffness_matrix @ vectors)
    assert np.allclose(ritz, np.sqrt(energy) / (2 * np.pi), rtol=1e-6)
    assert craig_bampton(condensed, n_modes=8, progress=False).truncation_errors()[6:].min() > -1e-12


def test_without_modes_the_whole_sum_is_reproduced(case):
    """Its value at zero is Psi^T M K^-1 M Psi, its derivative by omega^2 the same with one M K^-1 more."""
    ritz, vectors = left_out(case.condensed, *fixed_interface_modes(case.condensed, n_modes=0))
    for power in (1, 2):
        expected = modal_sum(case, case.frequency, case.shapes, power=power)
        found = modal_sum(case, ritz, vectors, power=power)
        assert np.allclose(unitless(found, expected), unitless(expected, expected), atol=1e-8)


def test_sum_is_wrong_by_the_fourth_power_of_the_frequency(case):
    """Value and first derivative by omega^2 at zero are exact, so the second one is the first that errs."""
    ritz, vectors = left_out(case.condensed, *fixed_interface_modes(case.condensed, n_modes=0))
    whole = case.left_out_sum(0)
    errors = []
    for share in (0.2, 0.1, 0.05):
        omega = share * 2 * np.pi * case.frequency[0]
        difference = case.left_out_sum(0, omega) - modal_sum(case, ritz, vectors, omega)
        errors.append(np.linalg.norm(unitless(difference, whole)))
    assert errors[-1] > 1e-13, "below that, rounding decides"
    assert np.allclose(np.log2(np.divide(errors[:-1], errors[1:])), 4.0, atol=0.15)


@pytest.mark.parametrize("n_modes", [1, 6, 12])
def test_with_modes_the_rest_of_the_sum_is_reproduced_in_the_directions_taken(case, n_modes):
    """Never overestimated, and exact in as many directions as there are vectors."""
    ritz, vectors = left_out(case.condensed, *fixed_interface_modes(case.condensed, n_modes=n_modes))
    rest = case.left_out_sum(n_modes)
    missing = np.linalg.eigvalsh(unitless(rest - modal_sum(case, ritz, vectors), rest))
    # The Lanczos modes are good to 1e-6.
    assert missing[0] > -1e-6
    assert np.all(np.abs(missing[: len(ritz)]) < 1e-6)
    assert np.linalg.norm(missing) < 0.5 * np.linalg.norm(unitless(rest, rest))


@pytest.mark.parametrize("columns", [(), (1,), (7,)])
def test_mass_operator_is_the_mass_matrix(columns):
    model = lattice()
    u = np.random.default_rng(0).standard_normal((model.n_dofs, *columns))
    assert np.allclose(mass_operator(model) @ u, model.mass_matrix @ u, rtol=1e-12)


def test_solves_are_counted(case):
    counted = []

    def advance(n=1):
        counted.append(n)

    modes = fixed_interface_modes(case.condensed, n_modes=6, advance=advance)
    assert sum(counted) >= 6
    counted.clear()
    modes_below(case.condensed, 1.01 * modes[0][-1], advance=advance)
    assert sum(counted) >= 7
    counted.clear()
    _, vectors = left_out(case.condensed, *modes, advance=advance)
    assert vectors.shape[1] <= sum(counted) <= 12


@pytest.mark.parametrize("size", [1.0, 1e-12, 1e12])
def test_the_size_of_a_load_does_not_matter(case, size):
    """Volts and newtons stand beside each other; a load that the remote points bear entirely adds nothing."""
    frequency, modes = fixed_interface_modes(case.condensed, n_modes=4)
    loads = np.random.default_rng(4).standard_normal((len(modes), 2))
    expected = left_out(case.condensed, frequency, modes, loads=loads)[0]
    borne = size * case.condensed.averages.toarray()[:1].T
    found = left_out(case.condensed, frequency, modes, loads=np.hstack([loads * [1.0, size], borne]))[0]
    np.testing.assert_allclose(found, expected, rtol=1e-6)
