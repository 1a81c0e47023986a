"""Reduced bodies from and for other programs: ANSYS, Simscape and whatever writes M and K; inspection and repair.

Loading it loads neither NGSolve nor Exudyn. To add a file format, open `superelement` (and `ansys` or `mat_npz` as
examples); a check of foreign matrices, `inspection`; a repair, `acceptance`.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
