"""Linear models with named inputs and outputs, continuous or sampled: poles, damping, frequency response."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from nassim.base.checks import Array, finite_array, freeze, known, positive, unique
from nassim.signals.frf import FRF
from nassim.systems.state_space import (
    StateSpace,
    discretize,
    quasi_static,
    settling_response,
    transfer_matrix,
    transmission_zeros,
)

ROUNDING = 1e-8
"""Growth rates below this share of the fastest pole are rounding: rigid motion's double pole has them."""
Names = str | Sequence[str]


@dataclass(frozen=True)
class LinearModel:
    """State space dx/dt = A x + B u, y = C x + D u with named inputs and outputs.

    A: (n, n); B: (n, inputs); C: (outputs, n); D: (outputs, inputs)
    units: of the outputs
    time_step: [s] of a sampled model, x_(k+1) = A x_k + B u_k, whose inputs keep each sample's value until the next;
        None for a continuous one
    unsupported: frequency [Hz] of the mode that a state belongs to where the model's maker does not answer for that
        mode, 0 for other states, (k,) of the first k states; see `sampled`
    """

    A: Array
    B: Array
    C: Array
    D: Array
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    units: tuple[str, ...] = ()
    time_step: float | None = None
    unsupported: Array = field(default_factory=lambda: np.zeros(0), repr=False)

    def __post_init__(self) -> None:
        n, n_in, n_out = len(self.A), len(self.inputs), len(self.outputs)
        freeze(
            self,
            A=finite_array("A", self.A, (n, n)),
            B=finite_array("B", self.B, (n, n_in)),
            C=finite_array("C", self.C, (n_out, n)),
            D=finite_array("D", self.D, (n_out, n_in)),
            time_step=None if self.time_step is None else positive("time_step", self.time_step, "s"),
            unsupported=finite_array("unsupported", self.unsupported, (None,)),
        )
        if len(self.unsupported) > n:
            raise ValueError(
                f"unsupported has {len(self.unsupported)} frequencies for {n} states; give those of the first states, "
                "or () for none"
            )

    @property
    def matrices(self) -> StateSpace:
        """A, B, C and D."""
        return self.A, self.B, self.C, self.D

    def poles(self) -> Array:
        """Poles in the plane of s, complex, shape (n,) [rad/s]: eigenvalues of A, or ln(z)/T of a sampled model's z."""
        return s_plane(np.linalg.eigvals(self.A), self.time_step)


def zeros(model: LinearModel, *, inputs: Names | None = None, outputs: Names | None = None) -> Array:
    """Invariant zeros between some inputs and as many outputs, complex, shape (n,) [rad/s], in the plane of s.

    inputs, outputs: one name or several; None for all. One of each: the zeros of that response. Several: where some
        motion goes on that none of the outputs shows, which is where the poles go when strong loops keep them still

    Poles that no such input moves, or no such output shows, are among them. Zeros of a sampled model are ln(z)/T, those
    that come of the sampling included. Sources and accuracy: `transmission_zeros`. Raises ValueError for unknown names,
    for other numbers of outputs than of inputs, and where every s would be a zero.
    """
    rows = [model.outputs.index(n) for n in _chosen("output", outputs, model.outputs)]
    columns = [model.inputs.index(n) for n in _chosen("input", inputs, model.inputs)]
    system = model.A, model.B[:, columns], model.C[rows], model.D[np.ix_(rows, columns)]
    return s_plane(transmission_zeros(system), model.time_step)


@dataclass(frozen=True)
class UnstablePole:
    """A motion that grows by itself.

    frequency: of the oscillation, 0 for a drift [Hz]; growth_rate: the amplitude grows with exp(growth_rate * t) [1/s]
    """

    frequency: float
    growth_rate: float

    def __str__(self) -> str:
        """In words, for a message."""
        motion = f"an oscillation at {self.frequency:.4g} Hz" if self.frequency else "a drift"
        return f"{motion} that grows e-fold in {1 / self.growth_rate:.3g} s"


