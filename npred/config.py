"""The pipeline file as frozen models: one table per stage, every key checked, `--set` overrides included."""

import math
import os
import re
import stat
import tomllib
from collections.abc import Callable, Iterable, Iterator
from functools import partial
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, Self, TypeVar, get_args

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError, model_serializer, model_validator
from pydantic.fields import FieldInfo
from pydantic_core import PydanticCustomError

from npred import defaults, registry
from npred.errors import ConfigError, similar, size
from npred.registry import BASELINES, DELAY_LAWS, METHODS, NETWORKS, RUNTIMES, Registry

NAME = re.compile(r"[^\W_][\w.-]{0,99}")  # of a pipeline
LONGEST = 2**20  # bytes of a pipeline file
MOST = 2**53  # of anything that is counted
LONGEST_RUN = 10**9  # control steps of a loop
STEP = 6  # numbers that are kept of a step at least: X, P, U, D_hat, N and an energy
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False, strict=True)]
Delay = Annotated[float, Field(ge=0, allow_inf_nan=False, strict=True)]
Count = Annotated[int, Field(ge=1, le=MOST, strict=True)]
Nodes = Annotated[int, Field(ge=2, le=MOST, strict=True)]
Item = TypeVar("Item")
Some = Annotated[list[Item], Field(min_length=1)]
Number = Annotated[float, Field(allow_inf_nan=False, strict=True)]
StartInput = Number | list[Number] | list[list[Number]] | Literal["equilibrium", "law"]
PAPER, FROZEN = "bresch-pietri-krstic", "frozen"  # delay laws
STEPS_PER_DELAY = 10  # control steps in a delay, at least, where dt is not given
TAKEN = ("generate", "train", "evaluate", "bench", "report", "numerical", "no_adaptation", "published", "euler_python")
Networks = Annotated[Some[str], AfterValidator(lambda names: sorted(set(names)))]
Anchor = Literal["none", "initial", "equilibrium"]
Actuator = Literal["measured", "history"]
Share = Annotated[float, Field(ge=0, lt=1, strict=True)]
GONE = {  # tables of earlier versions
    "refine": "expected no such table, for that stage was taken out; drop it, and check networks by [evaluate.guard]"
}
# left out of a dump where they say nothing
ADDED = ("actuator", "measurement", "disturbance", "truth", "scenarios", "guard", "certify", "spread", "baselines")


def _part(parts: Registry, others: tuple[str, ...], name: str) -> str:
    if fault := parts.fault(name, *others):
        raise PydanticCustomError("fault", "{fault}", {"fault": fault})
    return name


def _ordered(span: tuple[float, float]) -> tuple[float, float]:
    if not span[0] <= span[1]:
        fault = f"expected [low, high] with low <= high, got {list(span)}; swap them"
        raise PydanticCustomError("fault", "{fault}", {"fault": fault})
    return span


def _times(D: float, value: Any, low: float, high: float) -> Any:
    """A number, or each one of a list, times D, clipped to [low, high]."""
    several = isinstance(value, list | tuple)
    return [_times(D, item, low, high) for item in value] if several else min(max(D * value, low), high)


def _ends(value: Any) -> list[float]:
    """The numbers of a value as it is written: a number, a list of numbers or of pairs; not those of anything else."""
    if isinstance(value, list | tuple):
        return [end for item in value for end in _ends(item)]
    return [float(value)] if isinstance(value, int | float) and not isinstance(value, bool) else []


ORDERED = AfterValidator(_ordered)
Range = Annotated[tuple[Delay, Delay], ORDERED]
Span = Annotated[tuple[Number, Number], ORDERED]
Bounds = Annotated[tuple[float, float], ORDERED]  # also infinite
Method = Annotated[str, AfterValidator(partial(_part, METHODS, ())), METHODS]
Law = Annotated[str, AfterValidator(partial(_part, DELAY_LAWS, (FROZEN,))), DELAY_LAWS]
Baseline = Annotated[str, AfterValidator(partial(_part, BASELINES, ())), BASELINES]
Architecture = Annotated[str, AfterValidator(partial(_part, NETWORKS, ())), NETWORKS]
Runtime = Annotated[str, AfterValidator(partial(_part, RUNTIMES, ())), RUNTIMES]


