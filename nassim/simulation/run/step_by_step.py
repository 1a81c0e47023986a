"""Runs that are stepped one time step at a time by their user."""

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping
from copy import copy
from dataclasses import dataclass
from types import TracebackType
from typing import Any

import numpy as np

from nassim.base.checks import Array, finite, known, positive
from nassim.base.short_repr import short_repr
from nassim.scene.scene import Scene
from nassim.signals.time_history import TimeHistory
from nassim.simulation.exudyn.monitor import Monitor
from nassim.simulation.exudyn.solver import diverged
from nassim.simulation.exudyn.stepped_run import SteppedRun
from nassim.simulation.linear.exact_steps import ExactSteps
from nassim.simulation.linear.path_steps import PathRun, PathSteps
from nassim.simulation.model.reach import GrowingReach
from nassim.simulation.model.runaway import runaway, see_runaway
from nassim.simulation.model.stopped_runs import Stopped, ValidSamples
from nassim.simulation.run.checks import check_steps_of_drives, turning_drives
from nassim.simulation.run.loop_notes import find_saturations, loop_notes, warn_of_saturation
from nassim.simulation.run.preparation import (
    Options,
    check_run,
    exact_assembly,
    start_system,
    warn_after_exact_steps,
    warn_after_steps,
)
from nassim.simulation.run.sampled_inputs import sampled_signals

STEPPED_METHODS = ("generalized_alpha", "exact")
LOOK = 50
"""Number of steps between checks of the run."""


@dataclass(frozen=True, eq=False)
class SimulationState:
    """Saved state of a run, to be given to `Simulation.restore`. Its content is no interface."""

    _count: int
    _inputs: Array
    _engine: Any
    _samples: tuple[tuple[Array, Array], ...]
    _scene: Scene
    _options: Options
    _path: Mapping[str, Array]
    __repr__ = short_repr


