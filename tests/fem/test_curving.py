"""Curved elements: folds against closed forms, mending that keeps the geometry."""

import re
from dataclasses import replace

import calculix
import netgen.occ as occ
import ngsolve as ng
import numpy as np
import pytest
from conftest import STEEL, meshed
from netgen.meshing import Element3D, Mesh, MeshPoint, Pnt

from models.apa300ml import make_apa300ml
from nassim import RemotePoint, Solid, build_fe_model, condense
from nassim.fem import assembly, curving, untangling
from nassim.fem.assembly import assemble_mesh
from nassim.fem.curving import Curving, curve_mesh, folded_elements, reduce_curvature
from nassim.fem.full_model import full_eigenfrequencies
from nassim.fem.meshing import generate_mesh

CORNERS = {
    "tetrahedron": [(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, -1)],
    "prism": [(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, -1), (1, 0, -1), (0, 1, -1)],
    "pyramid": [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 0, -1)],
    "hexahedron": [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 0, -1), (1, 0, -1), (1, 1, -1), (0, 1, -1)],
}
"""Corners in Netgen's order, of elements of unit edges in the half space z < 0."""
MAP = np.array([[1.3, 0.2, -0.4], [0.1, 0.8, 0.5], [-0.6, 0.3, 0.9]])
SHIFT = np.array([0.7, -0.2, 0.4])


def one_element(kind, shift, reflect=1.0):
    """An element, displaced by `shift` 4 x (1 - x) along x, in a general position."""
    mesh = Mesh(dim=3)
    places = (np.array(CORNERS[kind]) * [1, 1, reflect]) @ MAP.T + SHIFT
    mesh.Add(Element3D(1, [mesh.Add(MeshPoint(Pnt(*place))) for place in places]))
    mesh.SetMaterial(1, "body")
    result = ng.Mesh(mesh)
    arms = ng.CoefficientFunction((ng.x - SHIFT[0], ng.y - SHIFT[1], ng.z - SHIFT[2]))
    x = ng.InnerProduct(ng.CoefficientFunction(tuple(np.linalg.inv(MAP)[0])), arms)
    deformation = ng.GridFunction(ng.VectorH1(result, order=2))
    deformation.Set(4 * shift * x * (1 - x) * ng.CoefficientFunction(tuple(MAP[:, 0])))
    result.SetDeformation(deformation)
    return result


@pytest.mark.parametrize("kind", CORNERS)
@pytest.mark.parametrize(("shift", "folded"), [(0.24, False), (0.26, True), (-0.24, False), (-0.26, True)])
def test_an_element_folds_where_its_middle_is_nearer_than_a_quarter_to_an_end(kind, shift, folded):
    """The determinant is 1 + 4 shift (1 - 2 x) times that of the straight element: zero at an end for a quarter."""
    assert folded_elements(one_element(kind, shift)).tolist() == [folded]


@pytest.mark.parametrize("kind", CORNERS)
def test_folded_elements_lose_half_of_their_curvature_until_none_is_folded(kind):
    """A shift of 0.6 becomes 0.15: where the determinant is least, it is 0.4 of that of the straight element."""
    mesh = one_element(kind, 0.6)
    assert curving._straighten(mesh, 2) == 1
    assert folded_elements(mesh).tolist() == [False]
    found, expected = (curving._smallest_determinants(m) for m in (mesh, one_element(kind, 0.15)))
    assert found == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize("share", [0.9, 1.1])
def test_an_element_is_folded_below_a_hundredth_of_its_mean_determinant(share):
    """In a hexahedron the mean is that of the straight element."""
    assert folded_elements(one_element("hexahedron", 0.25 * (1 - 0.01 * share))).tolist() == [share < 1]


@pytest.mark.parametrize("n", [3, 8, 13])
def test_three_places_of_folded_elements_are_told(n):
    corners = np.arange(3.0 * n).reshape(n, 3)
    text = Curving(99, n, np.arange(n), corners, np.ones(n)).places_text
    places = re.findall(r"\(([\d.]+), ", text)
    assert len(set(places)) == 3
    assert set(places) <= {f"{x:g}" for x in corners[:, 0]}


def test_a_description_tells_of_folded_elements_only_where_there_are_some():
    none, five = np.zeros(0, dtype=int), np.arange(5)
    assert str(Curving(99, 0, none, np.zeros((0, 3)), np.zeros(0))) == ""
    still = Curving(99, 7, five, np.zeros((5, 3)), np.ones(5))
    assert str(still) == "7 of 99 curved elements folded, 5 are still folded"
    mended = replace(still, n_straightened=11, displacement=3e-6)
    told = "5 mended by straighter edges of 11, which moves curved faces by up to 3 um"
    assert str(mended) == f"7 of 99 curved elements folded, {told}"


