"""Scenes as programs of matrices: their exact steps with digital loops, and their continuous equations.

The numbers are those of `simulate(..., method="exact")`, so a program has the same start, loads and loops.
"""

from collections.abc import Mapping, Sequence

import numpy as np
import scipy

from nassim.base.checks import known, positive
from nassim.scene.scene import Scene
from nassim.scene.terms import Output, SpringForce
from nassim.simulation.linear.exact_steps import make_stretch, quasi_static_states
from nassim.simulation.linear.scene_state_space import released_state, state_space, steady_state
from nassim.simulation.model.assembly import Assembly
from nassim.simulation.run.checks import STARTS, check_constant_inputs, check_exact, check_loops
from nassim.simulation.run.loaded_start import assemble_exact
from nassim.systems.state_space import quasi_static
from nassim.systems.step_program import ProgramSignal, RateProgram, StepProgram


def scene_program(
    scene: Scene,
    time_step: float | None = None,
    *,
    hold_order: int = 0,
    start: str = "equilibrium",
    constant_inputs: Mapping[str, float] | None = None,
) -> StepProgram:
    """Make the program of a scene's exact steps, with its loops.

    Args:
        scene: the scene.
        time_step: between samples [s]; None: that of the fastest loop.
        hold_order: 0 for inputs that keep the value of each sample until the next, 1 for inputs that run straight.
        start: "equilibrium" or "released", see `simulate`.
        constant_inputs: constant values of inputs that act beside the inputs, see `simulate`.

    Returns:
        The program. Its outputs are those of the scene, then the commands of its loops.

    Raises:
        ValueError: for a scene that exact steps refuse, for a loop whose controller is in Python, for a scene without
            loops and time step, and for other arguments out of range.
    """
    if hold_order not in (0, 1):
        raise ValueError(f"hold_order must be 0 or 1, got {hold_order!r}")
    for loop in scene.loops:
        loop.linear_controller  # noqa: B018  # refuses a controller in Python by name
    step = time_step_of(scene, time_step)
    check_loops(scene, step)
    assembly = _assembly(scene, start, constant_inputs)
    model = make_stretch(assembly, step, hold_order, released=start == "released")
    return model.closed.program(*scene_signals(scene), model.start, -model.risen)


def time_step_of(scene: Scene, time_step: float | None) -> float:
    """Return a given time step, or that of the fastest loop of a scene [s].

    Raises:
        ValueError: for a scene without loops and time step, and for a time step that is not positive.
    """
    if time_step is None:
        if not scene.loops:
            raise ValueError(
                f"scene {scene.name!r} has no loop that sets the time step: give time_step, the time between samples"
            )
        time_step = 1 / max(loop.controller.sample_rate for loop in scene.loops)
    return positive("time_step", time_step, "s")


def scene_signals(scene: Scene) -> tuple[tuple[ProgramSignal, ...], tuple[ProgramSignal, ...]]:
    """Return the inputs of a scene, and its outputs with the commands of its loops."""
    descriptions = _descriptions(scene)

    def signals(names: Sequence[str], units: Sequence[str]) -> tuple[ProgramSignal, ...]:
        described = zip(names, units, strict=True)
        return tuple(ProgramSignal(name, unit, descriptions.get(name, "")) for name, unit in described)

    inputs = signals(scene.inputs, [scene.input_unit(name) for name in scene.inputs])
    return inputs, signals((*scene.outputs, *scene.commands), (*scene.output_units, *scene.command_units))


def scene_rates(
    scene: Scene, *, start: str = "equilibrium", constant_inputs: Mapping[str, float] | None = None
) -> RateProgram:
    """Make the continuous program of a scene without loops. Known functions of time, as of loads, are its last states.

    Modes that the mesh does not support (see `Scene.quasi_static_above`) are quasi-static.

    Args:
        scene: the scene.
        start: "equilibrium" or "released", see `simulate`.
        constant_inputs: constant values of inputs that act beside the inputs, see `simulate`.

    Returns:
        The program.

    Raises:
        ValueError: for a scene with loops, and for one that exact steps refuse.
    """
    if scene.loops:
        raise ValueError(
            f"scene {scene.name!r} has the sampled loop {scene.loops[0].name!r}, which continuous equations do not "
            "include: take co-simulation, or leave the loops out"
        )
    assembly = _assembly(scene, start, constant_inputs)
    a, b, c, d = state_space(assembly)
    n_in = len(scene.inputs)
    generator, values = assembly.known
    released = start == "released"
    begin = released_state(assembly, a) if released else steady_state(assembly, a, b[:, n_in:])
    fast = quasi_static_states(assembly, np.inf, len(a))
    a, b, kept, taken = quasi_static(a, b, fast)
    begin, c, d = begin[~fast], c @ kept, d + c @ taken
    if not np.any(b[:, n_in:]) and not np.any(d[:, n_in:]):
        generator, values, b, d = np.zeros((0, 0)), np.zeros(0), b[:, :n_in], d[:, :n_in]
    state = scipy.linalg.block_diag(a, generator)
    state[: len(a), len(a) :] = b[:, n_in:]
    drives = np.vstack([b[:, :n_in], np.zeros((len(values), n_in))])
    inputs, outputs = scene_signals(scene)
    system = state, drives, np.hstack([c, d[:, n_in:]]), d[:, :n_in]
    return RateProgram(matrices=system, inputs=inputs, outputs=outputs, start=np.concatenate([begin, values]))


def _assembly(scene: Scene, start: str, constant_inputs: Mapping[str, float] | None) -> Assembly:
    """Check a scene and assemble it for exact steps."""
    known("start", start, STARTS)
    constant = check_constant_inputs(scene, constant_inputs)
    check_exact(scene, {name: np.zeros(1) for name in scene.inputs})
    return assemble_exact(scene, released=start == "released", inputs=constant)


def _descriptions(scene: Scene) -> dict[str, str]:
    """Describe each input, output and command of a scene in a few words, by its name."""
    result: dict[str, str] = {}
    for part in scene.parts:
        kind = f"{type(part).__name__} {part.name}"
        for term in part.terms(scene):
            if isinstance(term, (Output, SpringForce)):
                result[term.name] = kind
            elif name := getattr(term, "input", ""):
                result[name] = f"{result[name]}, {kind}" if name in result else kind
    for loop in scene.loops:
        rate = f"{loop.controller.sample_rate:g} Hz"
        for kind, names in (("reference", loop.reference), ("noise", loop.noise)):
            result |= {
                name: f"{kind} of loop {loop.name} for {measured}"
                for name, measured in zip(names, loop.measured, strict=False)
            }
        result |= {
            command: f"command of loop {loop.name} on {driven}, sampled at {rate}"
            for command, driven in zip(loop.commands, loop.driven, strict=True)
        }
    return result
