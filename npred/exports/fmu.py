"""A controller as a Functional Mock-up Unit for co-simulation, FMI 3.0 or 2.0 [fmi-standard.org], around its C.

An FMU is a zip archive: a description of its variables, a shared library for this machine, and the sources of both. Its
control steps are due at start + k dt; one is done within each communication step [t, t + h) that holds its time, with
the inputs as they stand, and the outputs are those of the last one.
"""

import hashlib
import io
import json
import platform
import sys
import tempfile
import xml.etree.ElementTree as ET
import zipfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import accumulate
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

import npred
from npred.base.errors import ConfigError, unlisted
from npred.base.json_files import escaped
from npred.exports import Exported, WholeController, c_controller, c_files
from npred.guard.guarded import PASSES, Guarded
from npred.kernels.c_text import literal
from npred.loop.controller import Controller
from npred.plants.speed import long

SUFFIXES = {"linux": ".so", "darwin": ".dylib", "windows": ".dll"}
SYSTEMS = {"linux": "linux-gnu", "darwin": "macos", "windows": "windows-gnu"}  # as zig names them
MACHINES = {"amd64": "x86_64", "arm64": "aarch64"}
ABOUT = {  # the categories of the log
    "logStatusWarning": "a control step was refused",
    "logStatusDiscard": "a value was refused",
    "logStatusError": "a call was wrong",
}
TOKENS = {2: "guid", 3: "instantiationToken"}
ABILITIES = {
    2: "canHandleVariableCommunicationStepSize canNotUseMemoryManagementFunctions canGetAndSetFMUstate "
    "canSerializeFMUstate",
    3: "canGetAndSetFMUState canSerializeFMUState canHandleVariableCommunicationStepSize",
}
LARGEST, SMALLEST = sys.float_info.max, sys.float_info.min
PARAMETERS = ("tunable", "fixed")  # these roles; the others are input, output and independent
NO_LIBRARY = "sources only, because there is no C compiler here; install one, or let the importer build them"
NO_PLACE = "sources only, because FMI 2.0 has no name for this machine; take --fmi 3, or let the importer build them"


class Platform(NamedTuple):
    """A system and its machine, in FMI 3.0's words."""

    system: str
    machine: str

    def place(self, version: int, identifier: str) -> str | None:
        """Where its library lies in the archive; None where FMI has no name for it."""
        folder = f"{self.machine}-{self.system}" if version == 3 else FOLDERS_OF_2.get(self)
        return f"binaries/{folder}/{identifier}{SUFFIXES[self.system]}" if folder and self.system in SUFFIXES else None


FOLDERS_OF_2 = {
    Platform("linux", "x86_64"): "linux64",
    Platform("darwin", "x86_64"): "darwin64",
    Platform("windows", "x86_64"): "win64",
}
NAMED = {name: platform for platform, name in FOLDERS_OF_2.items()} | {
    f"{machine}-{system}": Platform(system, machine) for system in SUFFIXES for machine in MACHINES.values()
}


@dataclass(frozen=True)
class Variable:
    """A variable of the model description. Those of one `block` lie one after the other in the instance.

    `start` has the numbers of the whole array, row by row; a parameter lies within low, high.
    """

    name: str
    role: str
    block: str
    start: tuple[float, ...]
    about: str
    unit: str = ""
    shape: tuple[int, ...] = ()
    low: float = -LARGEST
    high: float = LARGEST
    boolean: bool = False


