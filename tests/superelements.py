"""Made-up superelements with the defects that real ones have, and writers of their files."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import scipy.linalg

from nassim.base.rigid_motion import AXES, rigid_transfer
from nassim.exchange.inspection import as_superelement
from nassim.exchange.superelements import read_superelement

SAMPLE = Path(__file__).parent / "data" / "ansys_listing"
DOFS = ("UX", "UY", "UZ", "ROTX", "ROTY", "ROTZ")
assert len(DOFS) == len(AXES)


def sample(**options):
    return read_superelement(*sorted(SAMPLE.glob("*.txt")), units="mm-N-t", **options)


def with_matrices(body, change):
    return replace(body, stiffness_matrix=change(body.stiffness_matrix), mass_matrix=change(body.mass_matrix), digits=0)


def symmetric(matrix):
    return 0.5 * (matrix + matrix.T)


def rounded(body, digits):
    """As a text listing of so many digits would leave it."""

    def change(matrix):
        return np.array([[float(f"{value:.{digits - 1}e}") for value in row] for row in matrix])

    return with_matrices(body, change)


def joint_like(body):
    """The same body with all nodes (nearly) in one place, as flexible joints have them."""
    given = as_superelement(body)
    places = given.positions.mean(axis=0) + np.outer(np.linspace(1e-9, -1e-9, len(given.positions)), [0, 0, 1])
    blocks = [rigid_transfer(old - new) for old, new in zip(given.positions, places, strict=True)]
    change = scipy.linalg.block_diag(*blocks, np.eye(given.n_modes))
    moved = with_matrices(given, lambda matrix: symmetric(change.T @ matrix @ change))
    return replace(moved, positions=places)


def grounded_at(body, node, share):
    """Spurious stiffness in one node's own block."""
    stiffness = np.array(body.stiffness_matrix)
    block = slice(6 * node, 6 * node + 6)
    stiffness[block, block] += share * np.diag(np.diag(stiffness)[block])
    return replace(body, stiffness_matrix=stiffness)


def matrix_text(matrix, *, title="MAT_K", entry="[{:3d},{:3d}]:{:10.3e}", between=" ", row_end="\n", banner=""):
    lines = []
    for i, row in enumerate(matrix):
        lines.append(between.join(entry.format(i + 1, j + 1, value) for j, value in enumerate(row)) + row_end)
        if banner and i % 5 == 4:
            lines.append(banner)
    return f"\n{title}: {row_end}" + "".join(lines)


def node_text(positions, *, rotations=True, turned=None, heading_every=5, others=True, row_end="\n"):
    """A listing of nodes 11, 12, ... (and of some that are no masters)."""
    heading = f"   NODE        X             Y             Z {'  THXY     THYZ     THZX' if rotations else ''}{row_end}"
    rows = [(11 + k, position) for k, position in enumerate(positions)]
    rows += [(901 + k, np.full(3, 7.0 * k)) for k in range(4 * others)]
    text = f" LIST ALL SELECTED NODES.   DSYS=      0{row_end}"
    for k, (number, xyz) in enumerate(rows):
        text += heading if k % heading_every == 0 else ""
        text += f"{number:9d}  {xyz[0]:.5E} {xyz[1]:9.4f} {xyz[2]:14.6f} "
        angle = (turned or {}).get(number, 0.0)
        text += (f"{angle:8.2f}     0.00     0.00" if rotations else "") + row_end
    return text


def master_text(n, *, dofs=DOFS, heading_every=7, row_end="\n"):
    text = f" LIST MASTERS ON ALL SELECTED NODES.{row_end} CURRENT DOF SET= UX   UY   UZ   ROTX ROTY ROTZ{row_end}"
    for k, (number, dof) in enumerate((11 + i, dof) for i in range(n) for dof in dofs):
        text += f"  NODE DOF{row_end}" if k % heading_every == 0 else ""
        text += f"{number:8d} {dof:4s}{row_end}"
    return text
