"""The train stage on a data file: what it writes, that it repeats itself and resumes, that held-out rows stay out."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from fake_gpu import FakeGpu
from operator_samples import PLANT, samples
from silent import Silent

from npred.lab import config
from npred.lab.config.results import Trained
from npred.lab.scheduler.job import Job
from npred.lab.stages.train import summary
from npred.lab.stages.train.train import run
from npred.lab.training import captured
from npred.lab.training.data import shards
from npred.lab.training.data.dataset import MEANING, Dataset
from npred.lab.training.operators import describe, load

SIZES = {
    "deeponet": {"width": 8, "depth": 1, "basis": 4, "trunk": 8, "moments": 4},
    "fno": {"width": 4, "modes": 3, "layers": 1},
}
SHARED = {"epochs": 3, "batch": 16, "snapshots": [2], "checkpoint_every": 1}
MODELS = pytest.mark.parametrize("model", ["deeponet", "fno"])


def write_data(path: Path, held_out: float = 1.0) -> None:
    """Four rollouts of ten samples, the last held out; its P is multiplied by `held_out`."""
    arrays, rollout = samples(40), np.repeat(np.arange(4, dtype=np.int32), 10)
    test = (rollout == 3).astype(np.uint8)
    P = arrays.P * np.where(test, held_out, 1.0)[:, None, None]
    path.mkdir()
    Dataset(arrays.X, arrays.u, arrays.D_hat, P, np.ones(40), np.zeros(40), rollout, test).write(path / "data.h5", {})


def job(root: Path, model: str, progress: Silent | None = None, **changes: object) -> Job:
    """A job with empty folders of its own; the data lie beside them."""
    tables = {name: sizes | SHARED | changes for name, sizes in SIZES.items()}
    root.mkdir(exist_ok=True)
    for name in ("folder", "scratch"):
        (root / name).mkdir(exist_ok=True)
    pipeline = config.parse({"plant": "activator_repressor", "seed": 1, "train": tables}, "test")
    inputs = {"generate": root.parent / "data"}
    return Job(pipeline, PLANT, root / "folder", inputs, root / "scratch", "cpu", 1, progress or Silent(), model)


def payload(job: Job) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in job.folder.iterdir()}


@MODELS
def test_payload_and_result(model, tmp_path):
    write_data(tmp_path / "data")
    stage = job(tmp_path / "run", model)
    result = run(stage)
    weights = {"model.safetensors", "snapshot-2.safetensors"}
    assert set(payload(stage)) == weights | {"model.json", "domain.safetensors", "metrics.jsonl"}
    metrics = [json.loads(line) for line in (stage.folder / "metrics.jsonl").read_text().splitlines()]
    assert [row["epoch"] for row in metrics] == [1, 2, 3]
    assert result.samples == 30 and result.epochs == 3 and result.mse == metrics[-1]["mse"]
    assert describe(stage.folder)["model"] == model == result.model
    assert Trained.of(json.loads(json.dumps(result.json_object())), "a test") == result
    assert model in summary(result) and f"{result.mse:.3g}" in summary(result)


def test_a_network_that_a_gpu_trains_is_written_with_its_domain(tmp_path):
    """On the CPU's arithmetic the same bytes, but every array that leaves the device has to be fetched."""
    write_data(tmp_path / "data")
    here, there = (job(tmp_path / device, "deeponet") for device in ("cpu", "cuda"))
    run(here)
    with FakeGpu():
        run(replace(there, device="cuda"))
    assert payload(there) == payload(here)


def sharded(source: Path, folder: Path) -> Path:
    """The same rows in four shards."""
    folder.mkdir()
    data = Dataset.read(source / "data.h5")
    for k in range(4):
        some = {name: getattr(data, name)[10 * k : 10 * k + 10] for name in MEANING}
        Dataset(**some).write(folder / shards.name(k), {})
    shards.join(folder, [10] * 4, {})
    return folder


