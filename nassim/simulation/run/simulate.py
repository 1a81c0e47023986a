"""Time-domain simulation and static equilibrium of scenes."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from nassim.base.checks import Array, finite, known, of_kind
from nassim.base.progress import stage
from nassim.scene.motion import Motion
from nassim.scene.port_voltages import recorded_voltages, with_voltage_sensors
from nassim.scene.scene import Scene
from nassim.signals.time_history import TimeHistory, occupied_bandwidth
from nassim.simulation.exudyn.monitor import Monitor
from nassim.simulation.exudyn.motion_recorder import MotionRecorder
from nassim.simulation.exudyn.solver import (
    eigenfrequencies,
    loaded_eigenfrequencies,
    solve_dynamic,
    solve_static,
)
from nassim.simulation.exudyn.system import build_system
from nassim.simulation.linear.exact_steps import exact_response
from nassim.simulation.linear.linearization import steady_outputs
from nassim.simulation.linear.path_steps import path_response
from nassim.simulation.model.assembly import Assembly, assemble
from nassim.simulation.model.axial_preload import warn_of_buckling
from nassim.simulation.model.initial_velocities import steady_rotation_twists
from nassim.simulation.model.prescribed_motion import PrescribedMotions
from nassim.simulation.model.recorded_motion import recorded_motion, recorded_steps, traced
from nassim.simulation.model.stopped_runs import Stopped
from nassim.simulation.run.loaded_start import assemble_large_motion, assemble_small_motion, assemble_spin
from nassim.simulation.run.loop_notes import find_saturations, loop_notes, warn_of_saturation
from nassim.simulation.run.preparation import (
    Options,
    bring_to_equilibrium,
    check_run,
    exact_assembly,
    start_system,
    warn_after_exact_steps,
    warn_after_steps,
)
from nassim.simulation.run.sampled_inputs import sample_excitation, without_noise
from nassim.simulation.run.warnings_of_runs import warn_of_frames, warn_of_motion

LARGEST_TURN = 0.5
"""Largest turn [rad] of a drive at a time in statics: a joint holds as well where it is turned by half a turn more."""
STEADY = 1e-3
"""Change of a drive's speed from step to step, over the speed, up to which the speed is one to start at."""