@pytest.mark.parametrize("kind", CORNERS)
def test_an_inverted_element_is_found(kind):
    assert folded_elements(one_element(kind, 0.0, reflect=-1.0)).tolist() == [True]
    assert folded_elements(one_element(kind, 0.0)).tolist() == [False]


def test_an_element_that_folds_between_its_corners_is_found():
    """The determinant is 1 at the ends of x and 1 - 1.5 share in the middle."""
    mesh = one_element("hexahedron", 0.0)
    deformation = ng.GridFunction(ng.VectorH1(mesh, order=3))
    arms = ng.CoefficientFunction((ng.x - SHIFT[0], ng.y - SHIFT[1], ng.z - SHIFT[2]))
    x = ng.InnerProduct(ng.CoefficientFunction(tuple(np.linalg.inv(MAP)[0])), arms)
    for share, folded in ((0.6, False), (0.7, True)):
        mesh.UnsetDeformation()
        deformation.Set(-share * (3 * x**2 - 2 * x**3) * ng.CoefficientFunction(tuple(MAP[:, 0])))
        mesh.SetDeformation(deformation)
        assert folded_elements(mesh).tolist() == [folded]


def make_plate(radius=3e-3, thickness=4e-3, angle=20):
    """A plate in a general position with a hole that Netgen meshes with few chords, so that flat elements fold."""
    hole = occ.Cylinder(occ.Pnt(0, 0, -4e-3), occ.Z, radius, 12e-3)
    plate = occ.Box((-4.5e-3, -10e-3, 0), (4.5e-3, 10e-3, thickness)) - hole
    plate.faces.Min(occ.Y).name, plate.name = "end", "plate"
    plate = plate.Rotate(occ.Axis((0, 0, 0), occ.gp_Dir(1, 2, 3)), angle)
    return Solid("plate", plate, {"plate": STEEL}, (RemotePoint("end", "end", np.zeros(3), "rbe2"),))


@pytest.fixture(scope="module")
def plate_mesh():
    return generate_mesh(make_plate(), element_size=10e-3)


def volume_inside(mesh):
    """Volume inside the outer faces by the divergence theorem, which does not depend on the elements inside."""
    faces = [mesh.ngmesh.FaceDescriptor(k + 1) for k in range(mesh.ngmesh.GetNFaceDescriptors())]
    outside = ng.Region(mesh, ng.BND, ng.BitArray([not (face.domin and face.domout) for face in faces]))
    position = ng.CoefficientFunction((ng.x, ng.y, ng.z))
    return ng.Integrate(position * ng.specialcf.normal(3), mesh, definedon=outside, order=8) / 3


@pytest.fixture(scope="module")
def thin_plate_mesh():
    """Elements that no motion of inner nodes unfolds: all their vertices are on the hole."""
    return generate_mesh(make_plate(2e-3, 1e-3, 0), element_size=8e-3)


@pytest.mark.parametrize(
    ("name", "order"), [("plate_mesh", 2), ("plate_mesh", 3), pytest.param("apa_tetrahedra", 2, marks=pytest.mark.slow)]
)
def test_mended_elements_fill_the_same_volume_once(name, order, request):
    """Folded elements count some volume twice; mended ones do not, and the outer faces remain as they are."""
    mesh = ng.Mesh(request.getfixturevalue(name).Copy())
    mesh.Curve(order)
    inside = volume_inside(mesh)
    assert ng.Integrate(1.0, mesh, order=6) > (1 + 1e-4) * inside
    found = curve_mesh(mesh, order)
    assert found.n_folded > 5
    assert not len(found.left)
    assert not folded_elements(mesh).any()
    assert volume_inside(mesh) == pytest.approx(inside, rel=1e-12)
    assert ng.Integrate(1.0, mesh, order=6) == pytest.approx(inside, rel=1e-12)


@pytest.fixture(scope="module")
def drilled_plate():
    """A plate of prisms with a hole, and its mesh."""
    plate = occ.Box(occ.Pnt(-0.02, -0.02, 0), occ.Pnt(0.02, 0.02, 0.01))
    plate -= occ.Cylinder(occ.Pnt(0.003, 0.002, -1), occ.Z, 0.008, 2)
    plate.solids.name, plate.faces.Min(occ.X).name = "plate", "left"
    solid = Solid("plate", plate, {"plate": STEEL}, (RemotePoint("left", "left", [-0.02, 0, 0.005]),))
    return solid, generate_mesh(solid, element_size=8e-3, extrude="z", layer_thickness=5e-3)


