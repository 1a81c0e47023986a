"""What every optional argument of the verbs of finite elements does, and limits a tenth below and above."""

import functools
import re
import warnings
from dataclasses import replace
from functools import partial
from types import SimpleNamespace

import netgen.occ as occ
import numpy as np
import psutil
import pytest
import scipy.sparse as sp
from arguments import check_fields, check_finite, optional_arguments, table
from conftest import STEEL, assert_limit, lattice, make_bar

from nassim import (
    FEModel,
    Material,
    RemotePoint,
    Solid,
    StressPoint,
    StressSurface,
    build_fe_model,
    condense,
    craig_bampton,
    fem,
)
from nassim.bodies.piezo import ElectricalPort, PiezoStack, PortCoupling
from nassim.bodies.readouts import Surface
from nassim.bodies.reduced_body import error_text
from nassim.bodies.remote_points import free_coordinates
from nassim.fem import (
    Extreme,
    Face,
    MeshRound,
    OnCylinder,
    OnPlane,
    accuracy,
    face_names,
    full_eigenfrequencies,
    full_frequency_response,
    generate_mesh,
    glue,
    list_faces,
    make_coupling,
    meshing,
    name_faces,
    read_solid,
    replace_materials,
)
from nassim.fem.cad_sizes import sizes_from_cad
from nassim.fem.condensation import vector_dofs
from nassim.fem.face_picks import _joined_cylinders, _turns_fully
from nassim.fem.faces import occ_faces
from nassim.fem.mesh_targets import MeshTargets
from nassim.fem.meshing import CADBody
from nassim.fem.reduction import _warn_of_coarse_mesh

QUIET = {"progress": False}
BAR = make_bar()
SURFACE = Surface(np.eye(3), np.array([[0, 1, 2]]), np.array([[0, 1]]), ("bar",))
ROUND = MeshRound(2, 10, 300, seconds=1.0, error=0.01)
STACK = PiezoStack.from_datasheet(
    free_stroke=20e-6, blocked_force=4700.0, voltage_range=170.0, capacitance=6.7e-6, size=(0.1, 0.01, 0.01)
)


@functools.cache
def model():
    """The lattice with two electrical ports, made by hand."""
    plain = lattice()
    force = np.random.default_rng(1).standard_normal((2, plain.n_dofs))
    force -= force @ (motions := plain.rigid_motions()) @ np.linalg.pinv(motions)
    return replace(plain, ports=tuple(PortCoupling(name, f, 1e-6) for name, f in zip("pq", force, strict=True)))


@functools.cache
def condensed():
    return condense(model(), progress=False)


@functools.cache
def rich():
    """So many modes that the lattice's low frequencies are exact."""
    return craig_bampton(condensed(), n_modes=40, progress=False).enriched


@functools.cache
def meshed_bar():
    return build_fe_model(BAR, element_size=0.05, order=1, progress=False)


# Data classes


FACE = partial(Face, 1, "plane", 1.0, np.zeros(3), np.zeros(3), np.eye(3)[0])
MODEL = {"stiffness": lattice().stiffness_matrix, "scalar_mass_matrix": lattice().scalar_mass_matrix}
FIELDS = {
    "Face": (
        FACE,
        {"axis": (None, np.eye(2, 3)), "radius": (None, 0.1), "hollow": (None, True), "name": ("", "lid"),
         "colour": ("", "#ff0000"), "bodies": ((), ("a", "b"))},
    ),
    "MeshRound": (partial(MeshRound, 2, 10, 300, seconds=1.0), {"error": (np.nan, 0.01)}),
    "FEModel": (
        partial(FEModel, "model", fields=lattice().fields, **MODEL),
        {"couplings": ((), lattice().couplings), "surface": (None, SURFACE), "surface_evaluation": (None, sp.eye(3)),
         "description": ("", "coarse"), "order": (0, 3), "ports": ((), model().ports), "warnings": ((), ("thin",)),
         "rounds": ((), (ROUND,))},
    ),
    "OnPlane": (partial(OnPlane, (0.0, 0.0, 0.1), (0.0, 0.0, 2.0)), {"several": (False, True)}),
    "StressPoint": (partial(StressPoint, "top", np.zeros(3)), {"cad_body": ("", "bar")}),
    "StressSurface": (StressSurface, {"name": ("stress", "skin"), "faces": ((), ("left",))}),
    "Solid": (
        partial(Solid, "bar", BAR.shape, BAR.materials),
        {"remote_points": ((), BAR.remote_points), "ports": ((), (ElectricalPort("drive", "bar", STACK),))},
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", FIELDS)
def test_fields_have_their_defaults_and_take_a_value(name):
    check_fields(*FIELDS[name])


@pytest.mark.parametrize("name", sorted(FIELDS.keys() - {"Face", "MeshRound"}))
def test_numbers_that_are_not_finite_are_refused(name):
    check_finite(*FIELDS[name])


def respond(frequency, **options):
    """Response of the lattice to nothing, read nowhere."""
    return full_frequency_response(condensed(), frequency, inputs={}, outputs={}, damping_ratio=0.0, **options, **QUIET)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: build_fe_model(BAR, tolerance=0.1, max_unknowns=0, **QUIET), "max_unknowns must be positive, got 0"),
        (lambda: build_fe_model(BAR, tolerance=0.1, extrude="w", **QUIET), "extrude 'w'"),
        (lambda: model().port("r"), "electrical port 'r'.* p, q"),
        (lambda: respond([np.nan]), "frequency holds 1 .*NaN or infinite"),
        (lambda: respond([1.0], tolerance=0.0), "tolerance must be positive, got 0"),
    ],
)
def test_what_makes_no_sense_is_refused(call, message):
    with pytest.raises(ValueError, match=message):
        call()


