"""Exchange with other programs: reduced bodies of ANSYS, Simscape and plain matrices, and models as FMU or C code.

Importing this sub-package loads neither NGSolve nor Exudyn. A new file format goes to `superelements` (`ansys` and
`mat_npz` are examples), a check of foreign matrices to `inspection`, and a repair to `repairing`. Models become
programs of matrices (`programs`), from which `c_code` and `fmu` write.
"""

from nassim.lazy_names import attach_names

__getattr__, __dir__, __all__ = attach_names(__name__, __file__)
