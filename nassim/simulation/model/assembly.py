"""Assembly of a scene: coordinates, constraints, modal model and signals of small motion about its start."""

from dataclasses import dataclass, replace

import numpy as np

from nassim.base.checks import Array
from nassim.base.short_repr import short_repr
from nassim.bodies.projection import with_voltage_rows
from nassim.scene.bodies import Body, FlexibleBody
from nassim.scene.measures import BodyCoordinates, Combination, Measure
from nassim.scene.scene import Scene
from nassim.scene.stress_sensors import warn_of_pressed_stacks
from nassim.scene.terms import Output, Spring, Term
from nassim.simulation.model.constraints import Constraints
from nassim.simulation.model.coordinates import Coordinates
from nassim.simulation.model.damping import Damping
from nassim.simulation.model.effect_of_loads import LoadedState
from nassim.simulation.model.lever_arm_warning import warn_of_lever_arms
from nassim.simulation.model.modal_model import ModalModel, Structure
from nassim.simulation.model.prescribed_motion import PrescribedMotions
from nassim.simulation.model.signals import Signals
from nassim.simulation.model.states import ReferenceState
from nassim.simulation.model.steady_rotation import SteadyRotation
from nassim.simulation.model.tangents import Tangent, law_tangents
from nassim.simulation.model.trimming import trim_scene, without_pictures


@dataclass(frozen=True)
class Assembly:
    """Model of a scene for small motion about its start.

    Attributes:
        scene: the modelled scene, after `trim_scene`. Its bodies include the stiffness of springs within them, such as
            electrical ports that keep their charge.
        terms: terms of the parts, except these springs.
        coordinates: all coordinates of the bodies, and measures on them.
        constraints: constraints of bodies, joints and drives.
        tangents: force laws about the static equilibrium.
        modal: matrices in minimal coordinates, and undamped modes; drives that follow inputs are at rest in them.
        signals: inputs and outputs.
        loads: effect of constant loads, about whose equilibrium the motion then is; None: the reference configuration.
        rotation: rotation whose known functions of time act too; None: only constant loads do.
    """

    scene: Scene
    terms: tuple[Term, ...]
    coordinates: Coordinates
    constraints: Constraints
    tangents: tuple[Tangent, ...]
    modal: ModalModel
    signals: Signals
    loads: LoadedState | None = None
    rotation: SteadyRotation | None = None
    __repr__ = short_repr

    def under(self, loads: LoadedState) -> "Assembly":
        """Return the assembly with the effect of constant loads, and outputs of strain accordingly."""
        terms = tuple(_strained(term, loads) for term in self.terms)
        if all(one is other for one, other in zip(terms, self.terms, strict=True)):
            return replace(self, loads=loads)
        signals = Signals.of(self.coordinates, terms, self.tangents, self.signals.prescribed)
        return replace(self, terms=terms, signals=signals, loads=loads)

    def with_damping(self, damping: Damping) -> "Assembly":
        """Return the assembly with another damping."""
        return replace(self, modal=replace(self.modal, damping=damping))

    @property
    def is_linear(self) -> bool:
        """Whether all force laws are linear."""
        return all(tangent.law.is_linear for tangent in self.tangents)

    @property
    def known(self) -> tuple[Array, Array]:
        """Generator of the known functions of time, and their values at the start, see `SteadyRotation.known`.

        Without a rotation the only one is a constant of one.
        """
        return self.rotation.known if self.rotation else (np.zeros((1, 1)), np.ones(1))

    @property
    def offset(self) -> Array:
        """Constant part of all coordinates, which are modes @ amplitudes + offset, (n_all,)."""
        given = self.loads.offset if self.loads else None
        return np.zeros(self.coordinates.size) if given is None else given

    @property
    def output_offsets(self) -> Array:
        """Constant part of the outputs before their filters, (outputs,)."""
        given = self.loads.output_offsets if self.loads else None
        return self.signals.offsets if given is None else given

    @property
    def bent_points_carry(self) -> bool:
        """Whether points that rotate by deformation carry rigid groups in large motion.

        In a spin they do where the stiffness of the loads on these groups is known.
        """
        return self.scene.at_rest or bool(self.loads and self.loads.carried)

    @property
    def modes_uncoupled(self) -> bool:
        """Whether the undamped modes are uncoupled, outputs read displacements only and inputs act as forces only."""
        return self.signals.are_static and not np.any(self.modal.damping.non_modal)


