"""The evaluate stage: errors on held-out rows of each kind, what closed loops make of them, the certificate of both."""

from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np

from npred import figures, predictors
from npred.config import FROZEN, Evaluate
from npred.data import shards
from npred.data.dataset import Dataset
from npred.loop import delay_law, metrics
from npred.loop.closed_loop import Trajectories, simulate
from npred.plants import Plant
from npred.predictors import Compiled, Predictor
from npred.stages import Job
from npred.stages.evaluate import (
    accuracy,
    convergence_map,
    coverage,
    figure1,
    held_out_kinds,
    in_loop,
    summary_tables,
)
from npred.stages.evaluate.accuracy import Rows
from npred.stages.evaluate.initial_conditions import Contender, Starts, starts

EVERY = 10  # control steps between two kept states
SHARE = 16  # loops of a compiled predictor in a task
summary, details = summary_tables.summary, summary_tables.details


def run(job: Job) -> dict[str, Any]:
    """For the numerical predictor, without adaptation, and each network and snapshot: errors, cases, map, Fig. 1.

    The errors mse, eps_sup, … are on the data's own held-out rows, of the kind `held_out_kind`; `kinds` has them for
    the rows of each kind, and `in_loop` the largest |P(1, t) - X(t + D)| where D_hat = D.
    Where none adapts, "without adaptation" would be the numerical predictor's loop again and is left out.
    Writes figure1, certificate and coverage (.svg, .png); figure1.h5 (its loops), errors.h5 (where networks err) and
    coverage.h5 (histograms). Warns where loops leave the data.
    """
    config, data = job.config.evaluate, shards.survey(job.inputs["generate"] / "data.h5")
    begin, contenders = starts(job.config, job.plant), _contenders(job)
    loops, in_loops = _all_loops(job, contenders, begin)
    job.progress.doing("evaluate", "measuring errors")
    taken = accuracy.sample_steps(job.config.seed, config, len(begin.D))[begin.cases] * config.dt
    cases = loops["numerical"].part(begin.cases)
    held_out, fresh = held_out_kinds.held_out(job, data), Rows.fresh(cases, taken, contenders[0].predictor)
    P_hat = {c.name: _predicted(c, held_out) for c in contenders if c.network}
    accuracy.write(job.folder / "errors.h5", held_out, P_hat)
    errors = {c.name: _errors(job.plant, c, P_hat, held_out, fresh) | {"in_loop": in_loops[c.name]} for c in contenders}
    models = {c.name: errors[c.name] | _row(job.plant, config, begin, c, errors[c.name], loops) for c in contenders}
    covered = coverage.measure(job.plant, data, {c.name: loops[c.name] for c in contenders if c.network}, config.bounds)
    _warn(job, covered)
    _record(job, data, loops)
    result = {
        "plant": job.plant.name,
        "equilibrium": job.plant.equilibrium.tolist() if job.plant.rests else None,
        "gain": metrics.number(metrics.gain(job.plant, config.case_t_end)),
        "held_out": len(next(iter(held_out.values())).X),
        "held_out_kind": next(iter(held_out)),
        "kinds": {name: {"rows": len(rows.X)} for name, rows in held_out.items()},
        "fresh": len(fresh.X),
        "in_loop": in_loop.about(config, begin),
        "models": models,
        "coverage": covered,
    }
    _draw(job, result)
    return result


def _contenders(job: Job) -> list[Contender]:
    config = job.config.evaluate
    numerical = predictors.numerical(config.predictor, job.plant, config.nx)
    contenders = [Contender("numerical", numerical)]
    if config.adaptation != FROZEN:
        contenders.append(Contender("no_adaptation", numerical, adapts=False))
    for model in job.config.train.models:
        for snapshot in [*job.config.train.table(model).snapshots, None]:
            name = model if snapshot is None else f"{model}@{snapshot}"
            contenders.append(Contender(name, _neural(job, model, snapshot, name), network=True))
    return contenders


def _all_loops(
    job: Job, contenders: list[Contender], begin: Starts
) -> tuple[dict[str, Trajectories], dict[str, float | None]]:
    """Every contender's loops, and its prediction error in the loop.

    In threads: kernels and torch let go of the GIL, and networks need not be sent.
    Shares are of fixed size, so that the bytes do not depend on the number of threads.
    """
    config = job.config.evaluate
    job.progress.doing("evaluate", "compiling")
    for contender in contenders:
        contender.predictor.lanes()  # compiled here, once, not by threads side by side
    known = [contender for contender in contenders if contender.adapts]  # with D_hat = D adaptation makes no difference
    total = sum(begin.of(contender) for contender in contenders) * (round(config.case_t_end / config.dt) + 1)
    total += len(known) * in_loop.steps(config, begin)
    with job.progress.bar("evaluate", total, "steps") as bar, ThreadPoolExecutor(job.jobs) as pool:
        try:
            tasks = {
                c.name: [pool.submit(_loops, job, c, begin, some, bar.advance) for some in _shares(c, begin)]
                for c in contenders
            }
            checks = {c.name: pool.submit(in_loop.error, job, c, begin, bar.advance) for c in known}
            loops = {name: Trajectories.joined([done.result() for done in parts]) for name, parts in tasks.items()}
            errors = {name: metrics.number(done.result()) for name, done in checks.items()}
            return loops, errors | {"no_adaptation": errors["numerical"]}
        except BaseException:
            job.progress.stop()
            pool.shutdown(wait=False, cancel_futures=True)
            raise