class Simulation:
    """A run in time that is stepped by its user, as a context manager.

    The scene is assembled and brought to its start once, when the block begins. The steps are those of `simulate`: the
    outputs are the same to the last bit.

    Example:
        >>> with Simulation(scene, time_step=1e-4) as run:
        ...     for _ in range(1000):
        ...         outputs = run.step({"force": -200.0 * run.outputs["velocity"]})

    Args:
        scene: what is simulated.
        time_step: [s].
        method: "generalized_alpha", Exudyn's implicit integrator, for every scene; "exact", the exact discrete-time
            solution for small motion, about rest, a rotation at constant speed or the path of a drive. See `simulate`.
        spectral_radius: of generalized-alpha only, see `simulate`.
        hold_order: of the exact method, 1 (default) for inputs that run straight between the steps, 0 for inputs that
            keep the value of the last step.
        start: "equilibrium" or "released", see `simulate`.
        period_correction: of generalized-alpha only, see `simulate`.
        stress: of floating frames only, "start" or "present", see `simulate`.
        constant_inputs: constant forces and voltages that act beside `inputs`, before the start too, see `simulate`.
        inputs: values at the start, by name; 0 for others.
        input_rates: rates at the start of inputs that prescribe motions, by name [unit of the input / s]; 0 for others.
        path: of the exact method only, the signal of the input of the one drive that turns a joint far, whose course
            is known before the run, see `simulate`; `step` takes the other inputs, as long as the path is.

    Raises:
        ValueError: for unknown names, and for a scene or an option that the method does not fit.
    """

    def __init__(
        self,
        scene: Scene,
        *,
        time_step: float,
        method: str = "generalized_alpha",
        spectral_radius: float | None = None,
        hold_order: int | None = None,
        start: str = "equilibrium",
        period_correction: bool = True,
        stress: str = "start",
        constant_inputs: Mapping[str, float] | None = None,
        inputs: Mapping[str, float] | None = None,
        input_rates: Mapping[str, float] | None = None,
        path: TimeHistory | None = None,
    ) -> None:
        known("method", method, STEPPED_METHODS)
        step = positive("time_step", time_step, "s")
        self._scene = scene
        self._options = Options(
            scene,
            time_step=step,
            method=method,
            spectral_radius=spectral_radius,
            hold_order=hold_order,
            start=start,
            period_correction=period_correction,
            stress=stress,
            constant_inputs=constant_inputs,
        )
        self._names = (*scene.outputs, *scene.commands)
        drives = [drive.input for drive in scene.prescribed]
        self._rates = {
            known("input of a drive", name, drives): finite(f"input rate {name!r}", rate)
            for name, rate in (input_rates or {}).items()
        }
        self._path = {} if path is None else _path_signal(scene, path, step, method)
        self._places = {name: k for k, name in enumerate(scene.inputs) if name not in self._path}
        turning = [drive for _, drive in turning_drives(scene) if method == "exact" and drive.input not in self._path]
        self._turning = turning, [scene.inputs.index(drive.input) for drive in turning]
        self._inputs = np.zeros(len(scene.inputs))
        self._inputs = self._merged(inputs)
        self._engine: _Engine | None = None
        self._samples: list[tuple[Array, Array]] = []  # inputs, then outputs and commands
        self._count, self._closed = 0, "it has not begun: use it as `with Simulation(...) as run:`"

    def __enter__(self) -> "Simulation":
        """Assemble the scene and bring it to its start.

        Raises:
            RuntimeError: when there is no equilibrium to start from, or the run was begun before.
            SimulationError: when a controller in Python fails at the start.
        """
        if self._engine or self._samples:
            raise RuntimeError("a Simulation runs once; make another one")
        self._start()
        return self

    def _start(self) -> None:
        scene, options = self._scene, self._options
        signals = {name: self._inputs[[k]] for k, name in enumerate(scene.inputs)} | self._path
        check_run(scene, options, signals)
        make = _ExactEngine if options.method == "exact" else _ExudynEngine
        try:
            self._engine = make(scene, options, signals, self._rates)
        except Stopped as stop:
            raise self._public_error(stop, None) from stop.__cause__
        self._closed = ""
        self._samples = [(self._inputs, self._engine.row)]

    def __exit__(
        self, kind: type[BaseException] | None, _error: BaseException | None, _traceback: TracebackType | None
    ) -> None:
        """End the run; warn, as `simulate` does, of motion beyond the range of the model."""
        engine, self._engine = self._engine, None
        failed, self._closed = self._closed, self._closed or "its block has ended"
        if engine and kind is None and not failed:
            self._end(engine)

    def _end(self, engine: "_Engine") -> None:
        try:
            self._look(engine, self._count % LOOK or 1, last=True)
        except Stopped as stop:
            raise self._public_error(stop, engine) from stop.__cause__
        engine.warn()
        if self._scene.loops and len(self._samples) > 1:
            record = self.record
            signals = dict(zip(record.names, record.values, strict=True))
            warn_of_saturation(find_saturations(self._scene, record.time, signals))

    @property
    def time(self) -> float:
        """Present time [s]."""
        return self._count * self._options.time_step

    @property
    def outputs(self) -> dict[str, float]:
        """Present values of the outputs and of the loops' commands, by name."""
        self._running()
        return dict(zip(self._names, self._samples[-1][1].tolist(), strict=True))

    @property
    def record(self) -> TimeHistory:
        """The inputs, outputs and commands from the start until now, with notes on the loops; it stays after the block.

        Raises:
            ValueError: before the second sample.
        """
        if len(self._samples) < 2:
            raise ValueError("a run has a record after its first step")
        scene = self._scene
        units = (*(scene.input_unit(name) for name in scene.inputs), *scene.output_units, *scene.command_units)
        time = np.arange(len(self._samples)) * self._options.time_step
        values = np.hstack([np.array(part) for part in zip(*self._samples, strict=True)]).T
        names = (*scene.inputs, *self._names)
        notes = loop_notes(scene, time, dict(zip(names, values, strict=True)))
        return TimeHistory(time, values, names, units, notes=notes)

    def step(self, inputs: Mapping[str, float] | None = None) -> dict[str, float]:
        """Go on by one time step.

        Args:
            inputs: values at the end of the step, by name; within the step inputs are linear. Inputs that are not named
                keep their value. The commands of loops add to them.

        Returns:
            The outputs and the loops' commands at the end of the step, by name.

        Raises:
            ValueError: for unknown inputs, values that are not finite, a drive whose input turns its joint beyond
                small motion in exact steps without its path, and at the end of a path; the run can go on.
            RuntimeError: outside the block and after an error.
            SimulationError: when the integration fails, a loop runs away or a controller in Python fails; its `record`
                has what was recorded.
        """
        engine = self._running()
        values = self._merged(inputs)
        for name, course in self._path.items():
            if self._count + 1 == len(course):
                raise ValueError(f"the path of input {name!r} ends at {self.time:g} s: give the run a longer one")
            values[self._scene.inputs.index(name)] = course[self._count + 1]
        drives, places = self._turning
        if drives:
            check_steps_of_drives(self._scene, drives, values[places])
        try:
            engine.step(values)
            self._inputs, self._count = values, self._count + 1
            self._samples.append((values, engine.row))
            if self._count % LOOK == 0:
                self._look(engine, LOOK, last=False)
        except Stopped as stop:
            raise self._public_error(stop, engine) from stop.__cause__
        except BaseException:  # such as Ctrl-C within a step
            self._closed = "it was interrupted within a step"
            raise
        return self.outputs

    @property
    def state(self) -> SimulationState:
        """The present state, with that of filters, amplifiers and controllers.

        A run that is restored from it goes on as this one does, to the last bit. Reading it changes nothing.
        """
        state, samples = self._running().state, tuple(self._samples)
        return SimulationState(self._count, self._inputs, state, samples, self._scene, self._options, self._path)

    def restore(self, state: SimulationState) -> None:
        """Go back to a state of this run, or of another one of the same scene with the same options.

        Args:
            state: as `state` has given it.

        Raises:
            ValueError: for a state of another scene or of other options.
            RuntimeError: outside the block and after an error.
        """
        engine = self._running()
        if not isinstance(state, SimulationState):
            raise ValueError(f"restore takes a state that a Simulation gave, got a {type(state).__name__}")
        if state._scene is not self._scene or state._options != self._options:
            raise ValueError(
                f"the state is of a run of scene {state._scene.name!r} with {state._options}; this run has scene "
                f"{self._scene.name!r} and {self._options}: restore it in a run of the same scene and options"
            )
        if any(not np.array_equal(state._path.get(name, []), course) for name, course in self._path.items()):
            raise ValueError("the state is of a run along another path: restore it in a run along the same path")
        self._count, self._inputs, self._samples = state._count, state._inputs, list(state._samples)
        engine.restore(state._engine)

    def _running(self) -> "_Engine":
        if self._closed or self._engine is None:
            raise RuntimeError(f"this Simulation cannot go on: {self._closed}")
        return self._engine

    def _look(self, engine: "_Engine", n: int, *, last: bool) -> None:
        """Check the run after n steps without a check; raise Stopped where it diverges or runs away."""
        scene, options = self._scene, self._options
        body, happened = engine.look(np.array([inputs for inputs, _ in self._samples[-n:]]), last=last)
        if happened and scene.loops:
            outputs = np.array([row[: len(scene.outputs)] for _, row in self._samples])
            raise Stopped(runaway(scene, happened, outputs, options.time_step))
        if happened:
            raise Stopped(diverged(body, self.time, options.spectral_radius))

    def _public_error(self, stop: Stopped, engine: "_Engine | None") -> BaseException:
        """Make the public exception of a run that has stopped, with its record; the run cannot go on."""
        self._closed, self._engine = f"it has failed at t = {self.time:g} s", None
        n = [*(bool(np.isfinite(row).all()) for _, row in self._samples), False].index(False)
        del self._samples[n:]
        kept = Stopped(str(stop), np.zeros((1, n)), engine.trusted if engine else 0)
        return kept.public_error(self.record if n > 1 else None, self._options.time_step)

    def _merged(self, inputs: Mapping[str, float] | None) -> Array:
        result = self._inputs.copy()
        for name, value in (inputs or {}).items():
            place = self._places.get(name)
            if place is None:
                known("input", name, self._scene.inputs)
                raise ValueError(f"input {name!r} follows the path that the run was made with; step takes the others")
            if isinstance(value, float) and math.isfinite(value):  # a full check would take much of a step
                result[place] = value
            else:
                result[place] = finite(f"input {name!r}", value)
        return result


