"""Geometric stiffness of reduced bodies: the full model's tangent, columns, rigid rotations, blades, piezo stacks."""

from dataclasses import replace

import calculix
import netgen.occ as occ
import ngsolve as ng
import numpy as np
import pytest
import scipy.linalg
import scipy.sparse as sp
from conftest import lattice, meshed
from scipy.spatial.transform import Rotation

from models.apa300ml import make_apa300ml
from nassim import (
    ElectricalPort,
    Material,
    PiezoStack,
    RemotePoint,
    Solid,
    condense,
    craig_bampton,
    load as load_file,
    save,
)
from nassim.base.rigid_motion import rigid_motions
from nassim.bodies.projection import keep_modes, open_circuit, project, trim_body
from nassim.fem import glue
from nassim.fem.assembly import mesh_and_solid
from nassim.fem.condensation import vector_dofs
from nassim.fem.meshing import generate_mesh
from nassim.fem.regions import by_body
from nassim.fem.stress_stiffness import _stress_form

STEEL = Material("steel", 210e9, 0.3, 7800.0)
STACK = PiezoStack(
    free_stroke=20e-6,
    blocked_force=1000.0,
    voltage_range=200.0,
    stiffness=50e6,
    capacitance=5e-6,
    length=20e-3,
    area=25e-6,
    transverse_ratio=-0.3,
)
CERAMIC = Material("ceramic", STACK.young_modulus, 0.3, 8000.0)


def bar(size, couplings=("rbe3", "rbe3"), material=STEEL, ports=()):
    """A bar along x from "foot" at the origin to "tip"."""
    length, width, height = size
    box = occ.Box(occ.Pnt(0, -width / 2, -height / 2), occ.Pnt(length, width / 2, height / 2))
    box.solids.name, box.faces.Min(occ.X).name, box.faces.Max(occ.X).name = "bar", "foot", "tip"
    ends = zip(("foot", "tip"), (0.0, length), couplings, strict=True)
    points = tuple(RemotePoint(name, (name,), np.array([x, 0, 0]), coupling) for name, x, coupling in ends)
    return Solid("bar", box, {"bar": material}, points, ports)


def bar_mesh(solid, size, layers):
    """Two prisms in each layer."""
    return generate_mesh(solid, element_size=2 * size[1], layer_thickness=size[0] / layers, extrude="x")


def bar_model(size, *, order, layers, **more):
    solid = bar(size, **more)
    return meshed(bar_mesh(solid, size, layers), solid, order)


def reduced(model, n_modes):
    return craig_bampton(model, n_modes=n_modes, geometric_stiffness=True, progress=False)


def under(body, free, force, body_force=None):
    """Stiffness, mass and geometric stiffness on some coordinates, the others held, at rest under forces on these."""
    keep, static = np.ix_(free, free), np.zeros(len(body.mass_matrix))
    static[free] = np.linalg.solve(body.stiffness_matrix[keep], force)
    stress = body.stress_stiffness.stiffness(static, body_force)
    return body.stiffness_matrix[keep], body.mass_matrix[keep], stress[keep]


def weight(body, body_force):
    """Forces of an affine body force on all coordinates."""
    n = len(body.mass_matrix)
    return np.einsum("bjb->j", (body_force @ body.gram[:4, 4:]).reshape(3, n, 3))


def energy_form(model, voltage):
    """NGSolve's form of the strain energy of large deformation, whose derivatives it takes itself, and its state."""
    mesh, solid = mesh_and_solid(model)
    space = ng.VectorH1(mesh, order=model.order)
    u = space.TrialFunction()
    lame = {name: material.lame_parameters for name, material in solid.materials.items()}
    lambda_, mu = (by_body(mesh, {name: values[k] for name, values in lame.items()}) for k in range(2))
    strain = ng.Sym(ng.Grad(u)) + 0.5 * ng.Grad(u).trans * ng.Grad(u)
    energy = mu * ng.InnerProduct(strain, strain) + 0.5 * lambda_ * ng.Trace(strain) ** 2
    for port in solid.ports:
        (first, second), free = solid.materials[port.bodies[0]].lame_parameters, port.strain_per_volt
        blocked = first * np.trace(free) * np.eye(3) + 2 * second * free
        energy -= voltage * ng.InnerProduct(ng.CoefficientFunction(tuple(blocked.ravel()), dims=(3, 3)), strain)
    form = ng.BilinearForm(space)
    form += ng.Variation(energy * ng.dx(bonus_intorder=2 * model.order))
    return form, ng.GridFunction(space)