# Verbs


def refusal(call, **options):
    """Result of a call, or the words with which it refuses."""
    try:
        return call(**options)
    except ValueError as error:
        return str(error)


def drilled():
    """A block with a hole of 3 mm along x, one of 2 mm along z, a boss of 2 mm along z, and two equal steps."""
    shape = occ.Box((0, 0, 0), (0.04, 0.02, 0.02)) - occ.Box((0.015, -1, 0.015), (0.025, 1, 1))
    shape = shape - occ.Cylinder(occ.Pnt(-1, 0.01, 0.007), occ.X, 3e-3, 2)
    shape = shape - occ.Cylinder(occ.Pnt(0.035, 0.01, 0.012), occ.Z, 2e-3, 1)
    return shape + occ.Cylinder(occ.Pnt(0.02, 0.01, 0.015), occ.Z, 2e-3, 0.002)


def cylinders(**options):
    shape = drilled()
    groups = OnCylinder(**options).find(list_faces(shape), occ_faces(shape))
    return sorted(tuple(np.round(1e3 * group[0].centre, 6).tolist()) for group in groups)


def n_named(pick, **options):
    """Number of faces that a choice of one or several names, or 0 if it is refused."""
    shape = drilled()
    try:
        name_faces(shape, {"chosen": pick(**options)})
    except ValueError:
        return 0
    return [face.name for face in shape.faces].count("chosen")


def halves(**options):
    """Words about two boxes that overlap."""
    return refusal(lambda **o: glue([occ.Box((0, 0, 0), (2, 2, 2)), occ.Box((1, 0, 0), (3, 2, 2))], **o), **options)


class Asked(Exception):
    """Carries what a function was called with."""


def asked_of(module, name, call):
    """Return what a call asks of a function of a module, which is replaced: arguments and options."""

    def ask(*arguments, **options):
        raise Asked(arguments, options)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, name, ask)
        try:
            return "refused" if isinstance(refusal(call), str) else "not asked"
        except Asked as found:
            return found.args


def netgen(**options):
    """What is asked of Netgen: options, number of CAD bodies, sizes on the face "left" and at points."""

    def see(shape, parameters, points, share):
        left = min(face.maxh for face in shape.faces if face.name == "1")  # while a mesh is made, names are numbers
        layers = len(list(shape.solids))
        raise Asked(parameters["curvaturesafety"], left, layers, points)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(meshing, "_generate", see)
        with pytest.raises(Asked) as found:
            generate_mesh(BAR, element_size=0.02, **options)
    return found.value.args


POINTS = (np.array([[0.05, 0.0, 0.0]]), np.array([0.001]))


def sized(**options):
    """What `build_fe_model` asks of the mesher for elements of a size, or that it does not."""
    given = {"element_size": 0.02, **QUIET, **options}
    found = asked_of(fem.assembly, "generate_mesh", lambda: build_fe_model(BAR, **given))
    return found if isinstance(found, str) else tuple(found[1].values())


def for_tolerance(**options):
    """What `build_fe_model` asks for a tolerance: that, n, conditions, limits, order, options of the mesh."""
    found = asked_of(accuracy, "_refine", lambda: build_fe_model(BAR, **{"tolerance": 0.01, **QUIET, **options}))
    if isinstance(found, str):
        return found
    task, order = found[0]
    limits, mesh = task.limits, tuple(task.mesh_options.values())
    return task.tolerance, task.n, tuple(task.conditions), limits.unknowns, limits.seconds, order, mesh, task.progress


def becomes(index, *expected):
    """Whether one of the results is as expected before and after."""
    return lambda *results: [result[index] for result in results] == list(expected)


def are(*expected):
    return lambda *results: list(results) == list(expected)


def reduced(read, given=None, **base):
    return lambda **options: read(craig_bampton(given() if given else condensed(), **{**QUIET, **base, **options}))


def full(**options):
    return full_eigenfrequencies(condensed(), **{**QUIET, "n": 9, **options})


def as_reduced(**conditions):
    def law(_, after):
        return np.allclose(after, rich().eigenfrequencies(**conditions)[: len(after)], rtol=1e-3, atol=0.1)

    return law