def export(
    of: WholeController, path: Path, *, name: str, precision: str, fmi: int, platforms: str | Sequence[str]
) -> Exported:
    """Write the FMU of a controller.

    It holds a library for each of `platforms` (NAMED), which ziglang compiles; by default one for this machine, or,
    without a C compiler, its sources alone. Raises ConfigError for another version of FMI, for a platform that it has
    no name for, for names of variables that are not different, and as npred.exports.c_controller.sources does;
    MissingError for platforms without ziglang.
    """
    if fmi not in TOKENS:
        raise ConfigError(f"fmi: expected 3 or 2, got {fmi}; give one")
    named = list(filter(None, platforms.split(","))) if isinstance(platforms, str) else platforms
    places = _places(fmi, name, named)
    controller = of.controller
    listed = variables(controller, np.zeros(controller.plant.n) if of.X0 is None else of.X0, arrays=fmi == 3)
    header, source = c_controller.sources(controller, name, precision, of.about, tunable=True)
    texts = {f"{name}.h": header, f"{name}.c": source}
    texts |= {file: c_files.filled(file, name, precision) for file in ("instance.h", "calls.h", f"fmi{fmi}.c")}
    sources = [f"{name}.c", f"fmi{fmi}.c"]
    undated = _description(of, listed, fmi, name, "", sources)
    digest = hashlib.sha256("\0".join([*texts.values(), undated]).encode()).hexdigest()
    token = "{" + "-".join(digest[i:j] for i, j in ((0, 8), (8, 12), (12, 16), (16, 20), (20, 32))) + "}"
    texts["variables.h"] = _header(controller, listed, name, token)
    files: dict[str, str | bytes] = {"modelDescription.xml": _description(of, listed, fmi, name, token, sources)}
    files |= {place: _compiled(texts, sources, target) for place, target in places.items()}
    files |= {f"sources/{file}": text for file, text in texts.items()}
    if fmi == 3:
        root = ET.Element("fmiBuildDescription", fmiVersion="3.0")
        configuration = ET.SubElement(root, "BuildConfiguration", modelIdentifier=name)
        file_set = ET.SubElement(configuration, "SourceFileSet", language="C99")
        _each(file_set, "SourceFile", {file: {} for file in sources})
        _each(configuration, "Library", {"m": {}})
        files["sources/buildDescription.xml"] = _text(root)
    aside = path.with_name(f"{path.name}.tmp")  # a full disk leaves no half of an FMU
    aside.write_bytes(_archive(files))
    aside.replace(path)
    without = NO_PLACE if c_files.compiler() else NO_LIBRARY
    holds = f"{', '.join(places)} and sources" if places else without
    facts = {"libraries": list(places), "token": token, "variables": [variable.name for variable in listed]}
    return Exported([path], facts, f"{controller!r} as FMI {fmi}.0, {holds}")


def _places(version: int, identifier: str, names: Sequence[str]) -> dict[str, str]:
    """Where the libraries of platforms lie, and how zig names these; without names that of this machine, "".

    Nowhere without a C compiler, or where FMI has no name for this machine. Raises ConfigError for a platform that has
    no name.
    """
    if not names:
        machine = platform.machine().lower()
        place = Platform(platform.system().lower(), MACHINES.get(machine, machine)).place(version, identifier)
        return {place: ""} if place and c_files.compiler() else {}
    nameable = [name for name, one in NAMED.items() if one.place(version, identifier)]
    places = {}
    for name in names:
        if name not in nameable:
            raise ConfigError(unlisted("platforms", name, nameable, "some of"))
        one = NAMED[name]
        places[str(one.place(version, identifier))] = f"{one.machine}-{SYSTEMS[one.system]}"
    return places


def _compiled(texts: Mapping[str, str], sources: Sequence[str], target: str) -> bytes:
    """The shared library for a machine, by default this one, with FMI's names alone. Raises as c_files.build does."""
    with tempfile.TemporaryDirectory() as folder:
        for name, text in texts.items():
            (Path(folder) / name).write_text(text, encoding="utf-8")
        library, flag = Path(folder) / "library", "-fvisibility=hidden"
        c_files.build([Path(folder) / name for name in sources], library, "fmu", flag, other=target)
        return library.read_bytes()


