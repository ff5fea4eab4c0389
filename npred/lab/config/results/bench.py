"""The result of the stage bench."""

from math import inf

from npred.lab.config.results.base import Number, Result


class CallTimes(Result):
    """A timed predictor. Times are in microseconds per call."""

    predictor: str  #: a method, a network, or a baseline, as `published` (the O(nx²) interpreted one)
    runtime: str  #: `python`, `compiled`, `torch`, `onnx` or `fused`
    dx: float  #: the spacing of the nodes
    batch: int  #: rows per call
    #: `null` in the rows of Table I. On an extra grid: the network of equal accuracy, or `front`, a coarse grid
    matches: str | None
    device: str  #: `cpu`, or a GPU
    copies: bool | None  #: whether the time includes copies from and to the host; `null` on the CPU
    calls: int  #: number of timed calls
    median_us: float  #: the median
    p95_us: float  #: the 95 % quantile
    p999_us: float  #: the 99.9 % quantile
    max_us: float  #: the largest
    #: the largest error over held-out samples and nodes; `null` if the predictor diverges
    eps_sup: Number
    eps_median: Number = inf  #: the median over samples of the largest error over nodes
    #: median of `published` at the same dx and batch over this median; `null` if not timed
    speedup_published: float | None = None
    speedup_compiled: float | None = None  #: the same for compiled `euler`

    @property
    def is_network(self) -> bool:
        """True if a network was timed, and no numerical predictor."""
        return self.runtime not in ("python", "compiled")


class EquivalentMethod(Result):
    """A numerical method on as many steps as it needs for the network's accuracy."""

    predictor: str  #: its name
    steps: int  #: how many
    median_us: float  #: microseconds per call
    eps_sup: Number = inf  #: its largest error with these steps
    eps_median: Number = inf  #: its median error


class Crossover(Result):
    """The break-even of a network: the cost of f above which the network is faster."""

    plant: str  #: its name
    predictor: str  #: the network
    runtime: str  #: the network's fastest runtime
    dx: float  #: the spacing of its nodes
    eps_sup: Number  #: its largest error; the methods have at most this error
    eps_relative: Number  #: `eps_sup` over the largest P
    eps_median: Number = inf  #: its median error, as in `rows`
    network_us: float  #: microseconds per call
    numerical: list[EquivalentMethod]  #: each method of that accuracy
    by_median: list[EquivalentMethod] = []  #: each method at the network's median error
    best: str  #: the fastest of them
    best_steps: int  #: its steps
    best_us: float  #: its microseconds per call
    network_speedup: float  #: `best_us` over `network_us`
    f_ns: float  #: cost of an evaluation of f, in nanoseconds
    pays_from_ns: float  #: cost of f above which the network is faster; 0 for always
    sentence: str = ""  #: the same in words


class BreakEven(Result):
    """The answer of `npred bench --no-networks`, before a network is trained."""

    plant: str  #: its name
    network: str  #: the network whose call is timed, with random weights
    crossover: list[Crossover]  #: its break-even at each of the errors that networks reach, the larger first
    sentence: str  #: whether a network could pay


class Stops(Result):
    """Interruptions by the machine, which cause the tails of the times."""

    per_s: float  #: interruptions per second of a thread that only reads the clock
    median_us: float  #: their length, in microseconds
    sentence: str = ""  #: both in words


class Hardware(Result):
    """The machine that was timed."""

    cpu: str  #: the processor
    cores: int  #: cores that this process may use
    device: str  #: `cpu` or `cuda`
    gpus: list[str] = []  #: by name, on CUDA
    threads: int  #: torch's threads
    versions: dict[str, str | None]  #: versions of Python and of the packages


class Benched(Result):
    """Times and errors of predictors."""

    rows: list[CallTimes]  #: one per timed predictor
    calls: int  #: calls that the pipeline asks for
    crossover: list[Crossover]  #: one per network
    stops: Stops  #: interruptions by the machine
    hardware: Hardware  #: the machine and the packages

    @property
    def table(self) -> list[CallTimes]:
        """The rows of Table I of [DAPF]: one call, on the grids that were asked for."""
        return [row for row in self.rows if row.batch == 1 and row.matches is None]
