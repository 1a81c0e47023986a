"""Static condensation against dense algebra on models made by hand, and on the APA."""

from dataclasses import replace

import netgen.occ as occ
import numpy as np
import pytest
import scipy.linalg
from conftest import STEEL, lattice, make_bar

from nassim import RemotePoint, Solid, build_fe_model, condense
from nassim.base.rigid_motion import rigid_transfer
from nassim.fem.condensation import vector_dofs
from nassim.fem.fe_model import make_coupling


def dense_reference(model, load):
    """Saddle-point solution of K u = load with W u = q at rbe3 points and u = R q on the interfaces of rbe2 points."""
    stiffness = model.stiffness_matrix.toarray()
    n, rows, targets = model.n_dofs, [], []
    for coupling in model.couplings:
        held = vector_dofs(coupling, n)
        soft = coupling.point.coupling == "rbe3"
        rows.append(coupling.averages @ np.eye(n)[held] if soft else np.eye(n)[held])
        targets.append(np.eye(6) if soft else coupling.motions)
    rows, targets = np.vstack(rows), scipy.linalg.block_diag(*targets)
    scale = np.abs(stiffness).max()
    saddle = np.block([[stiffness / scale, rows.T], [rows, np.zeros((len(rows),) * 2)]])
    static = np.linalg.solve(saddle, np.vstack([np.zeros((n, targets.shape[1])), targets]))[:n]
    fixed = np.linalg.solve(saddle, np.concatenate([load / scale, np.zeros(len(rows))]))[:n]
    return static, fixed


@pytest.mark.parametrize("coupling", ["222", "333", "23", "232", "322"])
def test_constraint_modes_and_fixed_solution_equal_dense_algebra(coupling):
    """Of two and three remote points: 2 for rbe2, 3 for rbe3, at planes of a lattice that are no equal way apart."""
    model = lattice(n=6)
    couplings = []
    for k, (x, kind) in enumerate(zip((0.0, 0.05, 0.02), coupling, strict=False)):
        point = RemotePoint(f"p{k}", f"p{k}", np.array([x, 0.01, 0.01]), f"rbe{kind}")
        dofs = np.flatnonzero(np.abs(model.fields[1] - x) < 1e-9)
        couplings.append(make_coupling(point, dofs, model.fields[:, dofs], model.fields[:, dofs]))
    model = replace(model, couplings=tuple(couplings))
    condensed = condense(model, progress=False)
    load = np.random.default_rng(1).standard_normal(model.n_dofs)
    static, fixed = dense_reference(model, load)
    assert np.allclose(condensed.constraint_modes, static, atol=1e-9 * np.abs(static).max())
    assert np.allclose(condensed.solve_fixed(load), fixed, atol=1e-9 * np.abs(fixed).max())
    expected = static.T @ model.stiffness_matrix @ static
    assert np.allclose(condensed.stiffness, expected, atol=1e-9 * np.abs(expected).max())


@pytest.mark.parametrize("coupling", ["rbe2", "rbe3"])
def test_six_rigid_motions(coupling):
    model = build_fe_model(make_bar(coupling=coupling), element_size=0.01, progress=False)
    condensed = condense(model, progress=False)
    rigid = condensed.averages @ model.rigid_motions()
    assert np.abs(condensed.stiffness @ rigid).max() < 1e-9 * np.abs(condensed.stiffness).max()
    assert np.allclose(condensed.constraint_modes @ rigid, model.rigid_motions(), atol=1e-9)


def test_apa_compliance_equals_the_full_model(apa_condensed, apa):
    """K u = W^T f solved with the bottom held by a saddle-free route: the residual of the full equations."""
    model = apa_condensed.fe_model
    compliance = apa.compliance(fixed=["bottom"])
    column = apa.coordinate_names.index("top.uz")
    motion = compliance[:, column]
    u = apa_condensed.constraint_modes @ motion
    reactions = apa_condensed.stiffness @ motion
    residual = model.stiffness_matrix @ u - apa_condensed.averages.T @ reactions
    assert np.abs(residual).max() < 1e-8 * np.abs(apa_condensed.averages.T @ reactions).max()
    # The sparse Cholesky is right to 4e-14 of the largest, PARDISO to 1e-10.
    assert np.allclose(apa_condensed.averages @ u, motion, atol=1e-9 * np.abs(motion).max())
    assert reactions[column] == pytest.approx(1.0, rel=1e-8)