def _archive(files: Mapping[str, str | bytes]) -> bytes:
    """The zip archive, its entries in this order, without the time: the same files give the same bytes."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in files.items():
            entry = zipfile.ZipInfo(name)  # its date is 1980, where zip begins
            entry.compress_type, entry.external_attr, entry.create_system = zipfile.ZIP_DEFLATED, 0o644 << 16, 3
            archive.writestr(entry, content)
    return buffer.getvalue()


def _description(
    of: WholeController, listed: Sequence[Variable], version: int, name: str, token: str, sources: Sequence[str]
) -> str:
    """modelDescription.xml."""
    controller = of.controller
    root = ET.Element("fmiModelDescription", {"fmiVersion": f"{version}.0", TOKENS[version]: token})
    root.set("modelName", controller.plant.name)
    root.set("description", f"Predictor feedback: {of.about or controller.predictor.name}")
    root.set("generationTool", f"npred {npred.__version__}")
    root.set("variableNamingConvention", "flat")
    slave = ET.SubElement(root, "CoSimulation", dict.fromkeys(ABILITIES[version].split(), "true"), modelIdentifier=name)
    if version == 3:
        slave.set("fixedInternalStepSize", repr(controller.dt))
    else:
        _each(ET.SubElement(slave, "SourceFiles"), "File", {key: {} for key in sources})
    units = sorted({variable.unit for variable in listed} - {""})
    _each(ET.SubElement(root, "UnitDefinitions"), "Unit", {key: {} for key in units})
    _each(ET.SubElement(root, "LogCategories"), "Category", {key: {"description": ABOUT[key]} for key in ABOUT})
    stop = of.t_end or 40 * controller.D_hat or long(controller.plant)
    times = {"startTime": 0.0, "stopTime": stop, "stepSize": controller.dt}
    ET.SubElement(root, "DefaultExperiment", {key: repr(float(value)) for key, value in times.items()})
    elements, structure = ET.SubElement(root, "ModelVariables"), ET.SubElement(root, "ModelStructure")
    for reference, variable in enumerate(listed):
        _describe(variable, reference, elements, version)
    outputs = [reference for reference, variable in enumerate(listed) if variable.role == "output"]
    for kind, depends in (("Output", {"dependencies": ""}), ("InitialUnknown", {})):
        unknowns = structure if version == 3 else ET.SubElement(structure, f"{kind}s")
        for reference in outputs:
            place = {"valueReference": str(reference)} if version == 3 else {"index": str(reference + 1)}
            ET.SubElement(unknowns, kind if version == 3 else "Unknown", place | depends)
    return _text(root)


def _describe(variable: Variable, reference: int, elements: ET.Element, version: int) -> None:
    """Append the element of a variable: its name and role; its unit, bounds and start; in FMI 3.0 its sizes."""
    parameter = variable.role in PARAMETERS
    attributes = {
        "name": variable.name,
        "valueReference": str(reference),
        "description": variable.about,
        "causality": "parameter" if parameter else variable.role,
        "variability": variable.role if parameter else "discrete" if variable.boolean else "continuous",
    }
    number = {"unit": variable.unit} if variable.unit else {}
    number |= {"min": repr(variable.low)} if parameter and variable.low > -LARGEST else {}
    number |= {"max": repr(variable.high)} if parameter and variable.high < LARGEST else {}
    if parameter or variable.role == "input":
        number["start"] = " ".join(repr(value) for value in variable.start)
    if version == 3:
        element = ET.SubElement(elements, "Boolean" if variable.boolean else "Float64", attributes | number)
        for extent in variable.shape:
            ET.SubElement(element, "Dimension", start=str(extent))
        return
    if parameter or variable.role == "output":
        attributes["initial"] = "exact" if parameter else "calculated"
    element = ET.SubElement(elements, "ScalarVariable", attributes)
    ET.SubElement(element, "Boolean" if variable.boolean else "Real", number)


def _each(parent: ET.Element, kind: str, named: Mapping[str, dict[str, str]]) -> None:
    """An element for each name, with its other attributes."""
    for name, attributes in named.items():
        ET.SubElement(parent, kind, {"name": name} | attributes)


def _text(root: ET.Element) -> str:
    """The XML; characters that XML has no place for are spelt out."""
    for element in root.iter():
        element.attrib = escaped(element.attrib)
    ET.indent(root)
    return '<?xml version="1.0" encoding="UTF-8"?>\n' + ET.tostring(root, encoding="unicode") + "\n"


def variables(controller: Controller, X0: ArrayLike, arrays: bool) -> list[Variable]:
    """All variables, each at its value reference; `arrays` where one may be an array. Raises ConfigError for twins."""
    X0 = np.asarray(X0, dtype=float)
    listed = [*_inputs(controller, X0, arrays), *_outputs(controller), *_parameters(controller)]
    names = [variable.name for variable in listed]
    if doubled := sorted({name for name in names if names.count(name) > 1}):
        what = f"expected different names of variables, got {doubled[0]!r} twice"
        raise ConfigError(f"export fmu: {what}; rename that state or input")
    return listed


def _inputs(controller: Controller, X0: np.ndarray, arrays: bool) -> Iterator[Variable]:
    plant, nx = controller.plant, controller.predictor.nx
    yield Variable("time", "independent", "TIME", (0.0,), "time", plant.time_unit)
    what = "measured output" if controller.observer else "measured state"
    X = X0 if controller.observer is None else controller.observer.measured(X0)
    for name, value in zip(controller.outputs, X.tolist(), strict=True):
        yield Variable(name, "input", "X", (value,), what, plant.units.get(name, ""))
    if controller.actuator == "history":
        about = "age of the sample when the control step is due; below 0 if there is no sample"
        yield Variable("sample_age", "input", "SAMPLE_AGE", (0.0,), about, plant.time_unit)
        return
    about = "commands under way (nodes, inputs): row 1 acts now, the last row was sent just now"
    if arrays:
        start = tuple(np.tile(controller.u0, nx).tolist())
        yield Variable("actuator_state", "input", "ACTUATOR", start, about, shape=(nx, plant.m))
        return
    for j in range(nx):
        for c, value in enumerate(controller.u0.tolist()):
            unit = plant.units.get(plant.inputs[c], "")
            yield Variable(f"actuator_state[{j + 1},{c + 1}]", "input", "ACTUATOR", (value,), about, unit)


def _outputs(controller: Controller) -> Iterator[Variable]:
    """U, what it is made of, and, where commands are read, what npred.loop.status says of the last control step."""
    plant, units, time = controller.plant, controller.plant.units, controller.plant.time_unit

    def output(name: str, block: str, about: str, unit: str = "", start: float = 0.0) -> Variable:
        return Variable(name, "output", block, (start,), about, unit)

    def flag(name: str, about: str) -> Variable:
        return Variable(name, "output", name.upper(), (0.0,), about, boolean=True)

    for name, value in zip(plant.inputs, controller.u0.tolist(), strict=True):
        yield output(name, "U", "command", units.get(name, ""), value)
    yield output("D_hat", "D_HAT", "estimated delay", time, controller.D_hat)
    for name in plant.states:
        yield output(f"predicted.{name}", "P", "predicted state, when the command acts", units.get(name, ""))
    if isinstance(controller.predictor, Guarded):
        yield flag("fallback", "true if the guard took the numerical predictor's answer")
        yield output("error", "ERROR", "the guard's estimate of the error of the command")
    if controller.actuator != "history":
        return
    yield output("age", "AGE", "age of the last sample that was used; -1 before the first", time, -1.0)
    yield output("late", "LATE", "number of samples that came after a newer one, or were too old")
    yield output("refused", "REFUSED", "number of samples that were too far from the model's value")
    if controller.adaptation:
        yield flag("at_bound", "true if D_hat stands at a bound of its law: the delay may lie outside")
    if controller.observer:
        yield output("renewed", "RENEWED", "how often the observer of the state restarted")
    if controller.parts["observe"]:
        spread = controller.status.D_hat_spread
        about = "half the range of the delays that D_hat may be taken for; at a bound the whole range of the bounds"
        yield output("D_hat_spread", "SPREAD", about, time, spread)
    if controller.watchdog:
        yield flag("handed_over", "true if the watchdog gives the command")
    if controller.safety:
        yield flag("filtered", "true if the safety filter changed U")
        yield flag("unkept", "true if no U within the bounds was found that keeps all limits")
        yield flag("promised", "true if U begins a plan that keeps all limits for good")
        yield output("withdrawn", "WITHDRAWN", "how often a promise ended")
        yield output("kept", "KEPT", "smallest limit h of the predicted states; safe at 0 or above")
    for name in plant.inputs if controller.settings.offsets else ():
        about = "estimate of the constant that is added to the command"
        yield output(f"offset.{name}", "OFFSET", about, units.get(name, ""))


def _parameters(controller: Controller) -> Iterator[Variable]:
    """Numbers that can be set, the plant's parameters as `controller.set` takes them."""
    plant, predictor, law = controller.plant, controller.predictor, controller.adaptation
    if not plant.declares_delay:
        low, high = c_controller.D_hat_bounds(controller)
        about, high = "first estimate of the delay", min(high, LARGEST)
        yield Variable("D_hat0", "fixed", "D_HAT0", (controller.D_hat,), about, plant.time_unit, low=low, high=high)
    first, about = controller.u0.tolist(), "command that the actuator has had before the first control step"
    limits = controller.loop.input_bounds.tolist()
    for name, value, (low, high) in zip(plant.inputs, first, limits, strict=True) if controller.keeps_commands else ():
        low, high = max(low, -LARGEST), min(high, LARGEST)
        unit = plant.units.get(name, "")
        yield Variable(f"u0.{name}", "fixed", "U0", (value,), about, unit, low=low, high=high)
    if law is not None and controller.settings.gamma_dt > 0:
        yield Variable("gamma", "tunable", "GAMMA", (law.gamma,), "gain of the delay law", low=SMALLEST)
    if isinstance(predictor, Guarded):
        about = "largest error of the command that the guard accepts"
        yield Variable("tolerance", "tunable", "TOLERANCE", (predictor.tolerance,), about, low=SMALLEST)
    for name, value in c_controller.settable(controller).items():
        yield Variable(f"parameter.{name}", "tunable", "PARAMETERS", (float(value),), "parameter of plant and law")