def response(**options):
    """Receptance along two directions, and the number of solves; "refused" where the model can move."""
    inputs, outputs = {"f": {"right.uy": 1.0}}, {"y": {"right.uy": 1.0}, "x": {"right.ux": 1.0}}
    given = {"inputs": inputs, "outputs": outputs, "damping_ratio": 0.02, "fixed": ["left"], **QUIET, **options}
    try:
        found = full_frequency_response(condensed(), np.array([20.0, 90.0]), **given)
    except (ValueError, RuntimeError) as error:
        return str(error)[:40]
    return np.round(found.frf.values[:, 0], 17), found.n_solves  # several threads of BLAS add up in any order


def receptance(**conditions):
    """Of the reduced body with so many modes, by a direct solution."""
    body = rich()
    free = free_coordinates(body.point_names, fixed=["left"], guided=conditions.get("guided"))
    free = np.concatenate([free, np.arange(12, len(body.mass_matrix))])
    frequency, shapes = body.eigenmodes(fixed=["left"], **conditions)
    omega = 2 * np.pi * np.array([20.0, 90.0])
    terms = shapes[[7, 6]][:, :, None] * shapes[7][:, None] / (
        (2 * np.pi * frequency[:, None]) ** 2 - omega**2 + 0.04j * 2 * np.pi * frequency[:, None] * omega
    )  # fmt: skip
    return terms.sum(axis=1)


def responds(**conditions):
    return lambda _, after: np.allclose(
        after[0], receptance(**conditions), rtol=1e-3, atol=1e-9 * np.abs(after[0]).max()
    )


MESH = {"curvature": 1.5, "local_sizes": {"left": 0.001}, "extrude": "x", "layer_thickness": 0.002}
NO_MESH = (0.5, None, None, None)


def meshes(order, k):
    """Rows of `build_fe_model`: each argument of the mesh is asked of the mesher, with n options before them."""
    for place, (name, value) in enumerate(MESH.items()):
        after = tuple(value if j == place else NO_MESH[j] for j in range(4))
        yield (
            name,
            NO_MESH[place],
            value,
            becomes(k, NO_MESH, after) if order else are((0.02, *NO_MESH), (0.02, *after)),
        )


