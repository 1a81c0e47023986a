"""Meshes: prisms on extruded bodies, sizes on faces, convergence rates, refused input."""

import inspect
import warnings
from collections import Counter
from types import SimpleNamespace

import netgen.occ as occ
import ngsolve as ng
import numpy as np
import pytest
from conftest import STEEL, make_bar, meshed

from models.apa300ml import make_apa300ml
from nassim import Material, RemotePoint, Solid, build_fe_model, condense, craig_bampton
from nassim.fem import assembly, mesh_checks, meshing
from nassim.fem.full_model import full_eigenfrequencies
from nassim.fem.meshing import extrusion_axis, generate_mesh


def make_post():
    """A narrow post on a wide foot: two bodies extruded along y over different lengths."""
    foot, post = occ.Box((0, 0, 0), (0.02, 0.005, 0.02)), occ.Box((0.005, 0.005, 0.005), (0.01, 0.02, 0.012))
    foot.name, post.name = "foot", "post"
    foot.faces.Min(occ.Y).name, post.faces.Max(occ.Y).name, foot.faces.Max(occ.X).name = "ground", "tip", "side"
    points = tuple(RemotePoint(name, name, np.zeros(3)) for name in ("ground", "tip", "side"))
    return Solid("post", occ.Glue([foot, post]), {"foot": STEEL, "post": STEEL}, points)


def kinds(mesh):
    return {element.type for element in ng.Mesh(mesh).Elements(ng.VOL)}


def area(mesh, name):
    return ng.Integrate(1, mesh, definedon=mesh.Boundaries(name))


def test_extruded_bodies_get_prisms_only():
    mesh = ng.Mesh(generate_mesh(make_post(), element_size=5e-3, extrude="y"))
    assert {element.type for element in mesh.Elements(ng.VOL)} == {ng.ET.PRISM}
    assert ng.Integrate(1, mesh) == pytest.approx(0.02**2 * 0.005 + 0.005 * 0.007 * 0.015, rel=1e-12)
    assert set(mesh.GetMaterials()) == {"foot", "post"}


def test_edges_far_shorter_than_the_elements_are_meshed():
    """Elements that ignored them made Netgen end the interpreter."""
    corner = occ.HalfSpace(occ.Pnt(1e-5, 0, 0), occ.Vec(1, 1, 1))
    block = next(iter((occ.Box((0, 0, 0), (0.1, 0.08, 0.05)) - corner).solids))
    mesh = ng.Mesh(generate_mesh(Solid("block", block, STEEL), element_size=0.02))
    assert ng.Integrate(1, mesh) == pytest.approx(0.1 * 0.08 * 0.05 - 1e-15 / 6, rel=1e-12)
    assert mesh.ne < 1000


def test_a_bar_over_a_gap_cuts_both_prongs():
    """Its outline, one face, cuts each prong of the fork into pieces, and the gap from what is below."""
    fork = occ.Box((0, 0, 0), (0.03, 0.03, 0.01)) - occ.Box((0.01, 0.01, -1), (0.02, 1, 1))
    bar = occ.Box((-0.004, 0.018, 0.01), (0.034, 0.024, 0.016))
    fork.solids.name, bar.solids.name = "fork", "bar"
    fork.faces.Min(occ.Y).name = "left"
    shape, points = occ.Glue([fork, bar]), (RemotePoint("left", "left", np.zeros(3)),)
    solid = Solid("fork", shape, {"fork": STEEL, "bar": STEEL}, points)
    mesh = generate_mesh(solid, element_size=0.01, extrude="z", tetrahedra_instead=False)
    assert kinds(mesh) == {ng.ET.PRISM}
    volumes = [ng.Integrate(1, ng.Mesh(mesh), definedon=ng.Mesh(mesh).Materials(name)) for name in ("fork", "bar")]
    np.testing.assert_allclose(volumes, [0.03**2 * 0.01 - 0.01 * 0.02 * 0.01, 0.038 * 0.006**2], rtol=1e-9)


