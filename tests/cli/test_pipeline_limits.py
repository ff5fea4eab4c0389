"""Limits in a pipeline: what [evaluate] safety does, what its key holds, what goes to C and to an FMU."""

import ctypes
import json
import subprocess

import c_controllers
import numpy as np
import pytest
from conftest import settings_of
from typer.testing import CliRunner

import npred
from npred.base import randomness
from npred.base.errors import ConfigError
from npred.cli import app
from npred.lab import config
from npred.lab.config.conditions import starts
from npred.lab.scheduler import pipeline_fit
from npred.lab.scheduler.models import load_model
from npred.lab.scheduler.plan import Node
from npred.networks.fused import Fused
from npred.networks.weights import read
from npred.prediction.methods import RK4

CART = """
class Cart:
    states, inputs, guess = ("x", "v"), ("u",), (0.95, 0.0)
    box, input_bounds = {"x": (-0.6, 0.6), "v": (-0.4, 0.4)}, ((-5.0, 5.0),)

    def f(x, u, t, p, M):
        return [x.v, u.u]

    def kappa(x, t, p, M):
        return [-4 * (x.x - 0.95) - 1.2 * x.v]

    def safe(x, t, p, M):
        return [1.0 - x.x, 1.0 + x.x]
"""
TEXT = """
plant = "cart.py:Cart"
[generate]
samples = 100
rollouts = 5
t_end = 2.0
dt = 0.01
nx = 11
D = 0.3
D_hat = [[0.28, 0.32]]
adaptation = "frozen"
[train]
models = ["deeponet"]
[train.deeponet]
epochs = 2
width = 8
[evaluate]
X0 = [-0.6, 0.2]
D = 0.3
D_hat = 0.3
case_D_hat = [0.29, 0.3, 0.31]
case_states = 4
case_t_end = 6.0
t_end = 6.0
dt = 0.01
nx = 11
adaptation = "frozen"
actuator = "history"
u0 = [0.0]
[[evaluate.scenarios]]
name = "kept"
safety = { alpha = 3.0, delay = 0.02 }
"""
FILTER = ("--safety", "alpha=3,delay=0.02")


@pytest.fixture(scope="module")
def evaluated(tmp_path_factory):
    """A folder with plant, pipeline and store, and what its evaluation found."""
    folder = tmp_path_factory.mktemp("limits")
    (folder / "cart.py").write_text(CART)
    (folder / "cart.toml").write_text(TEXT)
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        done = CliRunner().invoke(app, ["evaluate", "cart.toml", "--store", "store", "-q", "--jobs", "1", "--json"])
        assert done.exit_code == 0, done.output
        plant = npred.plant("cart.py:Cart")
    return folder, plant, json.loads(done.stdout)["result"]


