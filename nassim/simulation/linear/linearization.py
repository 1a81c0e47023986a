"""Linear models of scenes: small motion about the start, at rest or spinning, with open loops."""

from collections.abc import Mapping, Sequence

import numpy as np

from nassim.base.checks import Array, finite_array, known, of_kind
from nassim.base.field_types import ArrayLike
from nassim.base.warning_log import warn
from nassim.scene.field_kinds import body_of
from nassim.scene.scene import Scene
from nassim.scene.terms import PrescribedMotion
from nassim.simulation.linear.scene_state_space import state_space, steady_state
from nassim.simulation.loaded.about_equilibrium import about_equilibrium
from nassim.simulation.loaded.loaded_state import NO_LOAD, loaded_state
from nassim.simulation.loaded.rotating_signals import with_rates
from nassim.simulation.loaded.rotor_frame import (
    FRAMES,
    FrameView,
    RotorPartition,
    check_constant,
    damps_both,
    turns_as_whole,
)
from nassim.simulation.loaded.rotor_stator import stator_bodies
from nassim.simulation.loaded.stability import warn_of_instability
from nassim.simulation.model.assembly import Assembly, assemble
from nassim.systems.linear_model import LinearModel, growing_poles


def linearize(
    scene: Scene,
    *,
    angular_velocity: ArrayLike = NO_LOAD,
    axis_point: ArrayLike = NO_LOAD,
    stator: Sequence[str] | None = None,
    frame: str = "rotor",
    loaded: bool = True,
    constant_inputs: Mapping[str, float] | None = None,
) -> LinearModel:
    """Compute the linear model of a scene about its equilibrium, with the damping of its modes, bodies and dampers.

    The equilibrium is that under gravity and spin, which give stiffness to rigid bodies, joints, springs and, where
    their reduction holds their geometric stiffness, flexible bodies, see `nassim.simulation.loaded.loaded_state`. In a
    rotating frame only the gravity along the axis is constant and counts.

    A drive of constant speed defines the rotor and its speed; all else is the stator, as is the ground.

    The states are the modal amplitudes that the scene has there without the stiffness of its loads, in minimal
    coordinates and from the reference configuration, and their rates, then the charges of ports with a resistance
    (as volts) and flux linkages of coils (as amperes), the outputs of amplifiers and drives with a bandwidth, and
    the states of sensors' filters. With drives that follow inputs, the amplitudes are those of
    `nassim.simulation.model.prescribed_motion`. The scene's loops are open. The model excludes a body's own
    angular_velocity, with a warning. A model may be unstable: `unstable_poles` finds its unstable poles.

    Args:
        scene: the scene.
        angular_velocity: constant angular velocity of a scene that rotates as a whole, fixed bodies included, (3,)
            [rad/s]. The scene is then described in the rotating frame: its axes rotate, outputs read motion relative to
            the frame, the model is about the equilibrium under centrifugal forces, and the damping belongs to the
            rotating parts. See `nassim.simulation.loaded.spinning` for what it includes.
        axis_point: a point of the axis, (3,) [m].
        stator: names of all bodies of the stator, fixed ones included, while the others rotate. None: with a drive,
            the bodies that are tied to the ground rather than to the drive's rotor; without a drive, no body.
        frame: frame in which the states describe motion, where there are a rotor and a stator: "rotor" for the
            rotor's, "stator" for the stator's. The world's axes stand still, those of a point rotate with its body;
            outputs of a rotation are its deviation from the steady rotation, and velocities and accelerations are
            deviations of those against the ground, as in a run. The bodies of the other side must be rigid and equal in
            all directions across the axis, see `nassim.simulation.loaded.rotor_frame`. The scene's damping_ratio is
            then, as in floating frames, a damping of the bodies' deformation.
        loaded: whether gravity and the stress inside bodies change the stiffness. Without, the model is that of the
            reference configuration, in which a pendulum does not swing; a spin has its other terms.
        constant_inputs: constant values of inputs that load the scene too, by name: forces, voltages, accelerations of
            the base. In a spin they are constant in the frame that `frame` names. Inputs of the model are deviations
            from them, outputs those from the equilibrium.

    Returns:
        The linear model.

    Raises:
        ValueError: for loads without an equilibrium near the start, for inertial sensors in an angular_velocity, for a
            part (by name) that makes the model depend on the angle of the rotor, and for outputs that would need an
            input's derivative.

    Warns:
        UserWarning: for an equilibrium that is unstable under gravity, one beyond small motion, and bodies whose
            stress matters but is only estimated or left out.
    """
    of_kind("scene", scene, Scene)
    if not scene.speeds and not np.any(angular_velocity):
        _warn_of_own_rotation(scene)
    assembly = loaded_assembly(
        scene,
        angular_velocity=angular_velocity,
        axis_point=axis_point,
        stator=stator,
        frame=frame,
        loaded=loaded,
        inputs=constant_inputs,
        rates=True,
    )
    return linear_model(assembly)