def within(key: str, span: Range, bounds: Range) -> None:
    """Raise ValueError unless the span lies inside the bounds of the delay estimate."""
    if span[0] < bounds[0] or span[1] > bounds[1]:
        values = list(span) if span[0] < span[1] else f"{span[0]:g}"
        raise ValueError(f"{key}: expected within bounds = {list(bounds)}, got {values}; widen bounds or move {key}")


class Section(BaseModel):
    """A table of the pipeline file: frozen, and an unknown key is an error."""

    model_config = ConfigDict(extra="forbid", frozen=True, ser_json_inf_nan="constants")

    def moved(self, locate: Callable[[str], str]) -> Self:
        """The same with `locate(path)` in each value that names a class of a file, or data."""
        return self.model_copy(update={key: _moved(value, locate, key) for key, value in self})

    @model_serializer(mode="wrap")
    def _dump(self, handler: Callable[[Any], dict[str, Any]]) -> dict[str, Any]:
        """All keys, but for those of ADDED that have their default: a key of a result is older than they are."""
        fields, document = type(self).model_fields, handler(self)
        return {k: v for k, v in document.items() if k not in ADDED or getattr(self, k) != fields[k].default}


def _moved(value: Any, locate: Callable[[str], str], key: Any = None) -> Any:
    """A pipeline's value, plain or parsed, with `locate(path)` in each text that names a class of a file, or data."""
    if isinstance(value, Section):
        return value.moved(locate)
    if isinstance(value, dict):
        return {name: _moved(item, locate, name) for name, item in value.items()}
    if isinstance(value, list):
        return [_moved(item, locate) for item in value]
    is_path = isinstance(value, str) and (registry.named(value) or (key == "data" and value))
    return locate(value) if is_path else value


class Sensors(Section):
    """What the controller sees of the plant: samples X (1 + noise ξ), ξ standard normal, and when they arrive.

    Between samples it predicts the state from the last one, with its own commands.
    """

    noise: Delay = 0.0  #: standard deviation of a sample, relative to its value
    period: Positive | None = None  #: between samples, in seconds; by default the control step
    jitter: Share = 0.0  #: largest deviation of a period, relative to it
    delay: Delay = 0.0  #: from a sample to its arrival, in seconds
    drop: Share = 0.0  #: probability that a sample never arrives

    @model_validator(mode="after")
    def _check(self) -> Self:
        self.spread()
        return self

    def spread(self) -> None:
        """Raise ValueError for a jitter without the period that it spreads."""
        if self.jitter and self.period is None:
            raise ValueError("jitter: expected a period that it spreads, got none; give period")


class Disturbance(Section):
    """amplitude sin(omega t), added to what leaves the actuator, the same for each input."""

    amplitude: Number = 0.0  #: in units of the input
    omega: Positive = 1.0  #: in rad/s


class Drift(Section):
    """The true delay D + amplitude sin(2π t / period)."""

    amplitude: Number  #: in seconds
    period: Positive  #: in seconds


class Jump(Section):
    """The true delay D up to the time `at`, and another one from there on."""

    to: Delay  #: the delay afterwards, in seconds
    at: Delay  #: in seconds


