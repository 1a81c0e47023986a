"""Elimination order of a sparse symmetric matrix by nested dissection of its graph.

A small separator divides the graph in two halves without entries between them, and each half is divided again. When the
halves are eliminated before their separator, the factor remains sparse.

The nodes are ordered along the graph: by the difference of their distances from its two ends (breadth-first search),
smoothed by repeated averages over the neighbours, which approximate the slowest mode of the graph's Laplacian. The
separator between the first and the last nodes of this order is the one of fewest unknowns (a minimum cut, from a
maximum flow). In small parts, whose separators matter less, the graph is cut where the fewest nodes of one side touch
the other, and the separator is the smallest set of nodes that covers all entries across the cut (a minimum vertex
cover, by Koenig's theorem from a maximum matching).

Source: A. George, Nested dissection of a regular finite element mesh, SIAM J. Numer. Anal. 10 (1973) 345-363; A.
George, J. W. H. Liu, An automatic nested dissection algorithm for irregular finite element problems, SIAM J. Numer.
Anal. 15 (1978) 1053-1069; C. Ashcraft, J. W. H. Liu, Applications of the Dulmage-Mendelsohn decomposition and network
flow to graph bisection improvement, SIAM J. Matrix Anal. Appl. 19 (1998) 325-354.
"""

from dataclasses import dataclass, replace

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray
from scipy.sparse.csgraph import (
    breadth_first_order,
    connected_components,
    maximum_bipartite_matching,
    maximum_flow,
)

Indices = NDArray[np.int64]
Mask = NDArray[np.bool_]
LARGEST_LEAF = 200
"""Number of unknowns that are not divided."""
SMALL_PART = 2500
"""Number of unknowns up to which a maximum flow costs more time than its smaller separator saves."""
SMALLEST_SHARE = 0.35
"""Smallest share of the unknowns on one side of a cut; a freer cut costs more time than its smaller separator saves."""
AVERAGES = 20


@dataclass(frozen=True)
class GraphPart:
    """Nodes of a graph that are eliminated together: a separator, or a part that is not divided.

    Attributes:
        nodes: the nodes
        children: places, in the list of all parts, of the two parts between which this is the separator
    """

    nodes: Indices
    children: tuple[int, ...]


def dissect(graph: sp.csr_matrix, unknowns: Indices) -> list[GraphPart]:
    """Divide a graph by nested separators.

    Args:
        graph: a nonzero entry for each pair of nodes that are connected, symmetric, no diagonal, shape (n, n)
        unknowns: number of unknowns of each node, shape (n,)

    Returns:
        Parts in the order of elimination, each one after its children. Nodes of a separator that touch the same parts
        follow each other, so that the border of a part consists of few runs of consecutive nodes.
    """
    parts: list[GraphPart] = []

    def divide(nodes: Indices, graph: sp.csr_matrix, unknowns: Indices) -> int:
        children = []
        if unknowns.sum() > LARGEST_LEAF and len(nodes) > 1:
            first, separator = _separate(graph, unknowns)
            halves = [np.flatnonzero(half) for half in (first & ~separator, ~first & ~separator)]
            if len(halves[0]) and len(halves[1]):
                children = [divide(nodes[half], graph[half][:, half], unknowns[half]) for half in halves]
                nodes = nodes[separator]
        parts.append(GraphPart(nodes, tuple(children)))
        return len(parts) - 1

    if graph.shape[0]:
        divide(np.arange(graph.shape[0]), graph, unknowns)
    first = np.zeros(graph.shape[0], dtype=np.int64)
    connected = np.diff(graph.indptr) > 0
    if connected.any():
        first[connected] = np.minimum.reduceat(_places(parts)[graph.indices], graph.indptr[:-1][connected])
    return [replace(part, nodes=part.nodes[np.argsort(first[part.nodes], kind="stable")]) for part in parts]


def _places(parts: list[GraphPart]) -> Indices:
    """Return the place of each node in the order of elimination, shape (n,)."""
    return np.argsort(np.concatenate([np.zeros(0, dtype=np.int64), *(part.nodes for part in parts)]))


def borders(graph: sp.csr_matrix, parts: list[GraphPart]) -> list[Indices]:
    """Return the later nodes that each part is connected to once the earlier parts are eliminated.

    Nodes are counted in the order of elimination; each border is ascending.
    """
    place = _places(parts)
    ordered = graph[np.argsort(place)]
    neighbours = place[ordered.indices]
    result: list[Indices] = []
    begin = end = 0
    for part in parts:
        begin, end = end, end + len(part.nodes)
        own = neighbours[ordered.indptr[begin] : ordered.indptr[end]]
        reached = np.concatenate([own, *(result[child] for child in part.children)])
        result.append(np.unique(reached[reached >= end]))
    return result