def _warn_of_own_rotation(scene: Scene) -> None:
    """Warn of bodies whose own rotation a model about rest leaves out."""
    if scene.spinning:
        warn(
            f"body {scene.spinning[0]!r} of scene {scene.name!r} has an angular_velocity, whose gyroscopic and "
            "centrifugal effects a linear model about rest leaves out: let a Drive(speed=...) turn its joint, or "
            "give linearize the angular_velocity of a scene that turns as a whole"
        )


def linear_model(assembly: Assembly) -> LinearModel:
    """Make the linear model of an assembled scene, see `state_space`, with the inputs of its actuators only."""
    a, b, c, d = state_space(assembly)
    scene, modal = assembly.scene, assembly.modal
    inputs = scene.inputs[: len(scene.inputs) - len(scene.read_by_loops)]
    b, d = b[:, : len(inputs)], d[:, : len(inputs)]
    unsupported = np.tile(np.where(modal.unsupported, modal.frequency, 0.0), 2)
    return LinearModel(a, b, c, d, inputs, scene.outputs, scene.output_units, unsupported=unsupported)


def loaded_assembly(
    scene: Scene,
    *,
    angular_velocity: ArrayLike = NO_LOAD,
    axis_point: ArrayLike = NO_LOAD,
    stator: Sequence[str] | None = None,
    frame: str = "rotor",
    loaded: bool = True,
    weight: bool = True,
    inputs: Mapping[str, float] | None = None,
    rates: bool = False,
    at_equilibrium: bool = True,
) -> Assembly:
    """Assemble a scene with its damping at speed and the effect of its loads.

    Args:
        scene: the scene.
        angular_velocity: as of `linearize`, as are the following.
        axis_point: a point of the axis, (3,) [m].
        stator: names of the bodies of the stator.
        frame: "rotor" or "stator".
        loaded: whether gravity and the stress inside bodies change the stiffness.
        weight: whether gravity is one of the loads.
        inputs: constant values of inputs, by name.
        rates: whether velocities and accelerations of a rotor are read with the part that the rotation adds.
        at_equilibrium: whether a scene that turns as a whole, see `turns_as_whole`, is described in equilibrium.

    Returns:
        The assembly.

    Raises:
        ValueError: for several drives of constant speed, and for one that translates.
    """
    assembly = assemble(scene)
    known("frame", frame, FRAMES)
    if inputs and not loaded:
        raise ValueError("constant_inputs are loads: give them with loaded=True")
    velocity, point, names = _spin(assembly, angular_velocity, axis_point, stator)
    gravity = np.asarray(scene.gravity) * (loaded and weight)
    rate = float(np.linalg.norm(velocity))
    if rate and not (names and frame == "stator"):
        axis = velocity / rate
        gravity = axis * (axis @ gravity)
    partition = RotorPartition(velocity, point, names, frame) if rate and names else None
    whole = partition is None
    if partition is not None:
        view = FrameView(assembly, partition)
        check_constant(view)
        if damps_both(view):
            assembly = assembly.with_damping(assembly.modal.damping.of_deformation)
        whole = at_equilibrium and turns_as_whole(view)
    state = loaded_state(
        assembly,
        gravity=gravity,
        inputs=inputs,
        angular_velocity=velocity,
        axis_point=point,
        partition=None if whole else partition,
        stress=loaded,
    )
    result = about_equilibrium(assembly, state) if whole else assembly.under(state)
    if partition is not None and rates:
        result = with_rates(result, partition)
    if not rate and result.loads is not None:
        warn_of_instability(result, result.loads)
    return result


