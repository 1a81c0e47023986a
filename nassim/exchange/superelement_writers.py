"""Writers of superelements for other FE programs: Nastran's DMIG (.pch) and .op4, Abaqus' user elements (.mtx)."""

import re
from pathlib import Path

from nassim.base.checks import known
from nassim.base.storage import write_atomically
from nassim.bodies.reduced_body import ReducedBody
from nassim.exchange.abaqus import mtx_text
from nassim.exchange.inspection import as_superelement, symmetry
from nassim.exchange.nastran import bulk_text, dmig_text, write_op4
from nassim.exchange.nodal_matrices import NodalMatrices
from nassim.exchange.superelements import Superelement
from nassim.exchange.unit_systems import matrix_units

ENDINGS = (".pch", ".op4", ".mtx")


def write_superelement(body: ReducedBody | Superelement, path: str | Path, *, units: str) -> tuple[Path, ...]:
    """Write stiffness and mass of a body for Nastran or Abaqus, which `read_superelement` reads back.

    The files have no names of nodes: nodes called node_1001 keep their number, otherwise nodes are numbered from 1.
    Modal coordinates are scalar points with the numbers after the last node.

    Args:
        body: reduced body or superelement.
        path: file with the ending .pch (Nastran: GRID, SPOINT and symmetric DMIG KAAX and MAAX, 11 digits or more),
            .op4 (Nastran: binary matrices KAAX and MAAX; nodes and order of rows are in the .asm file beside it) or
            .mtx (Abaqus: *USER ELEMENT, LINEAR, 17 digits; coordinates are comments).
        units: units of the file, length-force-mass, such as "mm-N-t".

    Returns:
        Paths of the files.

    Raises:
        ValueError: for another ending, unknown units, and in .pch and .mtx for matrices that are not symmetric.
        RuntimeError: for .op4 without the package pyYeti.
    """
    target = Path(path)
    ending = known("file ending", target.suffix.lower(), ENDINGS)
    given = as_superelement(body)
    if ending != ".op4" and (found := symmetry(given)).verdict == "fault":
        raise ValueError(f"{given.source}: {ending} holds one triangle of each matrix: {found.text}")
    nodal = _in_units(given, units)
    title = f"{body.name} by nassim, {units}, s, rad"
    if ending == ".op4":
        beside = target.with_suffix(".asm")
        with write_atomically(target) as matrices, write_atomically(beside) as text:
            write_op4(matrices, {"KAAX": nodal.stiffness, "MAAX": nodal.mass})
            text.write_text(bulk_text(nodal, title), encoding="latin-1", errors="replace")
        return target, beside
    written = mtx_text(nodal, title) if ending == ".mtx" else dmig_text(nodal, title)
    with write_atomically(target) as text:
        text.write_text(written, encoding="latin-1", errors="replace")
    return (target,)


def _in_units(body: Superelement, units: str) -> NodalMatrices:
    """Return the matrices in other units: the inverse of the conversion in `superelement`."""
    length, stiffness_unit, mass_unit = matrix_units(units, len(body.positions), body.n_modes)
    numbers = _node_numbers(body.names)
    dofs = [(node, component) for node in numbers for component in range(1, 7)]
    dofs += [(max(numbers) + 1 + k, 0) for k in range(body.n_modes)]
    return NodalMatrices(
        body.stiffness_matrix / stiffness_unit,
        body.mass_matrix / mass_unit,
        tuple(dofs),
        dict(zip(numbers, body.positions / length, strict=True)),
    )


def _node_numbers(names: tuple[str, ...]) -> list[int]:
    found = [re.fullmatch(r"node_([1-9]\d{0,6})", name) for name in names]
    if all(found):
        return [int(match[1]) for match in found if match]
    return list(range(1, len(names) + 1))
