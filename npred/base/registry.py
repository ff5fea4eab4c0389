"""Named parts: built in, of an installed package (an entry point), or a class of a user's file, as my_plant.py:Tank.

The tables below name what is built in: a new network, method, law or runtime is one file and a line here. Nothing is
imported before it is asked for. A user's file is code: it is run when somebody names it.
"""

import ast
import hashlib
import importlib
import inspect
import sys
from collections.abc import Collection, Mapping
from functools import cache, lru_cache
from keyword import iskeyword
from pathlib import Path
from typing import Any, Literal, NamedTuple

from npred.base import json_files
from npred.base.errors import ConfigError, imported, similar

SUFFIX = ".py:"


class Entry(NamedTuple):
    """A built-in part: its module:Class, its label for people, and its line in figures.

    `look` is the role of the colour (of a runtime: its network's), the dash and the marker.
    `fused` is the module of a network's fused form, where there is one: it says what its file of weights holds, and
    makes a program of it. `extra` is that of npred with all that the part needs, where it is not torch's.
    """

    target: str
    label: str
    look: tuple[str, tuple[float, ...], str] = ("green", (1, 1), "D")
    fused: str = ""
    extra: str = ""


class Source(NamedTuple):
    """A file of code: its name without folders, its text, and the sha256 of its meaning."""

    file: str
    text: str
    sha256: str


class Registry:
    """The parts of one kind by name; `group` is that of the entry points of other packages."""

    def __init__(self, kind: str, group: str, builtin: Mapping[str, Entry] = {}) -> None:
        self.kind, self.group, self.builtin = kind, group, dict(builtin)

    def names(self) -> list[str]:
        """The built-in names, then those of installed packages, sorted; nothing of these is imported."""
        return [*self.builtin, *sorted(self._installed().keys() - self.builtin.keys())]

    def label(self, name: str) -> str:
        """The label of a part: its name where it is not built in."""
        return self.builtin[name].label if name in self.builtin else name

    def look(self, name: str) -> tuple[str, tuple[float, ...], str]:
        """Its line in figures: the same for all that are not built in."""
        return self.builtin[name].look if name in self.builtin else Entry("", "").look

    def fault(self, name: str, *others: str) -> str | None:
        """The fault of a name, in words; None for a part, for a class of a file, and for one of `others`."""
        if name in (*self.builtin, *others) or in_file(name) or name in self._installed():
            return None
        names = [*self.names(), *others]
        near = similar(name, names) or "; choose one"
        named_ones = f"{', '.join(names)}, or " if names else ""
        return f"expected {named_ones}a class of a file as my_file.py:Name, got {name!r}{near}"

    def identity(self, name: str) -> Any:
        """The part in a key: a built-in name, the digest of its file, or the package with version and target."""
        if in_file(name):
            path, attribute = split(name)
            return {"name": attribute, "source": read(self.kind, path).sha256}
        entry = None if name in self.builtin else self._installed().get(name)
        if entry is None:
            return name
        foreign = entry.dist and not self.is_npreds(name)  # parts of npred are keyed by their code
        package = {"package": entry.dist.name, "version": entry.dist.version} if foreign else {}
        return {"name": name, "target": entry.value} | package

    def is_npreds(self, name: str) -> bool:
        """True for a part that comes with npred, also where another of its packages registers it."""
        entry = self._installed().get(name)
        return name in self.builtin or bool(entry and entry.dist and entry.dist.name == "npred")

    def load(self, what: str, name: str) -> Any:
        """The part of that name, imported now. Raises ConfigError, after `what` (a key, say), where there is none."""
        if fault := self.fault(name):
            raise ConfigError(f"{what}: {fault}")
        if in_file(name):
            return load(what, name)[0]
        if name in self.builtin:
            return attribute(self.builtin[name].target, f"{what} {name}", self.builtin[name].extra)
        return self.installed(name)

    def subclass(self, what: str, name: str, base: type) -> Any:
        """The part of that name, a class derived from `base`. Raises ConfigError, in one line, for any other."""
        kind = self.load(what, name)
        if not (isinstance(kind, type) and issubclass(kind, base)):
            raise ConfigError(f"{what} {name}: expected a subclass of npred.{base.__name__}; derive it from that")
        if missing := sorted(getattr(kind, "__abstractmethods__", ())):
            raise ConfigError(f"{what} {name}: expected a class with {', '.join(missing)}, got none; define it")
        return kind

    def check_keywords(self, what: str, name: str, keywords: Collection[str]) -> None:
        """Raise ConfigError unless a part takes these keyword-only arguments, by the text of its file: none is run.

        What its class inherits is not seen, and not checked; nor is a part of a package.
        """
        if not in_file(name) and name not in self.builtin:
            return
        if in_file(name):
            path, attribute = split(name)
        else:
            module, _, attribute = self.builtin[name].target.partition(":")
            path = Path(__file__).parents[2].joinpath(*module.split(".")).with_suffix(".py")
        source = read(self.kind, path)
        if attribute not in source.text:
            raise ConfigError(f"{what}: expected a class {attribute} in {path}, found none; check the name")
        tree = _compiled(self.kind, path, source.text, ast.PyCF_ONLY_AST)
        bodies = [node.body for node in tree.body if isinstance(node, ast.ClassDef) and node.name == attribute]
        methods = [node for body in bodies for node in body if isinstance(node, ast.FunctionDef)]
        arguments = next((node.args for node in methods if node.name == "__init__"), None)
        if arguments is None or arguments.kwarg:
            return
        takes = {argument.arg: True for argument in arguments.args[4:]}  # after self, n, m and clock
        pairs = zip(arguments.kwonlyargs, arguments.kw_defaults, strict=True)
        takes |= {argument.arg: default is not None for argument, default in pairs}
        faults = [f"got {key}{similar(key, takes) or '; drop it'}" for key in keywords if key not in takes]
        faults += [f"no {key}; give it a value" for key, free in takes.items() if not free and key not in keywords]
        if faults:
            expected = f"keyword arguments of {attribute} ({', '.join(takes) or 'none'})"
            raise ConfigError(f"{what}: expected {expected}, {faults[0]}")

    def installed(self, name: str) -> Any:
        """The part that an installed package registers, or None. Raises ConfigError, with its name, if it fails."""
        entry = self._installed().get(name)
        if entry is None:
            return None
        try:
            return entry.load()
        except (Exception, SystemExit) as error:
            from npred.base import source_lines

            package = entry.dist.name if entry.dist else "a package"
            reason = source_lines.one_line(error)
            raise ConfigError(
                f"{self.kind} {name}: {package} failed on import of {entry.value}: {reason}; install another version"
            ) from None

    def module(self, name: str) -> str:
        """The module that an installed package registers a part of."""
        return self._installed()[name].module

    def _installed(self) -> dict[str, Any]:
        return _entry_points(self.group, tuple(sys.path))


