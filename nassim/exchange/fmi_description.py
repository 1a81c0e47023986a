"""Model descriptions of FMUs, versions 2.0 and 3.0 of FMI: variables, units and dependencies as XML."""

import re
import xml.etree.ElementTree as ET
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

import nassim
from nassim.base.checks import Array
from nassim.exchange.fmi_units import DIMENSIONLESS, base_unit
from nassim.systems.step_program import ProgramSignal

VERSIONS = ("2.0", "3.0")
INTERFACES = {"co_simulation": "CoSimulation", "model_exchange": "ModelExchange"}
FMI2_GROUPS = {
    "Output": "Outputs",
    "ContinuousStateDerivative": "Derivatives",
    "InitialUnknown": "InitialUnknowns",
}
"""Where FMI 2 has what FMI 3 calls so."""
NOT_IN_XML = r"[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]"
"""Characters that no XML file may hold, of names and descriptions; _ replaces them."""
RUN_STEPS = 1000
"""Number of time steps of the default experiment."""


@dataclass(frozen=True, kw_only=True)
class FMUModel:
    """Content of the description of an FMU, the file modelDescription.xml.

    Attributes:
        name: name of the model.
        identifier: the same as an identifier of C.
        description: a line about the model.
        token: text by which an importer and the binary know that they belong together.
        interface: "co_simulation" or "model_exchange".
        inputs: the inputs.
        outputs: the outputs.
        direct: outputs per unit of the inputs, (outputs, inputs), of which zeros are no dependencies; NaN where a
            dependency is not known.
        sizes: typical magnitudes of the states of model exchange, (n,).
        start: these states at the start, (n,).
        time_step: of co-simulation; None for model exchange [s].
        sources: names of the source files.
        in_python: whether the FMU runs nassim in Python, whose state no importing program can save.
    """

    name: str
    identifier: str
    description: str
    token: str
    interface: str
    inputs: tuple[ProgramSignal, ...]
    outputs: tuple[ProgramSignal, ...]
    direct: Array
    sizes: Array
    start: Array
    time_step: float | None
    sources: tuple[str, ...]
    in_python: bool = False


@dataclass(frozen=True)
class _Variable:
    """A variable of an FMU; its value reference is its place among all, from 0, the time."""

    name: str
    causality: str
    description: str = ""
    unit: str = ""
    initial: str = ""
    start: float | None = None
    nominal: float | None = None
    derivative_of: int | None = None


def structured_name(name: str) -> str:
    """Return the name of a variable in FMI's structured naming: parts of a name become levels with a dot between.

    A level that is no identifier stands in quotes.
    """
    return ".".join(map(_level, re.split(r"[./]", name)))


def _level(text: str) -> str:
    if re.fullmatch(r"[A-Za-z_][A-Za-z0-9_]*", text):
        return text
    # Within quotes the convention allows these characters and escapes; others become _.
    allowed = re.sub(r"[^A-Za-z0-9_!#$%&()*+,\-./:;<>=?@\[\]^{}|~ ]", "_", text)
    return f"'{allowed or '_'}'"


def model_description(model: FMUModel, version: str) -> bytes:
    """Return modelDescription.xml of an FMU.

    Raises:
        ValueError: for signals whose names would be the same.
    """
    variables = _variables(model)
    root = _root(model, version)
    root.append(_interface(model, version))
    root.append(_units(variables))
    categories = ET.SubElement(root, "LogCategories")
    for category in ("logStatusError", "logStatusDiscard", *(["logStatusWarning"] if model.in_python else [])):
        ET.SubElement(categories, "Category", name=category)
    experiment = {"startTime": "0", "tolerance": "1e-6"}
    if model.time_step is not None:
        experiment |= {"stopTime": repr(RUN_STEPS * model.time_step), "stepSize": repr(model.time_step)}
    ET.SubElement(root, "DefaultExperiment", experiment)
    root.append(_model_variables(variables, version))
    root.append(_structure(model, version))
    return _written(root)


def build_description(model: FMUModel) -> bytes:
    """Return sources/buildDescription.xml of an FMU of version 3.0."""
    root = ET.Element("fmiBuildDescription", fmiVersion="3.0")
    configuration = ET.SubElement(root, "BuildConfiguration", modelIdentifier=model.identifier)
    files = ET.SubElement(configuration, "SourceFileSet", language="C99")
    for name in model.sources:
        ET.SubElement(files, "SourceFile", name=name)
    return _written(root)


def _written(root: ET.Element) -> bytes:
    for element in root.iter():
        element.attrib = {key: re.sub(NOT_IN_XML, "_", value) for key, value in element.attrib.items()}
    ET.indent(root)
    result: bytes = ET.tostring(root, encoding="UTF-8", xml_declaration=True)
    return result + b"\n"


def _root(model: FMUModel, version: str) -> ET.Element:
    token = "guid" if version == "2.0" else "instantiationToken"
    attributes = {"fmiVersion": version, "modelName": model.name, token: model.token}
    attributes |= {"description": model.description} if model.description else {}
    attributes |= {"generationTool": f"nassim {nassim.__version__}", "variableNamingConvention": "structured"}
    if version == "2.0":
        attributes["numberOfEventIndicators"] = "0"
    return ET.Element("fmiModelDescription", attributes)


