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
import zipfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from npred.errors import ConfigError
from npred.loop.controller import Controller
from npred.runtimes import c_controller, c_files
from npred.runtimes.fmu import description, variables
from npred.runtimes.fmu.description import Model
from npred.runtimes.fmu.variables import Variable

VERSIONS = (3, 2)
HIDDEN = "-fvisibility=hidden"  # but what FMI names
SUFFIXES = {"linux": ".so", "darwin": ".dylib", "windows": ".dll"}
MACHINES = {"amd64": "x86_64", "arm64": "aarch64"}
FOLDERS_OF_2 = {("linux", "x86_64"): "linux64", ("darwin", "x86_64"): "darwin64", ("windows", "x86_64"): "win64"}


class Written(NamedTuple):
    """What an FMU holds: where its library lies, None where it has none, its token, and its variables."""

    library: str | None
    token: str
    variables: list[Variable]


def write(
    controller: Controller, path: Path, *, version: int = 3, name: str = "npred", precision: str = "double",
    model: str = "", X0: ArrayLike | None = None, t_end: float = 1.0, test: c_controller.Test | None = None,
) -> Written:  # fmt: skip
    """Write the FMU of a controller. `X0` (n,) are the first values of the inputs X, `t_end` the experiment's seconds.

    Without a C compiler it holds its sources alone. Raises ConfigError for another version of FMI, for names of
    variables that are not different, and as npred.runtimes.c_controller.sources does.
    """
    if version not in VERSIONS:
        raise ConfigError(f"--fmi: expected 3 or 2, got {version}; name one of them")
    X0 = np.zeros(controller.plant.n) if X0 is None else np.asarray(X0, dtype=float)
    listed = variables.of(controller, X0, arrays=version == 3)
    header, source = c_controller.sources(controller, name, precision, model, test, tunable=True)
    texts = {f"{name}.h": header, f"{name}.c": source}
    texts |= {file: c_files.filled(file, name, precision) for file in ("instance.h", "calls.h", f"fmi{version}.c")}
    sources = (f"{name}.c", f"fmi{version}.c")
    about = f"Predictor feedback: {model or controller.predictor.name}"
    described = Model(controller.plant.name, name, "", about, controller.dt, t_end, sources)
    token = _token(texts, description.describe(version, described, listed))
    described = described._replace(token=token)
    texts["variables.h"] = variables.header(controller, listed, name, token)
    place = _place(version, name) if c_files.compiler() else None
    files: dict[str, str | bytes] = {"modelDescription.xml": description.describe(version, described, listed)}
    files |= {place: _compiled(texts, sources)} if place else {}
    files |= {f"sources/{file}": text for file, text in texts.items()}
    files |= {"sources/buildDescription.xml": description.build(described)} if version == 3 else {}
    _archive(path, files)
    return Written(place, token, listed)


def _token(texts: Mapping[str, str], undated: str) -> str:
    """What identifies the FMU: a hash of all that it is made of, in the form of a GUID."""
    digest = hashlib.sha256("\0".join([*texts.values(), undated]).encode()).hexdigest()
    return "{" + "-".join(digest[i:j] for i, j in ((0, 8), (8, 12), (12, 16), (16, 20), (20, 32))) + "}"


def _place(version: int, identifier: str) -> str | None:
    """Where the library of this machine lies in the archive; None where FMI has no name for the machine."""
    system, machine = platform.system().lower(), platform.machine().lower()
    machine = MACHINES.get(machine, machine)
    folder = f"{machine}-{system}" if version == 3 else FOLDERS_OF_2.get((system, machine))
    return f"binaries/{folder}/{identifier}{SUFFIXES[system]}" if folder and system in SUFFIXES else None


def _compiled(texts: Mapping[str, str], sources: Sequence[str]) -> bytes:
    """The shared library of the sources. Raises NpredError, in one line, where they do not compile."""
    with tempfile.TemporaryDirectory() as folder:
        for name, text in texts.items():
            (Path(folder) / name).write_text(text, encoding="utf-8")
        c_files.build([Path(folder) / name for name in sources], Path(folder) / "library", "fmu", HIDDEN)
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
