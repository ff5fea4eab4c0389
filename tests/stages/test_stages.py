"""The stages together on a tiny problem: evaluate, Fig. 1 and bench read what generate and train wrote."""

import copy
import dataclasses
import types
from pathlib import Path
from typing import Any

import follower
import h5py
import numpy as np
import pytest
from conftest import HERE
from jobs import job, tables, trained

from npred import plants
from npred.base.errors import MissingError
from npred.lab import config
from npred.lab.config.results import Benched, Evaluated, PredictorId
from npred.lab.config.results.bench import Stops
from npred.lab.config.results.evaluate import POOR, Coverage
from npred.lab.stages.bench import bench
from npred.lab.stages.evaluate import accuracy, behaviour, evaluate
from npred.lab.stages.generate import generate
from npred.lab.stages.train import train
from npred.lab.training.data import shards
from npred.lab.training.data.dataset import Dataset
from npred.lab.training.neural import Neural
from npred.loop import metrics
from npred.loop.closed_loop import Samples, Trajectories
from npred.networks.weights import read
from npred.prediction.methods import RK4

PLANT = plants.resolve("activator_repressor")
FNO = PredictorId("fno")
BASELINES = [f"{HERE.parent}/pipeline/interpreted.py:{name}" for name in ("Published", "EulerPython")]


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """The data and both networks, as the inputs of the later stages."""
    return trained(tmp_path_factory.mktemp("chain"))


@pytest.fixture(scope="module")
def evaluated(made, tmp_path_factory):
    task = job(tmp_path_factory.mktemp("evaluate"), "evaluate", inputs=made)
    return task, evaluate.run(task).json_object()


def test_every_predictor_is_there(evaluated):
    _, result = evaluated
    assert list(result["models"]) == ["numerical", "no_adaptation", "deeponet@1", "deeponet", "fno"]
    for row in result["models"].values():
        assert row["radius"]["cases"] == 4
        assert set(row["figure1"]) == {"X_end", "D_hat_end", "radius", "settle_time"}


def test_a_frozen_estimate_has_one_row_without_adaptation(made, tmp_path):
    """The numerical predictor's: the other would repeat it."""
    task = job(tmp_path, "frozen", inputs=made, evaluate={"adaptation": "frozen"})
    result = evaluate.run(task).json_object()
    assert list(result["models"]) == ["numerical", "deeponet@1", "deeponet", "fno"]
    assert result["models"]["numerical"]["figure1"]["D_hat_end"] == 2.0
    assert "no_adaptation" not in h5py.File(task.folder / "figure1.h5")


def test_numerical_is_exact_and_adapts(evaluated):
    _, result = evaluated
    numerical, frozen = result["models"]["numerical"], result["models"]["no_adaptation"]
    assert numerical["mse"] == numerical["eps_sup"] == numerical["radius"]["predicted"] == 0.0
    assert frozen["figure1"]["D_hat_end"] == 2.0 != numerical["figure1"]["D_hat_end"]


def test_errors_of_a_network_are_those_of_its_predictions(evaluated, made):
    _, result = evaluated
    test = Dataset.read(made["generate"] / "data.h5").subset(test=True)
    P_hat = Neural(PLANT, read(made["fno"], PLANT, precision=np.float64).module(PLANT))(test.X, test.u, test.D_hat)
    row = result["models"]["fno"]
    assert row["mse"] == pytest.approx(np.mean((P_hat - test.P) ** 2), rel=1e-9)
    assert row["radius"]["predicted"] == pytest.approx(metrics.gain(PLANT) * row["eps_kappa"])