def _interface(model: FMUModel, version: str) -> ET.Element:
    state = "canGetAndSetFMUstate" if version == "2.0" else "canGetAndSetFMUState"
    serialize = "canSerializeFMUstate" if version == "2.0" else "canSerializeFMUState"
    attributes = {"modelIdentifier": model.identifier}
    attributes |= {"needsExecutionTool": "true"} if model.in_python else {state: "true", serialize: "true"}
    if model.time_step is not None:
        attributes["canHandleVariableCommunicationStepSize"] = "false"
        if version == "3.0":
            attributes["fixedInternalStepSize"] = repr(model.time_step)
    result = ET.Element(INTERFACES[model.interface], attributes)
    if version == "2.0":
        files = ET.SubElement(result, "SourceFiles")
        for name in model.sources:
            ET.SubElement(files, "File", name=name)
    return result


def _variables(model: FMUModel) -> list[_Variable]:
    """Return all variables in the order of their value references; raise ValueError for equal names."""
    result = [_Variable("time", "independent", "simulation time", "s")]
    result += [_of_signal(signal, "input", start=0.0) for signal in model.inputs]
    result += [_of_signal(signal, "output", initial="calculated") for signal in model.outputs]
    first = len(result)
    numbers = [f"state[{k}]" for k in range(1, len(model.start) + 1)]
    for name, start, size in zip(numbers, model.start.tolist(), model.sizes.tolist(), strict=True):
        result.append(_Variable(name, "local", "state", initial="exact", start=start, nominal=size))
    for place, name in enumerate(numbers, start=first):
        result.append(
            _Variable(f"der({name})", "local", "rate of the state", initial="calculated", derivative_of=place)
        )
    for name, times in Counter(variable.name for variable in result).items():
        if times > 1:
            raise ValueError(
                f"the FMU would have {times} variables {name!r}: inputs, outputs and the time need different names in "
                "which . and / mean the same; rename a signal"
            )
    return result


def _of_signal(signal: ProgramSignal, causality: str, *, initial: str = "", start: float | None = None) -> _Variable:
    name = structured_name(signal.name)
    parts = (signal.name if name != signal.name else "", signal.description)
    nominal = signal.size if causality == "input" and signal.size != 1 else None
    return _Variable(name, causality, ": ".join(filter(None, parts)), signal.unit, initial, start, nominal)


def _units(variables: Sequence[_Variable]) -> ET.Element:
    """Return the definitions of all units; there is one at least, that of the time."""
    used = [unit for unit in dict.fromkeys(v.unit for v in variables) if unit not in DIMENSIONLESS]
    result = ET.Element("UnitDefinitions")
    for unit in used:
        element = ET.SubElement(result, "Unit", name=unit)
        if found := base_unit(unit):
            attributes = {name: str(exponent) for name, exponent in found.exponents}
            attributes |= {"factor": repr(found.factor)} if found.factor != 1 else {}
            ET.SubElement(element, "BaseUnit", attributes)
    return result


def _model_variables(variables: Sequence[_Variable], version: str) -> ET.Element:
    result = ET.Element("ModelVariables")
    for reference, variable in enumerate(variables):
        outer = {"name": variable.name, "valueReference": str(reference), "causality": variable.causality}
        outer |= {"description": variable.description} if variable.description else {}
        outer["variability"] = "continuous"
        outer |= {"initial": variable.initial} if variable.initial else {}
        inner = {"unit": variable.unit} if variable.unit not in DIMENSIONLESS else {}
        if variable.nominal is not None:
            inner["nominal"] = repr(variable.nominal)
        if variable.start is not None:
            inner["start"] = repr(variable.start)
        if variable.derivative_of is not None:  # FMI 2 counts variables from 1, the time
            inner["derivative"] = str(variable.derivative_of + (version == "2.0"))
        if version == "2.0":
            ET.SubElement(ET.SubElement(result, "ScalarVariable", outer), "Real", inner)
        else:
            ET.SubElement(result, "Float64", outer | inner)
    return result


def _structure(model: FMUModel, version: str) -> ET.Element:
    """Return the dependencies: of FMI 2 by place from 1, of FMI 3 by value reference."""
    shift = version == "2.0"
    n_in, n_out, n = len(model.inputs), len(model.outputs), len(model.start)
    outputs = range(1 + n_in, 1 + n_in + n_out)
    rates = range(1 + n_in + n_out + n, 1 + n_in + n_out + 2 * n)
    result = ET.Element("ModelStructure")
    groups = {"Output": outputs, "ContinuousStateDerivative": rates, "InitialUnknown": (*outputs, *rates)}
    for tag, references in groups.items():
        if not references:
            continue
        parent = ET.SubElement(result, FMI2_GROUPS[tag]) if shift else result
        for row, reference in enumerate(references):
            place = {"index" if shift else "valueReference": str(reference + shift)}
            element = ET.SubElement(parent, "Unknown" if shift else tag, place)
            if tag == "Output" and not n and not np.isnan(model.direct[row]).any():
                used = np.flatnonzero(model.direct[row]) + 1 + shift
                element.set("dependencies", " ".join(map(str, used.tolist())))
    return result