class Loop(Section):
    """The settings of a stage's closed loops [DAPF, eqs. 6-14]: times and delays in seconds, nx nodes on [0, 1].

    `adaptation` is the delay law: the paper's by default; frozen, where D_hat stays where it starts (started at D, the
    delay is known); or a user's, `file.py:Class`, made with gamma, b and bounds. For a plant that declares its delay,
    which the controller then knows, every key about delays, estimates and laws is left out.

    Keys that are left out follow D: the defaults below are those of D = 1. Estimates, their bounds and other delays are
    multiplied by D, or by the middle of its range, and kept within bounds that are given; bounds that are left out hold
    all delays and estimates that are given. A dt is at most D / 10, and loops are longer where D is above 1.
    """

    follows: ClassVar[tuple[str, ...]] = ()  # keys that are multiples of D
    mapped: ClassVar[tuple[str, ...]] = ()  # further delays and estimates that the bounds hold
    lasting: ClassVar[tuple[str, ...]] = ("t_end",)

    dt: Positive = 0.005  #: control step, in seconds
    nx: Nodes = 101  #: nodes of the predictor and of u, both ends of [0, 1]; dx = 0.01 is 101
    t_end: Positive = 40.0  #: length of a loop, in seconds
    #: euler, heun, rk4, rosenbrock, semi_implicit, picard, one of an installed package, or `file.py:Class`
    predictor: Method = "rk4"
    adaptation: Law = PAPER  #: the delay law: the paper's, frozen, one of a package, or `file.py:Class`
    gamma: Positive | None = None  #: adaptation gain [DAPF, eq. 11]; by default one that suits the plant and D
    b: Positive = 1.0  #: weight of w in phi [DAPF, eq. 12]
    bounds: Range = (0.1, 4.0)  #: where D_hat stays, in seconds; by default 0.1 D to 4 D
    input_bounds: list[Bounds] | None = None  #: of U, a pair per input; by default the plant's
    #: the input before t = 0, which fills the delay: numbers, "equilibrium", "law" (κ of the start), or a history over
    #: [-D, 0], a list of rows of equal duration, the oldest first; by default 0 where input_bounds allow it, else
    #: "equilibrium"
    u0: StartInput | None = None
    actuator: Actuator = "measured"  #: whether u is measured, or read from the history of commands at D_hat
    truth: dict[str, Number] = {}  #: parameters of the simulated plant that are not those of the controller's model
    measurement: Sensors = Sensors()  #: a table: what the controller sees of the state
    disturbance: Disturbance = Disturbance()  #: a table: what is added to the input of the simulated plant

    @model_validator(mode="before")
    @classmethod
    def _follow(cls, data: Any) -> Any:
        """The table with the defaults that follow D."""
        ends = _ends(data.get("D", 1.0)) if isinstance(data, dict) else []
        if not ends or not 0 < min(ends) <= max(ends) < math.inf:
            return data  # its own check refuses that D
        D, fields, bounds = (min(ends) + max(ends)) / 2, cls.model_fields, _ends(data.get("bounds", []))
        low, high = bounds if len(bounds) == 2 else (0.0, math.inf)
        filled = {key: _times(D, fields[key].default, low, high) for key in cls.follows}
        filled |= {key: max(1.0, D) * fields[key].default for key in cls.lasting}
        filled |= {"dt": min(fields["dt"].default, min(ends) / STEPS_PER_DELAY)}
        data = filled | data
        if "bounds" not in data and data.get("adaptation") != FROZEN:
            delays = [end for key in ("D", *cls.follows, *cls.mapped) for end in _ends(data.get(key, []))]
            low, high = (D * bound for bound in fields["bounds"].default)
            data["bounds"] = (min(low, *delays), max(high, *delays))
        return data

    @model_validator(mode="after")
    def _check(self) -> Self:
        self.lasts("t_end", self.t_end)
        return self

    @property
    def longest(self) -> float:
        """The longest true delay, in seconds, jumps and drifts of scenarios aside."""
        return max(_ends(getattr(self, "D", 1.0)))

    @property
    def simulated(self) -> bool:
        """True if loops are run: data may come from a file."""
        return not getattr(self, "data", "")

    def lasts(self, key: str, seconds: float) -> None:
        """Raise ValueError for loops shorter than a control step, or with more steps than a record can hold."""
        if self.dt > seconds:
            raise ValueError(f"dt: expected at most {key} = {seconds:g}, got {self.dt:g}; shorten the step")
        if seconds > LONGEST_RUN * self.dt:
            steps = seconds / self.dt
            room = f"{steps:.3g} steps of {self.dt:g}, whose record takes {size(8 * STEP * steps)} for each loop"
            raise ValueError(f"{key}: expected at most {LONGEST_RUN} steps, got {room}; shorten {key} or lengthen dt")

    def reached(self, key: str, span: Range) -> None:
        """Raise ValueError for a delay or an estimate of it outside the bounds, where the estimate adapts."""
        if self.adaptation != FROZEN:
            within(key, span, self.bounds)


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
    spread: Delay = 0.0  #: how far redrawn rows are off the loop at most, in standard deviations of X and of u on it
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