CONDITIONS = ((), ("left",), ("right",), ("left", "right"))
CALLS = {
    "Extreme": partial(n_named, Extreme, direction="+z"),
    "OnPlane": partial(n_named, OnPlane, point=(0, 0, 0.02), normal=(0, 0, 1)),
    "OnCylinder": cylinders,
    "OnCylinder of a choice": partial(n_named, OnCylinder, radius=2e-3),
    "glue": halves,
    "generate_mesh": netgen,
    "generate_mesh in prisms": partial(netgen, extrude="x"),
    "build_fe_model": sized,
    "build_fe_model to a tolerance": for_tolerance,
    "condense": lambda **options: condense(model(), **{**QUIET, **options}).names,
    "full_eigenfrequencies": full,
    "full_frequency_response": response,
    "craig_bampton": reduced(lambda body: body.n_modes, ports=()),
    "craig_bampton: points": reduced(lambda body: body.point_names, model),
    "craig_bampton: of ports": reduced(lambda body: tuple(port.name for port in body.ports)),
    "craig_bampton: mesh": reduced(lambda body: body.released_stiffness is not None, meshed_bar),
    "craig_bampton: known error": reduced(
        lambda body: body.released_stiffness is not None, lambda: replace(meshed_bar(), rounds=(ROUND,))
    ),
    "craig_bampton: geometric": reduced(
        lambda body: body.stress_stiffness is not None, meshed_bar, discretization=False
    ),
    "craig_bampton: places": reduced(lambda body: "stress" in body.readouts, meshed_bar, discretization=False),
}
HOLE_X, HOLE_Z, BOSS = (20.0, 10.0, 7.0), (35.0, 10.0, 16.0), (20.0, 10.0, 16.0)
ARGUMENTS = table(
    CALLS,
    [
        ("Extreme", "several", False, True, are(0, 2)),
        ("OnPlane", "several", False, True, are(0, 2)),
        ("OnCylinder of a choice", "several", False, True, are(0, 2)),
        ("OnCylinder", "radius", None, 3e-3, are([HOLE_X, BOSS, HOLE_Z], [HOLE_X])),
        ("OnCylinder", "near", None, (0.036, 0.01, 0.02), are([HOLE_X, BOSS, HOLE_Z], [HOLE_Z])),
        ("OnCylinder", "axis", None, "x", are([HOLE_X, BOSS, HOLE_Z], [HOLE_X])),
        ("OnCylinder", "hole", None, False, are([HOLE_X, BOSS, HOLE_Z], [BOSS])),
        ("glue", "name", "", "tower", lambda *words: ["''" in words[0], "'tower'" in words[1]] == [True, True]),
        ("generate_mesh", "curvature", 0.5, 2.0, becomes(0, 0.5, 2.0)),
        ("generate_mesh", "local_sizes", None, {"left": 0.001}, becomes(1, 1e99, 0.001)),
        ("generate_mesh", "extrude", None, "x", becomes(2, 1, 5)),
        ("generate_mesh", "layer_thickness", None, 0.01, becomes(2, 1, 1)),
        ("generate_mesh in prisms", "end_layers", None, 0.005, becomes(2, 5, 7)),
        ("generate_mesh", "point_sizes", None, POINTS, lambda before, after: before[3] is None and after[3] is POINTS),
        *(("build_fe_model", *row) for row in meshes(0, 0)),
        *(("build_fe_model to a tolerance", *row) for row in meshes(2, 6)),
        ("build_fe_model", "tolerance", None, 0.01, lambda _, after: after == "refused"),
        ("build_fe_model to a tolerance", "element_size", None, 0.01, lambda _, after: after == "refused"),
        ("build_fe_model to a tolerance", "n", 5, 2, becomes(1, 5, 2)),
        ("build_fe_model to a tolerance", "fixed", None, [("right",)], becomes(2, CONDITIONS, (("right",),))),
        ("build_fe_model to a tolerance", "max_unknowns", 300_000, 7e5, becomes(3, 3e5, 7e5)),
        ("build_fe_model to a tolerance", "max_time", np.inf, 60.0, becomes(4, np.inf, 60.0)),
        ("build_fe_model to a tolerance", "order", None, 2, becomes(5, 3, 2)),
        ("condense", "remote_points", None, ["right"], are(("left", "right"), ("right",))),
        ("full_eigenfrequencies", "fixed", (), ["right"], as_reduced(fixed=["right"])),
        ("full_eigenfrequencies", "guided", None, {"right": "rx"}, as_reduced(guided={"right": "rx"})),
        ("full_eigenfrequencies", "masses", None, {"right": 0.5}, as_reduced(masses={"right": 0.5})),
        ("full_frequency_response", "guided", None, {"right": "y"}, responds(guided={"right": "y"})),
        ("full_frequency_response", "masses", None, {"right": 0.5}, responds(masses={"right": 0.5})),
        ("full_frequency_response", "tolerance", 1e-8, 1e-2, lambda before, after: 2 < after[1] < before[1]),
        ("full_frequency_response", "max_solves", 200, 2, lambda _, after: after.startswith("the response has not")),
        ("craig_bampton", "n_modes", None, 3, are(6, 3)),
        ("craig_bampton", "cutoff_frequency", None, 1e-3, are(6, 0)),
        ("craig_bampton", "tolerance", None, 0.9, lambda before, after: before == 6 > after),
        ("craig_bampton: points", "remote_points", None, ["right"], are(("left", "right"), ("right",))),
        ("craig_bampton: of ports", "ports", None, ["q"], are(("p", "q"), ("q",))),
        ("craig_bampton: mesh", "discretization", None, False, are(True, False)),
        ("craig_bampton: known error", "discretization", None, True, are(False, True)),
        ("craig_bampton: geometric", "geometric_stiffness", False, True, are(False, True)),
        ("craig_bampton: places", "stress", (), [StressSurface()], are(False, True)),
    ],
)


@pytest.mark.filterwarnings("ignore:.*its finite elements leave")
@pytest.mark.parametrize("case", ARGUMENTS)
def test_an_optional_argument_does_what_it_should(case):
    ARGUMENTS[case].check()


def test_ten_eigenfrequencies_unless_told():
    every = full_eigenfrequencies(condensed(), progress=False)
    assert len(every) == 10
    np.testing.assert_allclose(full(n=8), every[:8], rtol=1e-8)


def test_a_free_model_has_no_response():
    assert response(fixed=()).startswith("the full model can move freely")


def test_layers_are_as_thick_as_elements_unless_told():
    assert netgen(extrude="x")[2] == 5
    assert netgen(extrude="x", layer_thickness=0.01)[2] == 10


def test_sizes_at_points_refine_there():
    plain, finer = (ng_mesh.Coordinates() for ng_mesh in (
        generate_mesh(BAR, element_size=0.02), generate_mesh(BAR, element_size=0.02, point_sizes=POINTS)
    ))  # fmt: skip
    near, far = (np.sum(np.abs(finer[:, 0] - x) < 0.01) for x in (0.05, 0.09))
    assert near > 5 * far
    assert near > 5 * np.sum(np.abs(plain[:, 0] - 0.05) < 0.01)


def test_elements_of_a_size_are_of_order_3_unless_told():
    for options, order in (({}, 3), ({"order": 2}, 2)):
        assert build_fe_model(BAR, element_size=0.1, **QUIET, **options).order == order


def test_a_tolerance_applies_to_what_was_asked_for(monkeypatch):
    """The order of the first mesh, its options, the number of frequencies and the conditions go on to the rounds."""
    given = {"tolerance": 0.01, "n": 2, "fixed": [("right",)], "order": 2, **QUIET}
    (found, n, conditions, _), _ = asked_of(accuracy, "find_targets", lambda: build_fe_model(BAR, **given))
    assert (found.fe_model.order, n, conditions) == (2, 2, [("right",)])
    _, options = asked_of(fem.mesh_sizes, "generate_mesh", lambda: build_fe_model(BAR, **given, **MESH))
    assert {name: options[name] for name in MESH} == MESH


