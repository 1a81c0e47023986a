"""FMUs of linear models and scenes: C sources, a description, and a library for the machine they are made on."""

import sys
import tempfile
import uuid
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass, replace
from importlib import resources
from pathlib import Path

import numpy as np

import nassim
from nassim.base.checks import known
from nassim.base.storage import write_atomically
from nassim.exchange.c_code import StepCode
from nassim.exchange.c_compiler import binary_of, compile_library, find_compiler
from nassim.exchange.c_rates import RateCode
from nassim.exchange.c_tables import CNumbers, as_identifier
from nassim.exchange.fmi_description import INTERFACES, VERSIONS, FMUModel, build_description, model_description
from nassim.exchange.programs import Exported
from nassim.exchange.python_run import PythonRun
from nassim.scene.scene import Scene
from nassim.systems.linear_model import LinearModel
from nassim.systems.step_program import RateProgram, StepProgram

HEADERS = {
    "2.0": ("fmi2Functions.h", "fmi2FunctionTypes.h", "fmi2TypesPlatform.h"),
    "3.0": ("fmi3Functions.h", "fmi3FunctionTypes.h", "fmi3PlatformTypes.h"),
}
FIRST_DAY = (1980, 1, 1, 0, 0, 0)
"""Time of all files in an FMU, so that equal models give equal files."""
METHODS = ("exact", "generalized_alpha")
SPACE = uuid.UUID("8f9d9a4c-0a5b-4f0e-9a53-0c1f6f2f8d51")
"""Name space of the tokens."""


def export_fmu(
    model: LinearModel | Scene,
    path: str | Path,
    *,
    version: str = "2.0",
    interface: str = "co_simulation",
    time_step: float | None = None,
    method: str = "exact",
    hold_order: int = 0,
    spectral_radius: float | None = None,
    stress: str = "start",
    binaries: bool = True,
    description: str = "",
    start: str = "equilibrium",
    constant_inputs: Mapping[str, float] | None = None,
    input_sizes: Mapping[str, float] | None = None,
    allow_unstable: bool = False,
) -> Path:
    """Write a linear model or a scene as an FMU: plain C99 with its sources, which needs no Python to run.

    Co-simulation takes the exact steps of `simulate(..., method="exact")`, with the scene's loops. A communication step
    is a whole number of time steps. Model exchange has the continuous equations, for the solver of the importing
    program. The FMU has no parameters that its user could change.

    A scene that exact steps refuse, such as one in floating frames, takes `method="generalized_alpha"`. Its FMU holds
    the scene and runs nassim's `Simulation` in a process of Python, so the machine that runs the FMU needs Python with
    this nassim: the interpreter that made the FMU, or that of the environment variable NASSIM_PYTHON. Inputs run to the
    values that are set before a communication step within its first time step, and keep them. The export makes one step
    as a trial.

    Args:
        model: a linear model, or a scene; with loops for co-simulation only, whose commands are outputs too.
        path: file with the ending .fmu.
        version: of FMI, "2.0" or "3.0".
        interface: "co_simulation" or "model_exchange".
        time_step: of co-simulation [s]; None for that of a sampled model, or of the fastest loop of a scene.
        method: "exact", or of a scene in co-simulation "generalized_alpha", see `simulate`.
        hold_order: of exact steps; 0 for inputs that keep their value during a communication step, 1 for inputs that
            run straight, within its last time step, to the value that is set after it.
        spectral_radius: of generalized-alpha only, see `simulate` [-].
        stress: of generalized-alpha only, "start" or "present", see `simulate`.
        binaries: whether to compile a library for this machine, with the C compiler `cc`, `gcc` or `clang`.
        description: a line about the model.
        start: of a scene, "equilibrium" or "released", see `simulate`.
        constant_inputs: of a scene, constant values of inputs that act beside the inputs, by name, see `simulate`.
        input_sizes: typical magnitudes of inputs, by name; 1 for others. In model exchange, they give those of the
            states, by which a solver weighs its errors.
        allow_unstable: whether a model whose motion grows is written; it is not checked for generalized-alpha.

    Returns:
        Path of the file.

    Raises:
        ValueError: for a scene that exact steps refuse, unless the method is "generalized_alpha"; for a controller in
            Python, which neither method can take along; for a model that is unstable; for a sampled model or one with
            loops in model exchange; for arguments out of range.
        RuntimeError: without a C compiler, when it fails, and for a machine without a place in FMUs; for a scene whose
            first step fails.
    """
    target = Path(path)
    known("file ending", target.suffix, (".fmu",))
    known("version", version, VERSIONS)
    known("interface", interface, INTERFACES)
    known("method", method, METHODS)
    place = binary_of(version, as_identifier(target.stem)) if binaries else ""
    if binaries:
        find_compiler()
    _check_options(method, interface, time_step, hold_order, spectral_radius, stress)
    exported = Exported(
        source=model,
        start=start,
        constant_inputs=constant_inputs,
        input_sizes=input_sizes,
        allow_unstable=allow_unstable,
    )
    made: StepProgram | RateProgram | PythonRun
    if method != "exact":
        made = PythonRun.of(exported, time_step, spectral_radius=spectral_radius, stress=stress)
    elif interface == "co_simulation":
        made = exported.steps(time_step, hold_order)
    else:
        made = exported.rates()
    _write(target, _content(made, version, target.stem, description), version, place)
    return target


