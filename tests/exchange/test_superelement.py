"""Reading superelements: listings in all their variations, .mat and .npz files, units, orientations."""

import io
import zipfile
from dataclasses import replace

import numpy as np
import pytest
import scipy.io
import scipy.sparse
from conftest import assert_limit
from scipy.spatial.transform import Rotation
from superelements import DOFS, SAMPLE, master_text, matrix_text, node_text, sample

from nassim.exchange import mat_npz
from nassim.exchange.ansys import nodal_frame, parse_listings
from nassim.exchange.inspection import check
from nassim.exchange.mat_npz import read_arrays
from nassim.exchange.superelement_writers import write_superelement
from nassim.exchange.superelements import Superelement, read_superelement, significant_digits, superelement
from nassim.exchange.unit_systems import unit_factors


@pytest.fixture(scope="module")
def raw():
    """The sample's matrices as listed, mm-N-t, and its positions [mm]."""
    found = sample()
    return (
        read_superelement(*sorted(SAMPLE.glob("*.txt"))).stiffness_matrix,
        read_superelement(*sorted(SAMPLE.glob("*.txt"))).mass_matrix,
        1e3 * found.positions,
    )


def read_texts(folder, *texts, units="mm-N-t", **options):
    paths = []
    for k, text in enumerate(texts):
        paths.append(folder / f"part{k}.txt")
        paths[-1].write_text(text)
    return read_superelement(*paths, units=units, **options)


def test_the_sample_beam():
    body = sample()
    assert body.names == ("node_1001", "node_1029", "node_1113")
    assert np.allclose(body.positions, [[0, 0, 0], [0.1, 0, 0], [0.4, 0, 0]])
    assert (body.n_modes, body.digits, body.units) == (4, 4, "mm-N-t")
    report = check(body)
    assert report["mass"].figures["kg"] == pytest.approx(0.7536, rel=1e-4)
    assert not report.faults


BANNER = (
    "\n ***** ANSYS - ENGINEERING ANALYSIS SYSTEM  RELEASE 19.2 *****\n"
    " 00123456 VERSION=LINUX x64 10:11:12 CP= 1.234\n\n"
)
ONE_LINE = {"row_end": " "}
VARIATIONS = {
    "as the sample": {},
    "another title": {"matrix": {"title": "SUB_{}"}},
    "no blanks": {"matrix": {"entry": "[{:d},{:d}]:{:.3e}", "between": ""}},
    "many blanks": {"matrix": {"entry": "[ {:4d} , {:4d} ] : {:12.3e}"}},
    "Fortran exponents": {"matrix": {"entry": "[{:3d},{:3d}]:{:10.3e}", "exponent": "D"}},
    "all on one line": {"matrix": {"row_end": ""}, "nodes": ONE_LINE, "masters": ONE_LINE},
    "Windows line ends": {"matrix": {"row_end": "\r\n"}, "nodes": {"row_end": "\r\n"}, "masters": {"row_end": "\r\n"}},
    "banners": {"matrix": {"banner": BANNER}},
    "no rotations": {"nodes": {"rotations": False}},
    "headings everywhere": {"nodes": {"heading_every": 1}, "masters": {"heading_every": 1}},
    "only master nodes": {"nodes": {"others": False}},
}


@pytest.mark.parametrize("order", ["K M nodes masters", "masters nodes M K", "in one file"])
@pytest.mark.parametrize("variation", VARIATIONS)
def test_listings_vary(variation, order, raw, tmp_path):
    stiffness, mass, positions = raw
    options = VARIATIONS[variation]
    style = dict(options.get("matrix", {}))
    title, exponent = style.pop("title", "MAT_{}"), style.pop("exponent", "e")
    texts = {
        letter: matrix_text(matrix, title=title.format(letter), **style).replace("e", exponent)
        for letter, matrix in (("K", stiffness), ("M", mass))
    }
    texts["nodes"] = node_text(positions, **options.get("nodes", {}))
    texts["masters"] = master_text(3, **options.get("masters", {}))
    if order == "in one file":
        body = read_texts(tmp_path, "\n".join(texts.values()))
    else:
        body = read_texts(tmp_path, *(texts[name] for name in order.split()))
    expected = sample()
    assert body.names == ("node_11", "node_12", "node_13")
    assert np.array_equal(body.stiffness_matrix, expected.stiffness_matrix)
    assert np.array_equal(body.mass_matrix, expected.mass_matrix)
    assert np.allclose(body.positions, expected.positions, atol=1e-12)


def test_a_static_reduction_has_no_rows_but_its_masters(tmp_path):
    """Two nodes of six DoFs each; the matrices may be of no fewer rows, and of more only where modes follow."""
    stiffness, mass, positions = np.diag(np.arange(1.0, 13.0)), np.eye(12), np.array([[0.0, 0.0, 0.0], [1.0, 2.0, 3.0]])
    texts = [matrix_text(stiffness), matrix_text(mass, title="MAT_M"), node_text(positions)]
    read = read_texts(tmp_path, *texts, master_text(2), units="m-N-kg")
    assert read.n_modes == 0
    np.testing.assert_array_equal(read.stiffness_matrix, stiffness)
    texts = [matrix_text(stiffness[:11, :11]), matrix_text(mass[:11, :11], title="MAT_M"), node_text(positions)]
    with pytest.raises(ValueError, match="12 master DoFs, but matrices of 11 x 11"):
        read_texts(tmp_path, *texts, master_text(2), units="m-N-kg")


