"""Superelements: reduced matrices made elsewhere, as read, in SI units and nassim's order, before they are trusted."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import KW_ONLY, dataclass, field, replace
from pathlib import Path

import numpy as np
import scipy
from numpy.typing import ArrayLike

from nassim.base.checks import Array, finite_array, freeze, known, unique
from nassim.base.rigid_motion import rigid_motions
from nassim.exchange.ansys import LARGEST, Listing, nodal_frame, parse_listings, rows_by_node
from nassim.exchange.mat_npz import read_arrays, read_bytes
from nassim.exchange.unit_systems import unit_factors

VARIABLES = {
    "K": ("K", "K_red", "stiffness", "stiffness_matrix", "Kr"),
    "M": ("M", "M_red", "mass", "mass_matrix", "Mr"),
    "positions": ("P", "int_xyz", "positions", "origins", "ReferenceLocations", "interface_origins"),
    "names": ("names", "int_i"),
    "orientations": ("orientations",),
}
"""Names under which .mat and .npz files are searched for what a superelement needs."""
HUGE, TINY = 1e40, 1e-100
"""Numbers above the one are refused, below the other count as zero."""


@dataclass(frozen=True)
class Superelement:
    """Reduced matrices as somebody wrote them: r nodes with six DoFs each, then p modal coordinates.

    name: what files and reports call it
    stiffness_matrix, mass_matrix: (n, n) [SI], n = 6 r + p, in the body's axes; not necessarily symmetric, definite
        or right
    positions: of the nodes, (r, 3) [m]; names: of the nodes
    source: where it comes from, as text; units: of the source
    digits: significant digits of the source's numbers

    Raises ValueError for wrong shapes, fewer rows than the nodes need, and entries that are not finite or beyond 1e40.
    """

    name: str
    _: KW_ONLY
    stiffness_matrix: Array
    mass_matrix: Array
    positions: Array
    names: tuple[str, ...]
    source: str = "arrays"
    units: str = "m-N-kg"
    digits: int = field(default=0)

    def __post_init__(self) -> None:
        label = self.source
        mass = finite_array(f"{label}: mass matrix", self.mass_matrix, (None, None))
        n = len(mass)
        if n > LARGEST:
            raise ValueError(f"{label}: {n} coordinates; nassim takes up to {LARGEST}")
        mass = finite_array(f"{label}: mass matrix", mass, (n, n))
        stiffness = finite_array(f"{label}: stiffness matrix", self.stiffness_matrix, (n, n))
        positions = finite_array(f"{label}: positions", self.positions, (None, 3))
        names = unique(f"{label}: node", self.names)
        if not len(positions) or len(names) != len(positions):
            raise ValueError(f"{label}: {len(positions)} node(s) with {len(names)} name(s); at least one, a name each")
        if n < 6 * len(positions):
            raise ValueError(
                f"{label}: {len(positions)} nodes have {6 * len(positions)} DoFs, but the matrices only {n} rows: "
                "matrices or coordinates of another body, or cut"
            )
        for kind, array in (("mass matrix", mass), ("stiffness matrix", stiffness), ("positions", positions)):
            if np.abs(array).max() > HUGE:
                raise ValueError(f"{label}: the {kind} holds {np.abs(array).max():.3g}; nothing real is so large")
        mass, stiffness, positions = (
            np.where(np.abs(array) < TINY, 0.0, array) for array in (mass, stiffness, positions)
        )
        for array in (mass, stiffness, positions):
            array.setflags(write=False)
        freeze(
            self,
            stiffness_matrix=stiffness,
            mass_matrix=mass,
            positions=positions,
            names=names,
            digits=self.digits or max(significant_digits(stiffness), significant_digits(mass)),
        )

    @property
    def n_modes(self) -> int:
        """Number p of trailing rows that belong to no node."""
        return len(self.mass_matrix) - 6 * len(self.positions)

    @property
    def rigid_motions(self) -> Array:
        """The six rigid motions about the origin in these coordinates, (n, 6): from the geometry, modes at rest."""
        return rigid_motions(self.positions, len(self.mass_matrix))

    def reordered(self, rows: Sequence[int]) -> "Superelement":
        """The same with row rows[i] as row i, e.g. the rows that `guess_order` proposes."""
        order = np.array(rows)
        if sorted(order.tolist()) != list(range(len(self.mass_matrix))):
            raise ValueError(f"rows must name each of the {len(self.mass_matrix)} rows once")
        block = np.ix_(order, order)
        return replace(self, stiffness_matrix=self.stiffness_matrix[block], mass_matrix=self.mass_matrix[block])


def superelement(
    stiffness_matrix: ArrayLike,
    mass_matrix: ArrayLike,
    positions: ArrayLike,
    *,
    name: str = "superelement",
    names: Sequence[str] | None = None,
    units: str = "m-N-kg",
    orientations: ArrayLike | None = None,
    source: str = "arrays",
) -> Superelement:
    """A superelement from plain arrays in any units; the one place where units are converted.

    stiffness_matrix, mass_matrix: (6 r + p, 6 r + p), per node ux uy uz rx ry rz, then modal coordinates
    positions: of the nodes, (r, 3); names: of the nodes (default: node_1, node_2, ...)
    units: length-force-mass, such as "mm-N-t" or "in-lbf-slinch"; time is in seconds, angles in radians
    orientations: rotation from each node's axes to the body's, (r, 3, 3), where the nodes' DoFs are not along the
        body's axes (default: they are)

    Modal coordinates are scaled so that unit modal masses stay ones. Raises ValueError as `Superelement` does, for
    unknown units and for orientations that are no rotations.
    """
    length, force, mass = unit_factors(units)
    raw = Superelement(
        name,
        stiffness_matrix=finite_array(f"{source}: stiffness matrix", stiffness_matrix, (None, None)),
        mass_matrix=finite_array(f"{source}: mass matrix", mass_matrix, (None, None)),
        positions=finite_array(f"{source}: positions", positions, (None, 3)),
        names=tuple(f"node_{k + 1}" for k in range(len(np.atleast_2d(positions)))) if names is None else tuple(names),
        source=source,
        units=units,
    )
    r, energy = len(raw.positions), mass * length**2
    # Per unit of the file's coordinates: metres, radians, and modal amplitudes that keep unit modal masses.
    unit = np.concatenate([np.tile([length] * 3 + [1.0] * 3, r), [np.sqrt(energy)] * raw.n_modes])
    stiffness = force * length * raw.stiffness_matrix / np.outer(unit, unit)
    masses = energy * raw.mass_matrix / np.outer(unit, unit)
    if orientations is not None:
        turns = finite_array(f"{source}: orientations", orientations, (r, 3, 3))
        if np.abs(turns @ turns.transpose(0, 2, 1) - np.eye(3)).max() > 1e-6 or np.any(np.linalg.det(turns) < 0):
            raise ValueError(f"{source}: orientations must be rotation matrices, one per node")
        change = scipy.linalg.block_diag(*np.repeat(turns, 2, axis=0), np.eye(raw.n_modes))
        stiffness, masses = change @ stiffness @ change.T, change @ masses @ change.T
    return replace(raw, stiffness_matrix=stiffness, mass_matrix=masses, positions=length * raw.positions)


def read_superelement(
    *paths: str | Path,
    units: str = "m-N-kg",
    names: Sequence[str] | None = None,
    variables: Mapping[str, str] | None = None,
    orientations: ArrayLike | None = None,
    name: str | None = None,
) -> Superelement:
    """Read a superelement from one .mat or .npz file, or from ANSYS text listings (all files of one body).

    units: of the files, length-force-mass, see `superelement`
    names: of the nodes, in the file's order (default: the file's own, or node_ and the number it gives them)
    variables: for .mat and .npz: where K, M, positions, names or orientations have other names than `VARIABLES`
        lists, e.g. {"K": "stiff", "positions": "xyz"}
    orientations: (r, 3, 3), see `superelement`; listings give their own as THXY THYZ THZX
    name: of the result (default: of the first file)

    Raises ValueError naming file, line (of a text) and cause for whatever cannot be read. What can be read
    may be wrong all the same: `check` it.
    """
    files = [Path(path) for path in paths]
    if not files:
        raise ValueError("give at least one file")
    label = name or re.sub(r"\W+", "_", files[0].stem)
    if any(path.suffix.lower() in (".mat", ".npz") for path in files):
        if len(files) > 1:
            raise ValueError(f"a .mat or .npz file stands alone, got {len(files)} files: {', '.join(map(str, files))}")
        found = _from_arrays(files[0], variables or {})
        return superelement(
            found["K"],
            found["M"],
            found["positions"],
            name=label,
            names=_names(found["names"]) if names is None and "names" in found else names,
            units=units,
            orientations=found.get("orientations") if orientations is None else orientations,
            source=str(files[0]),
        )
    listing = parse_listings({str(path): read_bytes(path).decode("latin-1") for path in files})
    return _from_listing(listing, [str(path) for path in files], label, units, names, orientations)


def _from_listing(
    listing: Listing,
    files: Sequence[str],
    name: str,
    units: str,
    names: Sequence[str] | None,
    orientations: ArrayLike | None,
) -> Superelement:
    numbers, rows = rows_by_node(listing, files)
    n = len(listing.matrices["K"])
    order = np.concatenate([rows, np.setdiff1d(np.arange(n), rows)])
    stiffness, mass = (listing.matrices[letter][np.ix_(order, order)] for letter in "KM")
    angles = np.array([listing.angles.get(number, np.zeros(3)) for number in numbers])
    if orientations is None and np.any(angles):
        orientations = np.array([nodal_frame(row) for row in angles])
    return superelement(
        stiffness,
        mass,
        np.array([listing.nodes[number] for number in numbers]),
        name=name,
        names=[f"node_{number}" for number in numbers] if names is None else names,
        units=units,
        orientations=orientations,
        source=", ".join(files),
    )


def _from_arrays(path: Path, variables: Mapping[str, str]) -> dict[str, Array]:
    for key in variables:
        known("variable of a superelement", key, VARIABLES)
    arrays = read_arrays(path)
    found: dict[str, Array] = {}
    for key, usual in VARIABLES.items():
        wanted = (variables[key],) if key in variables else usual
        present = [candidate for candidate in wanted if candidate in arrays]
        if present:
            found[key] = arrays[present[0]]
        elif key in variables or key in ("K", "M", "positions"):
            raise ValueError(
                f"{path}: no variable {' or '.join(wanted)} for {key}; it has {', '.join(arrays) or 'none'}: name it "
                f"by variables={{{key!r}: ...}}"
            )
    positions = found["positions"]
    if positions.ndim == 2 and positions.shape[0] == 3 and positions.shape[1] != 3:
        found["positions"] = positions.T
    return found


def _names(values: Array) -> list[str]:
    """Names as text; numbers as node_1001."""
    return [value.strip() if isinstance(value, str) else f"node_{value:.15g}" for value in values.ravel().tolist()]


def significant_digits(matrix: Array) -> int:
    """Fewest decimal digits that give all entries to 1e-15; more than 14 count as 16."""
    values = np.abs(matrix[matrix != 0])
    if not values.size:
        return 1
    mantissa = values / 10.0 ** np.floor(np.log10(values))
    for digits in range(1, 15):
        step = 10.0 ** (1 - digits)
        if np.all(np.abs(mantissa - np.round(mantissa / step) * step) <= 1e-15 * mantissa):
            return digits
    return 16
