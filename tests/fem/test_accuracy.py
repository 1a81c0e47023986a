"""FE models of a wanted accuracy: sizes from CAD, error estimates against true errors, limits, refused input."""

import importlib
import warnings
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import netgen.occ as occ
import ngsolve as ng
import numpy as np
import pytest
import scipy
from conftest import STEEL, make_bar
from ngsolve.meshes import MakeStructured3DMesh

from nassim import ElectricalPort, Material, PiezoStack, RemotePoint, Solid, build_fe_model, condense, craig_bampton
from nassim.fem import accuracy, mesh_sizes
from nassim.fem.assembly import assemble_mesh, mesh_and_solid, refine_order
from nassim.fem.cad_sizes import ray_lengths, sizes_from_cad
from nassim.fem.curving import Curving
from nassim.fem.mesh_error import released_energy
from nassim.fem.mesh_sizes import MeshSizing, element_sizes
from nassim.fem.mesh_targets import MeshTargets, find_targets
from nassim.fem.meshing import PrismsFailedError, extrusion_axis, generate_mesh
from nassim.fem.modes import fixed_interface_modes

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


def make_step(angle=20):
    """A bar with a sharp step, in a general position or, without a turn, extruded along y."""
    shape = occ.Box((0, 0, 0), (0.03, 0.01, 0.01)) + occ.Box((0.03, 0, 0), (0.06, 0.01, 0.003))
    return named("step", shape.Rotate(occ.Axis((0, 0, 0), occ.Vec(1, 2, 3)), angle))


def test_rays_measure_a_box():
    corners = np.array([[[0.0, 0, 2], [5, 0, 2], [0, 5, 2]], [[0, 0, 3], [5, 0, 3], [0, 5, 3]]])
    points = np.array([[1.0, 1, 0], [1, 1, 2.5], [4, 4, 0], [1, 1, 4]])
    directions = np.array([[0.0, 0, 1], [0.6, 0, 0.8], [0, 0, 1], [0, 0, 1]])
    np.testing.assert_allclose(ray_lengths(points, directions, corners), [2, 0.5 / 0.8, np.inf, np.inf], rtol=1e-12)


def test_sizes_from_cad_of_a_tube():
    """Half of sqrt(R t) on a thin tube, 0.7 R on a wire, and no more than ten times the thickness on a plate."""
    tube = occ.Cylinder(occ.Pnt(0, 0, 0), occ.Z, 0.02, 0.03) - occ.Cylinder(occ.Pnt(0, 0, 0), occ.Z, 0.0195, 0.03)
    found = sizes_from_cad(named("tube", tube, occ.Z))
    curved = (found.points[:, 2] > 0.005) & (found.points[:, 2] < 0.025)
    assert np.median(found.sizes()[curved]) == pytest.approx(0.5 * np.sqrt(0.02 * 0.0005), rel=0.1)
    assert found.wall(2) == pytest.approx(0.0005, rel=0.02)
    outside = np.hypot(*found.points[:, :2].T) > 0.01975
    np.testing.assert_array_equal(found.convex[curved], outside[curved])
    found = sizes_from_cad(named("wire", occ.Cylinder(occ.Pnt(0, 0, 0), occ.Z, 0.001, 0.03), occ.Z))
    curved = (found.points[:, 2] > 0.005) & (found.points[:, 2] < 0.025)
    np.testing.assert_allclose(found.sizes()[curved], 0.7 * 0.001, rtol=0.02)
    found = sizes_from_cad(named("plate", occ.Box((0, 0, 0), (0.1, 0.06, 0.0004))))
    x, y, _ = found.points.T
    flat = (x > 0.01) & (x < 0.09) & (y > 0.01) & (y < 0.05)
    np.testing.assert_allclose(found.sizes()[flat], 10 * 0.0004, rtol=1e-3)


