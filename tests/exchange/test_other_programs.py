"""Superelements of Nastran, Abaqus and CalculiX: round trips, files by hand and of others, bad files."""

import subprocess
import sys
import warnings
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path

import calculix
import numpy as np
import pytest
import scipy.io
import scipy.linalg
from conftest import make_bar, meshed
from scipy.spatial.transform import Rotation
from superelements import SAMPLE, sample

from nassim import craig_bampton
from nassim.base.rigid_motion import rigid_transfer
from nassim.exchange import (
    check,
    export_body,
    read_calculix,
    read_superelement,
    superelement,
    to_body,
    write_superelement,
)
from nassim.exchange.c_tables import CNumbers
from nassim.exchange.nastran import BulkData, Card, _matrices, _points, cards, real_field
from nassim.exchange.nodal_matrices import NodalMatrices, interface_rows
from nassim.exchange.superelements import MOST_COORDINATES, Superelement
from nassim.fem.meshing import generate_mesh

YETI = find_spec("pyyeti")
needs_yeti = pytest.mark.skipif(YETI is None, reason="the package pyYeti is not installed (nassim[nastran])")
ENDINGS = ["pch", "mtx", pytest.param("op4", marks=needs_yeti)]


@pytest.fixture(scope="module")
def large():
    """Sixty nodes in general positions on a chain of springs and masses, two modes, numbers that do not ascend."""
    rng = np.random.default_rng(1)
    positions = rng.uniform(-0.3, 0.3, (60, 3))
    stiffness, mass = np.zeros((362, 362)), np.zeros((362, 362))
    for k in range(60):
        mass[6 * k : 6 * k + 6, 6 * k : 6 * k + 6] = np.diag([0.1] * 3 + [1e-4] * 3)
        if k < 59:
            # Relative motion of the next node and of the point that moves with this one.
            relative = np.zeros((6, 362))
            relative[:, 6 * k : 6 * k + 6] = -rigid_transfer(positions[k + 1] - positions[k])
            relative[:, 6 * k + 6 : 6 * k + 12] = np.eye(6)
            stiffness += relative.T @ np.diag(rng.uniform(1, 2, 6) * [1e7, 1e7, 1e7, 1e4, 1e4, 1e4]) @ relative
    mass[360:, 360:], stiffness[360:, 360:] = np.eye(2), np.diag([1e6, 3e6])
    mass[:360, 360:] = 0.02 * rng.uniform(-1, 1, (360, 2)) * np.sqrt(np.diag(mass)[:360, None])
    mass[360:, :360] = mass[:360, 360:].T
    names = tuple(f"node_{number}" for number in rng.permutation(np.arange(1001, 1061)))
    return Superelement(
        "large", stiffness_matrix=stiffness, mass_matrix=mass, positions=positions, names=names, units="mm-N-t"
    )


def written(body, path, units="mm-N-t"):
    return write_superelement(body, path, units=units)


def assert_same(back, body, accuracy):
    assert back.names == body.names
    np.testing.assert_allclose(back.positions, body.positions, atol=accuracy)
    for kind in ("stiffness_matrix", "mass_matrix"):
        expected, found = getattr(body, kind), getattr(back, kind)
        size = np.sqrt(np.abs(np.outer(np.diag(expected), np.diag(expected))))
        assert np.max(np.abs(found - expected) / size) < accuracy


@pytest.mark.parametrize("ending", ENDINGS)
def test_round_trips_keep_sixty_nodes_in_any_order(large, ending, tmp_path):
    """In mm-N-t; a field of DMIG holds eleven digits."""
    paths = written(large, tmp_path / f"new/body.{ending}")
    assert sorted(paths) == sorted(paths[0].parent.iterdir()), "no temporary file stays"
    back = read_superelement(*paths, units="mm-N-t")
    assert_same(back, large, 1e-10 if ending == "pch" else 1e-14)
    assert back.units == "mm-N-t"
    assert check(large)["row order"].verdict == check(back)["row order"].verdict == "ok"


@pytest.mark.parametrize("ending", ["mat", "npz"])
def test_sixty_nodes_go_through_arrays(large, ending, tmp_path):
    back = read_superelement(export_body(to_body(large, any_size=True), tmp_path / f"body.{ending}"))
    assert_same(back, large, 1e-14)


@pytest.mark.parametrize("ending", ENDINGS)
def test_units_are_asked_for_and_count(ending, tmp_path):
    body = sample()
    paths = written(body, tmp_path / f"body.{ending}")
    text = paths[-1].read_text()
    assert f"{body.name} by nassim, mm-N-t, s, rad" in text.partition("\n")[0], "a person reads the units"
    with pytest.raises(ValueError, match=r"does not say its units.*units='mm-N-t'"):
        read_superelement(*paths)
    wrong = read_superelement(*paths, units="m-N-kg")
    np.testing.assert_allclose(wrong.positions, 1e3 * body.positions)
    assert check(wrong)["units"].verdict == "fault"
    inches = read_superelement(*written(body, tmp_path / f"in.{ending}", "in-lbf-slinch"), units="in-lbf-slinch")
    assert_same(inches, replace(body, names=inches.names), 1e-10)


@pytest.mark.parametrize("ending", ENDINGS)
def test_positions_that_are_given_replace_those_of_the_file(ending, tmp_path):
    """At their nodes only; the matrices are those of the file."""
    body = sample()
    corrected = body.positions + np.outer([0, 1, 0], [0.02, 0.05, -0.01])
    given = {int(body.names[1].removeprefix("node_")): 1e3 * corrected[1]}
    back = read_superelement(*written(body, tmp_path / f"body.{ending}"), units="mm-N-t", positions=given)
    assert_same(back, replace(body, positions=corrected), 1e-10)


