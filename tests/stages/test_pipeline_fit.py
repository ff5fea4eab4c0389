"""A pipeline that does not fit its plant is told before anything runs."""

import re
import tomllib

import numpy as np
import pytest
from follower import Follower

from npred import plants
from npred.base import array_checks
from npred.base.errors import ConfigError
from npred.diagnosis import equilibrium
from npred.lab import config
from npred.lab.scheduler import pipeline_fit
from npred.plants import Plant
from npred.plants.black_box import BlackBox

MOVING = """
class Moving:
    states, inputs, box = ("x",), ("U",), {"x": (0, 1)}
    def f(x, u, t, p, M): return [u.U]
    def kappa(x, t, p, M): return [M.sin(t) - x.x]
    def V(x, t, p, M): return x.x**2
"""

LATE = """
class Late:
    states, inputs, box, delays = ("x", "y"), ("U", "V"), {"x": (0, 1), "y": (0, 1)}, (1.0, 2.0)
    def f(x, u, t, p, M): return [u.U, u.V]
    def kappa(x, t, p, M): return [-x.x, -x.y]
    def V(x, t, p, M): return x.x**2 + x.y**2
"""
BOX = """
class Box:
    traced, states, inputs, box = False, ("x",), ("U",), {"x": (0, 1)}
    def f(X, u, t, p): return u
    def kappa(X, t, p): return -X
    def V(X, t, p): return X[:, 0] ** 2
"""
CLOCK = """
class Clock:
    states, inputs, box, period = ("x",), ("U",), {"x": (0, 1)}, 6.283185307179586
    def f(x, u, t, p, M): return [u.U + M.sin(t)]
    def kappa(x, t, p, M): return [-x.x - M.sin(t)]
    def V(x, t, p, M): return x.x**2
"""


def check(stages=("generate", "evaluate"), **tables):
    pipeline = config.parse({"plant": "activator_repressor"} | tables, "tests")
    pipeline_fit.require(plants.resolve(pipeline.plant, pipeline.parameters), pipeline, stages)


def test_the_default_pipeline_fits_but_for_the_start_that_it_has_to_give():
    check(evaluate={"X0": [0.03, 30.0]})
    check(stages=("generate", "train", "bench"))
    with pytest.raises(ConfigError, match=r"expected one number per state \(x1, x2\), got none; give as many"):
        check()


@pytest.mark.parametrize(
    ("tables", "message"),
    [
        ({"generate": {"box": {"x3": [0, 1]}}}, "generate.box: expected one of x1, x2, got 'x3'"),
        ({"evaluate": {"X0": [1.0]}}, r"evaluate.X0: expected one number per state \(x1, x2\), got \[1.0\]"),
        ({"evaluate": {"X0": [float("nan"), 1.0]}}, r"evaluate.X0\[0\]: expected a finite number"),
        (
            {"generate": {"input_bounds": [[0, 1], [0, 1]]}},
            r"generate.input_bounds: expected a pair \(low, high\) for each of U, .*; give 1",
        ),
        ({"evaluate": {"input_bounds": [[1, 0]]}}, r"evaluate.input_bounds\[0\]: expected .* low <= high"),
        ({"generate": {"box": {"x1": [3, 1]}}}, "generate.box.x1: expected .* low <= high"),
        (
            {"generate": {"box": {"x1": [0, float("inf")]}}},
            r"generate.box.x1\[1\]: expected a finite number, got inf",
        ),
    ],
)
def test_what_does_not_fit_is_told(tables, message):
    with pytest.raises(ConfigError, match=message):
        check(**tables)


