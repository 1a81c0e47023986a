"""Finite elements: from CAD to a reduced body. NGSolve and Netgen are used here and nowhere else.

`solid` -> `meshing` -> `assembly` (an `FEModel`) -> `condensation` -> `reduction` (a `ReducedBody`). To add a way to
tie remote points to faces, open `fe_model` and `condensation`; a solver of sparse systems, `solver`; a physical load
over a volume, `ports`; an error estimate, `mesh_error`.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