def _shares(contender: Contender, begin: Starts) -> list[slice]:
    """The contender's loops, all at once where a call has a fixed cost to share."""
    count = begin.of(contender)
    width = SHARE if isinstance(contender.predictor, Compiled) else count
    return [slice(i, min(i + width, count)) for i in range(0, count, width)]


def _neural(job: Job, model: str, snapshot: int | None, name: str) -> Predictor:
    """The fused network, as it is deployed but in double precision: in float32 an FNO's loops end 3e-6 away.

    A network that sees the clock, or that cannot be lowered, is evaluated by torch.
    """
    import torch

    from npred import operators
    from npred.predictors.neural import Neural
    from npred.runtimes.fused import Fused
    from npred.runtimes.lower import lowering

    operator = operators.load(job.inputs[model], job.plant, snapshot, torch.float64, job.config.train.table(model))
    if not lowering(operator) and snapshot is None:
        job.progress.note(f"evaluate: {model} is evaluated by torch, for it has no fused form")
    if job.device == "cpu" and not job.plant.clocked and lowering(operator):
        return Fused(job.plant, operator, job.config.evaluate.nx, name, precision=np.float64)
    return Neural(job.plant, operator, job.config.evaluate.nx, job.device, name)


def _loops(job: Job, contender: Contender, begin: Starts, some: slice, progress: Any) -> Trajectories:
    config = job.config.evaluate
    taken = None if contender.network else accuracy.sample_steps(job.config.seed, config, begin.of(contender))[some]
    return simulate(
        job.plant, contender.predictor, D=begin.D[some], D_hat=begin.D_hat0[some], X0=begin.X0[some], dt=config.dt,
        t_end=config.case_t_end, adaptation=delay_law.resolve(config) if contender.adapts else None,
        input_bounds=config.input_bounds, u0=config.u0, every=EVERY, samples=taken, progress=progress,
    )  # fmt: skip


def _row(
    plant: Plant, config: Evaluate, begin: Starts, contender: Contender, errors: dict[str, Any],
    loops: dict[str, Trajectories],
) -> dict[str, Any]:  # fmt: skip
    """What is reported of a contender's loops."""
    run, exact = loops[contender.name], loops["numerical"]
    cases, reference = run.part(begin.cases), exact.part(begin.cases)
    target = plant.target(cases.t)
    radii = metrics.radius(cases, target)
    settle, goal = (metrics.settle_time(some, target) for some in (cases, reference))
    settled = np.isfinite(goal) & (goal > 0)
    mapped = contender.adapts and begin.map.stop > begin.map.start
    return {
        "radius": {
            "median": metrics.number(np.median(radii)),
            "worst": metrics.number(radii.max()),
            "converged": float(metrics.converged(radii, target).mean()),
            "cases": len(radii),
            "predicted": metrics.number(metrics.gain(plant, config.case_t_end) * errors["eps_kappa"]),
        },
        "settle_time": metrics.number(np.median(settle)),
        "settle_ratio": _median(settle[settled] / goal[settled]),
        "decay_rate": _median(metrics.decay_rate(cases, target)),
        "map": convergence_map.delay_map(plant, config, run.part(begin.map), exact.part(begin.map)) if mapped else None,
        "figure1": figure1.numbers(plant, figure1.first(config, run)),
    }


def _median(values: np.ndarray) -> float | None:
    """The median without NaN; None where nothing is left."""
    known = values[~np.isnan(values)]
    return metrics.number(np.median(known)) if len(known) else None


def _predicted(contender: Contender, held_out: dict[str, Rows]) -> dict[str, np.ndarray]:
    return {kind: accuracy.predict(contender.predictor, rows) for kind, rows in held_out.items()}


def _errors(
    plant: Plant, contender: Contender, P_hat: dict[str, dict[str, np.ndarray]], held_out: dict[str, Rows], fresh: Rows
) -> dict[str, Any]:
    """On held-out rows of the first kind; `kinds`: on those of each; `fresh`: on rows of this evaluation's loops."""
    if not contender.network:
        exact = {kind: accuracy.EXACT | {"above": 0.0} for kind in held_out}
        return accuracy.EXACT | {"kinds": exact, "fresh": dict(accuracy.EXACT)}
    errors = accuracy.by_kind(plant, P_hat[contender.name], held_out)
    headline = {key: value for key, value in next(iter(errors.values())).items() if key != "above"}
    again = accuracy.measure(plant, accuracy.predict(contender.predictor, fresh), fresh)
    return headline | {"kinds": errors, "fresh": again}


def _warn(job: Job, covered: dict[str, Any]) -> None:
    for quantity, found in covered.items():
        cure = (
            "widen generate's D_hat0 or narrow bounds" if quantity == "D_hat" else "widen generate's box, D or D_hat0"
        )
        for contender, share in found["outside"].items():
            if share > coverage.WARN:
                known = f"[{found['data'][0]:.3g}, {found['data'][1]:.3g}]"
                job.progress.warn(
                    f"{contender}: {share:.1%} of the loops' steps have {quantity} outside the data's {known}; {cure}"
                )


def _record(job: Job, data: Dataset, loops: dict[str, Trajectories]) -> None:
    figure1.write(job.folder / "figure1.h5", {n: figure1.first(job.config.evaluate, run) for n, run in loops.items()})
    named = {name: run for name, run in loops.items() if "@" not in name}
    coverage.write(job.folder / "coverage.h5", job.plant, data, named)


def _draw(job: Job, result: dict[str, Any]) -> None:
    job.progress.doing("evaluate", "drawing")
    evidence = figures.Evidence.read(job.folder, job.plant, job.config.evaluate, result)
    for plate in (figures.figure1(evidence), figures.certificate(evidence), figures.coverage(evidence)):
        figures.write(plate, job.folder)