def test_arguments_of_files(tmp_path):
    """A block of 10 x 20 x 30 mm with a step of 2 um."""
    shape = occ.Box((0, 0, 0), (10, 20, 30)) + occ.Box((0, 20, 0), (10, 25, 30.002))
    shape.WriteBrep(str(tmp_path / "part.brep"))
    read = partial(read_solid, tmp_path / "part.brep", STEEL)
    with pytest.warns(UserWarning, match="are shorter or narrower than 3 um, the smallest 2 um"):
        plain = read()
    assert (plain.name, face_names(plain.shape), plain.remote_points) == ("part", (), ())
    assert len(plain.shape.faces) == 8
    point = RemotePoint("end", "end", np.zeros(3))
    other = read(name="foot", faces={"end": Extreme("-z")}, remote_points=(point,), unit="inch", heal=1e-4)
    assert (other.name, face_names(other.shape), other.remote_points) == ("foot", ("end",), (point,))
    assert len(other.shape.faces) < 8
    assert other.shape.mass / plain.shape.mass == pytest.approx(25.4**3, rel=1e-3)


CALLS_WITH_PROGRESS = {
    "build_fe_model": (partial(build_fe_model, BAR, element_size=0.1, order=2), ("mesh", "assemble", "order 2")),
    "condense": (partial(condense, lattice()), ("factorise", "static modes")),
    "craig_bampton": (
        lambda **options: craig_bampton(
            meshed_bar(), n_modes=1, geometric_stiffness=True, stress=[StressSurface()], **options
        ),
        ("static modes", "fixed-interface modes", "truncation error", "integrals", "stress", "discretisation error",
         "geometric stiffness", "coordinates: 2 remote points"),
    ),
    "craig_bampton to a tolerance": (
        lambda **options: craig_bampton(condensed(), tolerance=0.5, **options), ("fixed-interface modes", "integrals")
    ),
    "full_eigenfrequencies": (partial(full_eigenfrequencies, condensed(), n=7), ("full model's eigenmodes",)),
    "full_frequency_response": (
        lambda **options: response(**({"progress": True} | options)), ("full model's response",)
    ),
}  # fmt: skip


@pytest.mark.filterwarnings("ignore:.*its finite elements leave")
@pytest.mark.parametrize("verb", CALLS_WITH_PROGRESS)
def test_stages_are_shown_unless_they_are_not_wanted(verb, capfd):
    call, stages = CALLS_WITH_PROGRESS[verb]
    for options, shown in (({}, True), ({"progress": True}, True), (QUIET, False)):
        call(**options)
        told = "".join(capfd.readouterr())
        assert all(stage in told for stage in stages) if shown else not told


def test_every_solve_is_counted():
    counted = []
    load = np.random.default_rng(0).standard_normal((model().n_dofs, 3))
    found = condensed().solve_fixed(load, advance=counted.append)
    assert sum(counted) == 3
    np.testing.assert_allclose(found, condensed().solve_fixed(load), rtol=1e-9)


def test_every_optional_argument_is_here():
    """Also those of the tests above."""
    rows = {f"{case.split(':')[0].split()[0]}: {case.split(': ')[-1]}" for case in ARGUMENTS}
    rows |= {f"{name}: {field}" for name, (_, values) in FIELDS.items() for field in values}
    rows |= {f"{case.split()[0]}: progress" for case in CALLS_WITH_PROGRESS}
    rows |= {f"read_solid: {name}" for name in ("faces", "remote_points", "unit", "name", "heal")}
    rows |= {
        "face_table: unit",
        "generate_mesh: tetrahedra_instead",  # see test_prisms_that_netgen_cannot_mesh_end_the_rounds_with_a_warning
        "full_eigenfrequencies: n",
        "full_frequency_response: fixed",
        "Condensation.solve_fixed: advance",
    }
    assert rows == optional_arguments(fem)


# Limits


def warned(call):
    """Whether a call warns."""
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        call()
    return bool(told)


def cube(side):
    shape = occ.Box((0, 0, 0), (1, 1, 1)).Scale(occ.Pnt(0, 0, 0), side)
    shape.name = "bar"
    return Solid("cube", shape, BAR.materials)


def test_a_solid_below_a_millimetre_is_warned_of():
    # OpenCASCADE's bounding boxes are larger by 2e-7 m.
    assert [warned(lambda s=share: cube(1e-3 * s)) for share in (0.9, 1.1)] == [True, False]