def test_a_cut_through_one_material_is_no_wall():
    """Two glued boxes are as thick as one; a layer of another material is as thin as it is."""
    parts = [occ.Box((0, 0, 0), (0.1, 0.06, 0.05)), occ.Box((0, 0, 0.05), (0.1, 0.06, 0.051))]
    for part, name in zip(parts, ("block", "layer"), strict=True):
        part.name = name
    shape, points = occ.Glue(parts), (RemotePoint("end", ("end",), np.zeros(3)),)
    shape.faces.Min(occ.X).name = "end"
    soft = Material("soft", 1e9, 0.3, 1000.0)
    for layer, thinnest in ((STEEL, 0.051), (soft, 0.001)):
        found = sizes_from_cad(Solid("pair", shape, {"block": STEEL, "layer": layer}, points))
        assert found.thickness.min() == pytest.approx(thinnest, rel=1e-3)


@pytest.fixture(scope="module")
def fine_step():
    """The sharp step to 0.05 %."""
    return condense(build_fe_model(make_step(), element_size=4e-3, order=5, progress=False), progress=False)


CONDITIONS = [(), ("first",)]


@pytest.mark.slow
def test_tolerance_is_met_on_a_sharp_step(fine_step):
    """Sharp edges cap the rate, so the first mesh is not enough."""
    model = build_fe_model(make_step(), tolerance=0.005, n=4, fixed=CONDITIONS, progress=False)
    assert len(model.rounds) > 1
    assert model.rounds[-1].error < 0.005
    assert model.n_dofs == model.rounds[-1].n_dofs
    found, truth = (find_targets(c, 4, CONDITIONS).values for c in (condense(model, progress=False), fine_step))
    assert np.all(np.abs(found / truth - 1) < 0.005)


@pytest.mark.slow
def test_a_tolerance_uses_prisms_where_all_is_extruded(fine_step):
    """The frequencies are those of the turned solid, which has tetrahedra."""
    model = build_fe_model(make_step(angle=0), tolerance=0.005, n=4, fixed=CONDITIONS, progress=False)
    assert "prisms" in model.description
    assert "tetrahedra" not in model.description
    found, truth = (find_targets(c, 4, CONDITIONS).values[:8] for c in (condense(model, progress=False), fine_step))
    assert np.all(np.abs(found / truth - 1) < 0.005)


def make_bolted(radius):
    """A bar that is extruded along x, with a head that is not."""
    bar = occ.WorkPlane(occ.Axes((0, 0, 0), occ.X, occ.Y)).LineTo(0.01, 0).LineTo(0.01, 0.006).LineTo(0, 0.01).Close()
    parts = [
        bar.Face().Extrude(0.04),
        occ.Sphere(occ.Pnt(0.04, 0.004, 0.004), radius) - occ.Box((0, -1, -1), (0.04, 1, 1)),
    ]
    for part, name in zip(parts, ("bar", "head"), strict=True):
        part.name = name
    shape = occ.Glue(parts)
    shape.faces.Min(occ.X).name = "end"
    return Solid("bolted", shape, {"bar": STEEL, "head": STEEL}, (RemotePoint("end", "end", np.zeros(3), "rbe2"),))


def test_prisms_are_chosen_where_most_of_the_volume_is_extruded():
    """A head of 3 % of the volume, and one of a third."""
    assert extrusion_axis(make_bolted(0.003)) == "x"
    assert extrusion_axis(make_bolted(0.009)) is None
    assert extrusion_axis(make_step()) is None  # in a general position


@pytest.mark.parametrize("options", [{}, {"extrude": "x", "local_sizes": {"end": 2e-3}}])
def test_a_mesh_does_not_depend_on_those_before(options):
    """OpenCASCADE leaves triangles and tolerances in shapes that it meshes or cuts."""
    used, new = make_bolted(0.003), make_bolted(0.003)
    for before in ({}, {"extrude": "x"}):
        generate_mesh(used, element_size=4e-3, **before)
    first, second = (generate_mesh(solid, element_size=4e-3, **options) for solid in (new, used))
    assert [point.p for point in second.Points()] == [point.p for point in first.Points()]


