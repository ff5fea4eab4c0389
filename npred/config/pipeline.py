"""A pipeline file: one table per stage. Those of [generate] and [bench] are here, the longer ones in modules."""

import re
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Self

from pydantic import Field, create_model, model_validator

from npred import registry
from npred.config.evaluate import Evaluate
from npred.config.loop import Loop
from npred.config.section import ADDED, Baseline, Count, Delay, Kappa, Positive, Range, Runtime, Section, Some, Span
from npred.config.train import Train
from npred.config.tune import Tune
from npred.registry import METHODS

NAME = re.compile(r"[^\W_][\w.-]{0,99}")  # of a pipeline


class Generate(Loop):
    """Rollouts with the numerical predictor and the samples taken from them.

    The share `explore` of the rollouts, the last ones, takes its delays from explore_D and explore_D_hat0: they widen
    what a network is trained on, and all of them are trained on. So does the share `redraw` of all rows to train on:
    their D_hat is drawn from explore_D_hat0 instead of the loop's, and P is the numerical predictor's for it. With
    `spread` their X and u are moved off the loop too, near it and farther away: where the delay is known the loops of
    the exact prediction run along one curve, and a network's own loops beside it. The evaluation makes more rollouts
    and rows of both kinds, which no network has seen, and reports their errors apart.
    `data` is an HDF5 file with these samples, as `npred import` and `npred export hdf5` write it: nothing is simulated.
    """

    follows: ClassVar = ("D_hat0", "explore_D", "explore_D_hat0")

    samples: Count = 5000  #: rows of data
    rollouts: Count = 50  #: loops that they are taken from
    D: Range | Positive = 1.0  #: true delay in seconds, or a range to draw it from
    #: ranges of D_hat(0), an equal share of rollouts each; times D
    D_hat0: Some[Range] = [(0.3, 0.7), (1.0, 2.0), (1.0, 2.0)]
    box: dict[str, Span] = {}  #: range of each initial state of the data, instead of the plant's
    test_share: Annotated[float, Field(gt=0, lt=1)] = 0.1  #: of the rollouts, held out
    explore: Annotated[float, Field(ge=0, lt=1)] = 0.0  #: share of rollouts with delays from explore_D, explore_D_hat0
    redraw: Annotated[float, Field(ge=0, lt=1)] = 0.0  #: share of rows with a D_hat drawn anew
    #: how far redrawn rows are off the loop at most, in standard deviations of X and of u on it
    spread: Annotated[Delay, ADDED] = 0.0
    explore_D: Range = (0.25, 2.0)  #: D of exploring rollouts; times D
    explore_D_hat0: Range = (0.25, 3.5)  #: D_hat(0) of those, and D_hat of redrawn rows; times D
    data: str = ""  #: an HDF5 file of samples instead of rollouts

    @property
    def explorers(self) -> int:
        """The number of rollouts that explore: at least two are left for training and test."""
        return min(round(self.explore * self.rollouts), self.rollouts - 2)

    @model_validator(mode="after")
    def _check_explorers(self) -> Self:
        if self.explore:
            self.reached("explore_D", self.explore_D)
        if self.explore or self.redraw:
            self.reached("explore_D_hat0", self.explore_D_hat0)
        return self

    @model_validator(mode="after")
    def _check_delays(self) -> Self:
        for k, span in enumerate(self.D_hat0):
            self.reached(f"D_hat0[{k}]", span)
        self.reached("D", self.D if isinstance(self.D, tuple) else (self.D, self.D))
        if self.rollouts < 2:
            raise ValueError("rollouts: expected at least 2, got 1; one is held out for the test")
        if not self.rollouts <= self.samples <= self.rollouts * round(self.t_end / self.dt):
            raise ValueError(
                f"samples: expected 1 to t_end / dt per rollout, got {self.samples} of {self.rollouts}; change either"
            )
        return self


class Bench(Section):
    """Table I of [DAPF]: calls at each dx, each predictor with its error beside its time.

    Batches above 1 are timed at the first dx. `calls` of a predictor end after `seconds`.
    """

    dx: Some[Annotated[float, Field(gt=0, le=0.5)]] = [0.01, 0.005, 0.001]  #: spacings of the nodes
    calls: Count = 20_000  #: timed calls of a predictor: of 1000, one alone is beyond 99.9 %
    seconds: Positive = 3.0  #: after which they end
    threads: Count = 1  #: of each library
    batches: Some[Count] = [1, 1024]  #: rows per call
    runtimes: Some[Runtime] = ["torch", "fused", "onnx"]  #: ways to evaluate a network; also `file.py:Class`
    #: predictors in Python to compare with, `file.py:Class`; timed at batch 1
    baselines: Annotated[list[Baseline], ADDED] = []


class _Tables(Section):
    """A pipeline file, resolved: `plant` is a built-in name or `file.py:Class`, `parameters` override its defaults."""

    name: str = "pipeline"  #: what its results are called
    seed: Annotated[int, Field(ge=0, strict=True)] = 0  #: of everything random
    plant: str  #: a name, or `file.py:Class`
    parameters: dict[str, float] = {}  #: overrides of the plant's
    #: a law designed from f in place of the plant's: "lqr"; or a table, {law = "pole_placement", poles = [-1]}
    kappa: Annotated[Kappa | dict[str, Any], ADDED] = ""
    generate: Generate = Generate()
    train: Train = Train()
    evaluate: Evaluate = Evaluate()
    bench: Bench = Bench()
    tune: Annotated[Tune | None, ADDED] = None  #: a table: what `npred tune` varies

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