def _strained(term: Term, loads: LoadedState) -> Term:
    """Return the term, an output of strain with the weights and the constant part that it has under loads."""
    return replace(term, measure=_strained_measure(term.measure, loads)) if isinstance(term, Output) else term


def _strained_measure(measure: Measure, loads: LoadedState) -> Measure:
    """Return a measure whose strains are those under loads."""
    if isinstance(measure, Combination):
        return replace(measure, parts=tuple((factor, _strained_measure(part, loads)) for factor, part in measure.parts))
    if not (isinstance(measure, BodyCoordinates) and measure.of_strain and measure.body in loads.stress):
        return measure
    beside = measure.weights @ loads.stress[measure.body].strained
    constant = measure.constant + float(beside[-1])
    return replace(measure, weights=measure.weights + beside[:-1], constant=constant)


def assemble(scene: Scene) -> Assembly:
    """Assemble the model of a scene for small motion, with its undamped modes.

    Args:
        scene: the scene; it is trimmed if it has a cut-off frequency.

    Returns:
        The assembly.

    Raises:
        ValueError: for a scene without static equilibrium, and for a drive whose motion other joints or drives hold.
    """
    scene = trim_scene(without_pictures(scene) if scene.cutoff_frequency else scene)
    valid = {body.name: body.reduced.valid_frequency for body in scene.flexible_bodies}  # without springs in ports
    scene, terms = _as_modelled(scene)
    coordinates = Coordinates.of(scene)
    constraints = Constraints.of(coordinates)
    warn_of_lever_arms(constraints)
    warn_of_pressed_stacks(scene)
    tangents = law_tangents(coordinates, terms, constraints.basis)
    structure = Structure.of(coordinates, tangents)
    modal = ModalModel.of(constraints, structure, valid)
    prescribed = PrescribedMotions.of(constraints, structure, modal)
    signals = Signals.of(coordinates, terms, tangents, prescribed)
    return Assembly(scene, terms, coordinates, constraints, tuple(tangents), modal, signals)


def _as_modelled(scene: Scene) -> tuple[Scene, tuple[Term, ...]]:
    """Move springs within bodies into the bodies; return the scene and its other terms.

    A spring on the charge of an electrical port is that of its own voltage, which stresses the body. A floating body
    that has only six rigid-body coordinates left becomes rigid.
    """
    added: dict[str, Array] = {}
    voltages: dict[str, dict[str, Array]] = {}
    terms = []
    for term in scene.terms:
        name = term.measure.within if isinstance(term, Spring) and not np.any(term.damping) else None
        if isinstance(term, Spring) and name is not None:
            body = scene.body(name)
            rows = term.measure.evaluate({name: ReferenceState(body)})[1][name]
            force = term.matrices[0] @ rows
            added[name] = added.get(name, 0.0) + rows.T @ force
            if isinstance(body, FlexibleBody):
                charges = [port.name for port in body.reduced.ports if np.array_equal(port.forces, rows[0])]
                voltages.setdefault(name, {}).update(dict.fromkeys(charges, -force[0]))
        else:
            terms.append(term)
    bodies: list[Body] = []
    for body in scene.bodies:
        if not isinstance(body, FlexibleBody):
            bodies.append(body)
            continue
        reduced = body.reduced
        if body.name in added:
            reduced = replace(reduced, stiffness_matrix=reduced.stiffness_matrix + added[body.name])
            reduced = with_voltage_rows(reduced, voltages.get(body.name, {}))
        stiff = body.fidelity == "ffrf" and len(reduced.mass_matrix) == 6
        bodies.append(replace(body, reduced=reduced, fidelity="rigid" if stiff else body.fidelity))
    return replace(scene, bodies=tuple(bodies)), tuple(terms)
