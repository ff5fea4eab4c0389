"""One training loop for every network: seeded by epoch, resumable, readable from top to bottom."""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import torch

from npred.config import Training
from npred.errors import DivergedError, NpredError, first_line
from npred.operators import io
from npred.parallel import torchrun
from npred.training import captured, checkpoint
from npred.training.captured import Captured
from npred.training.checkpoint import Metrics, Optimiser
from npred.training.eager import Eager, cycle_ends
from npred.training.rows import Fit

Ended = Metrics | DivergedError
Steps = Captured | Eager  # the work of an epoch, for several networks side by side, or for one


def fit(task: Fit, scratch: Path, progress: Any) -> Metrics:
    """Train, one dictionary of metrics per epoch; continues from the checkpoint in `scratch`, if there is one.

    The order of the rows depends on the seed and the epoch alone, the rate on the step. With config.eps it ends with
    the first cycle of the rate that leaves the held-out error as small, and says so where none does.
    Weights after the epochs of config.snapshots stay in `scratch`. Raises DivergedError for a loss that is not finite.
    """
    steps, (metrics,) = _begun([task], [scratch], progress)
    (ended,) = _train(steps, [task], [scratch], [metrics], progress)
    if isinstance(ended, DivergedError):
        raise ended
    if task.config.eps and not _reached(task.config, ended):
        got = f"{ended[-1]['eps_sup']:.2g} after {task.config.epochs} epochs"
        progress.note(f"{task.title}: expected ε sup {task.config.eps:g}, got {got}; raise epochs, the sizes or eps")
    return ended


def fit_side_by_side(tasks: Sequence[Fit], scratches: Sequence[Path], progress: Any) -> Sequence[Ended]:
    """The same for networks that are `captured.alike`, in one graph, each with its own seed, rows and checkpoint.

    Where that fails, and where an interruption left them at different epochs, one after the other. A loss that is not
    finite ends its own network alone, as the DivergedError in its place.
    """
    if len(tasks) == 1:
        return [fit(tasks[0], scratches[0], progress)]
    steps, metrics = _begun(tasks, scratches, progress)
    if steps and len({len(rows) for rows in metrics}) == 1:
        return _train(steps, tasks, scratches, metrics, progress)
    return [_alone(task, scratch, progress) for task, scratch in zip(tasks, scratches, strict=True)]


def _alone(task: Fit, scratch: Path, progress: Any) -> Ended:
    try:
        return fit(task, scratch, progress)
    except DivergedError as error:
        return error


def _begun(tasks: Sequence[Fit], scratches: Sequence[Path], progress: Any) -> tuple[Any, list[Metrics]]:
    """Steps that are ready, and the metrics of the epochs behind: in CUDA graphs, or eager where these fail, and said.

    Several networks have no eager steps: there are none for them then.
    """
    if captured.serves(str(tasks[0].test.X.device)):
        try:
            return _restored(Captured(tasks), tasks, scratches)
        except NpredError:
            raise
        except Exception as error:  # CUDA and torch have many for what a graph cannot hold
            left = "one after the other" if len(tasks) > 1 else "by eager steps, which are slower"
            expected = f"{tasks[0].title}: expected a step that a CUDA graph can hold, got: {first_line(error)}"
            progress.warn(f"{expected}; training {left}")
    return (None, []) if len(tasks) > 1 else _restored(Eager(tasks[0]), tasks, scratches)


def _restored(steps: Steps, tasks: Sequence[Fit], scratches: Sequence[Path]) -> tuple[Steps, list[Metrics]]:
    members = enumerate(zip(tasks, scratches, strict=True))
    metrics = [checkpoint.restore(scratch, task.operator, steps.state(k)) for k, (task, scratch) in members]
    if len({len(rows) for rows in metrics}) == 1:
        steps.begin()
    return steps, metrics


def _train(
    steps: Steps, tasks: Sequence[Fit], scratches: Sequence[Path], metrics: list[Metrics], progress: Any
) -> list[Ended]:  # fmt: skip
    """The epochs that are left, for all of the networks."""
    config, ended = tasks[0].config, list[Ended](metrics)
    title = tasks[0].title if len(tasks) == 1 else f"{tasks[0].title} of {len(tasks)} seeds"
    done = len(metrics[0])
    if done:
        progress.note(f"{title}: resuming at epoch {done + 1} of {config.epochs}")
    with progress.bar(title, config.epochs, "epochs", done=done) as bar:
        for task, rows in zip(tasks, metrics, strict=True):
            for row in rows:
                progress.measured(task.title, row)
        for epoch in range(done + 1, config.epochs + 1):
            if _reached(config, metrics[0]):
                break
            losses = steps.epoch(epoch, bar)
            for k, loss in enumerate(losses):
                if not math.isfinite(loss) and ended[k] is metrics[k]:
                    ended[k] = _diverged(tasks[k], loss, epoch)
            going = [k for k in range(len(tasks)) if ended[k] is metrics[k]]
            if not going:
                break
            measured = steps.errors()
            for k in going:
                metrics[k].append({"epoch": epoch, "lr": steps.lr, "loss": losses[k], **measured[k]})
                _keep(tasks[k], scratches[k], steps.state(k), metrics[k])
                progress.measured(tasks[k].title, metrics[k][-1])
            last = metrics[going[0]][-1]
            bar.advance(1, f"loss {last['loss']:.2e}, ε sup {last['eps_sup']:.2e}")
    return ended


def _diverged(task: Fit, loss: float, epoch: int) -> DivergedError:
    expected = f"{task.title}: expected a finite loss, got {loss} in epoch {epoch}"
    return DivergedError(f"{expected}; lower lr={task.config.lr:g}")


def _reached(config: Training, metrics: Metrics) -> bool:
    """Whether the stated error is reached at the end of a cycle: within one the rate is high, and the error is not the
    network's best.
    """
    return bool(config.eps) and len(metrics) in cycle_ends(config) and metrics[-1]["eps_sup"] <= config.eps


def _keep(task: Fit, scratch: Path, optimiser: Optimiser, metrics: Metrics) -> None:
    """The snapshot and the checkpoint after an epoch, if they are due."""
    if task.config.eps:  # all processes end in the same epoch
        eps = torch.tensor(metrics[-1]["eps_sup"], dtype=torch.float64, device=task.test.X.device)
        metrics[-1]["eps_sup"] = torchrun.mean(eps)
    if torchrun.number() > 0:
        return
    if len(metrics) in task.config.snapshots:
        io.save_weights(scratch / io.weights(len(metrics)), task.operator)
    if len(metrics) % task.config.checkpoint_every == 0:
        checkpoint.save(scratch, task.operator, optimiser, metrics)