@pytest.mark.parametrize("letter", "Dd")
def test_exponents_of_fortran_are_read_in_capitals_or_not(letter):
    """In matrices and in coordinates of nodes."""
    text = "MAT_K:\n[1,1]: 1.5D+03\nMAT_M:\n[1,1]: 2.5D-03\nNODE X Y Z\n7 1.0D-01 2.0 -3.0D+02\n"
    listing = parse_listings({"a": text.replace("D+", f"{letter}+").replace("D-", f"{letter}-")})
    assert (listing.matrices["K"].item(), listing.matrices["M"].item()) == (1500.0, 0.0025)
    assert listing.nodes[7].tolist() == [0.1, 2.0, -300.0]


def test_the_master_table_says_which_row_is_which(raw, tmp_path):
    """A table with rotations first: rows are sorted by it."""
    stiffness, mass, positions = raw
    order = np.concatenate([np.arange(18).reshape(3, 2, 3)[:, ::-1].ravel(), np.arange(18, 22)])
    block = np.ix_(order, order)
    body = read_texts(
        tmp_path,
        matrix_text(stiffness[block]),
        matrix_text(mass[block], title="MAT_M"),
        node_text(positions),
        master_text(3, dofs=DOFS[3:] + DOFS[:3]),
    )
    assert np.array_equal(body.stiffness_matrix, sample().stiffness_matrix)


def test_one_triangle_is_enough(raw, tmp_path):
    """Nodes that are listed twice at one place count once."""
    stiffness, mass, positions = raw
    upper = "MAT_K:\n" + "".join(f"[{i + 1},{j + 1}]: {stiffness[i, j]:.3e}\n" for i in range(22) for j in range(i, 22))
    nodes = 2 * node_text(positions)
    body = read_texts(tmp_path, upper, matrix_text(mass, title="MAT_M"), nodes, master_text(3))
    assert np.array_equal(body.stiffness_matrix, sample().stiffness_matrix)


@pytest.mark.parametrize("triangle", [np.asarray, np.tril])
def test_listings_may_have_nonzero_entries_alone(raw, tmp_path, triangle):
    stiffness, mass, positions = raw
    listed = [
        f"MAT_{letter}:\n" + "".join(f"[{i + 1},{j + 1}]: {part[i, j]:.3e}\n" for i, j in np.argwhere(part))
        for letter, part in (("K", triangle(stiffness)), ("M", triangle(mass)))
    ]
    body = read_texts(tmp_path, *listed, node_text(positions), master_text(3))
    assert np.array_equal(body.stiffness_matrix, sample().stiffness_matrix)
    assert np.array_equal(body.mass_matrix, sample().mass_matrix)
    cut = listed[0][: listed[0].index("[9,9]")]
    with pytest.raises(ValueError, match=r"K is cut: of \d+ x \d+|K has 8 rows"):
        read_texts(tmp_path, cut, listed[1], node_text(positions), master_text(3))


def test_an_entry_that_only_one_half_of_a_listing_has_is_missing():
    matrix = np.arange(1.0, 10.0).reshape(3, 3) + np.arange(1.0, 10.0).reshape(3, 3).T
    entries = [f"[{i + 1},{j + 1}]: {matrix[i, j]}\n" for i, j in np.ndindex(3, 3)]
    for lost, i, j in ((3, 2, 1), (5, 2, 3)):
        listed = "".join(entries[:lost] + entries[lost + 1 :])
        with pytest.raises(ValueError, match=rf"K is cut: of 3 x 3 entries 1 are missing, the first is \[{i}, {j}\]"):
            parse_listings({"a": f"MAT_K:\n{listed}MAT_M:\n{''.join(entries)}"})


def test_nodal_frames_are_turned_back(raw, tmp_path):
    """A node whose frame is turned by 30 deg about z: the listing's angles bring its rows into the body's axes."""
    stiffness, mass, positions = raw
    turn = nodal_frame(np.array([30.0, 0, 0]))
    assert turn @ [1, 0, 0] == pytest.approx([np.cos(np.pi / 6), 0.5, 0])
    change = np.eye(22)
    change[6:9, 6:9] = change[9:12, 9:12] = turn  # body from node
    full = {"entry": "[{:3d},{:3d}]:{:25.16e}"}
    body = read_texts(
        tmp_path,
        matrix_text(change.T @ stiffness @ change, **full),
        matrix_text(change.T @ mass @ change, title="MAT_M", **full),
        node_text(positions, turned={12: 30.0}),
        master_text(3),
    )
    assert np.allclose(body.stiffness_matrix, sample().stiffness_matrix, rtol=1e-12, atol=1e-3)
    by_hand = superelement(
        change.T @ stiffness @ change, mass, positions, units="mm-N-t", orientations=[np.eye(3), turn, np.eye(3)]
    )
    assert np.allclose(by_hand.stiffness_matrix, sample().stiffness_matrix, rtol=1e-12, atol=1e-3)


