"""Time histories, frequency responses, excitations, noise spectra, and the files that hold them.

To add an excitation, edit `excitations`; a kind of noise, `spectra`; an estimator of responses, `frf`; a file format,
`files`.
"""

from nassim.lazy_names import attach_names

__getattr__, __dir__, __all__ = attach_names(__name__, __file__)