@pytest.fixture
def export(evaluated, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    folder = evaluated[0]
    more = ["--store", str(folder / "store")]
    return lambda form, model, *flags: CliRunner().invoke(app, ["export", form, f"{folder}/{model}", *more, *flags])


def test_an_evaluation_says_how_limits_are_kept_with_a_filter_and_without(evaluated):
    folder, plant, result = evaluated
    pipeline = config.load(folder / "cart.toml")
    begin = starts(pipeline, plant)
    rows = begin.cases
    free = result["models"]["numerical"]["limits"]
    kept = result["scenarios"][0]["models"]["numerical"]["limits"]
    for limits, safety in ((free, None), (kept, npred.SafetyFilter(3.0, delay=0.02))):
        loop = npred.simulate(
            plant, RK4(plant, 11), D=0.3, D_hat=begin.D_hat[rows], X0=begin.X0[rows], t_end=6.0, dt=0.01,
            u0=[0.0], actuator="history", safety=safety,
        )  # fmt: skip
        h = np.minimum(1 - loop.X[..., 0], 1 + loop.X[..., 0])
        assert limits["least"] == h[:, ::10].min()  # every tenth step is kept
        if safety:
            assert limits["filtered"] == pytest.approx(loop.filtered.mean(), abs=1e-12)  # here every step is
            assert limits["unkept"] == 0 and 0.05 < limits["filtered"] < 0.5
    assert free["least"] < -0.2 and (free["filtered"], free["unkept"]) == (None, None)
    assert kept["least"] > 0


def test_its_key_holds_the_limits_and_that_of_the_data_only_with_a_filter(evaluated, tmp_path):
    def keys(old, new, *overrides):
        (tmp_path / "cart.py").write_text(CART.replace(old, new))
        (tmp_path / "cart.toml").write_text(TEXT)
        loaded = config.load(tmp_path / "cart.toml", [*overrides])
        return [settings_of(Node(stage, None, ()), loaded) for stage in ("generate", "evaluate")]

    data, loops = keys("", "")
    assert keys("    def safe", "    # the track\n    def safe") == [data, loops]
    other_data, other_loops = keys("[1.0 - x.x,", "[0.9 - x.x,")
    assert other_data == data and other_loops != loops
    filtered = "generate.safety.alpha=2.0"
    assert keys("", "", filtered)[0] != keys("[1.0 - x.x,", "[0.9 - x.x,", filtered)[0] != data


@pytest.mark.parametrize(
    "flags", [FILTER, (*FILTER, "--guard", "0.1"), (*FILTER, "--observer", 'kind=ekf,outputs=["x"]')]
)
@c_controllers.needs_gcc
def test_a_network_with_a_filter_in_c_is_that_of_python(export, evaluated, tmp_path, flags):
    """The exported files in a loop, beside a controller that is made from its parts in Python."""
    folder, plant, _ = evaluated
    done = export("controller", "cart.toml:deeponet", "-o", ".", *flags)
    assert done.exit_code == 0, done.output
    (tmp_path / "sizes.c").write_text(c_controllers.SIZES)
    command = ["gcc", *c_controllers.FLAGS, "-shared", "-fPIC", "sizes.c", "-o", "npred.so", "-lm"]
    subprocess.run(command, cwd=tmp_path, check=True, timeout=60)
    in_c = c_controllers.InC(ctypes.CDLL(str(tmp_path / "npred.so")), plant)
    stored = load_model(f"{folder / 'cart.toml'}:deeponet", folder / "store")
    operator = read(stored.folder, plant, None, np.float64, stored.config)
    predictor = Fused(plant, operator, 11, precision=np.float64)
    if "--guard" in flags:
        predictor = npred.guarded(predictor, 0.1, exact=RK4(plant, 11))
    observer = npred.observers.EKF(plant, outputs=["x"]) if "--observer" in flags else None
    python = npred.controller(
        plant, predictor, None, dt=0.01, D_hat=0.3, u0=[0.0], actuator="history", observer=observer,
        safety=npred.SafetyFilter(3.0, delay=0.02),
    )  # fmt: skip
    rng, X, filtered = randomness.generator(0, "limits"), np.array([-0.6, 0.2]), 0
    for _ in range(300):
        Y = X[:1] if observer else X
        U, U_c = python.step(Y), in_c.step(Y)
        np.testing.assert_allclose(U_c, U, rtol=1e-6, atol=1e-12)  # a network's sums round otherwise
        filtered += python.status.filtered
        X = X + 0.01 * np.array([X[1], U[0]]) + rng.normal(0, 1e-3, 2)
    assert 20 < filtered < 300


def test_an_fmu_has_the_filter_of_the_flag_and_of_the_pipeline(export):
    none, flag, table = (
        export("fmu", "cart.toml", "--predictor", "rk4", "--json", *flags)
        for flags in ((), FILTER, ("--set", "evaluate.safety={alpha=3.0, delay=0.02}"))
    )
    variables = [json.loads(done.stdout)["variables"] for done in (none, flag, table)]
    added = {"filtered", "kept", "unkept", "promised", "withdrawn"}
    assert set(variables[1]) - set(variables[0]) == added and variables[1] == variables[2]
    assert json.loads(flag.stdout)["token"] == json.loads(table.stdout)["token"]


@pytest.mark.parametrize(
    ("flags", "message"),
    [
        (("--safety", "3"), "--safety: expected KEY=VALUE,…, got '3'; name the keys of evaluate.safety"),
        (("--safety", "alfa=3"), "evaluate.safety.alfa: unknown key; expected one of alpha, delay, horizon, margin"),
        (("--safety", "alpha=0"), "safety: expected alpha above 0, got 0; give another"),
        ((*FILTER, "--actuator", "measured"), "safety: expected actuator=\"history\", got 'measured'"),
    ],
)
def test_a_filter_that_cannot_be_is_one_line(export, flags, message):
    done = export("controller", "cart.toml", "--predictor", "rk4", *flags)
    assert done.exit_code == 2 and message in done.stderr.splitlines()[-1]


def test_a_filter_of_a_plant_without_limits_is_refused_before_anything_runs():
    tables = {"plant": "scalar", "evaluate": {"X0": [0.5], "scenarios": [{"name": "a", "safety": {"alpha": 1.0}}]}}
    pipeline = config.parse(tables, "tests")
    with pytest.raises(ConfigError, match=r"expected a plant with safe\(x, t, p, M\)"):
        pipeline_fit.require(npred.plant("scalar"), pipeline, ("evaluate",))
