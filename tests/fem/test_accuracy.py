"""FE models of a wanted accuracy: sizes from CAD, error estimates against true errors, limits, refused input."""

import importlib
from pathlib import Path

import netgen.occ as occ
import ngsolve as ng
import numpy as np
import pytest
from conftest import STEEL, lattice, make_bar

from nassim import Material, RemotePoint, Solid, build_fe_model, condense, craig_bampton
from nassim.fem import accuracy, mesh_checks
from nassim.fem.accuracy import find_targets
from nassim.fem.cad_sizes import FINENESS, LARGEST_PER_THICKNESS, ray_lengths, sizes_from_cad

SCRIPTS = Path(__file__).parents[2] / "scripts"


@pytest.fixture
def hard_solids(monkeypatch):
    monkeypatch.syspath_prepend(str(SCRIPTS))
    return importlib.import_module("common.hard_solids").HARD_SOLIDS


def named(name, shape, axis=occ.X, material=STEEL):
    """A solid with rbe2 points on its ends along an axis."""
    faces = shape.faces.Min(axis), shape.faces.Max(axis)
    for face, label in zip(faces, ("first", "second"), strict=True):
        face.name = label
    shape.name = "body"
    points = tuple(RemotePoint(face.name, face.name, np.array(tuple(face.center)), "rbe2") for face in faces)
    return Solid(name, shape, {"body": material}, points)


def make_step():
    """A bar with a sharp step, in a general position."""
    shape = occ.Box((0, 0, 0), (0.03, 0.01, 0.01)) + occ.Box((0.03, 0, 0), (0.06, 0.01, 0.003))
    return named("step", shape.Rotate(occ.Axis((0, 0, 0), occ.Vec(1, 2, 3)), 20))


def test_rays_measure_a_box():
    corners = np.array([[[0.0, 0, 2], [5, 0, 2], [0, 5, 2]], [[0, 0, 3], [5, 0, 3], [0, 5, 3]]])
    points = np.array([[1.0, 1, 0], [1, 1, 2.5], [4, 4, 0], [1, 1, 4]])
    directions = np.array([[0.0, 0, 1], [0.6, 0, 0.8], [0, 0, 1], [0, 0, 1]])
    np.testing.assert_allclose(ray_lengths(points, directions, corners), [2, 0.5 / 0.8, np.inf, np.inf], rtol=1e-12)


def test_sizes_from_cad_of_a_tube():
    """c sqrt(R t) on a thin tube, and no more than ten times the thickness on a plate."""
    tube = occ.Cylinder(occ.Pnt(0, 0, 0), occ.Z, 0.02, 0.03) - occ.Cylinder(occ.Pnt(0, 0, 0), occ.Z, 0.0195, 0.03)
    points, sizes = sizes_from_cad(named("tube", tube, occ.Z))
    curved = (points[:, 2] > 0.005) & (points[:, 2] < 0.025)
    assert np.median(sizes[curved]) == pytest.approx(FINENESS * np.sqrt(0.02 * 0.0005), rel=0.1)
    points, sizes = sizes_from_cad(named("plate", occ.Box((0, 0, 0), (0.1, 0.06, 0.0004))))
    flat = (points[:, 0] > 0.01) & (points[:, 0] < 0.09) & (points[:, 1] > 0.01) & (points[:, 1] < 0.05)
    np.testing.assert_allclose(sizes[flat], LARGEST_PER_THICKNESS * 0.0004, rtol=1e-3)


def test_tolerance_is_met_on_a_sharp_step():
    """Against order 6 on the last mesh; sharp edges cap the rate, so the first round is not enough."""
    model = build_fe_model(make_step(), tolerance=0.003, fixed=[("first",), ()], progress=False)
    assert len(model.rounds) > 1
    assert model.rounds[-1].error < 0.003
    fine = build_fe_model(make_step(), element_size=2.5e-3, order=5, progress=False)
    body, truth = (craig_bampton(m, discretization=False, progress=False) for m in (model, fine))
    for fixed in ([], ["first"]):
        n_rigid = 0 if fixed else 6
        n = slice(n_rigid, n_rigid + 5)
        true = body.eigenfrequencies(fixed=fixed)[n] / truth.eigenfrequencies(fixed=fixed)[n] - 1
        assert np.all(true < 0.003)
    stiffness = [1 / np.diag(b.compliance(fixed=["first"]))[6:] for b in (body, truth)]
    assert np.all(stiffness[0] / stiffness[1] - 1 < 0.003)


def test_estimates_of_all_targets_against_a_finer_mesh():
    """Between half and three times the true error, on coarse elements."""
    targets = find_targets(
        condense(build_fe_model(make_step(), element_size=0.01, order=3, progress=False)), 4, [(), ("first",)]
    )
    fine = condense(build_fe_model(make_step(), element_size=2.5e-3, order=5, progress=False), progress=False)
    true = targets.values / find_targets(fine, 4, [(), ("first",)]).values - 1
    ratio = targets.errors() / true
    large = true > 5e-4
    assert np.count_nonzero(large) >= 8
    assert np.all((ratio[large] > 0.5) & (ratio[large] < 3)), dict(zip(targets.labels, ratio, strict=True))


def test_a_neck_on_a_coarse_mesh_has_an_unknown_error(hard_solids):
    """At 2 mm and order 2 the first frequency is more than twice the true one."""
    model = build_fe_model(hard_solids["neck"](), element_size=2e-3, order=2, progress=False)
    with pytest.warns(UserWarning, match="estimated error of unknown, above 50 %"):
        body = craig_bampton(model, progress=False)
    assert body.eigenfrequencies(fixed=["first"])[0] > 2 * 296
    assert body.discretization_errors(fixed=["first"])[0] == np.inf
    assert "above 50 %" in body.record["cost and error"]
