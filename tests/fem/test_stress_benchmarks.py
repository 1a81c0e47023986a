"""Stress by published figures: a plate with a hole, and two tests of NAFEMS whose supports are held in the elements."""

import netgen.occ as occ
import ngsolve as ng
import numpy as np
import pytest
from conftest import STEEL, meshed
from scipy.sparse.linalg import eigsh

from nassim import Material, RemotePoint, Solid, StressPoint, StressSurface, craig_bampton, von_mises
from nassim.fem import generate_mesh
from nassim.fem.assembly import mesh_and_solid
from nassim.fem.solver import factorize
from nassim.fem.stress import plan_stress, stress_readouts


def pulled_plate(length, thickness, order, places, **sizes):
    """A plate with a hole, 40 mm wide, under 100 N: its model, its body, its coordinates and its largest stress.

    R. B. Heywood's factor of the net stress, 2 + (1 - d / W)^3 (1952), fits R. C. J. Howland's solution (1930).
    """
    width, hole = 0.04, 0.008
    plate = occ.Box(occ.Pnt(-length / 2, -width / 2, 0), occ.Pnt(length / 2, width / 2, thickness))
    plate -= occ.Cylinder(occ.Pnt(0, 0, -1), occ.Z, hole / 2, 2)
    plate.solids.name, plate.faces.Min(occ.X).name, plate.faces.Max(occ.X).name = "plate", "left", "right"
    for face in plate.faces:
        if abs(face.center.x) + abs(face.center.y) < 1e-6 and abs(face.center.z - thickness / 2) < 1e-6:
            face.name = "hole"
    ends = (("left", -length / 2), ("right", length / 2))
    points = tuple(RemotePoint(name, name, np.array([x, 0, thickness / 2])) for name, x in ends)
    solid = Solid("plate", plate, {"plate": STEEL}, points)
    model = meshed(generate_mesh(solid, **sizes), solid, order)
    body = craig_bampton(model, n_modes=0, discretization=False, stress=places, progress=False)
    q, pull = np.zeros(len(body.mass_matrix)), np.zeros(len(body.mass_matrix))
    pull[6] = 100.0
    q[6:] = np.linalg.solve(body.stiffness_matrix[6:, 6:], pull[6:])
    expected = (2 + (1 - hole / width) ** 3) / (1 - hole / width) * 100.0 / (width * thickness)
    return model, body, q, expected


def test_a_hole_concentrates_stress_as_in_the_handbook():
    thickness, sizes = 1e-3, {"element_size": 0.01, "local_sizes": {"hole": 1e-3}, "extrude": "z"}
    places = [StressPoint("edge", (0.0, 0.004, thickness / 2)), StressSurface()]
    _, body, q, expected = pulled_plate(0.12, thickness, 3, places, layer_thickness=thickness, **sizes)
    assert body.readouts["edge"].stress(q)[0, 0] == pytest.approx(expected, rel=0.02)
    surface = body.readouts["stress"]
    values = von_mises(surface.stress(q))
    peak = int(np.argmax(values))
    assert values[peak] == pytest.approx(expected, rel=0.04)
    assert abs(surface.positions[peak, 0]) < 1e-3
    assert surface.mesh_error(q)[peak] < 0.1 * values[peak]


@pytest.mark.parametrize("size", [10e-3, 6e-3])
def test_the_figure_of_the_mesh_is_the_error_of_coarse_elements_of_second_order(size):
    """Neighbours agree on a stress that is too low together, also where they were moved to unfold."""
    places = [StressSurface("hole", "hole"), StressPoint("edge", (0.0, 0.004, 0.005))]
    model, body, q, expected = pulled_plate(0.06, 0.01, 2, places, element_size=size)
    mesh, _ = mesh_and_solid(model)
    assert bool(mesh.deformation) == (size < 1e-2)
    for name in ("hole", "edge"):
        place = body.readouts[name]
        values, figure = von_mises(place.stress(q)), place.mesh_error(q)
        peak = int(np.argmax(values))
        error = abs(values[peak] - expected)
        assert error > 0.2 * expected
        assert 0.8 * error < figure[peak] < 3 * error


