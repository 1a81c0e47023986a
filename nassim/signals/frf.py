"""Frequency response functions and their estimation from recorded signals."""

import itertools
from collections.abc import Sequence
from dataclasses import field

import numpy as np
import scipy
from numpy.typing import NDArray

from nassim.base.checks import Array, finite, finite_array, freeze, known, positive, unique
from nassim.base.field_types import ArrayField, ArrayLike, Field, NameList, OptionalArray, data_class, held
from nassim.base.html_repr import html_repr
from nassim.base.progress import wrap_text
from nassim.base.short_repr import short_repr
from nassim.base.warning_log import warn
from nassim.signals.time_history import TimeHistory

ComplexArray = NDArray[np.complex128]

NO_POWER = 1e-20
"""Share of an input's largest power below which a line holds rounding errors only and counts as without power."""
SMALLEST_INDEPENDENT_SHARE = 1e-4
"""Smallest share of an input's power not explained by the other inputs, for an input that can be separated from them.

Below this share, noise at the outputs would appear in the response amplified by a factor of one hundred.
"""
SAMPLES_PER_BLOCK = 1_000_000
"""Largest number of samples of a signal that are transformed at once."""
LARGEST_DEPENDENT_SHARE = 0.1
"""Share of an input's power at lines where it cannot be separated, above which the estimate is refused."""


@data_class
class FRF:
    """A matrix of frequency response functions.

    Attributes:
        frequency: ascending frequencies, shape (n_frequencies,) [Hz]
        values: complex, shape (n_outputs, n_inputs, n_frequencies), output unit over input unit
        outputs: names of the rows
        inputs: names of the columns
        coherence: multiple coherence per output, shape (n_outputs, n_frequencies) [-]; None for an FRF from a model
        label: text for legends
    """

    frequency: ArrayField
    values: Field[ArrayLike, ComplexArray]
    outputs: NameList
    inputs: NameList
    coherence: OptionalArray = held(None)
    label: str = field(default="")
    __repr__ = short_repr
    _repr_html_ = html_repr

    def __post_init__(self) -> None:
        frequency = finite_array("frequency", self.frequency, (None,))
        outputs, inputs = unique("output", self.outputs), unique("input", self.inputs)
        try:
            values = np.array(self.values, dtype=complex)
        except (TypeError, ValueError) as error:
            raise ValueError("values must be complex numbers of shape (outputs, inputs, frequencies)") from error
        if values.shape != (len(outputs), len(inputs), len(frequency)):
            raise ValueError(f"values must have shape (outputs, inputs, frequencies), got {values.shape}")
        if not np.all(np.isfinite(values)):
            raise ValueError(
                f"values hold {int(np.sum(~np.isfinite(values)))} NaN or infinite entries; all must be finite"
            )
        if len(frequency) == 0 or np.any(np.diff(frequency) <= 0) or frequency[0] < 0:
            raise ValueError("frequency must be ascending, not negative and not empty")
        values.setflags(write=False)
        freeze(self, frequency=frequency, values=values, outputs=outputs, inputs=inputs)
        if self.coherence is not None:
            coherence = finite_array("coherence", self.coherence, (len(outputs), len(frequency)))
            if coherence.min() < 0 or coherence.max() > 1 + 1e-6:
                raise ValueError(f"coherence must lie in 0 ... 1, got {coherence.min():g} ... {coherence.max():g}")
            freeze(self, coherence=coherence)

    def __str__(self) -> str:
        """Describe the frequencies, the inputs and the outputs."""
        label = f" '{self.label}'" if self.label else ""
        count, ends = len(self.frequency), f"{self.frequency[0]:g} Hz to {self.frequency[-1]:g} Hz"
        lines = [f"frequency responses{label} at {count} frequencies from {ends}"]
        for what, names in (("inputs", self.inputs), ("outputs", self.outputs)):
            lines.append(wrap_text(f"  {what}: {', '.join(names)}", next_indent=" " * 6))
        return "\n".join(lines)

    def response(self, output: str, input: str) -> ComplexArray:
        """Return one entry of the matrix over frequency, complex, shape (n_frequencies,)."""
        row = self.outputs.index(known("output", output, self.outputs))
        column = self.inputs.index(known("input", input, self.inputs))
        return self.values[row, column]

    def band(self, lowest: float, highest: float) -> "FRF":
        """Return the part between two frequencies [Hz], both included."""
        keep = (self.frequency >= lowest) & (self.frequency <= highest)
        if not keep.any():
            raise ValueError(f"no frequency between {lowest:g} and {highest:g} Hz in this FRF")
        coherence = None if self.coherence is None else self.coherence[:, keep]
        return FRF(self.frequency[keep], self.values[:, :, keep], self.outputs, self.inputs, coherence, self.label)