@pytest.mark.parametrize("order", [1, 2, 3, 4])
def test_curved_prisms_are_where_netgen_has_them_point_by_point(order, drilled_plate):
    expected, found = (ng.Mesh(drilled_plate[1].Copy()) for _ in range(2))
    expected.Curve(order)
    curve_mesh(found, order)
    for number in range(found.ne):
        there, here = (mesh.GetTrafo(ng.ElementId(ng.VOL, number)) for mesh in (expected, found))
        for point in ((0.2, 0.3, 0.4), (0.5, 0.5, 0.0), (0.25, 0.75, 1.0), (0.0, 0.3, 0.0), (0.7, 0.0, 1.0)):
            np.testing.assert_allclose(here(*point).point, there(*point).point, rtol=0, atol=1e-15)


@pytest.mark.parametrize("order", [2, 3])
def test_curved_prisms_leave_no_gap(order, drilled_plate):
    """A rotation then strains nothing, and a uniform strain has the energy of the volume."""
    solid, flat = drilled_plate
    mesh, _ = assembly.curved_mesh(flat.Copy(), order)
    model = assemble_mesh(mesh, solid, order)
    x, y, z = model.fields[1:]
    stretch, turns = np.concatenate([x, 0 * y, 0 * z]), ([0 * x, -z, y], [z, 0 * y, -x], [-y, x, 0 * z])
    energy = stretch @ (model.stiffness @ stretch)
    for turn in map(np.concatenate, turns):
        assert abs(turn @ (model.stiffness @ turn)) < 1e-13 * energy
    lame, shear = STEEL.lame_parameters
    assert energy == pytest.approx((lame + 2 * shear) * ng.Integrate(1.0, mesh), rel=1e-12)


def test_mending_prisms_leaves_them_on_the_curved_faces():
    """A deformation curves prisms, to which that which mends them is added."""
    mesh = ng.Mesh(generate_mesh(make_plate(angle=0), element_size=10e-3, extrude="z", layer_thickness=4e-3))
    curving._curve(mesh, 2)
    inside = volume_inside(mesh)
    found = curve_mesh(mesh, 2)
    assert found.n_folded
    assert not len(found.left)
    assert volume_inside(mesh) == pytest.approx(inside, rel=1e-12)


@pytest.mark.slow
def test_the_default_actuator_has_no_folded_element(apa_prisms):
    mesh = ng.Mesh(apa_prisms.Copy())
    assert curve_mesh(mesh, 3).n_folded > 0
    assert not folded_elements(mesh).any()


@pytest.mark.filterwarnings("ignore:.*more volume than the CAD")
def test_the_description_tells_how_many_elements_folded(plate_mesh, monkeypatch):
    monkeypatch.setattr(assembly, "generate_mesh", lambda *_, **__: plate_mesh.Copy())
    description = build_fe_model(make_plate(), element_size=10e-3, order=2, progress=False).description
    assert re.search(r"\d+ of \d+ curved elements folded, all mended by moving inner nodes", description)


def test_a_mesh_whose_folds_cannot_be_mended_is_replaced_by_one_with_smaller_elements_there():
    model = build_fe_model(make_plate(2e-3, 1e-3, 0), element_size=8e-3, order=2, progress=False)
    assert re.search(r"meshed anew with smaller elements where \d+ elements were folded", model.description)
    assert not folded_elements(model._source[0]).any()


@pytest.mark.filterwarnings("ignore:.*more volume than the CAD")
def test_a_mesh_that_cannot_be_replaced_gets_straighter_edges_with_a_warning(thin_plate_mesh, monkeypatch):
    monkeypatch.setattr(assembly, "generate_mesh", lambda *_, **__: thin_plate_mesh.Copy())
    monkeypatch.setattr(assembly, "FURTHER_MESHES", 0)
    with pytest.warns(
        UserWarning, match=r"\d+ mended by straighter edges of \d+, .* up to \d+ um, at \(.*, .*, .*\)"
    ) as told:
        model = build_fe_model(make_plate(2e-3, 1e-3, 0), element_size=8e-3, order=2, progress=False)
    assert {warning.filename for warning in told} == {__file__}
    assert not folded_elements(model._source[0]).any()
    assert "mended by straighter edges" in model.description
    assert model.warnings


