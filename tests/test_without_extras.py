"""A small installation, without torch and the packages of other extras: what works, and what says what it needs."""

import json
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import HERE, process_environment
from jobs import tables
from typer.testing import CliRunner

import npred
from npred.cli import app
from npred.lab.config import dumps
from npred.lab.training import operators

Child = Callable[..., subprocess.CompletedProcess[str]]
TRAIN = "pip install 'npred[train]'"
LOAD = "npred.load('p.toml:fno', store='store'"
MODELS = ["deeponet", "fno"]
ERRORS = ("mse", "eps_sup", "eps_kappa", "rel_l2")
CERTIFY = {"probability": 0.3, "confidence": 0.8, "samples": 4, "restarts": 8, "steps": 4, "loops": 3}


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a pipeline file and a store that holds its networks."""
    folder = tmp_path_factory.mktemp("small")
    bench = {"dx": [0.1], "calls": 10, "batches": [1]}
    path = folder / "p.toml"
    path.write_text(dumps({"name": "p"} | tables(bench=bench)))
    done = CliRunner().invoke(app, ["train", str(path), "--store", str(folder / "store"), "-q", "--jobs", "1"])
    assert done.exit_code == 0, done.output
    return folder


def run(*words: str, folder: Path) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, *words]
    return subprocess.run(command, cwd=folder, env=process_environment(), capture_output=True, text=True, timeout=300)


@pytest.fixture
def command(trained: Path) -> Child:
    """`npred` without the packages, beside the pipeline file."""
    program = str(HERE / "without_extras.py")
    return lambda *words: run(program, *words, *(["--store", "store"] if words[-1] != "--help" else []), folder=trained)


@pytest.fixture
def script(trained: Path) -> Callable[[str], list[str]]:
    """The lines that a program prints without the packages."""

    def call(text: str) -> list[str]:
        done = run("-c", f"import without_extras, sys, numpy as np, npred\n{text}", folder=trained)
        assert done.returncode == 0, done.stderr
        return done.stdout.splitlines()

    return call


SEVERAL = """
import contextlib, io, json, without_extras
from typer.testing import CliRunner
from npred.cli import app
answers = []
for words in {commands!r}:
    done = CliRunner().invoke(app, words)
    answers.append([done.exit_code, done.stdout, done.stderr])
for text in {programs!r}:
    with contextlib.redirect_stdout(io.StringIO()) as printed:
        exec(text, {{}})
    answers.append(printed.getvalue().splitlines())
print(json.dumps(answers))
"""


@pytest.fixture(scope="module")
def answers(trained: Path) -> dict[Any, Any]:
    """What the commands in NO_NETWORK, NEED and EXPORTS answer without the packages, and the programs of REFUSED: one
    process for all, for each imports NumPy and more.
    """
    asked = [words for words, _ in NEED] + NO_NETWORK + [export(*each) for each in EXPORTS]
    asked = [[*words, *(["--store", "store"] if words[-1] != "--help" else [])] for words in asked]
    programs = [f"import npred, npred.base.registry\n{refused(text)}" for text, _ in REFUSED]
    done = run("-c", SEVERAL.format(commands=asked, programs=programs), folder=trained)
    assert done.returncode == 0, done.stderr
    keys = [*(" ".join(words).removesuffix(" --store store") for words in asked), *(text for text, _ in REFUSED)]
    return dict(zip(keys, json.loads(done.stdout.splitlines()[-1]), strict=True))


def export(form: str, model: str) -> list[str]:
    return ["export", form, f"p.toml:{model}", "-o", f"{form}-{model}"]


def refused(text: str) -> str:
    """A program that prints what it is refused with."""
    return f"try:\n    {text}\nexcept npred.errors.MissingError as error:\n    print(error.exit_code, error)\n"


def test_the_child_has_no_torch(script):
    assert script("try:\n    import torch\nexcept ModuleNotFoundError:\n    print('none')") == ["none"]


LOOP = """
plant = npred.plant("activator_repressor")
law = npred.DelayAdaptation(gamma=1000.0, b=1.0, bounds=(0.1, 4.0))
def ends(predictor):
    loop = npred.simulate(plant, predictor, D=1.0, D_hat=2.0, X0=[0.03, 30.0], t_end=2.0, dt=0.01, adaptation=law)
    return loop.X[-1].tolist()
