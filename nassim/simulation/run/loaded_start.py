"""Assembly of scenes for runs, with the stiffness that their loads at the start add."""

from collections.abc import Collection, Mapping
from dataclasses import replace

import numpy as np

from nassim.base.checks import Array
from nassim.base.warning_log import mute_warnings, warn
from nassim.scene.scene import Scene
from nassim.scene.terms import PrescribedMotion
from nassim.simulation.linear.folding_warning import warn_of_folding
from nassim.simulation.linear.linearization import linear_model, loaded_assembly, rotor_of_drive, spin_of_drive
from nassim.simulation.linear.scene_state_space import state_space, steady_state
from nassim.simulation.loaded.about_equilibrium import about_equilibrium
from nassim.simulation.loaded.first_order_equilibrium import check_small, is_at_equilibrium, moved_by_drives
from nassim.simulation.loaded.geometric_stiffness import is_preloaded
from nassim.simulation.loaded.loaded_state import loaded_state
from nassim.simulation.loaded.path_models import PathModels, path_models
from nassim.simulation.loaded.present_stress import PresentStress
from nassim.simulation.loaded.rotating_signals import with_rotation
from nassim.simulation.loaded.rotor_frame import FRAMES, ChangesWithAngle, RotorPartition
from nassim.simulation.loaded.stability import describe_instability
from nassim.simulation.model.assembly import Assembly, assemble
from nassim.simulation.model.effect_of_loads import LoadedState
from nassim.simulation.model.motion_size import scene_size
from nassim.simulation.model.moved_coordinates import MovedCoordinates
from nassim.simulation.model.tangents import no_equilibrium
from nassim.systems.linear_model import growing_poles

STARTS_WITH = 1e-6
"""Relative difference up to which a body's angular velocity is that of the steady rotation."""
FARTHEST = 0.1
"""Displacement over the size of the scene beyond which an equilibrium is none."""
SWAYING = 0.01
"""Relative change of the stiffness of modes as the rotor turns above which a warning is given."""
NEUTRAL = 1e-9
"""Share of all weight that a rigid-body mode may feel by rounding."""


def assemble_exact(scene: Scene, *, released: bool, inputs: Mapping[str, float] | None) -> Assembly:
    """Assemble a scene for exact steps, at rest or about a steady rotation.

    Args:
        scene: the scene.
        released: whether the run starts in the reference configuration and not in equilibrium.
        inputs: constant values of inputs, by name.

    Returns:
        The assembly.

    Raises:
        ValueError: as `assemble_small_motion` and `assemble_spin`.
        RuntimeError: as these.

    Warns:
        UserWarning: as these, and of modes that could make loops unstable.
    """
    make = assemble_spin if scene.speeds else assemble_small_motion
    assembly = make(scene, released=released, inputs=inputs)
    if scene.loops and np.any(assembly.modal.unsupported):
        warn_of_folding(linear_model(assembly), scene.loops)
    return assembly


def assemble_small_motion(
    scene: Scene, *, released: bool = False, inputs: Mapping[str, float] | None = None
) -> Assembly:
    """Assemble a scene with the effect of gravity, preload and constant inputs on small motion.

    Args:
        scene: the scene.
        released: whether the run starts in the reference configuration, about which the model then is.
        inputs: constant values of inputs, by name.

    Returns:
        The assembly.

    Raises:
        ValueError: for an equilibrium beyond small motion, and for an unstable one that no loop may hold.
        RuntimeError: when gravity or a constant input does work on a rigid-body mode.

    Warns:
        UserWarning: as `nassim.simulation.loaded_state`.
    """
    assembly = assemble(scene)
    loads = loaded_state(assembly, gravity=scene.gravity, inputs=inputs, checked=False)
    if released:
        return assembly.under(loads)
    _check_held(assembly, inputs or {})
    displacement = assembly.modal.modes @ loads.equilibrium
    check_small(assembly.coordinates, displacement, "its loads", settled=is_at_equilibrium(assembly))
    result = about_equilibrium(assembly, loads)
    if result.loads and (instability := describe_instability(result, result.loads.stiffness)):
        if not scene.loops:
            raise ValueError(f'{instability}; start in the reference configuration by start="released"')
        warn(f"{instability}; only its loops can hold it")
    return result


