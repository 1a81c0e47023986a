"""Superelements: reduced matrices from other programs, as read, in SI units and nassim's order of coordinates."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import KW_ONLY, field, replace
from pathlib import Path

import numpy as np
import scipy

from nassim.base.checks import Array, finite_array, freeze, known, unique
from nassim.base.field_types import ArrayField, ArrayLike, NameList, data_class
from nassim.base.rigid_motion import rigid_motions
from nassim.base.short_repr import short_repr
from nassim.exchange.ansys import MOST_COORDINATES, Listing, nodal_frame, parse_listings, rows_by_node
from nassim.exchange.mat_npz import read_arrays, read_bytes
from nassim.exchange.unit_systems import unit_factors

VARIABLES = {
    "K": ("K", "K_red", "stiffness", "stiffness_matrix", "Kr"),
    "M": ("M", "M_red", "mass", "mass_matrix", "Mr"),
    "positions": ("P", "int_xyz", "positions", "origins", "ReferenceLocations", "interface_origins"),
    "names": ("names", "int_i"),
    "orientations": ("orientations",),
}
"""Names of the variables in .mat and .npz files, by their meaning."""
HUGE, TINY = 1e40, 1e-100
"""Entries above the first magnitude are refused; entries below the second count as zero."""


@data_class
class Superelement:
    """Reduced matrices from another program: r nodes with six DoFs each, then p modal coordinates.

    Attributes:
        name: name in files and reports.
        stiffness_matrix: K, (n, n) with n = 6 r + p, in the axes of the body; not necessarily symmetric, definite or
            right [SI].
        mass_matrix: M, (n, n), likewise [SI].
        positions: positions of the nodes, (r, 3) [m].
        names: names of the nodes.
        source: origin of the matrices, as text.
        units: units of the source.
        digits: number of significant digits of the source.

    Raises:
        ValueError: for wrong shapes, fewer rows than the nodes need, and entries that are not finite or above 1e40.
    """

    name: str
    _: KW_ONLY
    stiffness_matrix: ArrayField
    mass_matrix: ArrayField
    positions: ArrayField
    names: NameList
    source: str = "arrays"
    units: str = "m-N-kg"
    digits: int = field(default=0)
    __repr__ = short_repr

    def __post_init__(self) -> None:
        label = self.source
        mass = finite_array(f"{label}: mass matrix", self.mass_matrix, (None, None))
        n = len(mass)
        if n > MOST_COORDINATES:
            raise ValueError(f"{label}: {n} coordinates; nassim takes up to {MOST_COORDINATES}")
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
                raise ValueError(f"{label}: the {kind} holds {np.abs(array).max():.3g}; the largest is {HUGE:g}")
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
        """Six rigid-body motions about the origin, (n, 6), from the geometry, with modal coordinates of 0."""
        return rigid_motions(self.positions, len(self.mass_matrix))

    def reordered(self, rows: Sequence[int]) -> "Superelement":
        """Return the superelement with row rows[i] as row i.

        Args:
            rows: permutation of the rows, (n,), such as that of `guess_order`.

        Raises:
            ValueError: unless each row occurs once.
        """
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
    """Make a superelement from plain arrays in any units.

    This is the only place where units are converted. Modal coordinates are scaled so that unit modal masses remain
    ones.

    Args:
        stiffness_matrix: (6 r + p, 6 r + p), per node ux uy uz rx ry rz, then modal coordinates.
        mass_matrix: (6 r + p, 6 r + p), likewise.
        positions: positions of the nodes, (r, 3).
        name: name of the result.
        names: names of the nodes (default: node_1, node_2, ...).
        units: length-force-mass, such as "mm-N-t" or "in-lbf-slinch"; time is in seconds, angles are in radians.
        orientations: rotation from the axes of each node to those of the body, (r, 3, 3), where the DoFs of the nodes
            are not along the axes of the body (default: they are).
        source: origin of the matrices, for messages.

    Returns:
        Superelement in SI units.

    Raises:
        ValueError: in the cases of `Superelement`, for unknown units, and for orientations that are not rotations.
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
    # SI value of each unit of the file: metres, radians, and modal amplitudes that preserve unit modal masses.
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
    """Read a superelement from one .mat or .npz file, or from ANSYS text listings.

    Matrices that can be read may still be wrong: `check` the result.

    Args:
        paths: one .mat or .npz file, or all listings of one body.
        units: units of the files, length-force-mass, see `superelement`.
        names: names of the nodes in the order of the file (default: those of the file, or node_ and its node number).
        variables: for .mat and .npz: names of the variables K, M, positions, names or orientations that differ from
            `VARIABLES`, such as {"K": "stiff", "positions": "xyz"}.
        orientations: (r, 3, 3), see `superelement`; listings contain their own as THXY THYZ THZX.
        name: name of the result (default: that of the first file).

    Returns:
        Superelement in SI units.

    Raises:
        ValueError: naming file, line (of a text) and cause for data that cannot be read.
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
    """Return names as text; numbers become node_1001."""
    return [value.strip() if isinstance(value, str) else f"node_{value:.15g}" for value in values.ravel().tolist()]


def significant_digits(matrix: Array) -> int:
    """Return the smallest number of decimal digits that reproduces all entries to 1e-15; more than 14 count as 16.

    Args:
        matrix: of any shape.
    """
    values = np.abs(matrix[matrix != 0])
    if not values.size:
        return 1
    mantissa = values / 10.0 ** np.floor(np.log10(values))
    for digits in range(1, 15):
        step = 10.0 ** (1 - digits)
        if np.all(np.abs(mantissa - np.round(mantissa / step) * step) <= 1e-15 * mantissa):
            return digits
    return 16