def test_a_body_is_thicker_than_a_tenth_of_a_micrometre():
    """Twice the volume over the surface."""

    def plate(share):
        height = 1e-7 / share
        shape = occ.Box((0, 0, 0), (1e4, 1e4, 1.0)).Scale(occ.Pnt(0, 0, 0), height)
        shape.name = "bar"
        return Solid("plate", shape, BAR.materials)

    assert_limit(plate, "has no thickness")


@pytest.mark.parametrize("share", [0.9, 1.1])
def test_a_feature_is_tiny_below_a_ten_thousandth_of_the_solid(tmp_path, share):
    shape = occ.Box((0, 0, 0), (20, 10, 10)) + occ.Box((20, 0, 0), (40, 10, 10 + share * 40e-4))
    shape.WriteBrep(str(tmp_path / "bar.brep"))
    assert warned(lambda: read_solid(tmp_path / "bar.brep", STEEL)) == (share < 1)
    two = occ.Box((0, 0, 0), (20, 10, 10)), occ.Box((20, 0, 0), (40, 10, 10 + share * 40e-4))
    assert warned(lambda: glue(two)) == (share < 1)


def round_face(number, radius=1e-3, offset=0.0):
    axis = np.array([[offset, 0.0, 0.0], [0.0, 0.0, 1.0]])
    return Face(number, "cylinder", 1.0, axis[0], axis[0], np.zeros(3), axis, radius, True)


@pytest.mark.parametrize("share", [0.9, 1.1])
def test_round_faces_are_one_cylinder_to_a_millionth_and_fit_a_radius_to_a_thousandth(share):
    edge = SimpleNamespace(edges=["common"])
    for other in (round_face(2, offset=1e-6 * share), round_face(2, radius=1e-3 * (1 + 1e-6 * share))):
        assert len(_joined_cylinders([round_face(1), other], [edge, edge])) == (1 if share < 1 else 2)
    found = OnCylinder(1e-3).find([round_face(1, 1e-3 * (1 + 1e-3 * share))], [edge])
    assert len(found) == (share < 1)
    # The centre of half a cylinder is at 2 / pi of its radius.
    assert _turns_fully([replace(round_face(1), centre=np.array([0.05e-3 * share, 0.0, 0.3]))]) == (share < 1)


@pytest.mark.parametrize(("n_faces", "more"), [(30, ""), (33, "and 3 more: see face_table")])
def test_thirty_faces_are_listed(monkeypatch, n_faces, more):
    monkeypatch.setattr("nassim.fem.face_picks.list_faces", lambda _: [round_face(k) for k in range(n_faces)])
    monkeypatch.setattr("nassim.fem.face_picks.occ_faces", lambda _: [])
    with pytest.raises(ValueError, match="number 99 finds no face") as refused:
        name_faces(None, {"a": 99})
    lines = str(refused.value).splitlines()[1:]
    assert len(lines) == 30 + bool(more)
    assert more in lines[-1]


def test_an_element_is_extruded_to_a_billionth_of_its_volume(monkeypatch):
    monkeypatch.setattr(meshing, "solid_triangles", lambda shape: (None, np.zeros((0, 3))))
    end = [SimpleNamespace(mass=2.0)]
    for share in (0.9, 1.1):
        body = CADBody(SimpleNamespace(mass=6.0 * (1 + 1e-9 * share)), 1.0, 4.0, end, end, 0)
        assert body.is_prism() == (share < 1)


def test_faces_of_an_extruded_body_lie_along_or_across_the_axis_to_a_millionth(monkeypatch):
    end = [SimpleNamespace(mass=2.0)]
    body = CADBody(SimpleNamespace(mass=6.0), 1.0, 4.0, end, end, 1)
    for share in (0.9, 1.1):
        for along in (1e-6 * share, 1e-6 * share - 1):
            normals = np.array([[[0.0, along, 0.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]]])
            monkeypatch.setattr(meshing, "solid_triangles", lambda shape, found=normals: (None, found))
            assert body.is_prism() == (share < 1)


def test_an_element_may_be_longer_than_the_solid_by_a_billionth():
    length = np.ptp(np.array([tuple(corner) for corner in BAR.shape.bounding_box]), axis=0).max()

    for share, asked in ((0.9, True), (1.1, False)):
        size = length * (1 + 1e-9 * share)
        found = asked_of(meshing, "_mesh", lambda size=size: generate_mesh(BAR, element_size=size))
        assert (found != "refused") == asked


def test_elements_grow_more_slowly_away_from_points_with_sizes():
    """Netgen's grading is 0 for equal sizes and 1 for the fastest growth."""
    (_, free, *_), _ = asked_of(meshing, "_generate", lambda: generate_mesh(BAR, element_size=0.02))
    sized = asked_of(meshing, "_generate", lambda: generate_mesh(BAR, element_size=0.02, point_sizes=POINTS))[0][1]
    assert sized["grading"] < free["grading"]


