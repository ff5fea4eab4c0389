"""Whether a network could pay, before one is trained: methods with errors that networks reach, and an untrained one."""

import numpy as np

from npred.base import array_checks, grid, randomness
from npred.base.errors import ConfigError
from npred.base.registry import WITHOUT_V
from npred.lab.config import Pipeline
from npred.lab.config.results.bench import BreakEven, Crossover
from npred.lab.report.figures.style import short
from npred.lab.report.figures.table import Column, Table
from npred.lab.scheduler import pipeline_fit
from npred.lab.stages.bench import bench, candidates
from npred.lab.stages.bench.candidates import Candidate, ErrorSizes, Reference
from npred.lab.stages.generate import sampling
from npred.lab.training.data.dataset import Dataset
from npred.networks.fused import Fused
from npred.networks.weights import untrained
from npred.plants import Plant

NETWORK = "deeponet"  # whose call is the shortest
# Largest errors over the largest |P| that are tried: networks of the paper's plant have 1.0e-3 and 1.3e-3
RELATIVE = 1e-2, 1e-3
DELAYS = 8.0  # the length of the loops that samples are taken from
TRACED, CALLED = (24, 120), (4, 20)  # loops and samples; a plant that is called in Python has fewer
CALLS, SECONDS = 2000, 0.2


def measure(pipeline: Pipeline, plant: Plant) -> BreakEven:
    """Untrained weights of the network's sizes, timed in turn with each method on the fewest steps of each error.

    Samples come from short loops of [generate], and nothing is stored. Raises ConfigError for a pipeline that its plant
    does not fit, for loops that overflow, and where no method reaches an error.
    """
    if not plant.declares_V and pipeline.generate.adaptation not in WITHOUT_V:  # its loops are asked for samples only
        adapted = pipeline.generate.model_copy(update={"adaptation": "delay-observer", "actuator": "history"})
        pipeline = pipeline.model_copy(update={"generate": adapted})
    pipeline_fit.require(plant, pipeline, ("generate",))
    reference = Reference.of(plant, _samples(pipeline, plant))
    nx = grid.count(pipeline.bench.dx[0])
    weights = untrained(pipeline.train.table(NETWORK), plant, randomness.generator(pipeline.seed, "bench"))
    network = Candidate(NETWORK, "fused", nx, 1, Fused(plant, weights, nx, NETWORK))
    methods = candidates.one_step_methods(pipeline, plant)
    config = pipeline.bench.model_copy(update={"calls": CALLS, "seconds": SECONDS})
    crossovers = []
    for relative in RELATIVE:
        eps = relative * float(np.abs(reference.P).max())
        rivals = candidates.rivals(methods, reference, eps, NETWORK)
        if not rivals:
            todo = f"got {', '.join(methods) or 'none'}; name one in generate"
            raise ConfigError(f"bench: expected a method whose error is {short(eps)}, {todo}")
        crossovers.append(bench.crossover(config, network, ErrorSizes(eps, np.nan), rivals, reference))
    return BreakEven(plant=plant.name, network=NETWORK, crossover=crossovers, sentence=sentence(crossovers))


def _samples(pipeline: Pipeline, plant: Plant) -> Dataset:
    """The finite rows of some short loops."""
    config = pipeline.generate
    t_end = config.t_end if plant.declares_delay else min(config.t_end, DELAYS * config.longest)
    loops, count = TRACED if plant.traced else CALLED
    size = {"rollouts": loops, "samples": min(count, loops * round(t_end / config.dt)), "t_end": t_end}
    changed = config.model_copy(update=size | {"explore": 0.0, "redraw": 0.0, "data": ""})
    rows = sampling.rows(pipeline.model_copy(update={"generate": changed}), plant, range(loops), finite=False)
    finite = array_checks.finite_rows(rows["X"], rows["u"], rows["D_hat"]) & np.isfinite(rows["P"]).all(axis=(1, 2))
    kept = {name: array[finite] for name, array in rows.items()}
    return Dataset(**kept, test=np.ones(finite.sum(), dtype=np.uint8))


def sentence(crossovers: list[Crossover]) -> str:
    """Whether a network could pay, in words; the errors are in the order of RELATIVE."""
    faster = [c for c in crossovers if c.network_speedup > 1]
    of_each = ((bench.method_on(c.best, c.best_steps), c.best_us, short(c.eps_sup)) for c in crossovers)
    bests = ", ".join(f"{method} {us:.1f} µs at ε = {eps}" for method, us, eps in of_each)
    times = f"the network takes {crossovers[-1].network_us:.1f} µs, {bests}"
    least = " or ".join(f"{c.pays_from_ns:.0f} ns (for {100 * c.eps_relative:.2g} % error)" for c in crossovers)
    here = f"here it takes {crossovers[-1].f_ns:.0f} ns"
    pays = f"A network pays where an evaluation of f takes at least {least}; {here}."
    if not faster:
        return f"No network pays for {crossovers[0].plant}: {times}. {pays}"
    which = ""
    if crossovers[0] not in faster:
        which = f" if its error is {short(faster[0].eps_sup)} or less"
    elif crossovers[-1] not in faster:
        which = f", but not if its error has to be {short(crossovers[-1].eps_sup)}"
    return f"A network could pay for {crossovers[0].plant}{which}: {times}. {pays} Train one to know its error."


def summary(result: BreakEven, width: int | None = None) -> str:
    """The assumptions, a table, and the sentence."""
    rows = [row for crossover in result.crossover for row in crossover.numerical]
    columns = [
        Column("predictor", [*(row.predictor for row in rows), result.network]),
        Column("steps", [*(row.steps for row in rows), None], "d"),
        Column("dx", [*(1 / row.steps for row in rows), None], ".3g"),
        Column("µs", [*(row.median_us for row in rows), result.crossover[0].network_us], ".1f"),
        Column("ε sup", [*(short(row.eps_sup) for row in rows), "not trained"]),
    ]
    upper, lower = (f"{100 * crossover.eps_relative:.2g} %" for crossover in result.crossover)
    errors = f"{upper} (upper rows) and {lower} (lower rows) of the largest |P|"
    about = f"{result.plant}: the fewest steps with which each method errs by at most {errors}"
    return "\n".join([about, "", Table("break_even", "Break-even", columns).terminal(width), "", result.sentence])
