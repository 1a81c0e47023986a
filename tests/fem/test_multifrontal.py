"""Nested dissection of graphs and the factorisation by fronts, against closed forms and dense algebra."""

import numpy as np
import pytest
import scipy.sparse as sp
from scipy.sparse.csgraph import structural_rank

from nassim.fem import multifrontal
from nassim.fem.dissection import LARGEST_LEAF, _cover, borders, dissect
from nassim.fem.multifrontal import Factor


def path(n):
    return sp.diags([np.ones(n - 1), np.ones(n - 1)], offsets=[-1, 1]).tocsr()


def grid(m):
    """A square grid of m x m nodes, each connected to its neighbours along the axes."""
    return sp.kronsum(path(m), path(m)).tocsr()


GRAPHS = {
    "grid": grid(30),
    "two grids": sp.block_diag([grid(12), grid(15)], format="csr"),
    "nodes alone": sp.csr_matrix((200, 200)),
    "random": sp.random(400, 400, 0.004, "csr", random_state=1),
}


SIZES = (3, 30)
"""Unknowns of each node, with which cuts and minimum flows separate these graphs."""


def divided(graph, unknowns=3):
    return dissect(graph, np.full(graph.shape[0], unknowns))


def below(parts, k):
    """All nodes of a part and of those below it."""
    return np.concatenate([parts[k].nodes, *(below(parts, child) for child in parts[k].children)])


@pytest.mark.parametrize("unknowns", SIZES)
@pytest.mark.parametrize("name", GRAPHS)
def test_separators_leave_nothing_between_their_halves(name, unknowns):
    graph = GRAPHS[name]
    graph = (graph + graph.T - sp.diags(2 * graph.diagonal())).tocsr()
    graph.eliminate_zeros()
    parts = divided(graph, unknowns)
    assert np.array_equal(np.sort(np.concatenate([part.nodes for part in parts])), np.arange(graph.shape[0]))
    assert len(parts) > 1
    for part in parts:
        if len(part.children) == 2:
            first, second = (below(parts, child) for child in part.children)
            assert graph[first][:, second].nnz == 0
        if not part.children:
            assert unknowns * len(part.nodes) <= LARGEST_LEAF or len(part.nodes) == 1


def test_nodes_that_are_all_connected_are_one_part():
    for unknowns in SIZES:
        assert len(divided(sp.csr_matrix(np.ones((150, 150)) - np.eye(150)), unknowns)) == 1


def test_hub_that_all_nodes_touch_separates_them():
    star = sp.lil_matrix((500, 500))
    star[0, 1:] = star[1:, 0] = 1
    for unknowns in SIZES:
        assert [part.nodes.tolist() for part in divided(star.tocsr(), unknowns) if 0 in part.nodes] == [[0]]


def test_separator_of_a_grid_is_no_longer_than_its_side():
    """A cut along diagonals, as breadth-first search from a corner makes it, needs up to a side of m nodes."""
    for m in (20, 40):
        for unknowns in SIZES:
            assert len(divided(grid(m), unknowns)[-1].nodes) <= m


def test_separator_of_a_path_is_one_node():
    for unknowns in SIZES:
        assert all(len(part.nodes) == 1 for part in divided(path(500), unknowns) if part.children)


def test_separator_has_the_fewest_unknowns():
    """A strip of two nodes' width, in which one pair in the middle third has fewer unknowns than the others."""
    strip = sp.kronsum(path(2), path(200)).tocsr()
    unknowns = np.full(400, 9)
    pair = np.array([180, 181])
    unknowns[pair] = 8
    assert set(dissect(strip, unknowns)[-1].nodes) == set(pair)


def test_borders_are_the_fill_of_the_elimination():
    """The entries below a part's own columns in the dense factor of a matrix without cancellation."""
    graph = grid(12)
    parts = divided(graph)
    order = np.concatenate([part.nodes for part in parts])
    matrix = (8 * sp.eye(graph.shape[0]) - graph).toarray()[np.ix_(order, order)]
    lower, end = np.linalg.cholesky(matrix), 0
    for part, border in zip(parts, borders(graph, parts), strict=True):
        begin, end = end, end + len(part.nodes)
        filled = np.flatnonzero(np.any(np.abs(lower[end:, begin:end]) > 1e-14, axis=1)) + end
        assert np.array_equal(border, filled)


@pytest.mark.parametrize("smallest", [0, np.inf])
def test_factor_of_nodes_with_three_unknowns_each(smallest, monkeypatch):
    """Numbered x..., y..., z..., one of them fixed; against dense algebra, for one column and for several.

    With branches that threads share, and as one branch.
    """
    monkeypatch.setattr(multifrontal, "SMALL_BRANCH", smallest)
    rng = np.random.default_rng(0)
    scalar = 8 * sp.eye(225) - grid(15)
    kind = rng.standard_normal((3, 3))
    matrix = sp.kron(kind @ kind.T + np.eye(3), scalar).tocsr()
    kept = np.delete(np.arange(675), 300)
    matrix = matrix[kept][:, kept]
    free = np.arange(674) % 7 > 0
    for chosen in (np.ones(674, dtype=bool), free):
        factor = Factor(sp.tril(matrix, format="csr"), chosen)
        inner = matrix[chosen][:, chosen].toarray()
        for columns in (1, 5):
            rhs, expected = rng.standard_normal((674, columns)), np.zeros((674, columns))
            expected[chosen] = np.linalg.solve(inner, rhs[chosen])
            assert np.allclose(factor.solve(rhs), expected, rtol=1e-10, atol=1e-13)


def test_factor_does_not_depend_on_the_number_of_threads(monkeypatch):
    matrix = sp.tril(sp.kron(4.5 * sp.eye(900) - grid(30), np.diag([1.0, 2.0, 3.0])), format="csr")
    rhs = np.random.default_rng(1).standard_normal((2700, 3))
    monkeypatch.setattr(multifrontal, "SMALL_BRANCH", 1e4)
    found = []
    for count in ("1", "2", "5"):
        monkeypatch.setenv("NASSIM_THREADS", count)
        found.append(Factor(matrix).solve(rhs))
    assert np.array_equal(found[0], found[1])
    assert np.array_equal(found[0], found[2])


def test_matrix_without_unknowns():
    assert Factor(sp.csr_matrix((0, 0))).solve(np.zeros((0, 2))).shape == (0, 2)


def test_indefinite_matrix_raises():
    matrix = sp.csr_matrix(np.array([[1.0, 2.0], [2.0, 1.0]]))
    with pytest.raises(ArithmeticError, match="not positive definite"):
        Factor(sp.tril(matrix, format="csr"))


def test_cut_is_where_the_graph_is_thinnest():
    """Two grids of different size, joined by one connection."""
    graph = sp.block_diag([grid(14), grid(17)], format="lil")
    graph[195, 196] = graph[196, 195] = 1
    for unknowns in SIZES:
        assert len(divided(graph.tocsr(), unknowns)[-1].nodes) == 1


def test_separator_is_the_smallest_cover():
    """By Koenig's theorem it has as many nodes as the largest matching, which is the structural rank."""
    across = sp.random(60, 60, 0.03, "csr", random_state=2)
    first = np.arange(120) < 60
    cover = _cover(sp.bmat([[None, across], [across.T, None]], format="csr"), first)
    assert across[~cover[:60]][:, ~cover[60:]].nnz == 0
    assert np.count_nonzero(cover) == structural_rank(across)
