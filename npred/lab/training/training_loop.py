"""One training loop for every network: seeded by epoch, resumable, readable from top to bottom."""

import hashlib
import json
import math
from collections.abc import Callable
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file
from torch import Tensor, nn

from npred.base import json_files, randomness
from npred.base.errors import DivergedError, StoreError, first_line
from npred.lab.config import Training
from npred.lab.training import captured
from npred.lab.training.operators import Operator
from npred.lab.training.rows import REST_NODES, Fit, Rows
from npred.lab.training.soap import SOAP, GraphSOAP
from npred.networks.weights import file_of

CHECKPOINT = "checkpoint.safetensors"
CHUNK = 1024  # rows of a call without gradients
WARM_UP = 0.05  # share of the steps in which the one-cycle rate climbs
CYCLES = 4  # cycles of that rate in a training that may end before its last epoch, each twice as long as the one before
Metrics = list[dict[str, Any]]


def fit(task: Fit, scratch: Path, progress: Any) -> Metrics:
    """Train, one dictionary of metrics per epoch; continues from the checkpoint in `scratch`, if there is one.

    The order of the rows depends on the seed and the epoch alone, the rate on the step. With config.eps it ends with
    the first cycle of the rate that leaves the held-out error as small, and says so where none does.
    Weights after the epochs of config.snapshots stay in `scratch`. Raises DivergedError for a loss that is not finite.
    """
    config, count, title = task.config, len(task.train), task.title
    optimiser, step, metrics = _begun(task, scratch, progress)
    done = len(metrics)
    if done:
        at = f"resuming at epoch {done + 1} of {config.epochs}"
        progress.note(f"{title}: {at if done < config.epochs else f'all {done} epochs were done before'}")
    with progress.bar(title, config.epochs, "epochs", done=done) as bar:
        for row in metrics:
            progress.measured(title, row)
        for epoch in range(done + 1, config.epochs + 1):
            if _reached(config, metrics):
                break
            order = torch.Generator().manual_seed(randomness.integer(task.seed, "order", epoch))
            total, lr = torch.zeros((), device=task.test.X.device), 0.0
            for number, rows in enumerate(task.train.batches(order, config.batch)):
                lr = rate(config, epoch - 1 + number * config.batch / count)
                for group in optimiser.param_groups:
                    group["lr"] = group["lr"].fill_(lr) if isinstance(group["lr"], Tensor) else lr  # a graph reads it
                total += step(rows) * len(rows)
                bar.advance(0)  # Ctrl-C in another thread ends this one here
            loss = float(total) / count
            if not math.isfinite(loss):
                expected = f"{title}: expected a finite loss, got {loss} in epoch {epoch}"
                raise DivergedError(f"{expected}; lower lr={config.lr:g}")
            metrics.append({"epoch": epoch, "lr": lr, "loss": loss, **errors(task.operator, task.test)})
            if epoch in config.snapshots:
                task.operator.weights().save(scratch / file_of(epoch))
            if epoch % config.checkpoint_every == 0:
                save_checkpoint(scratch, task.operator, optimiser, metrics)
            progress.measured(title, metrics[-1])
            bar.advance(1, f"loss {loss:.2e}, ε sup {metrics[-1]['eps_sup']:.2e}")
    if config.eps and not _reached(config, metrics):
        got = f"{metrics[-1]['eps_sup']:.2g} after {config.epochs} epochs"
        progress.note(f"{title}: expected ε sup {config.eps:g}, got {got}; raise epochs, the sizes or eps")
    return metrics


def _begun(task: Fit, scratch: Path, progress: Any) -> tuple[torch.optim.Optimizer, Callable[[Rows], Tensor], Metrics]:
    """The optimiser, the step that it takes with a batch, and the metrics of the epochs behind, from the checkpoint.

    On a GPU the step is a CUDA graph; where a graph cannot hold it, it is eager, and a message says so.
    """
    device = task.test.X.device
    if captured.serves(str(device)):
        optimiser = optimiser_of(task.operator, task.config, torch.zeros((), device=device))
        metrics = restored(scratch, task.operator, optimiser)
        try:
            return optimiser, captured.CapturedStep(task, optimiser, partial(step, task, optimiser)), metrics
        except Exception as error:  # CUDA and torch have many for what a graph cannot hold
            expected = f"{task.title}: expected a step that a CUDA graph can hold, got: {first_line(error)}"
            progress.warn(f"{expected}; training by eager steps, which are slower")
    optimiser = optimiser_of(task.operator, task.config)
    return optimiser, partial(step, task, optimiser), restored(scratch, task.operator, optimiser)


def optimiser_of(operator: Operator, config: Training, rate: Tensor | None = None) -> torch.optim.Optimizer:
    """The optimiser of a network. With `rate`, a tensor for the learning rate, a CUDA graph can hold its step."""
    parameters, decay = operator.parameters(), config.weight_decay
    if config.optimiser == "soap":
        return SOAP(parameters, config.lr, decay) if rate is None else GraphSOAP(parameters, rate, decay)
    if rate is None:  # [Kingma and Ba 2015]
        return torch.optim.Adam(parameters, config.lr, weight_decay=decay, fused=True)
    return torch.optim.Adam(parameters, rate, weight_decay=decay, fused=True, capturable=True)


def step(task: Fit, optimiser: torch.optim.Optimizer, rows: Rows) -> Tensor:
    """Forward, backward and the optimiser's step for a batch; its mean loss before that step."""
    P_hat = task.operator(rows.X, rows.u, rows.D_hat, rows.phase, REST_NODES, rows.stride)
    loss = task.loss(P_hat, rows.P)
    optimiser.zero_grad()
    loss.backward()
    optimiser.step()
    return loss.detach()


