"""Forces and stiffness of single elements, against NGSolve's matrices."""

import netgen.occ as occ
import ngsolve as ng
import numpy as np
import pytest
from conftest import STEEL

from nassim import Solid
from nassim.fem.assembly import assemble_mesh
from nassim.fem.element_integrals import elastic_forces, element_stiffness
from nassim.fem.meshing import generate_mesh


def meshed(shape, order, **options):
    """A curved mesh of a solid, in a general position."""
    shape.mat("body")
    shape.name = "body"
    solid = Solid("part", shape, {"body": STEEL}, ())
    mesh = ng.Mesh(generate_mesh(solid, **options))
    mesh.Curve(order)
    return mesh, solid


@pytest.fixture(scope="module")
def tetrahedra():
    ball = occ.Sphere(occ.Pnt(1e-3, 2e-3, 0), 0.01) + occ.Box((0, 0, 0), (0.02, 0.004, 0.006))
    return meshed(ball.Rotate(occ.Axis((0, 0, 0), occ.Vec(1, 2, 3)), 20), 2, element_size=8e-3)


@pytest.fixture(scope="module")
def prisms():
    """A tube, whose elements are curved, on a block with straight ones."""
    tube = occ.Cylinder(occ.Pnt(0, 0, 0), occ.Z, 0.01, 0.02) - occ.Cylinder(occ.Pnt(0, 0, 0), occ.Z, 0.006, 0.02)
    return meshed(tube + occ.Box((0.009, -0.002, 0), (0.03, 0.002, 0.02)), 2, element_size=8e-3, extrude="z")


def full(mesh, solid, order):
    return assemble_mesh(mesh, solid, order).stiffness_matrix


def chosen(mesh, space):
    """Unknowns of vertices as inactive, some of the others as free, and the places of these."""
    inactive = np.arange(space.ndof) < mesh.nv
    free = np.flatnonzero(~inactive & (np.random.default_rng(1).random(space.ndof) > 0.2))
    node = np.full(space.ndof, len(free))
    node[free] = np.arange(len(free))
    return inactive, free, node


@pytest.mark.parametrize("case", ["tetrahedra", "prisms"])
def test_forces_on_finer_unknowns(case, request):
    """Of curved elements of order 2 on unknowns of order 3, as of NGSolve's rectangular matrix."""
    mesh, solid = request.getfixturevalue(case)
    coarse, fine = ng.VectorH1(mesh, order=2), ng.VectorH1(mesh, order=3)
    u, v = coarse.TrialFunction(), fine.TestFunction()
    lame, shear = STEEL.lame_parameters
    strain = ng.InnerProduct(ng.Sym(ng.Grad(u)), ng.Sym(ng.Grad(v)))
    form = ng.BilinearForm(trialspace=coarse, testspace=fine)
    form += (2 * shear * strain + lame * ng.div(u) * ng.div(v)) * ng.dx
    form.Assemble()
    displacement, expected = form.mat.CreateRowVector(), form.mat.CreateColVector()
    displacement.FV().NumPy()[:] = np.random.default_rng(0).standard_normal(coarse.ndof)
    expected.data = form.mat * displacement
    spaces = ng.H1(mesh, order=2), ng.H1(mesh, order=3)
    inactive, free, node = chosen(mesh, spaces[1])
    found = elastic_forces(mesh, solid, *spaces, displacement.FV().NumPy()[:, None], inactive, node)[:-1, :, 0]
    forces = expected.FV().NumPy().reshape(3, -1)[:, free].T
    np.testing.assert_allclose(found, forces, rtol=0, atol=1e-12 * np.abs(forces).max())


@pytest.mark.parametrize("case", ["tetrahedra", "prisms"])
def test_stiffness_among_some_unknowns(case, request):
    """In single precision; what is fixed takes no force."""
    mesh, solid = request.getfixturevalue(case)
    space = ng.H1(mesh, order=2)
    inactive, free, node = chosen(mesh, space)
    found = element_stiffness(mesh, solid, space, inactive, node)
    by_node = (free[:, None] + space.ndof * np.arange(3)).ravel()
    expected = full(mesh, solid, 2)[by_node][:, by_node]
    columns = np.zeros((3 * len(free) + 3, 2), dtype=np.float32)
    columns[:-3] = np.random.default_rng(2).standard_normal((3 * len(free), 2))
    product = expected @ columns[:-3]
    forces, scales = found @ columns, found.diagonal()
    np.testing.assert_allclose(forces[:-3], product, rtol=0, atol=1e-5 * np.abs(product).max())
    diagonal = expected.diagonal()
    np.testing.assert_allclose(scales[:-3], diagonal, rtol=0, atol=1e-5 * diagonal.max())
    assert np.all(forces[-3:] == 0), "the fixed node moves"
    assert np.all(scales[-3:] == 1)