class Training(Section):
    """The settings that all networks share; `snapshots` keeps the model as it stood after those epochs.

    `loss` weighs the components of an error, `rows` says what of a row's error is averaged; `nodes`: how many of the
    data's nodes the error is taken on (u is seen on all).
    """

    epochs: Count = 100  #: passes over the data; the most of them, with `eps`
    eps: Positive | None = None  #: ends once the largest error of P, held out, is as small
    batch: Count = 1024  #: rows per step
    lr: Positive = 1e-2  #: learning rate, at its peak
    weight_decay: Annotated[float, Field(ge=0)] = 0.0  #: of the weights, towards 0
    optimiser: Literal["soap", "adam"] = "soap"  #: SOAP or Adam
    schedule: Literal["one-cycle", "step"] = "one-cycle"  #: of the learning rate; step halves it every 50 epochs
    loss: Literal["raw", "standardised", "kappa"] = "kappa"  #: how components weigh; kappa: in control
    rows: Literal["square", "norm"] = "norm"  #: mean of squares, or of norms, over rows
    nodes: Nodes | None = None  #: of the data's, where P is compared; all by default
    snapshots: list[Count] = []  #: epochs whose model is kept beside the last
    anchor: Anchor = "equilibrium"  #: where P_hat is exact by construction
    checkpoint_every: Count = 5  #: epochs between checkpoints

    @model_validator(mode="after")
    def _check_snapshots(self) -> Self:
        late = [k for k in self.snapshots if k > self.epochs]
        if late:
            raise ValueError(
                f"snapshots: expected epochs of 1 to {self.epochs}, got {late[0]}; raise epochs or drop it"
            )
        if self.snapshots and self.eps:
            raise ValueError("snapshots: expected none beside eps, with which a training may end before; drop one")
        return self

    @property
    def architecture(self) -> str:
        """The network that is trained, as the registry names it: where a table does not say, the name of the table."""
        return getattr(self, "network", type(self).__name__.lower())

    @property
    def arguments(self) -> dict[str, Any]:
        """The keyword arguments of the network's class: `sizes`, or else the keys beyond those of Training."""
        keywords = {key: value for key, value in self if key not in Training.model_fields}
        return keywords.get("sizes", keywords)


class DeepONet(Training):
    """Branch network of `depth` hidden layers, trunk of two; `basis` trunk functions; `moments` of u."""

    width: Count = 96  #: of the branch network
    depth: Count = 4  #: hidden layers of the branch
    basis: Count = 48  #: trunk functions
    trunk: Count = 64  #: width of the trunk network
    moments: Count = 16  #: Legendre moments of u that the branch sees


class FNO(Training):
    """Spectral layers over x [Li et al. 2021], each a truncated real DFT of the lowest `modes`."""

    batch: Count = 256  #: rows per step
    lr: Positive = 5e-3  #: learning rate
    width: Count = 32  #: channels
    modes: Count = 8  #: kept of each spectral layer
    layers: Count = 4  #: spectral layers


class Network(Training):
    """Any network under a name of your choice: one that is registered, or a class of a file, and its sizes."""

    network: Architecture  #: a registered one, one of a package, or `file.py:Class`; the table's name
    sizes: dict[str, Any] = {}  #: keyword arguments of the network's class


