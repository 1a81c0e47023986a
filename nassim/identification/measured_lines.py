"""Spectral lines of a record or of an FRF within a band, as input to a fit of poles."""

import numpy as np
import scipy

from nassim.base.checks import Array, finite_array
from nassim.identification.spectral_lines import Lines
from nassim.signals.frf import FRF
from nassim.signals.time_history import TimeHistory, fast_length

UNEXCITED = 1e-6
"""Amplitude of the input, relative to its largest, below which a line contains no information."""
COHERENCE_LINES = 5
"""Number of neighbouring lines over which the noise derived from a coherence is averaged."""
END_ROUNDING = 1e-6
"""Relative distance of a line from the end of a band that counts as rounding, as of the steps of times since 1970."""


def lines_of_record(
    record: TimeHistory,
    input: str,
    outputs: tuple[str, ...],
    band: tuple[float, float],
    hold_order: int | None,
    powers: tuple[int, ...],
) -> Lines:
    """Return the DFT of input and outputs of a record within a band, without mean values.

    Args:
        record: the record.
        input: name of the input.
        outputs: names of the outputs.
        band: lowest and highest frequency [Hz].
        hold_order: see `Lines`.
        powers: `residual_powers` of `Lines`.

    Raises:
        ValueError: for unknown names, constant signals and a band outside the data.
    """
    for name in (input, *outputs):
        if np.ptp(record[name]) == 0:
            raise ValueError(f"signal {name!r} is constant: no response can be identified from it")
    n, step = fast_length(len(record.time)), 1 / record.sample_rate
    low, high = _band(band, 1 / (n * step), 0.5 / step)
    frequency = np.fft.rfftfreq(n, step)
    keep = _inside(frequency, low, high) & (frequency < 0.5 / step)
    excitation, *responses = (np.fft.rfft(y - y.mean())[keep] for y in (record[name][:n] for name in (input, *outputs)))
    excited = np.abs(excitation) > UNEXCITED * np.abs(excitation).max(initial=0.0)
    omega = 2 * np.pi * frequency[keep][excited]
    return Lines(
        omega=omega,
        excitation=excitation[excited],
        responses=np.stack(responses)[:, excited],
        time_step=step,
        transient=True,
        hold_order=hold_order,
        residual_powers=powers,
    )


def lines_of_frf(
    frf: FRF,
    input: str,
    outputs: tuple[str, ...],
    band: tuple[float, float],
    step: float | None,
    hold_order: int | None,
    powers: tuple[int, ...],
) -> tuple[Lines, Array | None]:
    """Return the lines of an FRF within a band, as the response to an input of 1, and the shape of the noise.

    Args:
        frf: the FRF.
        input: name of the input.
        outputs: names of the outputs.
        band: lowest and highest frequency [Hz].
        step: time step of the signals from which the FRF was estimated, where known [s].
        hold_order: see `Lines`.
        powers: `residual_powers` of `Lines`.

    Returns:
        The lines, and the standard deviation of the noise up to a factor, (outputs, n), from the coherence; None for an
        FRF without coherence and for one of several inputs: its coherence is that of all of them together.

    Raises:
        ValueError: for unknown names, a band outside the data or beyond half the sample rate, and responses that are
            zero.
    """
    responses = np.stack([frf.response(name, input) for name in outputs])
    low, high = _band(band, float(frf.frequency[0]), float(frf.frequency[-1]))
    if step is not None and high * step > 0.5 * (1 + 1e-9):
        raise ValueError(
            f"band {low:g} ... {high:g} Hz must end at half the sample_rate of {1 / step:g} Hz, above which samples "
            "show nothing"
        )
    keep = _inside(frf.frequency, low, high)
    responses, omega = responses[:, keep], 2 * np.pi * frf.frequency[keep]
    for name, response in zip(outputs, responses, strict=True):
        if not np.any(response):
            raise ValueError(f"the response of {name!r} is zero throughout the band")
    lines = Lines(
        omega=omega,
        excitation=np.ones(len(omega), dtype=complex),
        responses=responses,
        time_step=step,
        transient=False,
        hold_order=hold_order,
        residual_powers=powers,
    )
    if frf.coherence is None or len(frf.inputs) > 1:
        return lines, None
    rows = [frf.outputs.index(name) for name in outputs]
    coherence = np.clip(frf.coherence[rows][:, keep], 1e-6, 1 - 1e-9)
    # The variance of an estimated H is |H|^2 (1 - gamma^2) / gamma^2 over twice the number of averages (Bendat and
    # Piersol, ch. 9). The coherence gives its shape, and the residual gives its magnitude.
    shape = np.abs(responses) * np.sqrt((1 - coherence) / coherence)
    return lines, np.sqrt(scipy.ndimage.uniform_filter1d(shape**2, COHERENCE_LINES, axis=1))


def _inside(frequency: Array, low: float, high: float) -> Array:
    """Return which frequencies (n,) lie in a band, bool. Its ends count, whatever the rounding of a record's times."""
    return (frequency >= low * (1 - END_ROUNDING)) & (frequency <= high * (1 + END_ROUNDING))


def _band(band: tuple[float, float], lowest: float, highest: float) -> tuple[float, float]:
    low, high = finite_array("band", band, (2,))
    if not (0 < low < high and low >= lowest * (1 - 1e-9) and high <= highest * (1 + 1e-9)):
        raise ValueError(f"band {low:g} ... {high:g} Hz must ascend within the data's {lowest:g} ... {highest:g} Hz")
    return float(low), float(high)