@pytest.mark.parametrize("points", [1, 2])
def test_the_figure_of_the_mesh_depends_on_neither_signs_nor_rotations_nor_units_of_fields(points):
    """Rounding decides on the first two. A point that is alone moves as in a rigid body and has no stiffness."""
    box = occ.Box(occ.Pnt(0, 0, 0), occ.Pnt(0.05, 0.01, 0.02))
    box.solids.name, box.faces.Min(occ.X).name, box.faces.Max(occ.X).name = "bar", "left", "right"
    names = (("left", 0.0), ("right", 0.05))[:points]
    solid = Solid("bar", box, STEEL, tuple(RemotePoint(name, name, [x, 0.005, 0.01]) for name, x in names))
    model = meshed(generate_mesh(solid, element_size=0.012), solid, 2)
    body = craig_bampton(model, n_modes=3, stress=[StressSurface()], discretization=False, progress=False)
    first = body.readouts["stress"].deviations
    assert np.abs(first[..., 6:]).max() > 0
    assert np.isfinite(first).all()

    plan = plan_stress(model, [StressSurface()])
    fields = np.random.default_rng(1).standard_normal((model.n_dofs, 5))
    turn = np.linalg.qr(np.random.default_rng(2).standard_normal((5, 5)))[0]
    (plain,), (turned,) = (stress_readouts(plan, basis, np.ones(5)) for basis in (fields, fields @ turn))
    np.testing.assert_allclose(turned.deviations, plain.deviations @ turn, atol=1e-9 * np.abs(plain.deviations).max())
    units = np.geomspace(1e-3, 1e3, 5)
    (other,) = stress_readouts(plan, fields * units, 1 / units)
    np.testing.assert_allclose(other.deviations, plain.deviations * units, rtol=1e-6)


def held(model, **supports):
    """Numbers of the unknowns that supports hold, which are as of `ngsolve.VectorH1`."""
    mesh, _ = mesh_and_solid(model)
    return np.flatnonzero(~np.array(ng.VectorH1(mesh, order=model.order, **supports).FreeDofs(), dtype=bool))


def pressure(model, face, size):
    """Forces of a pressure on an upper face."""
    mesh, _ = mesh_and_solid(model)
    test = ng.VectorH1(mesh, order=model.order).TestFunction()
    form = ng.LinearForm(-size * test[2] * ng.ds(definedon=mesh.Boundaries(face)))
    return form.Assemble().vec.FV().NumPy().copy()


def stress_of(model, position, fields):
    """Stress at a point of displacement fields, (6, n)."""
    plan = plan_stress(model, [StressPoint("point", position)])
    return stress_readouts(plan, fields, np.ones(fields.shape[1]))[0].rows[0]


def ellipse(x, y):
    """A quarter of an elliptic disk of these half axes, as a face."""
    plane = occ.WorkPlane(occ.Axes(occ.Pnt(0, 0, 0), occ.Z, occ.X))
    face = plane.Ellipse(x, y).Face()
    return face * occ.WorkPlane().Rectangle(10, 10).Face()