def test_prisms_that_netgen_cannot_mesh_end_the_rounds_with_a_warning(hard_solids, monkeypatch):
    """Later meshes of tetrahedra would have larger errors; their warnings would be of meshes that are not used."""
    made = mesh_sizes.generate_mesh

    def fail_later(*args, tetrahedra_instead, **options):
        if not tetrahedra_instead:
            raise PrismsFailedError
        return made(*args, **options)

    monkeypatch.setattr(mesh_sizes, "generate_mesh", fail_later)
    monkeypatch.setattr(accuracy, "SPREAD", 1.0)  # sizes change before the order
    options = {"tolerance": 1e-4, "n": 1, "fixed": [("first",)], "order": 3, "progress": False}
    with pytest.warns(UserWarning, match="would need prisms of sizes for which Netgen fails"):
        model = build_fe_model(make_step(angle=0), **options)
    assert "prisms" in model.description
    # The order on the first mesh can still rise.
    assert [(made.order, made.n_elements) for made in model.rounds] == [(3, n := model.rounds[0].n_elements), (4, n)]


def test_sizes_of_prisms_are_those_across_their_axis():
    """Three layers of different thickness: columns of three prisms, as large as the edges of the section."""
    options = {"element_size": 0.02, "extrude": "x", "layer_thickness": 0.1, "end_layers": 0.02}
    mesh = ng.Mesh(generate_mesh(make_bar(), **options))
    _, sizes, columns = element_sizes(mesh, "x")
    assert np.all(np.bincount(columns) == 3)
    for element, size in zip(mesh.Elements(ng.VOL), sizes, strict=True):
        corners = np.unique(np.round([mesh[vertex].point[1:] for vertex in element.vertices], 9), axis=0)
        assert size == pytest.approx(np.mean(scipy.spatial.distance.pdist(corners)), rel=1e-6)
    for number in range(columns.max() + 1):
        assert np.ptp(sizes[columns == number]) < 1e-9


def test_columns_are_of_prisms_alone():
    """Of equal layers of tetrahedra above each other, each element is one; of prisms, all of a column are."""
    tetrahedra = MakeStructured3DMesh(hexes=False, nx=2, ny=1, nz=2)
    prisms = MakeStructured3DMesh(hexes=False, prism=True, nx=2, ny=1, nz=2)
    counts = [np.bincount(element_sizes(mesh, "z")[2]).tolist() for mesh in (tetrahedra, prisms)]
    assert counts == [24 * [1], 4 * [2]]


def test_frequencies_are_unknown_above_an_unknown_one_of_their_own_condition():
    """Of two frequencies of each of three conditions, and of two stiffnesses."""
    known, lost = 0.02, 10.0
    shares = np.array([[known, lost, known, known, lost, known, lost, known]])
    sequences = [slice(0, 2), slice(2, 4), slice(4, 6)]
    targets = MeshTargets([], np.ones(8), np.repeat([0.5, 1.0], [6, 2]), shares, sequences)
    assert np.isinf(targets.errors()).astype(int).tolist() == [0, 1, 0, 0, 1, 1, 1, 0]


def test_the_first_limit_is_told():
    task, best = SimpleNamespace(solid=SimpleNamespace(name="s"), tolerance=0.01), SimpleNamespace(error_text="5 %")
    with pytest.warns(UserWarning, match="error is 5 %: the next mesh would need more time; allow more"):
        accuracy._warn_of_missed_tolerance(task, best, ["more time", "more memory"])


def test_the_time_of_a_mesh_is_that_until_now_and_of_its_solution(monkeypatch):
    """Of four times the unknowns of the last one, which took a minute: eight minutes more."""
    mesh = MakeStructured3DMesh(hexes=False, nx=2, ny=2, nz=2)
    monkeypatch.setattr(accuracy, "time", SimpleNamespace(perf_counter=lambda: 1100.0))
    limits = accuracy.MeshLimits(1e9, 1000.0, 200.0)
    rounds = [accuracy.MeshRound(1, 48, n, seconds=seconds) for n, seconds in ((10, 15.0), (3 * mesh.nv / 4, 75.0))]
    assert limits.refusal(mesh, 1, rounds) == "about 580 s, max_time is 200 s"


def test_the_largest_error_is_told_with_its_target():
    """That of the second target, by a mesh before or by its faces, though elements alone leave more in the first."""
    targets = MeshTargets(["first", "second"], np.ones(2), np.ones(2), np.array([[0.02, 0.01]]), [])
    trial = accuracy.Trial(None, None, None, targets, np.array([0.06, 0.2]))
    assert trial.error_text == "20 % (second)"