def test_errors_are_reported_by_kind_of_row(made, tmp_path):
    """Networks that were trained on nominal rollouts alone, asked for what explorers would have shown them."""
    task = job(tmp_path, "evaluate", inputs=made, generate={"explore": 0.5, "redraw": 0.25})
    result = evaluate.run(task).json_object()
    counts = {"nominal": 30, "exploring": 30, "redrawn": 60}
    assert {kind: found["rows"] for kind, found in result["kinds"].items()} == counts
    assert result["held_out_kind"] == "nominal" and result["held_out"] == 30
    for name, row in result["models"].items():
        assert list(row["kinds"]) == list(counts)
        for key in ("mse", "eps_sup", "eps_kappa", "rel_l2"):
            assert row["kinds"]["nominal"][key] == row[key]
        assert (row["kinds"]["exploring"]["eps_sup"] > 0) == (name not in ("numerical", "no_adaptation"))
    with h5py.File(task.folder / "errors.h5") as file:
        for kind in ("exploring", "redrawn"):
            sup = file[f"kinds/{kind}/networks/fno/sup"][:]
            assert sup.shape == file[f"kinds/{kind}/D_hat"].shape == (counts[kind],)
            assert sup.max() == pytest.approx(result["models"]["fno"]["kinds"][kind]["eps_sup"])
    typed = Evaluated.of(result, "a test")
    assert "30 held-out samples (nominal)" in evaluate.summary(typed)
    words = ("exploring rollouts", "rows with a redrawn D̂", "sup |P(1, t) − X(t + D)|")
    assert all(each in evaluate.details(typed) for each in words)


def test_prediction_errors_in_the_loop_are_reported(evaluated):
    """Small for the numerical predictor, which is not its own reference there, and a network's own for a network."""
    _, result = evaluated
    assert result["in_loop"] == {"D": 1.0, "from": 2.0, "to": 5.0, "loops": 3}
    errors = {name: row["in_loop"] for name, row in result["models"].items()}
    assert 0 < errors["numerical"] == errors["no_adaptation"] < 1e-3
    assert all(errors[name] > 100 * errors["numerical"] for name in ("deeponet@1", "deeponet", "fno"))


def test_the_chain_runs_on_shards(evaluated, tmp_path, monkeypatch):
    for limit in ("WHOLE", "SHARD"):
        monkeypatch.setattr(shards, limit, 1)
    data = job(tmp_path, "generate", generate={"rollouts": 130, "samples": 520, "t_end": 4.0})
    assert generate.run(data).json_object()["shards"] == 3 == len(list(data.folder.glob("data-*.h5")))
    inputs, trained = {"generate": data.folder}, {}
    for model in ("deeponet", "fno"):
        training = job(tmp_path, model, inputs={"generate": data.folder}, model=model)
        trained[model] = train.run(training).json_object()
        inputs[model] = training.folder
    result = evaluate.run(job(tmp_path, "evaluate", inputs=inputs)).json_object()
    assert result["held_out"] == 52 and result["models"]["numerical"] == evaluated[1]["models"]["numerical"]
    for model, found in trained.items():
        assert found["samples"] == 468 and result["models"][model]["mse"] == pytest.approx(found["mse"], rel=1e-3)


def test_fresh_rows_are_samples_of_the_numerical_loops(evaluated):
    _, result = evaluated
    assert result["fresh"] == 4 * accuracy.FRESH
    assert result["models"]["fno"]["fresh"]["mse"] > 0 == result["models"]["numerical"]["fresh"]["mse"]
    assert set(result["models"]["fno"]["fresh"]) >= {"mse", "eps_sup", "eps_kappa", "eps_relative"}
    steps = accuracy.sample_steps(0, config.parse(tables(), "tests").evaluate, 3)
    assert steps.shape == (3, accuracy.FRESH) and (np.diff(steps) >= 0).all() and steps.max() <= 600


def test_a_fresh_row_whose_input_is_lost_before_its_state_is_left_out():
    """P diverges first, U with it, and X only when that U arrives."""
    u = np.zeros((2, 3, 5, 1))
    u[1, 2, -1] = np.nan
    loops: Any = types.SimpleNamespace(samples=Samples(np.ones((2, 3, 1)), u, np.full((2, 3), 0.4)))
    rows = accuracy.fresh(loops, np.zeros((2, 3)), RK4(plants.resolve("scalar"), 5))
    assert len(rows.X) == 5 and np.isfinite(rows.P).all()


