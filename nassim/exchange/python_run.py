"""Runs of nassim in a process of Python, which an FMU steps from another process.

The FMU holds a scene and the options of its `Simulation`. Its library starts `python -m nassim.exchange.python_run
FOLDER` and sends requests to the standard input: a letter, "b" to begin, "s" for a step or "e" to end, then, but for
the end, the inputs as float64. A reply on the standard output is two int32, whether the request failed and the length
of a text; the text, which tells the error or warnings; and the outputs as float64 unless the request failed.
"""

import json
import os
import struct
import sys
import tempfile
import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from nassim import simulation
from nassim.base.checks import Array
from nassim.base.storage import load, save
from nassim.exchange.programs import Exported
from nassim.scene.scene import Scene
from nassim.simulation.run.scene_program import scene_signals, time_step_of
from nassim.systems.python_controller import PythonController
from nassim.systems.step_program import ProgramSignal

SCENE, OPTIONS = "scene.h5", "options.json"
"""Names of the two files in the folder."""


@dataclass(frozen=True)
class PythonRun:
    """A scene and how it runs.

    Attributes:
        scene: the scene.
        options: arguments of its `Simulation`, by name.
        inputs: the inputs.
        outputs: the outputs, then the commands of the loops.
    """

    scene: Scene
    options: Mapping[str, Any]
    inputs: tuple[ProgramSignal, ...]
    outputs: tuple[ProgramSignal, ...]

    @classmethod
    def of(
        cls,
        exported: Exported,
        time_step: float | None,
        *,
        spectral_radius: float | None,
        stress: str,
    ) -> "PythonRun":
        """Collect the options of a run, and make one step of it, so that a scene that cannot run is refused.

        Args:
            exported: the scene, its start and its inputs.
            time_step: as of `export_fmu`, as are the following [s].
            spectral_radius: 0 to 1; None for that of the scene [-].
            stress: "start" or "present".

        Raises:
            ValueError: as `Simulation`, for a controller in Python, and for parts of classes that are not nassim's.
            RuntimeError: as `Simulation`.
        """
        scene = exported.source
        if not isinstance(scene, Scene):
            raise ValueError(f'method="generalized_alpha" takes a Scene, got a {type(scene).__name__}')
        _refuse_own_classes(scene)
        options: dict[str, Any] = {
            "time_step": time_step_of(scene, time_step),
            "spectral_radius": spectral_radius,
            "start": exported.start,
            "stress": stress,
            "constant_inputs": dict(exported.constant_inputs or {}),
        }
        inputs, outputs = scene_signals(scene)
        with simulation.Simulation(scene, **options) as trial:
            trial.step()
        return cls(scene, options, exported.sized(inputs), outputs)

    @property
    def time_step(self) -> float:
        """Time step [s]."""
        return float(self.options["time_step"])

    def files(self) -> dict[str, bytes]:
        """Return the contents of the two files, by their names.

        Raises:
            ValueError: for a scene that no file can hold.
        """
        with tempfile.TemporaryDirectory() as folder:
            scene = save(self.scene, Path(folder) / SCENE).read_bytes()
        return {SCENE: scene, OPTIONS: json.dumps(self.options, indent=1).encode()}


def _refuse_own_classes(scene: Scene) -> None:
    """Refuse what the process of an FMU does not know: controllers in Python, and classes of a user."""
    for loop in scene.loops:
        if isinstance(loop.controller, PythonController):
            law = type(loop.controller.law).__name__
            raise ValueError(
                f"loop {loop.name!r}: its controller, a {law} in Python, has no place in an FMU; leave the loop out, "
                "and close it in the importing program"
            )
    named: tuple[Any, ...] = (*scene.bodies, *scene.parts)
    for item in named:
        kind = type(item)
        if not kind.__module__.startswith("nassim."):
            raise ValueError(
                f"{item.name!r} is a {kind.__name__} of {kind.__module__}, which is not of nassim and has no place in "
                "an FMU: leave it out"
            )


class _Served:
    """The run that answers requests; each answer is the outputs and the loops' commands."""

    def __init__(self, folder: Path, requests: BinaryIO) -> None:
        self._folder, self._requests = folder, requests
        self._run: simulation.Simulation | None = None
        self._names: tuple[str, ...] = ()
        self._outputs: Array = np.zeros(0)

    def answer(self, kind: bytes) -> Array:
        """Do what a request asks for."""
        if kind == b"b":
            scene = load(self._folder / SCENE, as_=Scene)
            options = json.loads((self._folder / OPTIONS).read_text(encoding="utf-8"))
            self._names = scene.inputs
            self._run = simulation.Simulation(scene, inputs=self._inputs(), **options)
            self._run.__enter__()
        elif self._run and kind == b"s":
            self._run.step(self._inputs())
        elif self._run:
            self._run.__exit__(None, None, None)
            return self._outputs
        else:
            raise RuntimeError("the run has not begun")
        self._outputs = np.array([*self._run.outputs.values()])
        return self._outputs

    def _inputs(self) -> dict[str, float]:
        values = np.frombuffer(self._requests.read(8 * len(self._names)))
        return dict(zip(self._names, values.tolist(), strict=True))


def serve(folder: Path, requests: BinaryIO, replies: BinaryIO) -> None:
    """Answer requests until there are no more, or one fails.

    Args:
        folder: with the files of a `PythonRun`.
        requests: stream of the requests.
        replies: stream of the replies.
    """
    served = _Served(folder, requests)
    while kind := requests.read(1):
        failed, outputs, lines = False, np.zeros(0), []
        with warnings.catch_warnings(record=True) as given:
            warnings.simplefilter("always")
            try:
                outputs = served.answer(kind)
                lines = [str(one.message) for one in given]
            except Exception as error:
                failed, lines = True, [f"{type(error).__name__}: {error}"]
        # In FMI 2, the text becomes a format of C's printf in the importing program.
        text = "\n".join(lines).replace("%", "percent").encode()
        replies.write(struct.pack("=ii", failed, len(text)) + text + outputs.tobytes())
        replies.flush()
        if failed:
            return


if __name__ == "__main__":
    own_output = os.dup(1)
    os.dup2(2, 1)  # what libraries print is no reply
    with open(0, "rb", closefd=False) as standard_input, open(own_output, "wb") as standard_output:
        serve(Path(sys.argv[1]), standard_input, standard_output)