def tangent(form, state, displacement):
    """The full model's tangent stiffness at a displacement."""
    state.vec.FV().NumPy()[:] = displacement
    form.AssembleLinearization(state.vec)
    values, columns, starts = (np.array(part) for part in form.mat.CSR())
    return sp.csr_matrix((values, columns, starts), shape=2 * [len(displacement)])


def tangent_change(model, displacement, voltage):
    """First-order change of the full model's tangent stiffness."""
    volts = ng.Parameter(0.0)
    (form, state), change = energy_form(model, volts), 0.0
    step = 0.1 / np.abs(displacement).max() * np.ptp(model.fields[1])  # far from rounding; the tangent is quadratic
    for sign in (1, -1):
        volts.Set(sign * step * voltage)
        change = change + sign * tangent(form, state, sign * step * displacement) / (2 * step)
    return change


@pytest.fixture(scope="module")
def stack():
    """A stack of two layers, held by the mean motions of its ends."""
    return bar_model(
        (20e-3, 5e-3, 5e-3), order=2, layers=2, material=CERAMIC, ports=(ElectricalPort("v", "bar", STACK),)
    )


def test_any_load_changes_the_stiffness_as_in_the_full_model(stack):
    """Points, affine body forces and a voltage together: the stress and the change of shape."""
    condensed, rng = condense(stack, progress=False), np.random.default_rng(3)
    q, field, voltage = rng.standard_normal(12), rng.standard_normal((3, 4)), 30.0
    field *= np.array([1e5, 1e7, 1e7, 1e7])
    q *= 1e-6 * np.tile(np.repeat([1.0, 1e2], 3), 2)
    forces = (
        np.kron(field, stack.scalar_mass_matrix.toarray()) @ stack.fields.ravel() + voltage * stack.port("v").forces
    )
    displacement = condensed.constraint_modes @ q + condensed.solve_fixed(forces)
    expected = condensed.constraint_modes.T @ tangent_change(stack, displacement, voltage) @ condensed.constraint_modes
    body = craig_bampton(condensed, n_modes=0, geometric_stiffness=True, progress=False)
    n = len(body.mass_matrix)  # with the mode of the port, which is at rest here
    found = body.stress_stiffness.stiffness(np.append(q, np.zeros(n - 12)), field, {"v": voltage})[:12, :12]
    scale = np.sqrt(np.abs(np.diag(expected)))
    assert np.abs((found - expected) / np.outer(scale, scale)).max() < 1e-8


COLUMN = (0.25, 0.01, 0.01)


@pytest.fixture(scope="module")
def column_mesh():
    return bar_mesh(bar(COLUMN), COLUMN, 4)


def test_columns_buckle_at_eulers_load(column_mesh):
    """With Engesser's shear; the modes hold the sine of the deflection better and better."""
    euler = np.pi**2 * STEEL.young_modulus * COLUMN[1] ** 4 / 12 / (4 * COLUMN[0] ** 2)
    shear = 5 / 6 * STEEL.young_modulus / 2.6 * COLUMN[1] ** 2
    body = reduced(meshed(column_mesh, bar(COLUMN), 4), 4)
    for n_modes, error in ((0, 0.01), (2, 1e-3), (4, 1e-3)):
        free = np.arange(6, 12 + n_modes)
        stiffness, _, stress = under(keep_modes(body, n_modes), free, -np.eye(len(free))[0])
        load = 1 / scipy.linalg.eigh(-stress, stiffness)[0][-1]
        assert load == pytest.approx(euler / (1 + euler / shear), rel=error)


# Points that follow the mean of their faces have no rotation of second order: only forces along the bar there.
@pytest.mark.parametrize(
    ("coupling", "force", "gravity", "slopes"),
    [
        ("rbe2", [-100.0, 30.0, 20.0], [500.0, -900.0, 300.0], 2e5 * np.array([[1, 5, -3], [2, -9, 4], [1, 6, 8]])),
        ("rbe3", [-100.0, 0, 0], [700.0, 0, 0], np.zeros((3, 3))),
    ],
)
def test_rigid_rotations_feel_the_virial(column_mesh, coupling, force, gravity, slopes):
    """A force F at p, and body forces b at x, have the energy -F . (theta x (theta x p)) / 2 and the like."""
    body = reduced(meshed(column_mesh, bar(COLUMN, couplings=2 * [coupling]), 2), 0)
    field = np.column_stack([gravity, slopes])
    static = np.zeros(12)
    push = weight(body, field) + np.concatenate([np.zeros(6), force, np.zeros(3)])
    static[6:] = np.linalg.solve(body.stiffness_matrix[6:, 6:], push[6:])
    moments = np.outer(force, [COLUMN[0], 0, 0]) + field @ body.gram[:4, 1:4]
    found = on_rotations(body, body.stress_stiffness.stiffness(static, field))
    assert np.abs(found - virial(moments)).max() < 1e-6 * np.abs(moments).max()