def test_the_last_folded_elements_get_straighter_edges(plate_mesh, monkeypatch):
    """Without any motion of inner nodes; faces of radius R on chords c move by at most R - sqrt(R^2 - c^2 / 4) < R."""
    monkeypatch.setattr(curving, "untangle", lambda *_: None)
    mesh = ng.Mesh(plate_mesh.Copy())
    found = curve_mesh(mesh, 2)
    assert len(found.left) > 5
    mended = reduce_curvature(mesh, 2, found)
    assert not folded_elements(mesh).any()
    assert mended.n_straightened >= len(found.left)
    assert 1e-5 < mended.displacement < 3e-3
    assert ng.Integrate(1.0, mesh, order=6) == pytest.approx(volume_inside(mesh), rel=1e-12)


def test_a_vertex_that_turned_elements_inside_out_moves_back():
    """As it may by mending, when the displacements of edges and faces do not matter."""
    mesh = ng.Mesh(occ.OCCGeometry(occ.Box((0, 0, 0), (1, 1, 1))).GenerateMesh(maxh=0.5, nthreads=1))
    outside = {vertex.nr for element in mesh.Elements(ng.BND) for vertex in element.vertices}
    inner = min(set(range(mesh.nv)) - outside)
    deformation = ng.GridFunction(ng.VectorH1(mesh, order=2))
    deformation.vec.FV().NumPy()[inner] = 1.0
    mesh.SetDeformation(deformation)
    n_folded = folded_elements(mesh).sum()
    assert n_folded > 0
    assert curving._straighten(mesh, 2) == n_folded
    assert not folded_elements(mesh).any()


def test_the_distortion_is_least_for_a_rotation_and_its_derivative_is_its_slope():
    """By difference quotients, for maps with determinants of both signs."""
    maps, epsilon = np.stack([MAP, -MAP, MAP[[1, 0, 2]]]), 0.3
    values, slopes = untangling._distortion(maps, epsilon)
    for i, j in np.ndindex(3, 3):
        step = np.zeros((3, 3))
        step[i, j] = 1e-6
        above, below = (untangling._distortion(maps + sign * step, epsilon)[0] for sign in (1, -1))
        assert slopes[:, i, j] == pytest.approx((above - below) / 2e-6, rel=1e-7)
    rotation = np.linalg.qr(MAP)[0]
    rotation *= np.linalg.det(rotation)
    least, slope = untangling._distortion(rotation[None], 1e-9)
    assert least == pytest.approx(2)
    assert np.abs(slope).max() < 1e-12
    assert values.min() > 2


@pytest.mark.parametrize("rounds", [1, 2, 12])
def test_the_motion_of_fewest_folds_is_kept(rounds, thin_plate_mesh, monkeypatch):
    """Where not all elements can unfold, further rounds fold others."""
    monkeypatch.setattr(untangling, "ROUNDS", rounds)
    mesh = ng.Mesh(thin_plate_mesh.Copy())
    found = curve_mesh(mesh, 2)
    assert 0 < len(found.left) <= found.n_folded
    assert len(found.left) == folded_elements(mesh).sum()


def test_faces_move_by_their_normal_displacement_only():
    """A unit cube whose points slide within its faces by up to 0.25, and one that is longer by a hundredth."""
    mesh = ng.Mesh(occ.OCCGeometry(occ.Box((0, 0, 0), (1, 1, 1))).GenerateMesh(maxh=1, nthreads=1))
    field = ng.GridFunction(ng.VectorH1(mesh, order=2))
    for motion, expected in ((ng.x * (1 - ng.x), 0.0), (0.01 * ng.x, 0.01)):
        field.Set(ng.CoefficientFunction((motion, 0, 0)))
        assert curving._largest_across_faces(mesh, field) == pytest.approx(expected, abs=1e-12)


@pytest.mark.slow
@pytest.mark.skipif(calculix.PROGRAM is None, reason="CalculiX is not installed (Debian: calculix-ccx)")
def test_calculix_accepts_the_mended_mesh_and_finds_the_same_frequencies(apa_tetrahedra, tmp_path):
    """On few strongly curved elements, the two programs' integration rules differ by more."""
    solid = make_apa300ml(coupling="rbe2")
    solid = replace(solid, remote_points=solid.remote_points[:1])
    mesh = ng.Mesh(apa_tetrahedra.Copy())
    mesh.Curve(2)
    with pytest.raises(RuntimeError, match="nonpositive jacobian"):
        calculix.eigenfrequencies(assemble_mesh(mesh, solid, 2), tmp_path, fixed=["bottom_pad"], n=5)
    model = meshed(apa_tetrahedra, solid, 2)
    expected = full_eigenfrequencies(condense(model, progress=False), fixed=["bottom"], n=5, progress=False)
    found = calculix.eigenfrequencies(model, tmp_path, fixed=["bottom_pad"], n=5)
    assert np.allclose(found, expected, rtol=1e-5)
