"""What needs a GPU, by `make gpu`: graphs that are really captured, and the stages there."""

import json
import os
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest
import torch
from conftest import TINY, process_environment
from operator_samples import EVERY, NETWORKS, PLANT, operator, samples
from silent import Silent

from npred.base import devices
from npred.base.registry import short_name
from npred.lab.config import DeepONet, Training
from npred.lab.training import captured, training_loop
from npred.lab.training.loss import Criterion, weights
from npred.lab.training.rows import Fit, Rows
from npred.lab.training.training_loop import Metrics

pytestmark = [
    pytest.mark.gpu,
    pytest.mark.skipif("NPRED_TEST_GPU" not in os.environ or not torch.cuda.is_available(), reason="no GPU"),
]
CAPTURED = {"deeponet", "fno", "AveragingNetwork"}  # the recurrent ones may fall back, as cuDNN allows


def task(config: Training, seed: int = 0, count: int = 600, **changes: object) -> Fit:
    config = config.model_copy(update={"epochs": 6, "batch": 64, "checkpoint_every": 2} | changes)
    train = Rows.of(samples(count, seed=2 * seed), "cuda", nodes=11)
    test = Rows.of(samples(100, seed=2 * seed + 1), "cuda")
    loss = Criterion(config.rows, weights(config, PLANT, train.P))
    return Fit("train tiny", operator(config, seed).to("cuda"), config, train, test, loss, seed=11 + seed)


def fit(run: Fit, folder: Path, progress: Silent | None = None) -> Metrics:
    folder.mkdir(exist_ok=True)
    return training_loop.fit(run, folder, progress or Silent())


def close(found: Metrics, expected: Metrics, rtol: float) -> None:
    for row, other in zip(found, expected, strict=True):
        np.testing.assert_allclose(list(row.values()), list(other.values()), rtol=rtol)


@NETWORKS
def test_a_network_is_captured_and_learns_as_by_eager_steps(config, tmp_path, monkeypatch):
    progress = Silent()
    found = fit(task(config), tmp_path / "graph", progress)
    fallen = [note for note in progress.notes if "expected a step" in note]
    print(config.architecture, *fallen)
    assert not fallen or short_name(config.architecture) not in CAPTURED
    monkeypatch.setattr(captured, "serves", lambda device: False)
    close(found[:2], fit(task(config), tmp_path / "eager")[:2], rtol=2e-2)


def test_adam_is_captured(tmp_path, monkeypatch):
    config, progress = DeepONet(optimiser="adam", lr=1e-3, weight_decay=1e-4), Silent()
    found = fit(task(config), tmp_path / "graph", progress)
    assert not any("expected" in note for note in progress.notes)
    monkeypatch.setattr(captured, "serves", lambda device: False)
    close(found, fit(task(config), tmp_path / "eager"), rtol=1e-2)


def test_a_training_that_was_stopped_goes_on(tmp_path):
    expected = fit(task(EVERY[0]), tmp_path / "whole")
    with pytest.raises(KeyboardInterrupt):
        fit(task(EVERY[0]), tmp_path / "broken", Silent(stop_after=4))
    close(fit(task(EVERY[0]), tmp_path / "broken"), expected, rtol=2e-2)


def test_what_reads_the_gpu_is_trained_eagerly_and_said(tmp_path):
    run, progress, seen = task(EVERY[0]), Silent(), list[float]()
    run.operator.network.register_forward_pre_hook(lambda module, inputs: seen.append(inputs[0].sum().item()))
    assert len(fit(run, tmp_path / "reads", progress)) == 6
    assert any("reads numbers of the GPU on the host; training by eager steps" in note for note in progress.notes)


def test_two_networks_are_captured_side_by_side_in_threads(tmp_path):
    ended: dict[int, Metrics] = {}

    def train(k: int) -> None:
        ended[k] = fit(task(EVERY[k]), tmp_path / str(k))

    threads = [threading.Thread(target=train, args=(k,)) for k in (0, 1)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert {k: len(metrics) for k, metrics in ended.items()} == {0: 6, 1: 6}


def test_the_time_of_a_step(tmp_path, monkeypatch):
    """Printed, not judged."""
    for config in (DeepONet(), EVERY[1]):
        for graphs in (True, False):
            monkeypatch.setattr(captured, "serves", lambda device, graphs=graphs: graphs)
            run = task(config, count=20 * 1024, batch=1024, epochs=10, checkpoint_every=10)
            start = time.perf_counter()
            fit(run, tmp_path / f"{config.architecture}{graphs}")
            torch.cuda.synchronize()
            way, ms = "graphs" if graphs else "eager", 1000 * (time.perf_counter() - start) / 200
            print(f"{torch.cuda.get_device_name()}: {config.architecture}, {way}: {ms:.2f} ms a step, capture included")


def test_all_stages_run_on_a_gpu_and_the_key_of_a_bench_names_it(tmp_path):
    assert devices.hardware("cuda")["gpus"]
    (tmp_path / "tiny.toml").write_text(TINY + "[certify]\nprobability = 0.1\nloops = 8\n")
    for arguments in (["run", "tiny.toml"], ["sweep", "tiny.toml", "--set", "seed=0:3", "--to", "train"]):
        command = [sys.executable, "-m", "npred", *arguments, "--device", "cuda", "--json"]
        done = subprocess.run(command, cwd=tmp_path, env=process_environment(), capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
        print(json.dumps(json.loads(done.stdout))[:400])
