"""A pipeline file: one table per stage. Those of [generate], [bench] and [tune] are here."""

import re
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, Self

from pydantic import Field, create_model, model_validator

from npred.base import registry
from npred.base.registry import METHODS
from npred.lab.config import section
from npred.lab.config.evaluate import Evaluate
from npred.lab.config.loop import LoopTable
from npred.lab.config.section import Baseline, Count, Delay, Number, Positive, Range, Runtime, Section, Some, Span
from npred.lab.config.train import Train

NAME = re.compile(r"[^\W_][\w.-]{0,99}")  # a pipeline's name


class Generate(LoopTable):
    """Rollouts with the numerical predictor, and samples of them.

    A share `explore` of the rollouts has other delays, from explore_D and explore_D_hat. A share `redraw` of the
    training rows has a D_hat from explore_D_hat, and with `spread` an X and u off the loop; the numerical predictor
    labels them. Use `spread` if the delay is known: exact loops then follow one curve, and loops of networks leave it.
    """

    follows: ClassVar = ("D_hat", "explore_D", "explore_D_hat")

    samples: Count = 5000  #: rows of data
    rollouts: Count = 50  #: loops of these rows
    D: Range | Positive = 1.0  #: true delay, or its range
    #: ranges of D_hat(0), an equal share of rollouts each; times D
    D_hat: Some[Range] = [(0.3, 0.7), (1.0, 2.0), (1.0, 2.0)]
    box: dict[str, Span] = {}  #: range of each initial state; by default the plant's
    test_share: Annotated[float, Field(gt=0, lt=1, strict=True)] = 0.1  #: share of held-out rollouts
    explore: Annotated[float, Field(ge=0, lt=1, strict=True)] = 0.0  #: share of exploring rollouts
    redraw: Annotated[float, Field(ge=0, lt=1, strict=True)] = 0.0  #: share of redrawn rows
    #: largest distance of redrawn rows from the loop, in standard deviations of X and u
    spread: Delay = 0.0
    explore_D: Range = (0.25, 2.0)  #: D of exploring rollouts; times D
    explore_D_hat: Range = (0.25, 3.5)  #: D_hat(0) of exploring rollouts, D_hat of redrawn rows; times D
    data: str = ""  #: samples of a file as data.h5 of this stage, instead of rollouts

    @property
    def explorers(self) -> int:
        """The number of rollouts that explore: at least two are left for training and test."""
        return min(round(self.explore * self.rollouts), self.rollouts - 2)

    @model_validator(mode="after")
    def _check_explorers(self) -> Self:
        if self.explore:
            self.reached("explore_D", self.explore_D)
        if self.explore or self.redraw:
            self.reached("explore_D_hat", self.explore_D_hat)
        return self

    @model_validator(mode="after")
    def _check_delays(self) -> Self:
        for k, span in enumerate(self.D_hat):
            self.reached(f"D_hat[{k}]", span)
        self.reached("D", self.D if isinstance(self.D, tuple) else (self.D, self.D))
        if self.rollouts < 2:
            raise ValueError("rollouts: expected at least 2, got 1; one is held out for the test")
        if not self.rollouts <= self.samples <= self.rollouts * round(self.t_end / self.dt):
            what, cure = "samples: expected 1 to t_end / dt per rollout", "change either"
            raise ValueError(f"{what}, got {self.samples} of {self.rollouts}; {cure}")
        return self


class Bench(Section):
    """Times and errors of predictors, as Table I of [DAPF]. Batches above 1 are timed at the first dx only."""

    dx: Some[Annotated[float, Field(gt=0, le=0.5, strict=True)]] = [0.01, 0.005, 0.001]  #: spacings of the nodes
    calls: Count = 20_000  #: timed calls of a predictor
    seconds: Positive = 1.0  #: longest time of a predictor
    threads: Count = 1  #: threads of each library
    batches: Some[Count] = [1, 1024]  #: rows per call
    runtimes: Some[Runtime] = ["torch", "fused", "onnx"]  #: ways to evaluate a network; also `file.py:Class`
    #: predictors in Python to compare with, `file.py:Class`; timed at batch 1
    baselines: list[Baseline] = []


