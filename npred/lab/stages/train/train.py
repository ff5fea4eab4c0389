"""The train stage: samples in, one trained network with its metrics and snapshots out."""

import json
import shutil
from pathlib import Path
from threading import Lock

import torch

from npred.base import randomness
from npred.lab.config import Training
from npred.lab.config.results import Trained
from npred.lab.scheduler.job import Job
from npred.lab.training import loss, training_loop
from npred.lab.training.captured import own_stream
from npred.lab.training.data import shards
from npred.lab.training.operators import Scaling, checked, save
from npred.lab.training.rows import Fit, Rows, Stream
from npred.networks.domain import Domain
from npred.networks.weights import file_of

SEEDING = Lock()  # torch has one generator for all threads, and another network may be starting beside this one


def run(job: Job) -> Trained:
    """Train job.model on the rows of job.inputs["generate"] that are not held out; the held-out ones give the errors.

    Writes model.safetensors, model.json, domain.safetensors (where the data were), metrics.jsonl and a
    snapshot-E.safetensors for each E of `snapshots`.
    The same bytes for the same configuration, data and number of threads (CPU). Raises ConfigError for an anchor or
    `nodes` that do not fit, DivergedError for a loss that is not finite.
    """
    torch.set_num_threads(1)  # the same bits on any machine; another network takes the other cores
    config = job.config.train.table(str(job.model))
    job.progress.doing(f"train {job.model}", "reading the data")
    task = _task(job, config, job.inputs["generate"] / "data.h5")
    with own_stream(task.test.X.device):
        metrics = training_loop.fit(task, job.scratch, job.progress)
    save(job.folder, task.operator.to("cpu"), config)
    lines = "".join(json.dumps(row) + "\n" for row in metrics)
    (job.folder / "metrics.jsonl").write_text(lines, encoding="utf-8")
    for epoch in config.snapshots:
        shutil.copy(job.scratch / file_of(epoch), job.folder)
    parameters = sum(p.numel() for p in task.operator.parameters())
    size = {"model": job.model, "parameters": parameters, "samples": len(task.train), "epochs": len(metrics)}
    return Trained(**size, **{key: metrics[-1][key] for key in ("loss", "mse", "eps_sup")})


def _task(job: Job, config: Training, path: Path) -> Fit:
    """Rows of one file are held in memory; shards are streamed, and a survey of them gives the errors."""
    data, streamed = shards.survey(path), len(shards.files(path)) > 1
    fitted, held_out = data.subset(test=False), data.subset(test=True)
    rows = Rows.of(fitted, job.device, config.nodes, job.plant.phase(fitted.t))
    test = Rows.of(held_out, job.device, phase=job.plant.phase(held_out.t))
    seed = randomness.integer(job.config.seed, "train", str(job.model))
    stream = Stream(path, job.device, config.nodes, job.plant.phase)
    scaling = Scaling.of_parts(stream.parts) if streamed else Scaling.of(fitted)
    with SEEDING, torch.random.fork_rng(devices=[]):  # the same weights for the same seed, whatever was drawn before
        torch.manual_seed(seed)
        operator = checked(config, job.plant, scaling)
    parts = stream.parts if streamed else lambda: [fitted]
    operator.domain = Domain.of_parts(parts, scaling.X_bend.double().cpu().numpy(), job.plant.phase)
    criterion = loss.Criterion(config.rows, loss.weights(config, job.plant, rows.P))
    operator = operator.to(job.device)  # and the scaling with it, which the domain was made of
    return Fit(f"train {job.model}", operator, config, stream if streamed else rows, test, criterion, seed)