def test_an_arm_beside_the_end_of_a_post_leaves_prisms_down_to_its_foot():
    """The edges of the arm go on along the wall of the post below it, where there is nothing beside the wall."""
    post, arm = occ.Box((0, 0, 0), (0.01, 0.01, 0.03)), occ.Box((0.01, 0.0025, 0.02), (0.02, 0.0075, 0.03))
    post.name = arm.name = "steel"
    post.faces.Min(occ.Z).name = "foot"
    points = (RemotePoint("foot", "foot", np.zeros(3)),)
    solid = Solid("post", occ.Glue([post, arm]), {"steel": STEEL}, points)
    assert kinds(generate_mesh(solid, element_size=5e-3, extrude="z", tetrahedra_instead=False)) == {ng.ET.PRISM}


def test_cutting_in_layers_keeps_the_faces_and_leaves_the_part_alone():
    solid = make_post()
    before = [face.name for face in solid.shape.faces]
    mesh = ng.Mesh(generate_mesh(solid, element_size=5e-3, extrude="y", layer_thickness=2e-3))
    assert [face.name for face in solid.shape.faces] == before
    assert area(mesh, "ground") == pytest.approx(0.02**2, rel=1e-12)
    assert area(mesh, "tip") == pytest.approx(0.005 * 0.007, rel=1e-12)
    assert area(mesh, "side") == pytest.approx(0.005 * 0.02, rel=1e-12)


@pytest.mark.parametrize(("thickness", "layers"), [(0.012, 9), (0.03, 4)])
def test_layers_are_thin_enough(thickness, layers):
    """As few equal layers as are no thicker than asked for."""
    mesh = ng.Mesh(generate_mesh(make_bar(), element_size=0.02, extrude="x", layer_thickness=thickness))
    x = {round(vertex.point[0], 9) for vertex in mesh.vertices}
    assert np.allclose(np.diff(sorted(x)), 0.1 / layers, atol=2e-9)


def test_end_layers_and_sizes_along_prisms():
    """Layers of 3, 17 and 17 mm (twice), and a size given at one place that holds along the bar."""
    sizes = np.array([[0.09, 0.0, 0.0]]), np.array([2e-3])
    options = {"element_size": 0.02, "extrude": "x", "layer_thickness": 0.05}
    mesh = ng.Mesh(generate_mesh(make_bar(), end_layers=3e-3, point_sizes=sizes, **options))
    x = sorted({round(vertex.point[0], 9) for vertex in mesh.vertices})
    np.testing.assert_allclose(x, [0, 0.003, 0.05, 0.097, 0.1], atol=1e-9)
    assert mesh.ne > 2 * ng.Mesh(generate_mesh(make_bar(), end_layers=3e-3, **options)).ne


def test_axis_along_which_a_solid_is_extruded():
    """One axis only: a bar has three, and a slanted slot, which keeps the area of both ends, has none."""
    bodies = [occ.Box((0, 0, 0), (0.02, 0.01, 0.005)) + occ.Box((0, 0, 0), (0.005, 0.01, 0.02))]
    slot = occ.Box((0.01, -0.01, 0.003), (0.012, 0.02, 0.03)).Rotate(occ.Axis((0.011, 0.005, 0), occ.Z), 17)
    bodies += [bodies[0] - slot, occ.Box((0, 0, 0), (0.02, 0.01, 0.005))]
    found = []
    for shape in bodies:
        shape.name, shape.faces.Min(occ.X).name = "body", "end"
        point = RemotePoint("end", ("end",), np.zeros(3))
        found.append(extrusion_axis(Solid("solid", occ.Compound([shape]), {"body": STEEL}, (point,))))
    assert found == ["y", None, None]


def test_prisms_and_tetrahedra_agree():
    found = []
    for extrude in (None, "x"):
        model = build_fe_model(make_bar(), element_size=0.01, order=3, extrude=extrude, progress=False)
        found.append(full_eigenfrequencies(condense(model, progress=False), fixed=["left"], n=6, progress=False))
    # The fifth is torsion, for which these meshes are coarse.
    assert np.allclose(found[0][:4], found[1][:4], rtol=1e-4)


@pytest.mark.parametrize("order", [1, 4])
def test_rigid_motions_cost_no_energy_in_prisms(order):
    model = build_fe_model(make_post(), element_size=5e-3, order=order, extrude="y", progress=False)
    forces = model.stiffness @ model.rigid_motions()
    assert np.abs(forces).max() < 1e-10 * np.abs(model.stiffness.lower.data).max()


