"""A benchmark for people: its tables, when a network pays, and the machine's share in the tails."""

from npred.base.progress import counted
from npred.base.registry import METHODS, NETWORKS, short_name
from npred.lab.config.results import NUMERICAL, Benched, PredictorId
from npred.lab.config.results.bench import Crossover, Stops
from npred.lab.report.figures.style import short
from npred.lab.stages.report import tables


def summary(result: Benched, width: int | None = None) -> str:
    """Each predictor's median and error, and the sentences on them; without the rows that only a figure needs."""
    return _text(result, tables.speed(result.rows, wide=False).terminal(width))


def details(result: Benched, width: int | None = None) -> str:
    """Every row with the tails of its times and its speed-ups, in a table wider than most screens."""
    return _text(result, tables.speed(result.rows, front=True).terminal(width))


def _text(result: Benched, table: str) -> str:
    title = f"microseconds per call, up to {result.calls} calls, {result.hardware.cpu}"
    return "\n".join([title, "", table, "", *sentences(result)])


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
            predictor = PredictorId(row.predictor) if row.is_network else NUMERICAL
            times[predictor] = min(times.get(predictor, row.median_us), row.median_us)
    return times


def stopped(stops: Stops) -> str:
    """The machine's share in the tails, in a sentence; see timing.stops."""
    if not stops.per_s:
        return "The machine did not stop a thread that only reads the clock: the tails are the predictors'."
    return (
        f"The machine stops a thread that only reads the clock {stops.per_s:.0f} times per second, for "
        f"{stops.median_us:.0f} µs in the median: from {1000 / stops.per_s:.1f} µs per call on, p99.9 includes that."
    )


def network_pays(crossover: Crossover, dx: float | None) -> str:
    """The break-even of a network in a sentence; `dx` is the grid of its call, None where it is not known."""
    numerical, ratio = method_on(crossover.best, crossover.best_steps), crossover.network_speedup
    grid = "" if dx is None else f", dx = {dx:.3g}"
    network = f"the {NETWORKS.label(crossover.predictor)} ({crossover.runtime}{grid})"
    first, second = (numerical, network) if ratio < 1 else (network, numerical)
    slower = [row for row in crossover.numerical if row.predictor != crossover.best]
    others = "".join(f", {method_on(row.predictor, row.steps)} {row.median_us:.1f} µs" for row in slower)
    here = f"(here {crossover.f_ns:.0f} ns)"
    from_ns = crossover.pays_from_ns
    pays = f"from {from_ns:.0f} ns per evaluation of f on {here}" if from_ns else f"however cheap f is {here}"
    typical = ""
    if crossover.by_median:  # the median error ranks methods otherwise than the largest may
        method = min(crossover.by_median, key=lambda row: row.median_us)
        times = method.median_us / crossover.network_us
        typical = (
            f" By the median error over samples, {short(crossover.eps_median)}, "
            f"{method_on(method.predictor, method.steps)} has the network's in {method.median_us:.1f} µs, "
            f"{f'{1 / times:.1f} times as fast' if times < 1 else f'{times:.1f} times its time'}."
        )
    return (
        f"For {crossover.plant} at ε = {short(crossover.eps_sup)} the fastest predictor is {first}, "
        f"{max(ratio, 1 / ratio):.1f} times as fast as {second}: the network takes {crossover.network_us:.1f} µs, "
        f"{numerical} {crossover.best_us:.1f} µs{others}.{typical} A network pays {pays}."
    )


def method_on(name: str, steps: int) -> str:
    """A method and its number of steps, in words."""
    return f"{METHODS.label(name)} on {counted(steps, 'steps')}"
