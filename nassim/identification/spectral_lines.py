"""Spectral lines of a record or an FRF, and the model of these lines for given poles."""

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from nassim.base.checks import Array
from nassim.base.modal import discretize_pole

TRANSIENT_ORDER = 3
DERIVATIVE_STEP = 1e-4
"""Step of the derivatives with respect to a pole, relative to its half-width."""


@dataclass(frozen=True, kw_only=True)
class Lines:
    """Spectral lines of one input and several outputs.

    Attributes:
        omega: angular frequencies, (n,) [rad/s].
        excitation: spectrum of the input, complex, (n,).
        responses: spectra of the outputs, complex, (outputs, n).
        time_step: time step of the samples; None where an FRF does not specify it [s].
        transient: whether the motion before and after a record is part of the model: True for records, False for FRFs.
        hold_order: behaviour of the input between samples, 0 or 1 as in `nassim.base.modal.discretize_pole`; None for
            an input without content above half the sample rate, or without a known time step.
        residual_powers: powers p of the terms s^p for modes outside the band.
        known: cells that `compressed_lines` has already compressed.
    """

    omega: Array
    excitation: Array
    responses: Array
    time_step: float | None
    transient: bool
    hold_order: int | None
    residual_powers: tuple[int, ...]
    known: dict[tuple[int, int], Any] = field(default_factory=dict, init=False)

    @cached_property
    def held(self) -> Array:
        """Spectrum of the input between its samples over that of the samples, complex, (n,)."""
        if self.hold_order is None or self.time_step is None:
            return np.ones(len(self.omega), dtype=complex)
        half = 0.5 * self.omega * self.time_step
        sinc = np.sin(half) / half
        return sinc * np.exp(-1j * half) if self.hold_order == 0 else sinc**2 + 0j

    def mode(self, pole: Array) -> Array:
        """Return the response of a mode with unit static gain to the input samples, complex, (n,).

        Args:
            pole: frequency [Hz] and damping ratio [-], (2,).
        """
        omega = 2 * np.pi * pole[0]
        if self.hold_order is None or self.time_step is None:
            denominator = omega**2 - self.omega**2 + 2j * pole[1] * omega * self.omega
            return omega**2 / denominator
        rate, back = self._rate(pole), self._back

        def first_order(rate: complex) -> Array:
            assert self.time_step is not None
            assert self.hold_order is not None
            now, before, decay = discretize_pole(rate, self.time_step, hold_order=self.hold_order)
            return (now + before * back) / (1 - decay * back)

        difference: Array = first_order(rate) - first_order(np.conj(rate))
        return omega**2 * difference / (2j * rate.imag)

    def driven_columns(self, poles: Array) -> Array:
        """Return the responses of modes and residual terms per unit of the input, complex, (n, R + powers).

        Args:
            poles: frequency [Hz] and damping ratio [-], (R, 2).
        """
        return _side_by_side([self.mode(pole) for pole in poles] + self._residuals, self.omega)

    def transient_columns(self, poles: Array) -> Array:
        """Return the transient terms of each mode and of all other motion, complex, (n, terms).

        Args:
            poles: frequency [Hz] and damping ratio [-], (R, 2).
        """
        transients = [column for pole in poles for column in self._transients(pole)]
        return _side_by_side(transients + self._background, self.omega)

    def joined_columns(self, driven: Array, left: Array) -> Array:
        """Return driven and transient columns, each (n, columns), in the scale of the responses."""
        return np.concatenate([driven * self.excitation[:, None], left], axis=1)

    def columns(self, poles: Array) -> Array:
        """Return all columns with linear parameters: modes, residual terms, transients, complex, (n, m).

        Args:
            poles: frequency [Hz] and damping ratio [-], (R, 2).
        """
        return self.joined_columns(self.driven_columns(poles), self.transient_columns(poles))

    def weights(self, weights: Array) -> Array:
        """Return the weights of the columns' rows from those of the lines, (outputs, n)."""
        return weights

    def modelled(self, poles: Array, values: Array) -> Array:
        """Return the responses of the model, (outputs, n).

        Args:
            poles: frequency [Hz] and damping ratio [-], (R, 2).
            values: linear parameters, (outputs, m).
        """
        return values @ self.columns(poles).T

    def derivatives(self, poles: Array, values: Array) -> Array:
        """Return derivatives of columns(poles) @ values with respect to log frequency, then log damping ratio.

        Args:
            poles: (R, 2).
            values: linear parameters, (outputs, m).

        Returns:
            Derivatives, complex, (outputs, n, 2 R).
        """
        n_poles, n_linear = len(poles), len(self.residual_powers)
        result = np.zeros((*self.responses.shape, 2 * n_poles), dtype=complex)
        for r, pole in enumerate(poles):
            own = [r, *(n_poles + n_linear + 2 * r + k for k in range(2) if self.transient)]
            for k, step in enumerate((DERIVATIVE_STEP * pole[1], DERIVATIVE_STEP)):
                moved = [pole * np.exp(sign * step * (np.arange(2) == k)) for sign in (1, -1)]
                upper, lower = (self._own(pole) for pole in moved)
                result[:, :, k * n_poles + r] = values[:, own] @ ((upper - lower) / (2 * step)).T
        return result

    def _own(self, pole: Array) -> Array:
        """Return the columns of one mode."""
        return self.joined_columns(self.mode(pole)[:, None], _side_by_side(self._transients(pole), self.omega))

    def _rate(self, pole: Array) -> complex:
        return 2 * np.pi * pole[0] * complex(-pole[1], np.sqrt(1 - pole[1] ** 2))

    def _transients(self, pole: Array) -> list[Array]:
        if not self.transient or self.time_step is None:
            return []
        rate = self._rate(pole) * self.time_step
        above, below = 1 / (1 - np.exp(rate) * self._back), 1 / (1 - np.exp(rate.conjugate()) * self._back)
        return [above + below, 1j * (above - below)]

    @cached_property
    def _back(self) -> Array:
        """Response of a delay by one sample, complex, (n,)."""
        assert self.time_step is not None
        return np.exp(-1j * self.omega * self.time_step)

    @cached_property
    def _residuals(self) -> list[Array]:
        """Columns of the residual terms."""
        return [(1j * self.omega) ** power * self.held for power in self.residual_powers]

    @cached_property
    def _background(self) -> list[Array]:
        """Columns of the transients of all motion but the modes'."""
        if not self.transient or self.time_step is None:
            return []
        s = 1j * self.omega * self.time_step
        drift = 1 / (1 - self._back)
        return [drift, *(s**power for power in range(TRANSIENT_ORDER + 1))]


def _side_by_side(columns: list[Array], omega: Array) -> Array:
    return np.stack(columns, axis=1) if columns else np.zeros((len(omega), 0), dtype=complex)
