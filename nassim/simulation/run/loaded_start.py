"""Assembly of scenes for runs, with the stiffness that their loads at the start add."""

import warnings
from collections.abc import Collection, Mapping
from dataclasses import replace

import numpy as np

from nassim.base.callers import outside
from nassim.scene.scene import Scene
from nassim.scene.terms import PrescribedMotion
from nassim.simulation.linear.linearization import NO_SPIN, loaded_assembly, rotor_of_drive
from nassim.simulation.loaded.equilibrium import check_small
from nassim.simulation.loaded.geometric_stiffness import is_preloaded
from nassim.simulation.loaded.loaded_state import describe_instability, loaded_state
from nassim.simulation.loaded.present_stress import PresentStress
from nassim.simulation.model.assembly import Assembly, assemble
from nassim.simulation.model.effect_of_loads import LoadedState
from nassim.simulation.model.tangents import NO_EQUILIBRIUM

NEUTRAL = 1e-9
"""Share of all weight that a rigid-body mode may feel by rounding."""


def assemble_small_motion(
    scene: Scene, *, released: bool = False, inputs: Mapping[str, float] | None = None
) -> Assembly:
    """Assemble a scene with the effect of gravity, preload and constant inputs on small motion.

    Args:
        scene: the scene.
        released: whether the run starts in the reference configuration and not in equilibrium.
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
    if not released:
        _check_held(assembly, inputs or {})
        check_small(assembly.coordinates, assembly.modal.modes @ loads.equilibrium, "its loads")
        if instability := describe_instability(assembly, loads.stiffness):
            if not scene.loops:
                raise ValueError(f'{instability}; start in the reference configuration by start="released"')
            warnings.warn(f"{instability}; only its loops can hold it", stacklevel=outside())
    return replace(assembly, loads=loads)


def assemble_large_motion(scene: Scene, inputs: Mapping[str, float] | None = None) -> tuple[Assembly, frozenset[str]]:
    """Assemble a scene with the geometric stiffness of the stress in its flexible bodies at the start.

    The stress is that under gravity, preload, constant inputs and a drive of constant speed. It stays as the scene
    moves. Weights, joints and springs need no stiffness of their own, as floating bodies carry their forces along.

    Args:
        scene: the scene.
        inputs: constant values of inputs, by name.

    Returns:
        The assembly, and the names of the bodies whose stress by the drive's speed it has.

    Warns:
        UserWarning: as `nassim.simulation.loaded_state` of stress that is only estimated.
    """
    assembly = assemble(scene)
    floating = {body.name for body in assembly.scene.deformable_bodies if body.fidelity == "ffrf"}
    loaded = np.any(scene.gravity) or scene.speeds or inputs or is_preloaded(assembly.tangents)
    if not (floating and loaded):
        return assembly, frozenset()
    loads, spinning = _loads(scene, assembly, inputs)
    known = {body.name for body in assembly.scene.deformable_bodies if body.reduced.stress_stiffness}
    return replace(assembly, loads=loads), frozenset(known & floating if spinning else ())


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
    known = [body.name for body in scene.deformable_bodies if body.fidelity == "ffrf" and body.reduced.stress_stiffness]
    if len(turned) != 1 or not known:
        raise ValueError(
            f'scene {scene.name!r}: stress="present" follows the speed of one drive that turns a joint, in bodies of '
            'fidelity "ffrf" that are reduced by craig_bampton(..., geometric_stiffness=True); it has '
            f'{len(turned)} such drives and {len(known)} such bodies: leave stress="start"'
        )
    ((drive, rotor),) = turned
    return PresentStress.of(assembly, known, *rotor, speed=drive.speed if stressed else 0.0)


def _loads(scene: Scene, assembly: Assembly, inputs: Mapping[str, float] | None) -> tuple[LoadedState, bool]:
    """Return the effect of the loads at the start, and whether that of a spin is included."""
    if scene.speeds:
        with warnings.catch_warnings():
            # Those of the linear model about the spin; the run has its own, and shows all others.
            warnings.filterwarnings("ignore", message=r"under the spin|body .* turns at")
            try:
                state = loaded_assembly(scene, NO_SPIN, NO_SPIN, None, "rotor", inputs=inputs).loads
            except ValueError:  # no linear model about this spin
                state = None
        if state is not None:
            return state, True
    return loaded_state(assembly, gravity=scene.gravity, inputs=inputs, checked=False), False


def _check_held(assembly: Assembly, inputs: Mapping[str, float]) -> None:
    """Raise RuntimeError when loads do work on a rigid-body mode; without work, equilibrium is neutral."""
    modes = assembly.modal.modes[:, assembly.modal.rigid_modes]
    applied = assembly.signals.input_matrix @ [inputs.get(name, 0.0) for name in assembly.scene.inputs]
    moving = [body for body in assembly.scene.bodies if body.name in assembly.coordinates.slices]
    mass = sum(body.rigid_inertia[0] for body in moving)
    # Of unit modal mass, no motion can feel more than all masses falling together.
    most = np.sqrt(mass) * float(np.linalg.norm(assembly.scene.gravity))
    most += float(np.linalg.norm(assembly.modal.modes.T @ applied))
    if np.abs(modes.T @ (assembly.signals.weight + applied)).max(initial=0.0) > NEUTRAL * most:
        raise RuntimeError(NO_EQUILIBRIUM)