def estimate_frf(
    history: TimeHistory,
    *,
    inputs: Sequence[str],
    outputs: Sequence[str],
    segment_duration: float,
    overlap: float = 0.5,
    window: str = "hann",
    method: str = "H1",
    label: str = "",
) -> FRF:
    """Estimate FRFs from signals recorded together, by averaging over windowed segments (Welch's method).

    At a line where an input has no power, the response to it is zero. Where no input has power, responses and coherence
    are zero. Where inputs cannot be separated, they are zero too, and a warning is given.

    Source: J. S. Bendat, A. G. Piersol, Random Data, 4th ed. (2010), ch. 6 and 7.

    Args:
        history: the record
        inputs: names of the input signals in `history`. With several inputs, which may differ in units and sizes, the
            full matrix is solved for
        outputs: names of the output signals in `history`
        segment_duration: length of a segment [s]; its inverse is the frequency resolution
        overlap: share by which segments overlap [-]
        window: a window of scipy.signal; "boxcar" for periodic signals
        method: "H1" = Syu Suu^-1 (noise at the outputs) or "H2" = Syy Suy^-1 (noise at the input; one input only)
        label: text for legends

    Raises:
        ValueError: for unknown names, for inputs that cannot be separated at lines with a large share of their power,
            and for a record without more segments than inputs (at least two), for which the coherence would be
            meaningless
    """
    known("method", method, ("H1", "H2"))
    inputs, outputs = unique("input", inputs), unique("output", outputs)
    if not inputs or not outputs:
        raise ValueError(f"name at least one input and one output; known signals: {', '.join(history.names)}")
    if method == "H2" and len(inputs) != 1:
        raise ValueError(f"H2 needs exactly one input, got {len(inputs)}; take H1")
    for name in inputs:
        if np.ptp(history[name]) == 0:
            raise ValueError(f"input {name!r} is constant: no response can be estimated from it")
    shape, step = _segments(history, len(inputs), segment_duration, overlap, window)
    frequency = np.fft.rfftfreq(len(shape), 1 / history.sample_rate)[1:]
    rows = [history[name] for name in (*inputs, *outputs)]
    power, n_in = _power(rows, len(inputs), shape, step)[1:], len(inputs)
    s_uu, s_yu = power[:, :n_in, :n_in], power[:, n_in:, :n_in]
    s_yy = power[:, n_in:, n_in].real
    h1 = _solve_lines(s_uu, s_yu, inputs, frequency)
    coherent_power = np.einsum("foi,foi->fo", h1, s_yu.conj()).real
    coherence = np.clip(coherent_power / np.maximum(s_yy, np.finfo(float).tiny), 0.0, 1.0)
    coherent = (np.abs(s_yu) > 0) & (h1 != 0)
    h2 = np.where(coherent, s_yy[:, :, None] / np.where(coherent, s_yu.conj(), 1.0), 0.0)
    values = h1 if method == "H1" else h2
    return FRF(frequency, values.transpose(1, 2, 0), outputs, inputs, coherence.T, label)