def assemble_spin(scene: Scene, *, released: bool = False, inputs: Mapping[str, float] | None = None) -> Assembly:
    """Assemble a scene that a drive of constant speed turns, about its steady rotation, for exact steps.

    Args:
        scene: the scene.
        released: whether the run starts in the reference configuration and not in equilibrium.
        inputs: constant values of inputs, by name.

    Returns:
        The assembly, in the frame of the rotor or else of the stator, with absolute outputs.

    Raises:
        ValueError: for a scene whose model changes as the rotor turns, for outputs that a model cannot read, without an
            equilibrium within small motion, for an unstable one that no loop may hold, and for bodies with another
            angular velocity.
        RuntimeError: when weight or centrifugal forces drive a motion that nothing holds.

    Warns:
        UserWarning: as `nassim.simulation.loaded_state`, of an unstable equilibrium that only loops can hold, and of
            gravity across the axis whose stiffness matters.
    """
    refused: list[str] = []
    for frame in FRAMES:
        try:
            assembly = loaded_assembly(scene, frame=frame, inputs=inputs, at_equilibrium=not released)
            partition = RotorPartition(*spin_of_drive(assembly), frame)
            assembly = with_rotation(assembly, partition, scene.gravity, released=released)
            if not scene.of_fidelity("linear"):  # as in runs in floating frames
                assembly = assembly.with_damping(assembly.modal.damping.of_deformation)
            state, drives, _, _ = state_space(assembly)
            break
        except ChangesWithAngle as error:
            refused.append(str(error))
        except ValueError as error:
            raise ValueError(f'method "exact": {error}; or take generalized_alpha') from error
    else:
        raise ValueError(
            f'method "exact" needs a model that does not change as the rotor of scene {scene.name!r} turns, and found '
            f"none in the frame of the rotor or of the stator ({'; '.join(refused)}); let the drive follow an input, "
            "its angle, for a sequence of models, or take generalized_alpha"
        )
    if not released:
        _check_velocities(scene, partition)
        _check_steady(assembly, state, drives[:, len(scene.inputs) :])
        _check_stable(scene, state)
    if assembly.rotation and np.any(assembly.rotation.force):
        _warn_of_swaying_weight(assemble(scene), partition)
    return assembly


def assemble_path(
    scene: Scene, drive: int, ends: tuple[float, float], highest: float, inputs: Mapping[str, float]
) -> PathModels:
    """Make the models of small motion along the path of a drive, for exact steps.

    Args:
        scene: the scene.
        drive: index of the drive among those that follow inputs.
        ends: least and largest angle of the path [rad].
        highest: highest frequency at which models are compared [Hz].
        inputs: constant values of inputs, by name.

    Returns:
        The models.

    Raises:
        ValueError: as `nassim.simulation.loaded.path_models.path_models`, and for bodies with no side of the drive.
    """
    assembly = assemble(scene)
    try:
        turned = rotor_of_drive(assembly, scene.prescribed[drive])
    except ValueError as error:
        raise ValueError(f'method "exact": {error}; or take generalized_alpha') from error
    assert turned is not None  # `path_drive` finds drives that turn
    axis, point, stator = turned
    partition = RotorPartition(axis / np.linalg.norm(axis), point, stator, "stator")
    return path_models(assembly, partition, drive, ends, inputs, highest)


def _check_velocities(scene: Scene, partition: RotorPartition) -> None:
    """Refuse bodies with an angular velocity other than that of their side of the steady rotation."""
    for body in scene.bodies:
        steady = partition.velocity * (body.name not in partition.stator)
        if np.any(body.angular_velocity) and not np.allclose(body.angular_velocity, steady, rtol=STARTS_WITH):
            raise ValueError(
                f"body {body.name!r} has an angular_velocity other than that of the steady rotation about which exact "
                'steps start: leave it out, give start="released", or take generalized_alpha'
            )