def simulate(
    scene: Scene,
    excitation: TimeHistory | None,
    *,
    time_step: float,
    duration: float | None = None,
    outputs: Sequence[str] | None = None,
    method: str = "generalized_alpha",
    spectral_radius: float | None = None,
    hold_order: int | None = None,
    start: str = "equilibrium",
    period_correction: bool = True,
    stress: str = "start",
    constant_inputs: Mapping[str, float] | None = None,
    progress: bool = True,
) -> TimeHistory:
    """Simulate a scene and record its inputs and outputs together at every time step.

    The stiffness is that about the start: gravity, preload, constant inputs and, in floating bodies, a drive of
    constant speed add to it, see `nassim.simulation.loaded_state`.

    Args:
        scene: what is simulated.
        excitation: one signal per input of the scene, but for inputs that only a loop drives; between its samples it
            runs straight; in the inputs' units, in others that convert to them ("mV", "kN"), or without. None: all
            inputs stay 0, as they must for a scene without inputs; give a duration.
        time_step: of the integrator [s].
        duration: a whole number of steps [s] (default: those within the excitation).
        outputs: names (default: all outputs of the scene, then the commands of its loops).
        method: "generalized_alpha", "exact" or "explicit"; outputs mean the same by all of them.

            - "generalized_alpha" is Exudyn's implicit integrator. It takes every scene.
            - "exact" is the exact discrete-time solution for small motion, a hundred times as fast. The motion is
              small about rest, where no body is "ffrf"; about the rotation by one drive of constant speed; or about
              the path of one drive whose input turns a joint, where a sequence of models follows the path. Rigid
              bodies alone are in small motion too.
            - "explicit" is the Runge-Kutta rule of order 4, for scenes in small motion (`Scene.in_small_motion`)
              without outputs of accelerations. It holds inputs like hold_order 0.
        spectral_radius: of generalized-alpha only, numerical damping at infinite frequency, from 1 (none, the
            trapezoidal rule) to 0. The default is 1 in small motion, and where all bodies are rigid and joints let none
            turn; it is 0.9 for all other scenes, because at 1 rounding grows in whatever turns far, until the run
            fails. In large motion it is 0.8 where an output reads an acceleration without a low-pass, which rings
            longer at larger ones. A radius r holds for turns of up to -ln(r) rad in a step: 0.1 at 0.9, 60 steps a
            turn. At 0.9 it damps a mode of 20 steps a period by 2e-6 of critical, see
            `nassim.simulation.integrator_error`.
        hold_order: of the exact method, 1 for inputs that run straight between time steps, the default, 0 for inputs
            that keep their value, as of a converter: where the excitation has a sample at each step, it may then hold
            frequencies up to half the sample rate.
        start: what gravity and spin have done before.

            - "equilibrium": the scene hangs at rest in static equilibrium. What a drive turns at constant speed from
              the start is at rest on its turntable, under centrifugal forces too. Under gravity across the axis of a
              rotation, exact steps start in the periodic motion that it keeps up; other runs start at
              rest on the rotor under the weight of the first angle, with a warning.
            - "released": the scene is unloaded in its reference configuration and falls from the first step on, such
              as a pendulum released at an angle.

            Bodies with an angular_velocity turn from the start in both.
        period_correction: of generalized-alpha only. True changes masses that the rule steps so that every mode keeps
            its period, see `nassim.simulation.period_errors`. At steps h and a spectral radius of 1, a mode of period T
            loses the share 2/3 (pi h / T)^2 of its mass; the ratio that the scene gives it is scaled to stay.
            Rigid-body mass, weight, stiffness, bodies' own damping and dampers stay as they are. False is the plain
            rule with the true masses, which lengthens periods by (pi h / T)^2 / 3.
        stress: of floating frames only, the loads whose stress stiffens bodies that hold their geometric stiffness:
            "start", those at the start of the run; "present", the present speed of the one drive that turns a joint,
            and gravity along the present axes of each body, set before every step.
        constant_inputs: constant forces and voltages, by name of the input, which have acted before the start too: the
            run starts in equilibrium under them and has their stiffness, as `linearize` has; what `excitation` gives
            adds to them.
        progress: show a bar; Ctrl-C stops the run at the end of a step.

    Returns:
        The signals of `excitation` at the time steps, then the outputs. Its time counts from 0, the first sample of the
        excitation, also where that begins later. Its `notes` tell which loops were at the limits of their converters,
        how long and when first, and what the resolution of converters means.

    Warns:
        UserWarning: where the result is less than it seems: a loop at a limit for more than a tenth of the run; motion
            beyond the range of small motion or of reduced bodies; a damping_ratio of a scene whose bodies move far
            against each other; turns too fast for the steps. Also of loads: stress whose stiffness is estimated or left
            out, preload above a tenth of a buckling load, and gravity across the axis of a rotation, whose stiffness
            exact steps leave out. The documentation has a page about every warning.

    Raises:
        ValueError: for unknown names; for a scene or an option that the method does not fit; for steps that lose
            something of the excitation (fewer than 8 in its shortest period, a pulse shorter than one); and for an
            unstable equilibrium to start from, unless a loop may hold it.
        RuntimeError: when there is no equilibrium to start from.
        SimulationError: a RuntimeError whose `record` has what was recorded, when the integration fails or diverges and
            when a loop runs away: a body then is deformed by a tenth of its size, or farther away than the scene's
            size, forces, speeds and drives account for (`nassim.simulation.model.reach`).
        SimulationInterrupted: a KeyboardInterrupt with the same `record`, after Ctrl-C; the exact method has none.
    """
    options = Options(
        scene,
        time_step=time_step,
        method=method,
        spectral_radius=spectral_radius,
        hold_order=hold_order,
        start=start,
        period_correction=period_correction,
        stress=stress,
        constant_inputs=constant_inputs,
    )
    return _simulate(scene, excitation, options, duration, outputs, None, progress=progress)[0]


