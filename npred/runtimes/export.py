"""A controller as files for another program: C99 sources, an FMU, the ONNX graph of its network."""

import copy
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from npred import grid
from npred.errors import ConfigError, imported, unlisted
from npred.loop.controller import Controller
from npred.predictors.guarded import bare
from npred.runtimes import c_controller, fmu

ATOL = 1e-4  # how far an ONNX graph's P and U may be from the network's, in the plant's units
NAME = "npred"  # of the files in a folder


def export(
    controller: Controller, form: str, path: str | Path, platforms: Sequence[str] = (), *, precision: str = "double"
) -> list[Path]:
    """The controller as files for another program: `npred export controller`, `fmu` and `onnx` from Python.

    Returns the files.
    Raises ConfigError for another form, for a part that has no such form and for a file that cannot be written;
    MissingError for a package that is not there; NpredError for a graph that differs from the network.
    """
    forms: dict[str, Callable[[], list[Path]]] = {
        "c": lambda: _c(controller, Path(path), precision),
        "fmu": lambda: _fmu(controller, Path(path), platforms, precision),
        "onnx": lambda: _onnx(controller, Path(path)),
    }
    if not isinstance(controller, Controller):
        raise ConfigError(f"export: expected a controller, got {controller!r}; make one with npred.controller")
    if form not in forms:
        raise ConfigError(unlisted("form", form, forms))
    if platforms and form != "fmu":
        raise ConfigError(f"platforms: expected none for {form}, which fits any machine, got {platforms!r}; drop it")
    try:
        return forms[form]()
    except OSError as error:
        raise ConfigError(f"path: expected a place to write, got '{path}': {error.strerror}; name another") from None


def _c(controller: Controller, path: Path, precision: str) -> list[Path]:
    folder, name = (path.parent, path.stem) if path.suffix == ".c" else (path, NAME)
    return c_controller.write(controller, folder, _identifier(name, path), precision)[0]


def _fmu(controller: Controller, path: Path, platforms: Sequence[str], precision: str) -> list[Path]:
    listed = platforms.split(",") if isinstance(platforms, str) else [*platforms]
    name = path.stem if c_controller.NAME.fullmatch(path.stem) else NAME
    path.parent.mkdir(parents=True, exist_ok=True)
    target = controller.plant.target(0.0)
    fmu.write(controller, path, name=name, precision=precision, X0=target, platforms=listed)
    return [path]


def _onnx(controller: Controller, path: Path) -> list[Path]:
    plant, predictor = controller.plant, bare(controller.predictor)
    operator: Any = getattr(predictor, "operator", None)
    if operator is None or operator.domain is None:
        raise ConfigError(
            f"export onnx: expected a controller with a trained network, got {predictor!r}; npred.load one"
        )
    onnx = imported("export onnx", "npred.runtimes.onnx", "onnx")
    domain = operator.domain  # which has some rows of the data
    samples = domain.X, grid.means(domain.u, predictor.nx), domain.D_hat, np.nan_to_num(domain.t)
    path.parent.mkdir(parents=True, exist_ok=True)
    onnx.export(copy.deepcopy(operator.module(plant)).float(), plant, path, predictor.nx, samples, ATOL)
    return [path]


def _identifier(name: str, path: Path) -> str:
    """The name. Raises ConfigError for one that C or a file cannot have."""
    if not c_controller.NAME.fullmatch(name):
        raise ConfigError(f"path: expected a file named by a C identifier in lower case, as tank.c, got {str(path)!r}")
    return name
