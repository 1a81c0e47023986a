"""Spectral lines of a record or an FRF, and what a model with given poles makes of them."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from nassim.base.checks import Array
from nassim.base.modal import discretize_pole

TRANSIENT_ORDER = 3
STEP = 1e-4
"""Step of the derivatives by a pole, relative to its half-width."""


@dataclass(frozen=True, kw_only=True)
class Lines:
    """Spectral lines of one input and several outputs.

    omega: (n,) [rad/s]; excitation: (n,) complex; responses: (outputs, n) complex
    time_step: of the samples [s]; None where an FRF does not say
    transient: whether motion before and after a record is part of the model: True for records, False for FRFs
    hold_order: what the input does between samples, 0 or 1 as in `nassim.base.modal.discretize_pole`; None: no content
        above half the sample rate, or no time step is known
    residual_powers: p of the terms s^p that stand for modes outside the band
    known: what `compressed_lines` has made of stretches of them
    """

    omega: Array
    excitation: Array
    responses: Array
    time_step: float | None
    transient: bool
    hold_order: int | None
    residual_powers: tuple[int, ...]
    known: dict[tuple[int, int], Any] = field(default_factory=dict, init=False, repr=False)

    @property
    def held(self) -> Array:
        """Spectrum of the input as it runs between its samples, over that of the samples, (n,) complex."""
        if self.hold_order is None or self.time_step is None:
            return np.ones(len(self.omega), dtype=complex)
        half = 0.5 * self.omega * self.time_step
        sinc = np.sin(half) / half
        return sinc * np.exp(-1j * half) if self.hold_order == 0 else sinc**2 + 0j

    def mode(self, pole: Array) -> Array:
        """A mode's response to the input samples, with unit static gain; pole: (Hz, damping ratio); (n,) complex."""
        omega = 2 * np.pi * pole[0]
        if self.hold_order is None or self.time_step is None:
            denominator = omega**2 - self.omega**2 + 2j * pole[1] * omega * self.omega
            result: Array = omega**2 / denominator
            return result
        rate, back = self._rate(pole), np.exp(-1j * self.omega * self.time_step)

        def first_order(rate: complex) -> Array:
            assert self.time_step is not None
            assert self.hold_order is not None
            now, before, decay = discretize_pole(rate, self.time_step, hold_order=self.hold_order)
            result: Array = (now + before * back) / (1 - decay * back)
            return result

        difference: Array = first_order(rate) - first_order(np.conj(rate))
        return omega**2 * difference / (2j * rate.imag)

    def driven(self, poles: Array) -> Array:
        """What the input drives, per unit of it: modes, residual terms; poles (R, 2); (n, R + powers) complex."""
        residuals = [(1j * self.omega) ** power * self.held for power in self.residual_powers]
        return _side_by_side([self.mode(pole) for pole in poles] + residuals, self.omega)

    def left(self, poles: Array) -> Array:
        """What motion before and after a record leaves, of each mode and of all else; poles (R, 2); complex."""
        transients = [column for pole in poles for column in self._transients(pole)]
        return _side_by_side(transients + self._background(), self.omega)

    def seen(self, driven: Array, left: Array) -> Array:
        """Columns of both, (n, columns) each, as the responses are seen."""
        return np.concatenate([driven * self.excitation[:, None], left], axis=1)

    def columns(self, poles: Array) -> Array:
        """Everything that enters linearly: modes, residual terms, transients; poles (R, 2); (n, m) complex."""
        return self.seen(self.driven(poles), self.left(poles))

    def weights(self, weights: Array) -> Array:
        """Of weights of the lines, (outputs, n), those of the columns."""
        return weights

    def modelled(self, poles: Array, values: Array) -> Array:
        """The responses of the model, (outputs, n); values: of the columns, (outputs, m)."""
        return values @ self.columns(poles).T

    def derivatives(self, poles: Array, values: Array) -> Array:
        """Derivatives of columns(poles) @ values by log frequency, then log damping, (outputs, n, 2 R) complex.

        values: (outputs, m)
        """
        n_poles, n_linear = len(poles), len(self.residual_powers)
        result = np.zeros((*self.responses.shape, 2 * n_poles), dtype=complex)
        for r, pole in enumerate(poles):
            own = [r, *(n_poles + n_linear + 2 * r + k for k in range(2) if self.transient)]
            for k, step in enumerate((STEP * pole[1], STEP)):
                moved = [pole * np.exp(sign * step * (np.arange(2) == k)) for sign in (1, -1)]
                upper, lower = (self._own(pole) for pole in moved)
                result[:, :, k * n_poles + r] = values[:, own] @ ((upper - lower) / (2 * step)).T
        return result

    def _own(self, pole: Array) -> Array:
        """Columns of one mode."""
        return self.seen(self.mode(pole)[:, None], _side_by_side(self._transients(pole), self.omega))

    def _rate(self, pole: Array) -> complex:
        return 2 * np.pi * pole[0] * complex(-pole[1], np.sqrt(1 - pole[1] ** 2))

    def _transients(self, pole: Array) -> list[Array]:
        if not self.transient or self.time_step is None:
            return []
        back = np.exp(-1j * self.omega * self.time_step)
        rate = self._rate(pole) * self.time_step
        above, below = 1 / (1 - np.exp(rate) * back), 1 / (1 - np.exp(rate.conjugate()) * back)
        return [above + below, 1j * (above - below)]

    def _background(self) -> list[Array]:
        if not self.transient or self.time_step is None:
            return []
        s = 1j * self.omega * self.time_step
        drift = 1 / (1 - np.exp(-1j * self.omega * self.time_step))
        return [drift, *(s**power for power in range(TRANSIENT_ORDER + 1))]


def _side_by_side(columns: list[Array], omega: Array) -> Array:
    return np.stack(columns, axis=1) if columns else np.zeros((len(omega), 0), dtype=complex)