def _path_signal(scene: Scene, path: TimeHistory, time_step: float, method: str) -> dict[str, Array]:
    """Return the samples of the path of a drive at the steps of a run, by the name of its input."""
    if method != "exact":
        raise ValueError(f'path is of method "exact"; {method!r} takes every input step by step, leave it out')
    drives = [drive.input for drive in scene.prescribed]
    if len(path.names) != 1:
        raise ValueError(f"path is the signal of one input, got {path.names}; give the others to step")
    name = known("input of a drive", path.names[0], drives)
    return {name: sampled_signals(scene, path, time_step=time_step).values[0]}


class _Engine(ABC):
    """Steps of a run, and its checks from time to time."""

    run: SteppedRun | ExactSteps
    reach: GrowingReach | None

    @property
    def row(self) -> Array:
        return self.run.row

    def step(self, inputs: Array) -> None:
        self.run.step(inputs)

    @property
    def state(self) -> Any:
        return self.run.state, copy(self.reach)

    def restore(self, state: Any) -> None:
        own, reach = state
        self.run.restore(own)
        self.reach = copy(reach)

    @abstractmethod
    def look(self, inputs: Array, *, last: bool) -> tuple[str, str]:
        """Check the run.

        Args:
            inputs: since the last check, (n, inputs).
            last: whether it is the last check of the run.

        Returns:
            The name of a body that is lost, and what has happened to it; empty without one.
        """

    @property
    @abstractmethod
    def trusted(self) -> int:
        """Number of the last valid sample."""

    @abstractmethod
    def warn(self) -> None:
        """Give the warnings of all checks."""