def _check_options(
    method: str,
    interface: str,
    time_step: float | None,
    hold_order: int,
    spectral_radius: float | None,
    stress: str,
) -> None:
    """Check that the options fit method and interface."""
    if interface == "model_exchange" and (time_step is not None or hold_order):
        raise ValueError("time_step and hold_order are of co-simulation: leave them out of model exchange")
    if method == "exact":
        if spectral_radius is not None or stress != "start":
            raise ValueError('spectral_radius and stress are of method="generalized_alpha": leave them out')
        return
    if interface == "model_exchange" or hold_order:
        raise ValueError(
            'method="generalized_alpha" is for co-simulation with hold_order=0: nassim runs in a process of Python'
        )
    if sys.platform == "win32":
        raise RuntimeError('FMUs that run Python (method="generalized_alpha") are for Linux and macOS')


@dataclass(frozen=True, kw_only=True)
class _Content:
    """Description, source files and resources of an FMU.

    Attributes:
        model: its description, without a token.
        sources: texts of the source files, by name.
        resources: resource files, by name.
        configuration: definitions that its sources read.
    """

    model: FMUModel
    sources: dict[str, str]
    resources: dict[str, bytes]
    configuration: dict[str, str]


def _content(made: StepProgram | RateProgram | PythonRun, version: str, name: str, description: str) -> _Content:
    model = FMUModel(
        name=name,
        identifier=as_identifier(name),
        description=description,
        token="",
        interface="model_exchange" if isinstance(made, RateProgram) else "co_simulation",
        inputs=made.inputs,
        outputs=made.outputs,
        direct=np.zeros((len(made.outputs), len(made.inputs))),
        sizes=np.zeros(0),
        start=np.zeros(0),
        time_step=None if isinstance(made, RateProgram) else made.time_step,
        sources=(),
        in_python=isinstance(made, PythonRun),
    )
    shared = [f"fmi{version[0]}_interface.c", "instance.h", *HEADERS[version]]
    texts, files, defined = {}, {}, {"MODEL_EXCHANGE": "0", "MODEL_IN_PYTHON": "0"}
    if isinstance(made, PythonRun):
        shared += ["python_run.c", "python_run.h"]
        files = made.files()
        counts = {"MODEL_INPUTS": len(made.inputs), "MODEL_OUTPUTS": len(made.outputs), "MODEL_STATES": 0}
        defined |= {"MODEL_IN_PYTHON": "1"} | {key: str(count) for key, count in counts.items()}
        defined |= {"MODEL_TIME_STEP": repr(made.time_step), "FMU_MADE_BY": _quoted(f"nassim {nassim.__version__}")}
        defined["FMU_PYTHON"] = _quoted(sys.executable or "python3")
        note = f"runs nassim {nassim.__version__} in Python, which the machine that runs the FMU needs"
        model = replace(model, description="; ".join(filter(None, (description, note))))
    elif isinstance(made, RateProgram):
        rates = RateCode.of(made, "model")
        texts = {"model.c": rates.source, "model.h": rates.header}
        model = replace(model, direct=made.matrices[3], sizes=made.sizes, start=made.start)
        defined["MODEL_EXCHANGE"] = "1"
    else:
        steps = StepCode.of(made, "model", CNumbers())
        texts = {"model.c": steps.source, "model.h": steps.header}
        unknown = np.full((len(made.outputs) - len(made.feedthrough), len(made.inputs)), np.nan)  # of commands
        model = replace(model, direct=np.vstack([made.feedthrough, unknown]))
    folder = resources.files("nassim.exchange") / "fmi"
    sources = {each: (folder / each).read_text(encoding="utf-8") for each in shared} | texts
    model = replace(model, sources=tuple(each for each in sources if each.endswith(".c")))
    return _Content(model=model, sources=sources, resources=files, configuration=defined)


def _quoted(text: str) -> str:
    """Return a text as a literal of C."""
    return '"' + text.replace("\\", "\\\\").replace('"', '\\"') + '"'


def _write(target: Path, content: _Content, version: str, place: str) -> None:
    """Write an FMU, with a library at a place in it unless that is empty."""
    model = content.model
    identity = repr((model.name, version, model.description, model.inputs, model.outputs, content.sources))
    identity += repr((content.resources, content.configuration)) * bool(content.resources)
    model = replace(model, token=f"{{{uuid.uuid5(SPACE, identity)}}}")
    defined = content.configuration | {"FMU_TOKEN": _quoted(model.token)}
    lines = "\n".join(f"#define {key} {value}" for key, value in defined.items())
    included = "python_run.h" if model.in_python else "model.h"
    sources = content.sources | {"fmu.h": CONFIGURATION.format(lines=lines, included=included)}
    files = {"modelDescription.xml": model_description(model, version)}
    files |= {f"sources/{name}": text.encode() for name, text in sources.items()}
    files |= {f"resources/{name}": data for name, data in content.resources.items()}
    if version == "3.0":
        files["sources/buildDescription.xml"] = build_description(model)
    if place:
        files[place] = _library(sources, model)
    with write_atomically(target) as temporary, zipfile.ZipFile(temporary, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in files.items():
            archive.writestr(zipfile.ZipInfo(name, FIRST_DAY), data, zipfile.ZIP_DEFLATED)


def _library(sources: Mapping[str, str], described: FMUModel) -> bytes:
    """Compile the sources in a temporary folder."""
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        for name, text in sources.items():
            (folder / name).write_text(text, encoding="utf-8")
        library = folder / described.identifier
        compile_library([folder / name for name in described.sources], library)
        return library.read_bytes()


CONFIGURATION = """\
/* What this FMU is: for model exchange or co-simulation, in C or in Python, and the token of its description */
#ifndef FMU_H
#define FMU_H

{lines}

#include "{included}"

#endif
"""
