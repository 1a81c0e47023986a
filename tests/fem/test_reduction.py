"""Craig-Bampton: exact statics, convergence from above, errors of the 36-coordinate APA."""

import re
import warnings
from types import SimpleNamespace

import numpy as np
import pytest
import scipy.linalg
from conftest import assert_limit, lattice

from nassim import condense, craig_bampton
from nassim.base.modal import eigenmodes
from nassim.bodies.projection import keep_modes
from nassim.bodies.reduced_body import error_text
from nassim.fem import reduction
from nassim.fem.condensation import vector_dofs
from nassim.fem.full_model import full_eigenfrequencies
from nassim.fem.modes import fixed_interface_modes


@pytest.fixture(scope="module")
def full_clamped(apa_condensed):
    return full_eigenfrequencies(apa_condensed, fixed=["bottom"], n=5, progress=False)


def test_apa_has_36_coordinates(apa):
    assert apa.mass_matrix.shape == apa.stiffness_matrix.shape == (36, 36)
    assert apa.n_modes == 6
    assert apa.coordinate_names[:2] == ("bottom.ux", "bottom.uy")
    assert apa.coordinate_names[-1] == "mode 6"


def test_mass_and_six_rigid_motions(apa, apa_model):
    assert apa.mass == pytest.approx(apa_model.mass, rel=1e-9)
    frequency = apa.eigenfrequencies(n=7)
    assert np.all(frequency[:6] < 0.05)
    assert frequency[6] > 1000.0
    rigid = np.vstack([np.eye(6), *(_arm(p.position - apa.remote_points[0].position) for p in apa.remote_points[1:])])
    rigid = np.vstack([rigid, np.zeros((6, 6))])
    mass = rigid.T @ apa.mass_matrix @ rigid
    assert np.allclose(mass[:3, :3], apa.mass * np.eye(3), atol=1e-9 * apa.mass)
    offset = apa.center_of_mass - apa.remote_points[0].position
    assert np.allclose(mass[3:, :3], apa.mass * _cross(offset), atol=1e-9 * apa.mass)


def test_modal_rows_vanish_statically(apa):
    assert np.all(apa.stiffness_matrix[30:, :30] == 0.0)
    assert np.allclose(apa.mass_matrix[30:, 30:], np.eye(6), atol=1e-9)


def test_clamped_frequencies_from_above_and_close(apa, full_clamped):
    error = apa.eigenfrequencies(fixed=["bottom"], n=5) / full_clamped - 1
    assert np.all(error > -1e-9)
    assert np.all(error[:3] < 1e-3)
    assert np.all(error < 2e-2)


@pytest.mark.slow
def test_error_falls_with_more_modes(apa_condensed, full_clamped):
    errors, richest = [], craig_bampton(apa_condensed, n_modes=40, progress=False)
    for p in (0, 6, 20, 40):
        body = keep_modes(richest, p)
        errors.append(body.eigenfrequencies(fixed=["bottom"], n=5) / full_clamped - 1)
    errors = np.array(errors)
    assert np.all(np.diff(errors, axis=0) < 1e-9)
    assert np.all(errors[-1] < 1e-3)


def test_paper_figures(apa):
    """A coarse mesh of the calibrated model: 5 % of 95.9 Hz, 10 % of 1.79 N/um."""
    conditions = {"fixed": ["bottom"], "guided": {"top": "z"}}
    assert apa.eigenfrequencies(masses={"top": 5.0}, **conditions)[0] == pytest.approx(95.9, rel=0.05)
    top = apa.coordinate_names.index("top.uz")
    assert 1 / apa.compliance(fixed=["bottom"])[top, top] == pytest.approx(1.79e6, rel=0.10)


def test_reduction_equals_a_dense_projection():
    """The same basis made by dense algebra: constraint modes by a saddle point, modes in the null space of W."""
    model = lattice()
    body = craig_bampton(model, n_modes=8, progress=False)
    stiffness, mass = model.stiffness_matrix.toarray(), model.mass_matrix.toarray()
    rows = np.zeros((12, model.n_dofs))
    for i, coupling in enumerate(model.couplings):
        rows[6 * i : 6 * i + 6, vector_dofs(coupling, model.n_dofs)] = coupling.averages
    scale = np.abs(stiffness).max()
    saddle = np.block([[stiffness / scale, rows.T], [rows, np.zeros((12, 12))]])
    static = np.linalg.solve(saddle, np.vstack([np.zeros((model.n_dofs, 12)), np.eye(12)]))[: model.n_dofs]
    held = scipy.linalg.null_space(rows)
    modes = held @ eigenmodes(held.T @ stiffness @ held, held.T @ mass @ held, n_modes=8)[1]
    basis = np.hstack([static, modes])
    expected = eigenmodes(basis.T @ stiffness @ basis, basis.T @ mass @ basis)[0]
    assert np.allclose(body.eigenfrequencies()[6:], expected[6:], rtol=1e-8)


