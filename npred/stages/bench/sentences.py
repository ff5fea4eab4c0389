"""The break-even of a network in words."""

from npred.figures.style import short
from npred.progress import counted
from npred.registry import METHODS, NETWORKS
from npred.results.bench import Crossover


def network_pays(crossover: Crossover, dx: float | None) -> str:
    """The crossover in a sentence for people; `dx` is the grid of the network's call, None where it is not known."""
    numerical, ratio = method_on(crossover.best, crossover.best_steps), crossover.network_speedup
    grid = "" if dx is None else f", dx = {dx:.3g}"
    network = f"the {NETWORKS.label(crossover.predictor)} ({crossover.runtime}{grid})"
    first, second = (numerical, network) if ratio < 1 else (network, numerical)
    times = f"the network takes {crossover.network_us:.1f} µs, {numerical} {crossover.best_us:.1f} µs"
    from_ns, here = crossover.pays_from_ns, f"(here {crossover.f_ns:.0f} ns)"
    pays = f"from {from_ns:.0f} ns per evaluation of f on {here}" if from_ns else f"however cheap f is {here}"
    return (
        f"For {crossover.plant} at ε = {short(crossover.eps_sup)} the fastest predictor is {first}, "
        f"{max(ratio, 1 / ratio):.1f} times as fast as {second}: {times}{_others(crossover)}.{_typical(crossover)} "
        f"A network pays {pays}."
    )


def _typical(crossover: Crossover) -> str:
    """The network beside the fastest method of its median error, which ranks them otherwise than the largest may."""
    if not crossover.by_median:
        return ""
    rival = min(crossover.by_median, key=lambda row: row.median_us)
    method = method_on(rival.predictor, rival.steps)
    ratio = rival.median_us / crossover.network_us
    times = f"{1 / ratio:.1f} times as fast" if ratio < 1 else f"{ratio:.1f} times its time"
    return (
        f" By the median error over samples, {short(crossover.eps_median)}, {method} has the network's "
        f"in {rival.median_us:.1f} µs, {times}."
    )


def _others(crossover: Crossover) -> str:
    """The methods of that accuracy that are slower than the best."""
    rows = [row for row in crossover.numerical if row.predictor != crossover.best]
    return "".join(f", {method_on(row.predictor, row.steps)} {row.median_us:.1f} µs" for row in rows)


def method_on(name: str, steps: int) -> str:
    """A method and its number of steps, in words."""
    return f"{METHODS.label(name)} on {counted(steps, 'steps')}"