class Tune(Section):
    """The search of `npred tune` in the loops of [evaluate].

    gamma and b vary where the delay law has a use for them. A range with low > 0 has a logarithmic scale; low = high
    fixes the number.
    """

    #: parameters that vary: those of kappa, not of f; of kappa = "lqr" also Q and R, their diagonals, or one as Q.x
    free: list[str] = []
    #: by name, of Q and R times the present; by default gamma, b, Q, R: 1 % to 100 times, gains: a fifth to 5 times
    bounds: dict[str, Span] = {}
    starts: Count = 8  #: random initial states of the search
    held_out: Annotated[int, Field(ge=2, le=2**53, strict=True)] = 16  #: initial states of the final judgement
    evaluations: Count | None = None  #: number of settings to try; by default 60 for each number that is free
    effort: Delay = 0.1  #: weight of the control effort in the cost
    #: smallest gain that counts, as a share of the cost
    margin: Annotated[float, Field(gt=0, lt=1, strict=True)] = 0.05

    @model_validator(mode="after")
    def _check_bounds(self) -> Self:
        for name in self.bounds:
            if name not in (*self.free, "gamma", "b"):
                raise ValueError(f"bounds: expected gamma, b or a name of free, got {name!r}; add it to free")
        return self


class _Tables(Section):
    """The plant, and one table per stage."""

    name: str = "pipeline"  #: in results
    seed: Annotated[int, Field(ge=0, strict=True)] = 0  #: seed of all random numbers
    plant: str  #: a name, or `file.py:Class`
    parameters: dict[str, Number] = {}  #: overrides of the plant's
    #: a law: "lqr", "policy.onnx", or a table, {law = "pole_placement", poles = [-1]}; by default the plant's
    kappa: section.Kappa | dict[str, Any] | Literal[""] = ""
    delays: list[Delay] | None = None  #: the delay of each input, if they differ; by default the plant's
    generate: Generate = Generate()
    train: Train = Train()
    evaluate: Evaluate = Evaluate()
    bench: Bench = Bench()
    tune: Tune | None = None  #: for `npred tune`

    @model_validator(mode="after")
    def _check_nodes(self) -> Self:
        intervals = self.generate.nx - 1
        for name in self.train.models:
            nodes = self.train.table(name).nodes
            if nodes and not self.generate.data and intervals % (nodes - 1):
                counts = ", ".join(str(k + 1) for k in range(1, intervals + 1) if intervals % k == 0)
                what = f"train.{name}.nodes: expected nodes - 1 to divide generate.nx - 1 = {intervals}"
                cure = f"take one of {counts}"
                raise ValueError(f"{what}, got {nodes}; {cure}")
        return self

    @model_validator(mode="after")
    def _check_name(self) -> Self:
        if not NAME.fullmatch(self.name):
            what = "name: expected up to 100 letters, digits, . _ and -, a letter or digit first"
            cure = "files are named after it: choose another"
            raise ValueError(f"{what}, got {self.name!r}; {cure}")
        return self

    def optional(self, stage: str) -> Any:
        """The table of an optional stage, or its defaults where the pipeline has none."""
        return getattr(self, stage) or registry.declared_stage(stage).table()

    @property
    def of_plant(self) -> tuple[Any, ...]:
        """The arguments of npred.plants.resolve."""
        return self.plant, self.parameters, self.kappa, self.delays

    @property
    def files(self) -> list[str]:
        """The names of the user's files that it takes: of a plant, of parts, of data."""
        paths: dict[str, None] = {}

        def collect(path: str) -> str:
            paths[registry.split(path)[0].name if registry.in_file(path) else Path(path).name] = None
            return path

        self.map_paths(collect)
        return list(paths)

    @property
    def methods(self) -> list[str]:
        """The numerical methods to compare: those that have a name, and those of files that it takes."""
        return list(dict.fromkeys([*METHODS.names(), self.generate.predictor, self.evaluate.predictor]))

    def with_file_names(self) -> Self:
        """The same with each of its `files` in the current folder: so the same wherever they lie."""
        return self.map_paths(lambda path: Path(path).name)

    def with_absolute_paths(self) -> Self:
        """The same for a process elsewhere, where a relative path would be another file."""
        return self.map_paths(lambda path: str(Path(path).absolute()))


if TYPE_CHECKING:
    Pipeline = _Tables
else:  # with a table of each optional stage, where that declares it
    _optional = Field(None, description="`npred run` also runs this stage")
    _stages = filter(lambda stage: stage.optional, map(registry.declared_stage, registry.STAGES))
    _fields = {stage.name: (stage.table | None, _optional) for stage in _stages}
    Pipeline = create_model("Pipeline", __base__=_Tables, __doc__=_Tables.__doc__, __module__=__name__, **_fields)
