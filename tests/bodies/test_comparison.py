"""Two bodies side by side: against beams in closed form and bodies whose differences are known."""

from dataclasses import replace

import netgen.occ as occ
import numpy as np
import pytest
from conftest import STEEL

from nassim import RemotePoint, Solid, build_fe_model, compare, craig_bampton, load, save
from nassim.bodies.projection import trim_body

LENGTH, WIDTH, HEIGHT = 0.1, 0.010, 0.014


def beam(material, name="beam", height=HEIGHT):
    shape = occ.Box(occ.Pnt(0, -WIDTH / 2, -height / 2), occ.Pnt(LENGTH, WIDTH / 2, height / 2))
    shape.name = "beam"
    shape.faces.Min(occ.X).name, shape.faces.Max(occ.X).name = "left", "right"
    ends = (RemotePoint("root", "left", [0, 0, 0]), RemotePoint("tip", "right", [LENGTH, 0, 0]))
    model = build_fe_model(Solid(name, shape, {"beam": material}, ends), element_size=0.03, progress=False)
    return craig_bampton(model, n_modes=4, discretization=False, progress=False)


STIFFER = replace(STEEL, young_modulus=1.44 * STEEL.young_modulus, density=1.21 * STEEL.density)


@pytest.fixture(scope="module")
def one():
    return beam(STEEL)


@pytest.fixture(scope="module")
def other():
    return beam(STIFFER, "stiffer beam")


@pytest.mark.parametrize("fixed", [(), ("root",)])
def test_bodies_of_one_shape_differ_as_their_materials(one, other, fixed):
    result = compare(one, other, fixed=fixed)
    assert result.names == ("beam", "stiffer beam")
    assert result.mass[1] == pytest.approx(1.21 * result.mass[0])
    np.testing.assert_allclose(result.stiffness[1], 1.44 * result.stiffness[0], rtol=1e-6)
    elastic = one.eigenfrequencies(fixed=fixed)
    np.testing.assert_allclose(result.frequency[0], elastic[elastic > 0][:6], rtol=1e-9)
    np.testing.assert_allclose(result.frequency[1], 1.2 / 1.1 * result.frequency[0], rtol=1e-6)
    np.testing.assert_allclose(result.mac, 1.0, rtol=1e-6)
    assert result.distance == 0
    np.testing.assert_allclose(result.center_of_mass, [[LENGTH / 2, 0, 0]] * 2, atol=1e-9)


def test_stiffness_is_that_of_a_cantilever(one):
    """Timoshenko's beam with the shear coefficient 5/6; the clamped face adds some stiffness."""
    ux, uy, uz, _, ry, rz = compare(one, one).stiffness[0, 0]
    modulus, shear, area = STEEL.young_modulus, STEEL.young_modulus / (2 * (1 + STEEL.poisson_ratio)), WIDTH * HEIGHT
    about_z, about_y = HEIGHT * WIDTH**3 / 12, WIDTH * HEIGHT**3 / 12
    sheared = LENGTH / (5 / 6 * shear * area)
    assert ux == pytest.approx(modulus * area / LENGTH, rel=0.01)
    assert uy == pytest.approx(1 / (LENGTH**3 / (3 * modulus * about_z) + sheared), rel=0.02)
    assert uz == pytest.approx(1 / (LENGTH**3 / (3 * modulus * about_y) + sheared), rel=0.02)
    assert rz == pytest.approx(modulus * about_z / LENGTH, rel=0.02)
    assert ry == pytest.approx(modulus * about_y / LENGTH, rel=0.02)


def test_modes_pair_by_shape_and_not_by_number(one):
    """A beam turned by 90 degrees about its axis bends first in the plane in which the other one bends second."""
    turn = np.kron(np.eye(2), np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]]))
    change = np.eye(len(one.mass_matrix))
    change[:12, :12] = np.kron(np.eye(2), turn)
    turned = replace(
        one,
        stiffness_matrix=change @ one.stiffness_matrix @ change.T,
        mass_matrix=change @ one.mass_matrix @ change.T,
        readouts={},
        enriched=None,
    )
    result = compare(one, turned, fixed=["root"], n=2)
    np.testing.assert_allclose(result.frequency[1], result.frequency[0, ::-1], rtol=1e-9)
    np.testing.assert_allclose(result.mac, 1.0, rtol=1e-4)  # the planes differ by their shear
    np.testing.assert_allclose(result.stiffness[1, 0, [1, 2]], result.stiffness[0, 0, [2, 1]], rtol=1e-9)