def test_no_remote_points():
    model = lattice()
    bare = replace(model, name="bare", couplings=())
    with pytest.raises(ValueError, match="no remote points"):
        condense(bare, progress=False)


def test_unknown_and_repeated_remote_points():
    with pytest.raises(ValueError, match="known: left, right"):
        condense(lattice(), remote_points=["top"], progress=False)
    with pytest.raises(ValueError, match="more than once: left"):
        condense(lattice(), remote_points=["left", "left"], progress=False)


def test_stiff_interfaces_that_share_nodes():
    model = lattice("rbe2")
    twin = (
        model.couplings[0],
        type(model.couplings[0])(model.couplings[1].point, *_parts(model.couplings[0])),
    )
    shared = replace(model, name="shared", couplings=twin)
    with pytest.raises(ValueError, match="share nodes"):
        condense(shared, progress=False)


def _parts(coupling):
    return coupling.dofs, coupling.averages, coupling.motions


def cube_with_faces(kinds, order):
    """A cube in few elements whose four sides around z are the interface of one point, one of its ends of another."""
    cube = occ.Box((0, 0, 0), (0.01, 0.01, 0.01))
    cube.name = "cube"
    sides = ("west", "east", "south", "north")
    for name, pick, axis in zip(sides, ("Min", "Max") * 2, (occ.X, occ.X, occ.Y, occ.Y), strict=True):
        getattr(cube.faces, pick)(axis).name = name
    cube.faces.Min(occ.Z).name = "floor"
    points = (
        RemotePoint("around", sides, (0.005, 0.005, 0.005), kinds[0]),
        RemotePoint("foot", "floor", (0.005, 0.005, 0.0), kinds[1]),
    )
    return build_fe_model(Solid("cube", cube, {"cube": STEEL}, points), element_size=0.01, order=order, progress=False)


@pytest.mark.parametrize("order", [1, 2])
def test_soft_interface_all_on_stiff_ones_is_refused(order):
    """The floor's nodes but at most one lie on the sides, which move as a rigid body."""
    with pytest.raises(ValueError, match="rbe3 remote points that cannot move by themselves: 'foot'; too few nodes"):
        condense(cube_with_faces(("rbe2", "rbe3"), order), progress=False)


def test_two_soft_points_on_one_interface_are_refused():
    soft = cube_with_faces(("rbe3", "rbe3"), 2)
    twice = replace(soft, couplings=(soft.couplings[0], replace(soft.couplings[0], point=soft.couplings[1].point)))
    with pytest.raises(ValueError, match="that cannot move by themselves: 'around', 'foot'; too few nodes"):
        condense(twice, progress=False)


def test_soft_interface_with_nodes_of_its_own_beside_a_stiff_one():
    """Enough nodes of the floor lie inside it: the body turns and moves freely."""
    condensed = condense(cube_with_faces(("rbe2", "rbe3"), 4), progress=False)
    assert np.all(np.isfinite(condensed.stiffness))
    motions = np.vstack([rigid_transfer(c.point.position) for c in condensed.couplings])
    assert np.abs(condensed.stiffness @ motions).max() < 1e-9 * np.abs(condensed.stiffness).max()


def test_a_condensation_that_is_known_is_not_that_of_a_changed_model():
    model = lattice()
    known = condense(model, progress=False)
    model = replace(model, _condensation=known)
    assert condense(replace(model, description="other"), progress=False).constraint_modes is known.constraint_modes
    for change in (
        {"stiffness": 2.0 * model.stiffness_matrix},
        {"scalar_mass_matrix": 2.0 * model.scalar_mass_matrix},
        {"fields": model.fields.copy()},
        {"couplings": model.couplings[::-1]},
    ):
        found = condense(replace(model, **change), progress=False)
        assert found.constraint_modes is not known.constraint_modes, f"a model with another {next(iter(change))}"
    assert found.names == ("right", "left")