def _separate(graph: sp.csr_matrix, unknowns: Indices) -> tuple[Mask, Mask]:
    """Return which nodes are on the first side of a cut, and which nodes are its separator, shape (n,)."""
    n = graph.shape[0]
    order = breadth_first_order(graph, 0, return_predecessors=False)
    if len(order) < n:
        _, piece = connected_components(graph, directed=False)
        ends = np.cumsum(np.bincount(piece))
        first = piece <= np.argmin(np.abs(ends[:-1] - n / 2))
        return first, np.zeros(n, dtype=bool)
    order = breadth_first_order(graph, order[-1], return_predecessors=False)
    if unknowns.sum() <= SMALL_PART:
        return _cut(graph, unknowns, order)
    position = np.empty(n)
    position[order] = np.arange(n)
    position[breadth_first_order(graph, order[-1], return_predecessors=False)] -= np.arange(n)
    share = 0.5 / np.diff(graph.indptr)
    for _ in range(AVERAGES):
        position = 0.5 * position + share * (graph @ position)
    order = np.argsort(position, kind="stable")
    sizes = np.cumsum(unknowns[order])
    first, last = np.zeros((2, n), dtype=bool)
    first[order[sizes <= SMALLEST_SHARE * sizes[-1]]] = True
    last[order[sizes > (1 - SMALLEST_SHARE) * sizes[-1]]] = True
    first, separator = _smallest_separator(graph, unknowns, first, last)
    if np.all(first | separator):  # every node on the other side touches the first side
        return _cut(graph, unknowns, order)
    return first, separator


def _cut(graph: sp.csr_matrix, unknowns: Indices, order: Indices) -> tuple[Mask, Mask]:
    """Return the first side and the separator of a cut between two nodes that follow each other in an order."""
    n = len(order)
    place = np.empty(n, dtype=np.int64)
    place[order] = np.arange(n)
    last = np.maximum.reduceat(place[graph.indices], graph.indptr[:-1])  # farthest neighbour of each node
    # A cut before place k crosses the connections of a node at a place below k to one at k or beyond.
    begins, ends = (np.bincount(places + 1, unknowns, n + 1) for places in (place, np.maximum(place, last)))
    crossing = np.cumsum(begins - ends)
    sizes = np.cumsum(unknowns[order])
    shares = SMALLEST_SHARE * sizes[-1], (1 - SMALLEST_SHARE) * sizes[-1]
    lowest, highest = np.searchsorted(sizes, shares) + 1
    first = place < lowest + np.argmin(crossing[lowest : max(highest, lowest + 1)])
    return first, _cover(graph, first)


def _smallest_separator(graph: sp.csr_matrix, unknowns: Indices, first: Mask, last: Mask) -> tuple[Mask, Mask]:
    """Return the first side and the separator of fewest unknowns between two sets of nodes.

    Every node between them is an edge of a network, with its unknowns as capacity, from its entry to its exit; entries
    are numbered 0 to m - 1, exits m to 2 m - 1.

    Args:
        graph: the graph
        unknowns: number of unknowns of each node, shape (n,)
        first: nodes that remain on the first side, shape (n,)
        last: nodes on the other side; those that touch the first side may become part of the separator
    """
    beside = (graph @ first.astype(float)) > 0
    last = last & ~beside
    between = np.flatnonzero(~first & ~last)
    m = len(between)
    number = np.full(len(first), -1)
    number[between] = np.arange(m)
    rows = np.repeat(np.arange(m), np.diff(graph.indptr)[between])
    columns = number[graph[between].indices]
    rows, columns = rows[columns >= 0], columns[columns >= 0]
    begins = np.flatnonzero(beside[between])
    ends = np.flatnonzero((graph @ last.astype(float))[between] > 0)
    source, sink = 2 * m, 2 * m + 1
    tails = np.concatenate([np.arange(m), rows + m, np.full(len(begins), source), ends + m])
    heads = np.concatenate([np.arange(m, 2 * m), columns, begins, np.full(len(ends), sink)])
    capacities = np.full(len(tails), np.iinfo(np.int32).max // 2, dtype=np.int32)
    capacities[:m] = unknowns[between]
    network = sp.csr_matrix((capacities, (tails, heads)), shape=(2 * m + 2, 2 * m + 2))
    left = network - maximum_flow(network, source, sink).flow
    left.eliminate_zeros()
    reached = np.zeros(2 * m + 2, dtype=bool)
    reached[breadth_first_order(left, source, return_predecessors=False)] = True
    separator = np.zeros_like(first)
    separator[between] = reached[:m] & ~reached[m : 2 * m]
    first = first.copy()
    first[between] = reached[m : 2 * m]
    return first, separator


def _cover(graph: sp.csr_matrix, first: Mask) -> Mask:
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
    return np.where(first, ~reached, reached)
