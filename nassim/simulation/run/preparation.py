"""Checks, assembly and equilibrium before the steps of a run, and warnings after them, for all engines."""

from collections.abc import Mapping, Sequence
from dataclasses import KW_ONLY, InitVar

import numpy as np

from nassim.base.checks import Array, freeze, known, of_kind, positive
from nassim.base.field_types import Field, data_class
from nassim.base.progress import tell
from nassim.base.warning_log import warn
from nassim.scene.scene import Scene
from nassim.simulation.exudyn.monitor import Monitor
from nassim.simulation.exudyn.running_system import StressChange, System
from nassim.simulation.exudyn.solver import solve_static
from nassim.simulation.exudyn.steady_state import solve_steady_rotation
from nassim.simulation.exudyn.system import build_system
from nassim.simulation.linear.scene_state_space import state_space
from nassim.simulation.loaded.geometric_stiffness import is_preloaded
from nassim.simulation.loaded.path_models import PathModels
from nassim.simulation.model.assembly import Assembly
from nassim.simulation.model.axial_preload import axial_forces_under, warn_of_buckling
from nassim.simulation.model.initial_velocities import (
    has_free_rotation,
    initial_twists,
    is_axisymmetric,
    steady_rotation_twists,
)
from nassim.simulation.model.motion_size import motion_sizes
from nassim.simulation.model.period_correction import Steps
from nassim.simulation.model.step_errors import describe_commands, describe_steps
from nassim.simulation.run.checks import (
    STARTS,
    check_constant_inputs,
    check_drives,
    check_exact,
    check_loops,
    check_options,
    check_stability,
    path_drive,
)
from nassim.simulation.run.loaded_start import (
    assemble_exact,
    assemble_large_motion,
    assemble_path,
    assemble_small_motion,
    present_stress,
)
from nassim.simulation.run.warnings_of_runs import (
    RINGING,
    centrifugal_acceleration,
    ringing_outputs,
    warn_of_changed_modes,
    warn_of_drift,
    warn_of_far_equilibrium,
    warn_of_frames,
    warn_of_jolts,
    warn_of_linear_bodies_that_turn,
    warn_of_motion,
    warn_of_ringing,
    warn_of_spin,
)

METHODS = ("generalized_alpha", "exact", "explicit")
STRESSES = ("start", "present")
TURNING_RADIUS = 0.9
"""Spectral radius where bodies can turn far: for up to 0.1 rad in a step."""


@data_class
class Options:
    """How a run of a scene steps and starts; see `nassim.simulation.simulate`."""

    scene: InitVar[Scene]
    _: KW_ONLY
    time_step: float
    method: str
    spectral_radius: Field[float | None, float]
    hold_order: Field[int | None, int]
    start: str
    period_correction: bool
    stress: str
    constant_inputs: Field[Mapping[str, float] | None, Mapping[str, float]]

    def __post_init__(self, scene: Scene) -> None:
        of_kind("scene", scene, Scene)
        step = positive("time_step", self.time_step, "s")
        method, stress = known("method", self.method, METHODS), known("stress", self.stress, STRESSES)
        known("start", self.start, STARTS)
        if stress != "start" and (method != "generalized_alpha" or scene.in_small_motion):
            raise ValueError(
                f'stress={stress!r} is of floating frames (fidelity "ffrf") by method="generalized_alpha"; scene '
                f"{scene.name!r} by method {method!r} has the stress of the start, leave it out"
            )
        check_options(method, self.spectral_radius, self.hold_order)
        constant = check_constant_inputs(scene, self.constant_inputs)
        if not self.period_correction and method != "generalized_alpha":
            raise ValueError(f'period_correction is of "generalized_alpha"; method {method!r} has none, leave it out')
        radius, order = self.spectral_radius, self.hold_order
        if radius is None:
            far = method == "generalized_alpha" and not scene.in_small_motion
            turning = TURNING_RADIUS if far and has_free_rotation(scene) else 1.0
            radius = RINGING if far and ringing_outputs(scene, step) else turning
        freeze(
            self,
            time_step=step,
            spectral_radius=radius,
            hold_order=1 if order is None else order,
            constant_inputs=constant,
        )

    @property
    def released(self) -> bool:
        """Whether the scene starts in its reference configuration."""
        return self.start == "released"

    @property
    def steps(self) -> Steps | None:
        """Steps of generalized-alpha; None of other methods."""
        if self.method != "generalized_alpha":
            return None
        return Steps(self.time_step, self.spectral_radius, self.period_correction)


