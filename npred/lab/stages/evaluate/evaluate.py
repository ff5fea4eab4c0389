"""The evaluate stage: errors on held-out rows of each kind, closed loops, and the certificate of both."""

from collections.abc import Callable, Iterator, Mapping
from itertools import chain, zip_longest

import numpy as np

from npred import networks as runtimes
from npred.base import randomness
from npred.guard.guarded import Guarded, bare
from npred.lab.config import FROZEN, Evaluate
from npred.lab.config.conditions import EVERY, Condition, Starts, starts
from npred.lab.config.results import NO_ADAPTATION, NUMERICAL, Evaluated, PredictorId
from npred.lab.config.results.evaluate import POOR, Coverage, KindErrors, KindSize, Scores
from npred.lab.report import figures
from npred.lab.report.figures.evaluation_data import LoopSeries
from npred.lab.scheduler.job import Job
from npred.lab.stages.evaluate import accuracy, behaviour
from npred.lab.stages.report import tables
from npred.lab.training.data import shards
from npred.loop import metrics
from npred.loop.closed_loop import Trajectories
from npred.loop.trajectory_views import at_bound
from npred.networks.fused import Fused, lowering
from npred.networks.weights import read
from npred.prediction.methods import Predictor, numerical

FALLBACKS = 0.05  # share of steps with the numerical predictor, above which a guarded network is warned of
BEGUN: dict[str, figures.EvaluationData] = {}  # by pipeline, for its page is written after each stage
SHARES, LEAST = 8, 3  # a task of a compiled predictor has this share of the loops left, and so many at least


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
    at_D = accuracy.in_loop(job.config, begin)
    loops, bounded, in_loop_errors = _all_loops(job, predictors, begin, at_D)
    conditions = {"scenarios": behaviour.run_scenarios(job, predictors)} if config.scenarios else {}
    job.progress.doing("evaluate", "measuring errors")
    taken = accuracy.sample_steps(job.config.seed, config, len(begin.D))[begin.cases] * config.dt
    held_out = accuracy.held_out(job, data)
    fresh = accuracy.fresh(loops[NUMERICAL].part(begin.cases), taken, predictors[NUMERICAL])
    networks = {c: bare(predictor) for c, predictor in predictors.items() if c.is_network}

    def predicted(network: Predictor) -> dict[str, np.ndarray]:
        return {kind: accuracy.predict(network, rows) for kind, rows in held_out.items()}

    with job.threads() as pool:
        P_hat = dict(zip(networks, pool.map(predicted, networks.values()), strict=True))
    accuracy.write(job.folder / "errors.h5", held_out, P_hat)
    models = {}
    for predictor_id in predictors:
        # the numerical predictor is the reference: its errors are 0
        errors, new = accuracy.EXACT.set_values, accuracy.EXACT
        kinds = {kind: KindErrors(**errors, above=0.0) for kind in held_out}
        if network := networks.get(predictor_id):
            kinds = accuracy.by_kind(job.plant, P_hat[predictor_id], held_out)
            errors = {key: value for key, value in next(iter(kinds.values())).set_values.items() if key != "above"}
            new = accuracy.measure(job.plant, accuracy.predict(network, fresh), fresh)
        does = behaviour.scores(job.plant, config, begin, predictor_id, errors["eps_kappa"], loops)
        if bounded:
            does["figure1_bounded"] = behaviour.end(job.plant, behaviour.figure1(config, bounded[predictor_id]))
        models[predictor_id] = Scores(**errors, kinds=kinds, fresh=new, in_loop=in_loop_errors[predictor_id], **does)
    bounds = (0.0, np.inf) if job.plant.declares_delay else config.bounds
    covered = behaviour.coverage(job.plant, data, {c: loops[c] for c in networks}, bounds)
    _warn(job, begin, covered, loops, models)
    behaviour.write_figure1(job.folder / "figure1.h5", config, loops, bounded)
    final = {c: run for c, run in loops.items() if c.epoch is None}
    behaviour.write_coverage(job.folder / "coverage.h5", job.plant, data, final)
    result = Evaluated(
        plant=job.plant.name,
        equilibrium=job.plant.equilibrium.tolist() if job.plant.rests else None,
        gain=metrics.gain(job.plant, config.case_t_end),
        held_out=len(next(iter(held_out.values())).X),
        held_out_kind=next(iter(held_out)),
        kinds={name: KindSize(rows=len(rows.X)) for name, rows in held_out.items()},
        fresh=len(fresh.X),
        in_loop=accuracy.about_in_loop(job.plant, at_D),
        models=models,
        coverage=covered,
        **conditions,
    )
    job.progress.doing("evaluate", "drawing")
    drawn = figures.EvaluationData.read(job.folder, job.plant, config, result)
    for draw in (figures.figure1, figures.figure1_bounded, figures.certificate, figures.coverage):
        if figure := draw(drawn):
            figures.write(figure, job.folder)
    return result