class Train(Section):
    """One table per network; `models` says which of them are trained, each once; their order means nothing.

    A table of another name says by `network` what it is; a registered network needs no table.
    """

    model_config = ConfigDict(extra="allow")
    __pydantic_extra__: dict[str, Network] = Field(init=False)

    models: Networks = ["deeponet", "fno"]  #: networks to train: registered ones, or names of tables
    deeponet: DeepONet = DeepONet()
    fno: FNO = FNO()

    @property
    def named(self) -> dict[str, Network]:
        """The tables of names that the user has chosen."""
        return self.__pydantic_extra__

    @property
    def names(self) -> list[str]:
        """The networks that can be trained: those with a table, and the registered ones."""
        return list(dict.fromkeys(["deeponet", "fno", *self.named, *NETWORKS.names()]))

    def table(self, name: str) -> Training:
        """The table of a network; a registered one may have none."""
        if name in type(self).model_fields:
            return getattr(self, name)
        return self.named[name] if name in self.named else Network(network=name)

    @model_validator(mode="before")
    @classmethod
    def _named(cls, data: Any) -> Any:
        """Each table of a chosen name with its `network`, the name itself where it gives none."""
        if not isinstance(data, dict):
            return data
        chosen = {key: table for key, table in data.items() if key not in cls.model_fields}
        for key, table in chosen.items():
            if not isinstance(table, dict | Network):
                raise ValueError(f"{key}: {_unknown(f'train.{key}', sorted(cls.model_fields))}")
            if not key.isidentifier() or len(key) > 100 or key in (*TAKEN, *METHODS.names()):
                raise ValueError(
                    f"{key}: expected the name of a network, of letters, digits and _, and none that results use, "
                    f"got {key!r}; choose another"
                )
        return data | {k: {"network": k} | table for k, table in chosen.items() if isinstance(table, dict)}

    @model_validator(mode="after")
    def _check_models(self) -> Self:
        for name in set(self.models) - {*self.named, *NETWORKS.builtin}:
            if name not in self.names:
                cure, names = similar(name, self.names) or "; choose one or add a table", ", ".join(self.names)
                raise ValueError(f"models: expected {names} or a table [train.NAME], got {name!r}{cure}")
        return self


CASES = {"D_hat0": "case_D_hat0", "t_end": "case_t_end"}  # keys of [evaluate] by those of a scenario


class Scenario(Section):
    """Loops under other conditions, from the initial states of the cases: each key that is given takes the place of
    the one of [evaluate] or of its sensors, for the numerical predictor and for each network.
    """

    name: Annotated[str, Field(min_length=1, max_length=40)]  #: what tables and figures call it
    noise: Delay | None = None  #: as measurement.noise
    period: Positive | None = None  #: as measurement.period
    jitter: Share | None = None  #: as measurement.jitter
    delay: Delay | None = None  #: as measurement.delay
    drop: Share | None = None  #: as measurement.drop
    parameters_scale: Positive | None = None  #: all parameters of the simulated plant times that
    parameters: dict[str, Number] = {}  #: as truth
    disturbance: Disturbance | None = None  #: as disturbance, amplitude sin(omega t)
    actuator: Actuator | None = None  #: as actuator
    adaptation: Law | None = None  #: as adaptation
    D_hat0: Some[Positive] | None = None  #: as case_D_hat0
    drift: Drift | None = None  #: the true delay is D + amplitude sin(2π t / period)
    jump: Jump | None = None  #: the true delay is `to` from the time `at` on
    t_end: Positive | None = None  #: as case_t_end

    @model_validator(mode="after")
    def _check(self) -> Self:
        for one, other in (("drift", "jump"), ("parameters", "parameters_scale")):
            if getattr(self, one) and getattr(self, other):
                raise ValueError(f"{one}, {other}: expected one of them, got both; drop one, or write two scenarios")
        return self

    @property
    def about_delay(self) -> list[str]:
        """The keys that are given and mean nothing where the plant declares its delay."""
        return [key for key in ("adaptation", "D_hat0", "drift", "jump") if getattr(self, key) is not None]

    def delays(self, D: float) -> Range:
        """The smallest and the largest true delay where it is D in [evaluate], in seconds."""
        reach = abs(self.drift.amplitude) if self.drift else 0.0
        ends = (D, self.jump.to) if self.jump else (D - reach, D + reach)
        return min(ends), max(ends)

    @model_serializer(mode="wrap")
    def _given(self, handler: Callable[[Any], dict[str, Any]]) -> dict[str, Any]:
        """The keys that say something."""
        return {key: value for key, value in handler(self).items() if value not in (None, {})}


