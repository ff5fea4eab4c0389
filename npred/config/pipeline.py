"""A pipeline file: one table per stage."""

import re
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Self

from pydantic import Field, create_model, model_validator

from npred import registry
from npred.config.bench import Bench
from npred.config.evaluate import Evaluate
from npred.config.generate import Generate
from npred.config.section import ADDED, Section
from npred.config.train import Train
from npred.registry import METHODS

NAME = re.compile(r"[^\W_][\w.-]{0,99}")  # of a pipeline


class _Tables(Section):
    """A pipeline file, resolved: `plant` is a built-in name or `file.py:Class`, `parameters` override its defaults."""

    name: str = "pipeline"  #: what its results are called
    seed: Annotated[int, Field(ge=0, strict=True)] = 0  #: of everything random
    plant: str  #: a name, or `file.py:Class`
    parameters: dict[str, float] = {}  #: overrides of the plant's
    generate: Generate = Generate()
    train: Train = Train()
    evaluate: Evaluate = Evaluate()
    bench: Bench = Bench()

    @model_validator(mode="after")
    def _check_nodes(self) -> Self:
        intervals = self.generate.nx - 1
        for name in self.train.models:
            nodes = self.train.table(name).nodes
            if nodes and not self.generate.data and intervals % (nodes - 1):
                counts = ", ".join(str(k + 1) for k in range(1, intervals + 1) if intervals % k == 0)
                raise ValueError(
                    f"train.{name}.nodes: expected nodes - 1 to divide generate.nx - 1 = {intervals}, got {nodes}; "
                    f"take one of {counts}"
                )
        return self

    @model_validator(mode="after")
    def _check_name(self) -> Self:
        if not NAME.fullmatch(self.name):
            raise ValueError(
                f"name: expected up to 100 letters, digits, . _ and -, a letter or digit first, got {self.name!r}; "
                "files are named after it: choose another"
            )
        return self

    def optional(self, stage: str) -> Any:
        """The table of an optional stage, or its defaults where the pipeline has none."""
        return getattr(self, stage) or registry.declared_stage(stage).table()

    @property
    def longest_delay(self) -> float:
        """The longest delay or first estimate of one that the loops have, in seconds."""
        generate, evaluate = self.generate, self.evaluate
        spans = [generate.D if isinstance(generate.D, tuple) else (generate.D,), *generate.D_hat0]
        spans += [generate.explore_D] if generate.explore else []
        spans += [generate.explore_D_hat0] if generate.explore or generate.redraw else []
        spans += [(evaluate.D, evaluate.D_hat0), evaluate.case_D_hat0, evaluate.map_D, evaluate.map_D_hat0]
        return max(seconds for span in spans for seconds in span)

    @property
    def files(self) -> list[str]:
        """The names of the user's files that it takes: of a plant, of parts, of data."""
        paths: dict[str, None] = {}

        def collect(path: str) -> str:
            paths[registry.split(path)[0].name if registry.in_file(path) else Path(path).name] = None
            return path

        self.moved(collect)
        return list(paths)

    @property
    def methods(self) -> list[str]:
        """The numerical methods to compare: those that have a name, and those of files that it takes."""
        return list(dict.fromkeys([*METHODS.names(), self.generate.predictor, self.evaluate.predictor]))

    def beside(self) -> Self:
        """The same with each of its `files` in the current folder: so the same wherever they lie."""
        return self.moved(lambda path: Path(path).name)

    def located(self) -> Self:
        """The same for a process elsewhere, where a relative path would be another file."""
        return self.moved(lambda path: str(Path(path).absolute()))


if TYPE_CHECKING:
    Pipeline = _Tables
else:  # with a table of each optional stage, where that declares it
    _optional = Field(None, description="a table: with it, `npred run` runs this stage too")
    _stages = filter(lambda stage: stage.optional, map(registry.declared_stage, registry.STAGES))
    _fields = {stage.name: (Annotated[stage.table | None, ADDED], _optional) for stage in _stages}
    Pipeline = create_model("Pipeline", __base__=_Tables, __doc__=_Tables.__doc__, __module__=__name__, **_fields)
