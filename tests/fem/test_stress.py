"""Stress of reduced bodies: bars in closed form, projections, piezo stacks, two materials, and what is refused."""

import itertools
from dataclasses import replace

import netgen.occ as occ
import ngsolve as ng
import numpy as np
import pytest
from conftest import STEEL, assert_limit, lattice, make_bar, meshed

from nassim import (
    ElectricalPort,
    GaugeLine,
    Material,
    PiezoStack,
    RemotePoint,
    Solid,
    StressPoint,
    StressSurface,
    build_fe_model,
    condense,
    craig_bampton,
    load,
    save,
    von_mises,
)
from nassim.bodies.projection import keep_modes, open_circuit, remove_surface, trim_body
from nassim.bodies.stress import component_rotation, largest_factor, principal_stresses
from nassim.fem import generate_mesh, glue
from nassim.fem.assembly import assemble_mesh, mesh_and_solid
from nassim.fem.element_finder import INSIDE, ElementFinder, lattice as nodes
from nassim.fem.stress import plan_stress, stress_readouts

LENGTH, SIDE, PLACE = 0.1, 0.01, 0.043
AREA, BENDING = SIDE**2, SIDE**4 / 12
TORSION = 0.20817 * SIDE**3
"""Torque over the largest shear stress of a square section: S. Timoshenko, J. Goodier, Theory of Elasticity, 109."""


def affine(body, component, field):
    """Forces of a body force along a component that is the field 1, x, y or z, on the coordinates, (n,)."""
    n = len(body.mass_matrix)
    return body.gram[:4, 4:].reshape(4, n, 3)[field, :, component]


def clamped(body, load, at="left"):
    """Coordinates at rest under a load with a point held."""
    n, first = len(body.mass_matrix), 6 * body.point_names.index(at)
    free = np.setdiff1d(np.arange(n), first + np.arange(6))
    q = np.zeros(n)
    q[free] = np.linalg.solve(body.stiffness_matrix[np.ix_(free, free)], load[free])
    return q


def at_tip(body, direction, size):
    load = np.zeros(len(body.mass_matrix))
    load[6 * body.point_names.index("right") + direction] = size
    return load


SPIN = 300.0
LOADS = {
    "tension": (lambda b: at_tip(b, 0, 100.0), "sxx", 100.0 / AREA),
    "bending by a force": (lambda b: at_tip(b, 2, 10.0), "sxx", -10.0 * (LENGTH - PLACE) * SIDE / 2 / BENDING),
    "bending by a moment": (lambda b: at_tip(b, 4, 2.0), "sxx", 2.0 * SIDE / 2 / BENDING),
    "torsion": (lambda b: at_tip(b, 3, 2.0), "sxy", -2.0 / TORSION),
    "weight": (lambda b: -9.81 * affine(b, 0, 0), "sxx", -9.81 * 7800 * (LENGTH - PLACE)),
    "spin": (lambda b: SPIN**2 * affine(b, 0, 1), "sxx", 7800 * SPIN**2 / 2 * (LENGTH**2 - PLACE**2)),
}


@pytest.mark.parametrize("name", LOADS)
def test_a_bar_has_the_stress_of_its_closed_form(stressed_bar, name):
    make, component, expected = LOADS[name]
    q = clamped(stressed_bar, make(stressed_bar))
    stress = stressed_bar.readouts["top"].stress(q)[0]
    exact = np.zeros(6)
    exact[["sxx", "syy", "szz", "sxy", "syz", "sxz"].index(component)] = expected
    np.testing.assert_allclose(stress, exact, atol=5e-3 * abs(expected))
    if component == "sxx":
        mean = expected - (7800 * SPIN**2 / 2 * 0.01**2 / 3 if name == "spin" else 0)  # over the gauge's length
        assert stressed_bar.readouts["gauge"].row @ q == pytest.approx(mean / 200e9, rel=5e-3)


def test_without_static_corrections_the_weight_would_miss(stressed_bar):
    """The fixed-interface modes alone, which the read-outs of stress do not leave alone, give another stress."""
    q = clamped(stressed_bar, LOADS["weight"][0](stressed_bar))
    q[12 + 4 :] = 0.0
    wrong = stressed_bar.readouts["top"].stress(q)[0, 0]
    assert abs(wrong / LOADS["weight"][2] - 1) > 0.05


