"""The train stage: samples in, one trained network with its metrics and snapshots out."""

import json
import shutil
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from threading import Lock
from typing import Any, NamedTuple, Self

import torch

from npred import plants, randomness
from npred.config import Pipeline, Training
from npred.data import shards
from npred.data.domain import Domain
from npred.operators import Operator, Scaling, checked, io, save
from npred.parallel import side_by_side, torchrun
from npred.results import Trained
from npred.stages.job import Job
from npred.terminal.console import Console
from npred.training import captured, loss, training_loop
from npred.training.checkpoint import Metrics
from npred.training.cuda_graph import own_stream
from npred.training.rows import Fit, Rows, Stream

SEEDING = Lock()  # torch has one generator for all threads, and another network may be starting beside this one


def run(job: Job) -> Trained:
    """Train job.model on the rows of job.inputs["generate"] that are not held out; the held-out ones give the errors.

    Started by torchrun, its processes share each batch; this one alone writes.
    Writes model.safetensors, model.json, domain.safetensors (where the data were), metrics.jsonl and a
    snapshot-E.safetensors for each E of `snapshots`.
    The same bytes for the same configuration, data and number of threads (CPU). Raises ConfigError for an anchor or
    `nodes` that do not fit, DivergedError for a loss that is not finite.
    """
    torch.set_num_threads(1)  # the same bits on any machine; another network takes the other cores
    with torchrun.together(_Order.of(job)):
        task, metrics = _fit(job)
    _write(job, task.config, task.operator.to("cpu"), metrics)
    parameters = sum(p.numel() for p in task.operator.parameters())
    size = {"model": job.model, "parameters": parameters, "samples": len(task.train), "epochs": len(metrics)}
    return Trained(**size, **{key: metrics[-1][key] for key in ("loss", "mse", "eps_sup")})


class _Order(NamedTuple):
    """A training to help with."""

    config: Pipeline
    data: Path
    scratch: Path
    device: str
    model: str | None

    @classmethod
    def of(cls, job: Job) -> Self:
        """The part of a job that the helpers need."""
        folders = job.inputs["generate"].absolute(), job.scratch.absolute()
        return cls(job.config.located(), *folders, job.device, job.model)

    def job(self, progress: Console) -> Job:
        """The job as a helper sees it, who writes nothing."""
        plant = plants.resolve(self.config.plant, self.config.parameters, self.config.kappa)
        inputs = {"generate": self.data}
        return Job(self.config, plant, self.scratch, inputs, self.scratch, self.device, 1, progress, self.model)


def help_out(progress: Console) -> None:
    """The work of all processes of torchrun but the first: their part of each batch, training by training."""
    torch.set_num_threads(1)
    while order := torchrun.receive():
        _fit(order.job(progress))


def _fit(job: Job) -> tuple[Fit, list[dict[str, Any]]]:
    config = job.config.train.table(str(job.model))
    job.progress.doing(f"train {job.model}", "reading the data")
    task = _task(replace(job, device=torchrun.device(job.device)), config, job.inputs["generate"] / "data.h5")
    return task, side_by_side.together((task, job.scratch), lambda several: _trained(several, job.progress))


def _trained(several: Sequence[tuple[Fit, Path]], progress: Console) -> list[Metrics | Exception]:
    """The metrics of each network: those of the same shapes trained in one graph, the others one after the other."""
    groups: dict[object, list[int]] = defaultdict(list)
    for number, (task, _) in enumerate(several):
        groups[captured.alike(task) or number].append(number)
    ended: dict[int, Metrics | Exception] = {}
    for numbers in groups.values():
        tasks, scratches = zip(*(several[number] for number in numbers), strict=True)
        try:
            with own_stream(tasks[0].test.X.device):
                outcomes = training_loop.fit_side_by_side(tasks, scratches, progress)
        except Exception as error:
            outcomes = [error] * len(numbers)
        ended.update(zip(numbers, outcomes, strict=True))
    return [ended[number] for number in range(len(several))]


def _task(job: Job, config: Training, path: Path) -> Fit:
    """Rows of one file are held in memory; shards are streamed, and a survey of them gives the errors."""
    data, streamed = shards.survey(path), len(shards.files(path)) > 1
    fitted, held_out = data.subset(test=False), data.subset(test=True)
    rows = Rows.of(fitted, job.device, config.nodes, job.plant.phase(fitted.t))
    test = Rows.of(held_out, job.device, phase=job.plant.phase(held_out.t))
    seed = randomness.integer(job.config.seed, "train", str(job.model))
    stream = Stream(path, job.device, config.nodes, job.plant.phase)
    scaling = Scaling.of_parts(stream.parts) if streamed else Scaling.of(fitted)
    operator = _untrained(job.plant, config, scaling, seed)
    parts = stream.parts if streamed else lambda: [fitted]
    operator.domain = Domain.of_parts(parts, scaling.X_bend.double().cpu().numpy(), job.plant.phase)
    criterion = loss.criterion(config.rows, loss.weights(config, job.plant, rows.P))
    operator = operator.to(job.device)  # and the scaling with it, which the domain was made of
    return Fit(f"train {job.model}", operator, config, stream if streamed else rows, test, criterion, seed)


def _untrained(plant: plants.Plant, config: Training, scaling: Scaling, seed: int) -> Operator:
    """The same weights for the same seed, whatever was drawn before; torch's generator is left as it was."""
    with SEEDING, torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        return checked(config, plant, scaling)


def _write(job: Job, config: Training, operator: Operator, metrics: list[dict[str, Any]]) -> None:
    save(job.folder, operator, config)
    lines = "".join(json.dumps(row) + "\n" for row in metrics)
    (job.folder / "metrics.jsonl").write_text(lines, encoding="utf-8")
    for epoch in config.snapshots:
        shutil.copy(job.scratch / io.weights(epoch), job.folder)