def test_gram_holds_the_mass_matrix(apa):
    n = len(apa.mass_matrix)
    blocks = apa.gram[4:, 4:].reshape(n, 3, n, 3)
    assert np.allclose(np.einsum("jckc->jk", blocks), apa.mass_matrix, atol=1e-12 * np.abs(apa.mass_matrix).max())


def test_cutoff_frequency_picks_the_modes_below():
    model = lattice()
    every = craig_bampton(model, n_modes=20, progress=False)
    frequency = np.sqrt(np.diag(every.stiffness_matrix)[12:]) / (2 * np.pi)
    limit = 0.5 * (frequency[9] + frequency[10])
    assert craig_bampton(model, cutoff_frequency=limit, progress=False).n_modes == 10


@pytest.mark.parametrize(("cutoff", "n_modes"), [(600.0, 0), (700.0, 1)])
def test_a_tolerance_applies_to_the_frequencies_below_the_cutoff(cutoff, n_modes):
    """The fewest modes with 2 % against all of the model's own frequencies, free and clamped at either point."""
    model = lattice()
    stiffness, mass = model.stiffness_matrix.toarray(), model.mass_matrix.toarray()

    def error(body, clamped):
        rows = np.zeros((6 * len(clamped), model.n_dofs))
        for i, coupling in enumerate(coupling for coupling in model.couplings if coupling.point.name in clamped):
            rows[6 * i : 6 * i + 6, vector_dofs(coupling, model.n_dofs)] = coupling.averages
        free = scipy.linalg.null_space(rows) if clamped else np.eye(model.n_dofs)
        exact = eigenmodes(free.T @ stiffness @ free, free.T @ mass @ free)[0][0 if clamped else 6 :]
        frequency = body.eigenfrequencies(fixed=clamped)[0 if clamped else 6 :]
        frequency = frequency[frequency <= cutoff]
        return np.max(frequency / exact[: len(frequency)] - 1, initial=0.0)

    bodies = (craig_bampton(model, n_modes=p, progress=False) for p in range(3))
    errors = [max(error(body, clamped) for clamped in ([], ["left"], ["right"])) for body in bodies]
    assert np.argmax(np.array(errors) < 0.02) == n_modes
    assert craig_bampton(model, tolerance=0.02, cutoff_frequency=cutoff, progress=False).n_modes == n_modes


@pytest.mark.parametrize("n_modes", [-1, 10**6, 2.5, np.nan, np.inf, "3"])
def test_impossible_numbers_of_modes(n_modes):
    with pytest.raises(ValueError, match=r"n_modes .* must be a whole number"):
        craig_bampton(lattice(), n_modes=n_modes, progress=False)


def test_numbers_of_modes_may_be_written_with_a_point():
    body = craig_bampton(lattice(), n_modes=2.0, progress=False)
    assert body.n_modes == 2
    for find in (body.eigenfrequencies, body.truncation_errors):
        np.testing.assert_array_equal(find(fixed=["left"], n=3.0), find(fixed=["left"])[:3])
    assert body.eigenmodes(n=3.0)[1].shape[1] == 3


def test_six_modes_are_kept_unless_told_otherwise():
    assert craig_bampton(lattice(), progress=False).n_modes == 6


@pytest.mark.parametrize("option", ["tolerance", "cutoff_frequency"])
def test_limits_of_a_reduction_are_positive(option):
    with pytest.raises(ValueError, match=f"{option} must be positive"):
        craig_bampton(lattice(), **{option: -0.01}, progress=False)


@pytest.mark.parametrize("share", [0.9, 1.1])
def test_a_mesh_error_above_two_percent_is_told(share):
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        reduction._warn_of_coarse_mesh("bar", 0.02 * share)
    assert len(told) == (share > 1)


@pytest.mark.parametrize("points", [["left"], []])
def test_a_condensation_has_its_points(points):
    with pytest.raises(ValueError, match="has its remote points already; give them to condense instead"):
        craig_bampton(condense(lattice(), progress=False), remote_points=points, progress=False)


