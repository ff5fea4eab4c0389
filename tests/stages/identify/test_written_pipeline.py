"""The pipeline of an identified plant: its step, its delays, and that npred's commands take it as it is."""

import pickle
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from npred import plants
from npred.base.errors import ConfigError
from npred.cli import app
from npred.lab import config
from npred.lab.config import dumps
from npred.lab.config.results import IdentifiedResult
from npred.lab.stages.identify.pipeline import composed

PLANTS = """
class Room:
    states, inputs = ("T",), ("q",)
    parameters = {"K": 5.0, "tau": 4.0}
    box, guess, time_unit = {"T": (0.0, 40.0)}, (10.0,), "h"

    def f(x, u, t, p, M):
        return [(p.K * u.q - x.T) / p.tau]

    def kappa(x, t, p, M):
        return [(20.0 - x.T) / p.K]


class Steered(Room):
    parameters = Room.parameters | {"strength": 1.0}

    def kappa(x, t, p, M):
        return [(10.0 - p.strength * (x.T - 10.0)) / p.K]


class Unboxed(Room):
    box, kappa = {}, None


class Flow:
    states, inputs = ("H", "T"), ("q", "r")
    parameters = {"tau": 4.0}
    box = {"H": (0.0, 40.0), "T": (0.0, 40.0)}

    def f(x, u, t, p, M):
        return [u.q - x.H, (x.H + u.r - x.T) / p.tau]

    def kappa(x, t, p, M):
        return [10.0 - 0.5 * x.H, 0.0]
"""


def made(kind: str, D: list[float], interval: list[tuple[float, float]], period: float, **more: Any) -> Any:
    """The pipeline file of an answer, its tables as they are read again, and the remarks."""
    Path("my_plant.py").write_text(PLANTS)
    asked = config.parse({"name": "log", "plant": f"my_plant.py:{kind}"}, "log.csv")
    plant = plants.resolve(*asked.of_plant)
    answer = {"identifiable": [True] * len(D), "parameters": {"tau": 5.0}, "parameter_intervals": {"tau": (4.0, 6.0)}}
    answer |= {"ranges": {"T": (1.0, 30.0)}, "refused": False, "held_back": {}, "sentences": [], "samples": 99} | more
    answer |= {"plant": kind, "inputs": list(plant.inputs), "D": D, "interval": interval, "period": period}
    tables, remarks = composed(asked, plant, IdentifiedResult.model_validate(answer), Path("log.toml"))
    Path("log.toml").write_text(dumps(tables))
    return config.load("log.toml"), " ".join(remarks)


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def runs() -> None:
    """Check, simulate and export take the file unchanged, and the check has no doubt of its steps."""
    for call in ("plants check log.toml", "generate log.toml", "export controller log.toml -o out"):
        done = CliRunner().invoke(app, [*call.split(), "-q"])
        assert done.exit_code == 0, f"{call}: {done.output}"
        assert ".dt   warn" not in done.output


@pytest.mark.parametrize(
    ("D", "period", "dt"),
    [
        (40.0, 0.25, 0.125),  # two steps in a period, for the delay observer
        (2.0, 0.25, 0.05),  # 40 steps in the delay
        (0.1, 0.25, 0.00625),  # no more than 40 in a period
        (40.0, 4.0, 0.2),  # the rate 0.4 / h
    ],
)
def test_the_control_step_is_a_part_of_the_period(D: float, period: float, dt: float):
    pipeline, _ = made("Room", [D], [(0.9 * D, 1.1 * D)], period)
    assert pipeline.evaluate.dt == pipeline.generate.dt == pytest.approx(dt)
    assert pipeline.evaluate.measurement.period == pytest.approx(period)
    assert pipeline.evaluate.t_end > 5 * D and pipeline.evaluate.D_hat == D


def test_a_delay_of_zero_is_that_of_a_control_step():
    pipeline, remarks = made("Room", [0.0], [(0.0, 0.03)], 0.25)
    assert pipeline.evaluate.D == pipeline.evaluate.dt == 0.125
    assert "shorter than a control step, the least that a loop can have: D = 0.125 h" in remarks
    runs()


def test_each_input_keeps_its_delay_and_states_without_a_column_are_observed():
    pipeline, remarks = made("Flow", [2.0, 4.0], [(1.9, 2.1), (3.9, 4.1)], 0.2)
    assert pipeline.delays == [2.0, 4.0] and pipeline.evaluate.D == 4.0 and "q 2 s, r 4 s" in remarks
    plant = plants.resolve(*pipeline.of_plant)
    assert list(plant.ratios) == list(pickle.loads(pickle.dumps(plant)).ratios) == [0.5, 1.0]
    assert pipeline.evaluate.observer.outputs == ["T"]
    runs()


def test_a_plant_without_law_and_box_gets_both():
    pipeline, remarks = made("Unboxed", [2.0], [(1.9, 2.1)], 0.25)
    assert pipeline.kappa == "lqr" and "LQR" in remarks and pipeline.generate.box == {"T": (1.0, 30.0)}
    runs()


@pytest.mark.parametrize(
    ("named", "words"),
    [
        ({"parameters": {"tau": -5.0}}, "npred plants check would say no for stability"),
        ({"parameters": {"tau": 1e12}}, "expected rates that samples show"),
    ],
)
def test_a_plant_that_its_law_does_not_hold_gives_none(named: dict[str, Any], words: str):
    with pytest.raises(ConfigError, match=words):
        made("Room", [2.0], [(1.9, 2.1)], 0.25, **named)


def test_an_input_whose_delay_is_open_has_the_middle_of_its_range():
    pipeline, remarks = made("Flow", [2.0, 4.0], [(0.0, 3.0), (3.9, 4.1)], 0.2, identifiable=[False, True])
    assert pipeline.delays == [1.5, 4.0] and pipeline.evaluate.D == 4.0
    assert "The delay of q is not identifiable: it is the middle of its range, 1.5 s" in remarks


def test_a_delay_that_changes_begins_at_that_of_the_last_window_within_bounds_that_hold_all():
    windows = {"t": [10.0, 20.0], "D": [[2.4], [3.9]], "interval": [[(2.3, 2.5)], [(3.8, 4.0)]]}
    pipeline, remarks = made("Room", [3.9], [(2.3, 4.0)], 0.25, identifiable=[False], windows=windows)
    assert pipeline.evaluate.D_hat == 3.9 and pipeline.evaluate.bounds == (2.3, 4.0)
    assert "It begins at that of the last window, 3.9 h" in remarks


@pytest.mark.slow
def test_tune_takes_the_pipeline_of_a_range():
    made("Steered", [1.0], [(0.0, 8.0)], 0.25, identifiable=[False])
    runs()
    done = CliRunner().invoke(app, ["tune", "log.toml", "-q", "--free", "strength", "--set", "tune.evaluations=10"])
    assert done.exit_code == 0, done.output
