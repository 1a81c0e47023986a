"""Foundations of all sub-packages: input checks, progress, files, locks, dense modal algebra, rigid motions of points.

This sub-package knows no bodies, signals or scenes. It needs only NumPy, SciPy and the libraries that read and write
files. To add a check of arguments, edit `checks`; a data class that files may hold, `file_registry`; a unit, `units`.
"""

from nassim.lazy_names import attach_names

__getattr__, __dir__, __all__ = attach_names(__name__, __file__)
