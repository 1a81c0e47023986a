"""Reduced bodies: remote points, matrices, read-outs, floating frame, piezoelectric stacks.

Only NumPy and SciPy are needed, so a saved or imported body is used without a mesh. To add a quantity that a body reads
out (stress, a strain gauge), edit `readouts`; another reduction of its coordinates, `projection`.
"""

from nassim.lazy_names import attach_names

__getattr__, __dir__, __all__ = attach_names(__name__, __file__)
