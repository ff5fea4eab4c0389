"""The result of the stage bench."""

from math import inf

from npred.results.base import Number, Result


class CallTimes(Result):
    """A timed predictor; times in microseconds per call."""

    predictor: str  #: a method, a network, or a baseline, as `published` (the O(nx²) interpreted one)
    runtime: str  #: `python`, `compiled`, `torch`, `onnx` or `fused`
    dx: float  #: the spacing of the nodes
    batch: int  #: rows per call
    #: `null` in the rows of Table I. Else an extra grid: the network whose accuracy this numerical predictor has there,
    #: or `front`, a coarse end of the accuracy–time front
    matches: str | None
    device: str  #: `cpu`, or a GPU
    copies: bool | None  #: whether samples are copied from and to the host within the time; `null` on the CPU
    calls: int  #: how many calls were timed
    median_us: float  #: the median
    p95_us: float  #: the 95 % quantile
    p999_us: float  #: the 99.9 % quantile
    max_us: float  #: the largest
    #: the largest error over held-out samples of the data and nodes; `null` where the predictor diverges
    eps_sup: Number
    eps_median: Number = inf  #: the median over samples of the largest over nodes, likewise
    #: the median of `published` at the same dx and batch over this one's; `null` where that was not timed
    speedup_published: float | None = None
    speedup_compiled: float | None = None  #: the same of compiled `euler`

    @property
    def is_network(self) -> bool:
        """True if a network was timed, and no numerical predictor."""
        return self.runtime not in ("python", "compiled")


class Rival(Result):
    """A numerical method on as many steps as it needs for the network's accuracy."""

    predictor: str  #: its name
    steps: int  #: how many
    median_us: float  #: microseconds per call
    eps_sup: Number = inf  #: its error on those steps, the largest
    eps_median: Number = inf  #: its median error


class Crossover(Result):
    """The break-even of a network: from which cost of f on it pays."""

    plant: str  #: its name
    predictor: str  #: the network
    runtime: str  #: its fastest
    eps_sup: Number  #: its error, the largest over samples and nodes, by which methods are matched
    eps_relative: Number  #: that over the largest P
    eps_median: Number = inf  #: its median error, over samples, of the largest over nodes
    network_us: float  #: microseconds per call
    numerical: list[Rival]  #: each method of that accuracy
    by_median: list[Rival] = []  #: each on as many steps as it needs for the network's median error
    best: str  #: the fastest of them
    best_steps: int  #: its steps
    best_us: float  #: its microseconds per call
    network_speedup: float  #: `best_us` over `network_us`
    f_ns: float  #: what an evaluation of f costs, in nanoseconds
    pays_from_ns: float  #: from which cost of f on the network pays; 0 for always
    sentence: str = ""  #: all that in words


class Foreseen(Result):
    """What `npred bench --no-networks` says before a network is trained."""

    plant: str  #: its name
    network: str  #: the network whose call is timed, with random weights
    crossover: list[Crossover]  #: its break-even at each of the errors that networks reach, the larger first
    sentence: str  #: whether a network could pay


class Stops(Result):
    """The share of the machine in the tails of the times."""

    per_s: float  #: how often per second it stops a thread that only reads the clock
    median_us: float  #: for how long, in microseconds
    sentence: str = ""  #: both in words


class Hardware(Result):
    """The machine that was timed."""

    cpu: str  #: the processor
    cores: int  #: that this process may use
    device: str  #: `cpu` or `cuda`
    gpus: list[str] = []  #: by name, on CUDA
    threads: int  #: of torch
    versions: dict[str, str | None]  #: of Python and of the packages


class Benched(Result):
    """Predictors timed beside their errors."""

    rows: list[CallTimes]  #: one per timed predictor
    calls: int  #: how many calls were asked for
    crossover: list[Crossover]  #: one per network: when it pays
    stops: Stops  #: what of the tails is the machine's
    hardware: Hardware  #: the machine and the packages

    @property
    def table(self) -> list[CallTimes]:
        """The rows of Table I of [DAPF]: one call, on the grids that were asked for."""
        return [row for row in self.rows if row.batch == 1 and row.matches is None]