class GuardTable(Section):
    """The networks are checked in every call of a loop; where one may be wrong, `predictor` answers (npred.guarded)."""

    tolerance: Positive = 0.01  #: the largest error of U that passes, in units of the input
    by: Literal["auto", "shadow", "defect"] = "auto"  #: how the error is estimated
    correct: bool = False  #: whether the error by the defect is subtracted first; not advised


class Evaluate(Loop):
    """Held-out errors by kind of row; the error |P(1, t) - X(t + D)| in loops that know the delay; the loop of Fig. 1,
    initial states x D_hat(0), and Fig. 1's start over a map D x D_hat(0).
    """

    follows: ClassVar = ("D_hat0", "case_D_hat0")
    mapped: ClassVar = ("map_D", "map_D_hat0")
    lasting: ClassVar = ("t_end", "case_t_end")

    t_end: Positive = 100.0  #: length of the loop of Fig. 1, in seconds
    D: Positive = 1.0  #: true delay, in seconds
    X0: list[float] = []  #: start of Fig. 1, one number per state; has to be given
    D_hat0: Positive = 2.0  #: D_hat(0) of Fig. 1; times D
    case_states: Count = 10  #: random initial states of the box …
    case_D_hat0: Some[Positive] = [0.3, 0.5, 1.0, 1.5, 2.0]  #: … times these D_hat(0); times D
    case_t_end: Positive = 100.0  #: length of those loops, in seconds
    map_D: list[Positive] = []  #: true delays of the convergence map …
    map_D_hat0: list[Positive] = []  #: … times these D_hat(0), from the start of Fig. 1
    scenarios: list[Scenario] = []  #: other conditions, each a table [[evaluate.scenarios]]
    guard: GuardTable | None = None  #: a table: how networks are checked in their loops; by default they are not

    @model_validator(mode="after")
    def _check_scenarios(self) -> Self:
        names = [scenario.name for scenario in self.scenarios]
        if twice := next((name for name in names if names.count(name) > 1), None):
            raise ValueError(f"scenarios: expected different names, got {twice!r} twice; rename one")
        for k, scenario in enumerate(self.scenarios):
            span = scenario.delays(self.D)
            if span[0] < 0:
                raise ValueError(f"scenarios[{k}].drift: expected a delay of at least 0 s, got {span[0]:g}; shrink it")
            table = self.under(scenario)
            try:
                table.reached("delay", span)
                table.lasts("t_end", table.case_t_end)
                table.measurement.spread()
            except ValueError as error:
                raise ValueError(f"scenarios[{k}]: {error}") from None
            for value in scenario.D_hat0 or []:
                table.reached(f"scenarios[{k}].D_hat0", (value, value))
        return self

    def under(self, scenario: Scenario) -> Self:
        """This table with the keys that a scenario gives in their places; drifts and jumps of D aside."""
        values = {CASES.get(key, key): value for key, value in scenario if value is not None}
        update = {key: value for key, value in values.items() if key in type(self).model_fields}
        sensors = {key: value for key, value in values.items() if key in Sensors.model_fields}
        update |= {
            "measurement": self.measurement.model_copy(update=sensors),
            "truth": self.truth | scenario.parameters,
        }
        return self.model_copy(update=update)

    @model_validator(mode="after")
    def _check_delays(self) -> Self:
        self.reached("D_hat0", (self.D_hat0, self.D_hat0))
        self.reached("D", (self.D, self.D))
        for k, delay in enumerate(self.map_D):
            self.reached(f"map_D[{k}]", (delay, delay))
        for key, values in {"case_D_hat0": self.case_D_hat0, "map_D_hat0": self.map_D_hat0}.items():
            for k, value in enumerate(values):
                self.reached(f"{key}[{k}]", (value, value))
        if bool(self.map_D) != bool(self.map_D_hat0):
            raise ValueError("map_D, map_D_hat0: expected both or neither, got one; a map needs both axes")
        if self.t_end > self.case_t_end:
            raise ValueError(
                f"t_end: expected at most case_t_end = {self.case_t_end:g}, got {self.t_end:g}; raise that"
            )
        self.lasts("case_t_end", self.case_t_end)
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
    baselines: list[Baseline] = []  #: predictors in Python to compare with, `file.py:Class`; timed at batch 1


