"""The XML files of an FMU: the model description of FMI 3.0 and 2.0, and how its sources are built."""

import xml.etree.ElementTree as ET
from collections.abc import Sequence
from typing import NamedTuple

import npred
from npred.json_files import escaped
from npred.runtimes.fmu.variables import LARGEST, Variable

ABOUT = {
    "logStatusWarning": "a control step that was refused",
    "logStatusDiscard": "a value that was refused",
    "logStatusError": "a call that was wrong",
}


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
    return {2: _version_2, 3: _version_3}[version](model, variables)


def build(model: Model) -> str:
    """sources/buildDescription.xml of FMI 3.0."""
    root = ET.Element("fmiBuildDescription", fmiVersion="3.0")
    configuration = ET.SubElement(root, "BuildConfiguration", modelIdentifier=model.identifier)
    files = ET.SubElement(configuration, "SourceFileSet", language="C99")
    for name in model.sources:
        ET.SubElement(files, "SourceFile", name=name)
    ET.SubElement(configuration, "Library", name="m")
    return _text(root)


def _version_3(model: Model, variables: Sequence[Variable]) -> str:
    root = ET.Element(
        "fmiModelDescription", fmiVersion="3.0", modelName=model.plant, instantiationToken=model.token,
        description=model.about, generationTool=f"npred {npred.__version__}", variableNamingConvention="flat",
    )  # fmt: skip
    ET.SubElement(
        root, "CoSimulation", modelIdentifier=model.identifier, canGetAndSetFMUState="true",
        canSerializeFMUState="true", canHandleVariableCommunicationStepSize="true",
        fixedInternalStepSize=repr(model.dt),
    )  # fmt: skip
    _units(root, variables)
    _categories(root)
    _experiment(root, model)
    listed, structure = ET.SubElement(root, "ModelVariables"), ET.Element("ModelStructure")
    for reference, variable in enumerate(variables):
        kind = "Boolean" if variable.boolean else "Float64"
        attributes = {"name": variable.name, "valueReference": str(reference)}
        element = ET.SubElement(listed, kind, attributes | _causality(variable) | {"description": variable.about})
        _describe_number(element, variable)
        for extent in variable.shape:
            ET.SubElement(element, "Dimension", start=str(extent))
    outputs = [reference for reference, variable in enumerate(variables) if variable.role == "output"]
    for kind, depends in (("Output", {"dependencies": ""}), ("InitialUnknown", {})):
        for reference in outputs:
            ET.SubElement(structure, kind, {"valueReference": str(reference)} | depends)
    root.append(structure)
    return _text(root)


def _version_2(model: Model, variables: Sequence[Variable]) -> str:
    root = ET.Element(
        "fmiModelDescription", fmiVersion="2.0", modelName=model.plant, guid=model.token, description=model.about,
        generationTool=f"npred {npred.__version__}", variableNamingConvention="flat",
    )  # fmt: skip
    slave = ET.SubElement(
        root, "CoSimulation", modelIdentifier=model.identifier, canHandleVariableCommunicationStepSize="true",
        canNotUseMemoryManagementFunctions="true", canGetAndSetFMUstate="true", canSerializeFMUstate="true",
    )  # fmt: skip
    files = ET.SubElement(slave, "SourceFiles")
    for name in model.sources:
        ET.SubElement(files, "File", name=name)
    _units(root, variables)
    _categories(root)
    _experiment(root, model)
    listed, structure = ET.SubElement(root, "ModelVariables"), ET.Element("ModelStructure")
    for reference, variable in enumerate(variables):
        attributes = (
            {"name": variable.name, "valueReference": str(reference)} | _causality(variable) | _initial(variable)
        )
        element = ET.SubElement(listed, "ScalarVariable", attributes | {"description": variable.about})
        _describe_number(ET.SubElement(element, "Boolean" if variable.boolean else "Real"), variable)
    outputs = [index for index, variable in enumerate(variables, 1) if variable.role == "output"]
    for kind, depends in (("Outputs", {"dependencies": ""}), ("InitialUnknowns", {})):
        unknowns = ET.SubElement(structure, kind)
        for index in outputs:
            ET.SubElement(unknowns, "Unknown", {"index": str(index)} | depends)
    root.append(structure)
    return _text(root)


def _causality(variable: Variable) -> dict[str, str]:
    parameter = variable.role in ("tunable", "fixed")
    causality = "parameter" if parameter else variable.role
    variability = variable.role if parameter else "discrete" if variable.boolean else "continuous"
    return {"causality": causality, "variability": variability}


def _initial(variable: Variable) -> dict[str, str]:
    return {"output": {"initial": "calculated"}, "tunable": {"initial": "exact"}, "fixed": {"initial": "exact"}}.get(
        variable.role, {}
    )


def _describe_number(element: ET.Element, variable: Variable) -> None:
    """Unit, bounds and start."""
    if variable.unit:
        element.set("unit", variable.unit)
    if variable.role in ("tunable", "fixed"):
        element.attrib |= {"min": repr(variable.low)} if variable.low > -LARGEST else {}
        element.attrib |= {"max": repr(variable.high)} if variable.high < LARGEST else {}
    if variable.role in ("tunable", "fixed", "input"):
        element.set("start", " ".join(repr(value) for value in variable.start))


def _units(root: ET.Element, variables: Sequence[Variable]) -> None:
    definitions = ET.SubElement(root, "UnitDefinitions")
    for unit in sorted({variable.unit for variable in variables} - {""}):
        ET.SubElement(definitions, "Unit", name=unit)


def _categories(root: ET.Element) -> None:
    categories = ET.SubElement(root, "LogCategories")
    for name, about in ABOUT.items():
        ET.SubElement(categories, "Category", name=name, description=about)


def _experiment(root: ET.Element, model: Model) -> None:
    times = {"startTime": 0.0, "stopTime": model.t_end, "stepSize": model.dt}
    ET.SubElement(root, "DefaultExperiment", {name: repr(float(value)) for name, value in times.items()})


def _text(root: ET.Element) -> str:
    """The XML; characters that XML has no place for are spelt out."""
    for element in root.iter():
        element.attrib = escaped(element.attrib)
    ET.indent(root)
    return '<?xml version="1.0" encoding="UTF-8"?>\n' + ET.tostring(root, encoding="unicode") + "\n"