def summary(result: Evaluated, width: int | None = None) -> str:
    """The samples of the errors, and the table of each predictor."""
    return f"{_title(result)}\n\n{tables.predictors(result).terminal(width)}"


def details(result: Evaluated, width: int | None = None) -> str:
    """All tables of the page on errors and loops, wider than most screens."""
    shown = tables.accuracy(result), tables.kinds(result), tables.loops(result), tables.scenarios(None, result)
    texts = [f"{table.title}\n{table.terminal(width)}" for table in shown if table]
    return "\n\n".join([_title(result), *texts])


def _title(result: Evaluated) -> str:
    rows = f"{result.held_out} held-out samples ({result.held_out_kind}), {result.fresh} fresh ones"
    return "\n\n".join(filter(None, [f"{result.plant}: {rows}, and closed loops", result.caution]))


def load_network(job: Job, network_id: PredictorId) -> Predictor:
    """The fused network, as it is deployed but in double precision: in float32 an FNO's loops end 3e-6 away.

    A network that cannot be lowered is evaluated by torch.
    """
    model, epoch, name, nx = network_id.model, network_id.epoch, network_id.name, job.config.evaluate.nx
    operator = read(job.inputs[model], job.plant, epoch, np.float64, job.config.train.table(model))
    if not lowering(operator) and epoch is None:
        job.progress.note(f"evaluate: {model} is evaluated by torch, for it has no fused form")
    if job.device == "cpu" and lowering(operator):
        return Fused(job.plant, operator, nx, name, precision=np.float64)
    return runtimes.predictor("torch", job.plant, operator, nx, name, job.device)


def begun(job: Job) -> figures.EvaluationData:
    """The loop of Fig. 1 with the numerical predictor alone, as long as there is no network; simulated once."""
    if (asked := repr(job.config)) in BEGUN:
        return BEGUN[asked]
    config, begin = job.config.evaluate, starts(job.config, job.plant)

    def series(table: Evaluate) -> dict[PredictorId, LoopSeries]:
        part = begin, slice(0, 1), lambda steps: None  # seconds need no line of progress
        loops = {c: _loops(job, table, c, exact, *part) for c, exact in _exact(job).items()}
        shown = {c: behaviour.figure1(table, run) for c, run in loops.items()}
        return {c: LoopSeries(**{name: getattr(run, name) for name in behaviour.SERIES}) for c, run in shown.items()}

    bounded, none = series(config.bounded) if config.bounded else {}, np.zeros(0)
    BEGUN[asked] = figures.EvaluationData(job.plant, config, {}, 0.0, series(config), none, none, {}, {}, {}, bounded)
    return BEGUN[asked]


def _exact(job: Job) -> dict[PredictorId, Predictor]:
    """The numerical predictor, and the same without adaptation where something adapts."""
    config = job.config.evaluate
    exact = numerical(config.predictor, job.plant, config.nx)
    adapts = config.adaptation != FROZEN and not job.plant.declares_delay
    return {NUMERICAL: exact} | ({NO_ADAPTATION: exact} if adapts else {})


def _predictors(job: Job) -> dict[PredictorId, Predictor]:
    config, predictors = job.config.evaluate, _exact(job)
    exact = predictors[NUMERICAL]
    for model in job.config.train.models:
        for snapshot in [*job.config.train.table(model).snapshots, None]:
            network = load_network(job, PredictorId(model, snapshot))
            guarded = Guarded(network, exact=exact, **dict(config.guard)) if config.guard else network
            predictors[PredictorId(model, snapshot)] = guarded
    return predictors