def test_surface_of_prisms_is_closed():
    """Triangles of the outer surface sum up to its area, and each of their edges belongs to two."""
    surface = build_fe_model(make_bar(), element_size=0.01, order=2, extrude="x", progress=False).surface
    a, b, c = (surface.points[surface.triangles[:, k]] for k in range(3))
    assert 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() == pytest.approx(2 * 1e-4 + 4 * 1e-3, rel=1e-9)
    edges = np.sort(np.vstack([surface.triangles[:, pair] for pair in ([0, 1], [1, 2], [2, 0])]), axis=1)
    assert np.all(np.unique(edges, axis=0, return_counts=True)[1] == 2)


@pytest.mark.slow
@pytest.mark.parametrize("coupling", ["rbe2", "rbe3"])
def test_apa_is_meshed_with_prisms_around_its_holes(coupling, apa_prisms):
    """Curved prisms hold rotations not quite exactly; the condensed body turns freely all the same."""
    solid = make_apa300ml(coupling=coupling)
    model = meshed(apa_prisms, solid, 2)
    assert all(kind in model.description for kind in ("prisms", "pyramids", "tetrahedra"))
    assert model.mass == pytest.approx(7800 * sum(body.mass for body in solid.shape.solids), rel=3e-4)
    frequency = craig_bampton(model, n_modes=2, progress=False).eigenfrequencies()
    assert frequency[5] < 0.1
    assert frequency[6] > 1000.0


def test_sizes_on_faces_refine_there_and_do_not_stick():
    solid = make_bar()
    before = len(generate_mesh(solid, element_size=0.01).Elements3D())
    refined = len(generate_mesh(solid, element_size=0.01, local_sizes={"left": 0.001}).Elements3D())
    after = len(generate_mesh(solid, element_size=0.01).Elements3D())
    assert refined > 3 * before
    assert after < 1.5 * before


@pytest.mark.parametrize(("order", "rate"), [(1, 2.0), (2, 4.0)])
def test_eigenfrequencies_converge_with_rate_2p(order, rate):
    """A rod clamped at one end, on layers of prisms: f = c / 4 l."""
    solid = make_bar(material=Material("cork", 1e9, 0.0, 200.0))
    exact = np.sqrt(1e9 / 200.0) / (4 * 0.1)
    errors = []
    for thickness in (0.05, 0.025):
        model = build_fe_model(
            solid, element_size=0.02, order=order, extrude="x", layer_thickness=thickness, progress=False
        )
        found = full_eigenfrequencies(
            condense(model, progress=False), fixed=["left"], guided={"right": "x"}, n=12, progress=False
        )
        errors.append(np.abs(found / exact - 1).min())
    rates = np.log2(np.array(errors[:-1]) / errors[1:])
    assert np.all(np.array(errors) > 1e-9), "below that, rounding decides"
    assert np.allclose(rates, rate, atol=0.15)


@pytest.mark.slow
def test_error_falls_with_every_refinement_of_the_apa(apa_tetrahedra):
    """Displacement elements are too stiff, so each better mesh has lower frequencies."""
    frequencies = []
    for order in (1, 2, 3):
        condensed = condense(meshed(apa_tetrahedra, make_apa300ml(), order), progress=False)
        frequencies.append(full_eigenfrequencies(condensed, fixed=["bottom"], n=4, progress=False))
    assert np.all(np.diff(frequencies, axis=0) < 0)


def test_order_1_in_thin_walls_is_warned_of():
    with pytest.warns(UserWarning, match=r"100 % of the elements reach from surface to surface") as told:
        build_fe_model(make_bar(), element_size=0.02, order=1, progress=False)
    assert told[0].filename == __file__


def test_a_mesh_too_large_for_the_memory_is_told_a_larger_size(monkeypatch):
    monkeypatch.setattr(mesh_checks, "SMALL_MODEL", 0)
    monkeypatch.setattr(mesh_checks.psutil, "virtual_memory", lambda: type("Memory", (), {"available": 1e6}))
    message = r"need about .* GB to factorise, .* an element_size of .* would fit"
    with pytest.raises(ValueError, match=message) as refused:
        build_fe_model(make_bar(), element_size=0.005, order=2, progress=False)
    assert float(str(refused.value).partition("an element_size of ")[2].split()[0]) > 0.005


