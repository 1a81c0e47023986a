"""Lines of long records, so close together that neighbours say nearly the same, without what they say twice.

Within a cell of neighbouring lines, narrow beside its distance from all poles, what the input drives and what motion
before and after the record leaves are polynomials: their values at a few nodes fix them at all lines. A cell's fit to
n lines is then one to as many numbers as nodes determine, by a QR decomposition that is made once: what remains of the
responses no pole explains. Nothing is averaged and no line left out; near a pole cells are small, far away wide.
"""

from dataclasses import dataclass

import numpy as np
import scipy

from nassim.base.checks import Array
from nassim.identification.spectral_lines import Lines

MANY = 20_000
"""Lines of a record from which on they are compressed."""
NODES = 14
DISTANCE = 4.0
"""Least distance of poles from a cell's middle, in half-widths: with 14 nodes some 5e-13 of what they give are lost."""
WIDEST = 20_000
"""Most lines of a cell."""


@dataclass(frozen=True)
class Cell:
    """Neighbouring lines and what fits need of them.

    lines: which; omega: of the nodes, (nodes,) [rad/s]; shares: of the nodes' values in each line, (lines, nodes)
    taken: of the driven values and of the others at the nodes, (rows, 2 nodes); responses: (rows, outputs)
    """

    lines: slice
    omega: Array
    shares: Array
    taken: Array
    responses: Array

    @classmethod
    def of(cls, lines: Lines, place: slice) -> "Cell":
        """Lines at a place, compressed where they are more than what nodes determine."""
        omega, responses = lines.omega[place], lines.responses[:, place].T
        if len(omega) <= 2 * NODES:
            nodes, shares = omega, np.eye(len(omega))
        else:
            middle, half = (omega[-1] + omega[0]) / 2, (omega[-1] - omega[0]) / 2
            x = np.cos(np.pi * (np.arange(NODES) + 0.5) / NODES)
            nodes = middle + half * x
            # Lagrange's polynomials of Chebyshev's nodes, by the orthogonality of Chebyshev's polynomials there.
            to_nodes = 2 / NODES * np.polynomial.chebyshev.chebvander(x, NODES - 1)
            to_nodes[:, 0] /= 2
            shares = np.polynomial.chebyshev.chebvander((omega - middle) / half, NODES - 1) @ to_nodes.T
        seen = np.hstack([lines.excitation[place, None] * shares, shares, responses])
        if len(omega) > 2 * NODES:
            seen = np.asarray(np.linalg.qr(seen, mode="r"))[: 2 * NODES]
        return cls(place, nodes, shares, seen[:, : 2 * len(nodes)], seen[:, 2 * len(nodes) :])


@dataclass(frozen=True, kw_only=True)
class CompressedLines(Lines):
    """Lines whose omega are those of all cells' nodes, and whose responses and columns are compressed.

    of_driven, of_left: from values at the nodes to the columns, sparse (rows, nodes); middle: the line in the middle of
    a row's cell, (rows,); whole: the lines that they stand for
    """

    cells: tuple[Cell, ...]
    of_driven: scipy.sparse.csr_matrix
    of_left: scipy.sparse.csr_matrix
    middle: Array
    whole: Lines

    def seen(self, driven: Array, left: Array) -> Array:
        """Columns of both, compressed."""
        return np.concatenate([self.of_driven @ driven, self.of_left @ left], axis=1)

    def weights(self, weights: Array) -> Array:
        """Weights of the rows, (outputs, rows), of those of all lines, (outputs, n), which hardly change in a cell."""
        return weights[:, self.middle]

    def modelled(self, poles: Array, values: Array) -> Array:
        """The responses of the model at all lines, (outputs, n)."""
        driven = self.driven(poles)
        split = driven.shape[1]
        driven, left = driven @ values[:, :split].T, self.left(poles) @ values[:, split:].T
        result, start = np.empty_like(self.whole.responses), 0
        for cell in self.cells:
            here = slice(start, start := start + len(cell.omega))
            excitation = self.whole.excitation[cell.lines, None]
            result[:, cell.lines] = (excitation * (cell.shares @ driven[here]) + cell.shares @ left[here]).T
        return result


def compressed(lines: Lines, poles: Array) -> Lines:
    """Lines for fits of poles near those given, (R, 2), frequency [Hz] and damping ratio; few lines as they are."""
    if len(lines.omega) < MANY or not lines.transient:
        return lines
    omega, ratio = 2 * np.pi * poles[:, 0], poles[:, 1]
    # What a record's drift and the powers of s leave changes at rest, as a pole there.
    singular = np.append(omega * (1j * np.sqrt(1 - ratio**2) - ratio), 0.0)
    known, cells, waiting = lines.known, [], [slice(0, len(lines.omega))]
    while waiting:
        place = waiting.pop()
        first, last = lines.omega[place.start], lines.omega[place.stop - 1]
        far = np.abs(singular - 0.5j * (first + last)).min() >= DISTANCE * (last - first) / 2
        n = place.stop - place.start
        if n <= 2 * NODES or (far and n <= WIDEST):
            key = place.start, place.stop
            cells.append(known[key] if key in known else Cell.of(lines, place))
        else:
            half = place.start + n // 2
            waiting += [slice(half, place.stop), slice(place.start, half)]
    known.clear()
    known.update({(cell.lines.start, cell.lines.stop): cell for cell in cells})
    return _joined(lines, tuple(cells))


def _joined(lines: Lines, cells: tuple[Cell, ...]) -> CompressedLines:
    halves = (
        scipy.sparse.block_diag([np.split(cell.taken, 2, axis=1)[k] for cell in cells], format="csr") for k in range(2)
    )
    of_driven, of_left = halves
    middles = [np.full(len(cell.taken), (cell.lines.start + cell.lines.stop) // 2) for cell in cells]
    return CompressedLines(
        omega=np.concatenate([cell.omega for cell in cells]),
        excitation=np.ones(sum(len(cell.omega) for cell in cells), dtype=complex),
        responses=np.concatenate([cell.responses for cell in cells]).T,
        time_step=lines.time_step,
        transient=True,
        hold_order=lines.hold_order,
        residual_powers=lines.residual_powers,
        cells=cells,
        of_driven=of_driven,
        of_left=of_left,
        middle=np.concatenate(middles),
        whole=lines,
    )