def test_rows_and_places_that_listings_lack_are_given(raw, tmp_path):
    stiffness, mass, positions = raw
    texts = matrix_text(stiffness), matrix_text(mass, title="MAT_M"), node_text(positions)
    given = read_texts(tmp_path, *texts, master_text(3))
    rows = [(node, k) for node in (11, 12, 13) for k in range(1, 7)]
    rows += [(100 + k, 0) for k in range(len(mass) - 18)]
    found = read_texts(tmp_path, *texts, dofs=rows, positions={11: (1, 2, 3)})
    np.testing.assert_array_equal(found.stiffness_matrix, given.stiffness_matrix)
    np.testing.assert_allclose(found.positions, np.vstack([[1e-3, 2e-3, 3e-3], given.positions[1:]]))


def test_masters_in_any_order_keep_their_places_frames_and_names(raw, tmp_path):
    """Nodes 13, 11, 12 in the rows of the matrices, each turned about all three axes; the table of nodes ascends."""
    stiffness, mass, positions = raw
    order, angles = [2, 0, 1], np.array([[10.0, -20.0, 35.0], [50.0, 15.0, -5.0], [-70.0, 40.0, 25.0]])
    rows = np.concatenate([np.concatenate([np.arange(6) + 6 * k for k in order]), np.arange(18, 22)])
    change = np.eye(22)
    for k, angle in enumerate(angles):
        turn = Rotation.from_euler("ZXY", angle, degrees=True).as_matrix()
        change[6 * k : 6 * k + 6, 6 * k : 6 * k + 6] = np.kron(np.eye(2), turn)  # body from node
    listed = [(change.T @ matrix @ change)[np.ix_(rows, rows)] for matrix in (stiffness, mass)]
    nodes = "  NODE        X             Y             Z           THXY     THYZ     THZX\n" + "".join(
        f"{11 + k} " + " ".join(f"{value:.6f}" for value in (*positions[k], *angles[k])) + "\n" for k in range(3)
    )
    masters = " NODE DOF\n" + "".join(f"{11 + k} {dof}\n" for k in order for dof in DOFS)
    full = {"entry": "[{:3d},{:3d}]:{:25.16e}"}
    body = read_texts(
        tmp_path, matrix_text(listed[0], **full), matrix_text(listed[1], title="MAT_M", **full), nodes, masters
    )
    assert body.names == ("node_13", "node_11", "node_12")
    np.testing.assert_allclose(body.positions, 1e-3 * positions[order], atol=1e-9)
    block = np.ix_(rows, rows)
    for found, expected in (
        (body.stiffness_matrix, sample().stiffness_matrix),
        (body.mass_matrix, sample().mass_matrix),
    ):
        np.testing.assert_allclose(found, expected[block], rtol=0, atol=1e-12 * np.abs(expected).max())


def test_nodal_frames_turn_about_z_then_x_then_y():
    turn = nodal_frame(np.array([90.0, 90.0, 0]))
    # After 90 deg about z the new x points along y; turning about it brings z to x.
    assert np.allclose(turn @ np.eye(3), [[0, 0, 1], [1, 0, 0], [0, 1, 0]], atol=1e-15)


BAD_LISTINGS = {
    "binary": (lambda t: "\0" + t["K"], r"part0.txt: binary data, not a text listing"),
    "cut": (
        lambda t: t["K"][: t["K"].index("[ 17,")],
        r"part0.txt, line \d+: K is cut: of 22 x 22 entries 132 are missing, the first is \[17, 1\]",
    ),
    "no number": (
        lambda t: t["K"].replace(" 5.040e+05", " 5.04x+05", 1),
        r"part0.txt, line 3: .*'5.04x\+05', not a number",
    ),
    "nan": (lambda t: t["K"].replace(" 5.040e+05", " nan", 1), r"part0.txt, line 3: .*not a number"),
    "broken bracket": (lambda t: t["K"].replace("[  2,  1]", "[  2;  1]"), "part0.txt, line 4: '.' begins no entry"),
    "twice": (lambda t: t["K"] + "[1, 1]: 7.0", r"part0.txt, line \d+: entry \[1, 1\] is there twice"),
    "large index": (lambda t: t["K"] + "[99999, 1]: 7.0", r"part0.txt, line \d+: entry .* run from 1 to"),
    "nothing": (lambda t: t["K"][: t["K"].index("[")], "part0.txt: the title of K is followed by no entry"),
    "no title": (lambda t: t["K"].replace("MAT_K", "K"), r"part0.txt, line 3: an entry before a title"),
}


@pytest.mark.parametrize("fault", BAD_LISTINGS)
def test_bad_matrices_are_named_by_file_line_and_cause(fault, raw, tmp_path):
    stiffness, mass, positions = raw
    change, message = BAD_LISTINGS[fault]
    texts = {"K": matrix_text(stiffness)}
    with pytest.raises(ValueError, match=message):
        read_texts(tmp_path, change(texts), matrix_text(mass, title="MAT_M"), node_text(positions), master_text(3))


