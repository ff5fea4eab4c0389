"""A run in three sentences: the error, the closed loop, the time of a call."""

from collections.abc import Iterable

from npred.figures.evaluation_data import OF
from npred.figures.latency import label
from npred.figures.style import short
from npred.loop import metrics
from npred.plants import Plant
from npred.registry import METHODS
from npred.results import NO_ADAPTATION, NUMERICAL, Benched, Contender, Evaluated
from npred.results.evaluate import Scores
from npred.terminal.waiting import counted


def summary(plant: Plant, evaluated: Evaluated, benched: Benched) -> list[str]:
    """The three, each with its numbers."""
    networks = [contender for contender in evaluated.models if contender.is_network and contender.epoch is None]
    return [_errors(evaluated, networks), _loops(plant, evaluated, networks), _speed(benched)]


def _errors(evaluated: Evaluated, networks: list[Contender]) -> str:
    rows = [(network.label, evaluated.models[network]) for network in networks]
    errors = [f"{short(row.eps_sup)} for the {name} (mean square {short(row.mse)})" for name, row in rows]
    first, *others = evaluated.kinds
    samples = f"{evaluated.held_out:,} held-out samples of {OF[first]}"
    others = [_of_kind(kind, evaluated.kinds[kind].rows, [row for _, row in rows]) for kind in others]
    return "; ".join([f"On {samples} the largest error of a prediction is {_and(errors)}", *others]) + "."


def _of_kind(kind: str, count: int, rows: Iterable[Scores]) -> str:
    return f"on {count:,} of {OF[kind]} it is {_and([short(row.kinds[kind].eps_sup) for row in rows])}"


def _and(texts: list[str]) -> str:
    """a, b and c."""
    return " and ".join([", ".join(texts[:-1]), texts[-1]] if texts[1:] else texts)


def _loops(plant: Plant, evaluated: Evaluated, networks: list[Contender]) -> str:
    radii = {contender: scores.radius for contender, scores in evaluated.models.items()}
    counts = [f"{radii[n].count} with the {n.label} (median radius {short(radii[n].median)})" for n in networks]
    counts.append(f"{radii[NUMERICAL].count} with the numerical predictor")
    if adapts := NO_ADAPTATION in radii:
        counts.append(f"{radii[NO_ADAPTATION].count} without adaptation")
    delay = "with a delay that the controller does not know" if adapts else "with the delay estimate held"
    delay = "with a delay that the plant declares" if plant.declares_delay else delay
    return f"Of {radii[NUMERICAL].cases} closed loops {delay}, {_and(counts)} end {_near(plant)}."


def _near(plant: Plant) -> str:
    """Where a loop that converges ends."""
    if plant.rests:
        return f"within {short(metrics.SETTLED * metrics.size(plant.equilibrium))} of rest"
    return f"within {100 * metrics.SETTLED:g} % of the reference"


def _speed(benched: Benched) -> str:
    single = benched.table
    finest = min((row.dx for row in single), default=0.0)
    networks = [row for row in single if row.is_network and row.dx == finest]
    if not networks:
        return "No network was timed."
    row = min(networks, key=lambda row: row.median_us)
    ratio = row.speedup_published  # None where inputs have several delays, which that predictor does not take
    over = "" if ratio is None else f", {ratio:,.0f} times faster than interpreted O(nx²) sums"
    text = f"A call of the {label(row)}, takes {row.median_us:.1f} µs at dx = {finest:.3g}{over}"
    return f"{text}{_against_numerics(benched, row.predictor)}."


def _against_numerics(benched: Benched, network: str) -> str:
    crossover = next((row for row in benched.crossover if row.predictor == network), None)
    if crossover is None:
        return ""
    steps = counted(crossover.best_steps, "steps")
    return f"; {METHODS.label(crossover.best)} on {steps} is as accurate in {crossover.best_us:.1f} µs"