@pytest.mark.slow
def test_estimates_of_all_targets_against_a_finer_mesh(fine_step):
    """Between half and three times the true error, on coarse elements."""
    coarse = build_fe_model(make_step(), element_size=0.01, order=3, progress=False)
    targets = find_targets(condense(coarse, progress=False), 4, CONDITIONS)
    true = targets.values / find_targets(fine_step, 4, CONDITIONS).values - 1
    ratio = targets.errors() / true
    large = true > 3e-3
    assert np.count_nonzero(large) >= 6
    assert np.all((ratio[large] > 0.5) & (ratio[large] < 3)), dict(zip(targets.labels, ratio, strict=True))


def test_estimates_by_element_add_up(bar):
    """To the whole energy, of one shape and of a combination; the energy is that of a factorisation to 0.3 %."""
    condensed, energy = bar
    whole = np.random.default_rng(0).standard_normal((energy.stiffness.shape[0], 2))
    by_element = energy.by_element(whole)
    assert by_element.shape == (condensed.fe_model.rounds[0].n_elements, 2)
    assert by_element.min() >= 0
    np.testing.assert_allclose(by_element.sum(axis=0), np.diag(whole.T @ energy.stiffness @ whole), rtol=1e-9)
    held = refine_order(condensed.fe_model).held
    free = np.flatnonzero(np.tile(~held, 3))
    mesh, solid = mesh_and_solid(condensed.fe_model)
    matrix = assemble_mesh(mesh, solid, condensed.fe_model.order + 1).stiffness_matrix[free][:, free]
    residual = energy.residual.swapaxes(0, 1).reshape(len(free), -1)
    exact = residual.T @ scipy.sparse.linalg.spsolve(matrix.tocsc(), residual)
    found = np.diag(energy.stiffness) / np.diag(exact)
    assert np.all((found > 0.997) & (found < 1 + 1e-9))


@pytest.mark.parametrize("coupling", ["rbe2", "rbe3"])
def test_faces_off_the_cad_change_targets_as_meshes_of_that_shape_do(coupling):
    """A bar that is wider, more so towards its end: the shape derivative against the difference of two such meshes.

    Frequencies have the error of the modes that the search for targets leaves out, which also depend on the shape, and
    torsion that of the warping of an interface that is free to warp.
    """
    solid = named("bar", occ.Box((0, 0, 0), (0.05, 0.01, 0.006)))
    solid = replace(solid, remote_points=[replace(point, coupling=coupling) for point in solid.remote_points])
    mesh = ng.Mesh(generate_mesh(solid, element_size=0.03))
    move = ng.CoefficientFunction((0, 2e-3 * (1 + 20 * ng.x) * (ng.y - 0.005), 0))

    def targets(restoring=None):
        return find_targets(condense(assemble_mesh(mesh, solid, 3), progress=False), 1, [("first",)], restoring)

    restoring, deformation = ng.GridFunction(ng.H1(mesh, order=2, dim=3)), ng.GridFunction(ng.VectorH1(mesh, order=2))
    restoring.Set(move)
    deformation.Set(move)
    found, values = targets(restoring), []
    mesh.SetDeformation(deformation)
    for _ in range(2):
        values.append(targets().values)
        deformation.vec.data *= -1
    change = (values[0] - values[1]) / np.sum(values, axis=0)
    np.testing.assert_allclose(found.geometry[1:], change[1:], rtol=1e-3 if coupling == "rbe2" else 0.02)
    assert found.geometry[0] == pytest.approx(change[0], rel=0.02)
    np.testing.assert_allclose(found.values, np.mean(values, axis=0) * (1 + change), rtol=2e-4)


def make_stack():
    """A piezo stack whose ends cannot deform."""
    stack = PiezoStack.from_datasheet(
        free_stroke=20e-6, blocked_force=4700.0, voltage_range=170.0, capacitance=6.7e-6, size=(20e-3, 10e-3, 10e-3)
    )
    shape = occ.Box(occ.Pnt(0, -5e-3, -5e-3), occ.Pnt(20e-3, 5e-3, 5e-3))
    solid = named("stack", shape, material=Material("ceramic", stack.young_modulus, 0.31, 7800.0))
    return replace(solid, ports=(ElectricalPort("drive", "body", stack),))


