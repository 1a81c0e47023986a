"""Terms: laws on measures. They are all that engines know of the parts of a scene.

A force law makes a generalised force of a measure, an output records it, a constraint holds it. Every engine has one
general item for each kind of law on any measure, and faster items for frequent pairs. An engine that cannot simulate a
term refuses it by name (`nassim.simulation.model.capabilities`), and a term that no engine knows raises TypeError.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from nassim.base.checks import Array, finite_array, freeze, known
from nassim.base.field_types import ArrayLike
from nassim.base.short_repr import ShortRepr
from nassim.scene.field_kinds import Direction, Path, Signal
from nassim.scene.measures import BodyCoordinates, Measure, PointMeasure

TANGENT_STEP = 1e-6
"""Relative step of the difference quotients that replace a tangent that is not given."""


@dataclass(frozen=True)
class Term(ShortRepr):
    """Base class of all terms: the effect of a part in a scene."""


@dataclass(frozen=True)
class AppliedForce(Term):
    """A generalised force along a measure, proportional to an input.

    Attributes:
        input: name of the scene's input.
        unit: unit of the input.
        measure: the measure on which the force does work.
        gain: force [N], or the quantity dual to the measure, per unit of the input.
        bandwidth: -3 dB frequency of an amplifier, a low-pass of first order [Hz].
    """

    input: Signal
    unit: str
    measure: Measure
    gain: float = 1.0
    bandwidth: float = math.inf

    def __post_init__(self) -> None:
        _check_scalar(f"force of input {self.input!r}", self.measure)


@dataclass(frozen=True)
class CoilForce(Term):
    """The force of a coil in a magnetic field along a measure, force_constant i, with the current i by a voltage.

    inductance i' + resistance i = input - force_constant times the rate of the measure, which is the back-EMF. The
    state of the engines is the flux linkage: inductance i + force_constant times the value of the measure.

    Attributes:
        name: name of the coil.
        input: name of the scene's input [V].
        measure: a measure of one component.
        force_constant: force [N], or the quantity dual to the measure, per ampere.
        resistance: resistance [Ohm].
        inductance: inductance [H].
    """

    name: Signal
    input: Signal
    measure: Measure
    force_constant: float
    resistance: float
    inductance: float
    unit = "V"

    def __post_init__(self) -> None:
        _check_scalar(f"coil {self.name!r}", self.measure)
        if not self.measure.has_value:
            raise ValueError(
                f"coil {self.name!r}: a {type(self.measure).__name__} has no value in large motion; measure a "
                "Displacement, a Distance or a RotationAngle"
            )

    @property
    def gain(self) -> float:
        """Force per volt of a coil at rest."""
        return self.force_constant / self.resistance


@dataclass(frozen=True)
class CircuitState(Term):
    """The recorded state of a circuit, which adds to an output.

    Of a coil it is the flux linkage over the inductance, the current that it would have in the reference configuration.
    Of a shunt it is the charge over the capacitance, the voltage that the port would have there.

    Attributes:
        output: name of the output to which it adds.
        circuit: name of the coil, or of the output to which the shunt's voltage adds.
        gain: output per ampere or volt.
    """

    output: Signal
    circuit: Signal
    gain: float = 1.0


@dataclass(frozen=True)
class Feedthrough(Term):
    """An input that adds to an output at once, or behind an amplifier.

    Attributes:
        output: name of the output to which it adds.
        input: name of the input.
        gain: output per unit of the input.
        bandwidth: -3 dB frequency of the amplifier, a low-pass of first order [Hz].
    """

    output: Signal
    input: Signal
    gain: float = 1.0
    bandwidth: float = math.inf


@dataclass(frozen=True)
class BaseAcceleration(Term):
    """Acceleration of the base with all fixed bodies, proportional to an input; motion is then relative to the base.

    Attributes:
        input: name of the scene's input.
        unit: unit of the input.
        direction: acceleration of the base per unit of the input, (3,), along the world's axes at the start.
        axes_of: "" for the world's axes, or "body.point", with whose body the direction turns.
    """

    input: Signal
    unit: str
    direction: Direction
    axes_of: Path = ""


@dataclass(frozen=True)
class ForceLaw(Term):
    """A force that resists a measure: base class of springs, linear or not.

    Attributes:
        measure: the measure, of k components.
    """

    measure: Measure

    def resistance(self, value: Array, rate: Array) -> Array:
        """Evaluate the generalised force against the measure, (k,), at its value and rate, (k,) each."""
        raise NotImplementedError(f"force law {type(self).__name__} must define the method `resistance`")

    def static_resistance(self, value: Array) -> Array:
        """Evaluate the resistance at rest, (k,), at a value of the measure, (k,)."""
        return self.resistance(value, np.zeros(len(value)))

    def tangents(self, value: Array, rate: Array) -> tuple[Array, Array]:
        """Evaluate the derivatives of the resistance with respect to value and rate, (k, k) each."""
        raise NotImplementedError(f"force law {type(self).__name__} must define the method `tangents`")

    @property
    def is_linear(self) -> bool:
        """Whether the tangents are constant."""
        return True


@dataclass(frozen=True)
class Spring(ForceLaw):
    """A spring and a viscous damper in parallel, relaxed in the reference configuration.

    Attributes:
        stiffness: stiffness per unit of the measure, a symmetric matrix (k, k), or a number for all components.
        damping: damping per unit of the measure's rate, a symmetric matrix (k, k), or a number for all components.
    """

    stiffness: float | Array = 0.0
    damping: float | Array = 0.0

    def __post_init__(self) -> None:
        if not self.measure.has_value and np.any(self.stiffness):
            raise ValueError(
                f"a {type(self.measure).__name__} has rates but no value, so that a spring cannot act on it: give a "
                "damping only, or measure a Displacement or a RelativePose"
            )
        for name, value in (("stiffness", self.stiffness), ("damping", self.damping)):
            shape = (len(self.measure.components),) * 2 if np.ndim(value) else ()
            finite_array(f"{name} of a Spring", value, shape)

    @property
    def matrices(self) -> tuple[Array, Array]:
        """Stiffness and damping, (k, k) each."""
        return self.tangents(np.zeros(0), np.zeros(0))

    @property
    def scalars(self) -> tuple[float, float]:
        """Stiffness and damping on a measure of one component."""
        stiffness, damping = self.matrices
        return float(stiffness[0, 0]), float(damping[0, 0])

    def resistance(self, value: Array, rate: Array) -> Array:
        """Evaluate the generalised force against the measure, (k,)."""
        stiffness, damping = self.matrices
        return stiffness @ value + damping @ rate

    def tangents(self, value: Array, rate: Array) -> tuple[Array, Array]:
        """Evaluate stiffness and damping, (k, k) each."""
        one = np.eye(len(self.measure.components))
        stiffness, damping = (part if np.ndim(part) else part * one for part in (self.stiffness, self.damping))
        return np.asarray(stiffness), np.asarray(damping)


@dataclass(frozen=True)
class NonlinearSpring(ForceLaw):
    """Any force as a function of value and rate of a measure.

    Linear models hold its tangents in static equilibrium. Exact steps refuse it.

    Attributes:
        force: function of value and rate, (k,) each, that returns the generalised force against the measure, (k,) or a
            number.
        tangent: function of value and rate that returns the derivatives of the force with respect to both, (k, k) or
            numbers. Default: difference quotients.
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
        """False."""
        return False

    def resistance(self, value: Array, rate: Array) -> Array:
        """Evaluate the generalised force against the measure, (k,).

        Raises:
            ValueError: if the function returns no finite force of the right shape.
        """
        return finite_array("force of a nonlinear spring", np.atleast_1d(self.force(value, rate)), value.shape)

    def tangents(self, value: Array, rate: Array) -> tuple[Array, Array]:
        """Evaluate the derivatives of the force with respect to value and rate, (k, k) each."""
        if self.tangent is not None:
            by_value, by_rate = (np.atleast_2d(np.asarray(part, dtype=float)) for part in self.tangent(value, rate))
            return by_value, by_rate
        k = len(value)
        columns = []
        for j in range(2 * k):
            step = TANGENT_STEP * max(1e-3, float(np.abs(np.concatenate([value, rate])[j]))) * np.eye(2 * k)[j]
            ahead, behind = (self.resistance(value + s * step[:k], rate + s * step[k:]) for s in (1, -1))
            columns.append((ahead - behind) / (2 * step[j]))
        both = np.array(columns).T
        return both[:, :k], both[:, k:]