@pytest.mark.parametrize(
    ("stage", "tables", "key"),
    [
        ("generate", {"generate": {"nx": 10**8}}, "generate.nx"),
        ("generate", {"generate": {"rollouts": 10**12, "samples": 10**12}}, "generate.rollouts"),
        ("evaluate", {"evaluate": {"nx": 10**8}}, "evaluate.nx"),
        ("evaluate", {"evaluate": {"case_states": 10**12}}, "evaluate.case_states"),
        ("bench", {"bench": {"dx": [1e-8]}}, "bench.dx, bench.batches"),
        ("bench", {"bench": {"dx": [0.1, 1e-12]}}, "bench.dx"),
        ("bench", {"bench": {"batches": [10**10]}}, "bench.dx, bench.batches"),
        ("bench", {"bench": {"calls": 10**12}}, "bench.calls"),
        ("certify", {"certify": {"restarts": 10**9}}, "certify.restarts, certify.steps"),
        ("certify", {"certify": {"steps": 10**9}}, "certify.restarts, certify.steps"),
        ("train", {"train": {"deeponet": {"width": 10**9}}}, "train.deeponet.width"),
    ],
)
def test_what_no_memory_holds_is_told_before_anything_runs(monkeypatch, stage, tables, key):
    monkeypatch.setattr(array_checks, "memory", lambda: 2**36)
    tables = {"evaluate": {}} | tables
    tables["evaluate"] = {"X0": [0.03, 30.0]} | tables["evaluate"]
    with pytest.raises(ConfigError, match=rf"^{re.escape(key)}: expected what fits into memory, 68.7 GB, got arrays"):
        check([stage], **tables)
    check([{"generate": "bench"}.get(stage, "generate")], **tables)


def test_a_step_longer_than_a_delay_that_is_estimated_is_told():
    slow = {"D": 0.12, "dt": 0.5, "samples": 50}
    with pytest.raises(ConfigError, match=r"generate.dt: expected at most the delay, 0.12, .* got 0.5; shorten"):
        check(stages=("generate",), generate=slow)
    check(stages=("generate",), generate=slow | {"adaptation": "frozen"})


def test_keys_that_nobody_wrote_are_not_told_to_leave_out():
    tables = {"generate": {"D": 0.3}}
    with pytest.raises(ConfigError, match=r"^generate.D: expected none, for plant transport_tank declares"):
        check(stages=("generate",), plant="transport_tank", **tables)


def test_a_plant_without_rest_or_reference_has_no_radius(tmp_path):
    path = tmp_path / "moving.py"
    path.write_text(MOVING)
    check(stages=("generate",), plant=f"{path}:Moving")
    with pytest.raises(ConfigError, match="expected a plant with a rest or a reference, Moving has neither"):
        check(plant=f"{path}:Moving")
    with pytest.raises(ConfigError, match=r'train.fno.anchor: .* Moving has none; write anchor = "initial"'):
        check(stages=("train",), plant=f"{path}:Moving", train={"deeponet": {"anchor": "initial"}})


def test_a_plant_with_a_reference_is_evaluated_if_its_law_follows_it(tmp_path):
    follows = "    def reference(t, p, M): return [(M.sin(t) - M.cos(t)) / 2]\n"
    path = tmp_path / "moving.py"
    path.write_text(MOVING + follows)
    check(plant=f"{path}:Moving", evaluate={"X0": [0.5]})
    path.write_text(MOVING + follows.replace("- M.cos", "+ M.cos"))
    with pytest.raises(
        ConfigError, match=r"reference \(moving.py:7\) expected a trajectory of f with kappa, got one that differs"
    ):
        check(plant=f"{path}:Moving", evaluate={"X0": [0.5]})


class Black(Follower):
    """The follower in functions that are not traced."""

    traced = False

    @staticmethod
    def f(X, u, t, p):
        return p.a * X + u

    @staticmethod
    def kappa(X, t, p):
        turn = p.w * np.reshape(t, (-1, 1))  # t is a number or (B,)
        return p.A * p.w * np.cos(turn) - p.a * X - p.c * (X - p.A * np.sin(turn))

    @staticmethod
    def V(X, t, p):
        return (X[:, 0] - p.A * np.sin(p.w * t)) ** 2

    @staticmethod
    def reference(t, p):
        return p.A * np.sin(p.w * t)[:, None]


