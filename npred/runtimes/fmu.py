"""A controller as a Functional Mock-up Unit for co-simulation, FMI 3.0 or 2.0 [fmi-standard.org], around its C.

An FMU is a zip archive: a description of its variables, a shared library for this machine, and the sources of both. Its
control steps are due at start + k dt; one is done within each communication step [t, t + h) that holds its time, with
the inputs as they stand, and the outputs are those of the last one.
"""

import hashlib
import os
import platform
import sys
import tempfile
import xml.etree.ElementTree as ET
import zipfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

import npred
from npred.errors import ConfigError, unlisted
from npred.json_files import escaped
from npred.loop.controller import Controller
from npred.runtimes import c_controller, c_files, fmu_variables
from npred.runtimes.fmu_variables import LARGEST, PARAMETERS, Variable

VERSIONS = (3, 2)
HIDDEN = "-fvisibility=hidden"  # but what FMI names
SUFFIXES = {"linux": ".so", "darwin": ".dylib", "windows": ".dll"}
SYSTEMS = {"linux": "linux-gnu", "darwin": "macos", "windows": "windows-gnu"}  # as zig names them
MACHINES = {"amd64": "x86_64", "arm64": "aarch64"}
ABOUT = {  # the categories of the log
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


class Platform(NamedTuple):
    """A system and its machine, in FMI 3.0's words."""

    system: str
    machine: str

    def place(self, version: int, identifier: str) -> str | None:
        """Where its library lies in the archive; None where FMI has no name for it."""
        folder = f"{self.machine}-{self.system}" if version == 3 else FOLDERS_OF_2.get(self)
        return f"binaries/{folder}/{identifier}{SUFFIXES[self.system]}" if folder and self.system in SUFFIXES else None


FOLDERS_OF_2 = {
    Platform("linux", "x86_64"): "linux64", Platform("darwin", "x86_64"): "darwin64",
    Platform("windows", "x86_64"): "win64",
}  # fmt: skip
NAMED = {name: platform for platform, name in FOLDERS_OF_2.items()} | {
    f"{machine}-{system}": Platform(system, machine) for system in SUFFIXES for machine in MACHINES.values()
}


class Written(NamedTuple):
    """What an FMU holds: where its libraries lie, its token, and its variables."""

    libraries: list[str]
    token: str
    variables: list[Variable]

    @property
    def library(self) -> str | None:
        """Where the first library lies; None where it has none."""
        return next(iter(self.libraries), None)


class Model(NamedTuple):
    """What a description says beside the variables."""

    plant: str
    identifier: str  # of the files and of C
    token: str
    about: str
    dt: float
    t_end: float
    sources: tuple[str, ...]


def write(
    controller: Controller, path: Path, *, version: int = 3, name: str = "npred", precision: str = "double",
    model: str = "", X0: ArrayLike | None = None, t_end: float = 1.0, platforms: Sequence[str] = (),
) -> Written:  # fmt: skip
    """Write the FMU of a controller. `X0` (n,) are the first values of the inputs X, `t_end` the experiment's seconds.

    It holds a library for each of `platforms` (NAMED), which ziglang compiles; by default one for this machine, or,
    without a C compiler, its sources alone. Raises ConfigError for another version of FMI, for a platform that it has
    no name for, for names of variables that are not different, and as npred.runtimes.c_controller.sources does;
    MissingError for platforms without ziglang.
    """
    if version not in VERSIONS:
        raise ConfigError(f"fmi: expected 3 or 2, got {version}; give one")
    places = _chosen(version, name, platforms) if platforms else _own(version, name)
    X0 = np.zeros(controller.plant.n) if X0 is None else np.asarray(X0, dtype=float)
    listed = fmu_variables.of(controller, X0, arrays=version == 3)
    header, source = c_controller.sources(controller, name, precision, model, tunable=True)
    texts = {f"{name}.h": header, f"{name}.c": source}
    texts |= {file: c_files.filled(file, name, precision) for file in ("instance.h", "calls.h", f"fmi{version}.c")}
    sources = (f"{name}.c", f"fmi{version}.c")
    about = f"Predictor feedback: {model or controller.predictor.name}"
    described = Model(controller.plant.name, name, "", about, controller.dt, t_end, sources)
    token = _token(texts, _description(version, described, listed))
    described = described._replace(token=token)
    texts["variables.h"] = fmu_variables.header(controller, listed, name, token)
    files: dict[str, str | bytes] = {"modelDescription.xml": _description(version, described, listed)}
    libraries = {place: _compiled(texts, sources, target) for place, target in places.items()}
    files |= libraries
    files |= {f"sources/{file}": text for file, text in texts.items()}
    files |= {"sources/buildDescription.xml": _build_description(described)} if version == 3 else {}
    _archive(path, files)
    return Written(list(libraries), token, listed)


def _token(texts: Mapping[str, str], undated: str) -> str:
    """What identifies the FMU: a hash of all that it is made of, in the form of a GUID."""
    digest = hashlib.sha256("\0".join([*texts.values(), undated]).encode()).hexdigest()
    return "{" + "-".join(digest[i:j] for i, j in ((0, 8), (8, 12), (12, 16), (16, 20), (20, 32))) + "}"


def _own(version: int, identifier: str) -> dict[str, str]:
    """Where the library of this machine lies; nowhere without a C compiler, or where FMI has no name for it."""
    system, machine = platform.system().lower(), platform.machine().lower()
    place = Platform(system, MACHINES.get(machine, machine)).place(version, identifier)
    return {place: ""} if place and c_files.compiler() else {}


def _chosen(version: int, identifier: str, names: Sequence[str]) -> dict[str, str]:
    """Where the libraries of platforms lie, and how zig names these. Raises ConfigError for one that has no name."""
    nameable = [name for name, one in NAMED.items() if one.place(version, identifier)]
    places = {}
    for name in names:
        if name not in nameable:
            raise ConfigError(unlisted("platforms", name, nameable, "some of"))
        one = NAMED[name]
        places[str(one.place(version, identifier))] = f"{one.machine}-{SYSTEMS[one.system]}"
    return places


def _compiled(texts: Mapping[str, str], sources: Sequence[str], target: str) -> bytes:
    """The shared library of the sources for a machine, this one without a name. Raises as c_files.build does."""
    with tempfile.TemporaryDirectory() as folder:
        for name, text in texts.items():
            (Path(folder) / name).write_text(text, encoding="utf-8")
        c_files.build([Path(folder) / name for name in sources], Path(folder) / "library", "fmu", HIDDEN, other=target)
        return (Path(folder) / "library").read_bytes()


def _archive(path: Path, files: Mapping[str, str | bytes]) -> None:
    """Write the zip archive, its entries in this order, without the time: the same files give the same bytes."""
    handle, temporary = tempfile.mkstemp(dir=path.parent, suffix=".tmp")
    try:
        with os.fdopen(handle, "wb") as target, zipfile.ZipFile(target, "w", zipfile.ZIP_DEFLATED) as archive:
            for name, content in files.items():
                entry = zipfile.ZipInfo(name)  # of the year 1980, as zip counts from there
                entry.compress_type, entry.external_attr, entry.create_system = zipfile.ZIP_DEFLATED, 0o644 << 16, 3
                archive.writestr(entry, content)
        os.replace(temporary, path)
    except BaseException:
        Path(temporary).unlink(missing_ok=True)
        raise
    if sys.platform != "win32":
        path.chmod(0o644)


def _description(version: int, model: Model, variables: Sequence[Variable]) -> str:
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


def _build_description(model: Model) -> str:
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
