"""The XML files of an FMU: the model description of FMI 3.0 and 2.0, and how its sources are built."""

import xml.etree.ElementTree as ET
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import npred
from npred.json_files import escaped
from npred.runtimes.fmu.variables import LARGEST, PARAMETERS, Variable

ABOUT = {
    "logStatusWarning": "a control step that was refused",
    "logStatusDiscard": "a value that was refused",
    "logStatusError": "a call that was wrong",
}
TOKENS = {2: "guid", 3: "instantiationToken"}
ABILITIES = {
    2: ("canHandleVariableCommunicationStepSize", "canNotUseMemoryManagementFunctions", "canGetAndSetFMUstate",
        "canSerializeFMUstate"),
    3: ("canGetAndSetFMUState", "canSerializeFMUState", "canHandleVariableCommunicationStepSize"),
}  # fmt: skip


class Model(NamedTuple):
    """What a description says beside the variables."""

    plant: str
    identifier: str  # of the files and of C
    token: str
    about: str
    dt: float
    t_end: float
    sources: tuple[str, ...]


def describe(version: int, model: Model, variables: Sequence[Variable]) -> str:
    """modelDescription.xml."""
    root = ET.Element(
        "fmiModelDescription", {"fmiVersion": f"{version}.0", TOKENS[version]: model.token}, modelName=model.plant,
        description=model.about, generationTool=f"npred {npred.__version__}", variableNamingConvention="flat",
    )  # fmt: skip
    abilities = dict.fromkeys(ABILITIES[version], "true")
    slave = ET.SubElement(root, "CoSimulation", abilities, modelIdentifier=model.identifier)
    if version == 3:
        slave.set("fixedInternalStepSize", repr(model.dt))
    else:
        _each(ET.SubElement(slave, "SourceFiles"), "File", {name: {} for name in model.sources})
    units = sorted({variable.unit for variable in variables} - {""})
    _each(ET.SubElement(root, "UnitDefinitions"), "Unit", {unit: {} for unit in units})
    _each(ET.SubElement(root, "LogCategories"), "Category", {name: {"description": ABOUT[name]} for name in ABOUT})
    times = {"startTime": 0.0, "stopTime": model.t_end, "stepSize": model.dt}
    ET.SubElement(root, "DefaultExperiment", {name: repr(float(value)) for name, value in times.items()})
    listed, structure = ET.SubElement(root, "ModelVariables"), ET.SubElement(root, "ModelStructure")
    for reference, variable in enumerate(variables):
        (_variable_3 if version == 3 else _variable_2)(listed, reference, variable)
    outputs = [reference for reference, variable in enumerate(variables) if variable.role == "output"]
    for kind, depends in (("Output", {"dependencies": ""}), ("InitialUnknown", {})):
        unknowns = structure if version == 3 else ET.SubElement(structure, f"{kind}s")
        for reference in outputs:
            place = {"valueReference": str(reference)} if version == 3 else {"index": str(reference + 1)}
            ET.SubElement(unknowns, kind if version == 3 else "Unknown", place | depends)
    return _text(root)


def build(model: Model) -> str:
    """sources/buildDescription.xml of FMI 3.0."""
    root = ET.Element("fmiBuildDescription", fmiVersion="3.0")
    configuration = ET.SubElement(root, "BuildConfiguration", modelIdentifier=model.identifier)
    files = ET.SubElement(configuration, "SourceFileSet", language="C99")
    _each(files, "SourceFile", {name: {} for name in model.sources})
    _each(configuration, "Library", {"m": {}})
    return _text(root)


def _each(parent: ET.Element, kind: str, named: Mapping[str, dict[str, str]]) -> None:
    """An element for each name, with its other attributes."""
    for name, attributes in named.items():
        ET.SubElement(parent, kind, {"name": name} | attributes)


def _variable_3(listed: ET.Element, reference: int, variable: Variable) -> None:
    attributes = _attributes(reference, variable) | _number(variable)
    element = ET.SubElement(listed, "Boolean" if variable.boolean else "Float64", attributes)
    for extent in variable.shape:
        ET.SubElement(element, "Dimension", start=str(extent))


def _variable_2(listed: ET.Element, reference: int, variable: Variable) -> None:
    initials = {"output": "calculated"} | dict.fromkeys(PARAMETERS, "exact")
    initial = {"initial": initials[variable.role]} if variable.role in initials else {}
    element = ET.SubElement(listed, "ScalarVariable", _attributes(reference, variable) | initial)
    ET.SubElement(element, "Boolean" if variable.boolean else "Real", _number(variable))


def _attributes(reference: int, variable: Variable) -> dict[str, str]:
    parameter = variable.role in PARAMETERS
    return {
        "name": variable.name, "valueReference": str(reference), "description": variable.about,
        "causality": "parameter" if parameter else variable.role,
        "variability": variable.role if parameter else "discrete" if variable.boolean else "continuous",
    }  # fmt: skip


def _number(variable: Variable) -> dict[str, str]:
    """Unit, bounds and start."""
    attributes = {"unit": variable.unit} if variable.unit else {}
    if variable.role in PARAMETERS:
        attributes |= {"min": repr(variable.low)} if variable.low > -LARGEST else {}
        attributes |= {"max": repr(variable.high)} if variable.high < LARGEST else {}
    if variable.role in (*PARAMETERS, "input"):
        attributes["start"] = " ".join(repr(value) for value in variable.start)
    return attributes


def _text(root: ET.Element) -> str:
    """The XML; characters that XML has no place for are spelt out."""
    for element in root.iter():
        element.attrib = escaped(element.attrib)
    ET.indent(root)
    return '<?xml version="1.0" encoding="UTF-8"?>\n' + ET.tostring(root, encoding="unicode") + "\n"