@pytest.mark.parametrize("ending", ENDINGS)
def test_names_and_bodies_are_written_too(ending, tmp_path):
    """A reduced body; its points have names that the formats do not hold."""
    body = to_body(sample(names=["a", "b", "c"]), any_size=True)
    back = read_superelement(*written(body, tmp_path / f"body.{ending}"), units="mm-N-t")
    assert back.names == ("node_1", "node_2", "node_3")
    frequency = to_body(back, any_size=True).eigenfrequencies(fixed=["node_1"], n=5)
    np.testing.assert_allclose(frequency, body.eigenfrequencies(fixed=["a"], n=5), rtol=1e-8)
    stiffness = np.diag(np.arange(1.0, 9.0))
    stiffness[7, 0] = stiffness[0, 7] = 0.5  # the first coordinate is coupled to the second mode alone
    coupled = superelement(stiffness, np.eye(8), [[0.1, 0.2, 0.3]])
    back = read_superelement(*written(coupled, tmp_path / f"coupled.{ending}"), units="mm-N-t")
    np.testing.assert_allclose(back.stiffness_matrix, stiffness, rtol=1e-9)


HAND = """$ by hand, after the Quick Reference Guide: a bar of two nodes, mm-N-t
CORD2R* 10              0               0.              0.
*       0.              1.              0.              0.
*       0.              1.              0.
GRID    7               100.    0.0     0.              0
GRID,3,,0.,0.,0.,10
SPOINT  21
DMIG    KAAX    0       6       2       0
DMIG    MAAX    0       6       2       0
"""
"""Node 3 moves along axes 10: x is the basic y, y the basic z, z the basic x."""


def by_hand(spring):
    """Masses, a spring along the basic x between the nodes in a small field, another of one node; a mode."""
    rows = [("MAAX", node, component, "2.-3") for node in (7, 3) for component in range(1, 7)]
    rows += [
        ("KAAX", node, component, "1.5+3" if component == 2 else "0.D0") for node in (7, 3) for component in range(2, 7)
    ]
    rows.remove(("KAAX", 3, 3, "0.D0"))
    rows.append(("KAAX", 3, 1, "0."))
    text = HAND + f"DMIG    KAAX    7       1               7       1       {spring:16}+A\n"
    text += f"+A      3       3       -{spring}\nDMIG    KAAX    3       3               3       3       {spring}\n"
    for name, node, component, value in rows:
        text += f"DMIG*   {name:16}{node:16}{component:16}\n*       {node:16}{component:16}{value:>16}\n"
    return text + "DMIG    KAAX    21      0               21      0       4.+6\nDMIG,MAAX,21,0,,21,0,1.\n"


def test_dmig_by_hand(tmp_path):
    """Symmetric form with one triangle, three field formats, short exponents, a turned displacement system."""
    path = tmp_path / "hand.pch"
    path.write_text(by_hand("1.5+3"))
    body = read_superelement(path, units="mm-N-t")
    assert body.names == ("node_7", "node_3")
    np.testing.assert_allclose(body.positions, [[0.1, 0, 0], [0, 0, 0]])
    expected = np.zeros((13, 13))
    expected[np.ix_([0, 6], [0, 6])] = 1.5e6 * np.array([[1, -1], [-1, 1]])
    # Component 2 is the basic y of node 7, and the basic z of node 3.
    expected[1, 1], expected[8, 8], expected[12, 12] = 1.5e6, 1.5e6, 4e6
    np.testing.assert_allclose(body.stiffness_matrix, expected, atol=1e-6)
    np.testing.assert_allclose(np.diag(body.mass_matrix), [2.0] * 3 + [2e-6] * 3 + [2.0] * 3 + [2e-6] * 3 + [1.0])
    moved = read_superelement(path, units="mm-N-t", positions={3: (0, 50, 0)})
    np.testing.assert_allclose(moved.positions[1], [0, 0.05, 0])


@pytest.mark.parametrize(
    "cards", ["QSET,8,123456,9,1", "QSET,8,12,9,1\nQSET1,3456,8", "QSET1     123456       8    THRU       9"]
)
def test_modal_coordinates_may_be_components_of_grids(tmp_path, cards):
    rng = np.random.default_rng(0)
    factor = rng.normal(size=(13, 13))
    stiffness, mass = factor @ factor.T, np.eye(13) + 0.1 * np.ones((13, 13))
    dofs = [(node, k) for node in (8, 5) for k in range(1, 7)] + [(9, 1)]  # those of 8 and 9 are modal
    text = "GRID,8,,0.,0.,0.\nGRID,5,,1.,2.,3.\nGRID,9,,0.,0.,0.\nQSET1,,20,21\n" + cards + "\n"
    for name, matrix in (("KAAX", stiffness), ("MAAX", mass)):
        text += f"DMIG,{name},0,6,2,0\n"
        for j, (node, k) in enumerate(dofs):
            rows = [f",{dofs[i][0]},{dofs[i][1]},{matrix[i, j]:.15e}," for i in range(j, 13)]
            text += f"DMIG,{name},{node},{k},{''.join(rows[:1])}\n" + "".join(f"{row}\n" for row in rows[1:])
    path = tmp_path / "part.pch"
    path.write_text(text)
    body = read_superelement(path, units="m-N-kg")
    order = np.r_[6:12, 0:6, 12]
    assert (body.names, body.n_modes) == (("node_5",), 7)
    np.testing.assert_allclose(body.stiffness_matrix, stiffness[np.ix_(order, order)], rtol=1e-14)
    np.testing.assert_allclose(body.mass_matrix, mass[np.ix_(order, order)], rtol=1e-14)


