"""Where a name is answered with the names that there are, the message says which of them comes closest; and what else a
newcomer writes is answered with what to write instead.
"""

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

import npred
from npred import plants
from npred.base.errors import NpredError, unlisted
from npred.cli import app
from npred.diagnosis import box
from npred.lab import config

SOURCES = Path(npred.__file__).parent


class Tank:
    """A level that an inflow moves."""

    states, inputs = ("h",), ("q",)
    parameters = {"area": 1.0}
    box = {"h": (0.5, 2.0)}
    f = lambda x, u, t, p, M: [(u.q - x.h) / p.area]
    kappa = lambda x, t, p, M: [1.0 + p.area * (1.0 - x.h)]


TANK = plants.make("tank", Tank)
PIPELINE = {"plant": "scalar", "evaluate": {"X0": [1.0]}}
COMMANDS = {  # what is written after npred, and the name that was meant
    "trian": "train",
    "check": "plants check",
    "plants check tank": "tank.py",
    "plants check tank.py:tank": "Tank",
    "train smoke --modell fno": "model",
    "train smoke --model fnoo": "fno",
    "report smoke --figures pages": "page",
    "export contrller smoke:rk4": "controller",
    "export controller paper --predictor heun --precision dubble": "double",
    "export fmu paper --predictor heun --platforms linux46": "linux64",
    "sweep smoke --to evaluat": "evaluate",
    "why evalute smoke": "evaluate",
    "run smok": "smoke",
    "run smoke --set train.deeponet.epoch=2": "epochs",
    "run smoke --set train.deeponet.optimiser=sopa": "soap",
    "run smoke --set generate.adaptation=frozn": "frozen",
    "run smoke --set evaluate.actuator=histori": "history",
    "run smoke --set train.models=['fnoo']": "fno",
    "export controller smoke:deepnet": "deeponet",
    "plants check activator_represor": "activator_repressor",
    "plants check scalar --kappa lqrr": "lqr",
    "reproduce unicycle_constnt": "unicycle_constant",
    "identify log.csv --plant scalar --time-unit mss": "ms",
    "identify log.csv --plant scalar --input UU=U": "U",
}
CALLS: dict[str, tuple[Callable[[], Any], str]] = {
    "attribute": (lambda: npred.simulat, "simulate"),
    "plant": (lambda: npred.plant("chemostatt"), "chemostat"),
    "parameter": (lambda: npred.plant("scalar", aa=1.0), "a"),
    "kappa": (lambda: npred.plant("scalar", kappa="lqrr"), "lqr"),
    "argument of a law": (lambda: plants.controlled(npred.plant("scalar"), {"law": "lqr", "q": 1.0}), "Q"),
    "predictor": (lambda: npred.predictor(TANK, "RK44"), "rk4"),
    "actuator": (lambda: simulated(actuator="measure"), "measured"),
    "watchdog": (lambda: npred.Watchdog(0.1, then="hodl"), "hold"),
    "observed state": (lambda: npred.observers.EKF(TANK, outputs=("H",)), "h"),
    "form of an export": (lambda: npred.export(controller(), "fmi", "x.fmu"), "fmu"),
    "precision": (lambda: npred.export(controller(), "controller", "x", precision="Float"), "float"),
    "platform": (lambda: npred.export(controller(), "fmu", "x.fmu", platforms=["win46"]), "win64"),
    "network": (lambda: npred.train("smoke", "deepnet"), "deeponet"),
    "free parameter": (lambda: npred.identify(TANK, "log.csv", columns={"q": "U", "h": "X"}, free=["are"]), "area"),
    "state of f": (lambda: traced(f=lambda x, u, t, p, M: [x.hh]), "h"),
    "function of M": (lambda: traced(f=lambda x, u, t, p, M: [M.sqr(x.h)]), "sqrt"),
    "box": (lambda: traced(box={"hh": (0, 1)}), "h"),
    "sizes": (lambda: config.parse(PIPELINE | {"train": {"fno": {"widht": 3}}}, "test"), "width"),
}


