"""Finite elements, from CAD to a reduced body. Only this sub-package uses NGSolve and Netgen.

`cad_files` -> `solid` -> `meshing` -> `assembly` (an `FEModel`) -> `condensation` -> `reduction` (a `ReducedBody`). To
add a choice of faces, edit `face_picks`; a coupling of remote points to faces, `fe_model` and `condensation`; a solver
for sparse systems, `solver`; a physical load over a volume, `ports`; an error estimate, `mesh_error`.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
