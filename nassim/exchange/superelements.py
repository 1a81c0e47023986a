"""Superelements: reduced matrices from other programs, as read, in SI units and nassim's order of coordinates."""

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import KW_ONLY, field, replace
from pathlib import Path

import numpy as np
import scipy

from nassim.base.checks import Array, finite_array, freeze, known, unique
from nassim.base.field_types import ArrayField, ArrayLike, NameList, data_class
from nassim.base.rigid_motion import proper_rotation, rigid_motions
from nassim.base.short_repr import short_repr
from nassim.exchange.abaqus import read_mtx
from nassim.exchange.ansys import read_listings
from nassim.exchange.calculix import STORED, read_stored_matrices
from nassim.exchange.mat_npz import read_arrays
from nassim.exchange.nastran import BINARY, USUAL_NAMES, read_nastran
from nassim.exchange.nodal_matrices import MOST_COORDINATES, NodalMatrices, interface_rows
from nassim.exchange.unit_systems import matrix_units

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
            rows: permutation of the rows, (n,), such as that of `nassim.exchange.row_order.guess_order`.

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
    raw = Superelement(
        name,
        stiffness_matrix=stiffness_matrix,
        mass_matrix=mass_matrix,
        positions=positions,
        names=tuple(f"node_{k + 1}" for k in range(len(np.atleast_2d(positions)))) if names is None else names,
        source=source,
        units=units,
    )
    r = len(raw.positions)
    length, stiffness_unit, mass_unit = matrix_units(units, r, raw.n_modes)
    stiffness, masses = stiffness_unit * raw.stiffness_matrix, mass_unit * raw.mass_matrix
    if orientations is not None:
        turns = proper_rotation(f"{source}: orientations", orientations, (r, 3, 3), tolerance=1e-6)
        change = scipy.linalg.block_diag(*np.repeat(turns, 2, axis=0), np.eye(raw.n_modes))
        stiffness, masses = change @ stiffness @ change.T, change @ masses @ change.T
    return replace(raw, stiffness_matrix=stiffness, mass_matrix=masses, positions=length * raw.positions)


def read_superelement(
    *paths: str | Path,
    units: str | None = None,
    names: Sequence[str] | None = None,
    variables: Mapping[str, str] | None = None,
    orientations: ArrayLike | None = None,
    name: str | None = None,
    positions: Mapping[int, ArrayLike] | None = None,
    dofs: Iterable[Sequence[int]] | None = None,
) -> Superelement:
    """Read a superelement from files of MATLAB, NumPy, ANSYS, Nastran, Abaqus or nassim itself.

    Matrices that can be read may still be wrong: `check` the result.

    Args:
        paths: all files of one body: one .mat or .npz file; ANSYS text listings; Nastran's .pch with DMIG, or .op4 or
            .op2 with its .pch or .asm; one .mtx file of an Abaqus substructure.
        units: units of the files, length-force-mass, see `superelement` (default: SI for .mat, .npz and listings; files
            of Nastran and Abaqus need them stated).
        names: names of the nodes in the order of the file (default: those of the file, or node_ and its node number).
        variables: names of matrices that differ from the usual ones: for .mat and .npz those of K, M, positions, names
            or orientations in `VARIABLES`, such as {"K": "stiff", "positions": "xyz"}; for Nastran those of K and M
            (default: KAAX, KAA, KXX or KGG, and likewise for M).
        orientations: (r, 3, 3), see `superelement`; listings contain their own as THXY THYZ THZX, and Nastran's nodes
            as coordinate systems.
        name: name of the result (default: that of the first file).
        positions: not for .mat and .npz: coordinates of nodes, (3,) by node number, in the units of the files (default:
            those of the files).
        dofs: for listings, .op4, .op2 and .mtx: node number and component (1 to 6; 0 for a modal coordinate) of each
            row, (n,) pairs (default: those of the file, or of the .pch or .asm file beside it).

    Returns:
        Superelement in SI units.

    Raises:
        ValueError: naming file, line (of a text) and cause for data that cannot be read.
        RuntimeError: for .op4 and .op2 without the package pyYeti.
    """
    files = [Path(path) for path in paths]
    if not files:
        raise ValueError("give at least one file")
    label, source = name or _name_of(files[0]), ", ".join(map(str, files))
    endings = {path.suffix.lower() for path in files}
    for kinds in ({".mat", ".npz"}, {".mtx"}):
        if endings & kinds and len(files) > 1:
            raise ValueError(f"a {' or '.join(sorted(kinds))} file stands alone, got {len(files)} files: {source}")
    if endings & {".mat", ".npz"}:
        if positions is not None or dofs is not None:
            raise ValueError(f"positions and dofs are for listings, .pch, .op4, .op2 and .mtx, got {files[0].name}")
        return _from_arrays(files[0], variables or {}, label, units or "m-N-kg", names, orientations)
    if endings & STORED:
        raise ValueError(f"{files[0]}: CalculiX's stored matrices are read by read_calculix")
    if variables and not endings & {".pch", ".asm", *BINARY}:
        raise ValueError(f"variables are for .mat, .npz and Nastran's files, got {files[0].name}")
    if ".mtx" in endings:
        found = read_mtx(files[0], positions=positions, dofs=dofs)
    elif endings & {".pch", ".asm", *BINARY}:
        for key in variables or {}:
            known("matrix of a superelement", key, USUAL_NAMES)
        found = read_nastran(files, names=variables or {}, positions=positions, dofs=dofs)
    else:
        found = read_listings(files, positions=positions, dofs=dofs)
        units = units or "m-N-kg"
    return _from_nodes(found, source, label, units, names, orientations)


