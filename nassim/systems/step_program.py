"""Sampled systems with digital controllers as a few matrices: what runs at each sample, without any object of a scene.

A program is what C code is written from, and it also runs here, in double or single precision. A program without
controllers is the linear step x_(k+1) = A x_k + B u_k with the outputs C x_k + D u_k.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import DTypeLike

from nassim.base.checks import Array, positive
from nassim.base.short_repr import short_repr
from nassim.systems.linear_model import LinearModel, sampled
from nassim.systems.state_space import StateSpace, discretize, quasi_static

NEAR_POLE = 1e-6
"""Distance of a rate from a pole, relative to the rate, below which no mean of a step response is known."""

ROUNDING = 1e-9
"""Relative amount by which a limit may fall short of a whole number of steps."""


@dataclass(frozen=True)
class ProgramSignal:
    """An input or output of a program.

    Attributes:
        name: name of the signal.
        unit: its unit; empty where it is not known.
        description: one line about the signal.
        size: typical magnitude of an input, in its unit.
    """

    name: str
    unit: str = ""
    description: str = ""
    size: float = 1.0


@dataclass(frozen=True)
class Converter:
    """Quantisation and limits of a value: a converter, or the limit of a controller.

    Attributes:
        step: resolution; 0 for none.
        limit: largest magnitude; infinite for none.
    """

    step: float
    limit: float

    @property
    def largest_count(self) -> float:
        """Largest number of steps within the limit; infinite for none."""
        return steps_within(self.limit, self.step)

    def __call__(self, values: Array) -> Array:
        """Convert values, of any shape."""
        if not self.step:
            return np.clip(values, -self.limit, self.limit)
        kind = values.dtype.type
        counts = np.clip(np.rint(values / kind(self.step)), -self.largest_count, self.largest_count)
        return kind(self.step) * counts


def steps_within(limit: float, step: float) -> float:
    """Return the number of whole steps within a limit, that of 0.1 in 0.3 also where rounding divides them to 2.9999.

    Args:
        limit: largest magnitude; infinite for none.
        step: resolution.
    """
    return math.floor(limit / step * (1 + ROUNDING)) if limit < math.inf else math.inf


@dataclass(frozen=True)
class SampleMatrices:
    """Matrices of one sample, which depend on the controllers that take a sample then.

    Attributes:
        due: whether some controller takes a sample.
        state: next state per unit of the state and of the converted values, (n, n + raw).
        outputs: outputs per unit of the state, (outputs - commands, n).
        corrections: next state per unit of what limits take from the controllers' outputs, (n, computed).
    """

    due: bool
    state: Array
    outputs: Array
    corrections: Array
    __repr__ = short_repr


@dataclass(frozen=True, kw_only=True)
class StepProgram:
    """A sampled system, with or without digital controllers, at fixed time steps.

    At each sample the raw values are R x + T u. The first are measured values, which are converted and less the
    references; the others are the outputs of controllers, to which the gains times the measured values are added before
    they are converted. The next state is a product with the state, the converted values and the inputs.

    Attributes:
        time_step: time between samples [s].
        inputs: the inputs.
        outputs: the outputs, then the commands of controllers.
        start: state at the first sample for inputs of zero, (n,).
        start_by_inputs: change of that state per unit of the inputs at the first sample, (n, inputs).
        samples: matrices of each kind of sample.
        phases: kind of sample k, at the place k modulo the number of places.
        taken: next state per unit of the inputs, (n, inputs).
        feedthrough: outputs per unit of the inputs, (outputs - commands, inputs).
        reading: R, raw values per unit of the state, (raw, n).
        through: T, raw values per unit of the inputs, (raw, inputs).
        reference: references per unit of the inputs, (measured, inputs).
        gains: controllers' outputs per unit of the converted measured values, (computed, measured).
        converters: of each raw value.
        commands: slice of the commands that act among the states.
    """

    time_step: float
    inputs: tuple[ProgramSignal, ...]
    outputs: tuple[ProgramSignal, ...]
    start: Array
    start_by_inputs: Array
    samples: tuple[SampleMatrices, ...]
    phases: tuple[int, ...]
    taken: Array
    feedthrough: Array
    reading: Array
    through: Array
    reference: Array
    gains: Array
    converters: tuple[Converter, ...]
    commands: slice
    __repr__ = short_repr

    @property
    def n_states(self) -> int:
        """Number of states."""
        return len(self.start)

    @property
    def n_measured(self) -> int:
        """Number of measured values."""
        return len(self.reference)


def linear_program(
    system: StateSpace,
    time_step: float,
    inputs: tuple[ProgramSignal, ...],
    outputs: tuple[ProgramSignal, ...],
    start: Array,
    start_by_inputs: Array,
) -> StepProgram:
    """Make the program of a sampled system without controllers.

    Args:
        system: its matrices.
        time_step: [s].
        inputs: the inputs.
        outputs: the outputs.
        start: state at the first sample for inputs of zero, (n,).
        start_by_inputs: change of that state per unit of the inputs at the first sample, (n, inputs).

    Returns:
        The program.
    """
    a, b, c, d = system
    n, n_in = b.shape
    return StepProgram(
        time_step=time_step,
        inputs=inputs,
        outputs=outputs,
        start=start,
        start_by_inputs=start_by_inputs,
        samples=(SampleMatrices(False, a, c, np.zeros((n, 0))),),
        phases=(0,),
        taken=b,
        feedthrough=d,
        reading=np.zeros((0, n)),
        through=np.zeros((0, n_in)),
        reference=np.zeros((0, n_in)),
        gains=np.zeros((0, 0)),
        converters=(),
        commands=slice(n, n),
    )


def step_program(model: LinearModel, time_step: float | None = None, *, hold_order: int = 0) -> StepProgram:
    """Make the program of a linear model, which steps exactly and starts at rest.

    Args:
        model: the linear model.
        time_step: of a continuous model [s]; None for a sampled model, which has its own.
        hold_order: 0 for inputs that keep the value of each sample until the next; 1 for inputs that run straight
            between samples, of a continuous model.

    Returns:
        The program.

    Raises:
        ValueError: for a continuous model without a time step, a sampled model with another time step or with
            `hold_order` 1, and another `hold_order`.
    """
    if hold_order not in (0, 1):
        raise ValueError(f"hold_order must be 0 or 1, got {hold_order!r}")
    system, shift, step = _steps(model, time_step, hold_order)
    return linear_program(system, step, *_signals(model), np.zeros(len(system[0])), -shift)


def _signals(model: LinearModel) -> tuple[tuple[ProgramSignal, ...], tuple[ProgramSignal, ...]]:
    """Return the inputs and the outputs of a linear model."""
    outputs = tuple(ProgramSignal(name, unit) for name, unit in zip(model.outputs, model.units, strict=True))
    return tuple(ProgramSignal(name) for name in model.inputs), outputs


def _steps(model: LinearModel, time_step: float | None, hold_order: int) -> tuple[StateSpace, Array, float]:
    """Return the matrices of the exact step, the shift H of the state x - H u, (n, inputs), and the time step [s]."""
    if model.time_step is not None:
        if time_step is not None and not math.isclose(time_step, model.time_step, rel_tol=1e-9):
            raise ValueError(
                f"the model is sampled every {model.time_step:g} s, not every {time_step:g} s; leave time_step out"
            )
        if hold_order:
            raise ValueError("a sampled model holds its inputs; hold_order=1 needs a continuous model")
        return model.matrices, np.zeros_like(model.B), model.time_step
    if time_step is None:
        raise ValueError("a continuous model needs time_step, the time between samples [s]")
    step = positive("time_step", time_step, "s")
    if hold_order == 0:
        held = sampled(model, 1 / step)
        return held.matrices, np.zeros_like(held.B), step
    slow, drives, kept, taken = quasi_static(model.A, model.B, model.unsupported_above(0.5 / step))
    state, held_inputs, risen = discretize(slow, drives, step)
    readings = model.C @ kept
    direct = model.D + model.C @ taken + readings @ risen
    return (state, held_inputs - risen + state @ risen, readings, direct), risen, step


def run_program(program: StepProgram, inputs: Array, *, precision: DTypeLike = float) -> Array:
    """Run a program from its start.

    Args:
        program: the program.
        inputs: values at each sample, (inputs, n_samples).
        precision: type of all numbers: float, or numpy.float32 for single precision.

    Returns:
        Outputs and commands at each sample, (outputs, n_samples).
    """
    kind = np.dtype(precision)
    given = np.asarray(inputs, dtype=kind).T
    split, n = program.n_measured, program.n_states
    taken, feedthrough = program.taken.astype(kind), program.feedthrough.astype(kind)
    reading, through = program.reading.astype(kind), program.through.astype(kind)
    reference, gains = program.reference.astype(kind), program.gains.astype(kind)
    samples = [tuple(m.astype(kind) for m in (one.state, one.outputs, one.corrections)) for one in program.samples]
    limits = np.array([converter.limit for converter in program.converters[split:]], dtype=kind)
    state = (program.start + program.start_by_inputs @ inputs[:, 0]).astype(kind)
    result = np.empty((len(given), len(program.outputs)), dtype=kind)
    for k, now in enumerate(given):
        phase = program.phases[k % len(program.phases)]
        step, shown, corrections = samples[phase]
        raw, excess = np.zeros(len(reading), dtype=kind), np.zeros(len(limits), dtype=kind)
        if program.samples[phase].due:
            raw = reading @ state + through @ now
            raw[:split] = _converted(program.converters[:split], raw[:split]) - reference @ now
            computed = raw[split:] + gains @ raw[:split]
            excess = np.clip(computed, -limits, limits) - computed
            raw[split:] = _converted(program.converters[split:], computed)
        after = step[:, :n] @ state + step[:, n:] @ raw + taken @ now + corrections @ excess
        result[k, : len(shown)] = shown @ state + feedthrough @ now
        result[k, len(shown) :] = after[program.commands]
        state = after
    return result.T


def _converted(converters: tuple[Converter, ...], values: Array) -> Array:
    return np.array([of(value) for of, value in zip(converters, values, strict=True)], dtype=values.dtype)


@dataclass(frozen=True, kw_only=True)
class RateProgram:
    """A continuous linear system dx/dt = A x + B u, y = C x + D u with its start.

    Attributes:
        matrices: A, B, C and D.
        inputs: the inputs.
        outputs: the outputs.
        start: state at the start, (n,).
    """

    matrices: StateSpace
    inputs: tuple[ProgramSignal, ...]
    outputs: tuple[ProgramSignal, ...]
    start: Array
    __repr__ = short_repr

    @property
    def sizes(self) -> Array:
        """Typical magnitudes of the states for inputs of their typical size, (n,), by which solvers weigh errors.

        At the real value s of the magnitude of a pole, s times the Laplace transform of a step response is its mean
        over about one period of that pole. The magnitude of a state is the largest of these means over all poles, plus
        its start.
        """
        a, b, _, _ = self.matrices
        steps = b * [signal.size for signal in self.inputs]
        poles = np.linalg.eigvals(a)
        rates = np.unique(np.abs(poles).round(12))
        rates = rates[rates > 0] if np.any(rates > 0) else np.ones(1)
        found = np.abs(self.start)
        for rate in rates:
            if np.abs(poles - rate).min(initial=np.inf) < NEAR_POLE * rate:  # of a motion that grows
                continue
            found = np.maximum(found, np.abs(np.linalg.solve(rate * np.eye(len(a)) - a, steps)).sum(axis=1))
        return np.where(found > 0, found, 1.0)


def rate_program(model: LinearModel) -> RateProgram:
    """Make the continuous program of a linear model, which starts at rest.

    Modes in `LinearModel.unsupported` are quasi-static, as far above what the mesh supports a solver would only lose
    time.

    Raises:
        ValueError: for a sampled model.
    """
    if model.time_step is not None:
        raise ValueError("model exchange needs a continuous model; this one is sampled: take co-simulation")
    inputs, outputs = _signals(model)
    a, b, kept, taken = quasi_static(model.A, model.B, model.unsupported_above(0.0))
    system = a, b, model.C @ kept, model.D + model.C @ taken
    return RateProgram(matrices=system, inputs=inputs, outputs=outputs, start=np.zeros(len(a)))


def closed_step(program: StepProgram) -> Array:
    """Return the matrix of a whole period of samples without converters, (n, n), whose eigenvalues tell stability."""
    split, n = program.n_measured, program.n_states
    ideal = np.eye(len(program.reading))
    ideal[split:, :split] = program.gains
    result = np.eye(n)
    for phase in program.phases:
        sample = program.samples[phase]
        result = (sample.state[:, :n] + sample.state[:, n:] @ ideal @ program.reading * sample.due) @ result
    return result
