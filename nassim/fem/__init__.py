"""Finite elements, from CAD to a reduced body. Only this sub-package uses NGSolve and Netgen.

`cad_files` -> `solid` -> `meshing` -> `assembly` (an `FEModel`) -> `condensation` -> `reduction` (a `ReducedBody`).
`accuracy` repeats meshing to condensation until `mesh_error` is below a tolerance. To add a choice of faces, edit
`face_picks`; a coupling of remote points to faces, `fe_model` and `condensation`; a solver for sparse systems,
`solver`; a physical load over a volume, `ports`; an error estimate, `mesh_error`; a quantity that a tolerance holds,
`accuracy`.
"""

from nassim.lazy_names import attach_names

__getattr__, __dir__, __all__ = attach_names(__name__, __file__)