@pytest.fixture(scope="module")
def bar():
    condensed = condense(build_fe_model(make_bar(), element_size=0.01, order=2, progress=False), progress=False)
    shapes = condensed.constraint_modes[:, 6:]
    return condensed, released_energy(condensed, shapes, accelerations=np.zeros_like(shapes))


def test_the_error_of_a_port_is_a_target():
    """A stack between two pads, whose free stroke and charge a coarse mesh makes too small."""
    model = build_fe_model(make_stack(), element_size=0.01, order=2, progress=False)
    fine = build_fe_model(make_stack(), element_size=0.005, order=4, progress=False)
    coarse, truth = (find_targets(condense(m, progress=False), 1, [("first",)]) for m in (model, fine))
    static = [f"stiffness along {axis} at 'second' with 'first' fixed" for axis in ("x", "y", "z", "rx", "ry", "rz")]
    assert coarse.labels[1:] == [*static, "charge of port 'drive' with all points fixed", "stroke by port 'drive'"]
    assert coarse.sequences == [slice(0, 1)]
    assert coarse.powers.tolist() == [0.5, *8 * [1.0]], "energy is a frequency's square, and a stiffness or a capacity"
    true = coarse.values[-2:] / truth.values[-2:] - 1
    assert np.all(true > 1e-3)
    ratio = coarse.errors()[-2:] / true
    assert np.all((ratio > 0.5) & (ratio < 3)), ratio


def test_a_port_changes_no_error_of_modes():
    """Its vector has no estimate of its own, so what a finer mesh releases is that of the body without the port."""
    condensed = condense(build_fe_model(make_stack(), element_size=0.02, order=2, progress=False), progress=False)
    alone, driven = (
        craig_bampton(condensed, n_modes=2, ports=ports, discretization=True, progress=False) for ports in ((), None)
    )
    released = np.zeros((15, 15))
    released[:14, :14] = alone.released_stiffness
    np.testing.assert_allclose(driven.released_stiffness, released, atol=1e-9 * released.max())


def test_a_mesh_is_used_again_for_the_reduction(hard_solids):
    """The condensation of the last round; another choice of points is condensed anew."""
    model = build_fe_model(hard_solids["bar"](), tolerance=0.1, n=1, fixed=[("first",)], progress=False)
    assert condense(model).constraint_modes is condense(model).constraint_modes
    assert condense(model).fe_model is model
    assert condense(model, remote_points=["first"], progress=False).names == ("first",)
    modes = [fixed_interface_modes(condense(model), n_modes=n)[1] for n in (2, 3)]
    assert np.shares_memory(*modes)
    twice = replace(model, stiffness=2 * model.stiffness_matrix)
    np.testing.assert_allclose(
        condense(twice, progress=False).stiffness, 2 * condense(model).stiffness, rtol=1e-6, atol=1.0
    )
    body = craig_bampton(model, progress=False)
    assert body.released_stiffness is None
    assert f"{model.n_dofs} unknowns" in body.record["cost and error"]
    assert f"{100 * model.rounds[-1].error:.2g} % (estimate)" in body.record["cost and error"]


def test_limits_end_the_rounds_with_the_best_model(hard_solids, capsys):
    with pytest.warns(UserWarning, match=r"tolerance 1e-05 was not reached.*max_unknowns is 4000") as told:
        model = build_fe_model(hard_solids["bar"](), tolerance=1e-5, n=1, fixed=[("first",)], max_unknowns=4000)
    assert told[0].filename == __file__
    assert model.n_dofs <= 4000
    errors = [made.error for made in model.rounds]
    assert [made.n_dofs for made in model.rounds][int(np.argmin(errors))] == model.n_dofs
    assert f"round 1: {model.rounds[0]}" in " ".join(capsys.readouterr().out.split())
    assert "tolerance 1e-05 was not reached" in model.warnings[0]