def test_figure_and_loops_are_written(evaluated):
    task, result = evaluated
    assert (task.folder / "figure1.png").read_bytes().startswith(b"\x89PNG")
    assert "<svg" in (task.folder / "figure1.svg").read_text()
    with h5py.File(task.folder / "figure1.h5") as file:
        assert set(file) == set(result["models"])
        t, X = file["fno/t"][:], file["fno/X"][:]
    assert t[-1] == pytest.approx(4.0) and X.shape == (len(t), 2)
    np.testing.assert_allclose(X[0], [0.03, 30.0])
    np.testing.assert_allclose(X[-1], result["models"]["fno"]["figure1"]["X_end"])


def test_the_loop_of_fig_1_runs_within_bounds_of_its_own_too(made, tmp_path):
    """The other loops are as without these bounds."""
    task = job(tmp_path, "bounded", inputs=made, evaluate={"figure_bounds": [[0.0, 0.05]], "t_end": 2.0})
    result = evaluate.run(task).json_object()
    assert (task.folder / "figure1_bounded.png").read_bytes().startswith(b"\x89PNG")
    with h5py.File(task.folder / "figure1.h5") as file:
        assert set(file) == {*result["models"], "bounded"} and set(file["bounded"]) == set(result["models"])
        for name, row in result["models"].items():
            U, X = (file[f"bounded/{name}/{series}"][:] for series in "UX")
            assert U.min() >= 0.0 and U.max() == 0.05 < file[f"{name}/U"][:].max()
            np.testing.assert_allclose(X[-1], row["figure1_bounded"]["X_end"])


def test_where_networks_err_is_written_and_adds_up(evaluated):
    task, result = evaluated
    with h5py.File(task.folder / "errors.h5") as file:
        assert set(file["networks"]) == {"deeponet@1", "deeponet", "fno"}
        for name, found in file["networks"].items():
            sup, over_x = found["sup"][:], found["over_x"][:]
            assert sup.shape == file["D_hat"].shape == (result["held_out"],) and over_x.shape == (21, 3)
            assert sup.max() == over_x[:, 2].max() == pytest.approx(result["models"][name]["eps_sup"])
            assert (np.diff(over_x, axis=1) >= 0).all()


def test_histograms_of_data_and_loops_are_written(evaluated):
    task, result = evaluated
    with h5py.File(task.folder / "coverage.h5") as file:
        assert set(file) == {"x1", "x2", "U", "D_hat"}
        for name, found in file.items():
            width = np.diff(found["edges"][:])
            assert set(found["loops"]) == {"numerical", "no_adaptation", "deeponet", "fno"}
            assert np.sum(found["data"][:] * width) == pytest.approx(1.0)
            inside = np.sum(found["loops/fno"][:] * width)
            assert 1.0 - inside == pytest.approx(result["coverage"][name]["outside"]["fno"], abs=0.02)


def test_a_plant_that_tracks_is_evaluated_against_its_reference(tmp_path):
    networks = {name: small | {"anchor": "initial"} for name, small in tables()["train"].items()}
    pipeline = {
        "plant": f"{Path(follower.__file__)}:Follower", "train": networks, "generate": {"gamma": 1.0},
        "evaluate": {"X0": [0.5], "D_hat": 1.0, "gamma": 0.2, "map_D": [1.0], "map_D_hat": [1.0]},
    }  # fmt: skip
    data = job(tmp_path, "generate", **pipeline)
    generate.run(data)
    inputs = {"generate": data.folder}
    for model in ("deeponet", "fno"):
        training = job(tmp_path, model, inputs=inputs, model=model, **pipeline)
        train.run(training)
        inputs[model] = training.folder
    found = evaluate.run(job(tmp_path, "evaluate", inputs=inputs, **pipeline)).json_object()
    assert found["equilibrium"] is None and found["gain"] == pytest.approx(0.5, rel=1e-4)
    exact = found["models"]["numerical"]["figure1"]
    assert exact["radius"] < 0.05 < abs(exact["X_end"][0]) and found["models"]["fno"]["eps_kappa"] > 0
    assert "eps_relative" not in found["models"]["fno"]