def test_sizes_from_cad_are_at_most_twice_a_radius():
    """A thin hole through a thick block, whose walls would allow more."""
    shape = occ.Box((0, 0, 0), (0.1, 0.1, 0.1)) - occ.Cylinder(occ.Pnt(0.05, 0.05, -1), occ.Z, 1e-3, 2)
    shape.name = "bar"
    found = sizes_from_cad(Solid("block", shape, BAR.materials))
    points, sizes = found.points, found.sizes()
    round_ones = np.abs(np.hypot(points[:, 0] - 0.05, points[:, 1] - 0.05) - 1e-3) < 1e-4
    inner = round_ones & (points[:, 2] > 0.02) & (points[:, 2] < 0.08)
    assert inner.any()
    np.testing.assert_allclose(sizes[inner], 2e-3, rtol=0.05)


@pytest.mark.parametrize("share", [0.9, 1.1])
def test_a_soft_point_has_a_motion_of_its_own_from_a_billionth(share):
    """Two points with the same interface, whose readings differ by a small angle a: 1 - cos(a) of them is left."""
    plain = lattice()
    first = plain.couplings[0]
    basis = np.linalg.qr(first.averages.T)[0].T
    other = np.linalg.svd(basis)[2][6:12]
    cosine = 1 - share * 1e-9
    averages = cosine * basis + np.sqrt(1 - cosine**2) * other
    twin = replace(first, point=replace(first.point, name="twin"), averages=averages)
    call = partial(condense, replace(plain, couplings=(replace(first, averages=basis), twin)), progress=False)
    assert (vector_dofs(twin, plain.n_dofs) == vector_dofs(first, plain.n_dofs)).all()
    assert ("cannot move by themselves" in str(refusal(call))) == (share < 1)


def test_two_per_cent_of_error_are_warned_of():
    for share in (0.9, 1.1):
        assert warned(lambda error=0.02 * share: _warn_of_coarse_mesh("bar", error)) == (share > 1)


def spread_errors(more):
    """A search for targets that finds one, 81 % of whose error is in 8 % of the elements, rounded down, and more."""

    def find(condensed, n, conditions, restoring):
        n_elements = condensed.fe_model._source[0].ne
        held = int(0.08 * n_elements) + more
        shares = np.where(np.arange(n_elements) < held, 0.081 / held, 0.019 / (n_elements - held))
        return MeshTargets(["stiffness"], np.ones(1), np.ones(1), shares[:, None], [])

    return find


@pytest.mark.parametrize(("more", "orders"), [(0, [2, 2]), (1, [2, 3, 4, 4, 4, 4])])
def test_rounds_raise_the_order_up_to_four_where_errors_are_spread_and_end_with_the_sixth(monkeypatch, more, orders):
    """Where more than 8 % of the elements hold 80 % of the error; nothing is solved, and no element gets smaller."""
    monkeypatch.setattr(accuracy, "find_targets", spread_errors(more))
    monkeypatch.setattr(accuracy, "condense", lambda fe_model, **_: SimpleNamespace(fe_model=fe_model))
    monkeypatch.setattr(accuracy, "with_interface_modes", lambda condensed, **_: condensed)
    monkeypatch.setattr(accuracy.MeshSizing, "refined", lambda self, *_: self)
    if not more:
        monkeypatch.setattr(accuracy, "MOST_ROUNDS", 2)
    with pytest.warns(UserWarning, match=f"{len(orders)} meshes were tried"):
        model = build_fe_model(BAR, tolerance=0.01, order=2, progress=False)
    assert [made.order for made in model.rounds] == orders


# What errors planted here have shown


def test_other_materials_on_the_same_mesh():
    """Twice the modulus and a third of the density; what was told of the mesh stays, but for its errors."""
    told = replace(meshed_bar(), warnings=("thin walls",), description="coarse", rounds=(replace(ROUND, error=0.01),))
    other = replace_materials(told, {"bar": Material("other", 400e9, STEEL.poisson_ratio, 2600.0)})
    assert (other.warnings, other.description) == (("thin walls",), "coarse")
    assert [replace(made, error=0.01) for made in other.rounds] == list(told.rounds)
    assert np.isnan(other.discretization_error)
    assert other.mass == pytest.approx(told.mass / 3, rel=1e-12)
    difference = other.stiffness_matrix - 2 * told.stiffness_matrix
    assert abs(difference).max() < 1e-9 * abs(told.stiffness_matrix).max()
    unchanged = replace_materials(told, {}).stiffness_matrix - told.stiffness_matrix
    assert abs(unchanged).max() < 1e-12 * abs(told.stiffness_matrix).max()


@pytest.mark.parametrize("order", [("left", "right"), ("right", "left")])
def test_a_tolerance_holds_for_the_body_clamped_at_each_point(order):
    """Between the largest error and the second, more modes are needed, wherever the point stands."""
    reduce = partial(craig_bampton, lattice(), remote_points=order, progress=False)
    body = reduce(n_modes=5)
    conditions = ([], ["left"], ["right"])
    errors = [max(body.truncation_errors(fixed=fixed)[6 - 6 * len(fixed) :][:5]) for fixed in conditions]
    assert errors[0] < errors[1] < 0.9 * errors[2]
    assert reduce(tolerance=0.5 * (errors[1] + errors[2])).n_modes > 5


