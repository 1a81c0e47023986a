"""CAD bodies and faces of a mesh by exact name: NGSolve's own look-ups, which are not used, take regular expressions.

A name such as "part.1" would match "part-1" too, "pad (2)" would match nothing, and "c++" ends the interpreter.
"""

from collections.abc import Collection, Mapping
from typing import Any

import ngsolve as ng


def bodies(mesh: Any, names: Collection[str]) -> Any:
    """The CAD bodies with exactly these names, as a region."""
    return ng.Region(mesh, ng.VOL, ng.BitArray([name in names for name in mesh.GetMaterials()]))


def faces(mesh: Any, names: Collection[str]) -> Any:
    """The faces with exactly these names, as a region."""
    return ng.Region(mesh, ng.BND, ng.BitArray([name in names for name in mesh.GetBoundaries()]))


def by_body(mesh: Any, values: Mapping[str, float]) -> Any:
    """The function that is constant in each CAD body; values: by its name, KeyError where one is missing."""
    return ng.CoefficientFunction([values[name] for name in mesh.GetMaterials()])