def test_evaluation_gives_the_same_bytes_again(evaluated, made, tmp_path):
    first, result = evaluated
    again = job(tmp_path, "again", inputs=made)
    assert evaluate.run(again).json_object() == result
    for name in sorted(path.name for path in first.folder.iterdir()):
        assert (again.folder / name).read_bytes() == (first.folder / name).read_bytes()


def test_map_and_coverage_of_known_loops():
    """Three loops at rest and one far away; the reference loses one that the other one keeps."""
    t, rest = np.linspace(0, 1, 11), np.tile(PLANT.equilibrium, (4, 11, 1))
    far = rest.copy()
    far[3] += 10.0
    lost = rest.copy()
    lost[2] += 10.0
    table = config.parse(tables(evaluate={"map_D": [0.5, 1.0], "map_D_hat": [0.6, 0.7]}), "tests").evaluate
    found = behaviour.delay_map(PLANT, table, still(t, far), still(t, lost))
    assert found.converged == [[True, True], [True, False]]
    assert found.share == pytest.approx(2 / 3) and found.band == (0.5, 0.5)
    data = dataset(X=np.array([[0.0, 0.0], [1.0, 10.0]]), u=np.array([-1.0, 1.0]), D_hat=np.array([0.0, 2.0]))
    covered = behaviour.coverage(PLANT, data, {FNO: still(t, far)})
    assert covered["x1"].json_object() == {"data": [0.0, 1.0], "outside": {"fno": 0.25}}
    assert covered["x2"].outside[FNO] == 0.25 and covered["U"].outside[FNO] == 0.0


@pytest.mark.parametrize(("low", "outside"), [(0.13, 0.0), (0.6, 1.0)])
def test_an_estimate_at_its_bound_is_covered_by_data_that_come_near_it(low, outside):
    """Drawn from [0.1, 1.2], data hardly meet the bound 0.1; data above 0.6 are another matter."""
    t, X = np.linspace(0, 1, 11), np.zeros((4, 11, 2))
    data = dataset(X=np.ones((2, 2)), u=np.zeros(2), D_hat=np.array([low, 1.2]))
    loops = {FNO: dataclasses.replace(still(t, X), D_hat=np.full((4, 11), 0.1))}
    covered = behaviour.coverage(PLANT, data, loops, (0.1, 2.0))
    assert covered["D_hat"].json_object() == {"data": [low, 1.2], "outside": {"fno": outside}}
    below = {FNO: dataclasses.replace(still(t, X), D_hat=np.full((4, 11), 0.05))}
    assert behaviour.coverage(PLANT, data, below, (0.1, 2.0))["D_hat"].outside[FNO] == 1.0


def test_loops_that_leave_the_data_are_warned_of(evaluated):
    task, result = evaluated
    shares = result["coverage"]["x2"]["outside"]
    warned = [line for line in task.progress.notes if "outside" in line]
    loud = [c for q in result["coverage"].values() for c, share in q["outside"].items() if share > behaviour.OUTSIDE]
    assert len(warned) == len(loud) and set(shares) == {"deeponet@1", "deeponet", "fno"}


@pytest.mark.parametrize(("rel_l2", "cure"), [(POOR, "it predicts poorly, train it longer first"), (POOR / 2, "widen")])
def test_a_poor_network_is_to_blame_for_its_loops_before_data_and_bounds_are(rel_l2, cure):
    said, t, X = [], np.linspace(0, 1, 11), np.zeros((4, 11, 2))
    task: Any = types.SimpleNamespace(plant=PLANT, progress=types.SimpleNamespace(warn=said.append))
    run = dataclasses.replace(still(t, X), D_hat=np.full((4, 11), 0.1), ends=(0.1, 2.0))
    covered = {"x1": Coverage.of({"data": [0.0, 1.0], "outside": {"fno": 1.0}}, "a test")}
    scored: Any = {FNO: types.SimpleNamespace(rel_l2=rel_l2, fallback=None)}
    evaluate._warn(task, types.SimpleNamespace(cases=slice(0, 4)), covered, {FNO: run}, scored)
    assert len(said) == 2 and all(cure in line for line in said) and "D_hat ended at its bound in 4 of 4" in said[1]


