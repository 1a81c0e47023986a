"""Time histories, frequency responses, excitations, noise spectra, and the files that hold them.

To add an excitation, edit `excitations`; a kind of noise, `spectra`; an estimator of responses, `frf`; a file format,
`files`.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