@pytest.mark.slow
def test_smaller_elements_are_tried_where_a_higher_order_is_beyond_the_limit(hard_solids, monkeypatch):
    """Less than three times the unknowns of the first mesh, where the error is spread over all elements."""
    monkeypatch.setattr(accuracy, "MOST_ROUNDS", 2)
    options = {"tolerance": 1e-3, "n": 1, "fixed": [("first",)], "order": 2, "max_unknowns": 2700}
    with pytest.warns(UserWarning, match="max_unknowns is 2700"):
        model = build_fe_model(hard_solids["bar"](), progress=False, **options)
    assert len(model.rounds) == 2
    assert model.rounds[0].n_dofs < model.n_dofs <= 2700
    assert model.discretization_error < model.rounds[0].error


@pytest.fixture(scope="module")
def coarse_mesh():
    return ng.Mesh(generate_mesh(make_bar(), element_size=0.02))


def new_sizes(mesh, shares):
    """Points, sizes of the elements and their ratio to those before, from the released shares of targets by element,
    shape (n_elements, t), for an error of 1 %; a folded element of 2 mm is at 0.5, 0.5, 0.5."""
    targets = MeshTargets([], np.ones(shares.shape[1]), np.ones(shares.shape[1]), shares, [])
    curving = Curving(mesh.ne, 1, np.array([0]), np.full((1, 3), 0.5), np.array([2e-3]))
    sizing = MeshSizing(0.02, *2 * ((np.zeros((0, 3)), np.zeros(0)),))
    points, sizes = sizing.refined(mesh, targets, curving, 0.01).points
    return points, sizes, sizes[: mesh.ne] / element_sizes(mesh)[1]


def test_new_sizes_meet_the_goal_of_the_worst_target(coarse_mesh):
    """Two targets with errors in different halves of a bar need the sizes that each one needs alone."""
    spread = np.random.default_rng(0).uniform(0.02, 0.04, coarse_mesh.ne) / coarse_mesh.ne
    half = np.arange(coarse_mesh.ne) % 2 == 0
    shares = np.column_stack([spread * half, spread * ~half])
    one, other, both = (new_sizes(coarse_mesh, shares[:, chosen])[2] for chosen in ([0], [1], [0, 1]))
    assert np.all(both < 1.24)
    np.testing.assert_allclose(both, np.where(half, one, other), rtol=0.05)


def test_new_sizes_are_smaller_where_elements_folded(coarse_mesh):
    points, sizes, _ = new_sizes(coarse_mesh, np.full((coarse_mesh.ne, 1), 1e-6))
    assert sizes[np.all(points == 0.5, axis=1)] == pytest.approx(0.7 * 2e-3)


@pytest.mark.parametrize(
    ("error", "moved", "refusal", "chosen"),
    [
        (0.012, 0.0, "", "smaller"),
        (0.014, 0.0, "", "higher"),
        (0.014, 0.0, "too large", "smaller"),
        (0.012, 0.02, "", "smaller"),
        (0.014, 0.02, "", "higher"),
    ],
)
def test_a_higher_order_pays_where_the_error_is_far_above_the_tolerance(error, moved, refusal, chosen):
    """The errors of two targets are spread evenly, each over one half of the elements.

    A higher order does not bring back faces that moved, which change the second target.
    """
    shares = np.kron(np.eye(2), np.full((25, 1), 1e-3))
    targets = MeshTargets([], np.ones(2), np.ones(2), shares, [], np.array([0.0, -moved]))
    plan = SimpleNamespace(
        order=3,
        with_new_sizes=lambda task, trial: SimpleNamespace(name="smaller"),
        of_higher_order=lambda task, rounds: SimpleNamespace(name="higher", refusal=refusal),
    )
    trial = SimpleNamespace(targets=targets, errors=np.array([error, 0.001 + moved]))
    found, reason = accuracy._improve(plan, SimpleNamespace(tolerance=0.01), trial, [])
    assert (found.name, reason) == (chosen, refusal)


