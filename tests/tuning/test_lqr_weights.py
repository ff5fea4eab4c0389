"""Q and R of kappa = "lqr" in `npred tune`: SciPy's Riccati equation, a grid, and the law that is kept."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.linalg import solve_continuous_are
from typer.testing import CliRunner

from npred import plants
from npred.base.errors import ConfigError
from npred.cli import app
from npred.kernels import compiler
from npred.lab import config
from npred.lab.config import Pipeline
from npred.lab.config.results import Tuned
from npred.lab.stages.tuning import Loops, LqrWeights, Yardstick, tune, varied
from npred.plants import Plant

PLANT = """
class Lever:
    states, inputs = ("x", "v"), ("F", "G")
    box, input_bounds = {"x": (-0.5, 0.5), "v": (-1.0, 1.0)}, ((-20.0, 20.0), (-10.0, 10.0))

    def f(x, u, t, p, M):
        return [x.v + 0.3 * u.G, 2 * M.sin(x.x) - 0.5 * x.v + u.F]
"""
A, B = np.array([[0.0, 1.0], [2.0, -0.5]]), np.array([[0.0, 0.3], [1.0, 0.0]])
TABLES: dict[str, Any] = {
    "plant": "lever.py:Lever",
    "kappa": "lqr",
    "evaluate": {
        "adaptation": "frozen", "D": 0.2, "D_hat": 0.2, "case_D_hat": [0.2], "X0": [0.4, 0.0], "t_end": 12.0,
        "case_t_end": 12.0, "dt": 0.01, "nx": 11,
    },
    "tune": {"free": ["Q", "R"], "starts": 4, "held_out": 4, "evaluations": 16},
}  # fmt: skip


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "lever.py").write_text(PLANT)
    return tmp_path


def pipeline(**search: Any) -> Pipeline:
    return config.parse(TABLES | {"tune": TABLES["tune"] | search}, "lever.toml")


def lever(kappa: Any = "lqr") -> Plant:
    return plants.resolve("lever.py:Lever", kappa=kappa)


def silent(steps: int) -> None:
    pass


def weight(plant: Plant, name: str) -> float:
    weights = LqrWeights.of(plant)
    assert weights
    return weights.present[name]


def cost(chosen: Pipeline, plant: Plant, numbers: dict[str, float]) -> float:
    loops = Loops(chosen, plant, 4, "training")
    present = loops.run({name: weight(plant, name) for name in numbers}, silent)
    yardstick = Yardstick.of(present, 0.1, chosen.evaluate.dt)
    return float(yardstick.costs(loops.run(numbers, silent)).mean())


def test_the_gains_are_those_of_scipy():
    rng, plant = np.random.default_rng(0), lever()
    assert LqrWeights.of(plant).present.keys() == {"Q.x", "Q.v", "R.F", "R.G"}  # type: ignore[union-attr]
    X = rng.uniform(-1, 1, (5, 2))
    for _ in range(4):
        q_x, q_v, r_F, r_G = 10 ** rng.uniform(-2, 2, 4)
        other = varied(plant, {"Q.x": q_x, "Q.v": q_v, "R.F": r_F, "R.G": r_G})
        R = np.diag([r_F, r_G])
        K = np.linalg.solve(R, B.T @ solve_continuous_are(A, B, np.diag([q_x, q_v]), R))
        np.testing.assert_allclose(other.kappa(X), -X @ K.T, rtol=1e-6, atol=1e-6)


def test_weights_that_are_not_varied_stay_as_they_are():
    plant = lever({"law": "lqr", "Q": [3.0, 4.0], "R": [[2.0, 0.0], [0.0, 5.0]]})
    K = np.linalg.solve(np.diag([2.0, 7.0]), B.T @ solve_continuous_are(A, B, np.diag([3.0, 4.0]), np.diag([2.0, 7.0])))
    np.testing.assert_allclose(varied(plant, {"R.G": 7.0}).kappa(np.eye(2)), -K.T, rtol=1e-6)


def test_along_a_reference_too_it_is_the_law_of_these_weights():
    plant, rng = plants.resolve("planar_arm2", kappa="lqr"), np.random.default_rng(1)
    weights = LqrWeights.of(plant)
    assert weights
    numbers = {name: value * 10 ** rng.uniform(-1, 1) for name, value in weights.present.items()}
    again = plants.resolve("planar_arm2", kappa=weights.table(numbers))
    X, t = rng.uniform(-0.5, 0.5, (6, 4)), rng.uniform(0, 6, 6)
    assert not np.allclose(again.kappa(X, t), plant.kappa(X, t), rtol=1e-2)
    np.testing.assert_allclose(varied(plant, numbers).kappa(X, t), again.kappa(X, t), rtol=1e-6, atol=1e-6)


def test_other_weights_compile_nothing():
    chosen, plant = pipeline(), lever()
    loops = Loops(chosen, plant, 2, "training")
    times = loops.run({"Q.x": 1.0}, silent).time
    compiled = set(compiler._loaded)
    assert not np.allclose(loops.run({"Q.x": 900.0, "R.G": 1e-3}, silent).time, times)
    assert set(compiler._loaded) == compiled


def test_only_ratios_count_so_that_one_weight_is_held():
    chosen, plant = pipeline(), lever()
    assert [number.name for number in tune(chosen, plant).numbers] == ["Q.x", "Q.v", "R.F"]
    assert [number.name for number in tune(pipeline(free=["R"]), plant).numbers] == ["R.F", "R.G"]
    once, scaled = ({f"{k}.{of}": s * v for k, of, v in (("Q", "x", 9.0), ("Q", "v", 2.0), ("R", "F", 0.3),
                     ("R", "G", 0.5))} for s in (1.0, 7.0))  # fmt: skip
    np.testing.assert_allclose(varied(plant, once).kappa(np.eye(2)), varied(plant, scaled).kappa(np.eye(2)), rtol=1e-6)


def test_no_cell_of_a_grid_over_one_scale_is_better_by_more_than_some_per_cent():
    plant, chosen = lever(), pipeline(free=["Q.x"], bounds={"Q.x": [0.04, 4e4]}, evaluations=40)
    result = tune(chosen, plant)
    [number] = result.numbers
    grid = {scale: cost(chosen, plant, {"Q.x": float(scale)}) for scale in np.geomspace(number.low, number.high, 41)}
    assert 3 * number.low < min(grid, key=grid.__getitem__) < number.high / 3
    assert min(grid.values()) > 0.97 * result.training.cost.after
    assert max(grid.values()) > 1.5 * min(grid.values())  # the scale matters


def test_ranges_of_all_are_times_the_present_weights():
    plant = lever({"law": "lqr", "Q": [3.0, 4.0], "R": [2.0, 5.0]})
    numbers = tune(pipeline(bounds={"Q": [0.5, 2.0]}, evaluations=1), plant).numbers
    ranges = {number.name: (number.low, number.high) for number in numbers}
    assert ranges == {"Q.x": (1.5, 6.0), "Q.v": (2.0, 8.0), "R.F": (0.02, 200.0)}


@pytest.mark.parametrize(
    ("kappa", "message"),
    [
        ({"law": "lqr", "Q": [[2.0, 1.0], [1.0, 2.0]]}, "expected diagonals Q and R to tune, got a matrix"),
        ({"law": "pole_placement", "poles": [-1, -2]}, 'expected kappa = "lqr" for its weight Q, got another law'),
        ({"law": "lqr", "Q": [0.0, 1.0]}, "expected a range for Q.x, which is 0 now"),
    ],
)
def test_what_has_no_weights_to_tune_is_refused(kappa: Any, message: str):
    with pytest.raises(ConfigError, match=message):
        tune(pipeline(), lever(kappa))


FILE = """
plant = "lever.py:Lever"
kappa = "lqr"

