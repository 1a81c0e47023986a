"""Elimination order of a sparse symmetric matrix by nested dissection of its graph.

A small separator divides the graph in two halves without entries between them, and each half is divided again. When the
halves are eliminated before their separator, the factor remains sparse. The nodes are ordered by their distance from a
node at the graph's end (breadth-first search). The cut is made where the fewest nodes of one side touch the other, and
the separator is the smallest set of nodes that covers all entries across it (a minimum vertex cover, by Koenig's
theorem from a maximum matching).

Source: A. George, Nested dissection of a regular finite element mesh, SIAM J. Numer. Anal. 10 (1973) 345-363; A.
George, J. W. H. Liu, An automatic nested dissection algorithm for irregular finite element problems, SIAM J. Numer.
Anal. 15 (1978) 1053-1069; C. Ashcraft, J. W. H. Liu, Applications of the Dulmage-Mendelsohn decomposition and network
flow to graph bisection improvement, SIAM J. Matrix Anal. Appl. 19 (1998) 325-354.
"""

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray
from scipy.sparse.csgraph import breadth_first_order, connected_components, maximum_bipartite_matching

Indices = NDArray[np.int64]
LARGEST_LEAF = 64
"""Number of nodes that are not divided."""
SMALLEST_SHARE = 0.35
"""Smallest share of the nodes on one side of a cut; a freer cut finds smaller separators."""


@dataclass(frozen=True)
class GraphPart:
    """Nodes of a graph that are eliminated together: a separator, or a part that is not divided.

    Attributes:
        nodes: the nodes
        children: places, in the list of all parts, of the two parts between which this is the separator
    """

    nodes: Indices
    children: tuple[int, ...]


def dissect(graph: sp.csr_matrix) -> list[GraphPart]:
    """Divide a graph by nested separators.

    Args:
        graph: a nonzero entry for each pair of nodes that are connected, symmetric, no diagonal, shape (n, n)

    Returns:
        Parts in the order of elimination, each one after its children.
    """
    parts: list[GraphPart] = []

    def divide(nodes: Indices, graph: sp.csr_matrix) -> int:
        children = []
        if len(nodes) > LARGEST_LEAF:
            first, separator = _separate(graph)
            for half in (first & ~separator, ~first & ~separator):
                chosen = np.flatnonzero(half)
                if len(chosen):
                    children.append(divide(nodes[chosen], graph[chosen][:, chosen]))
            nodes = nodes[separator]
        parts.append(GraphPart(nodes, tuple(children)))
        return len(parts) - 1

    if graph.shape[0]:
        divide(np.arange(graph.shape[0]), graph)
    return parts


def borders(graph: sp.csr_matrix, parts: list[GraphPart]) -> list[Indices]:
    """Return the later nodes that each part is connected to once the earlier parts are eliminated.

    Nodes are counted in the order of elimination; each border is ascending.
    """
    order = np.concatenate([np.zeros(0, np.int64), *(part.nodes for part in parts)])
    place = np.empty_like(order)
    place[order] = np.arange(len(order))
    ordered = graph[order]
    neighbours = place[ordered.indices]
    result: list[Indices] = []
    begin = end = 0
    for part in parts:
        begin, end = end, end + len(part.nodes)
        own = neighbours[ordered.indptr[begin] : ordered.indptr[end]]
        reached = np.concatenate([own, *(result[child] for child in part.children)])
        result.append(np.unique(reached[reached >= end]))
    return result


def _separate(graph: sp.csr_matrix) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Return which nodes are on the first side of a cut, and which nodes are its separator, shape (n,)."""
    n = graph.shape[0]
    order = breadth_first_order(graph, 0, return_predecessors=False)
    if len(order) < n:
        _, piece = connected_components(graph, directed=False)
        ends = np.cumsum(np.bincount(piece))
        first = piece <= np.argmin(np.abs(ends[:-1] - n / 2))
        return first, np.zeros(n, dtype=bool)
    order = breadth_first_order(graph, order[-1], return_predecessors=False)
    place = np.empty(n, dtype=np.int64)
    place[order] = np.arange(n)
    last = np.maximum.reduceat(place[graph.indices], graph.indptr[:-1])  # farthest neighbour of each node
    # A cut before place k crosses the connections of a node at a place below k to one at k or beyond.
    begins, ends = (np.bincount(places + 1, minlength=n + 1) for places in (place, np.maximum(place, last)))
    crossing = np.cumsum(begins - ends)
    lowest = int(SMALLEST_SHARE * n)
    first = place < lowest + np.argmin(crossing[lowest : n - lowest])
    return first, _cover(graph, first)


def _cover(graph: sp.csr_matrix, first: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return the fewest nodes that cover all connections between two sides, shape (n,)."""
    rows = np.repeat(np.arange(len(first)), np.diff(graph.indptr))
    across = first[rows] & ~first[graph.indices]
    rows, columns = rows[across], graph.indices[across]
    connections = sp.csr_matrix((np.ones(len(rows)), (rows, columns)), shape=graph.shape)
    match = maximum_bipartite_matching(connections, perm_type="column")
    matched = np.flatnonzero(match >= 0)
    # Alternating paths from unmatched nodes: to the second side by any connection, back by the matching.
    reached, count = first & (match < 0), -1
    while count < (count := int(np.count_nonzero(reached))):
        reached[columns[reached[rows]]] = True
        reached[matched[reached[match[matched]]]] = True
    result: NDArray[np.bool_] = np.where(first, ~reached, reached)
    return result
