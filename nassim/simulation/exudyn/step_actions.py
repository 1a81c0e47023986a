"""Actions of an Exudyn run at every time step: samples of filters and loops, then inputs behind their amplifiers."""

from typing import Any

import numpy as np

from nassim.base.checks import Array
from nassim.simulation.exudyn.filtering import Filtering
from nassim.simulation.exudyn.held_directions import HeldDirections
from nassim.simulation.exudyn.running_system import System
from nassim.simulation.model.digital_controllers import BadCommand, RunningLoops, span


class StepActions:
    """Samples of filters and loops, and forces and motions for the next step.

    Attributes:
        begun: number of steps begun.
        commands: commands of the loops at the last sample, (commands,).
        samples_any: whether there are filters or loops.
        bad: failure of a controller in Python, which must not pass through Exudyn's callbacks.
    """

    def __init__(self, system: System, start: Array, time_step: float, *, explicit: bool) -> None:
        """Begin before the first step.

        Args:
            system: in its state at the start.
            start: the inputs at the start, (inputs,).
            time_step: [s].
            explicit: whether the rule holds inputs from step to step.
        """
        scene = system.assembly.scene
        self.system, self.explicit, self.time_step = system, explicit, time_step
        self.begun = 0
        self.bad: BadCommand | None = None
        self.commands = np.zeros(len(scene.commands))
        self.loops = RunningLoops(scene, time_step)
        self.held_directions = HeldDirections(system)
        self.filtering = Filtering(system, time_step)
        self.n_outputs = len(scene.outputs)
        self.held = self.end = np.zeros(len(scene.inputs))
        self.measure = self.filtering.measure if self.filtering.passed else self.filtering.read
        self.samples_any = bool(self.filtering.passed) or self.commands.size > 0
        inputs = [scene.inputs.index(channel.input) for channel in system.channels]
        self.places = span(inputs)
        rates = [channel.rate for channel in system.channels]
        amplifiers = {k: _Amplifier(rate, time_step) for k, rate in enumerate(rates) if np.isfinite(rate)}
        self.amplified = [(k, inputs[k], amplifier) for k, amplifier in amplifiers.items()]
        read = [one for one in system.assembly.signals.amplifiers if np.any(one.readings)]
        self.read = [(one.readings, one.input, _Amplifier(one.rate, time_step)) for one in read]
        starting = start[self.places].copy()
        starting[list(amplifiers)] = 0.0
        self.acting = starting
        system.act(starting)

    def sample(self, inputs: Array) -> bool:
        """Let filters and loops take their samples at these inputs, (inputs,); whether the controllers have worked."""
        if self.filtering.passed:
            amplified = sum((row * amplifier.value for row, _, amplifier in self.read), np.zeros(self.n_outputs))
            self.filtering.step(inputs + self.held, amplified)
        if self.commands.size:
            try:
                self.held, self.end, self.commands = self.loops(self.begun, self.measure, inputs)
            except BadCommand as bad:
                self.bad = bad
                return False
        return True

    def act(self, before: Array, after: Array) -> bool:
        """Set what acts during the next step, with inputs before and after it, (inputs,) each.

        Returns:
            Whether joints hold other directions than before, for which Newton's iterations need a new Jacobian.
        """
        held, explicit = self.held, self.explicit
        # The implicit rule takes forces at both ends of a step. A command that jumps there enters with its mean, else
        # the loop would have half a step of delay more.
        values = (before + held if explicit else after + self.end)[self.places]
        for k, place, amplify in self.amplified:
            first, last = before[place] + held[place], after[place] + held[place]
            values[k] = amplify.mean(first) if explicit else amplify(first, last)
        for _, place, amplify in self.read:
            first = before[place] + held[place]
            amplify(first, first if explicit else after[place] + held[place])
        self.acting = values
        self.system.act(values)
        self.system.update_stress()
        changed = self.held_directions.renew(self.begun)
        self.begun += 1
        return changed

    @property
    def _every_amplifier(self) -> list["_Amplifier"]:
        return [amplifier for _, _, amplifier in (*self.amplified, *self.read)]

    @property
    def state(self) -> Any:
        """A copy of all that changes from step to step."""
        amplified = [amplifier.value for amplifier in self._every_amplifier]
        now = self.begun, self.acting.copy(), self.commands.copy(), self.held.copy(), self.end.copy()
        return (*now, amplified, self.loops.state, self.filtering.state, self.held_directions.state)

    def restore(self, state: Any) -> None:
        """Go back to a state."""
        self.begun, acting, commands, held, end, amplified, loops, filtering, directions = state
        self.acting, self.commands, self.held, self.end = acting, commands, held, end
        for amplifier, value in zip(self._every_amplifier, amplified, strict=True):
            amplifier.value = value
        self.loops.restore(loops)
        self.filtering.restore(filtering)
        self.held_directions.restore(directions)
        self.system.act(acting)


class _Amplifier:
    """An amplifier that starts at rest; its input is linear between the two values of a step.

    Attributes:
        value: output at the end of the last step.
    """

    def __init__(self, rate: float, time_step: float) -> None:
        """Make one; rate: of its low-pass [1/s]."""
        x = rate * time_step
        self.share = -float(np.expm1(-x))
        self.slope = 1 - self.share / x
        self.value = 0.0

    def __call__(self, before: float, after: float) -> float:
        self.value += self.share * (before - self.value) + self.slope * (after - before)
        return self.value

    def mean(self, held: float) -> float:
        """Go on by a step with a held input; return the mean of the output over the step."""
        start = self.value
        self(held, held)
        return self.slope * held + (1 - self.slope) * start