def rate(config: Training, epochs: float) -> float:
    """The learning rate after so many epochs, a fraction allowed.

    one-cycle [Smith and Topin 2018]: up in a straight line, down along a cosine; with config.eps several times, each
    twice as long [warm restarts, Loshchilov and Hutter 2017]. step: halved every 50 epochs [DAPF].
    """
    if config.schedule == "step":
        return config.lr * 0.5 ** (int(epochs) // 50)
    ends = [0, *cycle_ends(config)]
    start, end = next(pair for pair in pairwise(ends) if epochs < pair[1] or pair[1] == ends[-1])
    done = (epochs - start) / (end - start)
    if done < WARM_UP:
        return config.lr * (0.04 + 0.96 * done / WARM_UP)
    return config.lr * (1e-4 + 0.5 * (1 + math.cos(math.pi * (done - WARM_UP) / (1 - WARM_UP))))


def cycle_ends(config: Training) -> list[int]:
    """The epochs after which the one-cycle rate has come down: the last one, or with config.eps also some before."""
    count = CYCLES if config.eps else 1
    return sorted({math.ceil(config.epochs * (2**k - 1) / (2**count - 1)) for k in range(1, count + 1)})


def _reached(config: Training, metrics: Metrics) -> bool:
    """Whether the stated error is reached at the end of a cycle: within one, the error is not the network's best."""
    return bool(config.eps) and len(metrics) in cycle_ends(config) and metrics[-1]["eps_sup"] <= config.eps


@torch.no_grad()
def errors(operator: Operator, rows: Rows) -> dict[str, float]:
    """mse, the mean square of P_hat - P in raw units, and eps_sup = sup |P_hat - P| (Euclid), over rows and nodes."""
    squares, sup = 0.0, 0.0
    for start in range(0, len(rows), CHUNK):
        part = rows[start : start + CHUNK]
        square = (operator(part.X, part.u, part.D_hat, part.phase) - part.P).square()
        squares += float(square.sum(dtype=torch.float64))
        sup = max(sup, float(square.sum(-1).max()))
    return {"mse": squares / rows.P.numel(), "eps_sup": math.sqrt(sup)}


def save_checkpoint(folder: Path, network: nn.Module, optimiser: torch.optim.Optimizer, metrics: Metrics) -> None:
    """Write parameters, buffers and the optimiser's moments as tensors, the metrics so far as JSON in the header.

    The file is complete or absent: it is written beside its name, synced and renamed. It holds a digest of all that is
    in it and of the snapshots beside it: a bit that flips must not become a result. Nothing is ever unpickled.
    """
    partial = folder / f"{CHECKPOINT}.partial"
    moments = {
        f"optimiser/{index}/{key}": tensor.clone()  # several may be views of one tensor, which no file may hold
        for index, state in optimiser.state_dict()["state"].items()
        for key, tensor in state.items()
    }
    tensors = {**network.state_dict(), **moments}
    snapshots = {path.name: json_files.sha256(path) for path in sorted(folder.glob("snapshot-*.safetensors"))}
    texts = {"metrics": json.dumps(metrics), "snapshots": json.dumps(snapshots)}  # parts of the result as they are
    save_file(tensors, partial, metadata=texts | {"sha256": _digest(tensors, texts)})
    json_files.sync(partial)
    partial.replace(folder / CHECKPOINT)


def restored(folder: Path, network: nn.Module, optimiser: torch.optim.Optimizer) -> Metrics:
    """Load the folder's checkpoint in place, if there is one; the metrics of the epochs behind it, else none.

    Raises StoreError for a file that is broken or was changed, and for such a snapshot.
    """
    path = folder / CHECKPOINT
    if not path.exists():
        return []
    try:
        with safe_open(path, framework="pt") as file:
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118 - no mapping
            texts = file.metadata()
        if texts.pop("sha256", "") != _digest(tensors, texts):
            raise ValueError("other bytes than were written")
        for name, digest in json_files.parse(texts["snapshots"]).items():
            if not (folder / name).is_file() or json_files.sha256(folder / name) != digest:
                raise ValueError(f"{name} missing or with other bytes than were written")
        network.load_state_dict({name: tensors.pop(name) for name in network.state_dict()})
        state: dict[int, dict[str, Tensor]] = {}
        for name, tensor in tensors.items():
            _, index, key = name.split("/")
            state.setdefault(int(index), {})[key] = tensor
        optimiser.load_state_dict({"state": state, "param_groups": optimiser.state_dict()["param_groups"]})
        return json_files.parse(texts["metrics"])
    except (OSError, SafetensorError, ValueError, KeyError, TypeError, RuntimeError) as error:
        expected = f"{path}: expected a checkpoint, got: {first_line(error)}"
        raise StoreError(f"{expected}; delete it to start over") from None


def _digest(tensors: dict[str, Tensor], texts: dict[str, str]) -> str:
    """The sha256 of names, types, shapes and bytes of tensors, and of the texts beside them."""
    digest = hashlib.sha256(json.dumps(texts, sort_keys=True).encode())
    for name, tensor in sorted(tensors.items()):
        digest.update(f"{name} {tensor.dtype} {tuple(tensor.shape)}".encode())
        digest.update(tensor.detach().cpu().contiguous().flatten().view(torch.uint8).numpy().data)
    return digest.hexdigest()
