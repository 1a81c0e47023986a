"""Compression of closely spaced spectral lines of long records, without loss of information.

A cell is a group of neighbouring lines that is narrow compared with its distance from all poles. Within a cell, the
driven response and the transient terms of a record are smooth, so that values at a few Chebyshev nodes determine them
at all lines. The fit to n lines is then a fit to as many numbers as the nodes determine, by one QR decomposition per
cell; the remaining part of the responses cannot be explained by any pole. No lines are averaged or omitted. Cells are
small near a pole and wide far away.
"""

from dataclasses import dataclass

import numpy as np
import scipy

from nassim.base.checks import Array
from nassim.identification.spectral_lines import Lines

COMPRESSED_FROM = 20_000
"""Number of lines from which on a record is compressed."""
NODES = 14
DISTANCE = 4.0
"""Smallest distance of poles from the centre of a cell, in half-widths. With 14 nodes the error is some 5e-13."""
WIDEST = 20_000
"""Largest number of lines in a cell."""


@dataclass(frozen=True)
class Cell:
    """Compressed group of neighbouring lines.

    Attributes:
        lines: slice of the lines.
        omega: angular frequencies of the nodes, (nodes,) [rad/s].
        shares: interpolation weights of the nodes at each line, (lines, nodes).
        taken: compressed columns of the driven values and of the transient values at the nodes, (rows, 2 nodes).
        responses: compressed responses, (rows, outputs).
    """

    lines: slice
    omega: Array
    shares: Array
    taken: Array
    responses: Array

    @classmethod
    def of(cls, lines: Lines, place: slice) -> "Cell":
        """Compress the lines in a slice if they are more numerous than the numbers that nodes determine."""
        omega, responses = lines.omega[place], lines.responses[:, place].T
        if len(omega) <= 2 * NODES:
            nodes, shares = omega, np.eye(len(omega))
        else:
            middle, half = (omega[-1] + omega[0]) / 2, (omega[-1] - omega[0]) / 2
            x = np.cos(np.pi * (np.arange(NODES) + 0.5) / NODES)
            nodes = middle + half * x
            # The discrete orthogonality of Chebyshev polynomials gives the Lagrange polynomials of their nodes.
            to_nodes = 2 / NODES * np.polynomial.chebyshev.chebvander(x, NODES - 1)
            to_nodes[:, 0] /= 2
            shares = np.polynomial.chebyshev.chebvander((omega - middle) / half, NODES - 1) @ to_nodes.T
        seen = np.hstack([lines.excitation[place, None] * shares, shares, responses])
        if len(omega) > 2 * NODES:
            seen = np.asarray(np.linalg.qr(seen, mode="r"))[: 2 * NODES]
        return cls(place, nodes, shares, seen[:, : 2 * len(nodes)], seen[:, 2 * len(nodes) :])


@dataclass(frozen=True, kw_only=True)
class CompressedLines(Lines):
    """Spectral lines at the nodes of all cells, with compressed responses and columns.

    Attributes:
        cells: the cells.
        of_driven: matrix from driven values at the nodes to the columns, sparse, (rows, nodes).
        of_transient: matrix from transient values at the nodes to the columns, sparse, (rows, nodes).
        middle: index of the central line of each row's cell, (rows,).
        whole: the original lines.
    """

    cells: tuple[Cell, ...]
    of_driven: scipy.sparse.csr_array
    of_transient: scipy.sparse.csr_array
    middle: Array
    whole: Lines

    def joined_columns(self, driven: Array, left: Array) -> Array:
        """Return the compressed columns of driven and transient values."""
        return np.concatenate([self.of_driven @ driven, self.of_transient @ left], axis=1)

    def weights(self, weights: Array) -> Array:
        """Return the weights of the rows, (outputs, rows).

        Args:
            weights: weights of all lines, which are nearly constant in a cell, (outputs, n).
        """
        return weights[:, self.middle]

    def modelled(self, poles: Array, values: Array) -> Array:
        """Return the responses of the model at all lines, (outputs, n).

        Args:
            poles: frequency [Hz] and damping ratio [-], (R, 2).
            values: linear parameters, (outputs, m).
        """
        driven = self.driven_columns(poles)
        split = driven.shape[1]
        driven, left = driven @ values[:, :split].T, self.transient_columns(poles) @ values[:, split:].T
        result, start = np.empty_like(self.whole.responses), 0
        for cell in self.cells:
            here = slice(start, start := start + len(cell.omega))
            excitation = self.whole.excitation[cell.lines, None]
            result[:, cell.lines] = (excitation * (cell.shares @ driven[here]) + cell.shares @ left[here]).T
        return result


def compress_lines(lines: Lines, poles: Array) -> Lines:
    """Compress the lines of a long record for fits of poles near given ones; return other lines unchanged.

    Args:
        lines: the lines.
        poles: frequency [Hz] and damping ratio [-], (R, 2).

    Returns:
        Compressed lines; the given lines where they are few.
    """
    if len(lines.omega) < COMPRESSED_FROM or not lines.transient:
        return lines
    omega, ratio = 2 * np.pi * poles[:, 0], poles[:, 1]
    # The drift term of a record and the powers of s are singular at zero frequency, like a pole at s = 0.
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
    of_driven, of_transient = (
        scipy.sparse.block_diag([scipy.sparse.csr_array(np.split(c.taken, 2, axis=1)[k]) for c in cells], format="csr")
        for k in range(2)
    )
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
        of_transient=of_transient,
        middle=np.concatenate(middles),
        whole=lines,
    )