def read_calculix(
    path: str | Path,
    *,
    units: str,
    positions: Mapping[int, ArrayLike],
    rotation_nodes: Mapping[int, int],
    n_modes: int = 6,
    names: Sequence[str] | None = None,
    name: str | None = None,
) -> Superelement:
    """Read the matrices that CalculiX stores, and reduce them to interface nodes and fixed-interface modes.

    CalculiX's own substructures (`*SUBSTRUCTURE GENERATE`) have no mass and no modes. A step
    `*FREQUENCY, SOLVER=MATRIXSTORAGE` of a free body, whose interface faces are rigid bodies (`*RIGID BODY` with
    `REF NODE` and `ROT NODE`), writes all that is needed.

    Args:
        path: one of the files .sti, .mas and .dof; the others stand beside it.
        units: units of the model, length-force-mass, see `superelement`.
        positions: coordinates of the reference nodes (REF NODE), (3,) by node number, in the units of the model.
        rotation_nodes: number of the rotation node (ROT NODE) by that of the reference node.
        n_modes: number of fixed-interface modes that are retained.
        names: names of the nodes in the order of `positions` (default: node_ and its number).
        name: name of the result (default: that of the file).

    Returns:
        Superelement in SI units.

    Raises:
        ValueError: naming file and cause for data that cannot be read, and for nodes that the files do not contain.
    """
    file = Path(path)
    found = read_stored_matrices(file, positions=positions, rotation_nodes=rotation_nodes, n_modes=n_modes)
    return _from_nodes(found, str(file), name or _name_of(file), units, names, None)


def _from_nodes(
    found: NodalMatrices,
    source: str,
    name: str,
    units: str | None,
    names: Sequence[str] | None,
    orientations: ArrayLike | None,
) -> Superelement:
    if units is None:
        raise ValueError(f"{source}: the file does not say its units: state them, such as units='mm-N-t'")
    nodes, rows = interface_rows(found, source)
    if orientations is None and found.frames:
        orientations = np.array([found.frames.get(node, np.eye(3)) for node in nodes])
    block = np.ix_(rows, rows)
    return superelement(
        found.stiffness[block],
        found.mass[block],
        np.array([found.positions[node] for node in nodes]),
        name=name,
        names=[f"node_{node}" for node in nodes] if names is None else names,
        units=units,
        orientations=orientations,
        source=source,
    )


def _name_of(path: Path) -> str:
    return re.sub(r"\W+", "_", path.stem)


def _from_arrays(
    path: Path,
    variables: Mapping[str, str],
    name: str,
    units: str,
    names: Sequence[str] | None,
    orientations: ArrayLike | None,
) -> Superelement:
    arrays = _arrays(path, variables)
    return superelement(
        arrays["K"],
        arrays["M"],
        arrays["positions"],
        name=name,
        names=_names(arrays["names"]) if names is None and "names" in arrays else names,
        units=units,
        orientations=arrays.get("orientations") if orientations is None else orientations,
        source=str(path),
    )


def _arrays(path: Path, variables: Mapping[str, str]) -> dict[str, Array]:
    """Return the arrays of a .mat or .npz file by their meaning."""
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
