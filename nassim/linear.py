"""The linear model of a scene: small motion about its start, in minimal coordinates; continuous or sampled."""

from dataclasses import dataclass, replace

import numpy as np

from nassim.assembly import Assembly, assemble
from nassim.checks import Array, finite_array, freeze, positive
from nassim.frf import FRF
from nassim.parts import Body, FlexibleBody
from nassim.scene import Scene
from nassim.statespace import StateSpace, discretize, transfer_matrix

ROUNDING = 1e-8
"""Growth rates below this share of the fastest pole are rounding: rigid motion's double pole has them."""


@dataclass(frozen=True)
class LinearModel:
    """State space dx/dt = A x + B u, y = C x + D u with named inputs and outputs.

    A: (n, n); B: (n, inputs); C: (outputs, n); D: (outputs, inputs)
    units: of the outputs
    time_step: [s] of a sampled model, x_(k+1) = A x_k + B u_k, whose inputs keep each sample's value until the next;
        None for a continuous one
    """

    A: Array
    B: Array
    C: Array
    D: Array
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    units: tuple[str, ...] = ()
    time_step: float | None = None

    def __post_init__(self) -> None:
        n, n_in, n_out = len(self.A), len(self.inputs), len(self.outputs)
        freeze(
            self,
            A=finite_array("A", self.A, (n, n)),
            B=finite_array("B", self.B, (n, n_in)),
            C=finite_array("C", self.C, (n_out, n)),
            D=finite_array("D", self.D, (n_out, n_in)),
            time_step=None if self.time_step is None else positive("time_step", self.time_step, "s"),
        )

    @property
    def matrices(self) -> StateSpace:
        """A, B, C and D."""
        return self.A, self.B, self.C, self.D

    def poles(self) -> Array:
        """Poles in the plane of s, complex, shape (n,) [rad/s]: eigenvalues of A, or ln(z)/T of a sampled model's z."""
        return s_plane(np.linalg.eigvals(self.A), self.time_step)


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


def linearize(scene: Scene) -> LinearModel:
    """The scene's linear model about its start, with the modal damping that the scene states.

    The states are the minimal coordinates' modal amplitudes and their rates, then the charges of ports that leak (as
    volts) and the outputs of amplifiers with a bandwidth. The scene's loops are open. Gravity's effect on stiffness and
    gyroscopic terms of a spinning body are not part of it.
    """
    state, drives, readings = state_space(assemble(scene))
    feedthrough = np.zeros((len(scene.outputs), len(scene.inputs)))
    units = tuple(sensor.unit for sensor in scene.sensors)
    return LinearModel(state, drives[:, :-1], readings, feedthrough, scene.inputs, scene.outputs, units)


def state_space(assembly: Assembly) -> tuple[Array, Array, Array]:
    """A, B and C of an assembled scene; the last column of B is gravity, a constant input of one.

    States: modal amplitudes and their rates, then the charges of circuits (as volts) and the amplifiers' outputs.
    """
    a = assembly
    omega = 2 * np.pi * a.frequency
    n, n_in, n_out = len(omega), a.input_matrix.shape[1], len(a.output_matrix)
    modes = a.basis @ a.shapes
    size = 2 * n + len(a.circuits) + len(a.amplifiers)
    state, drives, readings = np.zeros((size, size)), np.zeros((size, n_in + 1)), np.zeros((n_out, size))
    velocity = slice(n, 2 * n)
    state[:n, velocity] = np.eye(n)
    state[velocity, :n] = -np.diag(omega**2)
    state[velocity, velocity] = -np.diag(2 * a.damping_ratio * omega) - a.shapes.T @ a.damper_matrix @ a.shapes
    drives[velocity, :n_in], drives[velocity, n_in] = modes.T @ a.input_matrix, modes.T @ a.weight
    readings[:, :n] = a.output_matrix @ modes
    for j, circuit in enumerate(a.circuits, start=2 * n):
        pull = modes[a.slices[circuit.body]].T @ circuit.forces
        rate = 1 / (circuit.resistance * circuit.capacitance)
        state[velocity, j] = pull
        state[j, :n] = rate * pull / circuit.capacitance
        state[j, j] = -rate
        readings[circuit.output, j] = circuit.gain
    for j, amplifier in enumerate(a.amplifiers, start=2 * n + len(a.circuits)):
        state[velocity, j] = modes.T @ amplifier.forces
        state[j, j] = -amplifier.rate
        drives[j, amplifier.input] = amplifier.rate
    return state, drives, readings


def sampled(model: LinearModel, sample_rate: float) -> LinearModel:
    """A continuous model from sample to sample [Hz], exact for inputs that keep each sample's value until the next.

    Raises ValueError for a model that is sampled already.
    """
    if model.time_step is not None:
        raise ValueError(f"the model is sampled already, every {model.time_step:g} s; sample the continuous one")
    time_step = 1 / positive("sample_rate", sample_rate, "Hz")
    state, held, _ = discretize(model.A, model.B, time_step)
    return replace(model, A=state, B=held, time_step=time_step)


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


def truncation_error(scene: Scene, frequency: Array) -> Array:
    """Estimated relative error of a scene's FRFs due to the modes that its flexible bodies leave out.

    frequency: (n,) [Hz]. Returns |H / H_enriched - 1|, shape (outputs, inputs, n) [-], where H_enriched is the FRF of
    the scene with every body in its `enriched` form. Raises ValueError where a body has none.
    """
    bodies: list[Body] = []
    for body in scene.bodies:
        if isinstance(body, FlexibleBody):
            if body.reduced.enriched is None:
                raise ValueError(f"body {body.name!r} carries no enriched form, so its truncation error is unknown")
            bodies.append(replace(body, reduced=body.reduced.enriched))
        else:
            bodies.append(body)
    better = frequency_response(
        linearize(replace(scene, bodies=tuple(bodies), cutoff_frequency=None)), frequency
    ).values
    result: Array = np.abs(frequency_response(linearize(scene), frequency).values / better - 1)
    return result