def _header(controller: Controller, listed: Sequence[Variable], name: str, token: str) -> str:
    """The text of variables.h, which instance.h and the functions of FMI read."""
    ends = list(accumulate(len(variable.start) for variable in listed))
    firsts = [end - len(variable.start) for end, variable in zip(ends, listed, strict=True)]
    blocks: dict[str, int] = {}
    for first, variable in zip(firsts, listed, strict=True):
        blocks.setdefault(variable.block, first)
    entries = [
        f"    {{{first}, {len(variable.start)}, {variable.role.upper()}, {int(variable.boolean)}, "
        f"{literal(variable.low, 'double')}, {literal(variable.high, 'double')}}},"
        for first, variable in zip(firsts, listed, strict=True)
    ]
    lines = [
        "/* The variables of this FMU. */",
        f'#include "{name}.h"',
        "",
        f'#define TOKEN "{token}"',
        f"#define STEP {controller.dt!r}",
        f"#define TIME_UNIT {json.dumps(controller.plant.time_unit.replace('%', ''))} /* of STEP and all times */",
        f"#define OLDEST {json.dumps(controller.plant.time_text(controller.memory.oldest * controller.dt))}",
        f"#define GUARD_PASSES {PASSES!r}",
        f"#define VARIABLES {len(listed)}",
        f"#define VALUES {ends[-1]}",
        *(f"#define AT_{block} {first}" for block, first in blocks.items()),
        "",
        "static const Variable variables[VARIABLES] = {",
        *entries,
        "};",
        "static const double start_values[VALUES] = {",
        *(f"    {', '.join(literal(value, 'double') for value in variable.start)}," for variable in listed),
        "};",
    ]
    return "\n".join(lines) + "\n"
