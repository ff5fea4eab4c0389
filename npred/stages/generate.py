"""The generate stage: rollouts with a numerical predictor, and samples of (X, u, D_hat) -> P taken from them."""

import os
import threading
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from multiprocessing import get_context, parent_process
from pathlib import Path
from typing import Any

import numpy as np

from npred import plants
from npred.adaptation import DelayAdaptation
from npred.closed_loop import LANES, simulate
from npred.config import Pipeline
from npred.dataset import Dataset, attributes
from npred.errors import DivergedError
from npred.plants import Plant
from npred.predictors import METHODS
from npred.stages import Job, draws

Rows = dict[str, np.ndarray]


def run(job: Job) -> dict[str, Any]:
    """Write data.h5: `samples` rows from `rollouts` closed loops, split by rollout.

    A rollout's start, delays and times come from its own child seed and rollouts go in chunks of fixed size, so the
    bytes do not depend on the number of jobs. With `data`, that file's samples instead, checked against the plant.
    Raises DivergedError, naming the rollout, where a state is not finite.
    """
    config = job.config.generate
    if config.data:
        return _given(job, Path(config.data))
    chunks = [range(i, min(i + LANES, config.rollouts)) for i in range(0, config.rollouts, LANES)]
    with job.progress.bar("generate", config.rollouts * draws.steps(config), "steps") as bar:
        parts = dict(_in_process(job, chunks, bar) if min(job.jobs, len(chunks)) == 1 else _in_pool(job, chunks, bar))
    rows = {name: np.concatenate([parts[chunk.start][name] for chunk in chunks]) for name in parts[0]}
    held_out = draws.held_out(job.config.seed, config)
    data = Dataset(**rows, test=np.isin(rows["rollout"], held_out).astype(np.uint8))
    data.write(job.folder / "data.h5", attributes(job.plant, config.predictor))
    return {"samples": len(data), "rollouts": config.rollouts, "held_out": sorted(held_out.tolist()), "nx": config.nx}


def summary(result: dict[str, Any]) -> str:
    """The data in a line."""
    return (
        f"{result['samples']} samples of {result['rollouts']} rollouts on {result['nx']} nodes, "
        f"{len(result['held_out'])} rollouts held out"
    )


def _given(job: Job, path: Path) -> dict[str, Any]:
    """The samples of a file in the place of simulated ones."""
    data = Dataset.read(path)
    data.fit(job.plant)
    data.write(job.folder / "data.h5", attributes(job.plant, "imported"))
    held_out = np.unique(data.rollout[data.test == 1]).tolist()
    rollouts = len(np.unique(data.rollout))
    return {"samples": len(data), "rollouts": rollouts, "held_out": held_out, "nx": data.u.shape[1]}


def _in_process(job: Job, chunks: list[range], bar: Any) -> Iterator[tuple[int, Rows]]:
    for chunk in chunks:
        yield chunk.start, rollouts(job.config, job.plant, chunk, bar.advance)


def _in_pool(job: Job, chunks: list[range], bar: Any) -> Iterator[tuple[int, Rows]]:
    """Processes start afresh: a fork would copy the threads' locks of whatever the caller has loaded."""
    workers = min(job.jobs, len(chunks), os.cpu_count() or 1)
    with ProcessPoolExecutor(workers, get_context("spawn"), _end_with_parent) as pool:
        tasks = {pool.submit(task, job.config, chunk): chunk for chunk in chunks}
        try:
            for done in as_completed(tasks):
                bar.advance(len(tasks[done]) * draws.steps(job.config.generate))
                yield tasks[done].start, done.result()
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise


def _end_with_parent() -> None:
    """A worker whose parent was killed waits for tasks for ever, unless it watches."""

    def watch() -> None:
        parent = parent_process()
        assert parent is not None
        parent.join()
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


def task(config: Pipeline, chunk: range) -> Rows:
    """The rows of a chunk, in a process of its own."""
    return rollouts(config, plants.resolve(config.plant, config.parameters), chunk)


def rollouts(pipeline: Pipeline, plant: Plant, chunk: range, progress: Any = None) -> Rows:
    """The rows of rollouts `chunk`: closed loops from random starts, sampled at random steps, P by the predictor."""
    config = pipeline.generate
    X0, D, D_hat0, steps = draws.starts(pipeline.seed, config, plant, chunk)
    predictor = METHODS[config.predictor](plant, config.nx)
    law = DelayAdaptation(config.gamma, config.b, config.bounds)
    loops = simulate(
        plant, predictor, D=D, D_hat=D_hat0, X0=X0, t_end=config.t_end, dt=config.dt, adaptation=law,
        input_bounds=config.input_bounds, every=draws.steps(config), samples=steps, progress=progress,
    )  # fmt: skip
    _finite(chunk, X0, loops.escaped, config.dt)
    count = steps.shape[1]
    D_hat = draws.redrawn(pipeline.seed, config, chunk, loops.samples.D_hat)
    rows = {"X": loops.samples.X, "u": loops.samples.u, "D_hat": D_hat}
    rows["P"] = predictor(rows["X"], rows["u"], rows["D_hat"])
    rows |= {"D": np.repeat(D[:, None], count, 1), "t": steps * config.dt}
    rows["rollout"] = np.repeat(np.array(chunk, dtype=np.int32)[:, None], count, 1)
    kept = np.arange(count) < np.array([draws.samples(config, r) for r in chunk])[:, None]
    return {name: array[kept] for name, array in rows.items()}


def _finite(chunk: range, X0: np.ndarray, escaped: np.ndarray, dt: float) -> None:
    lost = np.flatnonzero(escaped >= 0)
    if len(lost):
        first = lost[np.argmin(escaped[lost])]
        raise DivergedError(
            f"generate: expected finite states, got NaN in rollout {chunk[first]} at t = {escaped[first] * dt:g} s, "
            f"from X0 = {X0[first].tolist()} ({len(lost)} of {len(chunk)} rollouts); shrink the box, D or dt"
        )