def still(t, X):
    zeros = np.zeros(X.shape[:-1])
    nothing = Samples(*[np.empty((len(X), 0))] * 3)
    return Trajectories(
        t,
        X,
        zeros[..., None],
        zeros,
        zeros,
        zeros,
        np.full(len(X), -1),
        nothing,
        X,
        np.full(len(X), -1),
        np.zeros(len(X)),
        np.zeros(len(X)),
        X[:, 0],
        zeros > 0,
        np.zeros(len(X)),
        zeros > 0,
        np.zeros(len(X)),
        zeros > 0,
        np.zeros(len(X)),
        len(t),
    )


def dataset(X, u, D_hat):
    rows = np.zeros(len(X))
    return Dataset(X, u[:, None, None], D_hat, X[:, None], rows, rows, rows.astype(np.int32), rows.astype(np.uint8))


@pytest.fixture(scope="module")
def benched(made, tmp_path_factory):
    task = job(tmp_path_factory.mktemp("bench"), "bench", inputs=made, bench={"baselines": BASELINES})
    return task, bench.run(task).json_object()


def test_bench_rows(benched):
    """Batch 1 at each dx, larger batches at the first."""
    _, result = benched
    grid_rows = [r for r in result["rows"] if r["matches"] is None]
    numerical = [(name, "compiled") for name in ("euler", "heun", "rk4", "rosenbrock")]
    neural = [(name, runtime) for name in ("deeponet", "fno") for runtime in ("torch", "fused")]
    single = [("published", "python"), ("euler_python", "python"), *numerical, *neural]
    wanted = [(*kind, dx, 1) for dx in (0.1, 0.05) for kind in single]
    wanted += [(*kind, 0.1, 3) for kind in (*numerical, *neural)]
    assert [(r["predictor"], r["runtime"], round(r["dx"], 3), r["batch"]) for r in grid_rows] == wanted
    for row in result["rows"]:
        assert 0 < row["median_us"] <= row["p95_us"] <= row["p999_us"] <= row["max_us"]
        assert (row["calls"], row["device"], row["copies"]) == (12, "cpu", None)
    assert {"cpu", "threads", "versions"} <= set(result["hardware"])


def test_bench_errors_and_speedups(benched):
    rows = benched[1]["rows"]
    grid_rows = [r for r in rows if r["matches"] is None]
    errors = {(r["predictor"], round(r["dx"], 3)): r["eps_sup"] for r in grid_rows}
    assert errors["published", 0.1] == pytest.approx(errors["euler", 0.1], rel=1e-9)
    assert max(errors["rk4", 0.1], errors["heun", 0.1]) < errors["euler", 0.1]
    assert 1.5 < errors["euler", 0.1] / errors["euler", 0.05] < 3
    matched = {r["matches"]: r for r in rows if r["matches"]}
    assert set(matched) == {"deeponet", "fno", "front"}
    for name in ("deeponet", "fno"):
        assert matched[name]["eps_sup"] <= errors[name, 0.1]
        by_runtime = {r["runtime"]: r["eps_sup"] for r in grid_rows if (r["predictor"], r["batch"]) == (name, 1)}
        assert by_runtime["fused"] == pytest.approx(by_runtime["torch"], rel=1e-4)
    euler = next(r for r in grid_rows if r["predictor"] == "euler")
    assert euler["speedup_compiled"] == 1.0 and euler["speedup_published"] > 1.0


def test_bench_writes_raw_times_a_latex_table_and_a_figure(benched):
    task, result = benched
    with h5py.File(task.folder / "times.h5") as file:
        assert len(file) == len(result["rows"]) and all(len(samples) == 12 for samples in file.values())
    assert r"\toprule" in (task.folder / "bench.tex").read_text()
    assert "<svg" in (task.folder / "speed.svg").read_text()


