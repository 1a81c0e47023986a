"""Linear models with named inputs and outputs, continuous or sampled: poles, damping, frequency response."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
import scipy

from nassim.base.checks import Array, finite_array, freeze, known, positive, unique, units_of
from nassim.base.field_types import ArrayField, ArrayLike, NameList, data_class, held
from nassim.base.progress import wrap_text
from nassim.base.short_repr import short_repr
from nassim.base.tables import text_table
from nassim.signals.frf import FRF, ComplexArray
from nassim.systems.state_space import (
    StateSpace,
    balanced_states,
    discretize,
    quasi_static,
    settling_response,
    transmission_zeros,
)
from nassim.systems.transfer_matrices import refuse_infinite, transfer_matrix, warn_above_nyquist

GROWTH_ROUNDING = 1e-8
"""Growth rates below this fraction of the fastest pole's rate count as rounding, as in a double pole of rigid motion.
"""
Names = str | Sequence[str]


@data_class
class LinearModel:
    """State space dx/dt = A x + B u, y = C x + D u with named inputs and outputs.

    Attributes:
        A: state matrix, (n, n).
        B: input matrix, (n, inputs).
        C: output matrix, (outputs, n).
        D: feedthrough matrix, (outputs, inputs).
        inputs: names of the inputs.
        outputs: names of the outputs.
        units: units of the outputs; "" for each where none is given.
        time_step: time step of a sampled model x_(k+1) = A x_k + B u_k, whose inputs keep the value of each sample
            until the next; None for a continuous model [s].
        unsupported: frequency of the mode to which each of the first k states belongs, for modes above the range in
            which the model is valid; 0 for other states, (k,); see `sampled` [Hz].

    Raises:
        ValueError: for matrices whose shapes do not agree, names that are used twice, and another number of units.
    """

    A: ArrayField
    B: ArrayField
    C: ArrayField
    D: ArrayField
    inputs: NameList
    outputs: NameList
    units: NameList = held(())
    time_step: float | None = None
    unsupported: ArrayField = field(default_factory=held(lambda: np.zeros(0)), repr=False)
    __repr__ = short_repr

    def __post_init__(self) -> None:
        inputs, outputs = unique("input", self.inputs), unique("output", self.outputs)
        n, n_in, n_out = len(finite_array("A", self.A, (None, None))), len(inputs), len(outputs)
        freeze(
            self,
            A=finite_array("A", self.A, (n, n)),
            B=finite_array("B", self.B, (n, n_in)),
            C=finite_array("C", self.C, (n_out, n)),
            D=finite_array("D", self.D, (n_out, n_in)),
            inputs=inputs,
            outputs=outputs,
            units=units_of("output", self.units, outputs),
            time_step=None if self.time_step is None else positive("time_step", self.time_step, "s"),
            unsupported=finite_array("unsupported", self.unsupported, (None,)),
        )
        if len(self.unsupported) > n:
            raise ValueError(
                f"unsupported has {len(self.unsupported)} frequencies for {n} states; give those of the first states, "
                "or () for none"
            )

    def __str__(self) -> str:
        """Describe the model: how many states, which inputs, which outputs in which units."""
        kind = "continuous" if self.time_step is None else f"sampled, {1 / self.time_step:g} Hz"
        outputs = [f"{name} [{unit}]" if unit else name for name, unit in zip(self.outputs, self.units, strict=True)]
        lines = [f"linear model, {kind}, {len(self.A)} states"]
        for what, names in (("inputs", self.inputs), ("outputs", outputs)):
            lines.append(wrap_text(f"  {what}: {', '.join(names) or 'none'}", next_indent=" " * 6))
        return "\n".join(lines)

    @property
    def matrices(self) -> StateSpace:
        """The matrices A, B, C and D."""
        return self.A, self.B, self.C, self.D

    def unsupported_above(self, frequency: float) -> Array:
        """Return which states belong to modes in `unsupported` above a frequency [Hz], bool, (n,)."""
        result = np.zeros(len(self.A), dtype=bool)
        result[: len(self.unsupported)] = self.unsupported > frequency
        return result

    @cached_property
    def balanced_eigenvectors(self) -> tuple[Array, Array, Array, Array]:
        """Eigenvalues and eigenvectors of A in balanced states.

        Returns:
            Scale of the states, (n,), eigenvalues, (n,), and left and right eigenvectors as columns, (n, n) each.
        """
        balanced, scale = balanced_states(self.A)
        return (scale, *scipy.linalg.eig(balanced, left=True, right=True))

    def poles(self) -> Array:
        """Return the poles in the s-plane: the eigenvalues of A, or ln(z)/T for a sampled model.

        Returns:
            Poles, complex, (n,) [rad/s].
        """
        return s_plane(np.linalg.eigvals(self.A), self.time_step)


def zeros(model: LinearModel, *, inputs: Names | None = None, outputs: Names | None = None) -> Array:
    """Compute the invariant zeros between some inputs and the same number of outputs.

    The zeros between one input and one output are those of that response. A zero between several is a motion that
    continues while none of the outputs shows it. The poles of strong loops that hold these outputs tend to these zeros.
    The result includes poles that no such input moves or no such output shows. The zeros of a sampled model are ln(z)/T
    and include those caused by the sampling. `transmission_zeros` describes method, source and accuracy.

    Args:
        model: the linear model.
        inputs: one name or several; None for all.
        outputs: one name or several; None for all.

    Returns:
        Zeros in the s-plane, complex, (n,) [rad/s].

    Raises:
        ValueError: for unknown names, for different numbers of inputs and outputs, and where every s would be a zero.
    """
    part = subsystem(model, inputs=inputs, outputs=outputs)
    return s_plane(transmission_zeros(part.matrices), model.time_step)


def subsystem(model: LinearModel, *, inputs: Names | None = None, outputs: Names | None = None) -> LinearModel:
    """Return the part of a model between some inputs and some outputs, in the order given, with all states.

    Args:
        model: the linear model.
        inputs: one name or several; None for all.
        outputs: one name or several; None for all.

    Raises:
        ValueError: for unknown names.
    """
    rows = [model.outputs.index(n) for n in _chosen("output", outputs, model.outputs)]
    columns = [model.inputs.index(n) for n in _chosen("input", inputs, model.inputs)]
    return replace(
        model,
        B=model.B[:, columns],
        C=model.C[rows],
        D=model.D[np.ix_(rows, columns)],
        inputs=tuple(model.inputs[k] for k in columns),
        outputs=tuple(model.outputs[k] for k in rows),
        units=tuple(model.units[k] for k in rows),
    )


@dataclass(frozen=True)
class UnstablePole:
    """Growing motion of an unstable model.

    Attributes:
        frequency: frequency of the oscillation; 0 for a drift [Hz].
        growth_rate: rate of the amplitude exp(growth_rate * t) [1/s].
    """

    frequency: float
    growth_rate: float
    __repr__ = short_repr

    def __str__(self) -> str:
        """Describe the motion for a message."""
        motion = f"an oscillation at {self.frequency:.4g} Hz" if self.frequency else "a drift"
        return f"{motion} that grows e-fold in {1 / self.growth_rate:.3g} s"


def sampled(model: LinearModel, sample_rate: float) -> LinearModel:
    """Sample a model, exactly for inputs that keep the value of each sample until the next.

    Of a model that is sampled already, the result has every second or every so many of its samples.

    Modes in `LinearModel.unsupported` (for a scene see `Scene.quasi_static_above`) become quasi-static when they lie
    above half the sample rate. Otherwise they would fold to frequencies as uncertain as their own. Their contribution
    to the outputs follows from the last two values of the inputs (`nassim.systems.state_space.settling_response`).
    These values are additional states, the last ones.

    Args:
        model: continuous or sampled model.
        sample_rate: samples per second [Hz]; the rate of a sampled model is a whole multiple of it.

    Returns:
        Sampled model.

    Raises:
        ValueError: for a model that is sampled at a rate that is no such multiple.
    """
    time_step = 1 / positive("sample_rate", sample_rate, "Hz")
    if model.time_step is not None:
        return _every(model, time_step)
    slow, drives, kept, taken = quasi_static(model.A, model.B, model.unsupported_above(sample_rate / 2))
    state, held, _ = discretize(slow, drives, time_step)
    a, b, c, d = settling_response((state, held, model.C @ kept, model.D), model.C @ taken)
    return replace(model, A=a, B=b, C=c, D=d, time_step=time_step, unsupported=np.zeros(0))


def _every(model: LinearModel, time_step: float) -> LinearModel:
    """Return a sampled model at every so many of its samples, with inputs that keep their value between these."""
    assert model.time_step is not None
    ratio = time_step / model.time_step
    count = round(ratio)
    if abs(ratio - count) > 1e-9 * count:
        raise ValueError(
            f"the model is sampled already, at {1 / model.time_step:g} Hz, which is {ratio:.6g} times "
            f"{1 / time_step:g} Hz; take a whole number of its samples, or sample the continuous model"
        )
    n, m = model.B.shape
    steps = np.linalg.matrix_power(np.block([[model.A, model.B], [np.zeros((m, n)), np.eye(m)]]), count)
    return replace(model, A=steps[:n, :n], B=steps[:n, n:], time_step=time_step)


def frequency_response(model: LinearModel, frequency: ArrayLike, *, label: str = "linear model") -> FRF:
    """Compute the FRF of a linear model; for a sampled model, from sample to sample.

    Args:
        model: the linear model.
        frequency: (n,) [Hz].
        label: label of the FRF.

    Returns:
        FRF with values (outputs, inputs, n).

    Raises:
        ValueError: for frequencies at which the model has an undamped pole, such as 0 Hz with a free motion.

    Warns:
        UserWarning: for a sampled model and frequencies above half its sample rate, where its response only repeats.
    """
    frequency = finite_array("frequency", frequency, (None,))
    values = response_values(model, frequency)
    warn_above_nyquist("model", frequency, model.time_step)
    return FRF(frequency, values, model.outputs, model.inputs, None, label)


def response_values(model: LinearModel, frequency: Array) -> ComplexArray:
    """Return the values of `frequency_response`, complex, (outputs, inputs, n), at frequencies, (n,) [Hz]."""
    values = transfer_matrix(model.matrices, z_plane(2j * np.pi * frequency, model.time_step))
    refuse_infinite(frequency, values)
    return values


class PoleDamping(NamedTuple):
    """Natural frequencies and damping ratios of poles, a pair of arrays that prints as a table.

    Attributes:
        frequency: natural frequencies, (n,) [Hz].
        ratio: damping ratios, (n,) [-].
    """

    frequency: Array
    ratio: Array

    def __str__(self) -> str:
        """Return a table with a line for each pole."""
        rows = [(f"{f:.5g}", f"{z:.3g}") for f, z in zip(self.frequency, self.ratio, strict=True)]
        return text_table([("frequency [Hz]", "damping ratio [-]"), *rows])


def damping(model: LinearModel) -> PoleDamping:
    """Compute the natural frequency |s| / 2 pi and the damping ratio -Re s / |s| of every pole.

    Args:
        model: the linear model.

    Returns:
        Frequency, ascending, (n,) [Hz], and damping ratio, (n,) [-], with one entry per pair of conjugate poles. They
        unpack like a tuple and print as a table. A growing motion has a negative ratio, a real pole has 1 or -1, and a
        pole at the origin, within rounding, has 0. A free motion of a scene has two poles at the origin, so two entries
        of 0 Hz; against viscous friction or back-EMF it has one.
    """
    poles = model.poles()
    poles = np.where(np.abs(poles) <= GROWTH_ROUNDING * np.abs(poles).max(initial=0.0), 0.0, poles)
    poles = poles[np.argsort(np.abs(poles))]
    return PoleDamping(*frequency_and_damping(poles[poles.imag >= 0]))


def unstable_poles(model: LinearModel) -> tuple[UnstablePole, ...]:
    """Return the growing motions of a linear model, the fastest first, one entry per oscillation.

    A pole that grows by less than 1e-8 of the rate of the fastest pole counts as a pole at the origin, and in a sampled
    model by less than 1e-8 of pi times the sample rate, or of 37 times this rate with poles at z = 0, such as those of
    delays. The result of a stable model is empty.

    Args:
        model: the linear model.
    """
    return growing_poles(model.poles(), model.time_step)


def growing_poles(poles: Array, time_step: float | None = None) -> tuple[UnstablePole, ...]:
    """Return those of poles, complex (n,) [rad/s], that grow, see `unstable_poles`; arguments as `is_growing`."""
    return as_unstable(poles[is_growing(poles, time_step)])


def as_unstable(growing: Array) -> tuple[UnstablePole, ...]:
    """Return growing poles, complex (n,) [rad/s], as `unstable_poles` does."""
    growing = growing[growing.imag >= 0]
    growing = growing[np.argsort(-growing.real)]
    return tuple(UnstablePole(float(s.imag) / (2 * np.pi), float(s.real)) for s in growing)


def is_growing(poles: Array, time_step: float | None) -> Array:
    """Return which poles [rad/s], shape (..., n), grow by more than rounding explains, bool.

    Args:
        poles: complex, (..., n) [rad/s].
        time_step: of a sampled model [s].
    """
    fastest = 0.0 if time_step is None else np.pi / time_step
    return poles.real > GROWTH_ROUNDING * np.abs(poles).max(axis=-1, keepdims=True, initial=fastest)


def frequency_and_damping(poles: Array) -> tuple[Array, Array]:
    """Compute the natural frequency [Hz] and the damping ratio [-] of poles [rad/s], in the shape of the poles.

    Args:
        poles: complex, of any shape [rad/s].

    Returns:
        Frequency [Hz] and damping ratio [-], each in the shape of the poles.
    """
    size = np.abs(poles)
    return size / (2 * np.pi), 0.0 - poles.real / np.where(size > 0, size, 1.0)


def s_plane(z: Array, time_step: float | None) -> Array:
    """Return poles in the s-plane [rad/s].

    They are the eigenvalues themselves of a continuous model, ln(z)/T of a sampled one with |z| of at least 1e-16.

    Args:
        z: eigenvalues, complex.
        time_step: time step of a sampled model, or None [s].
    """
    if time_step is None:
        return z
    return (np.log(np.maximum(np.abs(z), 1e-16)) + 1j * np.angle(z + 0.0)) / time_step


def z_plane(s: Array, time_step: float | None) -> Array:
    """Return where the frequency response at s [rad/s] is evaluated: at s, or at exp(s T) for a sampled model.

    Args:
        s: complex [rad/s].
        time_step: time step of a sampled model, or None [s].
    """
    return s if time_step is None else np.exp(s * time_step)


def transmissibility(frf: FRF, *, output: str, ground: str) -> FRF:
    """Compute the ratio of absolute motion to ground motion from an FRF of relative motion over ground acceleration.

    The ground moves by w with the acceleration a = -omega^2 w, so that (w + x) / w = 1 - omega^2 x / a. The output must
    read x along the direction of the ground's motion, without a low-pass; an FRF does not tell. Of loops, take the
    model `linearize_closed(scene, continuous=True)`: a sampled one holds a between its samples, half a sample late,
    which leaves an error of pi f / sample rate, many times the transmissibility of an isolator.

    Args:
        frf: FRF that contains both signals.
        output: displacement x relative to the ground, along the axis of `ground` [m].
        ground: input a of a `GroundAcceleration` [m/s2].

    Returns:
        FRF of "absolute motion" over "ground" [m/m].
    """
    values = 1 - (2 * np.pi * frf.frequency) ** 2 * frf.response(output, ground)
    return FRF(frf.frequency, values[None, None], ("absolute motion",), ("ground",), None, frf.label)


def names(kind: str, value: Names) -> tuple[str, ...]:
    """Return one name or several as a tuple; raise ValueError if a name is empty or occurs twice.

    Args:
        kind: description of the names, for messages.
        value: one name or several.
    """
    return unique(kind, (value,) if isinstance(value, str) else value)


def _chosen(kind: str, value: Names | None, allowed: tuple[str, ...]) -> tuple[str, ...]:
    return allowed if value is None else tuple(known(kind, name, allowed) for name in names(kind, value))