BAD_TABLES = {
    "no masters": (node_text, lambda n: "", "no table of master DoFs"),
    "cut masters": (
        node_text,
        lambda n: master_text(n)[:-10],
        "node 13 lacks the components 6; .*: the list of rows is cut",
    ),
    "too many masters": (node_text, lambda n: master_text(4), "24 master DoFs, but matrices of 22 x 22"),
    "no coordinates": (
        lambda p: node_text(p[:2]),
        master_text,
        "no coordinates of 1 of 3 nodes, the first is 13: ",
    ),
    "a column too few": (
        lambda p: node_text(p).replace("     0.00     0.00\n", "     0.00\n", 1),
        master_text,
        r"line 3: node 11 has 5 numbers",
    ),
    "a number too large": (
        lambda p: node_text(p).replace("     0.00\n", "  1.0E999\n", 1),
        master_text,
        r"line 3: node 11 has 6 numbers",
    ),
    "two places": (lambda p: node_text(p) + node_text(p + 1), master_text, "node 11 is there twice"),
    "cylinder": (
        lambda p: node_text(p).replace("DSYS=      0", "DSYS=      1"),
        master_text,
        r"line \d+: coordinates in the system 1: list the nodes with DSYS,0",
    ),
}


@pytest.mark.parametrize("fault", BAD_TABLES)
def test_bad_tables_are_refused(fault, raw, tmp_path):
    stiffness, mass, positions = raw
    nodes, masters, message = BAD_TABLES[fault]
    with pytest.raises(ValueError, match=message):
        read_texts(tmp_path, matrix_text(stiffness), matrix_text(mass, title="MAT_M"), nodes(positions), masters(3))


def test_matrices_must_be_complete_and_of_one_size(raw, tmp_path):
    stiffness, mass, positions = raw
    tables = node_text(positions) + master_text(3)
    with pytest.raises(ValueError, match="no matrix with a title such as MAT_M"):
        read_texts(tmp_path, matrix_text(stiffness), tables)
    with pytest.raises(ValueError, match=r"K has 22 rows, M in .* has 18"):
        read_texts(tmp_path, matrix_text(stiffness), matrix_text(mass[:18, :18], title="MAT_M"), tables)
    with pytest.raises(ValueError, match="a second matrix K"):
        read_texts(tmp_path, matrix_text(stiffness), matrix_text(stiffness), tables)


@pytest.mark.parametrize(
    "options", [{}, {"do_compression": True}, {"format": "4"}], ids=["uncompressed", "compressed", "level 4"]
)
def test_mat_files_equal_scipys_reading(options, tmp_path):
    """An independent reader gives the same numbers."""
    body = sample()
    path = tmp_path / "body.mat"
    content = {"K": body.stiffness_matrix, "M": body.mass_matrix, "int_xyz": body.positions}
    if "format" not in options:
        content |= {
            "int_i": np.array([[1001], [1029], [1113]], dtype=np.int32),
            "more": {"a": 1},
            "cell": np.array([{}, 2]),
        }
    scipy.io.savemat(path, content, **options)
    read = read_superelement(path)
    reference = scipy.io.loadmat(path)
    assert np.array_equal(read.stiffness_matrix, reference["K"])
    assert np.array_equal(read.mass_matrix, reference["M"])
    assert np.array_equal(read.positions, reference["int_xyz"])
    assert read.names == (body.names if "format" not in options else ("node_1", "node_2", "node_3"))


def test_sparse_text_and_integers_in_mat_files(tmp_path):
    path = tmp_path / "a.mat"
    matrix = scipy.sparse.random(7, 5, 0.3, random_state=0, format="csc")
    content = {"s": matrix, "t": ["left", "right one"], "i": np.arange(-3, 3, dtype=np.int16), "e": [], "none": ""}
    scipy.io.savemat(path, content)
    found = read_arrays(path)
    assert np.array_equal(found["s"], matrix.toarray())
    assert found["t"].tolist() == ["left", "right one"]
    assert found["i"].ravel().tolist() == [-3, -2, -1, 0, 1, 2]
    assert found["e"].size == found["none"].size == 0


@pytest.mark.parametrize("compressed", [False, True])
def test_cells_of_text_in_mat_files_are_names(tmp_path, compressed):
    """As MATLAB's {'left', 'Füße', ...} is stored; cells of anything else are omitted."""
    body = sample()
    content = {"K": body.stiffness_matrix, "M": body.mass_matrix, "positions": body.positions}
    content |= {
        "names": np.array([["left", "Füße", "right end"]], dtype=object),
        "more": np.array(["a", 2], dtype=object),
    }
    scipy.io.savemat(tmp_path / "body.mat", content, do_compression=compressed)
    assert read_superelement(tmp_path / "body.mat").names == ("left", "Füße", "right end")
    assert "more" not in read_arrays(tmp_path / "body.mat")


KINDS = {"5": ("i1", "u1", "i2", "u2", "i4", "u4", "i8", "u8", "f4", "f8"), "4": ("u1", "i2", "u2", "i4", "f4", "f8")}


@pytest.mark.parametrize(("level", "kind"), [(level, kind) for level, kinds in KINDS.items() for kind in kinds])
def test_numbers_of_every_kind_in_mat_files(level, kind, tmp_path):
    """As SciPy writes them: the ends of each kind's range, which another kind would turn into something else."""
    limits = np.finfo(kind) if kind[0] == "f" else np.iinfo(kind)
    values = np.array([[limits.min, limits.max, 1], [2, 3, 4]], dtype=kind)
    scipy.io.savemat(tmp_path / "a.mat", {"v": values}, format=level)
    assert read_arrays(tmp_path / "a.mat")["v"].tolist() == values.tolist()


