"""Scenes: bodies and parts connected by name, as pure data."""

from collections.abc import Iterable, Sequence
from dataclasses import field
from functools import cached_property
from typing import TYPE_CHECKING, Any, NoReturn, TypeVar

import numpy as np

from nassim.base.checks import Array, above_zero, finite_array, freeze, instances, known, positive, unique
from nassim.base.field_types import ArrayField, ArrayLike, Field, data_class, held
from nassim.base.html_repr import html_repr
from nassim.base.modal import damping_ratios
from nassim.base.short_repr import short_repr
from nassim.scene.bodies import Body, FlexibleBody
from nassim.scene.field_kinds import body_of, point_of
from nassim.scene.loop import Loop
from nassim.scene.measures import Measure
from nassim.scene.part import Actuator, Connection, ForceElement, Part, Sensor
from nassim.scene.terms import (
    AppliedForce,
    CircuitState,
    CoilForce,
    Constraint,
    Driven,
    Feedthrough,
    ForceLaw,
    Output,
    OutputFilter,
    PrescribedMotion,
    Shunt,
    SpringForce,
    Term,
    check_term,
)

KINDS: dict[str, tuple[type, ...]] = {
    "bodies": (Body,),
    "joints": (Connection,),
    "actuators": (Actuator,),
    "sensors": (Sensor,),
    "springs": (ForceElement,),
    "loops": (Loop,),
}
USUAL_RATIO = 0.01
"""Damping ratio of the modes of a scene that states none."""
Kind = TypeVar("Kind", bound=Term)
OF_LINEAR_MODELS = ("A", "B", "C", "D", "matrices", "poles", "n_states", "time_step")
"""Attributes of linear models, which functions of `nassim.systems` ask for."""


