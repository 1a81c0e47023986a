"""Checks of a mesh: memory of its factorisation, folded elements, volume, and thickness of walls in elements."""

from typing import Any

import ngsolve as ng
import numpy as np
import psutil

from nassim.base.warning_log import note, warn
from nassim.fem.curving import Curving
from nassim.fem.solid import Solid
from nassim.fem.solver import factor_memory

SMALL_MODEL = 50_000
"""Number of unknowns below which a model fits in any memory."""
USUAL_SHARE = 0.8
"""Largest share of the estimated memory that the sparse Cholesky factorisation needs in practice."""
THIN_SHARE = 0.5
LARGEST_VOLUME_ERROR = 0.01


def factorization_memory(mesh: Any, order: int) -> float:
    """Estimate the memory of a factorisation of elements of an order on a mesh [bytes]; 0 for a small model."""
    scalar = ng.H1(mesh, order=order)
    if 3 * scalar.ndof < SMALL_MODEL:
        return 0.0
    points = np.array([vertex.point for vertex in mesh.vertices])
    elements = list(mesh.Elements(ng.VOL))
    centres = np.array([points[[v.nr for v in element.vertices]].mean(axis=0) for element in elements])
    unknowns = [np.array(scalar.GetDofNrs(element)) for element in elements]
    return USUAL_SHARE * factor_memory(centres, unknowns)


def free_memory() -> float:
    """Return the free memory of the computer [bytes]."""
    return float(psutil.virtual_memory().available)


def check_memory(mesh: Any, solid: Solid, order: int, element_size: float) -> None:
    """Raise ValueError for a mesh whose factorisation would not fit in the free memory."""
    need, free = factorization_memory(mesh, order), free_memory()
    if need > free:
        # The memory of the factor is about proportional to the number of unknowns to the power 4/3.
        fitting = element_size * (need / free) ** 0.25
        raise ValueError(
            f"solid {solid.name!r}: {3 * ng.H1(mesh, order=order).ndof} degrees of freedom need about "
            f"{need / 1e9:.1f} GB to factorise, {free / 1e9:.1f} GB are free; an element_size of {fitting:.2g} m or "
            "more would fit"
        )


def check_folds(curving: Curving, solid: Solid) -> None:
    """Note how many elements folded when a mesh was curved, and warn of faces that moved because of them."""
    if curving.n_folded:
        note(str(curving))
    if len(curving.left):
        warn(
            f"solid {solid.name!r}: {curving}, at {curving.places_text}; estimated errors leave this out, except with "
            "a tolerance in place of element_size; to keep the faces of the CAD, give the curved faces there smaller "
            "elements (local_sizes, curvature)",
        )


def check_volume(mesh: Any, solid: Solid) -> None:
    """Warn if the curved faces of a mesh approximate the CAD so coarsely that the volume is wrong."""
    cad = sum(body.mass for body in solid.shape.solids)
    excess = ng.Integrate(1, mesh) / cad - 1
    if abs(excess) > LARGEST_VOLUME_ERROR:
        warn(
            f"solid {solid.name!r}: the mesh has {100 * excess:+.1f} % more volume than the CAD; give its curved "
            "faces smaller elements (local_sizes, curvature) or a higher order",
        )


def warn_of_thin_walls(mesh: Any, solid: Solid) -> None:
    """Warn of walls that are one element thick, for elements of order 1."""
    outside = np.zeros(mesh.nv, dtype=bool)
    for element in mesh.Elements(ng.BND):
        outside[[v.nr for v in element.vertices]] = True
    thin = np.mean([all(outside[v.nr] for v in element.vertices) for element in mesh.Elements(ng.VOL)])
    if thin > THIN_SHARE:
        warn(
            f"solid {solid.name!r}: {100 * thin:.0f} % of the elements reach from surface to surface, so walls "
            "are one element thick; with order 1 they are far too stiff (the first clamped frequency of an APA300ML "
            "comes out 2.6 times too high on 5 mm elements): use order 2 or more",
        )