@cache
def _entry_points(group: str, path: tuple[str, ...]) -> dict[str, Any]:
    """By name; to read those of a large installation takes tens of milliseconds."""
    from importlib.metadata import entry_points

    return {entry.name: entry for entry in entry_points(group=group)}


NETWORKS = Registry(
    "network",
    "npred.networks",
    {
        "deeponet": Entry(
            "npred.lab.training.operators.deeponet:DeepONetwork", "DeepONet", fused="npred.networks.deeponet"
        ),
        "fno": Entry("npred.lab.training.operators.fno:FNOnetwork", "FNO", fused="npred.networks.fno"),
    },
)
Method = Literal["euler", "heun", "rk4", "rosenbrock", "semi_implicit", "picard", "rollout"]  # the names that follow
METHODS = Registry(
    "predictor",
    "npred.predictors",
    {
        "euler": Entry("npred.prediction.methods.runge_kutta:Euler", "Euler", ("green", (), "^")),
        "heun": Entry("npred.prediction.methods.runge_kutta:Heun", "Heun", ("green", (4, 1.6), "v")),
        "rk4": Entry("npred.prediction.methods.runge_kutta:RK4", "RK4", ("ink", (), "o")),
        "rosenbrock": Entry("npred.prediction.methods.rosenbrock:Rosenbrock", "Rosenbrock", ("ink", (4, 1.6), "s")),
        "semi_implicit": Entry(
            "npred.prediction.methods.semi_implicit:SemiImplicit", "semi-implicit", ("green", (), "D")
        ),
        "picard": Entry("npred.prediction.methods.picard:Picard", "Picard", ("muted", (4, 1.6), "v")),
        "rollout": Entry("npred.prediction.methods.rollout:Rollout", "rollout", ("ink", (1, 1.5), "P")),
    },
)
LAWS = Registry(  # kappa, designed from f, or learned
    "kappa",
    "npred.laws",
    {
        "lqr": Entry("npred.laws.regulator:lqr", "LQR"),
        "pole_placement": Entry("npred.laws.linearisation:pole_placement", "pole placement"),
        "feedback_linearisation": Entry("npred.laws.linearisation:feedback_linearisation", "feedback linearisation"),
        "sontag": Entry("npred.laws.universal:sontag", "Sontag's formula"),
        "policy": Entry("npred.laws.policy:law", "policy", extra="onnx"),
    },
)
PAPER, OBSERVER, FROZEN = "bresch-pietri-krstic", "delay-observer", "frozen"  # laws for the estimate of the delay
WITHOUT_V = (FROZEN, "l1", OBSERVER)  # laws that need no V
Adaptation = Literal["bresch-pietri-krstic", "l1", "delay-observer", "frozen"]  # the names that follow, and no law
DELAY_LAWS = Registry(
    "adaptation",
    "npred.delay_laws",
    {
        "bresch-pietri-krstic": Entry("npred.estimation.adaptation:DelayAdaptation", "Bresch-Pietri and Krstic"),
        "l1": Entry("npred.estimation.l1_adaptation:L1Adaptation", "L1"),
        "delay-observer": Entry("npred.estimation.delay_observer:DelayObserver", "delay observer"),
    },
)
OBSERVERS = Registry(
    "observer",
    "npred.observers",
    {
        "ekf": Entry("npred.estimation.observers.ekf:EKF", "extended Kalman filter"),
        "luenberger": Entry("npred.estimation.observers.luenberger:Luenberger", "Luenberger observer"),
    },
)
RUNTIMES = Registry(
    "runtime",
    "npred.runtimes",
    {
        "torch": Entry("npred.lab.training.neural:Neural", "torch", ("", (1, 1.5), "*")),
        "fused": Entry("npred.networks.fused:Fused", "fused", ("", (), "s")),
        "onnx": Entry("npred.exports.onnx:Onnx", "ONNX Runtime", ("", (4, 1.6), "D"), extra="onnx"),
    },
)
RECORDINGS = Registry(  # by the suffix of a file
    "recording",
    "npred.recordings",
    {
        **{
            suffix: Entry("npred.identification.recordings.text:Text", "table of text", extra="identify")
            for suffix in ("csv", "txt", "tsv", "dat", "asc", "log", "lvm", "trace")
        },
        **{
            suffix: Entry("npred.identification.recordings.frames:Workbook", "workbook", extra="identify")
            for suffix in ("xlsx", "xlsm", "xlsb", "xls", "ods")
        },
        "parquet": Entry("npred.identification.recordings.frames:Parquet", "Parquet", extra="identify"),
        **{
            suffix: Entry("npred.identification.recordings.arrays:Hdf5", "HDF5", extra="identify")
            for suffix in ("h5", "hdf5", "hdf")
        },
        "npz": Entry("npred.identification.recordings.arrays:Npz", ".npz", extra="identify"),
        "mat": Entry("npred.identification.recordings.arrays:Mat", ".mat", extra="identify"),
        **{
            suffix: Entry("npred.identification.recordings.arrays:Json", "JSON", extra="identify")
            for suffix in ("json", "jsonl", "ndjson")
        },
        "mcap": Entry("npred.identification.recordings.mcap:Mcap", "MCAP"),
        "bag": Entry("npred.identification.recordings.rosbag:Rosbag", "ROS 1 bag"),
        "db3": Entry("npred.identification.recordings.rosbag:Rosbag", "ROS 2 bag"),
        "ulg": Entry("npred.identification.recordings.ulog:Ulog", "ULog"),
    },
)
BASELINES = Registry("baseline", "npred.baselines")  # predictors to compare with: none is built in
# Modules that bring results of other things than pipelines, by their stage: planners(store, name) gives an
# npred.lab.scheduler.plan.Resolver for each thing of that name, of the stage for all, and summary(document, width)
# words
RESOLVERS = Registry("resolver", "npred.resolvers")
# Modules that say more of a network's error: check(plant), which raises where certify cannot, and certify(job, guards,
# exact, fresh), fields of the certificate of each network
CERTIFICATES = Registry("certificate", "npred.certificates")
COMMANDS = Registry("command", "npred.commands")  # functions as the commands in npred.cli: none is built in
PLANTS = Registry("plant", "npred.plants")  # the built-in ones are the files of npred/plants/builtin


