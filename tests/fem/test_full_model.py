"""The full model's answers against dense eigenvalue and harmonic solutions of a model made by hand."""

import functools
from dataclasses import replace

import numpy as np
import pytest
import scipy.linalg
from conftest import lattice

from nassim import condense
from nassim.fem.condensation import Condensation, vector_dofs
from nassim.fem.full_model import constrain, full_eigenfrequencies, full_frequency_response


def dense_system(model, end_mass):
    """Stiffness and mass of the lattice, left point held (all six), right point with a mass, in free coordinates."""
    n = model.n_dofs
    held = model.couplings[0]
    rows = np.zeros((6, n))
    rows[:, vector_dofs(held, n)] = held.averages
    moving = np.zeros((6, n))
    moving[:, vector_dofs(model.couplings[1], n)] = model.couplings[1].averages
    free = scipy.linalg.null_space(rows)
    mass = model.mass_matrix.toarray() + end_mass * moving[:3].T @ moving[:3]
    return free.T @ model.stiffness_matrix @ free, free.T @ mass @ free, free, moving


def test_eigenfrequencies_equal_dense_ones():
    model = lattice()
    condensed = condense(model, progress=False)
    stiffness, mass, _, _ = dense_system(model, end_mass=0.3)
    expected = np.sqrt(scipy.linalg.eigh(stiffness, mass, eigvals_only=True)[:5]) / (2 * np.pi)
    found = full_eigenfrequencies(condensed, fixed=["left"], masses={"right": 0.3}, n=5, progress=False)
    assert np.allclose(found, expected, rtol=1e-8)


@pytest.mark.parametrize("points", [("left", "right"), ("left",)])
@pytest.mark.parametrize("coupling", ["rbe2", "rbe3"])
def test_free_model_has_six_zeros(coupling, points):
    """The only point of a body has no stiffness at all."""
    model = lattice(coupling)
    condensed = condense(model, remote_points=points, progress=False)
    found = full_eigenfrequencies(condensed, n=8, progress=False)
    assert np.all(found[:6] == 0.0)
    if coupling == "rbe3":
        squares = scipy.linalg.eigh(model.stiffness_matrix.toarray(), model.mass_matrix.toarray(), eigvals_only=True)
        np.testing.assert_allclose(found[6:], np.sqrt(squares[6:8]) / (2 * np.pi), rtol=1e-6)
    assert found[6] > 100.0
    assert full_eigenfrequencies(condensed, n=4, progress=False).tolist() == [0.0] * 4


@pytest.mark.parametrize("share", [0.9, 1.1])
def test_a_motion_without_a_ten_billionth_of_the_stiffness_is_a_mechanism(share):
    """Two translations of the other point that are all but opposed: 1 - c of their stiffness is left for the sum."""
    stiffness = np.eye(12)
    stiffness[6, 7] = stiffness[7, 6] = -(1 - 1e-10 * share)
    model = constrain(replace(condense(lattice(), progress=False), stiffness=stiffness), fixed=["left"])
    assert model.mechanisms.shape[1] == (share < 1)


@pytest.mark.parametrize("damping_ratio", [0.0, 0.02])
def test_harmonic_response_equals_the_modal_sum(damping_ratio):
    model = lattice()
    stiffness, mass, free, moving = dense_system(model, end_mass=0.3)
    squares, shapes = scipy.linalg.eigh(stiffness, mass)
    frequency = np.linspace(5.0, 300.0, 20)
    omega, poles = 2 * np.pi * frequency, np.sqrt(squares)
    seen = moving[0] @ free @ shapes
    terms = poles[:, None] ** 2 - omega**2 + 2j * damping_ratio * poles[:, None] * omega
    expected = np.sum(seen[:, None] ** 2 / terms, axis=0)
    solution = full_frequency_response(
        condense(model, progress=False),
        frequency,
        inputs={"force": {"right.ux": 1.0}},
        outputs={"motion": {"right.ux": 1.0}},
        damping_ratio=damping_ratio,
        fixed=["left"],
        masses={"right": 0.3},
        progress=False,
    )
    assert np.allclose(solution.frf.response("motion", "force"), expected, rtol=1e-6, atol=0)
    assert solution.change < 1e-8


def test_undamped_response_satisfies_the_equations_of_motion():
    """Direct sparse solution of (K - omega^2 M) u = f + reactions at two frequencies, by another solver."""
    import scipy.sparse as sp
    from scipy.sparse.linalg import spsolve

    model = lattice(n=6)
    condensed = condense(model, progress=False)
    rows = condensed.averages[:6]
    for frequency in (20.0, 90.0):
        dynamic = model.stiffness_matrix - (2 * np.pi * frequency) ** 2 * model.mass_matrix
        system = sp.bmat([[dynamic, 1e6 * rows.T], [1e6 * rows, None]], format="csc")
        load = np.concatenate([condensed.averages[8].toarray().ravel(), np.zeros(6)])
        expected = condensed.averages[8] @ spsolve(system, load)[:-6]
        found = full_frequency_response(
            condensed,
            np.array([frequency]),
            inputs={"force": {"right.uz": 1.0}},
            outputs={"motion": {"right.uz": 1.0}},
            damping_ratio=0.0,
            fixed=["left"],
            progress=False,
        )
        assert found.frf.values[0, 0, 0] == pytest.approx(expected[0], rel=1e-7)