def simulated(**named: Any) -> Any:
    return npred.simulate(TANK, npred.predictor(TANK, "heun", 11), D=0.1, D_hat=0.1, X0=[1.0], t_end=0.1, **named)


def controller() -> Any:
    return npred.controller(TANK, npred.predictor(TANK, "heun", 11), None, 0.1, D_hat=0.1, actuator="measured")


def traced(**parts: Any) -> Any:
    plant = plants.make("other", type("Other", (Tank,), parts))
    return plant.f(np.ones((1, 1)), np.ones((1, 1)))


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "tank.py").write_text("class Tank:\n    states = ('h',)\n")
    for name in ("log.csv", "log.cvs"):
        (tmp_path / name).write_text("t,U,X\n" + "".join(f"{k},{k % 7},{k % 5}\n" for k in range(99)))


@pytest.mark.parametrize(("line", "meant"), COMMANDS.items())
def test_a_command_says_what_comes_closest(line: str, meant: str):
    done = CliRunner().invoke(app, [*line.split(), "-q"] if " " in line else [line])
    said = rf"(?i:did you mean|possible options).*(?<![\w.]){re.escape(meant)}\b"
    assert done.exit_code == 2 and re.search(said, done.output), done.output
    assert len(done.output.strip().splitlines()) == 1 or "Usage:" in done.output


@pytest.mark.parametrize("name", CALLS)
def test_python_says_what_comes_closest(name: str):
    call, meant = CALLS[name]
    with pytest.raises((NpredError, AttributeError)) as caught:
        call()
    assert re.search(rf"did you mean (\w\.)?{meant}\b", str(caught.value)), str(caught.value)


@pytest.mark.parametrize(
    ("line", "instead"),
    [
        ("run tank.py", 'expected a pipeline, a TOML file, got code; write plant = "tank.py:Tank" to one'),
        ("run tank.py:Tank", 'expected a pipeline, a TOML file, got code; write plant = "tank.py:Tank" to one'),
        ("run smoke --set evaluate.X0=0.5", "evaluate.X0: expected a list, got 0.5; put it in brackets"),
        ("run smoke --set bench.calls=1e3", "bench.calls: expected a whole number, got 1000.0; "),
    ],
)
def test_a_command_says_what_to_write_instead(line: str, instead: str):
    done = CliRunner().invoke(app, [*line.split(), "-q"])
    assert done.exit_code == 2 and instead in done.output, done.output
    assert len(done.output.strip().splitlines()) == 1


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: npred.load(TANK), "model: expected PIPELINE:MODEL, a path or a key, got <Plant tank"),
        (lambda: npred.laws.lqr("tank"), "plant: expected a Plant, got 'tank'; make one with npred.plant"),
        (lambda: npred.generate("smoke", settings=["generate.samples=9"]), "settings: expected keys and values"),
        (lambda: npred.lab.config.load("smok.toml"), "smok.toml: expected a pipeline file"),
    ],
)
def test_python_says_what_to_write_instead(call: Callable[[], Any], words: str):
    with pytest.raises(NpredError) as caught:
        call()
    assert words in str(caught.value) and "\n" not in str(caught.value)


def test_a_box_of_a_pipeline_says_what_comes_closest():
    case = type("Case", (), {"plant": TANK, "box": {"H": (0.0, 1.0)}, "experiment": None})
    assert "did you mean h?" in box.declared(case)[1]  # type: ignore[arg-type]


def test_no_message_lists_names_without_it():
    """All lists of names are written by one function."""
    listed = re.compile(r"expected (one of|some of|a type of) \{', '\.join|; (name|choose) one of (them|those|these)\"")
    places = [path.name for path in SOURCES.rglob("*.py") if listed.search(path.read_text())]
    assert set(places) == {"declared.py", "file.py", "devices.py"}  # which say it in other words


def test_a_name_far_from_all_is_answered_with_what_to_do():
    assert unlisted("form", "zip", ["c", "fmu"]) == "form: expected one of c, fmu, got 'zip'; name one of them"
    assert unlisted("free", "a", []) == "free: expected no name, for there is none to choose, got 'a'; leave it out"
