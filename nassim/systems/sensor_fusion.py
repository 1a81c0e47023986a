"""Complementary filters, whose sum is 1, and the fusion of two sensors of one quantity.

A super sensor reads H1 y1 + H2 y2 of two sensors with H1 + H2 = 1. Each filter leaves its sensor out where this sensor
is noisy or badly known.
"""

import math
from dataclasses import dataclass, replace

import numpy as np
import scipy

from nassim.base.checks import Array, finite_array, positive, whole_number
from nassim.base.short_repr import short_repr
from nassim.systems.interconnection import interconnect, static_gain
from nassim.systems.linear_model import LinearModel, frequency_response
from nassim.systems.optimal_control import Synthesis, h2_synthesis, hinf_synthesis


@dataclass(frozen=True)
class ComplementaryFilters:
    """Two filters whose sum is 1.

    Attributes:
        first: filter H1 of the first sensor.
        second: filter H2 of the second sensor, 1 - H1.
        norm: norm of the weighted filters that the synthesis made smallest; nan for filters in closed form.
    """

    first: LinearModel
    second: LinearModel
    norm: float = math.nan
    __repr__ = short_repr

    def fused_noise(self, frequency: Array, first: Array, second: Array) -> Array:
        """Return the noise density of the super sensor, sqrt(|H1 n1|^2 + |H2 n2|^2), (n,) [unit/sqrt(Hz)].

        Args:
            frequency: (n,) [Hz].
            first: noise density of the first sensor, (n,) [unit/sqrt(Hz)].
            second: noise density of the second sensor, (n,) [unit/sqrt(Hz)].
        """
        return np.hypot(*(self._gains(frequency) * _both(frequency, first, second)))

    def fused_uncertainty(self, frequency: Array, first: Array, second: Array) -> Array:
        """Return the largest relative error of the super sensor, |H1 w1| + |H2 w2|, (n,) [-].

        Args:
            frequency: (n,) [Hz].
            first: largest relative error of the first sensor's dynamics, (n,) [-].
            second: largest relative error of the second sensor's dynamics, (n,) [-].

        Source: T. Dehaeze, C. Collette, Sensor fusion method using H-infinity synthesis of complementary filters,
            Mechatronics 84 (2022).
        """
        return np.sum(self._gains(frequency) * _both(frequency, first, second), axis=0)

    def _gains(self, frequency: Array) -> Array:
        values = [frequency_response(h, frequency).values[0, 0] for h in (self.first, self.second)]
        return np.abs(values)


def complementary_filters(frequency: float, *, order: int = 1) -> ComplementaryFilters:
    """Return a high-pass and a low-pass filter in closed form: the parts of ((s/w + 1)/(s/w + 1))^(2 n - 1).

    Both filters have the slope n far from w and cross at w.

    Args:
        frequency: w / 2 pi [Hz].
        order: slope n of both filters.

    Returns:
        The high-pass as the first filter, the low-pass as the second.

    Source: C. Collette, F. Matichard, Sensor fusion methods for high performance active vibration isolation systems,
        Journal of Sound and Vibration 342 (2015) 1-21.
    """
    omega = 2 * np.pi * positive("frequency", frequency, "Hz")
    order = whole_number("order", order, 1)
    size = 2 * order - 1
    terms = np.array([math.comb(size, k) * omega**k for k in range(size + 1)])  # of falling powers of s
    numerator = np.concatenate([terms[:order], np.zeros(order)])
    a, b, c, d = scipy.signal.tf2ss(numerator, terms)
    high_pass = LinearModel(a, b, c, d, ("y",), ("filtered",))
    return ComplementaryFilters(high_pass, _complement(high_pass))


def hinf_complementary_filters(
    first: LinearModel, second: LinearModel, *, tolerance: float = 1e-3
) -> ComplementaryFilters:
    """Shape complementary filters by weights: they make the largest of |W1 H1| and |W2 H2| smallest.

    The norm of the result is the largest sqrt(|W1 H1|^2 + |W2 H2|^2). Below 1, both filters keep below the inverse of
    their weights.

    Args:
        first: weight W1 of the first filter: the inverse of its wanted largest magnitude (`weighting_filter`).
        second: weight W2 of the second filter.
        tolerance: see `hinf_synthesis`.

    Source: T. Dehaeze, M. Vermat, C. Collette, Complementary filters shaping using H-infinity synthesis, International
        Conference on Control, Mechatronics and Automation (2019).
    """
    return _synthesised(hinf_synthesis(_fusion(first, second), measured="y", driven="u", tolerance=tolerance))


def h2_complementary_filters(first: LinearModel, second: LinearModel) -> ComplementaryFilters:
    """Compute the complementary filters with the least rms noise of the super sensor.

    Args:
        first: stable filter that gives the first sensor's noise from white noise of unit intensity (`h2_norm`), without
            direct feedthrough: this sensor's noise falls at high frequency.
        second: stable filter that gives the second sensor's noise, with direct feedthrough.

    Returns:
        Filters; the norm is the rms noise of the super sensor.

    Raises:
        ValueError: for noises that have no finite rms in any super sensor.

    Source: T. Dehaeze, C. Collette, Sensor fusion method using H-infinity synthesis of complementary filters,
        Mechatronics 84 (2022).
    """
    return _synthesised(h2_synthesis(_fusion(first, second), measured="y", driven="u"))


def _fusion(first: LinearModel, second: LinearModel) -> LinearModel:
    """Return the plant of which a controller H2 gives W1 (1 - H2) and W2 H2."""
    w1, w2 = replace(first, inputs=("e",), outputs=("z1",)), replace(second, inputs=("u",), outputs=("z2",))
    mix = static_gain([[1.0, -1.0], [1.0, 0.0]], inputs=("w", "u"), outputs=("e", "y"))
    return interconnect(w1, w2, mix, inputs=("w", "u"), outputs=("z1", "z2", "y"))


def _synthesised(result: Synthesis) -> ComplementaryFilters:
    second = replace(result.controller, inputs=("y",), outputs=("filtered",))
    return ComplementaryFilters(_complement(second), second, result.norm)


def _complement(model: LinearModel) -> LinearModel:
    return replace(model, C=-model.C, D=1.0 - model.D)


def _both(frequency: Array, first: Array, second: Array) -> Array:
    shape = np.shape(frequency)
    return np.array([finite_array("first sensor", first, shape), finite_array("second sensor", second, shape)])