def test_bench_says_from_where_on_a_network_pays(benched):
    """A sentence a network, each against every method that is as accurate."""
    rows, crossover = benched[1]["rows"], benched[1]["crossover"]
    assert [found["predictor"] for found in crossover] == ["deeponet", "fno"]
    for found in crossover:
        assert found["plant"] == "activator_repressor" and found["runtime"] in ("torch", "fused")
        rivals = [row for row in rows if row["matches"] == found["predictor"]]
        assert [rival["predictor"] for rival in found["numerical"]] == [row["predictor"] for row in rivals] != []
        assert all(row["eps_sup"] <= found["eps_sup"] for row in rivals)
        assert found["best_us"] == min(rival["median_us"] for rival in found["numerical"])
        assert found["f_ns"] > 0 and found["best_steps"] >= 1
        assert found["sentence"].startswith("For activator_repressor at ε = ")


def test_bench_says_what_of_the_tails_is_the_machines(benched):
    found = benched[1]["stops"]
    assert found["per_s"] >= 0 and found["sentence"] == bench.stopped(Stops.of(found, "a test"))
    told = bench.stopped(Stops(per_s=400.0, median_us=38.2))
    assert "400 times per second, for 38 µs in the median: p99.9 of calls from 2.5 µs on" in told
    assert "did not stop" in bench.stopped(Stops(per_s=0.0, median_us=0.0))
    assert bench.sentences(Benched.of(benched[1], "a test"))[-1] == found["sentence"]


@pytest.mark.slow
def test_bench_with_onnx(made, tmp_path):
    pytest.importorskip("onnxruntime")
    task = job(tmp_path, "bench", inputs=made, bench={"runtimes": ["onnx"], "dx": [0.1], "batches": [1]})
    result = bench.run(task).json_object()
    assert {r["runtime"] for r in result["rows"]} == {"compiled", "onnx"}
    assert {found["runtime"] for found in result["crossover"]} == {"onnx"}


def test_bench_without_the_onnx_extra_leaves_its_rows_out(made, tmp_path, monkeypatch):
    from npred.lab.stages.bench import candidates

    monkeypatch.setattr(candidates, "installed", lambda name: name != "onnx")
    task = job(tmp_path, "bench", inputs=made, bench={"runtimes": ["torch", "onnx"]})
    assert candidates._available(task.progress, task.config.bench) == ["torch"]


def test_bench_of_the_runtime_onnx_alone_asks_for_its_package(made, tmp_path, monkeypatch):
    from npred.lab.stages.bench import candidates

    monkeypatch.setattr(candidates, "installed", lambda name: name != "onnx")
    task = job(tmp_path, "bench", inputs=made, bench={"runtimes": ["onnx"]})
    with pytest.raises(MissingError, match=r"bench: expected the package onnx .*; pip install 'npred\[onnx\]'"):
        bench.run(task)


@pytest.mark.parametrize("stage", [evaluate, bench])
def test_summaries_print(stage, evaluated, benched):
    result = Evaluated.of(evaluated[1], "a test") if stage is evaluate else Benched.of(benched[1], "a test")
    for text in (stage.summary(result), stage.details(result)):
        assert "deeponet" in text.lower() and ("numerical" if stage is evaluate else "A network pays if") in text


def test_figure_numbers_of_a_loop_that_never_settles(evaluated):
    _, result = evaluated
    assert result["models"]["no_adaptation"]["figure1"]["settle_time"] is None


def test_the_summary_of_a_loop_that_left_the_finite_numbers_prints(evaluated):
    lost = copy.deepcopy(evaluated[1])
    lost["models"]["deeponet"]["figure1"] |= {"X_end": [None, None], "D_hat_end": None, "radius": None}
    after, before = (evaluate.details(Evaluated.of(each, "a test")).splitlines() for each in (lost, evaluated[1]))
    (row,) = [line for line, other in zip(after, before, strict=True) if line.split() != other.split()]
    assert row.startswith("DeepONet ") and row.count("∞") >= 2
