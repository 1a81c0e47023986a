"""FMUs of linear models and scenes: C sources, a description, and a library for the machine they are made on."""

import tempfile
import uuid
import zipfile
from collections.abc import Mapping
from dataclasses import replace
from importlib import resources
from pathlib import Path

import numpy as np

from nassim.base.checks import known
from nassim.base.storage import write_atomically
from nassim.exchange.c_code import StepCode
from nassim.exchange.c_compiler import binary_of, compile_library, find_compiler
from nassim.exchange.c_rates import RateCode
from nassim.exchange.c_tables import CNumbers, as_identifier
from nassim.exchange.fmi_description import INTERFACES, VERSIONS, FMUModel, build_description, model_description
from nassim.exchange.programs import rates_of, steps_of
from nassim.scene.scene import Scene
from nassim.systems.linear_model import LinearModel
from nassim.systems.step_program import RateProgram, StepProgram

HEADERS = {
    "2.0": ("fmi2Functions.h", "fmi2FunctionTypes.h", "fmi2TypesPlatform.h"),
    "3.0": ("fmi3Functions.h", "fmi3FunctionTypes.h", "fmi3PlatformTypes.h"),
}
FIRST_DAY = (1980, 1, 1, 0, 0, 0)
"""Time of all files in an FMU, so that equal models give equal files."""
SPACE = uuid.UUID("8f9d9a4c-0a5b-4f0e-9a53-0c1f6f2f8d51")
"""Name space of the tokens."""


def export_fmu(
    model: LinearModel | Scene,
    path: str | Path,
    *,
    version: str = "2.0",
    interface: str = "co_simulation",
    time_step: float | None = None,
    hold_order: int = 0,
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

    Args:
        model: a linear model, or a scene; with loops for co-simulation only, whose commands are outputs too.
        path: file with the ending .fmu.
        version: of FMI, "2.0" or "3.0".
        interface: "co_simulation" or "model_exchange".
        time_step: of co-simulation [s]; None for that of a sampled model, or of the fastest loop of a scene.
        hold_order: of co-simulation; 0 for inputs that keep their value during a step, 1 for inputs that run straight
            to the value that is set after it.
        binaries: whether to compile a library for this machine, with the C compiler `cc`, `gcc` or `clang`.
        description: a line about the model.
        start: of a scene, "equilibrium" or "released", see `simulate`.
        constant_inputs: of a scene, constant values of inputs that act beside the inputs, by name, see `simulate`.
        input_sizes: typical magnitudes of inputs, by name; 1 for others. In model exchange, they give those of the
            states, by which a solver weighs its errors.
        allow_unstable: whether a model whose motion grows is written.

    Returns:
        Path of the file.

    Raises:
        ValueError: for a scene that exact steps refuse, such as one in floating frames; for a controller in Python; for
            a model that is unstable; for a sampled model or one with loops in model exchange; for arguments out of
            range.
        RuntimeError: without a C compiler, when it fails, and for a machine without a place in FMUs.
    """
    target = Path(path)
    known("file ending", target.suffix, (".fmu",))
    known("version", version, VERSIONS)
    known("interface", interface, INTERFACES)
    place = binary_of(version, as_identifier(target.stem)) if binaries else ""
    if binaries:
        find_compiler()
    program: StepProgram | RateProgram
    if interface == "co_simulation":
        program = steps_of(
            model,
            time_step,
            hold_order=hold_order,
            start=start,
            constant_inputs=constant_inputs,
            input_sizes=input_sizes,
            allow_unstable=allow_unstable,
        )
    else:
        if time_step is not None or hold_order:
            raise ValueError("time_step and hold_order are of co-simulation: leave them out of model exchange")
        program = rates_of(
            model,
            start=start,
            constant_inputs=constant_inputs,
            input_sizes=input_sizes,
            allow_unstable=allow_unstable,
        )
    sources = _sources(program, version)
    described = _described(program, interface, target.stem, description, tuple(n for n in sources if n.endswith(".c")))
    identity = repr((target.stem, version, description, program.inputs, program.outputs, sources))
    described = replace(described, token=f"{{{uuid.uuid5(SPACE, identity)}}}")
    xml = model_description(described, version)
    sources["fmu.h"] = CONFIGURATION.format(exchange=int(interface == "model_exchange"), token=described.token)
    files = {"modelDescription.xml": xml} | {f"sources/{name}": text.encode() for name, text in sources.items()}
    if version == "3.0":
        files["sources/buildDescription.xml"] = build_description(described)
    if binaries:
        files[place] = _library(sources, described)
    with write_atomically(target) as temporary, zipfile.ZipFile(temporary, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in files.items():
            archive.writestr(zipfile.ZipInfo(name, FIRST_DAY), content, zipfile.ZIP_DEFLATED)
    return target


def _sources(program: StepProgram | RateProgram, version: str) -> dict[str, str]:
    """Return the texts of all source files that do not depend on the token, by their names."""
    folder = resources.files("nassim.exchange") / "fmi"
    code: RateCode | StepCode
    if isinstance(program, RateProgram):
        code = RateCode.of(program, "model")
    else:
        code = StepCode.of(program, "model", CNumbers())
    shared = (f"fmi{version[0]}_interface.c", "instance.h", *HEADERS[version])
    texts = {name: (folder / name).read_text(encoding="utf-8") for name in shared}
    return texts | {"model.c": code.source, "model.h": code.header}


def _described(
    program: StepProgram | RateProgram, interface: str, name: str, description: str, sources: tuple[str, ...]
) -> FMUModel:
    if isinstance(program, RateProgram):
        direct, sizes, start, step = program.matrices[3], program.sizes, program.start, None
    else:
        commands = len(program.outputs) - len(program.feedthrough)
        unknown = np.full((commands, len(program.inputs)), np.nan)
        direct, sizes, start = np.vstack([program.feedthrough, unknown]), np.zeros(0), np.zeros(0)
        step = program.time_step
    return FMUModel(
        name=name,
        identifier=as_identifier(name),
        description=description,
        token="",
        interface=interface,
        inputs=program.inputs,
        outputs=program.outputs,
        direct=direct,
        sizes=sizes,
        start=start,
        time_step=step,
        sources=sources,
    )


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
/* What this FMU is: for model exchange (1) or co-simulation (0), and the token of its description */
#ifndef FMU_H
#define FMU_H

#include "model.h"

#define MODEL_EXCHANGE {exchange}
#define FMU_TOKEN "{token}"

#endif
"""