[evaluate]
adaptation = "frozen"
D = 0.2
D_hat = 0.2
case_D_hat = [0.2]
X0 = [0.4, 0.0]
t_end = 12.0
case_t_end = 12.0
nx = 11

[tune]
starts = 3
held_out = 4
evaluations = 24
"""


def test_the_pipeline_that_is_written_has_the_law_with_the_new_weights(folder: Path):
    (folder / "lever.toml").write_text(FILE)
    asked = ["tune", "lever.toml", "--free", "Q", "--free", "R=0.01:100", "-o", "better.toml", "--json"]
    done = CliRunner().invoke(app, asked)
    assert done.exit_code == 0, done.output
    answer = Tuned.of(json.loads(done.stdout), "stdout")
    assert answer.gained
    better = config.load(folder / "better.toml")
    assert isinstance(better.kappa, dict) and better.kappa["law"] == "lqr"
    after = {number.name: number.after for number in answer.numbers}
    expected = [after["Q.x"], weight(lever(), "Q.v"), after["R.F"], after["R.G"]]  # Q has no range of its own
    assert [*better.kappa["Q"], *better.kappa["R"]] == pytest.approx(expected, rel=1e-5)
    again = tune(better.model_copy(update={"tune": better.tune.model_copy(update={"evaluations": 1})}),  # type: ignore[union-attr]
                 plants.resolve(better.plant, better.parameters, better.kappa))  # fmt: skip
    assert again.held_out.settle_time.before == pytest.approx(answer.held_out.settle_time.after)
    near = ["--free", "Q=0.99:1.01", "--free", "R=0.99:1.01"]
    text = CliRunner().invoke(app, ["tune", "better.toml", *near, "-o", "none.toml"]).stdout
    assert "no clear gain" in text and not (folder / "none.toml").exists()


def test_where_all_weights_are_free_one_is_held_that_has_no_range_of_its_own():
    weights = LqrWeights.of(lever())
    assert weights is not None
    names = ["Q.x", "Q.v", "R.F", "R.G"]
    for free, bounds, held in (
        (["Q", "R"], {}, "R.G"),
        (["Q", "R"], {"R.G": (0.1, 1.0)}, "R.F"),
        (["Q", "R"], {"R": (0.1, 1.0)}, "Q.v"),
        (["Q", "R"], {"Q": (0.1, 1.0), "R": (0.1, 1.0)}, "R.G"),
        (names, dict.fromkeys(names, (0.1, 1.0)), "R.G"),
        (["R"], {}, ""),
        (["Q", "R.F"], {}, ""),
    ):
        table = config.Tune(free=[*free, *(name for name in bounds if name not in free)], bounds=bounds)
        assert weights.held(table) == held
        chosen = [name for name in names if name in table.free or name[0] in table.free]
        assert weights.named(table) == [name for name in chosen if name != held]


@pytest.mark.parametrize(("free", "said"), [("Q", 'expected kappa = "lqr" for its weight Q'), ("k", "there is none")])
def test_weights_of_another_law_and_a_law_without_gains_are_said(free: str, said: str, folder: Path):
    law = "\n    def kappa(x, t, p, M):\n        return [-3.0 * x.x - x.v, 0.0]\n"
    (folder / "lever.py").write_text(PLANT.rstrip() + "\n" + law)
    tables = {key: value for key, value in TABLES.items() if key != "kappa"} | {"tune": {"free": [free]}}
    plain = config.parse(tables, "lever.toml")
    with pytest.raises(ConfigError, match=f"free: {'expected a parameter .*' if free == 'k' else ''}{said}"):
        tune(plain, plants.resolve("lever.py:Lever"))


def test_a_column_is_no_file_of_the_pipeline(folder: Path):
    done = CliRunner().invoke(app, ["identify", "log.csv", "--plant", "scalar", "--output", "pH=COL"])
    assert done.exit_code == 2 and "--output: expected the file of the pipeline, got 'pH=COL'" in done.output
    assert "--output-column pH=COL" in done.output