def _check_steady(assembly: Assembly, state: Array, by_known: Array) -> None:
    """Check that a spinning scene has a steady state to start in, within small motion.

    Args:
        assembly: the assembly about the rotation.
        state: A of its model, (n, n).
        by_known: columns of B of its known functions, (n, known).
    """
    assert assembly.rotation is not None
    scene, slices, modal = assembly.scene, assembly.coordinates.slices, assembly.modal
    n, size, loose = len(modal.frequency), scene_size(scene), modal.rigid_modes
    constant = steady_state(replace(assembly, rotation=None), state, by_known)
    left = (state @ constant + by_known[:, 0])[n : 2 * n]
    motion = modal.modes @ steady_state(assembly, state, by_known)[:n]
    accelerations = modal.modes[:, loose] @ left[loose]
    fastest = NEUTRAL * (float(np.linalg.norm(scene.gravity)) + assembly.rotation.rate**2 * size)
    for name, place in slices.items():
        way, acceleration = (float(np.linalg.norm(values[place][:3])) for values in (motion, accelerations))
        if way > FARTHEST * size or acceleration > fastest:
            raise RuntimeError(
                f"scene {scene.name!r} has no equilibrium to start from as it turns: weight and centrifugal forces "
                f"drive body {name!r} in a motion that nothing holds, or at its critical speed; add a spring or a "
                'joint, change the speed, or give start="released"'
            )
    if isinstance(assembly.coordinates, MovedCoordinates):  # the model is about the constant part, checked before
        motion = motion - modal.modes @ constant[:n]
    check_small(assembly.coordinates.reference, motion, "weight and spin")


def _check_stable(scene: Scene, state: Array) -> None:
    """Refuse an unstable steady rotation unless loops may hold it; state: A of its model, (n, n)."""
    if growing := growing_poles(np.linalg.eigvals(state)):
        found = f"the spinning equilibrium of scene {scene.name!r} to start from is unstable: {growing[0]}"
        if not scene.loops:
            raise ValueError(f'{found}; change the speed, or start in the reference configuration by start="released"')
        warn(f"{found}; only its loops can hold it")


def _warn_of_swaying_weight(assembly: Assembly, partition: RotorPartition) -> None:
    """Warn of gravity across the axis whose stiffness, which changes as the rotor turns, matters."""
    axis = partition.velocity / np.linalg.norm(partition.velocity)
    gravity = assembly.scene.gravity - axis * (axis @ assembly.scene.gravity)
    frequency = np.maximum(assembly.modal.frequency, np.linalg.norm(partition.velocity) / (2 * np.pi))
    scale = 1 / (2 * np.pi * frequency)
    share = 0.0
    for across in (gravity, np.cross(axis, gravity)):
        stiffness = loaded_state(assembly, gravity=across, checked=False).stiffness
        share = max(share, float(np.linalg.norm(scale[:, None] * stiffness * scale, 2)))
    if share > SWAYING:
        warn(
            f"gravity across the axis changes the stiffness of modes by up to some {100 * share:.2g} % as the rotor "
            "turns, which exact steps leave out: compare with generalized_alpha"
        )


