"""The training loop: it learns, repeats itself to the bit, and goes on where it was stopped."""

from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import torch
from operator_samples import PLANT, SMALL, operator, samples
from silent import Silent

from npred.base.errors import ConfigError, DivergedError, StoreError
from npred.lab.config import DeepONet, Training
from npred.lab.training import training_loop
from npred.lab.training.loss import Criterion, weights
from npred.lab.training.rows import Fit, Rows
from npred.lab.training.training_loop import cycle_ends, errors, rate

NETWORKS = pytest.mark.parametrize("config", SMALL, ids=["deeponet", "fno"])


def task(config: Training, seed: int = 0, **changes: object) -> Fit:
    config = config.model_copy(update={"epochs": 6, "batch": 16, "checkpoint_every": 2, **changes})
    train, test = Rows.of(samples(40)), Rows.of(samples(10, seed=1))
    loss = Criterion(config.rows, weights(config, PLANT, train.P))
    return Fit("train tiny", operator(config, seed), config, train, test, loss, seed=11)


def folder(path: Path) -> Path:
    path.mkdir()
    return path


def state(trained: Fit) -> dict[str, torch.Tensor]:
    return {name: tensor.clone() for name, tensor in trained.operator.state_dict().items()}


def same(a: dict[str, torch.Tensor], b: dict[str, torch.Tensor]) -> bool:
    return a.keys() == b.keys() and all(torch.equal(a[name], b[name]) for name in a)


@NETWORKS
def test_learns_a_few_samples_by_heart(config, tmp_path):
    few = task(config, epochs=400, batch=10, lr=1e-2, checkpoint_every=400, loss="standardised")
    few = replace(few, train=few.train[:10], test=few.train[:10])
    metrics = training_loop.fit(few, tmp_path, Silent())
    assert metrics[-1]["loss"] < 1e-2 * metrics[0]["loss"]
    assert metrics[-1]["mse"] < 1e-2 * metrics[0]["mse"]


@NETWORKS
def test_interrupted_training_ends_where_an_uninterrupted_one_does(config, tmp_path):
    whole, broken, resumed = task(config), task(config), task(config)
    metrics = training_loop.fit(whole, folder(tmp_path / "whole"), Silent())
    scratch = folder(tmp_path / "broken")
    with pytest.raises(KeyboardInterrupt):
        training_loop.fit(broken, scratch, Silent(stop_after=4))
    assert not same(state(broken), state(whole))
    progress = Silent()
    assert training_loop.fit(resumed, scratch, progress) == metrics
    assert [values["epoch"] for _, values in progress.measurements] == [*range(1, 1 + len(metrics))]
    assert progress.done == 6 and progress.calls == 2  # the checkpoint stood after epoch 4
    assert progress.notes[0].endswith(": resuming at epoch 5 of 6")
    assert same(state(resumed), state(whole))


def test_a_training_that_had_ended_says_so_and_trains_nothing(tmp_path):
    first, again, progress = task(SMALL[0], checkpoint_every=1), task(SMALL[0], checkpoint_every=1), Silent()
    metrics = training_loop.fit(first, tmp_path, Silent())
    assert training_loop.fit(again, tmp_path, progress) == metrics and progress.calls == 0
    assert progress.notes[0].endswith(": all 6 epochs were done before")
    assert same(state(again), state(first))


def test_same_seed_same_bits_and_another_seed_others(tmp_path):
    runs = [task(SMALL[0]), task(SMALL[0]), replace(task(SMALL[0]), seed=12)]
    for k, run in enumerate(runs):
        training_loop.fit(run, folder(tmp_path / str(k)), Silent())
    assert same(state(runs[0]), state(runs[1])) and not same(state(runs[0]), state(runs[2]))


def test_snapshot_is_the_model_of_that_epoch(tmp_path):
    """A step schedule does not look ahead, so three epochs of six are the first three."""
    long = task(SMALL[0], schedule="step", snapshots=[3])
    short = task(SMALL[0], schedule="step", epochs=3)
    training_loop.fit(long, folder(tmp_path / "long"), Silent())
    training_loop.fit(short, folder(tmp_path / "short"), Silent())
    early = task(SMALL[0], seed=9)
    early.operator.load_state_dict(torch_file(tmp_path / "long" / "snapshot-3.safetensors"))
    assert same(state(early), state(short)) and not same(state(early), state(long))


def test_a_training_to_a_stated_error_ends_with_the_first_cycle_that_reaches_it(tmp_path):
    progress = Silent()
    whole = training_loop.fit(task(SMALL[0], epochs=30, eps=1e-9), folder(tmp_path / "whole"), progress)
    assert len(whole) == 30 and "train tiny: expected ε sup 1e-09, got" in progress.notes[-1]
    ends = [2, 6, 14, 30]
    left = [whole[end - 1]["eps_sup"] for end in ends]
    best = min(left[:3])
    expected = whole[: ends[left.index(best)]]
    for progress in (Silent(), Silent()):  # the second time from the checkpoint: what has ended goes on no further
        stated = task(SMALL[0], epochs=30, eps=best, checkpoint_every=1)
        (tmp_path / "stated").mkdir(exist_ok=True)
        assert training_loop.fit(stated, tmp_path / "stated", progress) == expected
        assert not any("expected" in note for note in progress.notes)


