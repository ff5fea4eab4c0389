"""Tables and sentences of a benchmark: its rows, when a network pays, and the machine's share in the tails."""

from math import isfinite

from npred.registry import short_name
from npred.results import NUMERICAL, Benched, PredictorId
from npred.results.bench import CallTimes, Crossover, Stops
from npred.stages.bench.sentences import network_pays
from npred.terminal.console import columns

TIMES = {"median": "median_us", "p95": "p95_us", "p99.9": "p999_us", "max": "max_us"}
NAMES = {"published": "O(nx²) sums", "euler_python": "euler"}  # shorter in a table
RATIOS = {"× O(nx²) sums": "speedup_published", "× euler": "speedup_compiled"}


def summary(result: Benched, width: int | None = None) -> str:
    """Each predictor's median and error, and the sentences on them; without the rows that only a figure needs."""
    rows = [_first(row) | {"µs": _short(row.median_us)} | _errors(row) for row in result.rows if row.matches != "front"]
    return _with_sentences(result, rows, width)


def details(result: Benched, width: int | None = None) -> str:
    """Every row with the tails of its times and its speed-ups, in a table wider than most screens."""
    return _with_sentences(result, [_all(row) for row in result.rows], width)


def sentences(result: Benched) -> list[str]:
    """One sentence per network, when it pays; then one on the machine. They are put anew, as results keep old words."""
    return [*(network_pays(row, timed_dx(result, row)) for row in result.crossover), result.stops.sentence]


def timed_dx(result: Benched, crossover: Crossover) -> float | None:
    """The dx of the network's call in a crossover; None where no row of the benchmark is that call."""
    call = (crossover.predictor, crossover.runtime, crossover.eps_sup)
    return next((row.dx for row in result.table if (row.predictor, row.runtime, row.eps_sup) == call), None)


def fastest(result: Benched, numerical: str) -> dict[PredictorId, float]:
    """The median µs of a call at the finest dx and batch 1: each network's in its fastest runtime, and the compiled
    numerical predictor's.
    """
    finest = min((row.dx for row in result.table), default=0.0)
    times: dict[PredictorId, float] = {}
    for row in result.table:
        if row.dx == finest and (row.is_network or (row.predictor, row.runtime) == (short_name(numerical), "compiled")):
            contender = PredictorId(row.predictor) if row.is_network else NUMERICAL
            times[contender] = min(times.get(contender, row.median_us), row.median_us)
    return times


def stopped(stops: Stops) -> str:
    """The machine's share in the tails, in a sentence; see timing.stops."""
    if not stops.per_s:
        return "The machine did not stop a thread that only reads the clock: the tails are the predictors'."
    often = f"{stops.per_s:.0f} times per second, for {stops.median_us:.0f} µs in the median"
    long = f"{1000 / stops.per_s:.1f} µs"
    return (
        f"The machine stops a thread that only reads the clock {often}: from {long} per call on, p99.9 includes that."
    )


def _with_sentences(result: Benched, rows: list[dict[str, str]], width: int | None) -> str:
    title = f"microseconds per call, up to {result.calls} calls, {result.hardware.cpu}"
    heads = list(rows[0]) if rows else ["predictor"]
    table = columns(heads, [list(row.values()) for row in rows], width, numbers=heads[2:])
    return "\n".join([title, "", table, "", *sentences(result)])


def _first(row: CallTimes) -> dict[str, str]:
    return {"predictor": _name(row), "runtime": _runtime(row), "dx": f"{row.dx:.3g}", "batch": str(row.batch)}


def _all(row: CallTimes) -> dict[str, str]:
    times = {head: _short(getattr(row, key)) for head, key in TIMES.items()}
    ratios = {head: "" if getattr(row, key) is None else f"{getattr(row, key):.3g}" for head, key in RATIOS.items()}
    return _first(row) | times | _errors(row) | ratios


def _name(row: CallTimes) -> str:
    name = NAMES.get(row.predictor) or str(row.predictor)
    return f"{name} (ε of {row.matches})" if row.matches not in (None, "front") else name


def _runtime(row: CallTimes) -> str:
    if row.copies is None:
        return row.runtime
    return f"{row.runtime} {row.device} {'with' if row.copies else 'without'} copies"


def _errors(row: CallTimes) -> dict[str, str]:
    errors = {"ε sup": row.eps_sup, "ε median": row.eps_median}
    return {head: f"{error:.1e}" if isfinite(error) else "∞" for head, error in errors.items()}


def _short(microseconds: float) -> str:
    return f"{microseconds:.1f}" if microseconds < 1000 else f"{microseconds:.0f}"