@pytest.mark.parametrize(("points", "arm"), [(None, LENGTH / 2), (["tip"], 1.0)])
def test_rotations_count_by_the_distance_of_the_points_or_a_metre(one, points, arm):
    """Against a body whose tip rotates the other way."""
    signs = np.ones(len(one.mass_matrix))
    signs[9:12] = -1.0
    stiffness, mass = (signs[:, None] * matrix * signs for matrix in (one.stiffness_matrix, one.mass_matrix))
    other = replace(one, stiffness_matrix=stiffness, mass_matrix=mass, readouts={}, enriched=None)
    squares = one.eigenmodes(fixed=["root"], n=1)[1][6:12, 0] ** 2
    moves, turns = squares[:3].sum(), arm**2 * squares[3:].sum()
    found = compare(one, other, fixed=["root"], points=points, n=1).mac
    assert found == pytest.approx([((moves - turns) / (moves + turns)) ** 2])


def test_modes_that_move_the_points_alike_pair_by_frequency():
    """The tip of a cantilever moves alike in all torsional modes."""
    thin, thicker = beam(STEEL, height=2.0e-3), beam(STEEL, height=2.4e-3)
    first, second = compare(thin, thicker, fixed=["root"], n=8).frequency
    assert (second / first).min() == pytest.approx(1, abs=0.01)
    assert (second / first).max() == pytest.approx(1.2, abs=0.1)


def test_it_prints_as_a_table_and_is_stored(one, other, tmp_path):
    result = compare(one, other, fixed=["root"], n=2)
    lines = str(result).splitlines()
    assert lines[0].split() == ["beam", "stiffer", "beam", "b", "/", "a", "-", "1", "MAC"]
    cells = {line.rsplit("  ", 3)[0].split("]")[0] + "]": line for line in lines}
    assert "+21.00 %" in cells["mass [kg]"]
    assert cells["stiffness tip.ux [N/m]"].endswith("+44.00 %")
    assert "stiffness tip.rz [N m/rad]" in cells
    assert cells["mode 2 [Hz]"].endswith("+9.09 %  1.00")
    assert lines[-2] == "Stiffness: root held. Modes: root held."
    assert lines[-1] == "Centres of mass differ by 0.000 mm, points by up to 0.000 mm."
    apart = replace(result, center_of_mass=np.array([[0.0, 0.0, 0.0], [3e-4, 0.0, 4e-4]]), distance=2e-3)
    assert str(apart).endswith("Centres of mass differ by 0.500 mm, points by up to 2.000 mm.")
    again = load(save(result, tmp_path / "comparison.h5"))
    assert str(again) == str(result)


def test_only_common_points_are_compared(one):
    root, tip = one.remote_points
    renamed = replace(one, remote_points=(root, replace(tip, name="end")), readouts={}, enriched=None)
    result = compare(one, renamed)
    assert result.points == ("root",)
    assert result.stiffness.shape == (2, 0, 6)
    assert "Stiffness" not in str(result)
    shifted = replace(tip, position=[LENGTH, 0.002, 0])
    moved = compare(one, replace(one, remote_points=(root, shifted), readouts={}, enriched=None))
    assert moved.distance == pytest.approx(0.002)
    assert "points by up to 2.000 mm" in str(moved)
    assert str(moved).splitlines()[-2] == "Stiffness: root held. Modes: free, without rigid-body modes."
    assert compare(one, one, points=["tip"]).points == ("tip",)
    with pytest.raises(ValueError, match=r"no remote point of the same name: root, tip against a, end"):
        compare(one, replace(renamed, remote_points=(replace(root, name="a"), renamed.remote_points[1])))
    with pytest.raises(ValueError, match="'middle'"):
        compare(one, renamed, points=["middle"])
    with pytest.raises(ValueError, match="'tip'"):
        compare(one, renamed, fixed=["tip"])
    passive = trim_body(one, points=["root"], loads=np.zeros((len(one.mass_matrix), 0)), cutoff_frequency=1e4)
    assert compare(one, passive).points == ("root",)
    with pytest.raises(ValueError, match=r"unknown remote point of body 'beam' 'tip'; known: root$"):
        compare(one, passive, points=["tip", "root"])


def test_modes_that_move_no_point_pair_in_order(one, other):
    result = compare(one, other, fixed=["root", "tip"], n=3)
    np.testing.assert_allclose(result.frequency[1], 1.2 / 1.1 * result.frequency[0], rtol=1e-6)
    assert not result.mac.any()