def test_turned_systems_rest_on_others(tmp_path):
    """A grid in a system in a system, in general position, by rotations of SciPy."""
    first, second = Rotation.from_euler("zyx", [0.4, -0.7, 1.1]), Rotation.from_euler("xyz", [1.3, 0.2, -0.5])
    origins = np.array([[1.0, -2.0, 3.0], [0.5, 4.0, -1.0]])

    def card(number, base, origin, turn):
        points = [origin, origin + turn.apply([0, 0, 2.0]), origin + turn.apply([3.0, 0, 1.0])]
        return f"CORD2R,{number},{base}," + "".join(
            f"{x:.9f}," + ("\n," if k == 5 else "") for k, x in enumerate(np.ravel(points))
        )

    body = sample()
    path = written(body, tmp_path / "body.pch")[0]
    text = path.read_text()
    start = text.index("GRID*   " + f"{1001:16}")
    grid = "GRID,1001,2,7.,8.,9.,2\n"
    text = text[:start] + grid + text[text.index("GRID*", start + 5) :]
    path.write_text(f"{card(1, 0, origins[0], first)}\n{card(2, 1, origins[1], second)}\n{text}")
    back = read_superelement(path, units="mm-N-t")
    turn = first * second
    place = origins[0] + first.apply(origins[1] + second.apply([7.0, 8.0, 9.0]))
    np.testing.assert_allclose(1e3 * back.positions[0], place, atol=1e-8)
    block = turn.as_matrix() @ body.stiffness_matrix[:3, :3] @ turn.as_matrix().T
    np.testing.assert_allclose(back.stiffness_matrix[:3, :3], block, rtol=1e-7, atol=1e-8 * np.abs(block).max())


@pytest.mark.parametrize("value", [-1.23456789012345e-5, 9.99999999999999e9, 1e-12, -3.0, 0.1, 1e123, -1e-123])
def test_fields_hold_eleven_digits(value):
    text = real_field(value)
    assert len(text) == 16
    assert Card("", "X", (text.strip(),)).real(0) == pytest.approx(value, rel=5e-11)


def test_cards_join_their_lines():
    found = list(cards(Path("a.pch"), "SPOINT,1,2,3,4,5,6,7,8\n,9 $ more\n$\nGRID*   4\n*\nENDDATA\n"))
    assert [(card.name, card.integer(0)) for card in found] == [("SPOINT", 1), ("GRID", 4), ("ENDDATA", 0)]
    assert found[0].integer(8) == 9


def test_points_are_listed_one_by_one_or_from_first_to_last():
    """Up to as many as a superelement may have coordinates."""
    for words, expected in (("3 9 4", [3, 9, 4]), ("3 THRU 6", [3, 4, 5, 6]), ("5 9", [5, 9])):
        assert _points(Card("", "SPOINT", tuple(words.split()))) == expected
    assert len(_points(Card("", "SPOINT", ("1", "thru", "99999999")))) == MOST_COORDINATES + 1


ABAQUS = """** Abaqus repeats a list of components only where it changes
*USER ELEMENT, NODES=       2, LINEAR
** ELEMENT NODES
**         8,         5
1, 2, 3, 4, 5, 6
2, 3, 1, 2, 4, 5, 6
*MATRIX,TYPE=STIFFNESS
{K}
*MATRIX,TYPE=MASS
{M}
"""


def test_mtx_as_abaqus_writes_it(tmp_path):
    values = np.zeros((12, 12))
    values[np.tril_indices(12)] = np.arange(1.0, 79.0)
    values += np.diag(100.0 * np.arange(1, 13))
    lines = "\n".join(",".join(f" {x:.13E}" for x in row[: k + 1]) for k, row in enumerate(values))
    path = tmp_path / "z1.mtx"
    path.write_text(ABAQUS.format(K=lines, M=lines.replace(", ", ",\n")))
    with pytest.raises(ValueError, match=r"no coordinates of 2 of 2 nodes, the first is 8: .*positions=\{8"):
        read_superelement(path, units="m-N-kg")
    body = read_superelement(path, units="m-N-kg", positions={5: (1, 2, 3), 8: (0, 0, 0)})
    assert body.names == ("node_8", "node_5")
    full = values + np.tril(values, -1).T
    order = [*range(6), 7, 8, 6, 9, 10, 11]
    np.testing.assert_allclose(body.stiffness_matrix, full[np.ix_(order, order)])
    np.testing.assert_array_equal(body.mass_matrix, body.stiffness_matrix)
    places, dofs = {1: (0, 0, 0)}, [(1, k) for k in range(1, 7)] + [(2 + k, 0) for k in range(6)]
    renamed = read_superelement(path, units="m-N-kg", positions=places, dofs=dofs)
    assert (renamed.names, renamed.n_modes) == (("node_1",), 6)
    for wrong, message in (
        (dofs[:6], "12 rows, dofs names 6"),
        ([(1, 7), *dofs[1:]], r"component \(1 to 6, 0 for a modal one\), got \(1, 7\)"),
        ([(1, 1, 1), *dofs[1:]], r"got \(1, 1, 1\)"),
        ([(1, 1.5), *dofs[1:]], "node and component of a row must be a whole number, got 1.5"),
        ([7, *dofs[1:]], r"dofs are pairs .* got \(7,\)"),
        ([(k, 0) for k in range(12)], "no row belongs to a component of a node"),
    ):
        with pytest.raises(ValueError, match=message):
            read_superelement(path, units="m-N-kg", positions=places, dofs=wrong)
    with pytest.raises(ValueError, match="position of node 1 must have shape 3, got 2"):
        read_superelement(path, units="m-N-kg", positions={1: (0, 0)}, dofs=dofs)
    with pytest.raises(ValueError, match=r"variables are for .* and Nastran's files, got"):
        read_superelement(path, units="m-N-kg", positions=places, variables={"K": "stiff"})