def test_the_rate_comes_down_where_a_training_may_end():
    config = task(SMALL[0], epochs=30, eps=1.0).config
    assert cycle_ends(config) == [2, 6, 14, 30]
    for start, end in pairwise([0, 2, 6, 14, 30]):
        rates = [rate(config, epochs) / config.lr for epochs in np.linspace(start, end - 1e-9, 101)]
        assert rates[0] < 0.05 and rates[-1] < 1e-3 and max(rates) > 0.99
        assert np.argmax(rates) == 5
    assert cycle_ends(task(SMALL[0], epochs=1, eps=1.0).config) == [1]


def torch_file(path: Path) -> dict[str, torch.Tensor]:
    from safetensors.torch import load_file

    return load_file(path)


def test_metrics_of_each_epoch(tmp_path):
    progress = Silent()
    trained = task(SMALL[0])
    metrics = training_loop.fit(trained, tmp_path, progress)
    assert [row["epoch"] for row in metrics] == [1, 2, 3, 4, 5, 6]
    assert set(metrics[0]) == {"epoch", "lr", "loss", "mse", "eps_sup"}
    assert errors(trained.operator, trained.test) == {k: metrics[-1][k] for k in ("mse", "eps_sup")}
    assert "loss" in progress.notes[-1]


def test_errors_by_hand():
    trained = task(SMALL[0])
    rows = trained.test
    with torch.no_grad():
        gap = (trained.operator(rows.X, rows.u, rows.D_hat) - rows.P).double().numpy()
    measured = errors(trained.operator, rows)
    np.testing.assert_allclose(measured["mse"], (gap**2).mean(), rtol=1e-5)
    np.testing.assert_allclose(measured["eps_sup"], np.linalg.norm(gap, axis=-1).max(), rtol=1e-5)


def test_loss_that_is_not_finite_is_an_error_in_one_line(tmp_path):
    bad = task(SMALL[0])
    bad.train.P[3] = torch.nan
    with pytest.raises(
        DivergedError, match=r"^train tiny: expected a finite loss, got nan in epoch 1; lower lr[^\n]*$"
    ):
        training_loop.fit(bad, tmp_path, Silent())


def test_broken_checkpoint_names_the_file(tmp_path):
    training_loop.fit(task(SMALL[0]), tmp_path, Silent())
    path = tmp_path / training_loop.CHECKPOINT
    path.write_bytes(path.read_bytes()[:-100])
    with pytest.raises(
        StoreError, match=r"checkpoint\.safetensors: expected a checkpoint, got.*delete it to start over"
    ):
        training_loop.fit(task(SMALL[0]), tmp_path, Silent())


@NETWORKS
def test_a_flipped_bit_anywhere_in_a_checkpoint_is_found(config, tmp_path):
    """In the header as in the tensors and the metrics: what is resumed becomes a result that counts as sound."""
    training_loop.fit(task(config), tmp_path, Silent())
    path, draw = tmp_path / training_loop.CHECKPOINT, np.random.default_rng(0)
    whole = path.read_bytes()
    header = 8 + int.from_bytes(whole[:8], "little")
    for position in [*draw.integers(0, header, 20), *draw.integers(header, len(whole), 20)]:
        content = bytearray(whole)
        content[position] ^= 1 << draw.integers(8)
        path.write_bytes(content)
        with pytest.raises(StoreError, match=r"checkpoint\.safetensors: expected a checkpoint, got: "):
            training_loop.fit(task(config), tmp_path, Silent())
    path.write_bytes(whole)
    training_loop.fit(task(config), tmp_path, Silent())


@pytest.mark.parametrize("damage", ["flip", "remove"])
def test_a_snapshot_that_changed_since_the_checkpoint_is_found(tmp_path, damage):
    training_loop.fit(task(SMALL[0], snapshots=[1]), tmp_path, Silent())
    path = tmp_path / "snapshot-1.safetensors"
    content = path.read_bytes()
    path.write_bytes(content[:-1] + bytes([content[-1] ^ 1]))
    if damage == "remove":
        path.unlink()
    with pytest.raises(StoreError, match=r"got: snapshot-1\.safetensors missing or with other bytes.*start over"):
        training_loop.fit(task(SMALL[0], snapshots=[1]), tmp_path, Silent())


def test_checkpoint_leaves_no_partial_file(tmp_path):
    training_loop.fit(task(SMALL[0]), tmp_path, Silent())
    assert [path.name for path in tmp_path.iterdir()] == [training_loop.CHECKPOINT]


def test_rates():
    cycle = DeepONet(epochs=100, lr=1e-3)
    assert rate(cycle, 0) == pytest.approx(4e-5)
    assert rate(cycle, 5) == pytest.approx(1e-3, rel=1e-3)
    assert rate(cycle, 100) == pytest.approx(1e-7)
    steps = DeepONet(epochs=500, lr=1e-3, schedule="step")
    assert [rate(steps, e) for e in (0, 49.9, 50, 107)] == [1e-3, 1e-3, 5e-4, 2.5e-4]


def test_rows_on_every_second_node():
    data = samples(3, nx=21)
    rows = Rows.of(data, nodes=11)
    assert rows.stride == 2 and Rows.of(data).stride == 1
    np.testing.assert_allclose(rows.u, data.u.astype(np.float32))
    np.testing.assert_allclose(rows.P, data.P[:, ::2].astype(np.float32))
    assert len(rows) == 3


@pytest.mark.parametrize("nodes", [4, 41])
def test_nodes_that_do_not_fit_the_grid(nodes):
    with pytest.raises(ConfigError, match=f"nodes: expected nodes - 1 to divide the data's 20 intervals, got {nodes}"):
        Rows.of(samples(3, nx=21), nodes=nodes)