# folders of npred/lab/stages, in order
STAGES = ("identify", "generate", "train", "evaluate", "certify", "bench", "report")


def declared_stage(name: str) -> Any:
    """The declaration of a stage: an npred.lab.scheduler.declaration.Stage."""
    return importlib.import_module(f"npred.lab.stages.{name}").STAGE


def is_policy(spec: object) -> bool:
    """True if a text names a file of a learned policy."""
    return isinstance(spec, str) and spec.endswith(".onnx")


def in_file(spec: str) -> bool:
    """True if the text names a class of a file."""
    return SUFFIX in spec


def attribute(target: str, what: str = "", extra: str = "") -> Any:
    """The object at module:Name, imported now. Raises MissingError, after `what` needs it, without its package."""
    module, _, name = target.partition(":")
    return getattr(imported(what or name, module, extra), name)


def short_name(spec: str) -> str:
    """The name of a part in results: a registered name, or the class of a file."""
    return split(spec)[1] if in_file(spec) else spec


def split(spec: str) -> tuple[Path, str]:
    """File and class of my_plant.py:Tank. Raises ConfigError for a class that no Python file could have."""
    path, _, name = spec.partition(SUFFIX)
    if not name.isidentifier() or iskeyword(name):
        raise ConfigError(f"{spec}: expected the name of a class after the colon, got {name!r}; write my_plant.py:Tank")
    return Path(path + ".py"), name


