"""Reduced bodies: remote points, matrices, what they read out, their motion in a floating frame, piezoelectric stacks.

NumPy and SciPy only: a body that was saved or imported is used without a mesh. To add something that a body reads out
(stress, a strain gauge), open `readouts`; another reduction of its coordinates, `projection`.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