@pytest.mark.filterwarnings("ignore:.*its finite elements leave")
def test_a_record_tells_the_warnings_of_the_mesh_and_the_largest_error():
    model = build_fe_model(BAR, element_size=0.1, order=2, progress=False)
    rounds = tuple(replace(model.rounds[0], seconds=seconds) for seconds in (10.0, 5000.0))
    body = craig_bampton(replace(model, warnings=("thin walls",), rounds=rounds), progress=False)
    first, second = body.record["warnings"].splitlines()
    assert first == "thin walls"
    assert "its finite elements leave" in second
    free, clamped = (body.discretization_errors(fixed=fixed) for fixed in ((), ("left",)))
    worst = max(clamped[:5])
    assert worst > 1.1 * max(free[6:11])
    cost = re.fullmatch(
        r"(\d+) unknowns, (\d+\.\d) s with the mesh, (.*) GB at most in this process; discretisation error (.*)",
        body.record["cost and error"],
    )
    assert cost
    assert (int(cost[1]), cost[4]) == (model.n_dofs, f"{error_text(worst)} (estimate)")
    assert 5000 <= float(cost[2]) < 6000, "all meshes"
    resident = 1e-9 * psutil.Process().memory_info().rss
    assert 0.5 * resident < float(cost[3]) < 100 * resident
    condensed = craig_bampton(condense(model, progress=False), discretization=False, progress=False)
    assert condensed.record["cost and error"] == f"{model.n_dofs} unknowns; discretisation error not estimated"


def test_a_model_is_that_of_the_round_with_the_smallest_error():
    rounds = [replace(ROUND, error=error) for error in (0.3, 0.01, 0.2)]
    assert replace(meshed_bar(), rounds=rounds).discretization_error == 0.01
    assert str(ROUND) == "order 2, 10 elements, 300 unknowns, error 1 % (estimate), 1.0 s"
    assert str(replace(ROUND, error=np.nan)) == "order 2, 10 elements, 300 unknowns, 1.0 s"


def strip(width, size=1.0):
    """A coupling of four nodes of equal areas on a strip of size x width."""
    x, y = size * np.array([[1.0, 1.0, -1.0, -1.0], [width, -width, width, -width]])
    fields = np.vstack([np.ones(4), x, y, np.zeros(4)])
    return make_coupling(RemotePoint("end", "face", np.zeros(3)), np.arange(4), size**2 * fields, fields)


@pytest.mark.parametrize("size", [1.0, 1e-6])
def test_an_interface_carries_a_rotation_from_a_billionth_of_the_area_on(size):
    """Mean square of the arms about the strip over a third of that about all axes, 2 + 2 w^2, whatever the size."""
    assert_limit(lambda share: strip(np.sqrt(2e-9 / share), size), "collinear or too small")
    coupling = strip(0.5, size)
    np.testing.assert_allclose(coupling.averages @ coupling.motions, np.eye(6), atol=1e-12)


def test_sizes_at_points_shrink_with_all_others_where_netgen_fails():
    options = {"maxh": 0.02, "grading": 0.7, "nthreads": 1}
    usual, finer = (len(meshing._generate(BAR.shape, options, POINTS, share).Elements3D()) for share in (1.0, 0.5))
    assert finer > 1.5 * usual


@pytest.mark.parametrize("moved", [0.0, 0.005, 0.3])
def test_what_another_mesh_found_softer_is_an_error(monkeypatch, moved):
    """Elements only stiffen: a mesh whose stiffness is 10 % above that of the one before errs by that at least.

    Unless the faces of the one before were far from the CAD, which is its own error.
    """
    values, changes = iter([1.0, 1.1]), iter([moved, 0.0])

    def find(condensed, n, conditions, restoring):
        n_elements = condensed.fe_model._source[0].ne
        shares = np.full((n_elements, 1), 0.02 / n_elements)
        return MeshTargets(["stiffness"], np.array([next(values)]), np.ones(1), shares, [], np.array([next(changes)]))

    monkeypatch.setattr(accuracy, "find_targets", find)
    monkeypatch.setattr(accuracy, "condense", lambda fe_model, **_: SimpleNamespace(fe_model=fe_model))
    monkeypatch.setattr(accuracy, "with_interface_modes", lambda condensed, **_: condensed)
    monkeypatch.setattr(accuracy, "MOST_ROUNDS", 2)
    with pytest.warns(UserWarning, match="2 meshes were tried"):
        model = build_fe_model(BAR, tolerance=0.01, order=2, progress=False)
    # Shares of 2 % of the energy leave 1 / (1 - 2.5 x 0.02) - 1.
    own = 1 / 0.95 - 1
    errors = [own + moved, 0.1 if moved < 0.01 else own]
    np.testing.assert_allclose([made.error for made in model.rounds], errors, rtol=1e-9)
    assert model.discretization_error == pytest.approx(min(errors))