@pytest.mark.parametrize("ending", ["npz", "mat"])
def test_small_files_that_unpack_to_much_are_refused(tmp_path, ending, monkeypatch):
    monkeypatch.setattr(mat_npz, "LARGEST_TOTAL", 3 * 8 * 10000)
    path, zeros = tmp_path / f"bomb.{ending}", {name: np.zeros((100, 100)) for name in "abcd"}
    if ending == "npz":
        np.savez_compressed(path, **zeros)
    else:
        scipy.io.savemat(path, zeros, do_compression=True)
    with pytest.raises(ValueError, match=r"bomb\..*all variables up to 'd' hold more than"):
        read_arrays(path)
    monkeypatch.undo()
    assert list(read_arrays(path)) == list("abcd")


@pytest.mark.parametrize("kind", ["<f8", ">f8", "<f4", ">i2"])
@pytest.mark.parametrize("order", ["C", "F"])
def test_arrays_of_any_layout_are_read(order, kind, tmp_path):
    given = np.array([[1.0, 2.0, 3.0], [-4.0, 5.0, 6.0]])
    np.savez(tmp_path / "a.npz", a=np.array(given, kind, order=order))
    np.testing.assert_array_equal(read_arrays(tmp_path / "a.npz")["a"], given)


def test_names_of_variables_are_free(tmp_path):
    body = sample()
    path = tmp_path / "body.npz"
    np.savez(path, stiff=body.stiffness_matrix, M=body.mass_matrix, xyz=body.positions.T[:, :2], P=body.positions)
    with pytest.raises(ValueError, match=r"body.npz: no variable K or .* for K; it has stiff, M, xyz, P"):
        read_superelement(path)
    read = read_superelement(path, variables={"K": "stiff"}, names=["a", "b", "c"])
    assert read.names == ("a", "b", "c")
    # Columns instead of rows, as ReferenceLocations has them; two nodes then leave ten modal rows.
    assert read_superelement(path, variables={"K": "stiff", "positions": "xyz"}).n_modes == 10
    with pytest.raises(ValueError, match="unknown variable of a superelement 'Q'"):
        read_superelement(path, variables={"Q": "stiff"})
    (bulk,) = write_superelement(body, tmp_path / "body.pch", units="m-N-kg")
    with pytest.raises(ValueError, match="unknown matrix of a superelement 'Q'; known: K, M"):
        read_superelement(bulk, units="m-N-kg", variables={"Q": "KAAX"})
    with pytest.raises(ValueError, match="node names must be a list of them, got the text 'abc'"):
        read_superelement(path, variables={"K": "stiff"}, names="abc")


