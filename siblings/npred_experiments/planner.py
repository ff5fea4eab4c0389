"""Published experiments as nodes: one for each part, keyed by the code of the experiment's own package.

What comes from npred's engine enters by `VERSION`: raise it when that changes a row.
"""

import ast
from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from importlib.util import find_spec, resolve_name
from itertools import accumulate
from pathlib import Path
from typing import Any, Self

from npred.base import registry
from npred.base.errors import ConfigError, unlisted
from npred.base.registry import Source
from npred.lab.report.terminal.console import Console
from npred.lab.scheduler.executors import Workers
from npred.lab.scheduler.plan import Node, Resolver
from npred.lab.store import Store
from npred_experiments import EXPERIMENTS, rows
from npred_experiments.experiment import CORRECTED, NUMERICAL, TIMES, Place, Reproduced, load

STAGE = "reproduce"
VERSION = 3


@dataclass(frozen=True)
class ExperimentPlanner(Resolver):
    """Resolves the parts of one experiment. Nothing of it is imported before it is asked for its `nodes`, or runs."""

    experiment: str
    store: Store
    forced: frozenset[str] = frozenset()
    device: str = "cpu"
    borrows: bool = False

    @property
    def name(self) -> str:
        """The same for all experiments: no pipeline."""
        return STAGE

    def with_absolute_paths(self) -> Self:
        return replace(self, store=Store(self.store.root.absolute()))

    def nodes(self, trained: bool = True) -> list[Node]:
        """A node for each part; the numerical rows only where nothing is to be `trained`."""
        return [self._node(part) for part in (load(self.experiment).parts if trained else [NUMERICAL])]

    def possible(self) -> list[Node]:
        """The nodes of all parts that an experiment may have: nothing of it is imported."""
        return [self._node(part) for part in (NUMERICAL, TIMES, *registry.NETWORKS.names(), *CORRECTED)]

    def check(self, nodes: Iterable[Node]) -> None:
        """Raise ConfigError for a name that there is no experiment of."""
        if self.experiment not in (registered := EXPERIMENTS.names()):
            raise ConfigError(unlisted(STAGE, self.experiment, registered))

    def version(self, node: Node) -> int:
        return VERSION

    def settings(self, node: Node) -> dict[str, Any]:
        """The experiment, the digests of its code, and the part, but for the numerical rows."""
        code = {name: source.sha256 for name, source in self._code.items()}
        part = {} if node.model == self.experiment else {"part": self._part(node)}
        return {"experiment": EXPERIMENTS.identity(self.experiment), "code": code} | part

    def run(
        self, node: Node, folder: Path, inputs: dict[str, Path], scratch: Path, console: Console, jobs: int,
        executor: Workers,
    ) -> Reproduced:  # fmt: skip
        """The part, measured now."""
        return load(self.experiment).measured(self.experiment, self._part(node), Place(folder, scratch, console))

    @cached_property
    def _code(self) -> dict[str, Source]:
        return imported_code(EXPERIMENTS.module(self.experiment))

    def _node(self, part: str) -> Node:
        return Node(STAGE, self.experiment if part == NUMERICAL else f"{self.experiment}_{part}", ())

    def _part(self, node: Node) -> str:
        return (node.model or "").removeprefix(self.experiment).removeprefix("_") or NUMERICAL


def planners(store: Store, name: str = STAGE) -> list[ExperimentPlanner]:
    """That of the experiment with this name, those of all for `reproduce`; none for another name."""
    return [ExperimentPlanner(each, store) for each in EXPERIMENTS.names() if name in (STAGE, each)]


def summary(document: dict[str, object], width: int | None = None) -> str:
    """A result's JSON as a table. Raises StoreError where it is none, ConfigError without its experiment."""
    return rows.summary([Reproduced.of(document, "result")], width)


def imported_code(module: str) -> dict[str, Source]:
    """The module and all that it imports of its top-level package, also inside functions, by name, sorted.

    The files are read, and none is run; a module without a text, as one compiled from C, is left out.
    """
    top = module.partition(".")[0]
    sources, todo = {}, [module]
    while todo:
        name = todo.pop()
        path = None if name in sources else _file(name)
        if path:
            sources[name] = registry.read(name, path)
            package = name if path.name == "__init__.py" else name.rpartition(".")[0]
            imports = [each for each in (name, *_imports(sources[name].text, package)) if each.split(".")[0] == top]
            # to import a.b.c runs a and a.b too
            todo += [above for each in imports for above in accumulate(each.split("."), "{}.{}".format)]
    return dict(sorted(sources.items()))


def _file(module: str) -> Path | None:
    """The text of a module, found without running the packages above it."""
    top, *below = module.split(".")
    try:
        spec = find_spec(top)
    except ValueError:  # a module without a spec, as __main__
        spec = None
    folders = (spec and spec.submodule_search_locations) or []
    files = [Path(folder, *below, "__init__.py") for folder in folders]
    files += [Path(folder, *below).with_suffix(".py") for folder in folders if below]
    files += [Path(spec.origin)] if spec and spec.origin and not folders and not below else []
    return next((path for path in files if path.is_file() and path.suffix == ".py"), None)


@lru_cache(maxsize=64)
def _imports(text: str, package: str) -> list[str]:
    """The names that a text imports in full; of `from a import b` both a and a.b, for b may be a module."""
    try:
        nodes = list(ast.walk(ast.parse(text)))
    except (SyntaxError, ValueError):
        return []
    imported = [alias.name for node in nodes if isinstance(node, ast.Import) for alias in node.names]
    for node in (node for node in nodes if isinstance(node, ast.ImportFrom)):
        source = resolve_name("." * node.level + (node.module or ""), package)
        imported += [source, *(f"{source}.{alias.name}" for alias in node.names)]
    return imported
