"""The evaluate stage: errors on held-out rows of each kind, what closed loops make of them, the certificate of both."""

from collections.abc import Callable, Mapping
from itertools import chain, zip_longest
from typing import Any

import numpy as np

from npred.base import randomness
from npred.guard.guarded import Guarded, bare
from npred.lab.config import FROZEN, Evaluate
from npred.lab.config.conditions import EVERY, Condition, Starts, starts
from npred.lab.config.results import NO_ADAPTATION, NUMERICAL, Evaluated, PredictorId
from npred.lab.config.results.evaluate import Coverage, KindErrors, KindSize, Scores
from npred.lab.report import figures
from npred.lab.report.terminal.console import Console
from npred.lab.scheduler.job import Job
from npred.lab.stages.evaluate import accuracy, behaviour, coverage, in_loop, networks, scenarios, summary_tables
from npred.lab.stages.evaluate.accuracy import EXACT, Labelled
from npred.lab.training.data import shards
from npred.loop import metrics
from npred.loop.closed_loop import Trajectories
from npred.loop.trajectory_views import at_bound
from npred.plants import Plant
from npred.prediction.methods import Predictor, numerical

FALLBACKS = 0.05  # share of steps with the numerical predictor, above which a guarded network is warned of
SHARE = 3  # loops of a compiled predictor in a task
summary, details = summary_tables.summary, summary_tables.details


def run(job: Job) -> Evaluated:
    """For the numerical predictor, without adaptation, and each network and snapshot: errors, cases, map, Fig. 1.

    The errors mse, eps_sup, … are on the data's held-out rows, of the kind `held_out_kind`; `kinds` has them for
    the rows of each kind, and `in_loop` the largest |P(1, t) - X(t + D)| where D_hat = D.
    Where none adapts, "without adaptation" would be the numerical predictor's loop again and is left out. With
    `scenarios`, the cases under other conditions too.
    With `guard`, networks are guarded in loops, and `fallback` is how often; errors are those of the bare networks.
    Writes figure1, certificate, coverage and, with `figure_bounds`, figure1_bounded (.svg, .png); figure1.h5 (loops),
    errors.h5 (where networks err) and coverage.h5 (histograms). Warns where loops leave the data, or end since commands
    would overtake each other.
    """
    config, data = job.config.evaluate, shards.survey(job.inputs["generate"] / "data.h5")
    begin, predictors = starts(job.config, job.plant), _predictors(job)
    loops, in_loops = _all_loops(job, predictors, begin)
    bounded = _bounded_loops(job, predictors, begin)
    conditions = {"scenarios": scenarios.run(job, predictors)} if config.scenarios else {}
    job.progress.doing("evaluate", "measuring errors")
    taken = accuracy.sample_steps(job.config.seed, config, len(begin.D))[begin.cases] * config.dt
    cases = loops[NUMERICAL].part(begin.cases)
    held_out, fresh = accuracy.held_out(job, data), Labelled.fresh(cases, taken, predictors[NUMERICAL])
    bare_networks = {c: networks.on_any_grid(job, bare(predictors[c])) for c in predictors if c.is_network}
    P_hat = {
        contender: {kind: accuracy.predict(predictor, rows) for kind, rows in held_out.items()}
        for contender, predictor in bare_networks.items()
    }
    accuracy.write(job.folder / "errors.h5", held_out, P_hat)
    models = {}
    for contender in predictors:
        errors = _errors(job.plant, bare_networks.get(contender), P_hat.get(contender, {}), held_out, fresh)
        does = behaviour.scores(job.plant, config, begin, contender, errors["eps_kappa"], loops)
        if bounded:
            does["figure1_bounded"] = behaviour.end(job.plant, behaviour.figure1(config, bounded[contender]))
        models[contender] = Scores(**errors, in_loop=in_loops[contender], **does)
    bounds = (0.0, np.inf) if job.plant.declares_delay else config.bounds
    covered = coverage.measure(job.plant, data, {c: loops[c] for c in bare_networks}, bounds)
    _warn(job, covered)
    behaviour.warn_of_overtaken(job.progress, {c: behaviour.overtaken(run) for c, run in loops.items()})
    for contender, run in loops.items():
        if words := at_bound(run.part(begin.cases)):
            job.progress.warn(f"{contender.label}, cases: {words}")
    _warn_of_fallbacks(job.progress, models)
    behaviour.write_figure1(job.folder / "figure1.h5", config, loops, bounded)
    coverage.write(job.folder / "coverage.h5", job.plant, data, {c: loops[c] for c in loops if c.epoch is None})
    result = Evaluated(
        plant=job.plant.name,
        equilibrium=job.plant.equilibrium.tolist() if job.plant.rests else None,
        gain=metrics.gain(job.plant, config.case_t_end),
        held_out=len(next(iter(held_out.values())).X),
        held_out_kind=next(iter(held_out)),
        kinds={name: KindSize(rows=len(rows.X)) for name, rows in held_out.items()},
        fresh=len(fresh.X),
        in_loop=in_loop.about(job.plant, config, begin),
        models=models,
        coverage=covered,
        **conditions,
    )
    _draw(job, result)
    return result


def _predictors(job: Job) -> dict[PredictorId, Predictor]:
    config = job.config.evaluate
    exact = numerical(config.predictor, job.plant, config.nx)
    predictors: dict[PredictorId, Predictor] = {NUMERICAL: exact}
    if config.adaptation != FROZEN and not job.plant.declares_delay:
        predictors[NO_ADAPTATION] = exact
    for model in job.config.train.models:
        for snapshot in [*job.config.train.table(model).snapshots, None]:
            contender = PredictorId(model, snapshot)
            network, guard = networks.load(job, contender), config.guard
            predictors[contender] = Guarded(network, exact=exact, **dict(guard)) if guard else network
    return predictors