class Certify(Section):
    """What `npred certify` draws and searches: N rollouts such that with `confidence` at most a share `probability` of
    all has a larger error than the largest of these; an adversary's calls; and loops that are counted as lost.
    """

    probability: Annotated[float, Field(gt=0, lt=1, strict=True)] = 1e-3  #: share of rollouts that may be worse
    confidence: Annotated[float, Field(gt=0, lt=1, strict=True)] = 0.999  #: with which that holds
    samples: Count = 50  #: of each rollout, at random times
    restarts: Count = 500  #: searches for the largest error, and for errors that the guard lets pass …
    steps: Count = 200  #: … of so many calls each
    loops: Count = 40  #: fresh starts, each with the numerical predictor, the bare network and the guarded one


class Pipeline(Section):
    """A pipeline file, resolved: `plant` is a built-in name or `file.py:Class`, `parameters` override its defaults."""

    name: str = "pipeline"  #: what its results are called
    seed: Annotated[int, Field(ge=0, strict=True)] = 0  #: of everything random
    plant: str  #: a name, or `file.py:Class`
    parameters: dict[str, float] = {}  #: overrides of the plant's
    generate: Generate = Generate()
    train: Train = Train()
    evaluate: Evaluate = Evaluate()
    bench: Bench = Bench()
    certify: Certify | None = None  #: a table: with it, `npred run` certifies too

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

    @property
    def certify_table(self) -> Certify:
        """The table [certify], or its defaults where there is none."""
        return self.certify or Certify()

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
            paths[registry.split(path)[0].name if registry.named(path) else Path(path).name] = None
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


def load(path: Path, overrides: list[str] | None = None) -> Pipeline:
    """The pipeline of a TOML file with `key.path=value` overrides applied.

    Files that it names (a plant's, a delay law's, data) are relative to its folder; those of overrides, and of a
    pipeline that comes through a pipe, to the current one.
    Raises ConfigError, in one line, for a file that is missing or no TOML, an unknown key, a wrong type or value.
    """
    try:
        folder = path.parent if path.is_file() else Path()
        data = _moved(tomllib.loads(_file_text(path)), lambda file: str(folder / file))
    except FileNotFoundError:
        raise ConfigError(defaults.missing(path)) from None
    except (OSError, ValueError, RecursionError) as error:
        raise ConfigError(f"{path}: expected a TOML file, got: {error}; write TOML, as seed = 0") from None
    for override in overrides or []:
        _apply(data, override)
    return parse(data, str(path))


def _file_text(path: Path) -> str:
    """The text of a file, or of a pipe that somebody writes to: an abandoned one would be waited for without an end."""
    descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK)
    with open(descriptor, "rb", buffering=0) as file:
        first = file.read(LONGEST + 1)  # None where a pipe's writer has written nothing yet
        if first == b"" and stat.S_ISFIFO(os.fstat(descriptor).st_mode):
            raise ValueError("a pipe that nobody writes to")
        content = first or b""
        os.set_blocking(descriptor, True)
        while chunk := file.read(LONGEST + 1 - len(content)):
            content += chunk
    if len(content) > LONGEST:
        raise ValueError(f"more than {LONGEST} bytes")
    return content.decode("utf-8")


