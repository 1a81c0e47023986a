"""Parallel kinematics of Stewart platforms (hexapods): plain functions on a frozen noun, NumPy and SciPy only.

No scene and no body in here: struts are lines between ideal joints. Geometry lives in `stewart`; what a pose makes of
the struts, and lengths of a pose, in `poses`; forces and stiffness in `stiffness`; strokes and workspace in `reach`.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
