"""Finite element models: closed forms of bars and beams, rigid motions, remote points."""

from dataclasses import replace

import netgen.occ as occ
import ngsolve as ng
import numpy as np
import pytest
from conftest import STEEL, lattice, make_bar

from nassim import FEModel, Material, RemotePoint, Solid, build_fe_model, condense
from nassim.fem.fe_model import make_coupling
from nassim.fem.full_model import full_eigenfrequencies


@pytest.fixture(scope="module")
def bar():
    return build_fe_model(make_bar(), element_size=0.01, order=2, progress=False)


def test_mass_is_the_integral_of_the_density(bar, apa_model):
    assert bar.mass == pytest.approx(7800 * 0.1 * 0.01**2, rel=1e-9)
    one = np.tile(apa_model.fields[0], 3)
    assert one @ apa_model.mass_matrix @ one == pytest.approx(3 * apa_model.mass, rel=1e-12)


def test_apa_mass_against_cad_volume(apa_model, apa_solid):
    volume = sum(body.mass for body in apa_solid.shape.solids)
    assert apa_model.mass == pytest.approx(7800 * volume, rel=3e-3)


@pytest.mark.parametrize("order", [1, 2, 3, 4])
def test_rigid_motions_cost_no_energy(order):
    model = build_fe_model(make_bar(), element_size=0.02, order=order, progress=False)
    forces = model.stiffness_matrix @ model.rigid_motions()
    assert np.abs(forces).max() < 1e-10 * np.abs(model.stiffness_matrix).max()
    assert abs(model.stiffness_matrix - model.stiffness_matrix.T).max() < 1e-12 * abs(model.stiffness_matrix).max()


def test_bar_in_tension_without_lateral_contraction():
    """With nu = 0 the bar is one-dimensional: k = E A / l exactly, for any mesh."""
    solid = make_bar(material=Material("cork", 1e9, 0.0, 200.0))
    condensed = condense(build_fe_model(solid, element_size=0.02, order=1, progress=False), progress=False)
    stiffness = condensed.stiffness[6, 6]
    assert stiffness == pytest.approx(1e9 * 0.01**2 / 0.1, rel=1e-9)


def test_clamped_bar_vibrates_axially_at_the_closed_form():
    """f = c / 4 l for a bar clamped at one end; its end guided along x leaves only axial motion low."""
    solid = make_bar(material=Material("cork", 1e9, 0.0, 200.0))
    condensed = condense(build_fe_model(solid, element_size=0.01, order=2, progress=False), progress=False)
    found = full_eigenfrequencies(condensed, fixed=["left"], guided={"right": "x"}, n=8, progress=False)
    expected = np.sqrt(1e9 / 200.0) / (4 * 0.1)
    assert np.abs(found / expected - 1).min() < 1e-4


def test_rod_with_an_end_mass():
    """omega l / c tan(omega l / c) = rod mass / end mass."""
    from scipy.optimize import brentq

    solid = make_bar(material=Material("cork", 1e9, 0.0, 200.0))
    condensed = condense(build_fe_model(solid, element_size=0.01, order=2, progress=False), progress=False)
    ratio = 200.0 * 0.1 * 0.01**2 / 0.01
    root = brentq(lambda x: x * np.tan(x) - ratio, 1e-6, 1.5)
    expected = root * np.sqrt(1e9 / 200.0) / 0.1 / (2 * np.pi)
    found = full_eigenfrequencies(
        condensed, fixed=["left"], guided={"right": "x"}, masses={"right": 0.01}, n=6, progress=False
    )
    assert np.abs(found / expected - 1).min() < 1e-4


def test_cantilever_bends_like_a_timoshenko_beam():
    """Tip stiffness 1 / (l^3 / 3 E I + l / k G A), k = 10 (1 + nu) / (12 + 11 nu), within the 3D end effects."""
    length, side = 0.2, 0.01
    solid = make_bar(length, side, coupling="rbe2")
    condensed = condense(build_fe_model(solid, element_size=0.01, order=3, progress=False), progress=False)
    tip = np.linalg.inv(condensed.stiffness[6:, 6:])[2, 2]
    inertia, area, shear = side**4 / 12, side**2, STEEL.lame_parameters[1]
    factor = 10 * 1.3 / (12 + 11 * 0.3)
    expected = length**3 / (3 * 200e9 * inertia) + length / (factor * shear * area)
    assert tip == pytest.approx(expected, rel=5e-3)


def test_remote_point_measures_a_rigid_motion_wherever_it_lies(bar):
    """W R = 1 about the remote point's own position."""
    for coupling in bar.couplings:
        assert np.allclose(coupling.averages @ coupling.motions, np.eye(6), atol=1e-12)


