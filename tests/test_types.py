"""Types as a stranger's editor sees them: a script without a complaint, planted mistakes, and the documented plants."""

import json
import re
import subprocess
import sys
from pathlib import Path
from typing import Any, get_args

import pytest

from npred import exports
from npred.base.registry import DELAY_LAWS, FROZEN, METHODS
from npred.estimation import delay_law
from npred.prediction import methods

ROOT = Path(__file__).parents[1]
SCRIPT = '''
"""A first loop, as a stranger writes it."""

from typing import Any

import numpy as np

import npred
from npred import metrics


class Pendulum:
    """A pendulum that is held upright; the torque arrives late."""

    states, inputs = ("theta", "omega"), ("torque",)
    box = {"theta": (-0.5, 0.5), "omega": (-0.5, 0.5)}

    @staticmethod
    def f(x: Any, u: Any, t: Any, p: Any, M: Any) -> list[Any]:
        return [x.omega, 10 * M.sin(x.theta) + u.torque]

    @staticmethod
    def kappa(x: Any, t: Any, p: Any, M: Any) -> list[Any]:
        return [-10 * M.sin(x.theta) - 4 * x.theta - 4 * x.omega]


plant = npred.plant(Pendulum)
rk4 = npred.predictor(plant, "rk4", nx=51)
law = npred.DelayObserver(bounds=(0.05, 1))
run = npred.simulate(plant, rk4, D=0.3, D_hat=0.6, X0=[0.3, 0], t_end=10, adaptation="l1", actuator="history")
print(run.X[-1], run.U.max(), run.D_hat[-1], metrics.settle_time(run, plant.equilibrium))
run.plot(D=0.3, label="with prediction")
print(npred.delay_margin(plant, 0.3)[1], npred.plant("planar_arm2", kappa="lqr").n)
controller = npred.controller(plant, rk4, law, 0.01, D_hat=0.5, actuator="history")
U: np.ndarray = controller.step([0.3, 0.0])
print(U[0], controller.D_hat)
files = npred.export(controller, "fmu", "tank.fmu", precision="float", platforms=["win64"])
print([file.name for file in files])
try:
    npred.plant("pendulum")
except npred.errors.ConfigError as error:
    print(error)
'''
MISTAKES = """
import npred
plant = npred.plant("van_der_pol")
rk4 = npred.predictor(plant, "rk4")
c = npred.controller(plant, rk4, None, 0.01, D_hat=0.5, actuator="history")
run = npred.simulate(plant, rk4, D=0.3, D_hat=0.6, X0=[0.3, 0], t_end=10)
npred.simulat(plant, rk4)  # reportAttributeAccessIssue
run.plt()  # reportAttributeAccessIssue
print(npred.errors.ConfgError)  # reportAttributeAccessIssue
npred.simulate(plant, rk4, D=0.3, D_hat=0.6, X0=[0.3, 0], t_end=10, actuator="histroy")  # reportArgumentType
npred.controller(plant, rk4, None, 0.01, D_hat=0.5, actuator="histroy")  # reportArgumentType
npred.export(c, "cc", "out")  # reportArgumentType
npred.export(c, "controller", "out", precison="float")  # reportCallIssue
npred.simulate(rk4, plant, D=0.3, D_hat=0.6, X0=[0.3, 0], t_end=10)  # reportArgumentType
npred.simulate(plant, rk4, D=0.3, D_hat=0.6, X0=[0.3, 0], t_end=10, measuremnt=None)  # reportCallIssue
npred.DelayObserver(bounds=1.0)  # reportArgumentType
npred.simulate(plant, rk4, D=0.3, D_hat=0.6, X0=[0.3, 0], t_end=10, adaptation=0.5)  # reportArgumentType
npred.simulate(plant, rk4, D=0.3, D_hat=0.6, X0=[0.3, 0])  # reportCallIssue
npred.predictor("rk4", plant)  # reportArgumentType
"""
PLANT = re.compile(r"^```python\n((?:(?!^```).)*?^    def f\(.*?)^```$", re.DOTALL | re.MULTILINE)


@pytest.fixture(scope="module")
def complaints(tmp_path_factory: pytest.TempPathFactory) -> dict[str, dict[int, str]]:
    """pyright's complaints by file and line: strict of both scripts, by its own defaults of the documented plants."""
    pytest.importorskip("pyright", reason="pyright is not installed")
    folder = tmp_path_factory.mktemp("types")
    files = {"script.py": f"# pyright: strict\n{SCRIPT}", "mistakes.py": f"# pyright: strict\n{MISTAKES}"}
    files["template.py"] = (ROOT / "npred/cli/templates/plant.py.txt").read_text(encoding="utf-8")
    for page in (ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))):
        for k, block in enumerate(PLANT.findall(page.read_text(encoding="utf-8"))):
            files[f"{page.stem}_{k}.py"] = block
    files |= {page.name: page.read_text(encoding="utf-8") for page in (ROOT / "docs/gallery").glob("*.py")}
    for name, text in files.items():
        (folder / name).write_text(text, encoding="utf-8")
    settings = {"include": ["."], "extraPaths": [str(ROOT)], "pythonVersion": "3.11"}
    (folder / "pyrightconfig.json").write_text(json.dumps(settings))
    command = [sys.executable, "-m", "pyright", "--outputjson", "--pythonpath", sys.executable, "-p", str(folder)]
    done = subprocess.run(command, capture_output=True, text=True, cwd=folder)
    report: dict[str, Any] = json.loads(done.stdout)
    assert report["summary"]["filesAnalyzed"] == len(files), done.stdout
    lines: dict[str, dict[int, str]] = {name: {} for name in files}
    for each in report["generalDiagnostics"]:
        place = lines[Path(each["file"]).name]
        place[each["range"]["start"]["line"]] = place.get(each["range"]["start"]["line"], "") + f"{each['rule']} "
    return lines


def test_a_script_has_no_complaint_under_strict(complaints: dict[str, dict[int, str]]):
    assert complaints["script.py"] == {} and len(SCRIPT.splitlines()) >= 40


def test_each_planted_mistake_is_reported(complaints: dict[str, dict[int, str]]):
    lines = f"# pyright: strict\n{MISTAKES}".splitlines()
    planted = {k: line.partition("  # ")[2] for k, line in enumerate(lines) if "  # report" in line}
    assert len(planted) >= 10 and complaints["mistakes.py"].keys() == planted.keys()
    assert all(rule in complaints["mistakes.py"][k] for k, rule in planted.items())


def test_documented_plants_have_functions_without_self(complaints: dict[str, dict[int, str]]):
    others = {name: found for name, found in complaints.items() if name not in ("script.py", "mistakes.py")}
    assert {"README_0.py", "template.py", "own_plant_0.py", "10_limits.py"} <= others.keys()
    rules = re.compile("reportSelfClsParameterName|reportAttributeAccessIssue")  # x taken for self, without its states
    assert not [(name, k) for name, found in others.items() for k, each in found.items() if rules.search(each)]


def test_words_of_types_are_those_of_the_registries():
    assert get_args(methods.Method) == tuple(METHODS.builtin)
    assert get_args(delay_law.Adaptation) == (*DELAY_LAWS.builtin, FROZEN)
    assert get_args(exports.Form) == tuple(exports.FORMATS)
    options = {name for form in exports.FORMATS.values() for name in form.options}
    assert exports.FormatOptions.__annotations__.keys() == options
