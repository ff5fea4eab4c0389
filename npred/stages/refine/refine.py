"""The refine stage: a network trained further on its failures, and what that buys and costs."""

import json
from dataclasses import replace

import numpy as np
import torch

from npred import operators, randomness
from npred.config import GuardTable, Training
from npred.data import shards
from npred.data.dataset import Dataset
from npred.data.domain import Domain
from npred.operators import Operator
from npred.predictors import Predictor, numerical
from npred.predictors.guarded import Guarded
from npred.results import Contender, Refined
from npred.results.refine import HostileLoops, Refinement
from npred.stages import Job
from npred.stages.certify import certify
from npred.stages.evaluate import networks
from npred.stages.refine import failures, hostile
from npred.stages.refine.failures import Failures
from npred.terminal.console import columns
from npred.terminal.progress_bars import counted
from npred.training import loss, training_loop
from npred.training.training_loop import Fit, Rows


def run(job: Job) -> Refined:
    """Train job.model of job.inputs on from its weights, one round, and compare it with what it was.

    The rows: a share of the data's, an adversary's, and those of hostile loops that the guard refused; the guard is
    that of [evaluate], or the default one. Compared on inputs of other seeds: held-out rows, fresh rollouts, a search
    against each of the two, nominal and hostile loops. Writes model.safetensors, model.json, domain.safetensors and
    metrics.jsonl as train does. Raises DivergedError for a loss that is not finite.
    """
    torch.set_num_threads(1)  # the same bits on any machine; another network takes the other cores
    name, table = str(job.model), job.config.refine_table
    data = shards.survey(job.inputs["generate"] / "data.h5")
    before = _guard(job, name)
    adversarial, refused = failures.adversarial(job, before, data), failures.refused(job, before, data)
    operator = operators.load(job.inputs[name], job.plant, None, config=job.config.train.table(name))
    errors, rows = _train(job, operator.to(job.device), data, [adversarial, refused])
    there = replace(job, inputs=job.inputs | {name: job.folder})
    operator.domain = _domain(job, operator, adversarial, refused)
    operators.save(job.folder, operator.to("cpu"), job.config.train.table(name), job.plant)
    guards = {Contender(name): before, Contender(name, refined=True): _guard(there, f"{name} refined")}
    size = {"adversary": len(adversarial), "fallbacks": len(refused), "data": rows, "epochs": table.epochs}
    loops = table.loops * len(hostile.kinds(job, data))
    return Refined(model=name, loops=loops, models=_compared(job, guards, data, errors), **size)


def summary(result: Refined, width: int | None = None) -> str:
    """What was trained on, and a row before and after."""
    head = ["network", "MSE", "ε sup", "ε κ", "adversary", "median", "blind", "hostile fallback", "lost", "guarded"]
    rows = [
        [contender.label, f"{r.mse:.2g}", f"{r.eps_sup:.2g}", f"{r.certificate.eps_kappa:.1e}",
         f"{r.certificate.adversarial:.2g}", f"{r.certificate.adversarial_median:.2g}",
         f"{r.certificate.blind} of {r.certificate.blind_calls}", f"{r.fallback:.2%}", str(r.lost), str(r.lost_guarded)]
        for contender, r in result.models.items()
    ]  # fmt: skip
    about = (
        f"{result.model}: {counted(result.epochs, 'epochs')} of {result.data} rows of the data, {result.adversary} of "
        f"an adversary and {result.fallbacks} that the guard refused; {result.loops} hostile loops"
    )
    return f"{about}\n\n{columns(head, rows, width, numbers=head[1:])}"


def _guard(job: Job, name: str) -> Guarded:
    """The guarded network of job.inputs."""
    config = job.config.evaluate
    exact = numerical(config.predictor, job.plant, config.nx)
    return Guarded(networks.load(job, str(job.model), None, name), exact=exact, **dict(config.guard or GuardTable()))


def _train(job: Job, operator: Operator, data: Dataset, added: list[Failures]) -> tuple[list[dict[str, float]], int]:
    """Errors on held-out rows before and after, and how many of the data's rows it saw. Writes metrics.jsonl."""
    table, config = job.config.refine_table, job.config.train.table(str(job.model))
    config: Training = config.model_copy(update={"epochs": table.epochs, "lr": table.lr, "snapshots": []})
    fitted, held_out = data.subset(test=False), data.subset(test=True)
    test = Rows.of(held_out, job.device, phase=job.plant.phase(held_out.t))
    old = Rows.of(fitted, job.device, config.nodes, job.plant.phase(fitted.t))
    seed = randomness.integer(job.config.seed, "refine", str(job.model))
    chosen = torch.randperm(len(old), generator=torch.Generator().manual_seed(seed))[: round(table.old * len(old))]
    new = [Rows.of(part, job.device, config.nodes, job.plant.phase(part.t)) for part in added if len(part)]
    criterion = loss.criterion(config.rows, loss.weights(config, job.plant, old.P))
    errors = [training_loop.errors(operator, test)]
    rows = Rows.joined([old[chosen.to(job.device)], *new])
    task = Fit(f"refine {job.model}", operator.train().requires_grad_(True), config, rows, test, criterion, seed)
    metrics = training_loop.fit(task, job.scratch, job.progress)
    text = "".join(json.dumps(row) + "\n" for row in metrics)
    (job.folder / "metrics.jsonl").write_text(text, encoding="utf-8")
    return [*errors, training_loop.errors(operator.eval().requires_grad_(False), test)], len(chosen)


def _domain(job: Job, operator: Operator, adversarial: Failures, refused: Failures) -> Domain | None:
    """The domain that the guard is to trust: that of the data, or widened by rows that were trained on too."""
    rows = {"data": [], "loops": [refused], "all": [refused, adversarial]}[job.config.refine_table.domain]
    domain = operator.domain
    for part in rows:
        domain = domain and domain.widened(part.X, part.u, part.D_hat, job.plant.phase(part.t))
    return domain


def _compared(
    job: Job, guards: dict[Contender, Guarded], data: Dataset, errors: list[dict[str, float]]
) -> dict[Contender, Refinement]:  # fmt: skip
    exact = next(iter(guards.values())).exact
    certificates = certify.certificates(job, guards, exact, data).models
    kept = {kind: ~certify.lost(job, loops) for kind, loops in hostile.loops(job, exact, data, "test")}
    compared = {}
    for (contender, guard), error in zip(guards.items(), errors, strict=True):
        by_kind = _hostile(job, guard, data, kept)
        total = {key: sum(getattr(row, key) for row in by_kind.values()) for key in ("lost", "lost_guarded")}
        limit = guard.domain.limit.item() if guard.domain else np.inf
        compared[contender] = Refinement(
            **error, **total, limit=limit, certificate=certificates[contender], hostile=by_kind,
            fallback=float(np.mean([row.fallback for row in by_kind.values()])),
        )  # fmt: skip
    return compared


def _hostile(job: Job, guard: Guarded, data: Dataset, kept: dict[str, np.ndarray]) -> dict[str, HostileLoops]:
    def lost(predictor: Predictor) -> dict[str, tuple[int, float]]:
        return {
            kind: (int((certify.lost(job, loops) & kept[kind]).sum()), loops.fallback_share)
            for kind, loops in hostile.loops(job, predictor, data, "test")
        }

    bare, guarded = lost(guard.model), lost(guard)
    return {
        kind: HostileLoops(lost=bare[kind][0], lost_guarded=guarded[kind][0], fallback=guarded[kind][1])
        for kind in kept
    }