def test_remote_point_off_its_face_rides_as_on_a_rigid_arm():
    solid = make_bar()
    moved = (solid.remote_points[0], RemotePoint("right", "right", np.array([0.15, 0.02, 0.0])))
    model = build_fe_model(Solid("bar", solid.shape, solid.materials, moved), element_size=0.02, progress=False)
    coupling = model.coupling("right")
    rows = np.concatenate([coupling.dofs + k * model.n_dofs // 3 for k in range(3)])
    motion = coupling.averages @ model.rigid_motions()[rows]
    assert np.allclose(motion[:3, 3:], -np.cross(np.eye(3), [0.15, 0.02, 0.0]).T * -1, atol=1e-12)


@pytest.mark.parametrize("order", [0, 7, 2.5])
def test_order_out_of_range(order):
    with pytest.raises(ValueError, match="whole number from 1 to 6"):
        build_fe_model(make_bar(), element_size=0.02, order=order, progress=False)


@pytest.mark.parametrize("size", [0.0, -1.0, np.nan, 1e-6])
def test_element_size_out_of_range(size):
    with pytest.raises(ValueError, match="element_size"):
        build_fe_model(make_bar(), element_size=size, progress=False)


def test_solid_in_two_pieces():
    a, b = occ.Box((0, 0, 0), (0.01, 0.01, 0.01)), occ.Box((0.02, 0, 0), (0.03, 0.01, 0.01))
    a.name = b.name = "body"
    solid = Solid("pieces", occ.Glue([a, b]), {"body": STEEL})
    with pytest.raises(ValueError, match="2 pieces"):
        build_fe_model(solid, element_size=0.01, order=1, progress=False)


def test_unknown_remote_point_lists_the_known_ones(bar):
    with pytest.raises(ValueError, match="known: left, right"):
        bar.coupling("middle")


def test_collinear_interface_cannot_carry_a_rotation():
    """Nodes on a line leave the rotation about it undefined."""
    x = np.array([0.0, 0.1, 0.2])
    fields = np.vstack([np.ones(3), x, np.zeros(3), np.zeros(3)])
    point = RemotePoint("edge", "edge", np.array([0.1, 0, 0]))
    with pytest.raises(ValueError, match="collinear or too small"):
        make_coupling(point, np.arange(3), fields, fields)


@pytest.mark.parametrize("coupling", ["rbe2", "rbe3"])
def test_remote_points_on_one_line_are_fine(coupling):
    """A beam's two remote points are always collinear; each carries its rotations itself."""
    condensed = condense(build_fe_model(make_bar(coupling=coupling), element_size=0.02, progress=False), progress=False)
    assert np.linalg.eigvalsh(condensed.stiffness[6:, 6:])[0] > 0


@pytest.mark.filterwarnings("ignore:.*more volume than the CAD")
def test_the_mass_matrix_of_curved_elements_has_the_moments_of_their_mesh():
    """Products of coordinates, against a rule of much higher order than that of the matrix."""
    rod = occ.Cylinder((0, 0, 0), occ.Vec(1, 2, 3), 0.004, 0.008)
    rod.name = "rod"
    model = build_fe_model(Solid("rod", rod, {"rod": STEEL}), element_size=0.005, order=3, progress=False)
    fields = (1.0, ng.x, ng.y, ng.z)
    density, mesh = STEEL.density, model._source[0]
    expected = np.array([[ng.Integrate(density * f * g, mesh, order=14) for g in fields] for f in fields])
    size = np.sqrt(np.diag(expected))
    found = model.fields @ model.scalar_mass_matrix @ model.fields.T
    np.testing.assert_allclose(found / np.outer(size, size), expected / np.outer(size, size), atol=1e-6)


def test_all_faces_of_a_remote_point_have_its_label():
    """Both ends of a bar, whose triangles are the only ones across it."""
    solid = make_bar()
    both = replace(solid, remote_points=(RemotePoint("grip", ("left", "right"), np.zeros(3)),))
    surface = build_fe_model(both, element_size=0.05, progress=False).surface
    across = np.ptp(surface.points[surface.triangles][..., 0], axis=1) < 1e-9
    assert across.any()
    np.testing.assert_array_equal(surface.labels, np.where(across, "grip", "bar"))


def test_a_model_prints_in_a_few_lines():
    text = repr(build_fe_model(make_bar(), element_size=0.02, order=2, progress=False))
    assert "'bar'" in text
    assert "order 2" in text
    assert len(text) < 500


@pytest.mark.parametrize("what", ["stiffness", "scalar_mass_matrix", "fields"])
def test_models_made_by_hand_hold_numbers_only(what):
    model = lattice()
    given = {
        "stiffness": model.stiffness_matrix,
        "scalar_mass_matrix": model.scalar_mass_matrix,
        "fields": model.fields,
    }
    broken = given[what].copy()
    (broken if what == "fields" else broken.data).flat[0] = np.nan
    with pytest.raises(ValueError, match=r"FE model 'lattice': the .* NaN or infinite values"):
        FEModel("lattice", **{**given, what: broken})
    with pytest.raises(ValueError, match="do not belong together"):
        FEModel("lattice", **{**given, what: given[what][:-1]})