def read(what: str, path: Path) -> Source:
    """The file as it is now. Raises ConfigError where it cannot be read, or is none: a pipe, a device."""
    try:
        return _source(path, json_files.regular(path).read_bytes())
    except OSError as error:
        raise ConfigError(f"{what}: expected a file at {path}, got: {error.strerror}; check the path") from None


def declaring(declaration: Any) -> Source | None:
    """The file of the module that a class comes from; None where there is none, as at a prompt."""
    try:
        path = Path(inspect.getfile(declaration))
        return _source(path, path.read_bytes())
    except (TypeError, OSError):
        return None


def _compiled(what: str, path: Path, content: str | bytes, flags: int = 0) -> Any:
    try:
        return compile(content, str(path), "exec", flags)
    except (SyntaxError, ValueError) as error:
        line, reason = getattr(error, "lineno", None), getattr(error, "msg", error)
        raise ConfigError(
            f"{what} {path}{f':{line}' if line else ''}: expected Python, got a syntax error: {reason}; edit that line"
        ) from None


def _source(path: Path, content: bytes) -> Source:
    return Source(path.name, content.decode(errors="replace"), hashlib.sha256(meaning(content)).hexdigest())


@lru_cache(maxsize=64)
def meaning(content: bytes) -> bytes:
    """The syntax tree of Python's text, the same for every version of Python; of no Python the content itself.

    Comments, docstrings and layout are not in it: results are keyed by it, so that they make none again.
    """
    try:
        return ascii(_branch(ast.parse(content))).encode()
    except (SyntaxError, ValueError, RecursionError, MemoryError):
        return content


def _branch(node: Any) -> Any:
    """A node as its name and fields; newer versions have more fields, which are empty where they mean nothing."""
    if isinstance(node, list):  # statements that are but a constant, as docstrings, do nothing
        return [_branch(n) for n in node if not (isinstance(n, ast.Expr) and isinstance(n.value, ast.Constant))]
    if not isinstance(node, ast.AST):
        return node
    fields = {name: _branch(value) for name, value in ast.iter_fields(node) if value not in (None, [])}
    return type(node).__name__, fields


def load(what: str, spec: str) -> tuple[Any, Source]:
    """Run the file: the class, and the text. Raises ConfigError, in one line, without either or where it fails."""
    path, name = split(spec)
    if not path.is_file():  # a pipe or a device would be read without an end
        cure = "check the path, which a pipeline gives from its folder and the command line from yours"
        raise ConfigError(f"{what} {spec}: expected a Python file, found none at {path}; {cure}")
    content = path.read_bytes()
    space: dict[str, Any] = {"__name__": path.stem, "__file__": str(path)}
    code = _compiled(what, path, content)
    try:
        exec(code, space)
    except (Exception, SystemExit) as error:
        from npred.base import source_lines

        line = source_lines.last_line(error, str(path))
        cure = f"python {path} shows more"
        raise ConfigError(f"{what} {path}{line}: failed on import: {source_lines.one_line(error)}; {cure}") from None
    if not isinstance(space.get(name), type):
        classes = [key for key, value in space.items() if isinstance(value, type) and value.__module__ == path.stem]
        raise ConfigError(
            f"{what} {path}: expected a class {name}, found {', '.join(classes) or 'none'}"
            f"{similar(name, classes) or '; name one that it has'}"
        )
    return space[name], _source(path, content)