def _all_loops(
    job: Job, predictors: Mapping[PredictorId, Predictor], begin: Starts, at_D: Condition
) -> tuple[dict[PredictorId, Trajectories], dict[PredictorId, Trajectories], dict[PredictorId, float]]:
    """Every predictor's loops, that of Fig. 1 with U within `figure_bounds` (if any), and its error in the loop.

    In threads: kernels and torch let go of the GIL, and networks need not be sent.
    Shares do not depend on the number of threads, nor do the bytes: all loops at once where a call has a fixed cost to
    share.
    """
    config = job.config.evaluate
    job.progress.doing("evaluate", "compiling")
    for predictor in predictors.values():
        predictor.lanes()  # compiled here, once, not by threads side by side
    adapting = [c for c in predictors if c.adapts]  # with D_hat = D adaptation makes no difference
    counts = {c: begin.of(c) for c in predictors}
    shares = [[(c, part) for part in _parts(counts[c], predictor.compiled)] for c, predictor in predictors.items()]
    steps = sum(counts.values()) * (round(config.case_t_end / config.dt) + 1) + at_D.steps * len(adapting)
    with job.progress.bar("evaluate", steps, "steps") as bar, job.threads() as pool:
        checks = {c: pool.submit(accuracy.in_loop_error, job.plant, predictors[c], at_D, bar.advance) for c in adapting}
        tasks = {c: [] for c in predictors}
        turns = chain.from_iterable(zip_longest(*shares))  # the time left is of a mean pace
        for c, part in filter(None, turns):
            tasks[c].append(pool.submit(_loops, job, config, c, predictors[c], begin, part, bar.advance))
        within = {}
        if (table := config.bounded) is not None:
            within = {c: pool.submit(_loops, job, table, c, p, begin, slice(0, 1)) for c, p in predictors.items()}
        loops = {c: Trajectories.joined([done.result() for done in parts]) for c, parts in tasks.items()}
        bounded = {c: done.result() for c, done in within.items()}
        errors = {c: done.result() for c, done in checks.items()}
        return loops, bounded, errors | {NO_ADAPTATION: errors[NUMERICAL]}


def _parts(count: int, shared: bool) -> Iterator[slice]:
    """The tasks of so many loops: wide ones first, whose lanes take less time, and then short ones, for all cores to
    end together.
    """
    start = 0
    while start < count:
        width = max((count - start) // SHARES, LEAST) if shared else count
        yield slice(start, start := min(start + width, count))


def _loops(
    job: Job, config: Evaluate, predictor_id: PredictorId, predictor: Predictor, begin: Starts, part: slice,
    progress: Callable[[int], None] | None = None,
) -> Trajectories:  # fmt: skip
    taken = None
    if not predictor_id.is_network:
        taken = accuracy.sample_steps(job.config.seed, config, begin.of(predictor_id))[part]
    seed = randomness.integer(job.config.seed, "evaluate", "noise")
    whole = Condition(config, begin.X0, begin.D, begin.D_hat, config.case_t_end, seed, adapts=predictor_id.adapts)
    return whole.part(part).loops(job.plant, predictor, every=EVERY, samples=taken, progress=progress)


def _warn(
    job: Job, begin: Starts, covered: Mapping[str, Coverage], loops: Mapping[PredictorId, Trajectories],
    models: Mapping[PredictorId, Scores],
) -> None:  # fmt: skip
    """Warn of loops that leave the data, that commands end, that stay at a bound, or that the guard answered.

    Where a network itself is poor, its training is the cure, not the data or the bounds.
    """
    poor = {each for each, row in models.items() if each.is_network and row.rel_l2 >= POOR}
    longer = "it predicts poorly, train it longer first"
    for quantity, cover in covered.items():
        cure = "widen generate's box, D or D_hat"
        if job.plant.declares_delay:
            cure = "widen generate's box or lengthen its t_end"
        elif quantity == "D_hat":
            cure = "widen generate's D_hat or narrow bounds"
        for network_id, share in cover.outside.items():
            if share > behaviour.OUTSIDE:
                low, high = cover.data
                job.progress.warn(
                    f"{network_id.name}: {share:.1%} of the loops' steps have {quantity} outside the data's "
                    f"[{low:.3g}, {high:.3g}]; {longer if network_id in poor else cure}"
                )
    behaviour.warn_of_overtaken(job.progress, {c: behaviour.overtaken(run) for c, run in loops.items()})
    for predictor_id, run in loops.items():
        if words := at_bound(run.part(begin.cases)):
            words = f"{words.partition(' and ')[0]}; {longer}" if predictor_id in poor else words
            job.progress.warn(f"{predictor_id.label}, cases: {words}")
    for predictor_id, scores in models.items():
        if (scores.fallback or 0.0) > FALLBACKS:
            job.progress.warn(
                f"{predictor_id.name}: the numerical predictor answered in {scores.fallback:.1%} of the loops' steps; "
                "train it longer, or on wider data, or raise evaluate.guard.tolerance"
            )