def test_projections_and_files_carry_the_stress(stressed_bar, tmp_path):
    """A load inside and weights across: fewer modes, trimmed to one point, and a file."""
    weight = 50.0 * affine(stressed_bar, 2, 0) + 3e3 * affine(stressed_bar, 0, 1)
    expected = [stressed_bar.readouts[name].stress(clamped(stressed_bar, weight)) for name in ("top", "surface stress")]
    scale = np.abs(expected[1]).max()
    fewer = keep_modes(stressed_bar, 6)
    save(fewer, tmp_path / "bar.h5")
    trimmed = trim_body(
        stressed_bar, points=["left"], loads=np.zeros((len(stressed_bar.mass_matrix), 0)), cutoff_frequency=100.0
    )
    assert len(trimmed.mass_matrix) <= 6 + 12
    for body in (load(tmp_path / "bar.h5"), trimmed):
        q = clamped(body, 50.0 * affine(body, 2, 0) + 3e3 * affine(body, 0, 1))
        for name, stress in zip(("top", "surface stress"), expected, strict=True):
            np.testing.assert_allclose(body.readouts[name].stress(q), stress, atol=1e-6 * scale)
    whole = clamped(stressed_bar, weight)
    for name in ("top", "gauge"):  # also where it is the only one
        alone = keep_modes(replace(stressed_bar, readouts={name: stressed_bar.readouts[name]}, enriched=None), 6)
        q = clamped(alone, 50.0 * affine(alone, 2, 0) + 3e3 * affine(alone, 0, 1))
        found, expected_one = (
            body.readouts[name].stress(at)[0] if name == "top" else 200e9 * (body.readouts[name].row @ at)
            for body, at in ((alone, q), (stressed_bar, whole))
        )
        np.testing.assert_allclose(found, expected_one, atol=1e-6 * scale)
    plain = remove_surface(stressed_bar)
    assert plain.readouts["surface stress"].positions.shape == (0, 3)
    assert len(plain.readouts["top"].positions) == 1


def test_a_rigid_motion_has_no_stress(stressed_bar):
    n = len(stressed_bar.mass_matrix)
    q = np.zeros(n)
    turn = np.array([0.1, -0.2, 0.3])
    q[:6] = [0.4, 0.5, -0.6, *turn]
    q[6:12] = [*(q[:3] + np.cross(turn, [LENGTH, 0, 0])), *turn]
    assert np.abs(stressed_bar.readouts["surface stress"].stress(q)).max() < 1e-9 * 200e9