@pytest.mark.parametrize("plant", [Plant("Follower", Follower, {"w": 3000.0}), BlackBox("Black", Black, {"w": 3000.0})])
def test_a_fast_reference_is_a_trajectory_too(plant):
    assert equilibrium.slip(plant, 5.0)[0] < equilibrium.SLIP


@pytest.mark.parametrize("kind", [Plant, BlackBox])
def test_a_fast_reference_that_is_none_is_found_out(kind):
    late = {Plant: lambda t, p, M: [p.A * M.sin(p.w * t - 1e-4)],
            BlackBox: lambda t, p: p.A * np.sin(p.w * t - 1e-4)[:, None]}  # fmt: skip
    base = Follower if kind is Plant else Black
    plant = kind("late", type("Late", (base,), {"reference": staticmethod(late[kind])}), {"w": 3000.0, "c": 1.0})
    assert equilibrium.slip(plant, 5.0)[0] > 10 * equilibrium.SLIP


@pytest.mark.parametrize("plant", ["unicycle", "CLOCK", "LATE", "BOX"])
def test_runtimes_that_bench_cannot_run_are_told_before_anything_runs(tmp_path, plant):
    """Clocks and several delays are served by all of them, a black box not by ONNX Runtime."""
    path = tmp_path / "given.py"
    path.write_text(LATE + BOX + CLOCK)
    named = plant if plant == "unicycle" else f"{path}:{plant.capitalize()}"
    frozen, stages = {"adaptation": "frozen"}, ("generate", "bench")
    check(stages=stages, plant=named, generate=frozen, bench={"runtimes": ["torch"]})
    check(stages=("generate",), plant=named, generate=frozen, bench={})
    if plant != "BOX":
        check(stages=stages, plant=named, generate=frozen, bench={})
        return
    message = 'expected .* is traced, Box says traced = False; set bench.runtimes = ."torch", "fused".'
    with pytest.raises(ConfigError, match=message):
        check(stages=stages, plant=named, generate=frozen, bench={})


def test_all_that_is_for_one_delay_is_told_at_once_with_one_cure(tmp_path):
    path = tmp_path / "late.py"
    path.write_text(LATE)
    stages, picard = ("generate", "train", "evaluate", "bench"), {"predictor": "picard"}
    with pytest.raises(ConfigError) as caught:
        check(stages, plant=f"{path}:Late", generate=picard)
    cure = tomllib.loads(f"all = {{ {str(caught.value).partition('; set ')[2]} }}")["all"]
    assert set(cure["generate"]) == {"adaptation", "predictor"} and set(cure["evaluate"]) == {"adaptation"}
    cure["evaluate"]["X0"] = [0.5, 0.5]
    check(stages, plant=f"{path}:Late", **cure)


def test_a_frozen_estimate_takes_no_V(tmp_path):
    path = tmp_path / "late.py"
    path.write_text(
        LATE.replace("(1.0, 2.0)", "(2.0, 2.0)").replace("    def V(x, t, p, M): return x.x**2 + x.y**2\n", "")
    )
    frozen = {"adaptation": "frozen"}
    check(plant=f"{path}:Late", generate=frozen, evaluate=frozen | {"X0": [0.5, 0.5]})
    check(plant=f"{path}:Late", generate=frozen, stages=("generate",))
    for tables in ({"generate": frozen}, {"evaluate": frozen}):
        with pytest.raises(ConfigError, match="plant Late: expected V"):
            check(plant=f"{path}:Late", **tables)


def test_a_state_without_a_range_is_told(tmp_path):
    path = tmp_path / "moving.py"
    path.write_text(MOVING.replace('{"x": (0, 1)}', "{}"))
    with pytest.raises(ConfigError, match=r"found none; add x = \[low, high\]"):
        check(plant=f"{path}:Moving")


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("[M.sin(t) - x.x]", "[1 + x.x**2]", "leads to no rest near guess"),
        ("[u.U]", "[u.U + M.sin(t)]", "Moving: expected a period, for its prediction depends on time"),
        ("[M.sin(t) - x.x]", "[x.x]", r"moving.py:5\) does not stabilise without delay: eigenvalues 1 at x = 0"),
        ("[u.U]", "[u.U / M.sqrt(x.x - 0.5)]", r"f \(moving.py:4\) is not finite at x = 0.\d+, .*; shrink box"),
        (
            "[u.U]",
            "[u.U, x.x]",
            r"f \(moving.py:4\) expected to return 1 value, got 2; return one deriv.* per state: x",
        ),
    ],
)
def test_a_plant_that_no_network_can_serve_is_told(tmp_path, old, new, message):
    path = tmp_path / "moving.py"
    path.write_text(MOVING.replace(old, new))
    with pytest.raises(ConfigError, match=message):
        check(stages=("generate",), plant=f"{path}:Moving")