def _all_loops(
    job: Job, predictors: Mapping[PredictorId, Predictor], begin: Starts
) -> tuple[dict[PredictorId, Trajectories], dict[PredictorId, float]]:
    """Every contender's loops, and its prediction error in the loop.

    In threads: kernels and torch let go of the GIL, and networks need not be sent.
    Shares are of fixed size, so that the bytes do not depend on the number of threads.
    """
    config = job.config.evaluate
    job.progress.doing("evaluate", "compiling")
    for predictor in predictors.values():
        predictor.lanes()  # compiled here, once, not by threads side by side
    adapting = [c for c in predictors if c.adapts]  # with D_hat = D adaptation makes no difference
    at_D = in_loop.condition(job.config, begin)
    starts = sum(begin.of(c) for c in predictors)
    steps = starts * (round(config.case_t_end / config.dt) + 1) + at_D.steps * len(adapting)
    with job.progress.bar("evaluate", steps, "steps") as bar, job.threads() as pool:
        checks = {c: pool.submit(in_loop.error, job.plant, predictors[c], at_D, bar.advance) for c in adapting}
        turns = zip_longest(*([(c, part) for part in _shares(p, begin.of(c))] for c, p in predictors.items()))
        tasks = {c: [] for c in predictors}
        for c, part in filter(None, chain.from_iterable(turns)):  # in turns: the time left is of a mean pace
            tasks[c].append(pool.submit(_loops, job, config, c, predictors[c], begin, part, bar.advance))
        loops = {c: Trajectories.joined([done.result() for done in parts]) for c, parts in tasks.items()}
        errors = {c: done.result() for c, done in checks.items()}
        return loops, errors | {NO_ADAPTATION: errors[NUMERICAL]}


def _bounded_loops(
    job: Job, predictors: Mapping[PredictorId, Predictor], begin: Starts
) -> dict[PredictorId, Trajectories]:
    """The loop of Fig. 1 with U within `figure_bounds`, of every contender; empty without these."""
    table = job.config.evaluate.bounded
    if table is None:
        return {}
    with job.threads() as pool:
        tasks = {c: pool.submit(_loops, job, table, c, p, begin, slice(0, 1)) for c, p in predictors.items()}
        return {c: task.result() for c, task in tasks.items()}


def _shares(predictor: Predictor, count: int) -> list[slice]:
    """A contender's loops, all at once where a call has a fixed cost to share."""
    width = SHARE if predictor.compiled else count
    return [slice(i, min(i + width, count)) for i in range(0, count, width)]


def _loops(
    job: Job, config: Evaluate, contender: PredictorId, predictor: Predictor, begin: Starts, part: slice,
    progress: Callable[[int], None] | None = None,
) -> Trajectories:  # fmt: skip
    taken = None if contender.is_network else accuracy.sample_steps(job.config.seed, config, begin.of(contender))[part]
    seed = randomness.integer(job.config.seed, "evaluate", "noise")
    whole = Condition(config, begin.X0, begin.D, begin.D_hat0, config.case_t_end, seed, adapts=contender.adapts)
    return whole.part(part).loops(job.plant, predictor, every=EVERY, samples=taken, progress=progress)


def _errors(
    plant: Plant, network: Predictor | None, P_hat: Mapping[str, np.ndarray], held_out: Mapping[str, Labelled],
    fresh: Labelled,
) -> dict[str, Any]:  # fmt: skip
    """By key of Scores: errors on held-out rows of the first kind, on those of each, and on this evaluation's loops.

    The numerical predictor's, which is no network, are 0: it is the reference.
    """
    if network is None:
        exact = {kind: KindErrors(**EXACT.set_values, above=0.0) for kind in held_out}
        return EXACT.set_values | {"kinds": exact, "fresh": EXACT}
    kinds = accuracy.by_kind(plant, P_hat, held_out)
    first = next(iter(kinds.values())).set_values
    del first["above"]
    return first | {"kinds": kinds, "fresh": accuracy.measure(plant, accuracy.predict(network, fresh), fresh)}


def _warn(job: Job, covered: Mapping[str, Coverage]) -> None:
    for quantity, cover in covered.items():
        cure = (
            "widen generate's box or lengthen its t_end" if job.plant.declares_delay
            else "widen generate's D_hat0 or narrow bounds" if quantity == "D_hat"
            else "widen generate's box, D or D_hat0"
        )  # fmt: skip
        for contender, share in cover.outside.items():
            if share > coverage.WARN:
                low, high = cover.data
                job.progress.warn(
                    f"{contender.name}: {share:.1%} of the loops' steps have {quantity} outside the data's "
                    f"[{low:.3g}, {high:.3g}]; {cure}"
                )


def _warn_of_fallbacks(progress: Console, models: Mapping[PredictorId, Scores]) -> None:
    for contender, scores in models.items():
        if (scores.fallback or 0.0) > FALLBACKS:
            progress.warn(
                f"{contender.name}: the numerical predictor answered in {scores.fallback:.1%} of the loops' steps; "
                "train it longer, or on wider data, or raise evaluate.guard.tolerance"
            )


def _draw(job: Job, result: Evaluated) -> None:
    job.progress.doing("evaluate", "drawing")
    data = figures.EvaluationData.read(job.folder, job.plant, job.config.evaluate, result)
    kinds = figures.figure1, figures.figure1_bounded, figures.certificate, figures.coverage
    for figure in filter(None, (kind(data) for kind in kinds)):
        figures.write(figure, job.folder)
