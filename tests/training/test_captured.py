"""The texts of the graphs, run on the CPU, train as the plain steps do.

In float64 and with one factorisation of the bases, so that what differs is the text and not the rounding: SOAP makes
much of that. The bases' own factorisation is in test_graph_soap.py.
"""

from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from fake_gpu import Away, FakeGpu
from operator_samples import NETWORKS, PLANT, SMALL, operator, samples
from silent import Silent
from torch import Tensor, nn
from torch.overrides import TorchFunctionMode
from torch.utils._pytree import tree_leaves

from npred.lab.config import Training
from npred.lab.training import captured, soap, training_loop
from npred.lab.training.captured import CapturedStep, NotCapturable, OnDevice
from npred.lab.training.loss import Criterion, weights
from npred.lab.training.operators import Operator
from npred.lab.training.rows import Fit, Rows
from npred.lab.training.training_loop import Metrics

CHANGES = {"epochs": 4, "batch": 6, "checkpoint_every": 2, "snapshots": [3], "weight_decay": 1e-3}


def task(config: Training, seed: int = 0, dtype: torch.dtype = torch.float64, **changes: object) -> Fit:
    """Seven steps an epoch, the last of a smaller batch: bases turn twice."""
    config = config.model_copy(update=CHANGES | changes)
    train, test = Rows.of(samples(40, seed=2 * seed), nodes=11), Rows.of(samples(10, seed=2 * seed + 1))
    train, test = (Rows(*(a.to(dtype) for a in rows.columns)) for rows in (train, test))
    loss = Criterion(config.rows, weights(config, PLANT, train.P))
    return Fit("train tiny", operator(config, seed).to(dtype), config, train, test, loss, seed=11 + seed)


def folder(path: Path) -> Path:
    path.mkdir()
    return path


@pytest.fixture
def graphs(monkeypatch: pytest.MonkeyPatch) -> None:
    """The texts of the graphs where a GPU has the graphs."""
    monkeypatch.setattr(captured, "serves", lambda device: True)
    one_factorisation(monkeypatch)


def one_factorisation(monkeypatch: pytest.MonkeyPatch) -> None:
    """The plain optimiser's."""
    monkeypatch.setattr(soap, "turned_bases", lambda A, Q: torch.linalg.qr(A @ Q)[0])


def close(found: Metrics, expected: Metrics, rtol: float = 1e-5) -> None:
    for row, other in zip(found, expected, strict=True):
        np.testing.assert_allclose(list(row.values()), list(other.values()), rtol=rtol)


def close_weights(a: Fit, b: Fit) -> None:
    torch.testing.assert_close(dict(a.operator.state_dict()), dict(b.operator.state_dict()), rtol=1e-4, atol=1e-6)


def both(config: Training, path: Path, monkeypatch: pytest.MonkeyPatch, **changes: object) -> list[tuple[Fit, Metrics]]:
    """The training by plain steps and by the texts."""
    runs = []
    for name, graphs in (("plain", False), ("texts", True)):
        monkeypatch.setattr(captured, "serves", lambda device, graphs=graphs: graphs)
        run = task(config, **changes)
        progress = Silent()
        runs.append((run, training_loop.fit(run, folder(path / name), progress)))
        assert not any("expected" in note for note in progress.notes)
    return runs


def test_with_its_own_bases_it_learns_as_well(tmp_path, monkeypatch):
    (_, expected), (_, found) = both(SMALL[0], tmp_path, monkeypatch, epochs=30, dtype=torch.float32)
    close(found[-1:], expected[-1:], rtol=0.2)
    close(found[:2], expected[:2], rtol=1e-3)


@NETWORKS
def test_the_text_trains_as_the_plain_steps_do(config, tmp_path, monkeypatch):
    one_factorisation(monkeypatch)
    (plain, expected), (text, found) = both(config, tmp_path, monkeypatch)
    close(found, expected)
    close_weights(text, plain)
    assert {p.name for p in (tmp_path / "texts").iterdir()} == {p.name for p in (tmp_path / "plain").iterdir()}


@pytest.mark.parametrize(
    "changes",
    [{"optimiser": "adam", "lr": 1e-3}, {"schedule": "step", "rows": "square", "loss": "raw"}, {"anchor": "none"},
     {"eps": 30.0, "snapshots": []}],
    ids=["adam", "published", "no anchor", "stated error"],
)  # fmt: skip
def test_every_setting_of_a_training(changes, tmp_path, monkeypatch):
    one_factorisation(monkeypatch)
    (_, expected), (_, found) = both(SMALL[0], tmp_path, monkeypatch, **changes)
    close(found, expected)


@pytest.mark.parametrize("first", [True, False], ids=["texts first", "plain first"])
def test_either_goes_on_where_the_other_was_stopped(first, tmp_path, monkeypatch):
    one_factorisation(monkeypatch)
    (_, expected), _ = both(SMALL[0], tmp_path, monkeypatch)
    scratch = folder(tmp_path / "broken")
    monkeypatch.setattr(captured, "serves", lambda device: first)
    with pytest.raises(KeyboardInterrupt):
        training_loop.fit(task(SMALL[0]), scratch, Silent(stop_after=2))
    monkeypatch.setattr(captured, "serves", lambda device: not first)
    progress = Silent()
    close(training_loop.fit(task(SMALL[0]), scratch, progress), expected)
    assert progress.notes[0] == "train tiny: resuming at epoch 3 of 4"