def test_a_factorisation_needs_eight_tenths_of_its_bound_from_50_000_unknowns_on(monkeypatch):
    def check(unknowns, bound):
        space = SimpleNamespace(ndof=unknowns / 3)
        monkeypatch.setattr(mesh_checks, "ng", SimpleNamespace(H1=lambda mesh, order: space, VOL=None))
        monkeypatch.setattr(mesh_checks, "factor_memory", lambda *_: bound)
        monkeypatch.setattr(mesh_checks.psutil, "virtual_memory", lambda: SimpleNamespace(available=1e9))
        nothing = SimpleNamespace(vertices=[], Elements=lambda _: [])
        mesh_checks.check_memory(nothing, SimpleNamespace(name="s"), 2, 1e-3)

    check(45_000, 1e12)
    check(55_000, 0.9e9 / 0.8)
    for unknowns, bound in ((55_000, 1e12), (55_000, 1.1e9 / 0.8)):
        with pytest.raises(ValueError, match="would fit"):
            check(unknowns, bound)


def test_order_1_in_a_thick_part_is_not_warned_of(recwarn):
    build_fe_model(make_bar(length=0.01), element_size=0.0015, order=1, progress=False)
    assert not [w for w in recwarn if "one element thick" in str(w.message)]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"element_size": 0.0}, "element_size must be positive"),
        ({"curvature": -1.0}, "curvature must be positive"),
        ({"extrude": "w"}, "known: x, y, z"),
        ({"extrude": "x", "layer_thickness": 0.0}, "layer_thickness must be positive"),
        ({"extrude": "x", "end_layers": -0.001}, "end_layers must be positive"),
        ({"local_sizes": {"lid": 0.001}}, "known: left, right"),
        ({"local_sizes": {"left": -0.001}}, "size on face 'left' must be positive"),
    ],
)
def test_impossible_arguments(arguments, message):
    with pytest.raises(ValueError, match=message):
        generate_mesh(make_bar(), **{"element_size": 0.01, **arguments})


def test_body_that_is_not_extruded_along_the_axis():
    ball = occ.Sphere(occ.Pnt(0, 0, 0), 0.01)
    ball.name = "ball"
    with pytest.raises(ValueError, match="no CAD body of solid 'ball' is extruded along x"):
        generate_mesh(Solid("ball", ball, {"ball": STEEL}), element_size=0.01, extrude="x")


def test_body_not_extruded_along_the_axis_gets_tetrahedra_beside_prisms():
    """A cylinder along z on a plate: along x the plate alone has prisms."""
    plate, pin = occ.Box((-0.01, -0.01, -0.004), (0.01, 0.01, 0)), occ.Cylinder(occ.Pnt(0, 0, 0), occ.Z, 0.004, 0.01)
    plate.name, pin.name = "plate", "pin"
    solid = Solid("pin", occ.Glue([plate, pin]), {"plate": STEEL, "pin": STEEL})
    kinds = Counter()
    mesh = ng.Mesh(generate_mesh(solid, element_size=4e-3, extrude="x"))
    for element in mesh.Elements(ng.VOL):
        kinds[element.mat, element.type] += 1
    assert {kind for body, kind in kinds if body == "plate"} >= {ng.ET.PRISM}
    assert ng.ET.PRISM not in {kind for body, kind in kinds if body == "pin"}
    pin = occ.Cylinder(occ.Pnt(0, 0, 0), occ.Z, 0.004, 0.01)
    pin.name = "pin"
    with pytest.raises(ValueError, match="no CAD body of solid 'pin' is extruded along x"):
        generate_mesh(Solid("pin", pin, {"pin": STEEL}), element_size=4e-3, extrude="x")


def test_prisms_that_netgen_cannot_make_become_tetrahedra(monkeypatch):
    def fail_on_layers(shape, *arguments):
        if len(list(shape.solids)) > 1:
            raise meshing.NgException("Meshing failed!")
        return run(shape, *arguments)

    run = meshing._run_netgen
    monkeypatch.setattr(meshing, "_run_netgen", fail_on_layers)
    with pytest.warns(UserWarning, match="solid 'bar' with prisms: tetrahedra are used instead") as told:
        model = build_fe_model(make_bar(), element_size=0.02, extrude="x", progress=False)
    assert told[0].filename == __file__
    assert {element.type for element in model._source[0].Elements(ng.VOL)} == {ng.ET.TET}


