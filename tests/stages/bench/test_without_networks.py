"""Whether a network could pay: methods on the fewest steps of an error, an untrained network, and the sentence."""

import json
import re

import numpy as np
import pytest
from result_samples import CROSSOVER
from typer.testing import CliRunner

from npred import plants
from npred.base.errors import ConfigError
from npred.cli import app
from npred.lab import config
from npred.lab.config.results.bench import Crossover
from npred.lab.stages.bench import without_networks
from npred.lab.stages.bench.candidates import Reference
from npred.lab.stages.generate import sampling
from npred.networks.fused import Fused
from npred.networks.weights import untrained
from npred.prediction.methods import RK4, method


def crossovers(*speedups):
    return [
        Crossover.of(CROSSOVER | {"network_speedup": speedup, "eps_sup": eps}, "a test")
        for speedup, eps in zip(speedups, (0.1, 0.01), strict=True)
    ]


@pytest.mark.parametrize(
    ("speedups", "words"),
    [
        ((0.5, 0.9), "No network pays for arm: the network takes 10.0 µs"),
        ((0.5, 2.0), "A network could pay for arm if its error is 0.01 or less: the"),
        ((2.0, 0.5), "A network could pay for arm, but not if its error has to be 0.01: the"),
        ((2.0, 3.0), "A network could pay for arm: the network takes 10.0 µs, RK4 on 10 steps 5.0 µs at ε = 0.1, RK4"),
    ],
)
def test_sentence(speedups, words):
    text = without_networks.sentence(crossovers(*speedups))
    assert text.startswith(words)
    least = "at least 200 ns (for 1 % error) or 200 ns (for 1 % error); here it takes 80 ns."
    assert f"A network pays where an evaluation of f takes {least}" in text


def test_each_method_has_the_fewest_steps_that_reach_the_error(monkeypatch):
    """Against RK4 on ten times as many steps as the reference has, on the same samples."""
    pipeline, plant = config.parse({"plant": "scalar"}, "tests"), plants.resolve("scalar")
    found = without_networks.measure(pipeline, plant)
    data = without_networks._samples(pipeline, plant)
    later = data.t > data.D
    X, u, D_hat = data.X[later], data.u[later], data.D_hat[later]
    fine = RK4(plant, 20001)(X, without_networks.grid.means(u, 20001), D_hat)[:, -1]

    def error(name, steps):
        P_hat = method(name)(plant, steps + 1)(X, without_networks.grid.means(u, steps + 1), D_hat)
        return np.abs(P_hat[:, -1] - fine).max()

    assert [c.eps_relative for c in found.crossover] == pytest.approx([1e-2, 1e-3])
    for crossover in found.crossover:
        for row in crossover.numerical:
            assert error(row.predictor, row.steps) <= crossover.eps_sup * (1 + 1e-6)
    assert {row.predictor for row in found.crossover[1].numerical} >= {"heun", "rk4"}
    heun = next(row for row in found.crossover[1].numerical if row.predictor == "heun")
    one_step_fewer = Reference.of(plant, data).of_method(method("heun")(plant), heun.steps)  # so many nodes
    assert one_step_fewer.sup > found.crossover[1].eps_sup


def test_an_untrained_network_has_the_arrays_of_a_trained_one():
    plant = plants.resolve("activator_repressor")
    weights = untrained(config.Train().table("deeponet"), plant, np.random.default_rng(0))
    X, u, D_hat = np.array([[0.03, 30.0]]), np.zeros((1, 101, 1)), np.array([1.0])
    P = Fused(plant, weights, 101)(X, u, D_hat)
    assert P.shape == (1, 101, 2) and np.isfinite(P).all()
    pytest.importorskip("torch")
    assert sum(a.numel() for a in weights.module(plant).network.parameters()) > 10_000


def test_samples_are_of_short_loops_and_finite():
    pipeline, plant = config.parse({"plant": "chemostat", "generate": {"D": 0.5}}, "tests"), plants.resolve("chemostat")
    data = without_networks._samples(pipeline, plant)
    assert data.t.max() <= 8 * 0.5 and np.isfinite(data.P).all() and len(data) == 120
    assert len(Reference.of(plant, data).X) <= 120


