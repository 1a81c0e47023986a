"""Parallel kinematics of Stewart platforms (hexapods): functions on a data class, with NumPy and SciPy only.

Struts are lines between ideal joints; there are no scenes and no bodies. Modules: `stewart` holds the geometry, `poses`
the forward and inverse kinematics, `stiffness` forces and stiffness, `strokes` strokes and workspace.
"""

from nassim.lazy_names import attach_names

__getattr__, __dir__, __all__ = attach_names(__name__, __file__)