def test_voltages_press_on_held_ends_with_the_blocked_force(stack):
    """The transverse strain is that of a pressed bar, so the stress is uniaxial and nothing moves."""
    body = reduced(stack, 0)
    found = on_rotations(body, body.stress_stiffness.stiffness(np.zeros(len(body.mass_matrix)), voltages={"v": 30.0}))
    expected = virial(np.diag([-30.0 * STACK.force_per_volt * STACK.length, 0, 0]))
    assert np.abs(found - expected).max() < 1e-6 * np.abs(expected).max()
    alone = on_rotations(body, body.stress_stiffness.of_voltages({"v": 30.0}))
    assert np.abs(alone - expected).max() < 1e-6 * np.abs(expected).max()


def test_voltages_press_across_rigid_ends_as_these_turn():
    """Where nothing deforms: the stress inside, and the work of what holds the end on its way through finite turns."""
    port = ElectricalPort("v", "bar", replace(STACK, transverse_ratio=-0.45))
    size, ends = (20e-3, 5e-3, 5e-3), ("rbe3", "rbe2")
    model = bar_model(size, order=1, layers=1, material=CERAMIC, ports=(port,), couplings=ends)
    condensed = condense(model, progress=False)
    stress = _stress_form(model, ["v"])(np.zeros(model.n_dofs), np.array([30.0]))
    inside = sum(part.T @ (stress @ part) for part in condensed.constraint_modes[:, 9:12].reshape(3, -1, 3))
    tip = model.coupling("tip")
    holding = -30.0 * model.ports[0].forces[vector_dofs(tip, model.n_dofs)].reshape(3, -1)
    arms = model.fields[1:, tip.dofs] - tip.point.position[:, None]

    def work(turn):
        return np.sum(holding * (Rotation.from_rotvec(turn).as_matrix() @ arms))

    steps = 1e-3 * np.eye(3)
    turned = [[sum(i * j * work(i * a + j * b) for i in (1, -1) for j in (1, -1)) / 4e-6 for a in steps] for b in steps]
    assert np.abs(turned).max() > 0.1 * np.abs(inside).max()
    body = craig_bampton(condensed, n_modes=0, geometric_stiffness=True, discretization=False, progress=False)
    found = body.stress_stiffness.of_voltages({"v": 30.0})[9:12, 9:12]
    np.testing.assert_allclose(found, inside + turned, rtol=0, atol=1e-5 * np.abs(inside).max())


def test_the_stiffness_by_a_voltage_is_the_sum_of_those_of_its_bodies():
    """Two stacks in a row, each with a port of its own, or both with one."""
    stacks = [occ.Box((x, -2.5e-3, -2.5e-3), (x + 20e-3, 2.5e-3, 2.5e-3)) for x in (0.0, 20e-3)]
    for each, name in zip(stacks, ("lower", "upper"), strict=True):
        each.name = name
    solid = Solid("row", glue(stacks), CERAMIC)
    mesh = bar_mesh(solid, (40e-3, 5e-3, 5e-3), 2)

    def stiffness(**ports):
        made = replace(solid, ports=[ElectricalPort(*port, STACK) for port in ports.items()])
        model = meshed(mesh, made, 1)
        return _stress_form(model, list(ports))(np.zeros(model.n_dofs), np.full(len(ports), 30.0)).to_scipy().toarray()

    apart, together = stiffness(a="lower", b="upper"), stiffness(v=("lower", "upper"))
    np.testing.assert_allclose(apart, together, rtol=0, atol=1e-12 * np.abs(together).max())
    assert np.abs(together).max() > 0