def parse(data: dict[str, Any], source: str) -> Pipeline:
    """The pipeline of a plain dictionary; `source` names it in errors."""
    try:
        return Pipeline.model_validate(data)
    except ValidationError as error:
        raise ConfigError(f"{source}: {_sentence(error)}") from None


def _apply(data: dict[str, Any], override: str) -> None:
    key, sign, text = override.partition("=")
    if not sign or not key:
        raise ConfigError(
            f"--set: expected key.path=value, got {override!r}; for example --set train.deeponet.epochs=5"
        )
    try:
        value = tomllib.loads(f"value = {text}")["value"]
    except tomllib.TOMLDecodeError:
        value = text  # a bare word is a string, so that --set plant=scalar needs no quotes
    *parents, leaf = key.split(".")
    for parent in parents:
        data = data.setdefault(parent, {})
        if not isinstance(data, dict):
            raise ConfigError(f"--set {key}: expected a table at {parent!r}, got {data!r}; check the key's path")
    data[leaf] = value


def _sentence(error: ValidationError) -> str:
    first: Any = error.errors()[0]
    named = [part for part in first["loc"] if part != "float"]  # without a union's types
    fields = [part for part in named if isinstance(part, int) or part.isidentifier()]
    where = ".".join(str(part) for part in fields)
    if first["type"] == "extra_forbidden":
        where = ".".join(map(str, first["loc"]))
        return f"{where}: {_unknown(where, _siblings(first['loc']))}"
    if first["type"] == "fault":
        place = "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in fields)
        return f"{place.removeprefix('.')}: {first['msg']}"
    if first["type"] == "value_error":
        return f"{where + '.' if where else ''}{first['ctx']['error']}"
    if first["type"] == "missing":
        example = ' as plant = "my_plant.py:Tank"' if where == "plant" else ""
        return f"{where}: expected a value, found none; add it{example}"
    if first["type"] == "too_short":
        return f"{where}: expected at least one value, got {first['input']!r}; give one"
    expected = [
        e["msg"].removeprefix("Input should be ") for e in error.errors() if e["loc"][: len(fields)] == tuple(fields)
    ]
    return f"{where}: expected {' or '.join(dict.fromkeys(expected))}, got {first['input']!r}; give such a value"


def _unknown(key: str, siblings: list[str]) -> str:
    return GONE.get(key) or f"unknown key; expected one of {', '.join(siblings)}{_meant(key, siblings)}"


def _siblings(loc: tuple[int | str, ...]) -> list[str]:
    model: Any = Pipeline
    for part in loc[:-1]:
        if isinstance(part, str):
            model = _table(model.model_fields[part].annotation) if part in model.model_fields else Network
    return sorted(model.model_fields)


def _table(kind: Any) -> Any:
    """The table that a key holds, or a list of."""
    return next(
        (part for part in (kind, *get_args(kind)) if isinstance(part, type) and issubclass(part, Section)), kind
    )


def _meant(key: str, siblings: list[str]) -> str:
    """A suggestion for an unknown key: one of the same table that is spelt alike, else one of another table."""
    leaf = key.rpartition(".")[2]
    near = similar(leaf, siblings)
    keys = [other for other, _ in leaves()]
    elsewhere = [other for other in keys if other.rpartition(".")[2] == leaf]
    if elsewhere and "sizes" in siblings:
        return f"; did you mean sizes = {{ {leaf} = … }}?"
    return near or (f"; did you mean {' or '.join(elsewhere)}?" if elsewhere else similar(key, keys))


def leaves(
    model: type[Section] = Pipeline, path: str = "", networks: Iterable[str] = ()
) -> Iterator[tuple[str, FieldInfo]]:
    """Every key of a pipeline file, dotted, with its declaration; `networks` are names of tables below train."""
    for name in networks:
        yield from leaves(Network, f"train.{name}.")
    for name, field in model.model_fields.items():
        if isinstance(field.annotation, type) and issubclass(field.annotation, Section):
            yield from leaves(field.annotation, f"{path}{name}.")
        else:
            yield path + name, field