@pytest.mark.parametrize(("options", "order"), [((0.01, None), 3), ((0.002, None), 4), ((0.002, 2), 2)])
def test_order_of_the_first_round(options, order, monkeypatch):
    orders = []

    def stop(task, order):
        orders.append(order)
        raise RuntimeError

    monkeypatch.setattr(accuracy, "_refine", stop)
    with pytest.raises(RuntimeError):
        build_fe_model(make_bar(), tolerance=options[0], order=options[1], progress=False)
    assert orders == [order]


@pytest.mark.slow
def test_edges_of_a_mesh_for_a_tolerance_are_of_order_three_at_most():
    """A cylinder of prisms, whose deformation curves them."""
    shape = occ.Cylinder(occ.Pnt(0, 0, 0), occ.Z, 5e-3, 30e-3)
    shape.name, shape.faces.Min(occ.Z).name = "rod", "end"
    rod = Solid("rod", shape, {"rod": STEEL}, (RemotePoint("end", "end", np.zeros(3)),))
    orders = {}
    for order in (2, 4):
        model = build_fe_model(rod, tolerance=0.4, n=1, fixed=[("end",)], order=order, progress=False)
        orders[model.order] = model._source[0].deformation.space.globalorder
    assert orders == {2: 2, 4: 3}


def test_no_further_round_beyond_the_time(hard_solids):
    with pytest.warns(UserWarning, match="max_time is 1e-09 s"):
        model = build_fe_model(
            hard_solids["bar"](), tolerance=1e-5, n=1, fixed=[("first",)], order=2, max_time=1e-9, progress=False
        )
    assert len(model.rounds) == 1


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({}, "give either element_size"),
        ({"element_size": 0.01, "tolerance": 0.01}, "give either element_size"),
        ({"tolerance": 0.0}, "tolerance must be positive"),
        ({"tolerance": "1%"}, "tolerance must be a"),
        ({"tolerance": 1}, "tolerance must be at most 0.5.* it is relative: 0.01 for 1 %"),
        ({"tolerance": 0.01, "max_time": -1}, "max_time must be positive"),
        ({"tolerance": 0.01, "n": 0}, "n must be a whole number"),
        ({"tolerance": 0.01, "order": 0}, "order must be"),
        ({"tolerance": 0.01, "fixed": [("middle",)]}, "known: left, right"),
        ({"tolerance": 0.01, "fixed": "left"}, "fixed must be sets of remote points"),
        ({"tolerance": 0.01, "fixed": [(), "left"]}, "fixed must be sets of remote points"),
        ({"tolerance": 0.01, "fixed": []}, "fixed must be sets"),
        ({"tolerance": 0.01, "max_unknowns": 300}, "the coarsest mesh would need .* max_unknowns is 300"),
    ],
)
def test_arguments_of_a_tolerance(arguments, message):
    with pytest.raises(ValueError, match=message):
        build_fe_model(make_bar(), progress=False, **arguments)


def test_a_tolerance_needs_remote_points():
    solid = Solid("bar", make_bar().shape, {"bar": STEEL})
    with pytest.raises(ValueError, match="no remote points, at which a tolerance is defined"):
        build_fe_model(solid, tolerance=0.01, progress=False)


def test_a_coarse_mesh_is_warned_of_and_a_fine_one_is_not():
    for size, order, warned in ((0.02, 2, True), (0.012, 4, False)):
        model = build_fe_model(make_bar(), element_size=size, order=order, progress=False)
        with warnings.catch_warnings(record=True) as told:
            warnings.simplefilter("always")
            body = craig_bampton(model, progress=False)
        assert [w.filename for w in told if "its finite elements leave" in str(w.message)] == warned * [__file__]
        assert ("tolerance" in body.record.get("warnings", "")) == warned


@pytest.mark.slow
def test_a_neck_on_a_coarse_mesh_has_an_unknown_error(hard_solids):
    """At 3 mm and order 2 the first frequency is more than twice the true one."""
    model = build_fe_model(hard_solids["neck"](), element_size=3e-3, order=2, progress=False)
    with pytest.warns(UserWarning, match="is estimated as unknown, above 50 %"):
        body = craig_bampton(model, progress=False)
    assert body.eigenfrequencies(fixed=["first"])[0] > 2 * 296
    assert body.discretization_errors(fixed=["first"])[0] == np.inf
    assert "above 50 %" in body.record["cost and error"]
