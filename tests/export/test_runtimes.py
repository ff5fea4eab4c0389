"""Runtimes by name: of npred, of an installed package, of a user's file; and without a name: torch in calls, the
compiled function in loops.
"""

import pickle
from pathlib import Path

import numpy as np
import pytest
import torch
from conftest import settings_of
from jobs import tables
from operator_samples import EVERY, PLANT, SMALL, operator, samples

import npred
from npred import networks as runtimes
from npred.base.errors import ConfigError
from npred.lab import config
from npred.lab.scheduler.plan import Node
from npred.lab.training.neural import Neural
from npred.networks.fused import Fused

LOOP = {"D": 1.0, "D_hat": [0.8, 2.0], "X0": [0.03, 30.0], "t_end": 0.5, "dt": 0.01}
MINE = """
from npred.lab.training.neural import Neural

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
        return settings_of(Node("bench", None, ()), pipeline)["bench"]["runtimes"]

    before = asked("torch", mine)
    assert before[0] == "torch" and before[1]["name"] == "Mine" and str(Path(mine).parent) not in str(before)
    Path(mine.partition(":")[0]).write_text(MINE + "another = 1\n")
    assert asked("torch", mine) != before


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


def loop(run):
    return npred.simulate(PLANT, run, adaptation=npred.DelayAdaptation(1000.0, 1.0, (0.1, 4.0)), **LOOP).X


@pytest.mark.parametrize("config", SMALL, ids=lambda config: type(config).__name__)
def test_calls_are_those_of_torch_and_loops_those_of_the_compiled_function(config):
    model, data = operator(config).double(), samples(4, 21)
    run, by_torch = runtimes.predictor(None, PLANT, model, 21), Neural(PLANT, model, 21)
    for rows in (slice(None), 0):
        inputs = data.X[rows], data.u[rows], data.D_hat[rows]
        np.testing.assert_array_equal(run(*inputs), by_torch(*inputs))
    assert run(data.X, samples(4, 33).u, data.D_hat).shape == (4, 33, 2)
    assert "fused" not in vars(run)  # no call has compiled anything
    np.testing.assert_array_equal(loop(run), loop(Fused(PLANT, model, 21, precision=np.float64)))
    np.testing.assert_allclose(loop(run), loop(by_torch), rtol=1e-9)
    np.testing.assert_array_equal(loop(pickle.loads(pickle.dumps(run))), loop(run))


def test_a_controller_and_a_guard_call_the_compiled_function():
    model = operator(SMALL[0]).double()
    run = runtimes.predictor(None, PLANT, model, 21)
    u = np.zeros((21, 1))
    for wrap in (lambda predictor: predictor, npred.guarded):
        controllers = [
            npred.controller(PLANT, wrap(predictor), None, dt=0.01, D_hat=1.0, actuator="measured")
            for predictor in (run, Fused(PLANT, model, 21, precision=np.float64))
        ]
        assert controllers[0].step([0.03, 30.0], u) == controllers[1].step([0.03, 30.0], u)
        assert controllers[0].predictor.compiled


@pytest.mark.parametrize(
    ("config", "device"), [*((config, "cpu") for config in EVERY if config not in SMALL), (SMALL[0], "meta")]
)
def test_without_a_fused_form_or_on_another_device_it_is_torch(config, device):
    assert type(runtimes.predictor(None, PLANT, operator(config), 21, device=device)) is Neural


def test_a_loop_has_one_thread_of_torch_and_so_has_a_single_row():
    seen, before = [], torch.get_num_threads()

    run, data = Neural(PLANT, operator(EVERY[-1]), 21), samples(3, 21)
    run.operator.register_forward_pre_hook(lambda _, inputs: seen.append((len(inputs[0]), torch.get_num_threads())))
    try:
        torch.set_num_threads(2)
        run(data.X, data.u, data.D_hat)
        run(data.X[0], data.u[0], data.D_hat[0])
        npred.simulate(PLANT, run, D=1.0, D_hat=[0.8, 2.0], X0=[0.03, 30.0], t_end=0.01, dt=0.01)
        assert torch.get_num_threads() == 2
    finally:
        torch.set_num_threads(before)
    assert set(seen) == {(3, 2), (1, 1), (2, 1)}