@dataclass(frozen=True)
class Shunt(Term):
    """A resistance across an electrical port that discharges it; its voltage adds to an output.

    Attributes:
        output: name of the output to which the voltage adds.
        measure: charge by the motion [C].
        capacitance: capacitance of port and load [F].
        resistance: resistance [Ohm].
        gain: output per volt.
    """

    output: Signal
    measure: BodyCoordinates
    capacitance: float
    resistance: float
    gain: float


@dataclass(frozen=True)
class Output(Term):
    """A recorded measure.

    All terms of one output add up: outputs, spring forces, shunts, states of circuits and feedthrough.

    Attributes:
        name: name of the output.
        unit: unit of the output.
        measure: a measure of one component.
        gain: output per unit of the measure or of its derivative.
        derivative: 0, 1 or 2. Acceleration is that of the points; the rotation of the axes adds nothing.
        inertial: whether an acceleration is against inertial space rather than against the base.
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
    """The recorded force of a spring and its damper; the spring itself is the term of another part.

    Attributes:
        name: name of the output.
        unit: unit of the output.
        spring: the force law.
        component: component of the law's measure.
    """

    name: Signal
    unit: str
    spring: ForceLaw
    component: str = "value"


@dataclass(frozen=True)
class OutputFilter(Term):
    """A filter of an output; several filters of one output act in their order.

    It starts settled on the output's first value, or on zero where that is an acceleration in a scene at rest.

    Attributes:
        output: name of the output.
        passes: "low", "high" or, of second order, "band".
        frequency: corner frequency or resonance [Hz].
        damping_ratio: damping ratio of a filter of second order, w^2, s^2 or w s over s^2 + 2 damping_ratio w s + w^2;
            None for first order, w or s over s + w.
    """

    output: Signal
    passes: str
    frequency: float
    damping_ratio: float | None = None


@dataclass(frozen=True)
class Constraint(Term):
    """Components of a measure that stay zero.

    Attributes:
        name: name of the joint.
        measure: `RelativePose` with rotation "matrix" for a joint, or any other measure.
        held: names of the components that stay zero; default: that of a measure of one component.
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
        """Points of the measure."""
        return self.measure.points

    def rows(self, components: tuple[str, ...]) -> list[int]:
        """Return the indices of components among those of the measure."""
        return [self.measure.components.index(component) for component in components]