def assemble_large_motion(
    scene: Scene, inputs: Mapping[str, float] | None = None, strokes: Mapping[str, float] | None = None
) -> tuple[Assembly, frozenset[str]]:
    """Assemble a scene with the geometric stiffness of the stress in its flexible bodies at the start.

    The stress is that under gravity, preload, constant inputs and a drive of constant speed. It stays as the scene
    moves. Weights, joints and springs need no stiffness of their own, as floating bodies carry their forces along.

    Args:
        scene: the scene.
        inputs: constant values of inputs, by name.
        strokes: constant values of inputs that drives follow, by name; left out beside nonlinear springs.

    Returns:
        The assembly, and the names of the bodies whose stress by the drive's speed it has.

    Warns:
        UserWarning: as `nassim.simulation.loaded_state` of stress that is only estimated.
    """
    assembly = assemble(scene)
    floating = {body.name for body in assembly.scene.of_fidelity("ffrf")}
    loaded = np.any(scene.gravity) or scene.speeds or inputs or strokes or is_preloaded(assembly.tangents)
    if not (floating and loaded):
        return assembly, frozenset()
    moved = moved_by_drives(assembly, strokes or {} if assembly.is_linear else {})
    loads, spinning = _loads(scene, assembly, inputs, moved)
    known = {body.name for body in assembly.scene.deformable_bodies if body.reduced.stress_stiffness}
    return assembly.under(loads), frozenset(known & floating if spinning else ())


def present_stress(assembly: Assembly, stressed: Collection[str]) -> PresentStress:
    """Compute how the stress in floating bodies changes with the speed of a drive and the direction of gravity.

    Args:
        assembly: the assembled scene, with the stiffness of its loads at the start.
        stressed: names of the bodies whose stress by the drive's speed it has.

    Returns:
        The change since the start.

    Raises:
        ValueError: without one drive that turns a joint, and without floating bodies that hold their geometric
            stiffness.
    """
    scene = assembly.scene
    found = [(drive, rotor_of_drive(assembly, drive)) for drive in scene.terms_of(PrescribedMotion)]
    turned = [(drive, rotor) for drive, rotor in found if rotor is not None]
    known = [body.name for body in scene.of_fidelity("ffrf") if body.reduced.stress_stiffness]
    if len(turned) != 1 or not known:
        raise ValueError(
            f'scene {scene.name!r}: stress="present" follows the speed of one drive that turns a joint, in bodies of '
            'fidelity "ffrf" that are reduced by craig_bampton(..., geometric_stiffness=True); it has '
            f'{len(turned)} such drives and {len(known)} such bodies: leave stress="start"'
        )
    ((drive, rotor),) = turned
    return PresentStress.of(assembly, known, *rotor, speed=drive.speed if stressed else 0.0)


def _loads(
    scene: Scene, assembly: Assembly, inputs: Mapping[str, float] | None, moved: Array
) -> tuple[LoadedState, bool]:
    """Return the effect of the loads at the start, and whether that of a spin is included."""
    if scene.speeds:
        # Muted are the warnings of the linear model about the spin, of which the run has its own.
        with mute_warnings(r"under the spin|body .* turns at"):
            try:
                state = loaded_assembly(scene, inputs=inputs, at_equilibrium=False).loads
            except ValueError:  # no linear model about this spin
                state = None
        if state is not None:
            return state, True
    state = loaded_state(assembly, gravity=scene.gravity, inputs=inputs, moved=moved, checked=False)
    return (replace(state, carried={}) if scene.speeds else state), False


def _check_held(assembly: Assembly, inputs: Mapping[str, float]) -> None:
    """Raise RuntimeError when loads do work on a rigid-body mode; without work, equilibrium is neutral."""
    modes = assembly.modal.modes
    values = [inputs.get(name, 0.0) for name in assembly.scene.inputs]
    by_input = modes.T @ assembly.signals.forces_at_rest * values
    moving = [body for body in assembly.scene.bodies if body.name in assembly.coordinates.slices]
    mass = sum(body.rigid_inertia[0] for body in moving)
    # Of unit modal mass, no motion can feel more than all masses falling together.
    most = np.sqrt(mass) * float(np.linalg.norm(assembly.scene.gravity))
    most += float(np.linalg.norm(np.abs(by_input).sum(axis=1)))  # pushes that balance each other count
    felt = (modes.T @ assembly.signals.weight + by_input.sum(axis=1))[assembly.modal.rigid_modes]
    if np.abs(felt).max(initial=0.0) > NEUTRAL * most:
        raise RuntimeError(no_equilibrium(assembly.scene))