def sampled(model: LinearModel, sample_rate: float) -> LinearModel:
    """A continuous model from sample to sample [Hz], exact for inputs that keep each sample's value until the next.

    Modes that the model's maker does not answer for (`LinearModel.unsupported`; of a scene see
    `Scene.quasi_static_above`) are quasi-static where they lie above half of the sample rate: they would fold below it,
    to where their uncertain frequencies put them. What they add to outputs follows from the last two values of the
    inputs (`nassim.systems.state_space.settling_response`), which are further states, the last ones.
    Raises ValueError for a model that is sampled already.
    """
    if model.time_step is not None:
        raise ValueError(f"the model is sampled already, every {model.time_step:g} s; sample the continuous one")
    time_step = 1 / positive("sample_rate", sample_rate, "Hz")
    fast = np.zeros(len(model.A), dtype=bool)
    fast[: len(model.unsupported)] = model.unsupported > sample_rate / 2
    slow, drives, kept, taken = quasi_static(model.A, model.B, fast)
    state, held, _ = discretize(slow, drives, time_step)
    a, b, c, d = settling_response((state, held, model.C @ kept, model.D), model.C @ taken)
    return replace(model, A=a, B=b, C=c, D=d, time_step=time_step, unsupported=np.zeros(0))


def frequency_response(model: LinearModel, frequency: Array, *, label: str = "linear model") -> FRF:
    """FRF of a linear model at the given frequencies, shape (n,) [Hz]; of a sampled one from sample to sample."""
    frequency = finite_array("frequency", frequency, (None,))
    values = transfer_matrix(model.matrices, z_plane(2j * np.pi * frequency, model.time_step))
    return FRF(frequency, values, model.outputs, model.inputs, None, label)


def damping(model: LinearModel) -> tuple[Array, Array]:
    """Natural frequency |s| / 2 pi [Hz], ascending, and damping ratio -Re s / |s| [-] of every pole.

    One entry per pair of conjugate poles, shape (n,). Negative damping grows; a real pole has 1 or -1, one at rest 0.
    """
    poles = model.poles()
    poles = poles[np.argsort(np.abs(poles))]
    return frequency_and_damping(poles[poles.imag >= 0])


def unstable_poles(model: LinearModel) -> tuple[UnstablePole, ...]:
    """What grows by itself in a linear model, fastest first, one entry per oscillation; empty for a stable one.

    Poles that grow by less than 1e-8 of the fastest pole's rate count as being at rest.
    """
    poles = model.poles()
    growing = poles[is_growing(poles) & (poles.imag >= 0)]
    growing = growing[np.argsort(-growing.real)]
    return tuple(UnstablePole(float(s.imag) / (2 * np.pi), float(s.real)) for s in growing)


def is_growing(poles: Array) -> Array:
    """Which poles [rad/s], shape (..., n), grow by more than rounding explains."""
    result: Array = poles.real > ROUNDING * np.abs(poles).max(axis=-1, keepdims=True, initial=0.0)
    return result


def frequency_and_damping(poles: Array) -> tuple[Array, Array]:
    """Natural frequency [Hz] and damping ratio [-] of poles [rad/s], of their shape."""
    size = np.abs(poles)
    return size / (2 * np.pi), -poles.real / np.where(size > 0, size, 1.0)


def s_plane(z: Array, time_step: float | None) -> Array:
    """Poles in the plane of s [rad/s] from eigenvalues: themselves, or ln(z)/T; |z| below 1e-16 counts as that."""
    if time_step is None:
        return z
    result: Array = (np.log(np.maximum(np.abs(z), 1e-16)) + 1j * np.angle(z + 0.0)) / time_step
    return result


def z_plane(s: Array, time_step: float | None) -> Array:
    """Where the frequency response at s [rad/s] is read: s itself, or exp(s T) of a sampled model."""
    return s if time_step is None else np.exp(s * time_step)


def transmissibility(frf: FRF, *, output: str, ground: str) -> FRF:
    """Absolute motion over the ground's, from an FRF of motion relative to the ground over the ground's acceleration.

    output: relative displacement x [m]; ground: input a of a `GroundAcceleration` [m/s2]. Where the ground moves by w,
    a = -omega^2 w, so (w + x) / w = 1 - omega^2 x / a. Returns an FRF of "absolute motion" over "ground" [m/m].
    """
    values = 1 - (2 * np.pi * frf.frequency) ** 2 * frf.response(output, ground)
    return FRF(frf.frequency, values[None, None], ("absolute motion",), ("ground",), None, frf.label)


def names(kind: str, value: Names) -> tuple[str, ...]:
    """One name or several as a tuple; raises ValueError if one is empty or occurs twice."""
    return unique(kind, (value,) if isinstance(value, str) else value)


def _chosen(kind: str, value: Names | None, allowed: tuple[str, ...]) -> tuple[str, ...]:
    return allowed if value is None else tuple(known(kind, name, allowed) for name in names(kind, value))