def make_rod():
    rod = occ.Cylinder(occ.Pnt(0, 0, 0), occ.Z, 0.004, 0.02)
    rod.name = "rod"
    return Solid("rod", rod, {"rod": STEEL})


def test_mesh_that_misses_the_volume_is_reported():
    with pytest.warns(UserWarning, match="more volume than the CAD; give its curved faces smaller elements") as told:
        build_fe_model(make_rod(), element_size=0.02, order=2, progress=False)
    assert told[0].filename == __file__


def test_curved_faces_have_as_many_elements_per_radius_as_asked_for():
    """So many chords around a circle of 4 mm, which miss the less of its volume: 2 pi^2 / 3 n^2 of n chords."""
    volumes = [ng.Integrate(1, ng.Mesh(generate_mesh(make_rod(), element_size=0.02, curvature=c))) for c in (0.5, 3.0)]
    missed = 1 - np.array(volumes) / (np.pi * 0.004**2 * 0.02)
    assert missed[1] < 2 * np.pi**2 / (3 * 15**2)
    assert missed[0] > 4 * missed[1]


def test_a_model_asks_for_the_mesh_that_it_is_told(monkeypatch):
    """Every argument of the mesh, and the mesher's own defaults where none is given."""
    asked = []

    def note(solid, **options):
        asked.append(options)
        raise InterruptedError

    monkeypatch.setattr(assembly, "generate_mesh", note)
    told = {"curvature": 1.5, "local_sizes": {"left": 0.001}, "extrude": "x", "layer_thickness": 0.002}
    for options in (told, {}):
        with pytest.raises(InterruptedError):
            build_fe_model(make_rod(), element_size=0.02, progress=False, **options)
    defaults = {name: p.default for name, p in inspect.signature(generate_mesh).parameters.items() if name in told}
    assert asked == [{"element_size": 0.02, **told}, {"element_size": 0.02, **defaults}]


def test_a_hundredth_of_the_volume_may_be_missed():
    cube = ng.Mesh(occ.OCCGeometry(occ.Box((0, 0, 0), (1, 1, 1))).GenerateMesh(maxh=1.0, nthreads=1))
    for share in (0.9, -0.9, 1.1, -1.1):
        body = SimpleNamespace(mass=1 / (1 + share / 100))
        with warnings.catch_warnings(record=True) as told:
            warnings.simplefilter("always")
            mesh_checks.check_volume(cube, SimpleNamespace(name="s", shape=SimpleNamespace(solids=[body])))
        expected = [f"the mesh has {share:+.1f} % more volume than the CAD"] if abs(share) > 1 else []
        assert [str(each.message).partition(": ")[2].partition(";")[0] for each in told] == expected


@pytest.mark.parametrize(("thin", "warned"), [(9, False), (11, True)])
def test_walls_are_thin_where_half_of_the_elements_reach_through(thin, warned):
    """Twenty elements of two vertices, of which so many lie outside with both."""
    pairs = [(0, 1)] * thin + [(0, 2)] * (20 - thin)
    elements = {
        kind: [SimpleNamespace(vertices=[SimpleNamespace(nr=n) for n in pair]) for pair in given]
        for kind, given in ((ng.VOL, pairs), (ng.BND, [(0, 1)]))
    }
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        mesh_checks.warn_of_thin_walls(SimpleNamespace(nv=3, Elements=elements.get), SimpleNamespace(name="s"))
    assert len(told) == warned


def test_each_trial_has_its_own_grading_and_size(monkeypatch):
    """Netgen fails twice: finer elements are asked for then, and the model says so."""
    asked, generate = [], meshing._generate

    def fail_at_first(shape, options, *sizes):
        asked.append((options["grading"], options["maxh"]))
        if len(asked) < 3:
            raise meshing.NgException("Meshing failed!")
        return generate(shape, options, *sizes)

    monkeypatch.setattr(meshing, "_generate", fail_at_first)
    model = build_fe_model(make_bar(), element_size=0.02, order=2, progress=False)
    np.testing.assert_allclose(asked, [(0.7, 0.02), (0.5, 0.02), (0.5, 0.019)])
    assert "elements of 0.95 times the size that was asked for" in model.description