def simulate_motion(
    scene: Scene,
    excitation: TimeHistory | None,
    *,
    time_step: float,
    frames: int | Array,
    duration: float | None = None,
    outputs: Sequence[str] | None = None,
    method: str = "generalized_alpha",
    spectral_radius: float | None = None,
    hold_order: int | None = None,
    start: str = "equilibrium",
    period_correction: bool = True,
    stress: str = "start",
    constant_inputs: Mapping[str, float] | None = None,
    progress: bool = True,
) -> tuple[TimeHistory, Motion]:
    """Simulate, and also return the bodies' motion at chosen times.

    All arguments but `frames` are those of `simulate`. `frames` says when the motion is kept: at how many time steps,
    evenly spread from the start to the end, or at which times [s], each moved to the nearest step. A vibration looks as
    it is only where there are some ten in each of its periods.

    Returns:
        The record as of `simulate`, and the motion of all bodies of the scene, fixed ones too, in the world's frame.

    Raises:
        ValueError: as `simulate`, and for frames that the run does not have.
        RuntimeError: as `simulate`; the exceptions of runs that end early keep the record, but no motion.
    """
    options = Options(
        scene,
        time_step=time_step,
        method=method,
        spectral_radius=spectral_radius,
        hold_order=hold_order,
        start=start,
        period_correction=period_correction,
        stress=stress,
        constant_inputs=constant_inputs,
    )
    record, motion = _simulate(scene, excitation, options, duration, outputs, frames, progress=progress)
    assert motion is not None
    return record, motion


def _simulate(
    scene: Scene,
    excitation: TimeHistory | None,
    options: Options,
    duration: float | None,
    outputs: Sequence[str] | None,
    frames: int | Array | None,
    *,
    progress: bool,
) -> tuple[TimeHistory, Motion | None]:
    available, time_step = (*scene.outputs, *scene.commands), options.time_step
    names = available if outputs is None else tuple(outputs)
    for name in names:
        known("output", name, available)
    held = options.hold_order == 0
    excitation = sample_excitation(scene, excitation, time_step=time_step, duration=duration, held=held)
    n_steps = len(excitation.time) - 1
    kept = np.zeros(0, dtype=int) if frames is None else recorded_steps(frames, n_steps, time_step)
    scene = scene if frames is None else with_voltage_sensors(traced(scene))
    signals = {name: np.zeros(n_steps + 1) for name in scene.commanded_inputs}
    signals |= dict(zip(excitation.names, excitation.values, strict=True))
    check_run(scene, options, signals)
    try:
        if options.method == "exact":
            readings, motion = _solve_exactly(scene, signals, n_steps, options, kept, progress=progress)
        else:
            highest = occupied_bandwidth(without_noise(scene, excitation)) if progress else 0.0
            readings, motion = _integrate(scene, signals, n_steps, options, kept, highest, progress=progress)
    except Stopped as stop:
        record = _record(scene, excitation, names, stop.readings) if stop.readings.shape[1] > 1 else None
        raise stop.public_error(record, time_step) from stop.__cause__
    warn_of_saturation(find_saturations(scene, excitation.time, _by_name(scene, excitation, readings)))
    if motion is not None:
        motion = replace(motion, voltages=recorded_voltages(scene, readings[:, kept]))
    return _record(scene, excitation, names, readings), motion


def _record(scene: Scene, excitation: TimeHistory, names: Sequence[str], readings: Array) -> TimeHistory:
    """Make the record of n samples: the excitation and the named ones of the readings, (outputs + commands, n)."""
    units = (*scene.output_units, *scene.command_units)
    chosen = [(*scene.outputs, *scene.commands).index(name) for name in names]
    n_samples = readings.shape[1]
    return TimeHistory(
        excitation.time[:n_samples],
        np.vstack([excitation.values[:, :n_samples], readings[chosen]]),
        (*excitation.names, *names),
        (*excitation.units, *(units[k] for k in chosen)),
        notes=loop_notes(scene, excitation.time[:n_samples], _by_name(scene, excitation, readings)),
    )


def _by_name(scene: Scene, excitation: TimeHistory, readings: Array) -> dict[str, Array]:
    """Return the excitation, the outputs and the commands by name, as many samples as there are readings."""
    given = zip(excitation.names, excitation.values[:, : readings.shape[1]], strict=True)
    return dict(given) | dict(zip((*scene.outputs, *scene.commands), readings, strict=True))