def check_run(scene: Scene, options: Options, signals: Mapping[str, Array]) -> None:
    """Check that a scene, its inputs and the options of a run fit each other; warn of ringing.

    Args:
        scene: the scene.
        options: of the run.
        signals: values of the inputs by name, shape (n,) each.

    Raises:
        ValueError: where they do not fit.
    """
    check_loops(scene, options.time_step)
    check_drives(scene, signals)
    if options.method == "exact":
        check_exact(scene, signals)
    elif options.method == "explicit":
        check_stability(scene, options.time_step)
    elif not scene.in_small_motion:
        warn_of_ringing(scene, options.spectral_radius, options.time_step)
        assert options.steps is not None
        warn_of_jolts(scene, options.steps, signals)


def exact_assembly(scene: Scene, signals: Mapping[str, Array], options: Options) -> tuple[Assembly, PathModels | None]:
    """Assemble a scene for exact steps; warn of modes that could make its loops unstable.

    Args:
        scene: the scene.
        signals: values of the inputs by name, shape (n,) each.
        options: of the run.

    Returns:
        The assembly at the start, and the models along the path of a drive, see `path_drive`; a message tells how far
        apart these are.
    """
    drive = path_drive(scene, signals)
    if drive is None:
        return assemble_exact(scene, released=options.released, inputs=options.constant_inputs), None
    path = signals[scene.prescribed[drive].input]
    ends = float(path.min()), float(path.max())
    models = assemble_path(scene, drive, ends, 0.5 / options.time_step, options.constant_inputs)
    tell(models.description)
    return models.start, models


def start_system(
    scene: Scene, options: Options, rates: Mapping[str, float], steady: Mapping[str, float], highest: float = 0.0
) -> tuple[System, list[str]]:
    """Build Exudyn's system of a scene and bring it to its start.

    Args:
        scene: what is simulated.
        options: of the run.
        rates: at the start, of inputs that prescribe motions.
        steady: the same, 0 where they do not go on.
        highest: frequency up to which a message describes the effect of the steps on modes [Hz].

    Returns:
        The system, and the names of bodies whose spin needs no (other) warning.
    """
    twists = initial_twists(scene, rates)
    assembly, stressed, changes = _assemble_start(scene, options)
    warn_of_linear_bodies_that_turn(scene, twists)
    speeds = {name: float(np.linalg.norm(twist[3:])) for name, twist in twists.items()}
    told = [*stressed, *warn_of_spin(scene, speeds, stressed)]
    if options.steps and highest:
        for line in (describe_steps(assembly, options.steps, highest), describe_commands(assembly, options.time_step)):
            if line:
                tell(line)
    system = build_system(assembly, rates, options.steps, changes)
    system.update_stress()
    if not scene.in_small_motion:  # small motion has them among its loads
        system.add_constant_inputs(options.constant_inputs)
    if not options.released:
        if bring_to_equilibrium(system, steady, options.constant_inputs):
            warn_of_far_equilibrium(system)
        _tell_of_centrifugal_forces(scene, steady, twists)
    return system, told


def _assemble_start(scene: Scene, options: Options) -> tuple[Assembly, frozenset[str], Mapping[str, StressChange]]:
    """Assemble a scene with the effect of its loads at the start.

    Returns:
        The assembly; the names of the floating bodies whose stress by a spin it has or follows; and how the stress in
        floating bodies changes.
    """
    if scene.in_small_motion:
        assembly = assemble_small_motion(scene, released=options.released, inputs=options.constant_inputs)
        state_space(assembly)  # refuses outputs that need a derivative of a prescribed motion
        return assembly, frozenset(), {}
    assembly, stressed = assemble_large_motion(scene, options.constant_inputs)
    if options.stress == "start":
        return assembly, stressed, {}
    changes = present_stress(assembly, stressed).changes
    return assembly, stressed | changes.keys(), changes