def changed(old, new):
    return lambda text: text.replace(old, new, 1)


BAD = {
    "pch": {
        "cut in a line": (lambda text: text[: len(text) // 2 - 3], "the last line has no end"),
        "cut after a line": (lambda text: text[: text.rindex("DMIG*")], r": 1 of 22 rows have no entry.*is cut"),
        "without mass": (lambda text: text[: text.index("DMIG    MAAX")], "no matrix MAAX or"),
        "without a value": (
            changed("*                   1001               1", "*                   1001 "),
            r"line 15: DMIG has '5.04",
        ),
        "text in a number": (
            changed("GRID*               1001               0", "GRID*               1001             1.5"),
            "'1.5' where an integer",
        ),
        "another format": (lambda text: "hello\nworld\n", "no matrix KAAX"),
        "empty": (lambda text: "", "is empty"),
        "two triangles": (
            lambda text: text + "DMIG,KAAX,1029,1,,1001,1,1.+9\n",
            r"KAAX: entries \(1029, 1\), \(1001, 1\) and .* differ",
        ),
        "an entry twice": (
            lambda text: text + "DMIG,KAAX,1001,1,,1001,1,1.+9\n",
            r"entry \(1001, 1\), \(1001, 1\) of KAAX is there twice",
        ),
        "no nodes": (lambda text: text.replace("GRID*", "GRIX*"), "no coordinates of 3 of 3 nodes"),
        "unknown axes": (changed(f"{1001:16}{0:16}", f"{1001:16}{4:16}"), "coordinate system 4 is missing"),
        "axes of all nodes": (lambda text: text + "GRDSET,,,,,,4\n", "GRDSET gives nodes a coordinate system"),
        "points on a line": (
            lambda text: changed(f"{1001:16}{0:16}", f"{1001:16}{4:16}")(text) + "CORD2R,4,0,,,,,,1.\n,,,2.\n",
            "line .*: the three points of a CORD2R must not be on one line",
        ),
        "points at one place": (
            lambda text: changed(f"{1001:16}{0:16}", f"{1001:16}{4:16}")(text) + "CORD2R,4\n",
            "line .*: the three points of a CORD2R must not be on one line",
        ),
        "axes of a cylinder": (
            lambda text: changed(f"{1001:16}{0:16}", f"{1001:16}{4:16}")(text) + "CORD2C,4,0,,,,,,1.\n,1.\n",
            "coordinate system 4 is a CORD2C; only CORD2R",
        ),
        "axes that rest on themselves": (
            lambda text: changed(f"{1001:16}{0:16}", f"{1001:16}{4:16}")(text) + "CORD2R,4,4,,,,,,1.\n,1.\n",
            "coordinate system 4 is a CORD2R; only CORD2R that rest on others",
        ),
        "axes of all places": (lambda text: text + "GRDSET,,4\n", "GRDSET gives nodes a coordinate system"),
        "a complex matrix": (changed(f"KAAX    {0:8}{6:8}{2:8}", f"KAAX    {0:8}{6:8}{4:8}"), "no matrix KAAX or"),
        "a rectangular matrix": (changed(f"KAAX    {0:8}{6:8}", f"KAAX    {0:8}{2:8}"), "no matrix KAAX or"),
        "a row without a node": (
            lambda text: text + "DMIG,KAAX,1001,1,,,1,5.\n",
            "a row of KAAX without node or value",
        ),
        "a component of 7": (lambda text: text + "EXTRN,1001,127\n", "digits from 0 to 6, got '127'"),
        "two superelements": (lambda text: text + "DMIG,KAAX,0,6,2,0\n", "a second matrix KAAX"),
        "a node at two places": (lambda text: text + "GRID,1001,,7.,8.,9.\n", "node 1001 is there twice, at different"),
        "text in a coordinate": (lambda text: text + "GRID,1001,,x\n", "GRID has 'x' where a number belongs"),
        "a row without a value": (
            lambda text: text + "DMIG,KAAX,1001,1,,1001,1\n",
            "a row of KAAX without node or value",
        ),
    },
    "mtx": {
        "cut in a line": (lambda text: text[: len(text) // 2 - 3], "the last line has no end"),
        "cut after a line": (
            lambda text: text[: text.rindex("\n", 0, -2000) + 1],
            "MASS has .* entries.*is cut|no .*MASS",
        ),
        "without mass": (lambda text: text[: text.index("*MATRIX,TYPE=MASS")], "TYPE=MASS .CalculiX writes none"),
        "text in a number": (changed("E+0", "x+0"), "line .*is not a number"),
        "another format": (lambda text: "hello\nworld\n", "numbers before the first option"),
        "two substructures": (lambda text: text + "*MATRIX, TYPE=MASS\n", r"a second \*MATRIX MASS; a file holds one"),
        "binary data": (lambda text: "\0" + text, "binary data, not the text that the ending .mtx stands for"),
        "a mesh": (lambda text: "*NODE\n1, 0., 0., 0.\n", "no .USER ELEMENT"),
        "empty": (lambda text: "", "is empty"),
        "a node too few": (changed("1001,", ""), "entries; the lower triangle|a component"),
        "a node too many": (
            changed("1, 2, 3, 4, 5, 6\n", "1, 2, 3, 4, 5, 6\n99, 1\n"),
            "components of node 99 in a list",
        ),
        "the first node twice": (
            changed("1, 2, 3, 4, 5, 6\n", "1, 2, 3, 4, 5, 6\n1, 1\n"),
            "components of node 1 in a list",
        ),
        "a component of 1.5": (changed("1, 2, 3, 4, 5, 6\n", "1, 2, 3, 4, 5.5, 6\n"), "components must be integers"),
        "no list of nodes": (changed("** ELEMENT NODES", "** OTHER"), "no list of nodes below"),
        "a component too few": (changed("1, 2, 3, 4, 5, 6", "1, 2, 3, 4, 5"), "entries; the lower triangle"),
        "a coordinate too few": (changed("** 1113, ", "** "), "coordinates are lines of node, x, y, z"),
        "an infinite coordinate": (changed("1.0000000000000000E+02", "1E+999"), "coordinates must be finite"),
    },
}


@pytest.mark.parametrize(("ending", "case"), [(ending, case) for ending in BAD for case in BAD[ending]])
def test_bad_files_are_refused(ending, case, tmp_path):
    change, message = BAD[ending][case]
    (path,) = written(sample(), tmp_path / f"body.{ending}")
    path.write_text(change(path.read_text()))
    with pytest.raises(ValueError, match=message) as caught:
        read_superelement(path, units="mm-N-t")
    assert f"body.{ending}" in str(caught.value)


def test_comments_of_others_in_mtx_are_left_out(tmp_path):
    (path,) = written(sample(), tmp_path / "body.mtx")
    expected, text = read_superelement(path, units="mm-N-t"), path.read_text()
    path.write_text("** 2.5\n" + text.replace("\n1, 2, 3", "\n** of a bracket\n** 3\n1, 2, 3", 1))
    found = read_superelement(path, units="mm-N-t")
    assert found.names == expected.names
    np.testing.assert_array_equal(found.stiffness_matrix, expected.stiffness_matrix)


@pytest.mark.parametrize("letter", "Dd")
def test_exponents_of_fortran_in_mtx_are_read(letter, tmp_path):
    (path,) = written(sample(), tmp_path / "body.mtx")
    expected, text = read_superelement(path, units="mm-N-t"), path.read_text()
    matrices, comments, places = text.partition("** COORDINATES")
    path.write_text(matrices.replace("E+", f"{letter}+").replace("E-", f"{letter}-") + comments + places)
    found = read_superelement(path, units="mm-N-t")
    for name in ("stiffness_matrix", "mass_matrix"):
        np.testing.assert_array_equal(getattr(found, name), getattr(expected, name))


def test_nodes_without_rotations_are_refused(tmp_path):
    path = tmp_path / "solid.mtx"
    text = ABAQUS.replace("1, 2, 3, 4, 5, 6\n2, 3, 1, 2, 4, 5, 6", "1, 2, 3\n2, 4").replace("{K}", "1.," * 10)
    path.write_text(text.replace("{M}", "1.," * 10))
    with pytest.raises(
        ValueError,
        match=r"node 8 lacks the components 4 5 6; .* not coupled to one reference node",
    ):
        read_superelement(path, units="m-N-kg", positions={8: (0, 0, 0), 5: (1, 0, 0)})


def test_what_does_not_go_together_is_refused(tmp_path):
    (path,) = written(sample(), tmp_path / "body.mtx")
    (other,) = written(sample(), tmp_path / "body.pch")
    with pytest.raises(ValueError, match="stands alone"):
        read_superelement(path, other, units="mm-N-t")
    with pytest.raises(ValueError, match=r"positions and dofs are for listings"):
        read_superelement(tmp_path / "body.npz", positions={1: (0, 0, 0)})
    with pytest.raises(ValueError, match=r"one \.op4 or \.op2 file holds both matrices, got 2"):
        read_superelement(tmp_path / "a.op4", tmp_path / "b.op4", units="mm-N-t")
    for dense, message in (
        ([("KAAX", np.eye(6)), ("MAAX", np.eye(7))], r"KAAX is \(6, 6\), MAAX is \(7, 7\); both must be n x n"),
        ([("KAAX", np.ones((6, 7))), ("MAAX", np.ones((6, 7)))], "both must be n x n"),
    ):
        with pytest.raises(ValueError, match=message):
            _matrices(BulkData(), dense, {}, None, "a.op4")
    with pytest.raises(ValueError, match="KAAX and MAAX are not in the same kind of file"):
        _matrices(BulkData(matrices={"KAAX": {}}), [("MAAX", np.eye(6))], {}, None, "a.op4")
    with pytest.raises(ValueError, match="a component of a node has two rows"):
        interface_rows(NodalMatrices(np.eye(7), np.eye(7), ((1, 1), *((1, k) for k in range(1, 7))), {}), "a.op4")
    with pytest.raises(ValueError, match="DMIG names the node of each row"):
        read_superelement(other, units="mm-N-t", dofs=[(1, 1)])
    with pytest.raises(ValueError, match="read by read_calculix"):
        read_superelement(SAMPLE.parent / "calculix_bar/bar.sti", units="mm-N-t")
    scipy.io.mmwrite(tmp_path / "K.mtx", np.eye(6))
    with pytest.raises(ValueError, match=r"K\.mtx: one matrix in the Matrix Market format: .* `superelement`"):
        read_superelement(tmp_path / "K.mtx", units="mm-N-t")
    with pytest.raises(ValueError, match=r"unknown file ending '\.inp'"):
        write_superelement(sample(), tmp_path / "body.inp", units="mm-N-t")
    with pytest.raises(ValueError, match="unit"):
        write_superelement(sample(), tmp_path / "none.mtx", units="mm-N")
    lopsided = superelement(np.diag([100.0] * 6) + np.eye(6, k=1), np.eye(6), np.zeros((1, 3)))
    with pytest.raises(ValueError, match=r"\.mtx holds one triangle of each matrix: .* 1\.0e-02 in K.*repair"):
        write_superelement(lopsided, tmp_path / "none.mtx", units="mm-N-t")
    assert sorted(found.name for found in tmp_path.iterdir()) == ["K.mtx", "body.mtx", "body.pch"]


@pytest.mark.slow
@needs_yeti
def test_numbers_print_as_before_pyyeti_was_imported():
    values = np.float32([0.1, np.pi, 1.2345678e-9, 98765432.0])
    with np.printoptions(legacy="1.13"):
        assert [np.float32(CNumbers("single").literal(float(value))[:-1]) for value in values] == values.tolist()
    code = "before = np.get_printoptions(); _pyyeti(); assert np.get_printoptions() == before"
    code = f"import numpy as np; from nassim.exchange.nastran import _pyyeti; {code}"
    subprocess.run([sys.executable, "-c", code], check=True)


def test_without_pyyeti_the_message_says_what_to_install(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "pyyeti", None)
    with pytest.raises(RuntimeError, match=r"nassim\[nastran\]"):
        write_superelement(sample(), tmp_path / "body.op4", units="mm-N-t")
    assert list(tmp_path.iterdir()) == []


@pytest.fixture
def outboard():
    """Nastran's own files, in pyYeti's tests: EXTSEOUT of a truss with a turned interface node, mm-mN-kg (2016)."""
    folder = Path(YETI.submodule_search_locations[0]) / "tests/nas2cam_extseout"
    if not folder.exists():
        pytest.skip("this pyYeti has no test files")
    return folder / "outboard.op4", folder / "outboard.asm"


@needs_yeti
def test_nastrans_own_files(outboard):
    """Its printout gives the fixed-interface frequencies; the rigid-body test needs the frames of the nodes."""
    body = read_superelement(*outboard, units="mm-mN-kg")
    printed = outboard[0].with_suffix(".out").read_text(encoding="latin-1")
    rows = [line.split() for line in printed.splitlines() if len(line.split()) == 7]
    cycles = [float(row[4]) for row in rows if row[0] == row[1] and row[0].isdigit()]
    assert len(cycles) >= 22
    found = np.sqrt(np.diag(body.stiffness_matrix)[24:] / np.diag(body.mass_matrix)[24:]) / (2 * np.pi)
    np.testing.assert_allclose(found[:16], cycles[:16], rtol=2e-6)
    report = check(body)
    assert [report[name].verdict for name in ("symmetry", "rigid motions", "row order", "modal rows")] == 4 * ["ok"]
    basic = read_superelement(*outboard, units="mm-mN-kg", orientations=[np.eye(3)] * 4)
    assert check(basic)["row order"].verdict == "fault"


@needs_yeti
def test_order_of_rows_is_asked_for(outboard, tmp_path):
    matrices, nodes = outboard
    body = read_superelement(matrices, nodes, units="mm-mN-kg")
    with pytest.raises(ValueError, match=r"which row belongs to which node\? .*46 pairs"):
        read_superelement(matrices, units="mm-mN-kg")
    order = [(node, k) for node in (3, 11, 19, 27) for k in range(1, 7)] + [(100 + k, 0) for k in range(22)]
    places = {int(name[5:]): 1e3 * place for name, place in zip(body.names, body.positions, strict=True)}
    by_hand = read_superelement(matrices, units="mm-mN-kg", dofs=order, positions=places)
    np.testing.assert_allclose(by_hand.stiffness_matrix[:6, :6], body.stiffness_matrix[:6, :6], rtol=1e-12)
    with pytest.raises(ValueError, match=r"no matrix KGG for K; there are .*KXX"):
        read_superelement(matrices, nodes, units="mm-mN-kg", variables={"K": "KGG"})
    data = matrices.read_bytes()
    for k, content in enumerate((data[: len(data) // 2], data[:-10], b"hello\n" * 50, bytes(500))):
        path = tmp_path / f"bad{k}.op4"
        path.write_bytes(content)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            with pytest.raises(ValueError, match=rf"bad{k}\.op4: damaged or of another format"):
                read_superelement(path, nodes, units="mm-mN-kg")


@needs_yeti
def test_a_file_of_two_superelements_is_refused(tmp_path):
    from pyyeti.nastran import op4

    body = sample()
    path, nodes = written(body, tmp_path / "body.op4")
    found = op4.read(str(path))
    op4.write(
        str(path), ["kaax", "maax", "kaax", "other", "other"], [*found.values(), 2 * found["kaax"], *[np.eye(2)] * 2]
    )
    with pytest.raises(ValueError, match=r"body\.op4.*: 2 matrices KAAX; a file holds one superelement"):
        read_superelement(path, nodes, units="mm-N-t")
    back = read_superelement(path, nodes, units="mm-N-t", variables={"K": "MAAX"})  # others may be there twice
    np.testing.assert_array_equal(back.mass_matrix.shape, body.mass_matrix.shape)


@needs_yeti
def test_text_op4_and_dmig_in_op2(tmp_path, outboard):
    """Text that pyYeti writes; .op2 with DMIG, where punch and binary of one run hold the same."""
    from pyyeti.nastran import op4

    body = sample()
    written(body, tmp_path / "body.op4")
    op4.write(str(tmp_path / "text.op4"), op4.read(str(tmp_path / "body.op4")), binary=False)
    back = read_superelement(tmp_path / "text.op4", tmp_path / "body.asm", units="mm-N-t")
    assert_same(back, body, 1e-12)
    folder = outboard[0].parents[1] / "nastran_dmig_data"
    (tmp_path / "nodes.asm").write_text("".join(f"GRID,{k},,{k}.,0.,0.\n" for k in (1, 2, 3)))
    options = {"units": "m-N-kg"}
    punch = read_superelement(
        folder / "matrix_factory.pch", tmp_path / "nodes.asm", variables={"K": "IDENT", "M": "IDENT"}, **options
    )
    binary = read_superelement(
        folder / "matrix.op2", tmp_path / "nodes.asm", variables={"K": "MIDENT", "M": "MIDENT"}, **options
    )
    np.testing.assert_array_equal(punch.stiffness_matrix, np.eye(21))
    np.testing.assert_array_equal(binary.stiffness_matrix, np.eye(21))
    with pytest.raises(ValueError, match=r"no matrix KAAX .* there are \w*, ?MIDENT"):
        read_superelement(folder / "matrix.op2", units="m-N-kg")


@needs_yeti
def test_matrices_in_op2(outboard):
    """Modal stiffness of a free body, in a file in which pyYeti's search for DMIG fails."""
    path = outboard[0].parents[1] / "cla_test_data_2020/residual.op2"
    if not path.exists():
        pytest.skip("this pyYeti has no such file")
    rows, places = [(node, k) for node in range(1, 12) for k in range(1, 7)], {k: (k, 0, 0) for k in range(1, 12)}
    options = {"units": "m-N-kg", "dofs": rows, "positions": places}
    body = read_superelement(path, variables={"K": "KHH", "M": "KHH"}, **options)
    modal = np.diag(body.stiffness_matrix)
    np.testing.assert_allclose(body.stiffness_matrix, np.diag(modal), atol=1e-3)
    assert np.sum(modal < 1e-7) == 6
    assert np.sum(modal > 100) == 60


def stored(folder, n_inner=2):
    """CalculiX's files of a chain of masses along x, with a reference and a rotation node at each end."""
    rng = np.random.default_rng(3)
    n = 12 + 3 * n_inner
    factor = rng.normal(size=(n, n))
    stiffness, mass = factor @ factor.T + n * np.eye(n), np.diag(rng.uniform(1, 2, n))
    dofs = [f"{5 + k}.{c}" for k in range(n_inner) for c in (1, 2, 3)]
    dofs += [f"{node}.{c}" for node in (101, 102, 201, 202) for c in (1, 2, 3)]
    for kind, matrix in (("sti", stiffness), ("mas", mass)):
        text = "".join(f"{i + 1} {j + 1}  {matrix[i, j]:.16e}\n" for j in range(n) for i in range(j + 1))
        (folder / f"job.{kind}").write_text(text)
    (folder / "job.dof").write_text("\n".join(dofs) + "\n")
    return stiffness, mass


STORED = {"units": "m-N-kg", "positions": {101: (0, 0, 0), 201: (1, 0, 0)}, "rotation_nodes": {101: 102, 201: 202}}


def test_calculix_stored_matrices_are_reduced(tmp_path):
    """Static stiffness by inversion; the lowest fixed-interface modes by a dense solution; nodes in any order."""
    stiffness, mass = stored(tmp_path)
    static = read_calculix(tmp_path / "job.sti", n_modes=0, **STORED)
    np.testing.assert_allclose(static.stiffness_matrix, np.linalg.inv(np.linalg.inv(stiffness)[6:, 6:]), rtol=1e-9)
    body = read_calculix(tmp_path / "job.dof", n_modes=5, names=["a", "b"], name="c", **STORED)
    assert (body.names, body.name, body.n_modes) == (("a", "b"), "c", 5)
    again = read_calculix(tmp_path / "job.dof", n_modes=5, **STORED)
    np.testing.assert_array_equal(again.stiffness_matrix, body.stiffness_matrix, "read once more, it has other numbers")
    modes = np.diag(body.stiffness_matrix)[12:] / np.diag(body.mass_matrix)[12:]
    np.testing.assert_allclose(modes, scipy.linalg.eigh(stiffness[:6, :6], mass[:6, :6], eigvals_only=True)[:5])
    np.testing.assert_allclose(body.stiffness_matrix[:12, :12], static.stiffness_matrix)
    back = dict(reversed(STORED["positions"].items()))
    turned = read_calculix(tmp_path / "job.sti", n_modes=0, **STORED | {"positions": back})
    swapped = np.ix_(*[[*range(6, 12), *range(6)]] * 2)
    np.testing.assert_allclose(turned.stiffness_matrix, static.stiffness_matrix[swapped])
    np.testing.assert_allclose(turned.mass_matrix, static.mass_matrix[swapped])


def test_a_bar_of_calculix():
    """Files of CalculiX 2.20: mass, and the first frequencies of a cantilever by Euler and Bernoulli."""
    options = STORED | {"units": "mm-N-t", "positions": {101: (0, 0, 0), 201: (200, 0, 0)}}
    bar = read_calculix(SAMPLE.parent / "calculix_bar/bar.sti", **options)
    report = check(bar)
    assert report.verdict == "ok"
    assert report["mass"].figures["kg"] == pytest.approx(0.157, rel=1e-9)
    beam = 1.8751041**2 / (2 * np.pi) * np.sqrt(210e9 * 0.01**2 / 12 / 7850) / 0.2**2
    np.testing.assert_allclose(to_body(bar).eigenfrequencies(fixed=["node_101"], n=2), beam, rtol=0.02)


@pytest.mark.parametrize(
    ("kind", "change", "message"),
    [
        ("sti", lambda text: text[:-40], "no end"),
        ("mas", lambda text: text[: text.rindex("18 18")], "not an entry on the diagonal"),
        ("mas", lambda text: text.replace("18 18", "18 19"), "from 1 to 18"),
        ("mas", lambda text: text + "0 7 1e3\n", "from 1 to 18"),
        ("mas", lambda text: text + "7 0 1e3\n", "from 1 to 18"),
        ("mas", lambda text: "\n", "from 1 to 18|is empty"),
        ("dof", lambda text: "hello\n", "not a list of node.component"),
        ("dof", lambda text: text.replace("202.3", "203.3"), "no row for node 201, component 6"),
        ("sti", lambda text: "1 2\n", "not lines of row, column and value"),
        ("sti", lambda text: text + "2 1 1e3\n", "row 1 and column 2 is there twice"),
        ("mas", lambda text: text + "7 7 1e3\n", "row 7 and column 7 is there twice"),
    ],
)
def test_bad_calculix_files_are_refused(kind, change, message, tmp_path):
    stored(tmp_path)
    path = tmp_path / f"job.{kind}"
    path.write_text(change(path.read_text()))
    with pytest.raises(ValueError, match=message) as caught:
        read_calculix(tmp_path / "job.sti", **STORED)
    assert f"job.{kind}" in str(caught.value)
    stored(tmp_path)
    for n_modes in (6, 2.5):
        with pytest.raises(ValueError, match=f"n_modes must be a whole number from 0 to 5, got {n_modes}"):
            read_calculix(tmp_path / "job.sti", n_modes=n_modes, **STORED)


@pytest.mark.slow
@pytest.mark.skipif(calculix.PROGRAM is None, reason="CalculiX is not installed (Debian: calculix-ccx)")
def test_calculix_and_nassim_reduce_one_mesh_alike(tmp_path):
    """Six elastic frequencies, free and held. On coarser meshes, the programs' integration rules differ by more.

    The text of CalculiX's own substructure is read too. Version 2.20 does not condense it: it is the interface's part
    of the complete matrix.
    """
    solid = make_bar(coupling="rbe2")
    model = meshed(generate_mesh(solid, element_size=0.005), solid, 2)
    storage = "*STEP\n*FREQUENCY, SOLVER=MATRIXSTORAGE\n4\n*END STEP"
    positions, rotation_nodes = calculix.run_with_rigid_faces(model, tmp_path, storage)
    options = {"units": "m-N-kg", "positions": positions, "names": ["left", "right"]}
    read = read_calculix(tmp_path / "model.sti", rotation_nodes=rotation_nodes, **options)
    assert check(read).verdict == "ok"
    body, expected = to_body(read), craig_bampton(model, n_modes=6, progress=False)
    for fixed, rigid in (([], 6), (["left"], 0)):
        found, own = (reduced.eigenfrequencies(fixed=fixed, n=rigid + 6)[rigid:] for reduced in (body, expected))
        np.testing.assert_allclose(found, own, rtol=1e-4)

    retained = "\n".join(f"{node}, 1, 3" for pair in rotation_nodes.items() for node in pair)
    output = "*SUBSTRUCTURE MATRIX OUTPUT, FILE NAME=sub, OUTPUT FILE=USER DEFINED"
    substructure = f"*STEP\n*SUBSTRUCTURE GENERATE\n*RETAINED NODAL DOFS\n{retained}\n{output}\n*END STEP"
    calculix.run_with_rigid_faces(model, tmp_path, substructure)
    with pytest.raises(ValueError, match=r"TYPE=MASS .CalculiX writes none: see read_calculix"):
        read_superelement(tmp_path / "sub.mtx", **options)
    text = (tmp_path / "sub.mtx").read_text()
    (tmp_path / "both.mtx").write_text(text + text[text.index("*MATRIX") :].replace("STIFFNESS", "MASS"))
    dofs = [(node, k) for node in positions for k in range(1, 7)]
    parsed = read_superelement(tmp_path / "both.mtx", dofs=dofs, **options).stiffness_matrix
    rows = (tmp_path / "model.dof").read_text().split()
    place = [1 + rows.index(f"{node + k // 3}.{k % 3 + 1}") for node in positions for k in range(6)]
    entries = np.loadtxt(tmp_path / "model.sti")
    complete = {(int(i), int(j)): value for i, j, value in entries}
    block = [[complete.get((min(i, j), max(i, j)), 0.0) for j in place] for i in place]
    np.testing.assert_allclose(parsed, block, rtol=1e-9, atol=1e-9 * np.abs(parsed).max())