def _integrate(
    scene: Scene,
    signals: Mapping[str, Array],
    n_steps: int,
    options: Options,
    kept: Array,
    highest: float,
    *,
    progress: bool,
) -> tuple[Array, Motion | None]:
    """Run Exudyn.

    Args:
        scene: the scene.
        signals: inputs by name, (n_steps + 1,) each.
        n_steps: number of steps.
        options: of the run.
        kept: numbers of the steps at which the motion is kept.
        highest: frequency up to which a message describes the error of the steps [Hz].
        progress: whether to show a bar.

    Returns:
        Outputs and commands, and the motion at the kept steps, if any.
    """
    rates, steady = _starting_rates(scene, signals, options.time_step)
    system, told = start_system(scene, options, rates, steady, highest)
    frames = MotionRecorder(system, kept)
    monitor, commands = solve_dynamic(
        system,
        signals,
        n_steps=n_steps,
        time_step=options.time_step,
        spectral_radius=options.spectral_radius,
        progress=progress,
        explicit=options.steps is None,
        look=frames if len(kept) else None,
    )
    warn_after_steps(system, monitor, told, options)
    motion = frames.motion(kept * options.time_step) if len(kept) else None
    return np.vstack([system.recorded(n_steps + 1), commands]), motion


def _starting_rates(
    scene: Scene, signals: Mapping[str, Array], time_step: float
) -> tuple[dict[str, float], dict[str, float]]:
    """Return the initial rates of inputs of prescribed motions, and the same with 0 for rates that change at once."""
    steps = {drive.input: np.diff(signals[drive.input][:3]) / time_step for drive in scene.prescribed}
    rates = {name: float(step[0]) for name, step in steps.items()}
    return rates, {name: rate * (abs(steps[name][-1] - rate) <= STEADY * abs(rate)) for name, rate in rates.items()}


def _solve_exactly(
    scene: Scene, signals: Mapping[str, Array], n_steps: int, options: Options, kept: Array, *, progress: bool
) -> tuple[Array, Motion | None]:
    driven = np.reshape([signals[name] for name in scene.inputs], (len(scene.inputs), n_steps + 1))
    assembly, models = exact_assembly(scene, signals, options)
    response = partial(path_response, models) if models else partial(exact_response, assembly)
    with stage("simulate", total=n_steps, unit="steps", enabled=progress) as advance:
        readings, commands, coordinates, at_kept = response(
            driven,
            options.time_step,
            hold_order=options.hold_order,
            released=options.released,
            kept=kept.tolist(),
            advance=advance,
        )
    warn_after_exact_steps(assembly, coordinates)
    own = {name: at_kept[place].T for name, place in assembly.coordinates.slices.items()}
    motion = None
    if len(kept):
        time, poses = kept * options.time_step, {}
        if models:
            poses = models.poses(signals[models.input][kept], own)
        elif assembly.rotation:
            poses = assembly.rotation.poses(assembly.scene, time, own)
        if assembly.loads:
            own = {name: assembly.loads.elastic(name, values) for name, values in own.items()}
        motion = recorded_motion(assembly.scene, time, own, poses)
    return np.vstack([readings, commands]), motion