@pytest.mark.parametrize("coupling", ["rbe2", "rbe3"])
def test_one_point_and_no_modes_make_a_rigid_body(coupling):
    """Six coordinates and no others: the mass matrix is that of a rigid body about the point."""
    model = lattice(coupling)
    body = craig_bampton(model, n_modes=0, remote_points=["left"], progress=False)
    assert np.array_equal(body.eigenfrequencies(), np.zeros(6))
    assert body.eigenfrequencies(fixed=["left"]).shape == body.truncation_errors(fixed=["left"]).shape == (0,)
    node_mass = model.scalar_mass_matrix.diagonal()
    arms = [_arm(position - body.point("left").position)[:3] for position in model.fields[1:].T]
    expected = sum(m * arm.T @ arm for m, arm in zip(node_mass, arms, strict=True))
    assert np.allclose(body.mass_matrix, expected, atol=1e-12 * np.abs(expected).max())
    assert body.record["truncation error of the first eigenfrequencies, 'left' clamped (estimate)"].startswith("none")


def test_the_record_tells_errors_of_elastic_modes():
    """A free body's six rigid motions have none; a clamped body has no such motions."""
    body = craig_bampton(lattice(), n_modes=4, progress=False)
    for label, errors in (
        ("free", body.truncation_errors()[6:11]),
        ("'left' clamped", body.truncation_errors(fixed=["left"])[:5]),
    ):
        expected = ", ".join(map(error_text, errors))
        assert body.record[f"truncation error of the first eigenfrequencies, {label} (estimate)"] == expected


def test_tolerance_out_of_reach_says_what_is_within():
    with pytest.raises(ValueError, match="tolerance 1e-12 is out of reach: 53 modes, more of which") as told:
        craig_bampton(lattice(), tolerance=1e-12, progress=False)
    within = float(re.search(r"error of (\S+);", str(told.value))[1])
    body = craig_bampton(lattice(), tolerance=1.1 * within, progress=False)
    assert body.n_modes <= 53
    assert body.truncation_errors()[6:11].max() <= 1.1 * within
    with pytest.raises(ValueError, match="is out of reach"):
        craig_bampton(lattice(), tolerance=0.9 * within, progress=False)


def test_remote_points_come_in_the_order_asked_for():
    model = lattice()
    names = [point.name for point in model.remote_points]
    usual, turned = (craig_bampton(model, n_modes=2, remote_points=o, progress=False) for o in (names, names[::-1]))
    assert turned.point_names == tuple(names[::-1])
    order = np.r_[6:12, 0:6]
    for matrix in ("stiffness_matrix", "mass_matrix"):
        a, b = (getattr(body, matrix)[:12, :12] for body in (usual, turned))
        np.testing.assert_allclose(b, a[np.ix_(order, order)], rtol=1e-6, atol=1e-9 * np.abs(a).max())


def test_a_record_tells_which_modes_were_kept_and_from_where_on_they_are_left_out():
    frequency, _ = fixed_interface_modes(condense(lattice(), progress=False), n_modes=3)
    record = craig_bampton(lattice(), n_modes=2, progress=False).record
    assert record["fixed-interface frequencies [Hz]"] == f"{frequency[0]:.1f} {frequency[1]:.1f}"
    assert record["modes left out"] == f"all from {frequency[2]:.1f} Hz"
    assert record["coordinates"].startswith("2 remote points x 6 + 2 fixed-interface modes = 14;")


def test_boundary_conditions_with_unknown_names(apa):
    with pytest.raises(ValueError, match="known: bottom, top"):
        apa.eigenfrequencies(fixed=["botom"])
    with pytest.raises(ValueError, match="both fixed and guided"):
        apa.eigenfrequencies(fixed=["top"], guided={"top": "z"})
    with pytest.raises(ValueError, match="move freely"):
        apa.compliance(fixed=[])


def _cross(a):
    return np.array([[0, -a[2], a[1]], [a[2], 0, -a[0]], [-a[1], a[0], 0]])


def _arm(offset):
    result = np.eye(6)
    result[:3, 3:] = -_cross(offset)
    return result


def test_a_tolerance_may_need_four_hundred_modes(monkeypatch):
    """Of a model with many more; the errors are made up, as so many modes would take minutes."""

    rich = SimpleNamespace(point_names=(), eigenfrequencies=lambda fixed: np.zeros(0))

    def needed(share):
        monkeypatch.setattr(reduction, "InterfaceModes", lambda _condensed: None)
        monkeypatch.setattr(reduction, "_reduce", lambda *_: (rich, 0, None, None))
        monkeypatch.setattr(reduction, "keep_modes", lambda _rich, count: count)
        monkeypatch.setattr(reduction, "_truncation", lambda count, *_: float(count < share * 400))
        large = SimpleNamespace(fe_model=SimpleNamespace(n_dofs=10_000), couplings=())
        assert reduction._reduce_within(large, 0.1, None, (), False)[1] == share * 400

    assert_limit(needed, "400 modes, more of which")
