"""Exchange of reduced bodies with other programs (ANSYS, Simscape, plain matrices), their inspection and repair.

Importing this sub-package loads neither NGSolve nor Exudyn. A new file format goes to `superelements` (`ansys` and
`mat_npz` are examples), a check of foreign matrices to `inspection`, and a repair to `repairing`.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
