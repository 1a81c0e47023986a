"""CAD bodies and faces of a mesh by exact name.

NGSolve's own look-ups take regular expressions and are not used: "part.1" would match "part-1" too, "pad (2)" would
match nothing, and "c++" terminates the interpreter.
"""

from collections.abc import Collection, Mapping
from typing import Any

import ngsolve as ng


def bodies(mesh: Any, names: Collection[str]) -> Any:
    """Return the CAD bodies with exactly these names as a region."""
    return ng.Region(mesh, ng.VOL, ng.BitArray([name in names for name in mesh.GetMaterials()]))


def faces(mesh: Any, names: Collection[str]) -> Any:
    """Return the faces with exactly these names as a region."""
    return ng.Region(mesh, ng.BND, ng.BitArray([name in names for name in mesh.GetBoundaries()]))


def by_body(mesh: Any, values: Mapping[str, float]) -> Any:
    """Return a function that is constant in each CAD body, from values by name; KeyError if one is missing."""
    return ng.CoefficientFunction([values[name] for name in mesh.GetMaterials()])
