"""Parallel kinematics of Stewart platforms (hexapods): functions on a data class, with NumPy and SciPy only.

Struts are lines between ideal joints; there are no scenes and no bodies. Modules: `stewart` holds the geometry, `poses`
the forward and inverse kinematics, `stiffness` forces and stiffness, `reach` strokes and workspace.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