@pytest.mark.slow
def test_nafems_le10_thick_plate():
    """NAFEMS, The Standard NAFEMS Benchmarks, rev. 3 (1990), LE10: sigma_yy at D is -5.38 MPa."""
    ring = ellipse(3.25, 2.75) - ellipse(2.0, 1.0)
    lower = ring.Extrude(0.3 * occ.Z)
    upper = lower.Move(occ.Vec(0, 0, 0.3))
    lower.solids.name, upper.solids.name = "lower", "upper"
    for half in (lower, upper):
        for face in half.faces:
            x, y = face.center.x, face.center.y
            face.name = "flat"
            if x < 1e-6:
                face.name = "x"
            elif y < 1e-6:
                face.name = "y"
            elif face.name == "flat" and np.hypot(x / 3.25, y / 2.75) > 0.85 and face.center.z % 0.3 > 0:
                face.name = "outer"
    upper.faces.Max(occ.Z).name = "top"
    for edge in lower.faces.Max(occ.Z).edges:
        if edge.center.x > 1.5 and edge.center.y > 1.0 and np.hypot(edge.center.x / 3.25, edge.center.y / 2.75) > 0.85:
            edge.name = "rim"
    shape = occ.Glue([lower, upper])
    steel = Material("steel", 210e9, 0.3, 7800.0)
    solid = Solid("plate", shape, {"lower": steel, "upper": steel})
    model = meshed(generate_mesh(solid, element_size=0.4, extrude="z", layer_thickness=0.15), solid, 4)
    supports = held(model, dirichletx="x|outer", dirichlety="y|outer", dirichletz_bbnd="rim")
    displacement = factorize(model.stiffness, held=supports).solve(pressure(model, "top", 1e6))
    assert stress_of(model, (2.0, 0.0, 0.6), displacement[:, None])[1, 0] == pytest.approx(-5.38e6, rel=0.02)


@pytest.mark.slow
def test_nafems_13h_plate_at_resonance():
    """NAFEMS, Selected Benchmarks for Forced Vibration (1989), 13H: 2.377 Hz and 45.42 mm; stress of the first mode."""
    side, thickness, load, ratio = 10.0, 0.05, 100.0, 0.02
    box = occ.Box(occ.Pnt(0, 0, 0), occ.Pnt(side, side, thickness))
    box.solids.name, box.faces.Max(occ.Z).name = "plate", "top"
    box.faces.Min(occ.X).name = box.faces.Max(occ.X).name = "x"
    box.faces.Min(occ.Y).name = box.faces.Max(occ.Y).name = "y"
    with pytest.warns(UserWarning, match="is 10 m long"):
        solid = Solid("plate", box, {"plate": Material("steel", 200e9, 0.3, 8000.0)})
    model = meshed(generate_mesh(solid, element_size=2.5, extrude="z", layer_thickness=thickness), solid, 4)
    free = np.setdiff1d(np.arange(model.n_dofs), held(model, dirichletx="y", dirichlety="x", dirichletz="x|y"))
    stiffness, mass = (matrix[free][:, free] for matrix in (model.stiffness_matrix, model.mass_matrix))
    squares, shapes = eigsh(stiffness.tocsc(), k=6, M=mass.tocsc(), sigma=0.0)
    omega = np.sqrt(squares)
    assert omega[0] / (2 * np.pi) == pytest.approx(2.377, rel=2e-3)
    modes = np.zeros((model.n_dofs, 6))
    modes[free] = shapes
    forces = modes.T @ pressure(model, "top", load)
    amplitudes = forces / (omega**2 - omega[0] ** 2 + 2j * ratio * omega * omega[0])
    mesh, _ = mesh_and_solid(model)
    field, moved = ng.GridFunction(ng.VectorH1(mesh, order=model.order)), []
    for mode in modes.T:
        field.vec.FV().NumPy()[:] = mode
        moved.append(field(mesh(side / 2, side / 2, thickness / 2))[2])
    deflection = abs(np.array(moved) @ amplitudes)
    assert deflection == pytest.approx(45.42e-3, rel=5e-3)
    stress = abs((stress_of(model, (side / 2, side / 2, 0.0), modes) @ amplitudes)[0])
    first = 200e9 * thickness / 2 * (np.pi / side) ** 2 / (1 - 0.3) * 45.42e-3
    assert first == pytest.approx(32.0e6, rel=2e-3)
    assert stress == pytest.approx(first, rel=0.02)