def _tell_of_centrifugal_forces(scene: Scene, steady: Mapping[str, float], twists: Mapping[str, Array]) -> None:
    """Tell of the centrifugal forces without which a run starts whose drive turns no steady rotation."""
    if scene.speeds and steady_rotation_twists(scene, steady) is None:
        largest = max(centrifugal_acceleration(body, twists[body.name]) for body in scene.bodies if body.moves)
        tell(
            f"what drive {scene.speeds[0].constraint!r} moves is no steady rotation against the ground: the run "
            f"starts without its centrifugal forces, up to {largest:.3g} m/s2 at points of the bodies, so with a "
            "transient as large as what they move; exact steps start a rotor on a moving stator in its steady "
            "whirl, where they can"
        )


def bring_to_equilibrium(
    system: System, rates: Mapping[str, float], constant_inputs: Mapping[str, float] | None = None
) -> bool:
    """Bring a system into its static equilibrium or into that of its steady rotation.

    Args:
        system: Exudyn's system, changed.
        rates: initial rates of prescribed motions, by input; 0 for those that are not steady.
        constant_inputs: constant values of inputs that the system has, by name.

    Returns:
        Whether gravity, preload, constant inputs or rotation load the system.
    """
    scene = system.assembly.scene
    twists = steady_rotation_twists(scene, rates)
    if twists is None:
        loaded = bool(np.any(scene.gravity) or constant_inputs) or is_preloaded(system.assembly.tangents)
        if loaded:
            solve_static(system)
        return loaded
    growing, sway = solve_steady_rotation(system, twists)
    if sway is not None:
        warn(
            f"scene {scene.name!r} has no steady rotation: weight, constant inputs, springs or joints act on the rotor "
            f"along directions that change as it turns; after a radian, bodies would rest up to {sway:.3g} m elsewhere "
            "on it. The start of a run, and static responses, are those of rest on the rotor at the first angle; the "
            "motion of fast rotors may be farther from it. Exact steps start in the motion that weight keeps up"
        )
    if growing and not scene.loops and is_axisymmetric(scene, twists):
        raise ValueError(
            f"the spinning equilibrium of scene {scene.name!r} to start from is unstable: {growing[0]}; change the "
            'speed, or start in the reference configuration by simulate(..., start="released")'
        )
    return True


def warn_after_steps(system: System, monitor: Monitor, told: Sequence[str], options: Options) -> None:
    """Give the warnings of the checks of an Exudyn run.

    Args:
        system: Exudyn's system after the run.
        monitor: the checks of the run.
        told: bodies that a warning has named before.
        options: of the run.
    """
    assembly, scene = system.assembly, system.assembly.scene
    warn_of_spin(scene, monitor.speeds, told)
    warn_of_motion(assembly, monitor.largest)
    warn_of_frames(assembly, monitor.most_turned)
    warn_of_buckling(assembly, monitor.slackest)
    warn_of_changed_modes(assembly, monitor.shifts)
    warn_of_drift(monitor.describe_drift(options.time_step, options.spectral_radius))


def warn_after_exact_steps(assembly: Assembly, coordinates: Array) -> None:
    """Warn of motion and preload in exact steps.

    Args:
        assembly: the assembled scene.
        coordinates: all coordinates at some times, (n_all, n_times).
    """
    slices = assembly.coordinates.slices
    warn_of_motion(assembly, motion_sizes(assembly.coordinates, coordinates))
    least = {}
    for body in assembly.scene.deformable_bodies:
        rows, constant = axial_forces_under(assembly, body)
        least[body.name] = (rows @ coordinates[slices[body.name]]).min(axis=1) + constant
    warn_of_buckling(assembly, least)