@data_class
class Scene:
    """Bodies and parts connected by name, as data: the complete input of a simulation.

    Names must differ within each kind of part. An electrical port that is neither driven nor measured is
    short-circuited.

    Attributes:
        name: name of the scene.
        bodies: the bodies.
        joints: the joints.
        actuators: the actuators.
        sensors: the sensors.
        springs: spring-dampers and bushings.
        loops: digital controllers, which run in `simulate`.
        damping_ratio: damping ratio of every elastic eigenmode of the assembled scene in the reference configuration
            [-], one number or one per mode from the lowest (the remaining modes then have the last). Rigid-body modes
            have none. It adds to the bodies' own damping. None means 0.01, or 0 where a body has damping of its own
            (`FlexibleBody.damping_ratio`, `ReducedBody.damping_matrix`), which is the right damping for scenes in large
            motion. The ratio is realised as a damping of the flexible bodies' deformation. In floating frames, motion
            that only springs hold therefore keeps the springs' own damping; a warning reports this.
        gravity: acceleration, world frame, (3,) [m/s2]. With gravity, simulations start in equilibrium with all inputs
            at zero. Controllers start with states of zero, so what their signals read there is a step to them.
        cutoff_frequency: frequency below which flexible bodies are modelled [Hz], see `trim_scene`; choose three times
            the highest frequency of interest. None models all coordinates of each body.
        quasi_static_above: frequency [Hz]. Modes that are above it and above half of a sample rate are quasi-static in
            sampled models and exact runs: they follow without dynamics instead of folding below half of the rate. None
            selects the modes with most strain energy in bodies whose modes end below them
            (`ReducedBody.valid_frequency`); math.inf selects no mode.

    Raises:
        ValueError: for unknown names, for joints whose points do not coincide, and for all that a part refuses.
    """

    name: str
    bodies: Field[Sequence[Body], tuple[Body, ...]]
    joints: Field[Sequence[Connection], tuple[Connection, ...]] = held(())
    actuators: Field[Sequence[Actuator], tuple[Actuator, ...]] = held(())
    sensors: Field[Sequence[Sensor], tuple[Sensor, ...]] = held(())
    springs: Field[Sequence[ForceElement], tuple[ForceElement, ...]] = held(())
    loops: Field[Sequence[Loop], tuple[Loop, ...]] = held(())
    damping_ratio: ArrayLike | None = None
    gravity: ArrayField = field(default_factory=held(lambda: np.zeros(3)))
    cutoff_frequency: float | None = None
    quasi_static_above: float | None = None
    __repr__ = short_repr
    _repr_html_ = html_repr
    if not TYPE_CHECKING:  # else checkers would accept any name

        def __getattr__(self, name: str) -> NoReturn:
            """Tell who gives a scene in place of its linear model, to `damping` for example."""
            if hasattr(type(self), name):  # a property in which a part lacks something: that error is the cause
                object.__getattribute__(self, name)
            linear = "; its linear model has: give linearize(scene)" if name in OF_LINEAR_MODELS else ""
            raise AttributeError(f"{type(self).__name__!r} object has no attribute {name!r}{linear}")

    def __post_init__(self) -> None:
        unique("scene", (self.name,))
        if self.cutoff_frequency is not None:
            positive("cutoff_frequency", self.cutoff_frequency, "Hz")
        if self.quasi_static_above is not None:
            above_zero("quasi_static_above", self.quasi_static_above, "Hz")
        ratio = self.damping_ratio
        if ratio is not None:
            ratio = damping_ratios("damping_ratio", ratio)
        kinds = {
            label: instances(f"scene {self.name!r}: {label}", getattr(self, label), KINDS[label]) for label in KINDS
        }
        freeze(self, **kinds, damping_ratio=ratio, gravity=finite_array("gravity", self.gravity, (3,)))
        for kind, named in zip(("body", "joint", "actuator", "sensor", "spring", "loop"), kinds.values(), strict=True):
            unique(kind, (part.name for part in named))
        dotted = [body.name for body in self.bodies if "." in body.name]
        if dotted:
            raise ValueError(f"body {dotted[0]!r}: no dot in a body's name, because points are written 'body.point'")
        if not any(body.moves for body in self.bodies):
            raise ValueError(f"scene {self.name!r} has no body that can move")
        self._check_ports()
        self._check_signals()

    def _check_signals(self) -> None:
        for name in self.read_by_loops:
            if name in self._actuated:
                raise ValueError(
                    f"reference or noise {name!r} of a loop is also the input of an actuator; give it another name"
                )
        noises = {name for loop in self.loops for name in loop.noise}
        for name in (name for loop in self.loops for name in loop.reference if name in noises):
            raise ValueError(f"{name!r} is a reference of one loop and the noise of another; give each its own name")
        for term in self._driven:
            if term.input and term.unit != self.input_unit(term.input):
                raise ValueError(f"input {term.input!r} cannot be both {term.unit} and {self.input_unit(term.input)}")
        driven = [(term.constraint, term.component) for term in self.terms_of(PrescribedMotion)]
        for joint, direction in driven:
            if driven.count((joint, direction)) > 1:
                raise ValueError(f"{direction} of joint {joint!r} is driven more than once")
        outputs = (name for terms in self._terms for name in dict.fromkeys(term.name for term in recorded(terms)))
        unique("signal (input, output, loop)", (*self.inputs, *outputs, *self.commands))
        self._check_outputs()
        for loop in self.loops:
            for name in loop.measured:
                known(f"output that loop {loop.name!r} measures:", name, self.outputs)
            for name in loop.driven:
                known(f"input that loop {loop.name!r} drives:", name, self._actuated)
        for name, output in self._read_with:
            if self.output_unit(output) != self.read_by_loops[name]:
                own = self.read_by_loops[name]
                raise ValueError(f"reference or noise {name!r} cannot be both {self.output_unit(output)} and {own}")

    def _check_outputs(self) -> None:
        for term in recorded(self.terms):
            if isinstance(term, Output) and term.inertial and term.derivative != 2:
                raise ValueError(f"output {term.name!r}: only accelerations are read against inertial space")
            if term.unit != self.output_unit(term.name):
                raise ValueError(f"output {term.name!r} cannot be both {self.output_unit(term.name)} and {term.unit}")
        circuits = [coil.name for coil in self.terms_of(CoilForce)] + [shunt.output for shunt in self.terms_of(Shunt)]
        for state in self.terms_of(CircuitState):
            known("output of a circuit's state", state.output, self.outputs)
            known("circuit", state.circuit, circuits)
        for direct in self.terms_of(Feedthrough):
            known("output of a feedthrough", direct.output, self.outputs)
            known("input of a feedthrough", direct.input, self._actuated)
        for passing in self.terms_of(OutputFilter):
            name = known("filtered output", passing.output, self.outputs)
            _check_filter(passing)
            kinds = {(term.derivative, term.inertial) for term in self.terms_of(Output) if term.name == name}
            others = [term.name for term in self.terms_of(SpringForce)] + [term.output for term in self.terms_of(Shunt)]
            if len(kinds | {(0, False) for other in others if other == name}) > 1:
                raise ValueError(
                    f"output {name!r} adds outputs of several derivatives and passes a filter, which starts on the "
                    "value of one: let it read displacement, velocity or acceleration"
                )

    def _check_ports(self) -> None:
        claims = [path for part in self.parts for path in part.claims]
        for path in claims:
            if claims.count(path) > 1:
                raise ValueError(f"electrical port {path!r} is used more than once; drive it or measure it, once")

    @property
    def parts(self) -> tuple[Part, ...]:
        """Joints, springs, actuators and sensors, in this order."""
        return (*self.joints, *self.springs, *self.actuators, *self.sensors)

    @cached_property
    def terms(self) -> tuple[Term, ...]:
        """Terms of all parts, see `nassim.scene.terms`."""
        return tuple(term for terms in self._terms for term in terms)

    @cached_property
    def _terms(self) -> tuple[tuple[Term, ...], ...]:
        """Terms of each part, in the order of `parts`."""
        result = tuple(part.all_terms(self) for part in self.parts)
        for part, terms in zip(self.parts, result, strict=True):
            for term in terms:
                check_term(term, f"{type(part).__name__} {part.name!r}")
        return result

    def terms_of(self, kind: type[Kind]) -> tuple[Kind, ...]:
        """Return the terms of one kind of all parts."""
        if kind not in self._terms_by_kind:
            self._terms_by_kind[kind] = tuple(term for term in self.terms if isinstance(term, kind))
        return self._terms_by_kind[kind]

    @cached_property
    def _terms_by_kind(self) -> dict[type, tuple[Any, ...]]:
        return {}

    def measures_of(self, *kinds: type[Term]) -> tuple[Measure, ...]:
        """Return the measures of terms of several kinds, kind by kind."""
        return tuple(term.measure for kind in kinds for term in self.terms_of(kind))  # type: ignore[attr-defined]

    @cached_property
    def constraints(self) -> dict[str, Constraint]:
        """Constraints of all parts, by the names of their joints."""
        return {constraint.name: constraint for constraint in self.terms_of(Constraint)}

    @cached_property
    def _driven(self) -> list[Driven]:
        return [term for term in self.terms if isinstance(term, Driven)]

    @property
    def mode_ratios(self) -> Array:
        """Damping ratios of the scene's elastic modes without the bodies' own damping, see `damping_ratio`."""
        if self.damping_ratio is None:
            own = any(body.is_damped for body in self.flexible_bodies)
            return np.array([0.0 if own else USUAL_RATIO])
        return np.atleast_1d(self.damping_ratio)

    @property
    def inputs(self) -> tuple[str, ...]:
        """Names of the inputs: of the actuators, then those that only loops read."""
        return (*self._actuated, *self.read_by_loops)

    @property
    def _actuated(self) -> tuple[str, ...]:
        """Names of the inputs of actuators."""
        return tuple(dict.fromkeys(term.input for term in self._driven if term.input))

    @cached_property
    def read_by_loops(self) -> dict[str, str]:
        """Unit of each input that only loops read, by its name: their references and the noise of what they measure."""
        return {name: self._units.get(output, "") for name, output in self._read_with}

    @property
    def _read_with(self) -> list[tuple[str, str]]:
        """References, then noise of the loops, with the outputs that they are read with."""
        references = [pair for loop in self.loops for pair in zip(loop.reference, loop.measured, strict=False)]
        return references + [pair for loop in self.loops for pair in zip(loop.noise, loop.measured, strict=False)]

    @property
    def commands(self) -> tuple[str, ...]:
        """Names of the outputs of the loops' controllers."""
        return tuple(name for loop in self.loops for name in loop.commands)

    @property
    def commanded_inputs(self) -> tuple[str, ...]:
        """Names of the inputs to which the commands add, in the order of `commands`."""
        return tuple(name for loop in self.loops for name in loop.driven)

    @property
    def command_units(self) -> tuple[str, ...]:
        """Units of the commands."""
        return tuple(map(self.input_unit, self.commanded_inputs))

    def input_unit(self, name: str) -> str:
        """Return the unit of an input."""
        if name in self.read_by_loops:
            return self.read_by_loops[name]
        return next(term.unit for term in self._driven if term.input == name)

    @property
    def outputs(self) -> tuple[str, ...]:
        """Names of the outputs."""
        return tuple(self._units)

    @property
    def output_units(self) -> tuple[str, ...]:
        """Units of the outputs."""
        return tuple(self._units.values())

    def output_unit(self, name: str) -> str:
        """Return the unit of an output."""
        return self._units[name]

    @cached_property
    def _units(self) -> dict[str, str]:
        """Units of the outputs, by name."""
        return {term.name: term.unit for term in recorded(self.terms)}

    @property
    def speeds(self) -> tuple[PrescribedMotion, ...]:
        """Prescribed motions at constant speed."""
        return tuple(term for term in self.terms_of(PrescribedMotion) if term.speed)

    @property
    def prescribed(self) -> tuple[PrescribedMotion, ...]:
        """Prescribed motions that follow inputs."""
        return tuple(term for term in self.terms_of(PrescribedMotion) if term.input)

    @property
    def in_small_motion(self) -> bool:
        """Whether joints and bodies are in small motion: some body is "linear", none is "ffrf", and nothing spins."""
        return bool(self.of_fidelity("linear")) and not self.of_fidelity("ffrf") and self.at_rest

    @property
    def at_rest(self) -> bool:
        """Whether no body has an angular_velocity and no drive runs at constant speed."""
        return not (self.speeds or self.spinning)

    @property
    def spinning(self) -> tuple[str, ...]:
        """Names of the bodies with an angular_velocity."""
        return tuple(body.name for body in self.bodies if np.any(body.angular_velocity))

    @property
    def flexible_bodies(self) -> tuple[FlexibleBody, ...]:
        """The flexible bodies, in order."""
        return tuple(body for body in self.bodies if isinstance(body, FlexibleBody))

    @property
    def deformable_bodies(self) -> tuple[FlexibleBody, ...]:
        """The flexible bodies whose fidelity lets them deform, in order."""
        return tuple(body for body in self.flexible_bodies if body.deforms)

    def of_fidelity(self, fidelity: str) -> tuple[FlexibleBody, ...]:
        """Return the flexible bodies of a fidelity, in order."""
        return tuple(body for body in self.flexible_bodies if body.fidelity == fidelity)

    @cached_property
    def _by_name(self) -> dict[str, Body]:
        return {body.name: body for body in self.bodies}

    def body(self, name: str) -> Body:
        """Return the body of a name.

        Raises:
            ValueError: for an unknown name; the message lists the known ones.
        """
        return self._by_name[known("body", name, self._by_name)]

    def split(self, path: str) -> tuple[Body, str]:
        """Return body and point name of "body.point".

        Raises:
            ValueError: for an unknown body; the message lists the known names.
        """
        if not isinstance(path, str) or "." not in path:
            raise ValueError(f"a point is written 'body.point', got {path!r}")
        return self.body(body_of(path)), point_of(path)

    def point_position(self, path: str) -> Array:
        """Return the position of "body.point" at the start, world frame, (3,) [m]."""
        body, point = self.split(path)
        return body.point_position(point)

    def held_points(self, body: Body) -> tuple[str, ...]:
        """Return the points of a body that constraints hold, then those that springs hold, in their order."""
        measures = self.measures_of(Constraint, ForceLaw)
        return self._points_of(body, [path for measure in measures if not measure.within for path in measure.points])

    def named_points(self, body: Body) -> tuple[str, ...]:
        """Return the points of a body that constraints, springs, forces or outputs name themselves."""
        paths = [f"{body.name}.{point}" for point in self.held_points(body)]
        for measure in self.measures_of(AppliedForce, CoilForce, Output):
            if not measure.within:
                paths += measure.points
        return self._points_of(body, paths)

    def _points_of(self, body: Body, paths: Iterable[str]) -> tuple[str, ...]:
        return tuple(dict.fromkeys(point_of(path) for path in paths if body_of(path) == body.name))

    def frame_point(self, body: FlexibleBody) -> str:
        """Return the name of the remote point that carries a flexible body's floating frame."""
        if body.frame is not None:
            return body.frame
        names = body.reduced.point_names
        return next((name for name in self.held_points(body) if name in names), names[0])


def recorded(terms: Iterable[Term]) -> tuple[Output | SpringForce, ...]:
    """Return the terms that name outputs; shunts add to the outputs of others."""
    return tuple(term for term in terms if isinstance(term, (Output, SpringForce)))


def _check_filter(term: OutputFilter) -> None:
    label = f"filter of output {term.output!r}"
    known(label, term.passes, ("low", "high", "band"))
    positive(f"{label}: frequency", term.frequency, "Hz")
    if term.damping_ratio is not None:
        positive(f"{label}: damping_ratio", term.damping_ratio)
    elif term.passes == "band":
        raise ValueError(f"{label}: a band-pass is of second order; give it a damping_ratio")
