"""The declaration of a stage. A stage is a module or a folder here, and its name a line in npred.base.registry."""

import sys
from dataclasses import dataclass
from types import ModuleType
from typing import TYPE_CHECKING, Any

from npred.base import registry
from npred.base.errors import imported

if TYPE_CHECKING:  # pydantic comes with these, which `npred --help` has no use for
    from npred.lab.config import Section
    from npred.lab.config.results import Result
    from npred.lab.scheduler.configuration import Slices
    from npred.lab.scheduler.job import Job
else:
    Slices = Any


@dataclass(frozen=True)
class Stage:
    """A stage; its `version` is raised when its results change for the same configuration.

    Its name is that of its module, and its line in the help of commands is the docstring. The module has the function
    key(slices), the slice of the configuration that its key holds beside plant and seed. It also has these functions,
    or NAME.py in its folder has them, which is imported when they are asked for, since it may bring torch:

    - run(job), which gives an object of the class at `result_class`;
    - summary(result, width), and, where there is more to say, details(result, width).

    An optional stage has a table of the class at `table_class`, and is a part of a run where the pipeline file has that
    table. The tables of the others, which more than one stage reads, are in npred.lab.config. A stage with an artifact
    `per_network` is called by the network's name. `needs` is the package of an extra without which it cannot run.
    """

    package: str
    version: int
    upstream: tuple[str, ...]
    result_class: str
    table_class: str = ""
    per_network: bool = False
    needs: str = ""

    @property
    def name(self) -> str:
        return self.package.rpartition(".")[2]

    @property
    def help(self) -> str:
        """Its results, in a line."""
        return sys.modules[self.package].__doc__ or ""

    @property
    def optional(self) -> bool:
        """True if the stage is a part of a run only where the pipeline has its table."""
        return bool(self.table_class)

    @property
    def result(self) -> "type[Result]":
        return registry.attribute(self.result_class)

    @property
    def table(self) -> "type[Section]":
        """The model of its table, of an optional stage."""
        return registry.attribute(self.table_class)

    def key(self, slices: Slices) -> dict[str, Any]:
        """The slice of the configuration that its key holds, plant and seed aside."""
        return self._home("key").key(slices)

    def run(self, job: "Job") -> "Result":
        """The stage's result; its other files are in the job's folder."""
        return self._home("run").run(job)

    def summary(self, document: dict[str, Any], width: int | None = None, wide: bool = False) -> str:
        """A result's JSON in a few lines for people, its tables folded to `width` columns; `wide`: all that is in it.

        Raises StoreError where it is no result of this stage.
        """
        home, result = self._home("summary"), self.result.of(document, "result")
        return (getattr(home, "details", home.summary) if wide else home.summary)(result, width)

    def _home(self, function: str) -> ModuleType:
        """The module that has a function of the stage: its own, else NAME.py in its folder."""
        module = sys.modules[self.package]
        return module if hasattr(module, function) else imported(self.name, f"{self.package}.{self.name}")
