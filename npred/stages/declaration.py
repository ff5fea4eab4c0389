"""What a stage declares of itself. A stage is a folder here, and its name a line in npred.registry."""

import sys
from dataclasses import dataclass
from types import ModuleType
from typing import TYPE_CHECKING, Any

from npred import registry
from npred.errors import imported

if TYPE_CHECKING:  # pydantic comes with these, which `npred --help` has no use for
    from npred.config import Pipeline, Section
    from npred.results import Result
    from npred.stages.job import Job


@dataclass(frozen=True)
class Stage:
    """A stage; its `version` is raised when its results change for the same configuration.

    Its name is that of its folder, and its line in the help of commands is the docstring of the folder's __init__.py,
    which declares it. Beside it the folder has these modules, which are imported when they are asked for, since they
    may bring torch:

    - NAME.py: run(job), which gives an object of the class at `result`; summary(result, width), and, where there is
      more to say, details(result, width), unless `summary_module` has them;
    - key.py: configuration(config, model, device), the slice of the configuration that its key holds beside plant and
      seed;
    - table.py, of an optional stage: its table, of the class `table_class`.

    An optional stage is a part of a run where the pipeline file has its table. The tables of the others, which more
    than one stage reads, are in npred.config. A stage with an artifact `per_network` is called by the network's name.
    `needs` is the package of an extra without which it cannot run.
    """

    package: str
    version: int
    upstream: tuple[str, ...]
    result_class: str
    table_class: str = ""
    per_network: bool = False
    needs: str = ""
    summary_module: str = ""

    @property
    def name(self) -> str:
        """The name of its folder."""
        return self.package.rpartition(".")[2]

    @property
    def help(self) -> str:
        """What it makes, in a line."""
        return sys.modules[self.package].__doc__ or ""

    @property
    def optional(self) -> bool:
        """True if the stage is a part of a run only where the pipeline has its table."""
        return bool(self.table_class)

    @property
    def result(self) -> "type[Result]":
        """The model of its result."""
        return registry.attribute(self.result_class)

    @property
    def table(self) -> "type[Section]":
        """The model of its table, of an optional stage."""
        return registry.attribute(f"{self.package}.table:{self.table_class}")

    def run(self, job: "Job") -> "Result":
        """The stage's result; its other files are in the job's folder."""
        return self._module(self.name).run(job)

    def summary(self, document: dict[str, Any], width: int | None = None, wide: bool = False) -> str:
        """A result's JSON in a few lines for people, its tables folded to `width` columns; `wide`: all that is in it.

        Raises StoreError where it is no result of this stage.
        """
        module, result = self._module(self.summary_module or self.name), self.result.of(document, "result")
        return (getattr(module, "details", module.summary) if wide else module.summary)(result, width)

    def configuration(self, config: "Pipeline", model: str | None, device: str) -> dict[str, Any]:
        """The slice of the configuration that its key holds, plant and seed aside."""
        return self._module("key").configuration(config, model, device)

    def _module(self, name: str) -> ModuleType:
        return imported(self.name, f"{self.package}.{name}")
