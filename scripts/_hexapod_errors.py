"""How far a hexapod is from another, in its FRFs and in a record of forces and lengths."""

from collections.abc import Mapping, Sequence

import numpy as np
from _hexapod import ENCODERS, SENSORS, VOLTAGES

from nassim import LinearModel, TimeHistory, frequency_response

FREQUENCY = np.geomspace(10.0, 500.0, 1000)


def frf_error(model: LinearModel, whole: LinearModel) -> float:
    """Largest difference of any FRF from voltages to force sensors and encoders, over its largest value [-]."""
    one, other = (frequency_response(each, FREQUENCY) for each in (model, whole))
    pairs = [(output, voltage) for output in (*SENSORS, *ENCODERS) for voltage in VOLTAGES]
    responses = [(one.response(*pair), other.response(*pair)) for pair in pairs]
    return max(float(np.abs(found - wanted).max() / np.abs(wanted).max()) for found, wanted in responses)


def record_error(record: TimeHistory, expected: Mapping[str, np.ndarray], outputs: Sequence[str], every: int) -> float:
    """Largest difference of outputs, from their values at the start, over the largest expected one [-].

    expected: samples of each output, one in so many of which the record has
    """
    wanted = np.array([expected[output][::every][: len(record.time)] for output in outputs])
    found = np.array([record[output] - record[output][0] for output in outputs])
    return float(np.abs(found - wanted).max() / np.abs(wanted).max())