FILE = """
class Tank:
    states, inputs = ("h",), ("q",)
    box, guess = {"h": (0.5, 2.0)}, (1.0,)

    def f(x, u, t, p, M):
        return [u.q - 0.5 * M.sqrt(x.h)]

    def kappa(x, t, p, M):
        return [0.5 * M.sqrt(x.h) - (x.h - 1)]

    def V(x, t, p, M):
        return (x.h - 1) ** 2
"""


def test_the_command_takes_a_plant_and_stores_nothing(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "tank.py").write_text(FILE)
    flags = ["--no-networks", "--json", "--set", "generate.D=0.3", "--set", 'generate.u0="equilibrium"']
    done = CliRunner().invoke(app, ["bench", "tank.py:Tank", *flags])
    assert done.exit_code == 0, done.output
    document = json.loads(done.stdout)
    assert document["plant"] == "Tank" and document["sentence"].count("Tank") == 1
    assert [c["f_ns"] > 0 and c["network_us"] > 0 for c in document["crossover"]] == [True, True]
    assert sorted(path.name for path in tmp_path.iterdir() if path.name != "__pycache__") == ["tank.py"]


def test_the_command_prints_a_table_for_a_plant_by_name():
    done = CliRunner().invoke(app, ["bench", "scalar", "--no-networks"])
    assert done.exit_code == 0, done.output
    assert "deeponet" in done.stdout and "not trained" in done.stdout and "for scalar" in done.stdout.splitlines()[-1]


def test_what_is_neither_pipeline_nor_plant_is_told():
    done = CliRunner().invoke(app, ["bench", "scaler", "--no-networks"])
    assert done.exit_code == 2 and "did you mean scalar?" in done.stderr


def test_an_error_that_no_method_reaches_is_told(monkeypatch):
    monkeypatch.setattr(without_networks, "RELATIVE", (-1.0,))
    with pytest.raises(ConfigError, match=r"bench: expected a method whose error is -.*, got .*rk4"):
        without_networks.measure(config.parse({"plant": "scalar"}, "tests"), plants.resolve("scalar"))


def test_a_plant_without_a_box_is_refused():
    class Boxless:
        states, inputs, guess = ("x",), ("U",), (0.0,)
        f = lambda x, u, t, p, M: [u.U]
        kappa = lambda x, t, p, M: [-x.x]

    with pytest.raises(ConfigError, match="box"):
        without_networks.measure(config.parse({"plant": "scalar"}, "tests"), plants.Plant("boxless", Boxless))


@pytest.mark.parametrize(
    ("adaptation", "runs"),
    [("frozen", "frozen"), ("delay-observer", "delay-observer"), ("bresch-pietri-krstic", "delay-observer")],
)
def test_a_plant_without_V_runs_its_own_law_unless_that_takes_one(monkeypatch, adaptation, runs):
    """Of first estimates below 0.1 s too, as D is 0.3 s: a frozen one knows no bounds."""

    class Pendulum:
        states, inputs = ("theta", "omega"), ("torque",)
        box = {"theta": (-0.5, 0.5), "omega": (-0.5, 0.5)}
        f = lambda x, u, t, p, M: [x.omega, 10 * M.sin(x.theta) + u.torque]
        kappa = lambda x, t, p, M: [-10 * M.sin(x.theta) - 4 * x.theta - 4 * x.omega]

    asked, rows = [], sampling.rows
    monkeypatch.setattr(
        sampling, "rows", lambda pipeline, *of, **named: asked.append(pipeline) or rows(pipeline, *of, **named)
    )
    pipeline = config.parse({"plant": "Pendulum", "generate": {"D": 0.3, "adaptation": adaptation}}, "tests")
    found = without_networks.measure(pipeline, plants.Plant("Pendulum", Pendulum))
    assert [each.generate.adaptation for each in asked] == [runs]
    assert re.match("(No network pays|A network could pay) for Pendulum", found.sentence)  # times decide
