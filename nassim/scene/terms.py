"""Terms: laws on measures. They are all that engines know of the parts of a scene.

A force law makes a generalised force of a measure, an output records it, a constraint holds it. Every engine has one
general way for each kind of law on any measure; for frequent pairs it has a faster one. An engine that cannot do a term
refuses it by name (`nassim.simulation.model.capabilities`), and one that does not know it raises TypeError.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from nassim.base.checks import Array, finite_array, freeze, known
from nassim.scene.measures import BodyCoordinates, Direction, Measure, PointMeasure, Signal

STEP = 1e-6
"""Relative step of the difference quotients that stand in for a tangent that is not given."""


@dataclass(frozen=True)
class Term:
    """What a part does in a scene: base class of all terms."""


@dataclass(frozen=True)
class AppliedForce(Term):
    """An input applies a generalised force along a measure.

    Attributes:
        input: name of the scene's input; unit: of it.
        measure: what the force does work on.
        gain: force [N], or what the measure's dual is, per unit of the input.
        bandwidth: of an amplifier between, a low-pass of first order, -3 dB [Hz].
    """

    input: Signal
    unit: str
    measure: Measure
    gain: float = 1.0
    bandwidth: float = math.inf

    def __post_init__(self) -> None:
        _check_scalar(f"force of input {self.input!r}", self.measure)


@dataclass(frozen=True)
class BaseAcceleration(Term):
    """An input accelerates the base with all fixed bodies; motion is then relative to the base.

    Attributes:
        input: name of the scene's input; unit: of it.
        direction: acceleration of the base per unit of the input, world frame, (3,).
    """

    input: Signal
    unit: str
    direction: Direction


@dataclass(frozen=True)
class ForceLaw(Term):
    """A force that resists a measure: base class of springs, linear or not.

    Attributes:
        measure: of k components.
    """

    measure: Measure

    def resistance(self, value: Array, rate: Array) -> Array:
        """Evaluate the generalised force against the measure, (k,), of its value and rate, (k,) each."""
        raise NotImplementedError(f"{type(self).__name__} has no method `resistance`")

    def tangents(self, value: Array, rate: Array) -> tuple[Array, Array]:
        """Evaluate the derivatives of the resistance by value and by rate, (k, k) each."""
        raise NotImplementedError(f"{type(self).__name__} has no method `tangents`")

    @property
    def is_linear(self) -> bool:
        """Whether the tangents are the same everywhere."""
        return True


@dataclass(frozen=True)
class Spring(ForceLaw):
    """A spring and a viscous damper in parallel, relaxed in the reference configuration.

    Attributes:
        stiffness, damping: per unit of the measure and of its rate, numbers or symmetric matrices (k, k).
    """

    stiffness: float | Array = 0.0
    damping: float | Array = 0.0

    def __post_init__(self) -> None:
        if not self.measure.has_value and np.any(self.stiffness):
            raise ValueError(
                f"a {type(self.measure).__name__} has rates but no value, so that a spring cannot act on it: give a "
                "damping only, or measure a Displacement or a RelativePose"
            )

    @property
    def matrices(self) -> tuple[Array, Array]:
        """Stiffness and damping, (k, k) each."""
        return self.tangents(np.zeros(0), np.zeros(0))

    def resistance(self, value: Array, rate: Array) -> Array:
        """Evaluate the generalised force against the measure, (k,)."""
        stiffness, damping = self.matrices
        return stiffness @ value + damping @ rate

    def tangents(self, value: Array, rate: Array) -> tuple[Array, Array]:
        """Evaluate stiffness and damping, (k, k) each."""
        return np.atleast_2d(self.stiffness), np.atleast_2d(self.damping)


@dataclass(frozen=True)
class NonlinearSpring(ForceLaw):
    """Any force of value and rate of a measure.

    Linear models hold its tangents in static equilibrium. Exact steps refuse it.

    Attributes:
        force: of value and rate, (k,) each; returns the generalised force against the measure, (k,) or a number.
        tangent: of value and rate; returns the derivatives of the force by both, (k, k) or numbers. Default:
            difference quotients.
    """

    force: Callable[[Array, Array], ArrayLike] = field(kw_only=True)
    tangent: Callable[[Array, Array], tuple[ArrayLike, ArrayLike]] | None = field(default=None, kw_only=True)

    def __post_init__(self) -> None:
        if not self.measure.has_value:
            raise ValueError(
                f"a {type(self.measure).__name__} has rates but no value, so that a spring cannot act on it: measure a "
                "Displacement or a RelativePose"
            )

    @property
    def is_linear(self) -> bool:
        """No."""
        return False

    def resistance(self, value: Array, rate: Array) -> Array:
        """Evaluate the generalised force against the measure, (k,); raises ValueError for what is no finite force."""
        return finite_array("force of a nonlinear spring", np.atleast_1d(self.force(value, rate)), value.shape)

    def tangents(self, value: Array, rate: Array) -> tuple[Array, Array]:
        """Evaluate the derivatives of the force by value and by rate, (k, k) each."""
        if self.tangent is not None:
            by_value, by_rate = (np.atleast_2d(np.asarray(part, dtype=float)) for part in self.tangent(value, rate))
            return by_value, by_rate
        k = len(value)
        columns = []
        for j in range(2 * k):
            step = STEP * max(1e-3, float(np.abs(np.concatenate([value, rate])[j]))) * np.eye(2 * k)[j]
            ahead, behind = (self.resistance(value + s * step[:k], rate + s * step[k:]) for s in (1, -1))
            columns.append((ahead - behind) / (2 * step[j]))
        both = np.array(columns).T
        return both[:, :k], both[:, k:]


@dataclass(frozen=True)
class Shunt(Term):
    """A resistance across an electrical port, through which its charge leaks; it adds to an output.

    Attributes:
        output: name of the output to which its voltage adds.
        measure: charge that the motion brings [C].
        capacitance: of port and load [F].
        resistance: [Ohm].
        gain: output per volt.
    """

    output: Signal
    measure: BodyCoordinates
    capacitance: float
    resistance: float
    gain: float


@dataclass(frozen=True)
class Output(Term):
    """An output records a measure. All terms of one output add up: outputs, spring forces and shunts.

    Attributes:
        name: of the output; unit: of it.
        measure: of one component.
        gain: output per unit of the measure or of its derivative.
        derivative: 0, 1 or 2; acceleration is that of the points, whichever way their axes turn.
        inertial: whether an acceleration is that against inertial space rather than against the base.
    """

    name: Signal
    unit: str
    measure: Measure
    gain: float = 1.0
    derivative: int = 0
    inertial: bool = False

    def __post_init__(self) -> None:
        if self.derivative not in (0, 1, 2):
            raise ValueError(f"output {self.name!r}: derivative must be 0, 1 or 2, got {self.derivative!r}")
        _check_scalar(f"output {self.name!r}", self.measure)


@dataclass(frozen=True)
class SpringForce(Term):
    """An output records what a spring and its damper pull with; the spring itself is the term of another part.

    Attributes:
        name: of the output; unit: of it.
        spring: the force law; component: of its measure.
    """

    name: Signal
    unit: str
    spring: ForceLaw
    component: str = "value"


@dataclass(frozen=True)
class OutputFilter(Term):
    """An output passes a filter, as if it had always been at its first value; several filters act in their order.

    Attributes:
        output: name.
        passes: "low", "high" or, of second order, a "band" of frequencies.
        frequency: of its corner or resonance [Hz].
        damping_ratio: of a filter of second order, w^2, s^2 or w s over s^2 + 2 damping_ratio w s + w^2; None for the
            first order, w or s over s + w.
    """

    output: Signal
    passes: str
    frequency: float
    damping_ratio: float | None = None


@dataclass(frozen=True)
class Constraint(Term):
    """Components of a measure stay zero.

    Attributes:
        name: of the joint.
        measure: `RelativePose` with rotation "matrix" of a joint, or any other.
        held: names of the components that stay zero; default: all.
    """

    name: Signal
    measure: Measure
    held: tuple[str, ...] = ("value",)

    def __post_init__(self) -> None:
        for component in self.held:
            known(f"component of constraint {self.name!r}", component, self.measure.components)
        if not self.measure.has_value:
            raise ValueError(f"constraint {self.name!r}: a {type(self.measure).__name__} has no value to hold")
        freeze(self, held=tuple(c for c in self.measure.components if c in self.held))

    @property
    def points(self) -> tuple[str, ...]:
        """Points of its measure."""
        return self.measure.points

    def rows(self, components: tuple[str, ...]) -> list[int]:
        """Indices of components among those of the measure."""
        return [self.measure.components.index(component) for component in components]


@dataclass(frozen=True)
class PrescribedMotion(Term):
    """A component that a constraint leaves free follows an input, or runs at constant speed.

    Attributes:
        constraint: name of the constraint; component: of its measure.
        input: name of the input, "" for a constant speed; unit: of the input.
        speed: constant [m/s] or [rad/s].
        bandwidth: of a servo between input and motion, a low-pass of first order, -3 dB [Hz].
    """

    constraint: Signal
    component: str
    input: Signal
    unit: str
    speed: float = 0.0
    bandwidth: float = math.inf


def _check_scalar(label: str, measure: Measure) -> None:
    if len(measure.components) != 1:
        raise ValueError(
            f"{label}: a {type(measure).__name__} has the components {', '.join(measure.components)}; give a measure "
            "of one, such as a Displacement or a RotationAngle"
        )


Driven = AppliedForce | BaseAcceleration | PrescribedMotion
"""Terms that have an input."""
KNOWN = (
    AppliedForce,
    BaseAcceleration,
    ForceLaw,
    Shunt,
    Output,
    SpringForce,
    OutputFilter,
    Constraint,
    PrescribedMotion,
)
"""Kinds of terms that engines know."""


def check_term(term: object, owner: str) -> None:
    """Raise TypeError for what is no term that engines know, or whose measure is none."""
    if not isinstance(term, KNOWN):
        names = ", ".join(kind.__name__ for kind in KNOWN)
        raise TypeError(f"{owner}: {type(term).__name__} is no term that engines know; known are {names}")
    measure = getattr(term, "measure", None)
    if measure is not None and not isinstance(measure, Measure):
        raise TypeError(
            f"{owner}: the measure of its {type(term).__name__} is a {type(measure).__name__}; derive it from Measure "
            f"or {PointMeasure.__name__} of nassim.scene.measures"
        )
