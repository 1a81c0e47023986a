"""Limits of what is read, and of what counts as right or repairable, a tenth below and above."""

import numpy as np
import pytest
import scipy.io
import scipy.sparse
from conftest import assert_limit
from superelements import matrix_text

from nassim.exchange import mat_npz
from nassim.exchange.abaqus import _dofs
from nassim.exchange.ansys import parse_listings
from nassim.exchange.inspection import check
from nassim.exchange.mat_npz import read_arrays, read_bytes
from nassim.exchange.nodal_matrices import matrix_from_entries
from nassim.exchange.node_positions import motions_without_stiffness, positions_from_motions
from nassim.exchange.repairing import Repair, repair
from nassim.exchange.superelements import superelement

MEGABYTE = 2**20
TEXTS = [matrix_text(np.eye(6), title=f"MAT_{letter}") for letter in "KM"]


class Long(str):
    """A text that says it has another length, as millions of characters would take long to search."""

    said = 0

    def __len__(self):
        return self.said


def listings(characters):
    """Two matrices in files of half as many characters each."""
    texts = {name: Long(text) for name, text in zip("ab", TEXTS, strict=True)}
    for text in texts.values():
        text.said = round(0.5 * characters)
    return parse_listings(texts)


def arrays(size):
    """Variables of half as many bytes each, in no memory."""
    return dict(mat_npz._within_total((name, np.broadcast_to(0.0, round(size / 16))) for name in "ab"))


def test_texts_may_have_sixty_four_million_characters():
    assert_limit(lambda x: listings(x * 64 * MEGABYTE), "a, b: more than 64 million characters")


def test_a_file_may_have_128_mb(tmp_path):
    def read(share):
        path = tmp_path / "large.bin"
        with path.open("wb") as file:
            file.truncate(round(share * 128 * MEGABYTE))
        return read_bytes(path)

    assert_limit(read, "larger than 128 MB")


def test_a_sparse_matrix_may_have_128_mb_when_it_is_full(tmp_path):
    def read(share):
        n = round(np.sqrt(share * 16 * MEGABYTE))
        scipy.io.savemat(tmp_path / "sparse.mat", {"K": scipy.sparse.csc_matrix((n, n))})
        return read_arrays(tmp_path / "sparse.mat")

    assert_limit(read, "variable 'K' unpacks to more than 128 MB")


def test_a_variable_may_have_128_mb_and_all_together_four_times_as_much():
    assert_limit(lambda x: mat_npz._limit("K", round(x * 128 * MEGABYTE)), "variable 'K' unpacks to more than 128 MB")
    mat_npz._limit("K", 128 * MEGABYTE)
    assert_limit(lambda x: arrays(x * 512 * MEGABYTE), "up to 'b' hold more than 512 MB")


def test_a_matrix_of_named_rows_may_have_1500():
    """As entries, and as components of a substructure's nodes."""

    def entries(share):
        dofs = [(k, 1) for k in range(round(1500 * share))]
        return matrix_from_entries("K", {(dof, dof): 1.0 for dof in dofs}, dofs)

    assert_limit(entries, "K: 1650 coordinates; nassim takes up to 1500")
    lines = [(1, "1, 2, 3, 4, 5, 6")]
    assert_limit(lambda x: _dofs("a.mtx", list(range(round(250 * x))), lines), "1650 coordinates; nassim takes up to")


def test_a_frequency_ratio_of_a_tenth_tells_rigid_motions():
    for share in (0.9, 1.1):
        stiffness = np.diag([0.0, 0, 0, 0, 0, (0.1 * share) ** 2, 1.0, 1.0])
        assert (motions_without_stiffness(stiffness, np.eye(8)) is None) == (share > 1)


def test_two_triangles_of_a_file_may_differ_by_a_millionth():
    """Of the root of both rows' diagonals, 2 and 50 here."""

    def read(share):
        entries = {((1, 1), (1, 1)): 2.0, ((1, 2), (1, 2)): 50.0}
        entries |= {((1, 1), (1, 2)): 3.0, ((1, 2), (1, 1)): 3.0 + share * 1e-5}
        return matrix_from_entries("K", entries, [(1, 1), (1, 2)])

    assert_limit(read, "K: entries .* differ: 3 and 3.00001")


@pytest.mark.parametrize("row", [1, 4])
def test_translations_and_rotations_of_nodes_differ_by_a_tenth(row):
    """Of the second node against the first in what should be rigid motions."""
    for share in (0.9, 1.1):
        motions = np.vstack([np.eye(6), np.eye(6)])
        motions[6 + row, row + 1] = 0.1 * share
        assert (positions_from_motions(motions, 2) is None) == (share > 1)


def test_one_node_is_damaged_where_the_others_have_a_hundredth_of_its_errors():
    """Two lumps in one place on springs between them, with weak ones to the ground: the rest follows from the other."""
    for share in (0.9, 1.1):
        stiffness = np.kron([[1.0 + 1e-6, -1.0], [-1.0, 1.0 + 1e-8 * share]], 1e6 * np.eye(6))
        (how,) = repair(superelement(stiffness, np.eye(12), np.zeros((2, 3)))).steps
        assert ("all of it in the rows of node_1" in how) == (share < 1)
        assert ("averaged over the body's mass" in how) == (share > 1)


def test_ten_frequencies_and_the_one_that_moved_most_are_told():
    lump = superelement(np.zeros((6, 6)), np.eye(6), np.zeros((1, 3)))
    before = np.arange(1.0, 15.0)
    moved = Repair(
        lump, (), check(lump), check(lump), before, before * (1 + 1e-3 * (before == 13.0) + 1e-5 * (before == 2.0))
    )
    told = [line for line in str(moved).splitlines() if "elastic (" in line]
    assert len(told) == 11
    assert "13 -> " in told[-1]
    assert "number 13 of 14: the largest change" in told[-1]
    assert str(moved).endswith("and 3 more elastic ones, which moved less")
