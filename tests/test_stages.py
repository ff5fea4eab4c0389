"""The stages together on a tiny problem: evaluate, Fig. 1 and bench read what generate and train wrote."""

import h5py
import numpy as np
import pytest
from jobs import job

from npred import metrics
from npred.errors import ConfigError
from npred.stages import bench, evaluate, figure1, generate, train


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """The data and both networks, as the inputs of the later stages."""
    root = tmp_path_factory.mktemp("chain")
    data = job(root, "generate")
    generate.run(data)
    inputs = {"generate": data.folder}
    for model in ("deeponet", "fno"):
        training = job(root, model, inputs={"generate": data.folder}, model=model)
        train.run(training)
        inputs[model] = training.folder
    return inputs


@pytest.fixture(scope="module")
def evaluated(made, tmp_path_factory):
    task = job(tmp_path_factory.mktemp("evaluate"), "evaluate", inputs=made)
    return task, evaluate.run(task)


def test_every_contender_is_there(evaluated):
    _, result = evaluated
    assert list(result["models"]) == ["numerical", "no_adaptation", "deeponet@1", "deeponet", "fno"]
    for row in result["models"].values():
        assert row["radius"]["cases"] == 4
        assert set(row["figure1"]) == {"X_end", "D_hat_end", "radius", "settle_time"}


def test_numerical_is_exact_and_adapts(evaluated):
    _, result = evaluated
    numerical, frozen = result["models"]["numerical"], result["models"]["no_adaptation"]
    assert numerical["mse"] == numerical["eps_sup"] == numerical["radius"]["predicted"] == 0.0
    assert frozen["figure1"]["D_hat_end"] == 2.0 != numerical["figure1"]["D_hat_end"]


def test_errors_of_a_network_are_those_of_its_predictions(evaluated, made):
    from npred import operators, plants
    from npred.dataset import Dataset
    from npred.predictors.neural import Neural

    _, result = evaluated
    plant, test = plants.resolve("activator_repressor"), Dataset.read(made["generate"] / "data.h5").subset(test=True)
    P_hat = Neural(plant, operators.load(made["fno"], plant))(test.X, test.u, test.D_hat)
    row = result["models"]["fno"]
    assert row["mse"] == pytest.approx(np.mean((P_hat - test.P) ** 2), rel=1e-6)
    assert row["radius"]["predicted"] == pytest.approx(metrics.gain(plant) * row["eps_kappa"])


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


def test_evaluation_gives_the_same_bytes_again(evaluated, made, tmp_path):
    first, result = evaluated
    again = job(tmp_path, "again", inputs=made)
    assert evaluate.run(again) == result
    for name in ("figure1.svg", "figure1.png", "figure1.h5"):
        assert (again.folder / name).read_bytes() == (first.folder / name).read_bytes()


def test_cases_cross_states_with_estimates(made):
    config = job_config()
    X0, D_hat0 = evaluate.cases(0, config.evaluate, plant())
    assert X0.shape == (5, 2) and D_hat0.tolist() == [2.0, 0.8, 1.2, 0.8, 1.2]
    np.testing.assert_array_equal(X0[1], X0[2])
    assert (X0[1:, 1] >= 25).all() and (X0[1:, 1] <= 35).all()


def test_a_plant_that_tracks_is_refused(made, tmp_path):
    path = tmp_path / "moving.py"
    path.write_text(
        "class Moving:\n    states, inputs, box = ('x',), ('U',), {'x': (0, 1)}\n"
        "    def f(x, u, t, p, M): return [u.U]\n    def kappa(x, t, p, M): return [M.sin(t) - x.x]\n"
        "    def V(x, t, p, M): return x.x**2\n"
    )
    with pytest.raises(ConfigError, match="expected a plant with an equilibrium, Moving has none"):
        evaluate.run(job(tmp_path, "evaluate", inputs=made, plant=f"{path}:Moving"))


def test_bench_rows(made, tmp_path):
    task = job(tmp_path, "bench", inputs=made)
    result = bench.run(task)
    grid_rows = [r for r in result["rows"] if r["matches"] is None]
    names = ["published", "euler_python", "euler", "heun", "rk4", "deeponet", "fno"]
    assert [(r["predictor"], round(r["dx"], 3)) for r in grid_rows] == [(n, dx) for dx in (0.1, 0.05) for n in names]
    for row in result["rows"]:
        assert 0 < row["median_us"] <= row["p95_us"] <= row["p999_us"] <= row["max_us"]
    errors = {(r["predictor"], round(r["dx"], 3)): r["eps_sup"] for r in grid_rows}
    assert errors["published", 0.1] == pytest.approx(errors["euler", 0.1], rel=1e-9)
    assert max(errors["rk4", 0.1], errors["heun", 0.1]) < errors["euler", 0.1]
    assert 1.5 < errors["euler", 0.1] / errors["euler", 0.05] < 3
    matched = {r["matches"]: r for r in result["rows"] if r["matches"]}
    for name in ("deeponet", "fno"):
        assert matched[name]["eps_sup"] <= errors[name, 0.1]
    published = next(r for r in grid_rows if r["predictor"] == "euler")
    assert published["speedup_compiled"] == 1.0 and published["speedup_published"] > 1.0
    with h5py.File(task.folder / "times.h5") as file:
        assert len(file) == len(result["rows"]) and all(len(samples) == 12 for samples in file.values())
    assert {"cpu", "threads", "versions"} <= set(result["hardware"])


@pytest.mark.parametrize("stage", [evaluate, bench])
def test_summaries_print(stage, evaluated, made, tmp_path):
    from rich.console import Console

    result = evaluated[1] if stage is evaluate else bench.run(job(tmp_path, "bench", inputs=made))
    console = Console(width=200, record=True, file=open("/dev/null", "w"))  # noqa: SIM115
    console.print(stage.summary(result))
    text = console.export_text()
    assert "deeponet" in text and "numerical" in text if stage is evaluate else "published" in text


def test_figure_numbers_of_a_loop_that_never_settles(evaluated):
    _, result = evaluated
    assert result["models"]["no_adaptation"]["figure1"]["settle_time"] is None
    assert figure1.COLOURS[0] == "#000000"


def job_config():
    from jobs import tables

    from npred import config

    return config.parse(tables(), "tests")


def plant():
    from npred import plants

    return plants.resolve("activator_repressor")