DECLARED = """
class Declared:
    states, inputs, box = ("x",), ("u",), {"x": (0.0, 1.0)}
    def f(x, u, t, p, M): return [u.u]
    def kappa(x, t, p, M): return [-x.x]
    def delay(x, t, p, M): return 0.5 + 0.1 * x.x
"""


@pytest.mark.parametrize(
    ("tables", "message"),
    [
        ({}, None),
        ({"generate": {"adaptation": "frozen"}}, None),
        ({"generate": {"D": 1.0, "D_hat": [(0.3, 0.7), (1.0, 2.0), (1.0, 2.0)]}}, None),  # the defaults, of a dump
        ({"generate": {"D": 0.7}}, "^generate.D: expected none, for plant .* declares delay.*; leave it out$"),
        (
            {"generate": {"redraw": 0.2}, "evaluate": {"map_D": [1.0], "map_D_hat": [1.0]}},
            "^generate.redraw, evaluate.map_D, evaluate.map_D_hat: expected none, .*; leave them out$",
        ),
        ({"evaluate": {"scenarios": [{"name": "a", "jump": {"to": 1, "at": 3}}]}}, r"^evaluate.scenarios\[0\].jump:"),
        ({"evaluate": {"scenarios": [{"name": "a", "measurement": {"relative_noise": 0.1}}]}}, None),
        ({"generate": {"predictor": "picard"}}, "expected a delay that is a number, .*; set generate.predictor"),
    ],
)  # fmt: skip
def test_a_pipeline_names_no_delay_where_the_plant_declares_it(tmp_path, tables, message):
    path = tmp_path / "declared.py"
    path.write_text(DECLARED)
    tables = {"plant": f"{path}:Declared"} | tables
    tables["evaluate"] = {"X0": [0.5]} | tables.get("evaluate", {})
    if message is None:
        check(("generate", "train", "evaluate", "bench"), **tables)
    else:
        with pytest.raises(ConfigError, match=message):
            check(("generate", "train", "evaluate", "bench"), **tables)


@pytest.mark.parametrize(
    ("scenario", "message"),
    [
        ({"truth": {"k1": 1.0}}, "got 'k1'"),
        ({"adaptation": "missing.py:Law"}, "missing.py"),
        (
            {"measurement": {"bias": [0.1]}},
            "expected bias as one number or 2, one per state of plant activator_repressor, got 1",
        ),
        ({"measurement": {"resolution": []}}, "expected resolution as one number or 2, .*, got 0; give as many"),
    ],
)
def test_a_scenario_that_cannot_run_is_told_before_anything_runs(scenario, message):
    evaluate = {"X0": [0.03, 30.0], "scenarios": [{"name": "a"} | scenario]}
    check(stages=("generate",), evaluate=evaluate)
    with pytest.raises(ConfigError, match=message):
        check(evaluate=evaluate)


def test_laws_that_take_no_V_need_none(tmp_path):
    path = tmp_path / "bare.py"
    path.write_text(MOVING.replace("M.sin(t) - x.x", "-x.x").replace("    def V(x, t, p, M): return x.x**2\n", ""))
    for law in ("delay-observer", "l1"):
        check(("generate",), plant=f"{path}:Moving", generate={"adaptation": law})
    with pytest.raises(ConfigError, match=r"expected V\(.*found none"):
        check(("generate",), plant=f"{path}:Moving")