def test_bad_array_files_are_refused(tmp_path):
    body = sample()
    good = {"K": body.stiffness_matrix, "M": body.mass_matrix, "P": body.positions}

    def reading(**changes):
        np.savez(tmp_path / "body.npz", **(good | changes))
        return read_superelement(tmp_path / "body.npz")

    for changes, message in (
        ({"K": np.array([None, {}])}, "not real numbers"),
        ({"K": good["K"] + 1j}, "not real numbers"),
        ({"K": good["K"][:5]}, "stiffness matrix must have shape 22 x 22, got 5 x 22"),
        ({"M": good["M"][0]}, "mass matrix must have shape any x any, got 22"),
        ({"M": good["M"][:, :5]}, "mass matrix must have shape 22 x 22, got 22 x 5"),
        ({"M": np.nan * good["M"]}, "mass matrix holds .* NaN or infinite"),
        ({"P": np.zeros((2, 2))}, "positions must have shape any x 3, got 2 x 2"),
        ({"P": np.full((3, 3), np.nan)}, "positions holds 9 value"),
        ({"P": np.zeros((4, 3))}, "4 nodes have 24 DoFs, but the matrices only 22 rows"),
        ({"K": np.where(good["K"] == 0, np.nan, good["K"])}, "NaN or infinite"),
        ({"M": good["M"] * 1e50}, "the largest is 1e.40"),
    ):
        with pytest.raises(ValueError, match=message) as caught:
            reading(**changes)
        assert "body.npz" in str(caught.value)
    data = (tmp_path / "body.npz").read_bytes()
    (tmp_path / "cut.npz").write_bytes(data[: len(data) // 2])
    with pytest.raises(ValueError, match=r"cut\.npz: damaged or of another format"):
        read_superelement(tmp_path / "cut.npz")
    for start in (b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM", b"\x89HDF\r\n\x1a\n"):
        (tmp_path / "new.mat").write_bytes(start + bytes(512))
        with pytest.raises(ValueError, match=r"version 7\.3 .* '-v7'"):
            read_superelement(tmp_path / "new.mat")
    with pytest.raises(ValueError, match="cannot be read"):
        read_superelement(tmp_path / "nothing.mat")
    with pytest.raises(ValueError, match="stands alone"):
        read_superelement(tmp_path / "new.mat", tmp_path / "cut.npz")


def test_units_are_converted_once():
    """A spring and a mass: 1 N/mm is 1000 N/m, 1 t is 1000 kg, N mm is 1e-3 N m; frequencies stay."""
    stiffness, mass = np.eye(7), np.eye(7)
    body = superelement(stiffness, mass, [[1.0, 2.0, 3.0]], units="mm-N-t")
    assert np.diag(body.stiffness_matrix) == pytest.approx([1e3] * 3 + [1e-3] * 3 + [1.0])
    assert np.diag(body.mass_matrix) == pytest.approx([1e3] * 3 + [1e-3] * 3 + [1.0])
    assert body.positions[0] == pytest.approx([1e-3, 2e-3, 3e-3])
    inches = superelement(stiffness, mass, [[1.0, 0, 0]], units="in-lbf-slinch")
    assert inches.stiffness_matrix[0, 0] == pytest.approx(4.4482216152605 / 0.0254)
    assert np.diag(inches.stiffness_matrix) == pytest.approx(np.diag(inches.mass_matrix))
    for units in ("mm-N", "mm-N-stone", "furlong-N-kg"):
        with pytest.raises(ValueError, match="unit"):
            unit_factors(units)


def test_digits_are_counted():
    rng = np.random.default_rng(0)
    values = rng.normal(size=(9, 9)) * 10.0 ** rng.integers(-9, 9, (9, 9))
    for digits in (1, 3, 4, 5, 8):
        text = np.array([[float(f"{v:.{digits - 1}e}") for v in row] for row in values])
        assert significant_digits(text) == digits
        assert significant_digits(1e-3 * text) == digits
    # Those of the numbers that are finest: stiffnesses may be round by themselves.
    exact, round_ones = np.diag(np.full(6, np.pi)), np.diag(np.full(6, 3e4))
    assert superelement(round_ones, exact, np.zeros((1, 3))).digits == 16
    assert superelement(exact, round_ones, np.zeros((1, 3))).digits == 16
    assert significant_digits(values) == 16


def test_wrong_nouns_are_refused():
    for turn in (2 * np.eye(3), np.diag([1.0, 1.0, -1.0])):
        with pytest.raises(ValueError, match="orientations must be proper orthogonal"):
            superelement(np.eye(6), np.eye(6), np.zeros((1, 3)), orientations=[turn])
    with pytest.raises(ValueError, match=r"orientations holds 9 .*NaN or infinite"):
        superelement(np.eye(6), np.eye(6), np.zeros((1, 3)), orientations=[np.nan * np.eye(3)])
    with pytest.raises(ValueError, match="used more than once"):
        superelement(np.eye(12), np.eye(12), np.zeros((2, 3)), names=["a", "a"])
    with pytest.raises(ValueError, match="each of the 6 rows once"):
        superelement(np.eye(6), np.eye(6), np.zeros((1, 3))).reordered([0, 0, 1, 2, 3, 4])
    with pytest.raises(ValueError, match=r"1 node\(s\) with 2 name\(s\); at least one, a name each"):
        superelement(np.eye(12), np.eye(12), np.zeros((1, 3)), names=["a", "b"])
    with pytest.raises(ValueError, match="at least one"):
        read_superelement()


def test_big_endian_mat_files_are_read(tmp_path):
    """A level-4 and a level-5 variable written by hand in the other byte order."""
    path = tmp_path / "big.mat"
    path.write_bytes(np.array([1000, 2, 1, 0, 2], ">i4").tobytes() + b"v\x00" + np.array([1.5, -2.0], ">f8").tobytes())
    assert read_arrays(path)["v"].ravel().tolist() == [1.5, -2.0]
    body = io.BytesIO()
    flags = np.array([6, 8, 6, 0], ">u4").tobytes()
    size = np.array([5, 8, 1, 2], ">u4").tobytes()
    name = np.array([1, 1], ">u4").tobytes() + b"v" + bytes(7)
    numbers = np.array([9, 16], ">u4").tobytes() + np.array([1.5, -2.0], ">f8").tobytes()
    content = flags + size + name + numbers
    body.write(b"by hand".ljust(124) + b"\x01\x00MI" + np.array([14, len(content)], ">u4").tobytes() + content)
    path.write_bytes(body.getvalue())
    assert read_arrays(path)["v"].ravel().tolist() == [1.5, -2.0]
    assert scipy.io.loadmat(path)["v"].ravel().tolist() == [1.5, -2.0]
    letters = np.array([17, 4], ">u4").tobytes() + "µz".encode("utf-16-be").ljust(8, b"\0")
    content = np.array([6, 8, 4, 0], ">u4").tobytes() + size + name + letters
    path.write_bytes(b"by hand".ljust(124) + b"\x01\x00MI" + np.array([14, len(content)], ">u4").tobytes() + content)
    assert read_arrays(path)["v"].tolist() == ["µz"]


def test_every_argument_of_arrays_and_files_counts(raw, tmp_path):
    """Names, orientations and the source that is told, given or left to the file."""
    stiffness, mass, positions = raw
    turn = nodal_frame(np.array([30.0, 0, 0]))
    plain = superelement(stiffness, mass, positions)
    assert (plain.name, plain.names, plain.source) == ("superelement", ("node_1", "node_2", "node_3"), "arrays")
    given = superelement(stiffness, mass, positions, name="leg", names=["a", "b", "c"], source="mail of 3 May")
    assert (given.name, given.names, given.source) == ("leg", ("a", "b", "c"), "mail of 3 May")
    with pytest.raises(ValueError, match=r"mail of 3 May: positions"):
        superelement(stiffness, mass, positions[:, :2], source="mail of 3 May")
    path = tmp_path / "my part.npz"
    np.savez(path, K=stiffness, M=mass, P=positions, names=["p", "q", "r"], orientations=[turn] * 3)
    of_file, read = read_superelement(path), read_superelement(path, name="leg", names=["a", "b", "c"])
    assert (of_file.name, of_file.names) == ("my_part", ("p", "q", "r"))
    assert (read.name, read.names, read.source) == ("leg", ("a", "b", "c"), str(path))
    straight = read_superelement(path, orientations=[np.eye(3)] * 3)
    np.testing.assert_array_equal(straight.stiffness_matrix, plain.stiffness_matrix)
    block = of_file.stiffness_matrix[:3, :3]
    np.testing.assert_allclose(block, turn @ stiffness[:3, :3] @ turn.T, atol=1e-9 * np.abs(block).max())
    texts = [matrix_text(stiffness), matrix_text(mass, title="MAT_M"), node_text(positions, turned={11: 30.0})]
    listed, over = (
        read_texts(tmp_path, *texts, master_text(3), units="m-N-kg", **options)
        for options in ({}, {"orientations": [np.eye(3)] * 3, "names": ["a", "b", "c"], "name": "leg"})
    )
    assert np.abs(listed.stiffness_matrix - over.stiffness_matrix).max() > 0
    np.testing.assert_array_equal(over.stiffness_matrix, plain.stiffness_matrix)
    assert (listed.name, listed.names) == ("part0", ("node_11", "node_12", "node_13"))
    assert (over.name, over.names) == ("leg", ("a", "b", "c"))


def test_digits_are_counted_unless_they_are_told():
    sound = {"stiffness_matrix": np.eye(6) * 1.25, "mass_matrix": np.eye(6), "positions": np.zeros((1, 3))}
    counted, told = (Superelement("s", names=("a",), **sound, **options) for options in ({}, {"digits": 9}))
    assert (counted.digits, told.digits) == (3, 9)
    assert [check(body)["digits"].verdict for body in (counted, told)] == ["warning", "ok"]
    assert check(replace(told, digits=8))["digits"].verdict == "warning"


def lump(**change):
    arguments = {"stiffness_matrix": np.zeros((6, 6)), "mass_matrix": np.eye(6), "positions": np.zeros((1, 3))} | change
    return superelement(**arguments)


LIMITS = {
    "an orientation's rounding": (lambda x: lump(orientations=[(1 + 5e-7 * x) * np.eye(3)]), "orientations must be"),
    "a huge mass": (lambda x: lump(mass_matrix=1e40 * x * np.eye(6)), "mass matrix holds"),
    "a huge stiffness": (lambda x: lump(stiffness_matrix=1e40 * x * np.eye(6)), "stiffness matrix holds"),
    "a huge position": (lambda x: lump(positions=[[0, 1e40 * x, 0]]), "positions holds"),
    "many coordinates": (
        lambda x: lump(stiffness_matrix=np.zeros((round(1500 * x),) * 2), mass_matrix=np.eye(round(1500 * x))),
        "nassim takes up to 1500",
    ),
}


@pytest.mark.parametrize("case", LIMITS)
def test_limits_lie_where_they_should(case):
    assert_limit(*LIMITS[case])


def test_entries_below_1e_100_count_as_zero():
    stiffness = np.diag([0.9e-100, 1.1e-100, 1, 1, 1, 1])
    np.testing.assert_array_equal(np.diag(lump(stiffness_matrix=stiffness).stiffness_matrix)[:2], [0.0, 1.1e-100])


def element(kind, values, code="<f8", *, cut=0):
    """A tagged element of a .mat file of level 5."""
    data = np.array(values, code).tobytes()
    return np.array([kind, len(data)], "<u4").tobytes() + data[: len(data) - cut].ljust(-(-len(data) // 8) * 8, b"\0")


def matrix_element(flags, shape, *parts):
    head = element(6, [flags, 0], "<u4") + element(5, shape, "<i4") + element(1, [118], "u1")
    return element(14, np.frombuffer(head + b"".join(parts), "u1"), "u1")


NUMBERS, ROWS = element(9, [1.5, 2.5]), element(5, [0, 1], "<i4")
BAD_ELEMENTS = {
    "bytes left over": (matrix_element(6, [1, 2], NUMBERS) + b"abc", r"3 byte\(s\) left over"),
    "a part of five bytes in four": (np.array([1 | 5 << 16, 0], "<u4").tobytes(), "small element says it has 5 bytes"),
    "bytes that lack": (np.array([9, 16, 0, 0], "<u4").tobytes(), "an element needs 16 bytes at byte .*, 8 are left"),
    "complex": (matrix_element(6 | 1 << 11, [1, 2], NUMBERS, NUMBERS), "variable 'v' is complex"),
    "negative size": (matrix_element(6, [-1, -2], NUMBERS), r"negative size, \(-1, -2\)"),
    "other shape": (matrix_element(6, [2, 2], NUMBERS), r"shape \(2, 2\), which is not the length"),
    "no numbers": (matrix_element(6, [1, 2], element(99, [1.5, 2.5])), "data of kind 99, not numbers"),
    "columns of a sparse matrix": (
        matrix_element(5, [2, 2], ROWS, element(5, [0, 2, 1], "<i4"), NUMBERS), "column indices of the sparse matrix"
    ),
    "too few columns of a sparse matrix": (
        matrix_element(5, [2, 2], ROWS, element(5, [0, 2], "<i4"), NUMBERS), "column indices of the sparse matrix"
    ),
    "columns of a sparse matrix that begin late": (
        matrix_element(5, [2, 2], ROWS, element(5, [1, 1, 2], "<i4"), NUMBERS), "column indices of the sparse matrix"
    ),
    "more entries than numbers of a sparse matrix": (
        matrix_element(5, [2, 2], ROWS, element(5, [0, 1, 3], "<i4"), NUMBERS), "column indices of the sparse matrix"
    ),
    "one negative size": (matrix_element(6, [-1, 2], NUMBERS), r"negative size, \(-1, 2\)"),
    "rows of a sparse matrix": (
        matrix_element(5, [1, 2], ROWS, element(5, [0, 1, 2], "<i4"), NUMBERS), "row indices of the sparse matrix"
    ),
    "rows below the first of a sparse matrix": (
        matrix_element(5, [2, 2], element(5, [0, -1], "<i4"), element(5, [0, 1, 2], "<i4"), NUMBERS),
        "row indices of the sparse matrix",
    ),
    "fewer rows than entries of a sparse matrix": (
        matrix_element(5, [2, 2], element(5, [0], "<i4"), element(5, [0, 1, 2], "<i4"), NUMBERS),
        "row indices of the sparse matrix",
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", BAD_ELEMENTS)
def test_bad_elements_of_mat_files_are_refused(case, tmp_path):
    """Beside one that is read; text of numbers and elements without content are."""
    content, message = BAD_ELEMENTS[case]
    header, path = b"by hand".ljust(124) + b"\x00\x01IM", tmp_path / "a.mat"
    good = matrix_element(4, [1, 2], element(5, [104, 105], "<i4")) + element(14, [])
    path.write_bytes(header + good)
    assert {name: value.tolist() for name, value in read_arrays(path).items()} == {"v": ["hi"]}
    path.write_bytes(header + good + content)
    with pytest.raises(ValueError, match=message):
        read_arrays(path)


def test_spare_places_of_a_sparse_matrix_are_passed_over(tmp_path):
    """As MATLAB keeps them after entries have been cleared, beyond the last column's end."""
    rows, ends, numbers = element(5, [0, 1, 0], "<i4"), element(5, [0, 1, 2], "<i4"), element(9, [1.5, 2.5, 9.0])
    path = tmp_path / "a.mat"
    path.write_bytes(b"by hand".ljust(124) + b"\x00\x01IM" + matrix_element(5, [2, 2], rows, ends, numbers))
    assert read_arrays(path)["v"].tolist() == [[1.5, 0.0], [0.0, 2.5]]


def test_bad_variables_of_npz_and_of_level_4_are_refused(tmp_path):
    """Beside one that is read; other files in the same archive are passed over."""
    stream = io.BytesIO()
    np.save(stream, np.eye(2))
    data = stream.getvalue()
    for name, content, compression, message in (
        ("notes.txt", b"text", zipfile.ZIP_STORED, ""),
        ("a.npy", data, zipfile.ZIP_BZIP2, "variable 'a' is compressed in another way"),
        ("a.npy", data[:-8], zipfile.ZIP_STORED, r"variable 'a' says it has shape \(2, 2\), which is not the length"),
    ):
        with zipfile.ZipFile(tmp_path / "a.npz", "w") as archive:
            archive.writestr("K.npy", data)
            archive.writestr(name, content, compression)
        if message:
            with pytest.raises(ValueError, match=message):
                read_arrays(tmp_path / "a.npz")
        else:
            assert list(read_arrays(tmp_path / "a.npz")) == ["K"]
    values = np.array([1.5, -2.0, 0.5, 1.0], "<f8").tobytes()
    (tmp_path / "a.mat").write_bytes(np.array([0, 2, 1, 1, 2], "<i4").tobytes() + b"v\x00" + values)
    with pytest.raises(ValueError, match="variable 'v' is complex"):
        read_arrays(tmp_path / "a.mat")
    (tmp_path / "a.mat").write_bytes(np.array([0, 2, 1, 0, 0], "<i4").tobytes() + values)
    with pytest.raises(ValueError, match="name has 0 characters"):
        read_arrays(tmp_path / "a.mat")
    for code, *shape in ([0, 2, -1], [0, -1, 2], [100, 2, 1], [90, 2, 1]):
        (tmp_path / "a.mat").write_bytes(np.array([code, *shape, 0, 2], "<i4").tobytes() + b"v\x00" + values)
        with pytest.raises(ValueError, match="no variable of level 4 at byte 0"):
            read_arrays(tmp_path / "a.mat")
    (tmp_path / "a.mat").write_bytes(np.array([0, 5, 1, 0, 2], "<i4").tobytes() + b"v\x00" + values)
    with pytest.raises(ValueError, match="cut off: variable 'v' needs 40 bytes, 32 are left"):
        read_arrays(tmp_path / "a.mat")