"""


def test_a_loop_a_controller_and_a_figure(script):
    program = (
        f"{LOOP}rk4 = npred.predictor(plant, 'rk4')\nprint(ends(rk4))\n"
        "c = npred.controller(plant, rk4, law, 0.01, D_hat=2.0)\nprint(c.step([0.03, 30.0]))\n"
        "loop = npred.simulate(plant, rk4, D=1.0, D_hat=2.0, X0=[0.03, 30.0], t_end=1.0, dt=0.01, adaptation=None)\n"
        "loop.plot(D=1.0)[0].figure.savefig('loop.png')\n"
    )
    ended, U = script(program)
    space: dict = {"npred": npred}
    exec(LOOP, space)
    assert ended == str(space["ends"](npred.predictor(space["plant"], "rk4"))) and U.startswith("[")


@pytest.mark.parametrize("runtime", [None, "fused"])
@pytest.mark.parametrize("model", MODELS)
def test_a_trained_network_is_that_of_an_installation_with_torch(script, trained, model, runtime):
    lines = script(
        f"{LOOP}model = npred.load('p.toml:{model}', store='store', nx=21, runtime={runtime!r})\n"
        "print(ends(model))\nu = np.linspace(0.0, 0.1, 21)[:, None]\n"
        "print(*model([0.03, 30.0], u, [0.5, 1.0]).ravel().tolist())\n"
        "print('torch' in sys.modules)\nprint(npred.guarded(model).error([0.03, 30.0], u, 1.0))"
    )
    space: dict = {"npred": npred}
    exec(LOOP, space)
    loaded = npred.load(f"{trained}/p.toml:{model}", store=trained / "store", nx=21, runtime=runtime)
    assert lines[0] == str(space["ends"](loaded)) and lines[2] == "False"
    P = loaded([0.03, 30.0], np.linspace(0.0, 0.1, 21)[:, None], [0.5, 1.0])
    np.testing.assert_allclose(np.array(lines[1].split(), dtype=float), P.ravel(), rtol=1e-12, atol=1e-14)


def test_a_network_without_a_fused_form_needs_torch(script, tmp_path):
    from operator_samples import EVERY, operator

    operators.save(tmp_path, operator(EVERY[3]), EVERY[3])
    table = f"npred.lab.config.Network(network={EVERY[3].architecture!r})"
    plant = "npred.plant('activator_repressor')"
    read = f"npred.networks.weights.read(pathlib.Path({str(tmp_path)!r}), {plant}, table={table})"
    (line,) = script(f"import npred.lab.config, npred.networks.weights, pathlib\n{refused(read)}")
    assert line == f"5 network {EVERY[3].architecture}: expected the package torch, found none; {TRAIN}"


REFUSED = [
        (f"{LOAD}, runtime='torch')", f"runtime torch: expected the package torch, {TRAIN}"),
        (f"{LOAD}, runtime='onnx')", "runtime onnx: expected the package torch, npred[onnx]"),
        (f"{LOAD}, device='cuda')", f"device: expected the package torch, {TRAIN}"),
        ("npred.base.registry.NETWORKS.load('network', 'fno')", f"network fno: expected the package torch, {TRAIN}"),
        ("npred.simulate(npred.plant('scalar'), None, D=1.0, D_hat=1.0, X0=[1.0], t_end=0.1, dt=0.01, adaptation=None)"
         ".to_dataframe()", "to_dataframe: expected the package pandas, pip install pandas"),
]  # fmt: skip


@pytest.mark.parametrize(("text", "words"), REFUSED)
def test_in_python_what_needs_a_package_says_so(answers, text, words):
    (line,) = answers[text]
    expected, cure = words.split(", ")
    assert line.startswith(f"5 {expected}, found none; ") and cure in line


NO_NETWORK = [
     ["--help"], ["plants"], ["ls"], ["doctor"], ["status", "p.toml"], ["show", "train"], ["train", "p.toml"],
     ["why", "train", "p.toml"], ["train", "p.toml", "--dry-run", "--set", "seed=1"],
]  # fmt: skip


@pytest.mark.parametrize("words", NO_NETWORK, ids=" ".join)
def test_commands_that_need_no_network(answers, words):
    code, _, said = answers[" ".join(words)]
    assert code == 0 and "error" not in said, said


def test_to_train_takes_the_extra_and_is_refused_before_anything_runs(command, trained):
    before = sorted((trained / "store").glob("*/*"))
    for verb in ("train", "run", "evaluate"):
        done = command(verb, "p.toml", "--set", "seed=1")
        assert (done.returncode, done.stdout) == (5, "")
        line = done.stderr.splitlines()[-1]
        assert line == f"error: train deeponet: expected the package torch, found none; {TRAIN}"
    swept = command("sweep", "p.toml", "--set", "seed=1,2")
    assert swept.returncode == 5 and TRAIN in swept.stderr.splitlines()[-1]
    after = sorted((trained / "store").glob("*/*"))
    assert [path for path in after if path.parent.name == "generate"] == [
        path for path in before if path.parent.name == "generate"
    ]


NEED = [
    (
        ["export", "onnx", "p.toml:fno"],
        "export onnx: expected the package torch, found none; pip install 'npred[onnx]'",
    ),
    (["evaluate", "p.toml", "--device", "cuda"], f"--device: expected the package torch, found none; {TRAIN}"),
]
EXPORTS = [(form, model) for form in ("controller", "fmu", "c") for model in MODELS]


@pytest.mark.parametrize(("words", "line"), NEED)
def test_commands_that_need_a_package_say_so(answers, words, line):
    code, _, said = answers[" ".join(words)]
    assert (code, said.splitlines()[-1]) == (5, f"error: {line}")
    assert "Traceback" not in said


@pytest.mark.parametrize(("form", "model"), EXPORTS)
def test_exports(answers, trained, form, model):
    code, _, said = answers[" ".join(export(form, model))]
    assert code == 0, said
    assert (trained / f"{form}-{model}").exists()


def test_evaluation_timings_and_page(command, trained):
    """The errors of an evaluation are those with torch, up to rounding."""
    shutil.copytree(trained / "store", trained / "with_torch", symlinks=True)
    done = command("evaluate", "p.toml", "--json")
    assert done.returncode == 0, done.stderr
    by_torch = CliRunner().invoke(app, ["evaluate", f"{trained}/p.toml", "--store", f"{trained}/with_torch", "--json"])
    for contender, scores in json.loads(by_torch.stdout)["result"]["models"].items():
        small = json.loads(done.stdout)["result"]["models"][contender]
        assert [small[key] for key in ERRORS] == pytest.approx([scores[key] for key in ERRORS], rel=1e-9)
    timed = command("bench", "p.toml")
    assert timed.returncode == 0, timed.stderr
    assert "bench: no rows of the runtime torch without torch" in timed.stderr
    assert command("report", "p.toml").returncode == 0


@pytest.mark.slow
def test_a_certificate_of_a_plant_whose_search_takes_no_gradient(tmp_path):
    start = {"adaptation": "frozen", "X0": [0.5, 0.5, 0.5], "D": 0.6, "D_hat": 0.6, "case_D_hat": [0.6]}
    data = {"adaptation": "frozen", "D": 0.6, "D_hat": [[0.55, 0.65]]}
    changes = {"plant": "unicycle", "generate": data, "evaluate": start, "certify": CERTIFY}
    (tmp_path / "p.toml").write_text(dumps({"name": "p"} | tables(**changes)))
    made = ["--store", str(tmp_path / "store"), "-q", "--jobs", "1"]
    done = CliRunner().invoke(app, ["train", str(tmp_path / "p.toml"), *made])
    assert done.exit_code == 0, done.output
    small = run(str(HERE / "without_extras.py"), "certify", "p.toml", "--store", "store", folder=tmp_path)
    assert small.returncode == 0, small.stderr
