"""Programs of matrices for what users export: linear models and scenes, refused where they grow."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from nassim.base.checks import Array, known, positive
from nassim.scene.scene import Scene
from nassim.simulation.run.scene_program import scene_program, scene_rates
from nassim.systems.linear_model import LinearModel, unstable_poles
from nassim.systems.step_program import ProgramSignal, RateProgram, StepProgram, closed_step, rate_program, step_program
from nassim.systems.uncoupled_states import uncoupled_rates, uncoupled_steps


def steps_of(
    source: LinearModel | Scene,
    time_step: float | None,
    *,
    hold_order: int,
    start: str,
    constant_inputs: Mapping[str, float] | None,
    input_sizes: Mapping[str, float] | None,
    allow_unstable: bool,
) -> StepProgram:
    """Make the program of the exact steps of a linear model or a scene.

    Args:
        source: the linear model or the scene.
        time_step: as of `export_c`, as are the following [s].
        hold_order: 0 or 1.
        start: "equilibrium" or "released".
        constant_inputs: constant values of inputs, by name.
        input_sizes: typical magnitudes of inputs, by name.
        allow_unstable: whether the motion may grow.

    Raises:
        ValueError: for another source, for arguments that do not fit it, and for a motion that grows.
    """
    if isinstance(source, Scene):
        program = scene_program(source, time_step, hold_order=hold_order, start=start, constant_inputs=constant_inputs)
    else:
        _check_model(source, start, constant_inputs)
        program = step_program(source, time_step, hold_order=hold_order)
    if not allow_unstable:
        _refuse_growth(closed_step(program), program.time_step * len(program.phases))
    return uncoupled_steps(replace(program, inputs=sized(program.inputs, input_sizes)))


def rates_of(
    source: LinearModel | Scene,
    *,
    start: str,
    constant_inputs: Mapping[str, float] | None,
    input_sizes: Mapping[str, float] | None,
    allow_unstable: bool,
) -> RateProgram:
    """Make the program of the continuous equations of a linear model or a scene; arguments as of `steps_of`."""
    if isinstance(source, Scene):
        program = scene_rates(source, start=start, constant_inputs=constant_inputs)
    else:
        _check_model(source, start, constant_inputs)
        program = rate_program(source)
    if not allow_unstable:
        _refuse_growth(program.matrices[0], None)
    return uncoupled_rates(replace(program, inputs=sized(program.inputs, input_sizes)))


def _check_model(source: object, start: str, constant_inputs: Mapping[str, float] | None) -> None:
    if not isinstance(source, LinearModel):
        raise ValueError(
            f"an export takes a LinearModel or a Scene, got a {type(source).__name__}; export_body takes bodies"
        )
    if start != "equilibrium" or constant_inputs:
        raise ValueError("a LinearModel starts at rest: start and constant_inputs are of scenes, leave them out")


def sized(inputs: tuple[ProgramSignal, ...], sizes: Mapping[str, float] | None) -> tuple[ProgramSignal, ...]:
    """Return inputs with their typical magnitudes; raise ValueError for sizes of other inputs."""
    names = [signal.name for signal in inputs]
    given = {known("input", name, names): positive(f"size of {name!r}", value) for name, value in (sizes or {}).items()}
    return tuple(replace(signal, size=given.get(signal.name, 1.0)) for signal in inputs)


def _refuse_growth(state: Array, time_step: float | None) -> None:
    """Refuse a motion that grows; a motion that nothing holds, or that drifts, does not."""
    none = np.zeros((0, 0))
    model = LinearModel(state, np.zeros((len(state), 0)), np.zeros((0, len(state))), none, (), (), (), time_step)
    if growing := unstable_poles(model):
        raise ValueError(
            f"the model is unstable: {growing[0]}; stabilise it, or give allow_unstable=True if it is meant to be"
        )