def test_shards_train_as_well_as_one_file(tmp_path):
    """With all rows in one batch only the rounding of the order is left."""
    write_data(tmp_path / "data")
    whole = job(tmp_path / "whole", "deeponet", batch=30)
    streamed = replace(whole, folder=tmp_path / "s", scratch=tmp_path / "t",
                       inputs={"generate": sharded(tmp_path / "data", tmp_path / "shards")})  # fmt: skip
    for path in (streamed.folder, streamed.scratch):
        path.mkdir()
    results = [run(whole), run(streamed)]
    assert results[0].samples == results[1].samples == 30
    assert results[1].mse == pytest.approx(results[0].mse, rel=1e-4)


@pytest.mark.parametrize("batch", [7, 64], ids=["a smaller last batch", "one batch"])
def test_shards_come_to_a_graph_as_to_plain_steps(batch, tmp_path, monkeypatch):
    """A buffer of one batch is the graph's; here its text runs on the CPU."""
    write_data(tmp_path / "data")
    inputs = {"generate": sharded(tmp_path / "data", tmp_path / "shards")}
    results = []
    for graphs in (False, True):
        monkeypatch.setattr(captured, "serves", lambda device, graphs=graphs: graphs)
        stage = replace(job(tmp_path / str(graphs), "deeponet", batch=batch), inputs=inputs)
        results.append(run(stage))
        assert not any("expected" in note for note in stage.progress.notes)  # type: ignore[attr-defined]
    assert results[1].mse == pytest.approx(results[0].mse, rel=1e-2)
    assert results[1].loss == pytest.approx(results[0].loss, rel=1e-2)


@MODELS
def test_saved_model_has_the_reported_error(model, tmp_path):
    write_data(tmp_path / "data")
    stage = job(tmp_path / "run", model)
    result = run(stage)
    rows = Dataset.read(tmp_path / "data" / "data.h5").subset(test=True)
    inputs = (torch.as_tensor(a, dtype=torch.float32) for a in (rows.X, rows.u, rows.D_hat))
    gap = load(stage.folder, PLANT)(*inputs).double().numpy() - rows.P
    np.testing.assert_allclose((gap**2).mean(), result.mse, rtol=1e-4)


@MODELS
def test_same_bytes_again(model, tmp_path):
    write_data(tmp_path / "data")
    first, second = job(tmp_path / "first", model), job(tmp_path / "second", model)
    run(first)
    torch.manual_seed(123)  # what was drawn before does not matter
    run(second)
    assert payload(first) == payload(second)


def test_torch_generator_is_left_alone(tmp_path):
    write_data(tmp_path / "data")
    before = torch.random.get_rng_state()
    run(job(tmp_path / "run", "fno"))
    assert torch.equal(before, torch.random.get_rng_state())


@MODELS
def test_interrupted_stage_goes_on_from_its_scratch(model, tmp_path):
    write_data(tmp_path / "data")
    whole = job(tmp_path / "whole", model)
    run(whole)
    with pytest.raises(KeyboardInterrupt):
        run(job(tmp_path / "broken", model, Silent(stop_after=2)))
    resumed = job(tmp_path / "broken", model)
    run(resumed)
    assert payload(resumed) == payload(whole)


def test_held_out_rows_do_not_touch_the_weights(tmp_path):
    results = []
    for name, factor in [("a", 1.0), ("b", 3.0)]:
        (tmp_path / name).mkdir()
        write_data(tmp_path / name / "data", factor)
        stage = job(tmp_path / name / "run", "deeponet")
        results.append((run(stage).mse, payload(stage)["model.safetensors"]))
    assert results[0][1] == results[1][1] and results[0][0] < results[1][0]


def test_two_networks_do_not_share_their_draws(tmp_path):
    write_data(tmp_path / "data")
    orders = []
    for model in ("deeponet", "fno"):
        stage = job(tmp_path / model, model)
        run(stage)
        orders.append(payload(stage)["metrics.jsonl"])
    assert orders[0] != orders[1]


def test_anchor_none_trains_as_published(tmp_path):
    write_data(tmp_path / "data")
    published = {"anchor": "none", "loss": "raw", "schedule": "step", "weight_decay": 1e-4, "batch": 20}
    result = run(job(tmp_path / "run", "deeponet", **published))
    assert np.isfinite(result.mse)