def test_the_mesh_error_estimates_the_true_one():
    """Bending by a force, away from the ends, on a coarse and a finer mesh of order 2: rms over the surface."""
    errors, estimates = [], []
    for size in (0.01, 0.006):
        model = meshed(generate_mesh(make_bar(), element_size=size), make_bar(), 2)
        body = craig_bampton(model, n_modes=0, discretization=False, stress=[StressSurface()], progress=False)
        q, surface = clamped(body, at_tip(body, 2, 10.0)), body.readouts["stress"]
        x, _, z = surface.positions.T
        middle = np.abs(x - 0.05) < 0.025
        error = surface.stress(q)[:, 0] + 10.0 * (LENGTH - x) * z / BENDING
        errors.append(np.sqrt(np.mean(error[middle] ** 2)))
        estimates.append(np.sqrt(np.mean(surface.mesh_error(q)[middle] ** 2)))
    assert estimates[1] < 0.7 * estimates[0]
    for error, estimate in zip(errors, estimates, strict=True):
        assert 0.3 < estimate / error < 5


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_nodes_deviation_is_that_of_the_element_that_deviates_most(sign):
    """Elements of constant strain: their stresses one by one, and the mean of those around each node.

    The mean deviates from that of the elements, and at midpoints of edges from the mean halfway between the ends.
    """
    solid = make_bar()
    model = meshed(generate_mesh(solid, element_size=0.01), solid, 1)
    mesh, n = model._source[0], model.n_dofs // 3
    nodes = np.array([mesh[ng.NodeId(ng.VERTEX, i)].point for i in range(n)])
    field = sign * np.random.default_rng(1).standard_normal((n, 3))
    around = [[v.nr for v in element.vertices] for element in mesh.Elements(ng.VOL)]
    gradients = np.array([np.linalg.solve(nodes[a[1:]] - nodes[a[0]], field[a[1:]] - field[a[0]]) for a in around])
    strain = 0.5 * (gradients + gradients.transpose(0, 2, 1))
    shear = STEEL.young_modulus / (2 * (1 + STEEL.poisson_ratio))
    bulk = 2 * shear * STEEL.poisson_ratio / (1 - 2 * STEEL.poisson_ratio) * np.trace(strain, axis1=1, axis2=2)
    tensor = 2 * shear * strain + bulk[:, None, None] * np.eye(3)
    stress = tensor[:, [0, 1, 2, 0, 1, 0], [0, 1, 2, 1, 2, 2]]  # xx yy zz xy yz xz
    (found,) = stress_readouts(plan_stress(model, [StressSurface()]), field.T.reshape(-1, 1), np.ones(1))
    means, at_nodes = found.rows[:, :, 0], np.linalg.norm(nodes[:, None] - found.positions, axis=2)
    place = {node: int(np.argmin(at_nodes[node])) for node in range(n) if at_nodes[node].min() < 1e-9}
    bends = {node: [] for node in place}
    edges = {tuple(sorted(pair)) for corners in around for pair in itertools.combinations(corners, 2)}
    for a, b in (edge for edge in edges if bends.keys() >= set(edge)):
        distances = np.linalg.norm(0.5 * (nodes[a] + nodes[b]) - found.positions, axis=1)
        if distances.min() < 1e-9:
            bend = means[np.argmin(distances)] - 0.5 * (means[place[a]] + means[place[b]])
            bends[a].append(bend)
            bends[b].append(bend)
    for point, mean, deviation in zip(found.positions, means, found.deviations[:, :, 0], strict=True):
        distances = np.linalg.norm(nodes - point, axis=1)
        node = np.argmin(distances)
        if distances[node] > 1e-9:
            continue  # the middle of an edge
        own = stress[[node in a for a in around]]
        differences = own.mean(axis=0) - own
        assert np.allclose(mean, own.mean(axis=0), rtol=1e-9, atol=1e-9 * np.abs(own).max())
        candidates, size = np.vstack([differences, *bends[node]]), 1e-9 * np.abs(own).max()
        sizes = np.linalg.norm(candidates, axis=1)
        chosen = np.abs(candidates - deviation).max(axis=1) < size
        assert chosen.any(), "it is the deviation of an element, or of an edge"
        assert sizes[chosen].max() > sizes.max() - size