def test_resumed_by_the_texts_it_is_the_same_to_the_bit(tmp_path, graphs):
    whole, resumed, scratch = task(SMALL[1]), task(SMALL[1]), folder(tmp_path / "broken")
    metrics = training_loop.fit(whole, folder(tmp_path / "whole"), Silent())
    with pytest.raises(KeyboardInterrupt):
        training_loop.fit(task(SMALL[1]), scratch, Silent(stop_after=3))
    assert training_loop.fit(resumed, scratch, Silent()) == metrics
    assert all(torch.equal(a, b) for a, b in zip(
        whole.operator.state_dict().values(), resumed.operator.state_dict().values(), strict=True))  # fmt: skip


class Reading(nn.Module):
    """A network whose forward does what a graph cannot hold."""

    def __init__(self, inner: nn.Module, how: str) -> None:
        super().__init__()
        self.inner, self.how = inner, how

    def forward(self, X: Tensor, u: Tensor, D_hat: Tensor, stride: int = 1) -> Tensor:
        if self.how == "item":
            X = X * (1.0 if X.sum().item() else 2.0)
        elif self.how == "bool":
            X = X if X.sum() > 0 else X.clone()
        elif self.how == "mask":
            X = X + X[X > 1e9].sum()
        elif self.how == "nonzero":
            X = X + 0 * torch.nonzero(X).sum()
        return self.inner(X, u, D_hat, stride)


@pytest.mark.parametrize("how", ["item", "bool", "mask", "nonzero"])
def test_what_a_graph_cannot_hold_is_trained_eagerly_and_said_in_a_line(how, tmp_path, graphs):
    run, plain = task(SMALL[0]), task(SMALL[0])
    run.operator.network = Reading(run.operator.network, how)
    progress = Silent()
    metrics = training_loop.fit(run, folder(tmp_path / "reads"), progress)
    (line,) = [note for note in progress.notes if "expected" in note]
    assert line.startswith("train tiny: expected a step that a CUDA graph can hold, got: ") and "\n" not in line
    assert line.endswith("reads numbers of the GPU on the host; training by eager steps, which are slower")
    captured_too = training_loop.fit(plain, folder(tmp_path / "plain"), Silent())
    close(metrics, captured_too)  # what the failed capture had moved was put back


def test_a_capture_that_raises_leaves_all_as_it_was(tmp_path, graphs, monkeypatch):
    def fails(text: Any, device: Any, pool: Any = None) -> Any:
        text()
        raise RuntimeError("CUDA error: operation not permitted when stream is capturing\nmore of it")

    expected = training_loop.fit(task(SMALL[0]), folder(tmp_path / "whole"), Silent())
    monkeypatch.setattr(captured, "record", fails)
    progress = Silent()
    close(training_loop.fit(task(SMALL[0]), folder(tmp_path / "failed"), progress), expected)
    assert "got: CUDA error: operation not permitted when stream is capturing; training" in " ".join(progress.notes)


class Strict(TorchFunctionMode):
    """No tensor of the host's is made, none is read there, and none moves."""

    BANNED = {"item", "tolist", "numpy", "cpu", "__bool__", "__float__", "__int__", "__index__", "nonzero"}

    def __torch_function__(self, func: Any, types: Any, args: tuple[Any, ...] = (), kwargs: Any = None) -> Any:
        assert func.__name__ not in self.BANNED, func
        result = func(*args, **(kwargs or {}))
        made = [a for a in tree_leaves(result) if isinstance(a, Tensor)]
        assert all(isinstance(a, Away) for a in made), f"{func} makes a tensor of the host's"
        return result


@NETWORKS
def test_nothing_in_a_captured_text_meets_the_host(config, monkeypatch):
    """On a device that only seems to be a GPU; its arithmetic is the CPU's."""
    plain = task(config, dtype=torch.float32)
    monkeypatch.setattr(captured, "record", lambda text, device, pool: (text(), (text, None))[1])  # fills the caches
    monkeypatch.setattr(torch.cuda, "get_rng_state", lambda device: None)
    monkeypatch.setattr(torch.cuda, "set_rng_state", lambda state, device: None)
    with FakeGpu():
        train, test = (Rows(*(a.to("cuda") for a in rows.columns)) for rows in (plain.train, plain.test))
        loss = replace(plain.loss, weights=plain.loss.weights.to("cuda"))
        moved = replace(plain, operator=away(plain.operator), train=train, test=test, loss=loss)
        optimiser = training_loop.optimiser_of(moved.operator, config, torch.zeros(()).to("cuda"))
        step = CapturedStep(moved, optimiser, partial(training_loop.step, moved, optimiser))
        with Strict(), OnDevice():
            for size in step.graphs:
                step.text(size)


def away(module: Operator) -> Operator:
    """The operator with buffers and parameters on the device, these as plain leaves."""
    leaves: list[Tensor] = []
    for part in module.modules():
        for name, buffer in list(part.named_buffers(recurse=False)):
            setattr(part, name, buffer.to("cuda"))
        for name, parameter in list(part.named_parameters(recurse=False)):
            leaves.append(parameter.detach().to("cuda").requires_grad_())
            del part._parameters[name]
            setattr(part, name, leaves[-1])
        if isinstance(part, nn.RNNBase):
            part._flat_weights = [getattr(part, name) for name in part._flat_weights_names]
    module.parameters = lambda recurse=True: iter(leaves)  # type: ignore[method-assign]
    return module


def test_the_guard_of_the_captured_texts_sees_reads_and_copies():
    x = torch.ones(3)
    for read in (lambda: float(x[0]), lambda: bool(x[0] > 0), lambda: x[x > 0], lambda: torch.nonzero(x),
                 lambda: torch.unique(x), lambda: x.to("meta")):  # fmt: skip
        with pytest.raises(NotCapturable), OnDevice():
            read()
    with OnDevice():
        x.double().copy_(x)