class _ExudynEngine(_Engine):
    """Steps by Exudyn."""

    def __init__(
        self, scene: Scene, options: Options, signals: Mapping[str, Array], rates: Mapping[str, float]
    ) -> None:
        inputs = np.array([signals[name][0] for name in scene.inputs])
        rates = {drive.input: rates.get(drive.input, 0.0) for drive in scene.prescribed}
        self.options = options
        self.system, self.told = start_system(scene, options, rates, rates)
        self.run = SteppedRun(self.system, inputs, options.time_step, options.spectral_radius)
        self.reach = GrowingReach(self.system.assembly, options.time_step) if scene.commands else None
        self.monitor: Monitor = self.run.monitor

    def look(self, inputs: Array, *, last: bool) -> tuple[str, str]:
        if self.reach:
            self.monitor.reach = self.reach.after(inputs.T)
        self.monitor.look(self.run.count)
        return self.monitor.lost[0] if self.monitor.lost else ("", "")

    @property
    def trusted(self) -> int:
        return self.monitor.valid.last

    def warn(self) -> None:
        warn_after_steps(self.system, self.monitor, self.told, self.options)


class _ExactEngine(_Engine):
    """Exact steps."""

    run: ExactSteps

    def __init__(
        self, scene: Scene, options: Options, signals: Mapping[str, Array], _rates: Mapping[str, float]
    ) -> None:
        inputs = np.array([signals[name][0] for name in scene.inputs])
        step, order, released = options.time_step, options.hold_order, options.released
        self.assembly, models = exact_assembly(scene, signals, options)
        if models:
            run = PathRun(models, signals[models.input], step, hold_order=order, released=released)
            self.run = PathSteps(run, inputs)
        else:
            self.run = ExactSteps(self.assembly, inputs, step, hold_order=order, released=released)
        self.valid = ValidSamples()
        self.reach = GrowingReach(self.assembly, step) if scene.loops else None
        self.seen: list[Array] = []

    def look(self, inputs: Array, *, last: bool) -> tuple[str, str]:
        sample, coordinates = self.run.coordinates(now=last)
        self.seen.append(coordinates)
        if not self.reach:
            return "", ""
        happened, sound = see_runaway(self.assembly.coordinates, self.reach.after(inputs.T), coordinates, len(inputs))
        self.valid.check(sample, valid=sound)
        return "", happened

    @property
    def trusted(self) -> int:
        return self.valid.last

    def warn(self) -> None:
        warn_after_exact_steps(self.assembly, np.transpose(self.seen))
