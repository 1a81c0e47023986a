"""Models from measurements: modes with their uncertainty, correction of scenes, calibration of parameters.

A new estimator of modes goes to `modal_fit`, which fits the `spectral_lines` that `measured_lines` provides. A new
scene parameter that measurements correct goes to `apply`, and a model parameter that published figures determine to
`calibration`.
"""

from nassim.lazy_names import attach_names

__getattr__, __dir__, __all__ = attach_names(__name__, __file__)