def _segments(
    history: TimeHistory, n_inputs: int, segment_duration: float, overlap: float, window: str
) -> tuple[Array, int]:
    """Return the window of a segment, (n_segment,), and the number of samples from one segment to the next.

    Raises:
        ValueError: for a record without more segments than inputs (at least two), and for an unknown window
    """
    if not 0 <= finite("overlap", overlap) < 1:
        raise ValueError(f"overlap must lie in 0 ... 1 (1 excluded), got {overlap:g}")
    n_segment = round(positive("segment_duration", segment_duration, "s") * history.sample_rate)
    step = n_segment - round(overlap * n_segment)
    if len(history.time) < n_segment + n_inputs * step or n_segment < 2:
        raise ValueError(
            f"a record of {history.duration:g} s holds fewer than {n_inputs + 1} segments of {segment_duration:g} "
            f"s, one more than inputs ({n_inputs}); record longer or take shorter segments"
        )
    if not step:
        raise ValueError(f"an overlap of {overlap:g} leaves no new sample to a segment of {n_segment}; take less")
    try:
        shape: Array = scipy.signal.get_window(window, n_segment)
    except (ValueError, TypeError) as error:
        raise ValueError(f"window {window!r} is none of scipy.signal's: {error}") from error
    return shape, step


def _power(rows: Sequence[Array], n_inputs: int, window: Array, step: int) -> ComplexArray:
    """Average X[row] conj(X[input]), and |X[row]|^2 as last entry, over segments; shape (lines, rows, inputs + 1).

    The rows are signals, the inputs first. `window` has one value per sample of a segment, and `step` is the number of
    samples from one segment to the next. The mean value of each segment is removed, and each is transformed once.
    """
    segments = [np.lib.stride_tricks.sliding_window_view(row, len(window))[::step] for row in rows]
    together = max(1, SAMPLES_PER_BLOCK // len(window))
    result = np.zeros((len(window) // 2 + 1, len(rows), n_inputs + 1), dtype=complex)
    for start in range(0, len(segments[0]), together):
        parts = [segment[start : start + together] for segment in segments]
        spectra = [scipy.fft.rfft((part - part.mean(axis=1, keepdims=True)) * window) for part in parts]
        for i, x in enumerate(spectra):
            for j, u in enumerate((*spectra[:n_inputs], x)):
                result[:, i, j] += np.einsum("sf,sf->f", x, u.conj())
    result /= len(segments[0])
    return result


def _solve_lines(s_uu: ComplexArray, s_yu: ComplexArray, inputs: tuple[str, ...], frequency: Array) -> ComplexArray:
    """Solve H Suu = Syu at each line, shape (n, outputs, inputs).

    H is zero where an input has no power or cannot be separated from the others. Inputs are scaled to unit power at
    every line, so their units do not matter. s_uu has the shape (n, inputs, inputs), s_yu (n, outputs, inputs).
    ValueError is raised if inputs cannot be separated at lines with a large share of their power.
    """
    power = np.einsum("fii->fi", s_uu).real
    carried = power > NO_POWER * power.max(axis=0)
    scale = np.where(carried, 1 / np.sqrt(np.where(carried, power, 1.0)), 0.0)
    unit = s_uu * scale[:, :, None] * scale[:, None, :]
    np.einsum("fii->fi", unit)[:] = 1.0
    sizes, vectors = np.linalg.eigh(unit)
    inverse = (vectors / np.maximum(sizes, np.finfo(float).eps)[:, None, :]) @ vectors.conj().transpose(0, 2, 1)
    alike = 1 / np.einsum("fii->fi", inverse).real < SMALLEST_INDEPENDENT_SHARE
    if alike.any():
        share = np.sum(power * alike, axis=0) / power.sum(axis=0)
        lines = alike.any(axis=1)
        coherence, involved = np.median(np.abs(unit[lines]) ** 2, axis=0), alike.any(axis=0)
        pairs = ", ".join(
            f"{inputs[a]} and {inputs[b]} {coherence[a, b]:.6f}"
            for a, b in itertools.combinations(range(len(inputs)), 2)
            if involved[a] or involved[b]
        )
        where = f"{lines.sum()} of {len(lines)} lines in {frequency[lines][0]:g} ... {frequency[lines][-1]:g} Hz"
        text = f"inputs cannot be separated at {where}; their ordinary coherence there: {pairs}"
        if share.max() > LARGEST_DEPENDENT_SHARE:
            raise ValueError(f"{text}: drive them independently, or name only one of them as input")
        warn(f"{text}; responses there are set to zero")
    usable = carried & ~alike.any(axis=1, keepdims=True)
    return np.where(usable[:, None, :], (s_yu * scale[:, None, :]) @ inverse * scale[:, None, :], 0.0)
