"""One export: a controller, or its network alone, as files for another program, on the command line and from Python.

A new format is a file in npred/exports with a function (of, path, *, its options) -> Exported, and its entry in
FORMATS. From there come the command `npred export FORMAT` with its flags, and the keywords that `export` takes.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, TypedDict, Unpack

from npred.base.errors import ConfigError, similar, unlisted
from npred.base.registry import attribute

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import ArrayLike

    from npred.loop.controller import Controller
    from npred.networks.weights import TrainedOperator
    from npred.plants import Plant


Form = Literal["controller", "fmu", "c", "onnx"]


class FormatOptions(TypedDict, total=False):
    """The options of all formats; each takes those of FORMATS."""

    precision: Literal["double", "float"]
    name: str
    fmi: Literal[3, 2]
    platforms: str | Sequence[str]
    atol: float


class Option(NamedTuple):
    """An option of a format: its default, which gives its type, its help, and the word for its value there."""

    default: str | int | float | tuple[str, ...]
    help: str
    word: str | None = None


class Format(NamedTuple):
    """A format: the module:function that writes it, its help, its options, and the suffix of its file, "" for a folder.

    `network`: it holds a trained network alone, else the whole controller. `extra` is that of npred which it needs.
    """

    target: str
    help: str
    options: Mapping[str, Option]
    suffix: str
    network: bool = False
    extra: str = ""


COMMON = {
    "precision": Option("double", "Type of the numbers.", "double|float"),
    "name": Option("npred", "Files and C names begin with this."),
}
FORMATS = {
    "controller": Format(
        "npred.exports.c_controller:export", "Write the whole controller as C99 files that test themselves.", COMMON, ""
    ),
    "fmu": Format(
        "npred.exports.fmu:export",
        "Write the whole controller as a Functional Mock-up Unit for co-simulation.",
        COMMON
        | {
            "fmi": Option(3, "Version of FMI.", "3|2"),
            "platforms": Option(
                (), "Machines to build for, as linux64,win64,darwin64 (needs ziglang); by default this one.", "NAME,…"
            ),
        },
        ".fmu",
    ),
    "c": Format(
        "npred.exports.c_network:export",
        "Write a trained network, P and U = kappa(P(1)), as a C99 file.",
        {},
        ".c",
        True,
    ),
    "onnx": Format(
        "npred.exports.onnx:export",
        "Write a trained network, P and U = kappa(P(1)), as an ONNX graph.",
        {"atol": Option(1e-4, "How far P and U may differ from the network's.")},
        ".onnx",
        network=True,
        extra="onnx",
    ),
}
KINDS = {str: str, int: int, float: int | float, tuple: str | list | tuple}  # what is taken, by the default's type


class Exported(NamedTuple):
    """The files of an export, and the words about them: in a JSON document, and to people."""

    files: list[Path]
    facts: dict[str, object]
    text: str


@dataclass(frozen=True)
class WholeController:
    """A controller to export, its name in words, and for an FMU the first state and the length, else 40 delays."""

    controller: "Controller"
    about: str = ""
    X0: "ArrayLike | None" = None
    t_end: float | None = None

    @property
    def facts(self) -> dict[str, object]:
        """The facts of the controller in a JSON document."""
        controller, predictor = self.controller, self.controller.predictor
        return {
            "plant": controller.plant.name,
            "predictor": predictor.name,
            "nx": predictor.nx,
            "actuator": controller.actuator,
            "guarded": predictor.guard is not None,
        }


@dataclass(frozen=True)
class NetworkAlone:
    """A trained network to export, the number of its nodes, and samples (X, u, D_hat, t) that its file is tested on."""

    operator: "TrainedOperator"
    plant: "Plant"
    nx: int
    samples: tuple["np.ndarray", "np.ndarray", "np.ndarray", "np.ndarray"]
    name: str = "network"

    @property
    def facts(self) -> dict[str, object]:
        """The facts of the network in a JSON document."""
        return {"model": self.name, "nx": self.nx}

    def exported(self, path: Path, errors: tuple[float, float] | None) -> Exported:
        """The words about a file whose P and U differ so much from those expected; None where it could not be run."""
        line, count = f"P and U of {self.name} on {self.nx} nodes", len(self.samples[0])
        if errors is None:
            return Exported([path], {}, f"{line}; not compared, for there is no C compiler here")
        error, eps = errors  # on some samples, and on other nodes than evaluate's: not its ε sup
        text = f"{line}; on {count} held-out samples within {error:.2g} of the model, whose error there is {eps:.2g}"
        return Exported([path], {"error": error, "eps": eps, "samples": count}, text)


def writer(form: str, options: Mapping[str, Any]) -> Callable[[Any, Path], Exported]:
    """A function that writes a WholeController or a NetworkAlone to a path in a format, with these of its options.

    Raises ConfigError for an option that the format has not, MissingError for a package that is not there; the function
    raises ConfigError for a part that has no such form and for a place where nothing can be written.
    """
    declared = FORMATS[form]
    for name, value in options.items():
        if name not in declared.options:
            takes = f"an option of {form} ({', '.join(declared.options) or 'it has none'})"
            near = similar(name, declared.options) or "; drop it"
            raise ConfigError(f"{name}: expected {takes}, got {name} = {value!r}{near}")
        default = declared.options[name].default
        if not isinstance(value, KINDS[type(default)]):
            raise ConfigError(f"{name}: expected a value as {default!r}, got {value!r}; give one")
    values = {name: option.default for name, option in declared.options.items()} | dict(options)
    function = attribute(declared.target, f"export {form}", declared.extra)

    def write(of: WholeController | NetworkAlone, path: Path) -> Exported:
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            return function(of, path, **values)
        except OSError as error:
            came = f"got '{path}': {error.strerror}"
            raise ConfigError(f"path: expected a place to write, {came}; name another") from None

    return write


def export(controller: "Controller", form: Form, path: str | Path, **options: Unpack[FormatOptions]) -> list[Path]:
    """The controller, or its network alone, as files for another program: `npred export` from Python.

    Parameters
    ----------
    controller : Controller
        From npred.controller.
    form : "controller", "fmu", "c" or "onnx"
        C99 with a test inside, a Functional Mock-up Unit, or the network alone, P and U, as C99 or as an ONNX
        graph.
    path : str or Path
        A file, as "tank.fmu", for "controller" a folder.
    **options
        The flags of `npred export FORM`, as precision="float", name="tank" or platforms=["win64"].

    Returns
    -------
    list[pathlib.Path]
        The files.

    Raises
    ------
    ConfigError
        For another form or option, for a part that has no such form and for a file that cannot be written.
    MissingError
        For a package that is not there.
    NpredError
        For a file that differs from the network.
    """
    import numpy as np

    from npred.base import grid
    from npred.guard.guarded import bare
    from npred.loop.controller import Controller

    if not isinstance(controller, Controller):
        raise ConfigError(f"export: expected a controller, got {controller!r}; make one with npred.controller")
    if form not in FORMATS:
        raise ConfigError(unlisted("form", form, FORMATS))
    write = writer(form, options)
    of: WholeController | NetworkAlone = WholeController(controller, X0=controller.plant.target(0.0))
    if FORMATS[form].network:
        predictor = bare(controller.predictor)
        operator: Any = getattr(predictor, "operator", None)
        if operator is None or operator.domain is None:
            what = f"expected a controller with a trained network, got {predictor!r}"
            raise ConfigError(f"export {form}: {what}; npred.load one")
        domain = operator.domain  # which has some rows of the data
        samples = domain.X, grid.means(domain.u, predictor.nx), domain.D_hat, np.nan_to_num(domain.t)
        of = NetworkAlone(operator, controller.plant, predictor.nx, samples, predictor.name)
    return write(of, Path(path)).files
