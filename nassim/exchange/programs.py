"""Programs of matrices for what users export: linear models and scenes, refused where they grow."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from nassim.base.checks import Array, known, positive
from nassim.scene.scene import Scene
from nassim.simulation.run.scene_program import scene_program, scene_rates
from nassim.systems.linear_model import LinearModel, unstable_poles
from nassim.systems.step_program import ProgramSignal, RateProgram, StepProgram, closed_step, rate_program, step_program
from nassim.systems.uncoupled_states import uncoupled_rates, uncoupled_steps


@dataclass(frozen=True, kw_only=True)
class Exported:
    """A linear model or a scene that is exported; the attributes are arguments of `export_fmu`.

    Attributes:
        source: the linear model or the scene.
        start: "equilibrium" or "released".
        constant_inputs: constant values of inputs, by name.
        input_sizes: typical magnitudes of inputs, by name.
        allow_unstable: whether the motion may grow.

    Raises:
        ValueError: for another source, and for a linear model with options of scenes.
    """

    source: LinearModel | Scene
    start: str
    constant_inputs: Mapping[str, float] | None
    input_sizes: Mapping[str, float] | None
    allow_unstable: bool

    def __post_init__(self) -> None:
        if isinstance(self.source, Scene):
            return
        if not isinstance(self.source, LinearModel):
            kind = type(self.source).__name__
            raise ValueError(f"an export takes a LinearModel or a Scene, got a {kind}; export_body takes bodies")
        if self.start != "equilibrium" or self.constant_inputs:
            raise ValueError("a LinearModel starts at rest: start and constant_inputs are of scenes, leave them out")

    def steps(self, time_step: float | None, hold_order: int) -> StepProgram:
        """Make the program of the exact steps.

        Args:
            time_step: between samples [s]; None for that of a sampled model or of the fastest loop.
            hold_order: 0 or 1.

        Raises:
            ValueError: for a source that has no such program, and for a motion that grows.
        """
        if isinstance(self.source, Scene):
            program = scene_program(
                self.source,
                time_step,
                hold_order=hold_order,
                start=self.start,
                constant_inputs=self.constant_inputs,
            )
        else:
            program = step_program(self.source, time_step, hold_order=hold_order)
        self._refuse_growth(closed_step(program), program.time_step * len(program.phases))
        return uncoupled_steps(replace(program, inputs=self.sized(program.inputs)))

    def rates(self) -> RateProgram:
        """Make the program of the continuous equations; raise ValueError as `steps`."""
        if isinstance(self.source, Scene):
            program = scene_rates(self.source, start=self.start, constant_inputs=self.constant_inputs)
        else:
            program = rate_program(self.source)
        self._refuse_growth(program.matrices[0], None)
        return uncoupled_rates(replace(program, inputs=self.sized(program.inputs)))

    def sized(self, inputs: tuple[ProgramSignal, ...]) -> tuple[ProgramSignal, ...]:
        """Return inputs with their typical magnitudes; raise ValueError for sizes of other inputs."""
        names = [signal.name for signal in inputs]
        given = self.input_sizes or {}
        sizes = {known("input", name, names): positive(f"size of {name!r}", value) for name, value in given.items()}
        return tuple(replace(signal, size=sizes.get(signal.name, 1.0)) for signal in inputs)

    def _refuse_growth(self, state: Array, time_step: float | None) -> None:
        """Refuse a motion that grows; a motion that nothing holds, or that drifts, does not."""
        none = np.zeros((0, 0))
        model = LinearModel(
            state, np.zeros((len(state), 0)), np.zeros((0, len(state))), none, (), (), time_step=time_step
        )
        if not self.allow_unstable and (growing := unstable_poles(model)):
            raise ValueError(
                f"the model is unstable: {growing[0]}; stabilise it, or give allow_unstable=True if it is meant to be"
            )
