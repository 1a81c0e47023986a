"""Models from measurements: modes with their uncertainty, scenes corrected by them, parameters calibrated.

To add an estimator of modes, open `modal_fit`; a parameter of scenes that measurements correct, `apply`.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