def test_the_deviation_at_a_point_is_that_of_its_element():
    """The second half of a bar is stretched: at the nodes between the halves the mean is half of its stress."""
    solid = make_bar()
    model = meshed(generate_mesh(solid, element_size=0.01, extrude="x", layer_thickness=0.05), solid, 2)
    field, vertices = np.zeros((3, model.n_dofs // 3)), model._source[0].vertices
    field[0, : len(vertices)] = [max(vertex.point[0] - 0.05, 0.0) for vertex in vertices]
    (found,) = stress_readouts(
        plan_stress(model, [StressPoint("second", (0.07, 0.001, 0.002))]), field.reshape(-1, 1), np.ones(1)
    )
    first, second = STEEL.lame_parameters
    stress = np.array([first + 2 * second, first, first, 0.0, 0.0, 0.0])
    np.testing.assert_allclose(found.deviations[0, :, 0], -0.5 * stress, atol=1e-9 * stress[0])


# Stacks


STACK = PiezoStack(
    free_stroke=20e-6, blocked_force=1000.0, voltage_range=200.0, stiffness=50e6, capacitance=5e-6, length=20e-3,
    area=25e-6, transverse_ratio=-0.3,
)  # fmt: skip


@pytest.fixture(scope="module")
def stack_model():
    """A stack between soft points, with Poisson's ratio equal to its transverse ratio: one-dimensional."""
    box = occ.Box(occ.Pnt(0, -2.5e-3, -2.5e-3), occ.Pnt(20e-3, 2.5e-3, 2.5e-3))
    box.solids.name, box.faces.Min(occ.X).name, box.faces.Max(occ.X).name = "stack", "left", "right"
    points = tuple(RemotePoint(n, n, np.array([x, 0, 0])) for n, x in (("left", 0.0), ("right", 20e-3)))
    material = Material("ceramic", STACK.young_modulus, 0.3, 8000.0)
    solid = Solid("stack", box, {"stack": material}, points, (ElectricalPort("v", "stack", STACK),))
    return meshed(generate_mesh(solid, element_size=0.01, layer_thickness=0.005, extrude="x"), solid, 2)


def stressed_middle(model):
    return craig_bampton(model, n_modes=1, stress=[StressPoint("middle", (0.01, 0.0, 0.0))], progress=False)


@pytest.fixture(scope="module")
def stack(stack_model):
    return stressed_middle(stack_model)


def test_a_port_that_a_model_leaves_out_stresses_nothing(stack_model, stack):
    assert list(stack.readouts["middle"].voltages) == ["v"]
    assert stressed_middle(replace(stack_model, ports=())).readouts["middle"].voltages == {}


def test_a_free_stack_has_no_stress_and_a_blocked_one_its_blocked_force(stack):
    volts, place = 100.0, stack.readouts["middle"]
    load = volts * stack.port("v").forces
    free = clamped(stack, load)
    blocked_stress = 1000.0 * volts / 200.0 / 25e-6
    assert np.abs(place.stress(free, {"v": volts})).max() < 1e-3 * blocked_stress
    held = np.zeros_like(free)
    held[12:] = np.linalg.solve(stack.stiffness_matrix[12:, 12:], load[12:])
    assert place.stress(held, {"v": volts})[0, 0] == pytest.approx(-blocked_stress, rel=5e-3)


def test_an_open_stack_stresses_itself_by_its_own_voltage(stack):
    """Under a force alone the stress is force over area, whatever the voltage."""
    body = open_circuit(stack, {"v": 0.0})
    q = clamped(body, at_tip(body, 0, -40.0))
    np.testing.assert_allclose(body.readouts["middle"].stress(q)[0], [-40.0 / 25e-6, *[0] * 5], atol=2e-3 * 40 / 25e-6)


# Two materials


@pytest.fixture(scope="module")
def pair():
    """A bar of steel and aluminium in series."""
    left, right = (occ.Box(occ.Pnt(x, 0, 0), occ.Pnt(x + 0.02, 0.01, 0.01)) for x in (0.0, 0.02))
    left.solids.name, right.solids.name = "steel", "aluminium"
    left.faces.Min(occ.X).name, right.faces.Max(occ.X).name = "left", "right"
    materials = {"steel": STEEL, "aluminium": Material("aluminium", 70e9, 0.33, 2700.0)}
    points = tuple(RemotePoint(n, n, np.array([x, 0.005, 0.005])) for n, x in (("left", 0.0), ("right", 0.04)))
    solid = Solid("pair", glue([left, right]), materials, points)
    return meshed(generate_mesh(solid, element_size=0.01), solid, 2)


def test_stress_is_that_of_either_material_where_two_meet(pair):
    """In series under tension both have the same axial stress; held across, they differ in the other components."""
    middle = (0.02, 0.005, 0.005)
    with pytest.raises(ValueError, match="steel meet, whose stresses differ: give its cad_body"):
        craig_bampton(pair, stress=[StressPoint("glue", middle)], progress=False)
    places = [StressPoint(name, middle, name) for name in ("steel", "aluminium")]
    body = craig_bampton(pair, n_modes=0, discretization=False, stress=[*places, StressSurface()], progress=False)
    q = clamped(body, at_tip(body, 0, 100.0))
    steel, aluminium = (body.readouts[place.name].stress(q)[0] for place in places)
    assert steel[0] == pytest.approx(1e6, rel=0.05)
    assert aluminium[0] == pytest.approx(steel[0], rel=0.02)
    assert steel[1] < -5e4  # aluminium, which contracts more, presses across
    assert aluminium[1] > 5e4
    surface = body.readouts["stress"]
    twice = [p for p in surface.positions if np.allclose(p, (0.02, 0.01, 0.01))]
    assert len(twice) == 2
    edges = np.sort(surface.surface.edges, axis=1)
    np.testing.assert_array_equal(np.unique(edges), np.arange(len(surface.positions)), "on edges in either material")
    sides = np.sort(surface.surface.triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    assert {*map(tuple, edges.tolist())} <= {*map(tuple, sides.tolist())}


def test_a_voltage_stresses_its_stack_and_by_the_force_alone_what_is_beside_it(pair):
    """A stack of steel and aluminium in series between walls."""
    data = {"free_stroke": 20e-6, "blocked_force": 20e3, "voltage_range": 200.0, "capacitance": 50e-6}
    port = ElectricalPort("v", "steel", PiezoStack.from_datasheet(**data, size=(0.02, 0.01, 0.01)))
    mesh, solid = pair._source
    places = [StressPoint(name, (x, 0.005, 0.005)) for name, x in (("steel", 0.01), ("aluminium", 0.03))]
    model = assemble_mesh(mesh, replace(solid, ports=(port,)), 2)
    body = craig_bampton(model, n_modes=0, discretization=False, stress=places, progress=False)
    q = np.zeros(len(body.mass_matrix))
    q[12:] = np.linalg.solve(body.stiffness_matrix[12:, 12:], 100.0 * body.port("v").forces[12:])
    steel, aluminium = (body.readouts[place.name].stress(q, {"v": 100.0})[0, 0] for place in places)
    assert aluminium == pytest.approx(-10e3 / 1e-4 / (1 + 200 / 70), rel=0.2)  # in one dimension
    assert steel == pytest.approx(aluminium, rel=0.1)
    both = assemble_mesh(mesh, replace(solid, ports=(replace(port, bodies=["steel", "aluminium"]),)), 2)
    body = craig_bampton(both, n_modes=0, discretization=False, stress=places, progress=False)
    free = clamped(body, 100.0 * body.port("v").forces)  # both lengthen alike
    for place in places:
        assert np.abs(body.readouts[place.name].stress(free, {"v": 100.0})).max() < 1e-6 * 10e3 / 1e-4


def test_a_gauge_has_the_strain_along_its_line(pair):
    """Of homogeneous deformations with rotations, along a line in a general direction that is no unit vector."""
    along, gradients = np.array([3.0, -1.0, 0.0]), np.random.default_rng(0).normal(size=(3, 3, 3))
    basis = np.column_stack([(gradient @ pair.fields[1:]).ravel() for gradient in gradients])
    (gauge,) = stress_readouts(
        plan_stress(pair, [GaugeLine("g", (0.03, 0.005, 0.01), along, 0.004)]), basis, np.ones(3)
    )
    np.testing.assert_allclose(gauge.row, [along @ gradient @ along / 10 for gradient in gradients], rtol=1e-9)
    assert np.linalg.norm(gauge.ends[1] - gauge.ends[0]) == pytest.approx(0.004)


def test_a_stress_surface_lies_on_its_faces_alone(pair):
    """One end, whose area is that of the section, both ends, and the whole surface."""
    places = [StressSurface("one", "left"), StressSurface("both", ["left", "right"]), StressSurface("all")]
    areas = []
    for surface in stress_readouts(plan_stress(pair, places), np.zeros((pair.n_dofs, 1)), np.ones(1)):
        corners = surface.surface.points[surface.surface.triangles]
        sides = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
        areas.append(0.5 * np.linalg.norm(np.cross(*sides), axis=1).sum())
    np.testing.assert_allclose(areas, [AREA, 2 * AREA, 2 * AREA + 4 * SIDE * 0.04], rtol=1e-9)


def test_a_uniform_strain_has_the_stress_of_hookes_law_in_either_material(pair):
    """Any displacement that is linear in the position, at a point and all over the surface, component by component."""
    gradient = 1e-4 * np.random.default_rng(4).standard_normal((3, 3))
    field = (gradient @ pair.fields[1:]).reshape(-1, 1)
    plan = plan_stress(pair, [StressPoint("inside", (0.013, 0.004, 0.0071)), StressSurface()])
    inside, surface = stress_readouts(plan, field, np.ones(1))
    strain, expected = (gradient + gradient.T) / 2, {}
    for name, material in mesh_and_solid(pair)[1].materials.items():
        first, second = material.lame_parameters
        tensor = first * np.trace(strain) * np.eye(3) + 2 * second * strain
        expected[name] = [*np.diag(tensor), tensor[0, 1], tensor[1, 2], tensor[0, 2]]
    np.testing.assert_allclose(inside.rows[0, :, 0], expected["steel"], rtol=1e-7)
    found = surface.rows[..., 0]
    near = {name: np.isclose(found, values, rtol=1e-7).all(axis=1) for name, values in expected.items()}
    x = surface.positions[:, 0]
    assert np.all(near["steel"] ^ near["aluminium"])
    assert (x[near["steel"]].max(), x[near["aluminium"]].min()) == (pytest.approx(0.02), pytest.approx(0.02))


# Algebra


def test_components_turn_as_a_tensor():
    rng = np.random.default_rng(5)
    turn = np.linalg.qr(rng.standard_normal((3, 3)))[0]
    turn *= np.linalg.det(turn)
    stress = rng.standard_normal(6)
    xx, yy, zz, xy, yz, xz = stress
    tensor = turn @ np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]) @ turn.T
    turned = component_rotation(turn) @ stress
    np.testing.assert_allclose(turned, [*np.diag(tensor), tensor[0, 1], tensor[1, 2], tensor[0, 2]], atol=1e-14)
    np.testing.assert_allclose(principal_stresses(turned), np.linalg.eigvalsh(tensor)[::-1], atol=1e-13)
    s1, s2, s3 = principal_stresses(stress)
    expected = np.sqrt(((s1 - s2) ** 2 + (s2 - s3) ** 2 + (s3 - s1) ** 2) / 2)
    np.testing.assert_allclose([von_mises(turned), von_mises(stress)], expected, rtol=1e-13)


def test_the_largest_factor_reaches_the_limit():
    rng = np.random.default_rng(6)
    constant, variable = rng.standard_normal((2, 40, 6))
    limit = 1.5 * von_mises(constant).max()
    factors = largest_factor(constant, variable, limit)
    np.testing.assert_allclose(von_mises(constant + factors[:, None] * variable), limit, rtol=1e-12)
    assert factors.min() > 0
    assert np.isinf(largest_factor(constant[0], np.array([1.0, 1, 1, 0, 0, 0]) * 0, limit))
    with pytest.raises(ValueError, match="the constant loads alone"):
        largest_factor(constant, variable, 0.9 * von_mises(constant).max())


@pytest.mark.parametrize("kind", INSIDE)
@pytest.mark.parametrize("order", [1, 2, 3])
def test_nodes_of_elements_interpolate_uniquely(kind, order):
    exponents = nodes(kind, order)
    matrix = np.prod((exponents / order)[:, None, :] ** exponents, axis=2)
    assert np.linalg.matrix_rank(matrix) == len(exponents)


# Refusals


REFUSED = {
    "outside": (StressPoint("p", (0.05, 0.0, 0.006)), r"'p' at \(50, 0, 6\) mm lies outside solid 'bar', 1 mm from it"),
    "millimetres": (StressPoint("p", (50.0, 0.0, 0.0)), "in metres and in the frame of its CAD"),
    "edge": (GaugeLine("g", (0.05, 0.0045, 0.005), (0, 1, 0), 0.002), "leaves the surface by 0.5 mm"),
    "inside": (GaugeLine("g", (0.05, 0.0, 0.0), (1, 0, 0), 0.002), "give the middle of the gauge on a face"),
    "no CAD body": (StressPoint("p", (0.05, 0.0, 0.0), "foot"), "unknown CAD body of stress point 'p' 'foot'"),
    "no face": (StressSurface("s", ("top",)), "unknown outer face of stress surface 's' 'top'"),
    "a taken name": (StressPoint("left", (0.05, 0.0, 0.0)), "left"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_places_that_are_not_on_the_solid_are_refused_before_the_reduction(name, bar_model):
    place, message = REFUSED[name]
    with pytest.raises(ValueError, match=message):
        craig_bampton(bar_model, stress=[place], progress=False)


GAUGE = GaugeLine("g", (0.05, 0.0, 0.005), (1, 0, 0), 0.002)
NO_PLACES = {
    "a point nowhere": (lambda: StressPoint("p", (0.0, np.nan, 0.0)), "stress point 'p': position holds 1 value"),
    "a point of a plane": (lambda: StressPoint("p", (0.0, 1.0)), "'p': position must have shape 3, got 2"),
    "a face twice": (lambda: StressSurface("s", ("top", "top")), "'s': face names must differ; .* once: top"),
    "a face without a name": (lambda: StressSurface("s", ("",)), "'s': face names must be non-empty"),
    "a gauge nowhere": (lambda: replace(GAUGE, position=(np.inf, 0.0, 0.0)), "gauge 'g': position holds 1 value"),
    "no direction": (lambda: replace(GAUGE, direction=(0, 0, 0)), "gauge 'g': direction must not be zero"),
    "an unknown direction": (lambda: replace(GAUGE, direction=(0, np.nan, 0)), "gauge 'g': direction holds 1 value"),
    "no length": (lambda: replace(GAUGE, length=0.0), "gauge 'g': length must be positive, got 0 m"),
}


@pytest.mark.parametrize("case", NO_PLACES)
def test_what_is_no_place_is_refused_when_made(case):
    make, message = NO_PLACES[case]
    with pytest.raises(ValueError, match=message):
        make()


@pytest.fixture(scope="module")
def bar_model():
    return meshed(generate_mesh(make_bar(), element_size=0.02, extrude="x"), make_bar(), 1)


def test_points_beside_the_solid_count_up_to_a_thousandth_of_an_element(bar_model):
    size = ElementFinder(bar_model._source[0], bar_model._source[1]).size(np.array([0.05, 0.0, 0.005]))
    assert size == pytest.approx(np.linalg.norm([0.02, 0.01, 0.01])), "the diagonal of a layer's prism"
    assert_limit(
        lambda share: plan_stress(bar_model, [StressPoint("p", (0.05, 0.0, 0.005 + share * 1e-3 * size))]),
        "'p' at .* lies outside solid 'bar'",
    )


def test_points_inside_thin_walls_are_inside():
    """Less than 1 mm from all faces."""
    leaf = occ.Box(occ.Pnt(0, 0, 0), occ.Pnt(0.01, 0.005, 0.001))
    leaf.solids.name, leaf.faces.Min(occ.X).name = "leaf", "root"
    solid = Solid("leaf", leaf, {"leaf": STEEL}, (RemotePoint("root", "root", np.zeros(3)),))
    model = meshed(generate_mesh(solid, element_size=0.005), solid, 1)
    assert plan_stress(model, [StressPoint("middle", (0.005, 0.002, 0.0005))]).evaluations
    with pytest.raises(ValueError, match=r"outside solid 'leaf', 0\.2 mm from it"):
        plan_stress(model, [StressPoint("above", (0.005, 0.002, 0.0012))])


def test_points_inside_the_solid_and_beside_its_mesh_are_inside():
    """The mesh of a rod of 10 mm has flat faces, between which points 0.05 mm below the surface lie."""
    rod = occ.Cylinder(occ.Pnt(0, 0, 0), occ.Z, r=0.01, h=0.02)
    rod.solids.name, rod.faces.Min(occ.Z).name = "rod", "root"
    solid = Solid("rod", rod, {"rod": STEEL}, (RemotePoint("root", "root", np.zeros(3)),))
    finder = ElementFinder(ng.Mesh(generate_mesh(solid, element_size=0.01, curvature=2.0)), solid)
    angles = np.linspace(0, 2 * np.pi, 12, endpoint=False)
    places = 0.00995 * np.column_stack([np.cos(angles), np.sin(angles), np.ones(12)])
    assert any(finder.mesh(*place).nr < 0 for place in places.tolist())
    for place in places:
        found = finder.positions(finder.find("point", place))[0]
        assert np.linalg.norm(found - place) < 0.001


def test_a_gauge_over_an_edge_between_two_faces_is_refused(pair):
    """Two faces of one plane: the strain jumps where their materials meet."""
    gauge = GaugeLine("g", (0.02, 0.005, 0.01), (1, 0, 0), 0.004)
    with pytest.raises(ValueError, match="crosses an edge: no one face holds all of its length of 4 mm"):
        craig_bampton(pair, stress=[gauge], progress=False)


def test_a_model_without_a_mesh_is_refused():
    with pytest.raises(ValueError, match="not made from a mesh by build_fe_model, so stress cannot be computed"):
        craig_bampton(lattice(), stress=[StressSurface()], progress=False)


def test_a_surface_of_a_mesh_that_bends_more_than_its_elements_is_refused():
    """Edges of third order between nodes of second order."""
    rod = occ.Cylinder((0, 0, 0), occ.Vec(1, 2, 3), 0.004, 0.008)
    rod.name = "rod"
    solid = Solid("rod", rod, {"rod": STEEL})
    mesh = ng.Mesh(generate_mesh(solid, element_size=0.005))
    mesh.Curve(3)
    with pytest.raises(ValueError, match=r"'stress': no node of an element lies at .* raise the order"):
        plan_stress(assemble_mesh(mesh, solid, 2), [StressSurface()])


def test_stress_of_other_coordinates_is_refused(stressed_bar):
    with pytest.raises(ValueError, match=r"reads .* coordinates, got an array"):
        stressed_bar.readouts["top"].stress(np.zeros(3))
    with pytest.raises(ValueError, match="positions"):
        replace(stressed_bar.readouts["top"], positions=np.zeros((2, 2)))


def test_a_condensation_keeps_stress_too(bar_model):
    places = [StressPoint("p", (0.05, 0.0, 0.0))]
    bodies = [
        craig_bampton(of, n_modes=0, stress=places, discretization=False, progress=False)
        for of in (bar_model, condense(bar_model, progress=False))
    ]
    q = [clamped(body, at_tip(body, 0, 1.0)) for body in bodies]
    stresses = [body.readouts["p"].stress(own) for body, own in zip(bodies, q, strict=True)]
    np.testing.assert_allclose(*stresses, atol=1e-9)


def test_the_report_tells_which_points_lie_at_a_sharp_edge():
    """A leaf on a foot: halfway its stress is that of a beam, at the sharp edge of its root no mesh resolves it."""
    shape = occ.Box((-0.01, 0, 0), (0.01, 0.002, 0.006)) + occ.Box((-0.001, 0, 0.006), (0.001, 0.002, 0.036))
    shape.solids.name, shape.faces.Min(occ.Z).name, shape.faces.Max(occ.Z).name = "leaf", "left", "right"
    points = (
        RemotePoint("left", "left", (0, 0.001, 0), "rbe2"),
        RemotePoint("right", "right", (0, 0.001, 0.036), "rbe2"),
    )
    model = build_fe_model(
        Solid("leaf", shape, STEEL, points), element_size=0.003, order=3, extrude="y", progress=False
    )
    places = [StressPoint("root", (0.001, 0.001, 0.006)), StressPoint("half", (0.001, 0.001, 0.021))]
    body = craig_bampton(model, stress=places, discretization=False, progress=False)
    told = body.record["error of the stress by the mesh, in the first modes with 'left' clamped (estimate)"]
    root, half = (float(text.split()[-2]) / 100 for text in told.split(","))
    found = body.readouts["half"].stress(clamped(body, at_tip(body, 0, 1.0)))[0, 2]
    true = 0.015 * 0.001 / (0.002**4 / 12)  # Pa by 1 N at the tip
    assert abs(abs(found) / true - 1) < 2 * half < 0.1
    assert root > 5 * half
    assert root > 0.3
