"""Models from measurements: modes with their uncertainty, scenes corrected by them, parameters calibrated.

To add an estimator of modes, open `modal_fit`, which fits `lines` of `spectra`; a parameter of scenes that measurements
correct, `apply`; a parameter of models that published figures tell, `calibration`.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