def test_translations_of_three_points_together_have_no_stress():
    """Beside a motion of the first point alone, which strains the body."""
    size = (20e-3, 5e-3, 5e-3)
    solid = bar(size)
    solid.shape.faces.Max(occ.Z).name = "side"
    side = RemotePoint("side", "side", np.array([9e-3, 1e-3, 4e-3]))
    solid = replace(solid, remote_points=(*solid.remote_points, side))
    body = reduced(meshed(bar_mesh(solid, size, 2), solid, 2), 0)
    for motion in rigid_motions(body.positions, 18).T[:3]:
        alone = np.abs(body.stress_stiffness.stiffness(np.where(np.arange(18) < 6, motion, 0.0))).max()
        assert np.abs(body.stress_stiffness.stiffness(motion)).max() < 1e-8 * alone


def virial(moments):
    return np.trace(moments) * np.eye(3) - 0.5 * (moments + moments.T)


def on_rotations(body, matrix):
    """A matrix on rigid rotations about the origin."""
    rotations = rigid_motions(body.positions, len(matrix))[:, 3:]
    return rotations.T @ matrix @ rotations


def test_a_leaf_spring_under_half_its_buckling_load_as_the_prestressed_full_model():
    """Guided: its tip moves along and across. The full model has the tangent of its static state."""
    model = bar_model((0.08, 0.01, 1e-3), order=3, layers=4, couplings=("rbe2", "rbe2"))
    body, free = reduced(model, 10), np.r_[6, 8, 12:22]
    stiffness, mass, stress = under(body, free, -np.eye(len(free))[0])
    load = 0.5 / scipy.linalg.eigh(-stress[1:, 1:], stiffness[1:, 1:])[0][-1]
    moved = [np.isin(np.arange(model.n_dofs // 3), model.coupling(name).dofs) for name in ("foot", "tip")]
    inner = np.flatnonzero(np.tile(~moved[0] & ~moved[1], 3))
    tip = sp.csc_matrix(np.kron(np.eye(3)[:, ::2], (model.fields[0] * moved[1])[:, None]))
    whole = sp.hstack([sp.eye(model.n_dofs, format="csc")[:, inner], tip]).tocsc()
    k = (whole.T @ model.stiffness_matrix @ whole).tocsc()
    pushed = np.zeros(k.shape[0])
    pushed[-2] = -load
    change = tangent_change(model, whole @ sp.linalg.spsolve(k, pushed), 0.0)
    m, k_s = whole.T @ model.mass_matrix @ whole, whole.T @ change @ whole
    for sign in (-1, 1):
        found = np.sqrt(scipy.linalg.eigh(stiffness + sign * load * stress, mass)[0][:2])
        expected = np.sqrt(np.sort(sp.linalg.eigsh((k + sign * k_s).tocsc(), k=2, M=m.tocsc(), sigma=0.0)[0]))
        assert found == pytest.approx(expected, rel=2e-4)


def test_a_leaf_spring_bent_by_its_thickness_as_by_large_deformation_of_the_full_model():
    """Clamped at its foot, pushed across and along at its tip. Without the square, it would have no equilibrium."""
    model = bar_model((0.08, 0.01, 1e-3), order=3, layers=4, couplings=("rbe2", "rbe3"))
    (form, state), body = energy_form(model, ng.Parameter(0.0)), reduced(model, 10)
    held = np.isin(np.arange(model.n_dofs // 3), model.coupling("foot").dofs)
    inner = np.flatnonzero(np.tile(~held, 3))
    push = np.array([-4.0, 0.0, 1.0]) @ averages(model, "tip").toarray()[:3]
    displacement, rest = np.zeros(model.n_dofs), ng.GridFunction(state.space).vec
    mass = model.mass_matrix.tocsc()[inner][:, inner]
    for _ in range(6):
        whole = tangent(form, state, displacement).tocsc()[inner][:, inner]
        form.Apply(state.vec, rest)
        displacement[inner] += sp.linalg.splu(whole).solve((push - rest.FV().NumPy())[inner])
    whole = tangent(form, state, displacement).tocsc()[inner][:, inner]
    assert (averages(model, "tip") @ displacement)[2] > 0.9e-3
    expected = np.sqrt(np.sort(sp.linalg.eigsh(whole, k=3, M=mass, sigma=0.0)[0]))
    free = np.arange(6, len(body.mass_matrix))
    keep, static = np.ix_(free, free), np.zeros(len(body.mass_matrix))
    static[free] = np.linalg.solve(body.stiffness_matrix[keep], np.eye(len(free))[:, [0, 2]] @ [-4.0, 1.0])
    stiffness, inertia = body.stiffness_matrix[keep], body.mass_matrix[keep]
    added = body.stress_stiffness.under(static).added_to(body.strain)[keep]
    assert np.sqrt(scipy.linalg.eigh(stiffness + added, inertia)[0][:3]) == pytest.approx(expected, rel=1e-3)
    first_order = body.stress_stiffness.stiffness(static)[keep]
    assert scipy.linalg.eigh(stiffness + first_order, inertia)[0][0] < 0


def averages(model, name):
    """Rows that read the motion of a remote point, (6, n_dofs)."""
    coupling = model.coupling(name)
    rows = sp.lil_matrix((6, model.n_dofs))
    rows[:, vector_dofs(coupling, model.n_dofs)] = coupling.averages
    return rows.tocsr()


@pytest.mark.slow
def test_a_pulled_actuator_as_by_large_deformation_of_the_full_model():
    """The APA300ML clamped at its bottom, 50 N along its axis: the shape changes as much as the stress acts."""
    solid = make_apa300ml()
    model = meshed(generate_mesh(solid, element_size=12e-3), solid, 2)
    form, state = energy_form(model, ng.Parameter(0.0))
    held, mass = averages(model, "bottom"), model.mass_matrix.tocsc()
    pull = 50.0 * averages(model, "top").toarray()[2]

    def clamped(matrix):
        """Frequencies with the bottom held, and the solver of static displacements."""
        scale, n = np.abs(matrix).max(), model.n_dofs
        factor = sp.linalg.splu(sp.bmat([[matrix / scale, held.T], [held, None]]).tocsc())

        def solve(load):
            return factor.solve(np.concatenate([load / scale, np.zeros(6)]))[:n]

        inverse = sp.linalg.LinearOperator((n, n), matvec=solve)
        start = solve(mass @ np.random.default_rng(0).standard_normal(n))
        return np.sqrt(np.sort(sp.linalg.eigsh(matrix, k=4, M=mass, sigma=0.0, OPinv=inverse, v0=start)[0])), solve

    displacement, rest = np.zeros(model.n_dofs), ng.GridFunction(state.space).vec
    before, solve = clamped(tangent(form, state, displacement))
    for _ in range(3):
        tangent(form, state, displacement)
        form.Apply(state.vec, rest)
        displacement = displacement + solve(pull - rest.FV().NumPy())
        after, solve = clamped(tangent(form, state, displacement))
    body = reduced(model, 12)
    bottom = 6 * body.point_names.index("bottom")
    free = np.delete(np.arange(len(body.mass_matrix)), np.s_[bottom : bottom + 6])
    force = 50.0 * (free == body.coordinate_names.index("top.uz"))
    stiffness, inertia, stress = under(body, free, force)
    unloaded, loaded = (np.sqrt(scipy.linalg.eigh(k, inertia)[0][:4]) for k in (stiffness, stiffness + stress))
    assert loaded - unloaded == pytest.approx(after - before, rel=0.05)


def test_rotating_cantilevers_stiffen():
    """Flapping, along the axis, where no force of the spin changes: slenderness 70, A. Hamza Cherif and A. Houmat."""
    height = np.sqrt(12) / 70
    body, free = reduced(bar_model((1.0, height, height), order=4, layers=4), 6), np.arange(6, 18)
    unit = np.sqrt(STEEL.young_modulus * height**2 / 12 / STEEL.density)  # sqrt(E I / (rho A L^4))
    for speed, flap in ((2, 4.1373), (10, 11.2023)):
        spin = np.hstack([np.zeros((3, 1)), (speed * unit) ** 2 * np.diag([1.0, 1.0, 0.0])])
        stiffness, mass, stress = under(body, free, weight(body, spin)[free], spin)
        squares, shapes = scipy.linalg.eigh(stiffness + stress, mass)
        flapping = np.argmax(np.abs(shapes[2, :2]))
        assert np.sqrt(squares[flapping]) / unit == pytest.approx(flap, rel=2e-3)


@pytest.mark.skipif(calculix.PROGRAM is None, reason="CalculiX is not installed (Debian: calculix-ccx)")
def test_calculix_finds_the_same_prestressed_frequencies_and_buckling_factor(tmp_path):
    """A leaf spring that stands and hangs under half of the body force of its buckling, and one that spins."""
    solid, field = bar((0.06, 0.01, 2e-3), couplings=("rbe2", "rbe3")), np.zeros((3, 4))
    model = meshed(generate_mesh(solid, element_size=5e-3), solid, 2)
    body, free = reduced(model, 8), np.arange(6, 20)
    field[0, 0] = -1.0
    stiffness, mass, stress = under(body, free, weight(body, field)[free], field)
    factor = 1 / scipy.linalg.eigh(-stress, stiffness)[0][-1]
    expected = calculix.buckling_factors(model, tmp_path, fixed=["foot"], n=1, loads="ALL, GRAV, 1., -1., 0., 0.")
    assert factor == pytest.approx(expected[0], rel=1e-3)
    for sign in (-1, 1):
        found = np.sqrt(scipy.linalg.eigh(stiffness + 0.5 * sign * factor * stress, mass)[0][:3]) / (2 * np.pi)
        loads = f"ALL, GRAV, {0.5 * factor:.15g}, {-sign}., 0., 0."
        expected = calculix.eigenfrequencies(model, tmp_path, fixed=["foot"], n=3, loads=loads)
        assert found == pytest.approx(expected, rel=5e-4)
    pull, n = 3000.0**2 * (np.eye(3) - np.outer([0, 0.6, 0.8], [0, 0.6, 0.8])), len(body.mass_matrix)
    spin, pairs = np.hstack([np.zeros((3, 1)), pull]), body.gram[4:, 4:].reshape(n, 3, n, 3)
    stiffness, mass, stress = under(body, free, weight(body, spin)[free], spin)
    softening = np.einsum("jakb,ab->jk", pairs, pull)[np.ix_(free, free)]
    found = np.sqrt(scipy.linalg.eigh(stiffness + stress - softening, mass)[0][:3]) / (2 * np.pi)
    loads = "ALL, CENTRIF, 9e6, 0., 0., 0., 0., 0.6, 0.8"
    expected = calculix.eigenfrequencies(model, tmp_path, fixed=["foot"], n=3, loads=loads)
    assert found == pytest.approx(expected, rel=1e-3)


def test_open_circuits_stiffen_by_the_voltage_that_follows_the_motion(stack):
    body, rng = reduced(stack, 3), np.random.default_rng(1)
    port, q = body.port("v"), rng.standard_normal(len(body.mass_matrix))
    voltage = -port.forces @ q / (port.blocked_capacitance + 1e-6)
    opened = open_circuit(body, {"v": 1e-6})
    expected = body.stress_stiffness.stiffness(q, voltages={"v": voltage})
    np.testing.assert_allclose(opened.stress_stiffness.stiffness(q), expected, atol=1e-12 * np.abs(expected).max())
    assert not np.allclose(opened.stress_stiffness.stiffness(q), body.stress_stiffness.stiffness(q))


def test_projections_and_files_carry_it(stack, tmp_path):
    body, rng = reduced(stack, 3), np.random.default_rng(2)
    n, field = len(body.mass_matrix), rng.standard_normal((3, 4))
    change = rng.standard_normal((n, 9))
    change[:6, :6], change[:6, 6:] = np.eye(6), 0.0
    q = rng.standard_normal(9)
    expected = change.T @ body.stress_stiffness.stiffness(change @ q, field, {"v": 2.0}) @ change
    projected = project(body, change, points=["foot"])
    again = load_file(save(projected, tmp_path / "body.h5"))
    for each in (projected, again):
        found = each.stress_stiffness.stiffness(q, field, {"v": 2.0})
        np.testing.assert_allclose(found, expected, atol=1e-12 * np.abs(expected).max())
    for each in (keep_modes(body, 1), trim_body(body, points=["tip"], loads=np.zeros((n, 0)), cutoff_frequency=1e5)):
        assert each.stress_stiffness.n_coordinates == len(each.mass_matrix)
        assert each.enriched.stress_stiffness is not None, "truncation errors under load need it"


def test_refusals(stack):
    with pytest.raises(ValueError, match="was not made from a mesh"):
        craig_bampton(lattice(), geometric_stiffness=True, progress=False)
    stress = reduced(stack, 0).stress_stiffness
    rest = np.zeros(stress.n_coordinates)
    with pytest.raises(ValueError, match="unknown electrical port 'w'"):
        stress.stiffness(rest, voltages={"w": 1.0})
    with pytest.raises(ValueError, match="body_force must have shape 3 x 4"):
        stress.stiffness(rest, np.zeros(3))
    with pytest.raises(ValueError, match="coordinates must have shape"):
        stress.stiffness(rest[1:])
    with pytest.raises(ValueError, match="3 cases are too few for 12 body forces and 1 ports"):
        replace(stress, rows=np.zeros((3, 2)), stress=np.zeros((3, 2, 2)), shape=np.zeros((3, 2, 2)))
    assert craig_bampton(stack, n_modes=0, progress=False).stress_stiffness is None