def static_response(scene: Scene, inputs: Mapping[str, float] | None = None) -> dict[str, float]:
    """Find the outputs of a scene in static equilibrium under constant inputs and gravity, by Exudyn's equations.

    The inputs load the scene as `constant_inputs` of `simulate` do: their stiffness takes part, that of the stress by
    strokes in floating bodies only. A scene with a drive of constant speed is in equilibrium as it turns, see
    `simulate`; outputs that change as it turns are those of the first angle, as is the weight across the axis. Where
    "linear" bodies turn, or the rotor's base moves, the outputs are those with which exact steps start, of small motion
    about the rotation. Loops are open. Angles are counted from those that drives set; loads may turn bodies by up to
    half a turn from there. The function warns as `simulate` does: of motion, preload, and rotation that is not steady.

    Args:
        scene: the scene.
        inputs: values by name; 0 for others.

    Returns:
        The outputs, by name.

    Raises:
        ValueError: for unknown inputs, for an unstable equilibrium, for a scene that turns otherwise than in a steady
            rotation, and for a stroke beside a rotation that only exact steps know.
        RuntimeError: when there is no equilibrium, as of a body that can move freely.
    """
    of_kind("scene", scene, Scene)
    if not scene.speeds:
        scene = _without_modal_damping(scene)
    values = {name: 0.0 for name in scene.inputs}
    for name, value in (inputs or {}).items():
        values[known("input", name, scene.inputs)] = finite(f"input {name!r}", value)
    moving = {drive.input for drive in scene.prescribed}
    loads = {name: value for name, value in values.items() if value and name not in moving}
    if not scene.at_rest and steady_rotation_twists(scene) is None:
        return _steady_outputs(scene, loads, [name for name in moving if values[name]])
    strokes = {name: values[name] for name in moving if values[name]}
    system = build_system(_assemble_for_run(scene, loads, strokes))
    # Small motion has the loads in its equations already.
    acting = {name: 0.0 for name in loads} if scene.in_small_motion else {}
    turns = [abs(values[drive.input]) for drive in scene.prescribed if drive.unit == "rad"]
    n_parts = max(1, int(np.ceil(max(turns, default=0.0) / LARGEST_TURN)))
    for part in range(1, n_parts + 1):
        driven = {name: values[name] * part / n_parts for name in moving}
        system.apply(values | acting | driven)
        if not bring_to_equilibrium(system, {}):
            solve_static(system)
        for name in scene.outputs:
            system.measured(name)  # counts the turns of angles
    seen = Monitor(system)
    seen.look(0)
    warn_of_motion(system.assembly, seen.largest)
    warn_of_frames(system.assembly, seen.most_turned)
    warn_of_buckling(system.assembly, seen.slackest)
    return {name: system.at_rest(name, np.array(list(values.values()))) for name in scene.outputs}


def _steady_outputs(scene: Scene, loads: Mapping[str, float], strokes: Sequence[str]) -> dict[str, float]:
    """Return the outputs in a steady rotation that Exudyn's equations have no equilibrium of, by exact steps."""
    if not scene.speeds or strokes:
        why = (
            f"input {strokes[0]!r} moves a drive beside a rotation"
            if strokes
            else f"body {scene.spinning[0]!r} turns freely"
        )
        raise ValueError(f"scene {scene.name!r} has no static response: {why}; look at the end of a run, simulate(...)")
    return steady_outputs(assemble_spin(replace(scene, loops=()), inputs=loads))


def exudyn_eigenfrequencies(scene: Scene, *, loaded: bool = False, n_modes: int | None = None) -> Array:
    """Find the undamped eigenfrequencies of a scene at rest by Exudyn's equations.

    Measured electrical ports keep their charge, whatever their resistance.

    Args:
        scene: the scene.
        loaded: whether they are those about the equilibrium under gravity and preload, as in runs; otherwise those in
            the reference configuration without loads.
        n_modes: number of frequencies; None for all.

    Returns:
        The frequencies, ascending, (n_modes,) [Hz].

    Raises:
        RuntimeError: when there is no equilibrium.
    """
    scene = _without_modal_damping(scene)
    assembly = _assemble_for_run(scene) if loaded else assemble(scene)
    still = PrescribedMotions.none(*assembly.modal.basis.shape)
    signals = replace(assembly.signals, circuits=(), prescribed=still)
    system = build_system(replace(assembly, signals=signals))
    return (loaded_eigenfrequencies(system) if loaded else eigenfrequencies(system))[:n_modes]


def _without_modal_damping(scene: Scene) -> Scene:
    """Return a scene at rest without a modal damping that would only give warnings, those of large motion.

    In small motion it decides whether an equilibrium flutters.
    """
    return scene if scene.in_small_motion else replace(scene, damping_ratio=0.0)


def _assemble_for_run(
    scene: Scene, inputs: Mapping[str, float] | None = None, strokes: Mapping[str, float] | None = None
) -> Assembly:
    """Assemble a scene with the stiffness of its loads.

    Args:
        scene: the scene.
        inputs: constant values of inputs among the loads, by name.
        strokes: those of inputs that drives follow, whose stress stiffens floating bodies, by name.
    """
    if scene.in_small_motion:
        return assemble_small_motion(scene, inputs=inputs)
    return assemble_large_motion(scene, inputs, strokes)[0]