def _spin(
    assembly: Assembly, angular_velocity: ArrayLike, axis_point: ArrayLike, stator: Sequence[str] | None
) -> tuple[Array, Array, frozenset[str]]:
    """Return the angular velocity [rad/s], a point of the axis and the stator, as given or as of the scene's drive."""
    scene = assembly.scene
    names = frozenset(known("body", name, [body.name for body in scene.bodies]) for name in stator or ())
    if scene.speeds:
        if np.any(angular_velocity):
            raise ValueError(f"scene {scene.name!r} has a drive that sets the spin; give no angular_velocity")
        angular_velocity, axis_point, names = spin_of_drive(assembly, None if stator is None else names)
    velocity = finite_array("angular_velocity", np.asarray(angular_velocity, dtype=float), (3,))
    return velocity, finite_array("axis_point", np.asarray(axis_point, dtype=float), (3,)), names


def spin_of_drive(assembly: Assembly, stator: frozenset[str] | None = None) -> tuple[Array, Array, frozenset[str]]:
    """Return the angular velocity [rad/s], a point of the axis and the stator of a scene with a drive of its speed.

    Args:
        assembly: the assembled scene.
        stator: names of the bodies of the stator; None: those that are tied to the ground.

    Raises:
        ValueError: for several drives of constant speed, for one that translates, and without a stator on one side.
    """
    (drive, *others) = assembly.scene.speeds
    turned = rotor_of_drive(assembly, drive, stator)
    if others or turned is None:
        raise ValueError(
            f"scene {assembly.scene.name!r}: a linear model is about one drive that turns at constant speed"
        )
    axis, point, stator = turned
    return drive.speed * axis, point, stator


def rotor_of_drive(
    assembly: Assembly, drive: PrescribedMotion, stator: frozenset[str] | None = None
) -> tuple[Array, Array, frozenset[str]] | None:
    """Return axis, a point of the axis [m] and the stator of what a drive turns; None for one that translates.

    Args:
        assembly: the assembled scene.
        drive: the drive.
        stator: names of the bodies of the stator; None: those that are tied to the ground.

    Raises:
        ValueError: for a drive without a stator on one side.
    """
    scene = assembly.scene
    joint = scene.constraints[drive.constraint]
    axis = joint.measure.rotation_axis(drive.component)
    if axis is None:
        return None
    stator = stator_bodies(assembly, joint, axis) if stator is None else stator
    ends = [body_of(path) in stator for path in joint.points[:2]]
    if sum(ends) != 1:
        raise ValueError(f"joint {joint.name!r}: a drive that turns far needs a stator on one of its two sides")
    return (1.0 if ends[0] else -1.0) * axis, scene.point_position(joint.points[0]), stator


def spinning_equilibrium(
    scene: Scene,
    *,
    angular_velocity: ArrayLike = NO_LOAD,
    axis_point: ArrayLike = NO_LOAD,
    stator: Sequence[str] | None = None,
    frame: str = "rotor",
) -> dict[str, float]:
    """Compute the outputs of a scene at rest in a rotating frame, under centrifugal forces without gravity and inputs.

    Loops are open.

    Args:
        scene: the scene.
        angular_velocity: as of `linearize`, as are the following.
        axis_point: a point of the axis, (3,) [m].
        stator: names of the bodies of the stator.
        frame: "rotor" or "stator".

    Returns:
        Values of the outputs, by name.

    Raises:
        ValueError: if there is no equilibrium within small motion, and if it is unstable.
    """
    assembly = loaded_assembly(
        scene, angular_velocity=angular_velocity, axis_point=axis_point, stator=stator, frame=frame, weight=False
    )
    state, *_ = state_space(assembly)
    if growing := growing_poles(np.linalg.eigvals(state)):
        raise ValueError(f"the spinning equilibrium of scene {scene.name!r} is unstable: {growing[0]}; spin slower")
    return steady_outputs(assembly)


def steady_outputs(assembly: Assembly) -> dict[str, float]:
    """Compute the outputs of a scene that has always been under its loads, by name, see `steady_state`; loops are open.

    Args:
        assembly: the assembled scene with the effect of its loads.
    """
    scene, n = assembly.scene, len(assembly.modal.frequency)
    state, drives, readings, feedthrough = state_space(assembly)
    n_in = len(scene.inputs)
    if not assembly.rotation:  # accelerations of what rests vanish but for rounding
        readings = readings - assembly.signals.acceleration_matrix @ assembly.modal.modes @ state[n : 2 * n]
    values = readings @ steady_state(assembly, state, drives[:, n_in:]) + feedthrough[:, n_in:] @ assembly.known[1]
    return dict(zip(scene.outputs, values.tolist(), strict=True))