def test_response_of_a_free_body_is_refused():
    with pytest.raises(ValueError, match="move freely"):
        full_frequency_response(
            condense(lattice(), progress=False),
            np.array([10.0]),
            inputs={"force": {"right.ux": 1.0}},
            outputs={"motion": {"right.ux": 1.0}},
            damping_ratio=0.01,
            progress=False,
        )


def test_solves_are_counted_and_end_when_nothing_changes(monkeypatch):
    """Of two inputs, far fewer than unknowns; a third one that applies nothing moves nothing."""
    calls, solve = [], Condensation.solve_fixed
    monkeypatch.setattr(
        Condensation, "solve_fixed", lambda own, load, **options: calls.extend(load.T) or solve(own, load, **options)
    )
    model = lattice(n=6)
    solution = full_frequency_response(
        condense(model, progress=False),
        np.array([1.0, 5.0]),
        inputs={"push": {"right.ux": 1.0}, "none": {}, "twist": {"right.rx": 1.0}},
        outputs={"motion": {"right.ux": 1.0}},
        damping_ratio=0.01,
        fixed=["left"],
        tolerance=1e-6,
        progress=False,
    )
    assert not solution.frf.response("motion", "none").any()
    assert solution.n_solves == len(calls)
    assert 4 < solution.n_solves < model.n_dofs // 6


def test_a_complete_basis_changes_nothing_more():
    """The response is exact, whatever the tolerance."""
    solution = full_frequency_response(
        condense(lattice(n=2), progress=False),
        [50.0],
        inputs={"push": {"right.ux": 1.0}},
        outputs={"motion": {"right.ux": 1.0}},
        damping_ratio=0.01,
        fixed=["left"],
        tolerance=1e-300,
        progress=False,
    )
    assert solution.change == 0.0


def test_the_change_is_that_of_the_last_two_blocks_for_the_worst_input():
    """Against projections on the Krylov spaces of the dense matrix S = L^T K^-1 L, where M = L L^T."""
    model, omega, ratio = lattice(), 2 * np.pi * np.array([50.0, 600.0]), 0.01
    stiffness, mass, free, moving = dense_system(model, end_mass=0.3)
    rows = {"right.ux": 0, "right.uy": 1, "right.rx": 3}
    solution = full_frequency_response(
        condense(model, progress=False),
        omega / (2 * np.pi),
        inputs={name: {name: 1.0} for name in rows},
        outputs={"motion": {"right.ux": 1.0}},
        damping_ratio=ratio,
        fixed=["left"],
        masses={"right": 0.3},
        tolerance=1e-2,
        progress=False,
    )
    lower = np.linalg.cholesky(mass)
    flexibility = lower.T @ np.linalg.solve(stiffness, lower)
    at_rest = lower.T @ np.linalg.solve(stiffness, free.T @ moving[list(rows.values())].T)
    blocks = [np.linalg.qr(at_rest)[0]]
    for _ in range(solution.n_solves // len(rows) - 2):
        blocks.append(np.linalg.qr(flexibility @ blocks[-1])[0])

    def response(blocks):
        basis = np.linalg.qr(np.hstack(blocks))[0]
        squares, shapes = np.linalg.eigh(basis.T @ flexibility @ basis)
        ratios, shapes = omega * np.sqrt(squares)[:, None], basis @ shapes
        return np.tensordot(shapes, (shapes.T @ at_rest)[..., None] / (1 - ratios**2 + 2j * ratio * ratios)[:, None], 1)

    found, before = response(blocks), response(blocks[:-2])
    change = np.linalg.norm(found - before, axis=0) / np.linalg.norm(found, axis=0)
    assert solution.change == pytest.approx(change.max(), rel=1e-3)
    assert change.max() > 1.2 * np.sort(change.ravel())[-2]


def test_tolerance_boundary_conditions_and_most_solves_count():
    """Guided along x as one that is held otherwise by hand; as loose as told; not one solve more than allowed."""
    condensed = condense(lattice(), progress=False)
    ask = functools.partial(
        full_frequency_response,
        condensed,
        np.array([50.0, 600.0]),
        inputs={"f": {"right.ux": 1.0}},
        outputs={"x": {"right.ux": 1.0}, "y": {"right.uy": 1.0}},
        damping_ratio=0.01,
        fixed=["left"],
        progress=False,
    )
    free, guided = ask(), ask(guided={"right": "x"})
    assert np.abs(guided.frf.values[1]).max() < 1e-9 * np.abs(guided.frf.values[0]).max()
    assert np.abs(free.frf.values[1]).max() > 1e-6 * np.abs(free.frf.values[0]).max()
    loose = ask(tolerance=1e-3)
    assert loose.n_solves < free.n_solves
    most = loose.n_solves - 1
    assert ask(tolerance=1e-3, max_solves=most).n_solves == loose.n_solves
    with pytest.raises(RuntimeError, match=f"not converged to 1e-03 after {most - 1} solves"):
        ask(tolerance=1e-3, max_solves=most - 1)
