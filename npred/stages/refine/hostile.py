"""Hostile loops: first estimates at the bounds, a delay that jumps, noisy sensors, a disturbance at the input."""

from collections.abc import Iterator
from typing import Any

import numpy as np

from npred import randomness
from npred.config import FROZEN, Disturbance, Evaluate, Sensors
from npred.data.dataset import Dataset
from npred.loop import configured
from npred.loop.closed_loop import Trajectories
from npred.predictors import Predictor
from npred.stages import Job
from npred.stages.certify import rollouts
from npred.stages.evaluate.scenarios import EVERY
from npred.stages.generate import sampling

NOISE = 0.05  # of a sample of the state, relative to it
PUSH = 0.25  # amplitude of the disturbance, of the range of the data's inputs
SWINGS = 10  # of the disturbance in a loop
JUMP = 0.2  # of a loop's length: when the delay jumps


def kinds(job: Job, data: Dataset) -> dict[str, dict[str, Any]]:
    """The kinds of loops by name, each as what differs from the table [evaluate], from D and from the estimate."""
    config = job.config.evaluate
    swing = Disturbance(amplitude=PUSH * float(np.ptp(data.u)), omega=2 * np.pi * SWINGS / config.case_t_end)
    changes: dict[str, dict[str, Any]] = {
        f"noise {NOISE:.0%}": {"table": {"measurement": Sensors(noise=NOISE)}},
        f"input + {swing.amplitude:.2g} sin": {"table": {"disturbance": swing}},
    }
    if job.plant.declares_delay or config.adaptation == FROZEN:
        return changes
    (low, high), (shortest, longest) = config.bounds, job.config.generate.explore_D
    at = JUMP * config.case_t_end
    return changes | {
        f"D̂(0) = {low:g}": {"D_hat": low},
        f"D̂(0) = {high:g}": {"D_hat": high},
        f"D from {longest:g} to {shortest:g}": {"D": lambda t: longest if t < at else shortest},
    }


def loops(
    job: Job, predictor: Predictor, data: Dataset, purpose: str, samples: np.ndarray | None = None
) -> Iterator[tuple[str, Trajectories]]:  # fmt: skip
    """The loops of each kind, from starts and with noise that `purpose` draws; `samples` as for npred.simulate."""
    number, config = job.config.refine_table.loops, job.config.evaluate
    pipeline = rollouts.fresh(job.config, job.config.certify_table, number)
    seed = randomness.integer(pipeline.seed, "refine", purpose)
    X0, D, D_hat, _ = sampling.starts(seed, pipeline.generate, job.plant, range(number))
    for name, different in kinds(job, data).items():
        table: Evaluate = config.model_copy(update=different.get("table", {}))
        with job.progress.bar(f"{predictor.name}: {name}", number * (steps(config) + 1), "steps") as bar:
            yield name, configured.loops(
                job.plant, predictor, table, D=different.get("D", D), D_hat=different.get("D_hat", D_hat), X0=X0,
                t_end=config.case_t_end, seed=seed, every=EVERY, samples=samples, progress=bar.advance,
            )  # fmt: skip


def steps(config: Evaluate) -> int:
    """The control steps of a loop."""
    return round(config.case_t_end / config.dt)
