"""A controller as a Functional Mock-up Unit for co-simulation, FMI 3.0 or 2.0 [fmi-standard.org], around its C.

An FMU is a zip archive: a description of its variables, a shared library for this machine, and the sources of both. Its
control steps are due at start + k dt; one is done within each communication step [t, t + h) that holds its time, with
the inputs as they stand, and the outputs are those of the last one.
"""

import hashlib
from collections.abc import Mapping
from importlib import resources
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from npred.errors import ConfigError
from npred.loop.controller import Controller
from npred.runtimes import c_controller, c_library
from npred.runtimes.fmu import archive, description, variables
from npred.runtimes.fmu.description import Model
from npred.runtimes.fmu.variables import Variable

VERSIONS = (3, 2)


class Written(NamedTuple):
    """What an FMU holds: where its library lies, None where it has none, its token, and its variables."""

    library: str | None
    token: str
    variables: list[Variable]


def write(
    controller: Controller, path: Path, *, version: int = 3, name: str = "npred", precision: str = "double",
    model: str = "", X0: Any = None, t_end: float = 1.0, test: Any = None,
) -> Written:  # fmt: skip
    """Write the FMU of a controller. `X0` (n,) are the first values of the inputs X, `t_end` the experiment's seconds.

    Without a C compiler it holds its sources alone. Raises ConfigError for another version of FMI, for names of
    variables that are not different, and as npred.runtimes.c_controller.sources does.
    """
    if version not in VERSIONS:
        raise ConfigError(f"--fmi: expected 3 or 2, got {version}; name one of them")
    X0 = np.zeros(controller.plant.n) if X0 is None else np.asarray(X0, dtype=float)
    listed = variables.of(controller, X0, arrays=version == 3)
    settings = variables.settings(controller)
    texts = dict(
        zip(
            (f"{name}.h", f"{name}.c"),
            c_controller.sources(controller, name, precision, model, test, settings),
            strict=True,
        )
    )
    texts |= {file: _template(file) for file in ("instance.h", f"fmi{version}.c")}
    sources = (f"{name}.c", f"fmi{version}.c")
    about = f"Predictor feedback: {model or controller.predictor.name}"
    described = Model(controller.plant.name, name, "", about, controller.dt, t_end, sources)
    token = _token(texts, description.describe(version, described, listed))
    described = described._replace(token=token)
    texts["variables.h"] = variables.header(controller, listed, name, precision, token)
    library = _library(version, name, texts, sources)
    files: dict[str, str | bytes] = {"modelDescription.xml": description.describe(version, described, listed)}
    files |= library
    files |= {f"sources/{file}": text for file, text in texts.items()}
    if version == 3:
        files["sources/buildDescription.xml"] = description.build(described)
    archive.write(path, files)
    return Written(next(iter(library), None), token, listed)


def _template(name: str) -> str:
    """A C file of this folder, the same in all FMUs."""
    return resources.files(__name__).joinpath(name).read_text(encoding="utf-8")


def _token(texts: Mapping[str, str], undated: str) -> str:
    """What identifies the FMU: a hash of all that it is made of, in the form of a GUID."""
    digest = hashlib.sha256("\0".join([*texts.values(), undated]).encode()).hexdigest()
    return "{" + "-".join(digest[i:j] for i, j in ((0, 8), (8, 12), (12, 16), (16, 20), (20, 32))) + "}"


def _library(version: int, name: str, texts: Mapping[str, str], sources: tuple[str, ...]) -> dict[str, bytes]:
    """The library of this machine by its place; nothing where there is no compiler, or FMI knows no such machine."""
    place = archive.place(version, name)
    return {place: archive.compiled(texts, sources)} if place and c_library.compiler() else {}
