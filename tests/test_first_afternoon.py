"""The first afternoon of a new user: an own plant, from its class to a figure for an article and a controller in C.

`pytest tests/test_first_afternoon.py -s` prints how long each step takes.
"""

import subprocess
import sys
import time
from pathlib import Path

import pytest
from c_controllers import needs_gcc
from conftest import process_environment

PLANT = """
class Crane:
    states, inputs = ("x", "v", "sway", "rate"), ("force",)
    units = {"x": "m", "v": "m/s", "sway": "rad", "rate": "rad/s", "force": "N"}
    box = {"x": (-1.0, 1.0), "v": (-0.2, 0.2), "sway": (-0.1, 0.1), "rate": (-0.1, 0.1)}
    input_bounds = ((-60.0, 60.0),)
    parameters = {"trolley": 10.0, "load": 5.0, "rope": 2.0, "aim": 0.0}

    @staticmethod
    def f(x, u, t, p, M):
        s, c = M.sin(x.sway), M.cos(x.sway)
        push = u.force - 8.0 * x.v + p.load * s * (p.rope * x.rate**2 + 9.81 * c)
        v = push / (p.trolley + p.load * s * s)
        return [x.v, v, x.rate, -(v * c + 9.81 * s) / p.rope]

    @staticmethod
    def setpoint(x, t, p, M):
        return [x.x - p.aim]
"""
FIGURE = """
import npred

crane = npred.plant("crane.py:Crane", kappa="lqr")
rk4 = npred.predictor(crane, "rk4")
loop = {"D": 0.4, "X0": [-1, 0, 0, 0], "t_end": 30, "actuator": "history"}
bare = npred.simulate(crane, rk4, D_hat=0, **loop)
law = npred.DelayObserver(bounds=(0.1, 1.0))
predicted = npred.simulate(crane, rk4, D_hat=0.7, adaptation=law, **loop)
axes = bare.plot(label="without prediction", signals=("x", "sway", "U"), size="article")
predicted.plot(ax=axes, label="with prediction")
axes[0].figure.savefig("crane.pdf")
assert abs(bare.X[-1, 0]) > 0.1 > 10 * abs(predicted.X[-1, 0])
assert abs(predicted.D_hat[-1] - 0.4) < 0.01
"""
CONTROLLER = """
import npred

crane = npred.plant("crane.py:Crane", kappa="lqr")
rk4 = npred.predictor(crane, "rk4", nx=51)
controller = npred.controller(crane, rk4, "delay-observer", dt=0.01, D_hat=0.4, u0="equilibrium")
controller.set(aim=0.5)
assert controller.step([0, 0, 0, 0]) > 0
npred.export(controller, "controller", "c")
"""
PIPELINE = """
plant = "crane.py:Crane"
kappa = "lqr"

[evaluate]
X0 = [-1.0, 0.0, 0.0, 0.0]
D = 0.4
D_hat = 0.7
adaptation = "delay-observer"
actuator = "history"
"""
NPRED = f"{sys.executable} -m npred"
STEPS = {
    "check the plant": f"{NPRED} plants check crane.py:Crane --kappa lqr --delay 0.4",
    "two loops, and a figure": f"{sys.executable} figure.py",
    "check the pipeline": f"{NPRED} plants check crane.toml",
    "export its controller": f"{NPRED} export controller crane.toml --predictor heun -o heun",
    "export one from Python": f"{sys.executable} controller.py",
    "compile it": "gcc -O2 -DNPRED_TEST c/npred.c -lm -o test",
    "test it": "./test",
}
MISTAKES = {
    "plants check crane.py:Crain": "expected a class Crain",
    "plants check crane.py:Crane --delay 400ms": "--delay",
    "plants check crane.py:Crane --kappa lqp": "did you mean lqr?",
    "export controller crane.toml --predictor rk5 -o c": "did you mean rk4?",
    "evaluate crane.toml --set evaluate.D_hat0=1": "did you mean D_hat",
    "export c crane.toml": "npred export controller",
}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    files = {"crane.py": PLANT, "figure.py": FIGURE, "controller.py": CONTROLLER, "crane.toml": PIPELINE}
    for name, text in files.items():
        (tmp_path / name).write_text(text)
    return tmp_path


def run(folder: Path, command: str) -> subprocess.CompletedProcess[str]:
    environment = process_environment(MPLBACKEND="agg")
    return subprocess.run(command.split(), cwd=folder, env=environment, capture_output=True, text=True, timeout=300)


@needs_gcc
def test_from_an_own_plant_to_a_figure_and_a_controller(folder: Path):
    for name, command in STEPS.items():
        begin = time.monotonic()
        done = run(folder, command)
        print(f"{name}: {time.monotonic() - begin:.1f} s")
        assert done.returncode == 0, (name, done.stdout, done.stderr)
        if name == "check the plant":
            assert "D_hat = 0 all swing" in " ".join(done.stdout.split())
    assert (folder / "crane.pdf").stat().st_size > 5000
    assert (folder / "c" / "npred.h").read_text().count("npred_set_aim")


@pytest.mark.parametrize("command", MISTAKES)
def test_a_mistake_gets_one_right_line(folder: Path, command: str):
    done = run(folder, f"{NPRED} {command}")
    lines = done.stderr.strip().splitlines()
    assert done.returncode == 2 and MISTAKES[command] in lines[-1], done.stderr
