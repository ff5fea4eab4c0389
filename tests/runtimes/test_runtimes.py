"""Runtimes by name: of npred, of an installed package, of a user's file."""

from pathlib import Path

import numpy as np
import pytest
from jobs import tables
from operator_samples import PLANT, SMALL, operator, samples

from npred import config, runtimes
from npred.errors import ConfigError
from npred.pipeline import stage_registry
from npred.predictors.neural import Neural

MINE = """
from npred.predictors.neural import Neural

class Mine(Neural):
    "By torch, twice as slow as it could be."

    def predict(self, X, u, D_hat, t):
        return (super().predict(X, u, D_hat, t) + super().predict(X, u, D_hat, t)) / 2
"""


@pytest.fixture
def mine(tmp_path: Path) -> str:
    (tmp_path / "my_runtime.py").write_text(MINE)
    return f"{tmp_path}/my_runtime.py:Mine"


def test_a_runtime_of_a_file_or_of_a_package_evaluates_a_network(mine, package):
    package("mine = shed_of_tanks:Mine", MINE, "npred.runtimes")
    data, model = samples(4), operator(SMALL[0])
    P = Neural(PLANT, model)(data.X, data.u, data.D_hat)
    for name in (mine, "mine"):
        run = runtimes.predictor(name, PLANT, model, 21)
        assert type(run).__name__ == "Mine"
        np.testing.assert_array_equal(run(data.X, data.u, data.D_hat), P)


def test_a_runtime_of_a_file_enters_the_key_by_what_it_holds(mine):
    def asked(*names: str) -> list:
        pipeline = config.parse(tables(bench={"runtimes": list(names)}), "tests")
        return stage_registry.question(stage_registry.Node("bench", None, ()), pipeline, "cpu")["bench"]["runtimes"]

    before = asked("torch", mine)
    assert before[0] == "torch" and before[1]["name"] == "Mine" and str(Path(mine).parent) not in str(before)
    Path(mine.partition(":")[0]).write_text(MINE + "another = 1\n")
    assert asked("torch", mine) != before
    pipeline = config.parse(tables(bench={"runtimes": [mine]}), "tests")
    sources = stage_registry.sources(stage_registry.Node("bench", None, ()), pipeline)
    assert sources["bench.Mine"].text == MINE + "another = 1\n"


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("fast", "runtime: expected torch, fused, onnx, or a class of a file .* got 'fast'"),
        ("{folder}/my_runtime.py:Path", "expected a class Path, found Mine"),
    ],
)
def test_what_is_no_runtime_is_refused(mine, name, words):
    with pytest.raises(ConfigError, match=words):
        runtimes.predictor(name.format(folder=Path(mine).parent), PLANT, operator(SMALL[0]))
    with pytest.raises(
        ConfigError, match=r"bench.runtimes\[1\]: expected torch, fused, onnx, .* got 'fusd'; did you mean fused"
    ):
        config.parse(tables(bench={"runtimes": ["torch", "fusd"]}), "tests")