@dataclass(frozen=True)
class PrescribedMotion(Term):
    """A component that a constraint leaves free and that follows an input, or runs at constant speed.

    Attributes:
        constraint: name of the constraint.
        component: component of the constraint's measure.
        input: name of the input, "" for a constant speed.
        unit: unit of the input.
        speed: constant speed [m/s] or [rad/s].
        bandwidth: -3 dB frequency of a servo between input and motion, a low-pass of first order [Hz].
    """

    constraint: Signal
    component: str
    input: Signal
    unit: str
    speed: float = 0.0
    bandwidth: float = math.inf


def _check_scalar(label: str, measure: Measure) -> None:
    """Refuse a measure of several components."""
    if len(measure.components) != 1:
        raise ValueError(
            f"{label}: a {type(measure).__name__} has the components {', '.join(measure.components)}; give a measure "
            "of one, such as a Displacement or a RotationAngle"
        )


Driven = AppliedForce | CoilForce | BaseAcceleration | PrescribedMotion
"""Terms that have an input."""
KNOWN = (
    AppliedForce,
    CoilForce,
    CircuitState,
    Feedthrough,
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
    """Check that a term, and its measure, are of kinds that engines know.

    Args:
        term: the term.
        owner: its part, for messages.

    Raises:
        TypeError: for an object of another kind.
    """
    if not isinstance(term, KNOWN):
        names = ", ".join(kind.__name__ for kind in KNOWN)
        raise TypeError(f"{owner}: {type(term).__name__} is no term that engines know; known are {names}")
    measure = getattr(term, "measure", None)
    if measure is not None and not isinstance(measure, Measure):
        raise TypeError(
            f"{owner}: the measure of its {type(term).__name__} is a {type(measure).__name__}; derive it from Measure "
            f"or {PointMeasure.__name__} of nassim.scene.measures"
        )
