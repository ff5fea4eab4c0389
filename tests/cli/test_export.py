"""`npred export`: a trained model of the store as a file, checked on its held-out samples."""

import json
import re
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import numpy as np
import pytest
from conftest import process_environment
from typer.testing import CliRunner

import npred
from npred.base.errors import ConfigError
from npred.cli import app
from npred.exports import c_files
from npred.lab import config

TEXT = """
plant = "activator_repressor"
name = "p"
[generate]
samples = 60
rollouts = 3
t_end = 2.0
dt = 0.01
nx = 11
[train]
models = ["deeponet"]
[train.deeponet]
epochs = 2
width = 8
snapshots = [1]
"""


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    """A folder with a pipeline file and a store that holds its network."""
    folder = tmp_path_factory.mktemp("export")
    (folder / "p.toml").write_text(TEXT)
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        done = CliRunner().invoke(app, ["train", "p.toml", "--store", "store", "-q", "--jobs", "1"])
        assert done.exit_code == 0, done.output
    return folder


@pytest.fixture
def export(trained, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    store = ["--store", str(trained / "store")]
    return lambda form, *more, model=f"{trained / 'p.toml'}:deeponet": CliRunner().invoke(
        app, ["export", form, model, *store, *more]
    )


def test_a_controller_of_a_pipeline_that_names_networks_says_which(tmp_path):
    """One that names none, as that of a recording, is exported with its predictor."""
    text = 'plant = "scalar"\n[evaluate]\nX0 = [1.0]\nactuator = "history"\nadaptation = "frozen"\n'
    (tmp_path / "p.toml").write_text(text)
    (tmp_path / "n.toml").write_text(text + "[train.deeponet]\n")
    done, refused = (CliRunner().invoke(app, ["export", "controller", f"{tmp_path / name}.toml", "-o", str(tmp_path)])
                     for name in "pn")  # fmt: skip
    assert done.exit_code == 0 and "<RK4 'rk4' of plant scalar" in done.stdout
    assert refused.exit_code == 2 and "got no model; add one, or give --predictor rk4" in refused.stderr


@pytest.mark.parametrize("form", ["onnx", "c"])
def test_writes_a_file(export, form):
    if form == "onnx":
        pytest.importorskip("onnxruntime")
    done = export(form, "--json", "--nx", "21")
    assert done.exit_code == 0, done.output
    document = json.loads(done.stdout)
    assert document["files"] == [f"deeponet-21.{form}"] and Path(f"deeponet-21.{form}").stat().st_size > 1000
    if form == "onnx" or shutil.which("gcc"):
        assert document["error"] < 1e-4 < document["eps"]
        said = export(form, "--nx", "21").stdout
        assert f"on {document['samples']} held-out samples within" in said and "ε" not in said  # evaluate's is of all


def test_a_process_that_exports_ends_without_words(trained, tmp_path):
    """Also not those of triton's binding, which come after Python's last line."""
    pytest.importorskip("onnxruntime")
    line = ["export", "onnx", f"{trained / 'p.toml'}:deeponet", "--store", str(trained / "store"), "-q", "--nx", "5"]
    command = [sys.executable, "-m", "npred", *line]
    done = subprocess.run(command, cwd=tmp_path, env=process_environment(), capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")


def test_a_snapshot_to_a_named_file(export, trained):
    assert export("c", "-o", "last.c").exit_code == 0
    done = export("c", "-o", "first.c", model=f"{trained / 'p.toml'}:deeponet@1")
    assert done.stdout.startswith("first.c: P and U of deeponet on 101 nodes")
    assert Path("first.c").read_text() != Path("last.c").read_text()


def test_a_graph_that_differs_is_refused(export):
    pytest.importorskip("onnxruntime")
    done = export("onnx", "--atol", "0")
    assert done.exit_code == 1 and "expected P and U within 0 of the model" in done.stderr
    assert not list(Path().iterdir())


def test_a_pipeline_without_a_model_leads_to_the_controller(export, trained):
    file = trained / "p.toml"
    done = export("c", model=str(file))
    assert done.exit_code == 2 and done.stderr.strip().endswith(
        f"write {file}:deeponet; without a network, npred export controller {file} --predictor heun"
    )


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["c", "--nx", "1"], "--nx: expected at least 2 nodes"),
        (["c", "-o", "nowhere/m.c"], "nowhere/m.c: expected a file that can be written"),
    ],
)
def test_mistakes_are_told_in_one_line(export, arguments, message):
    done = export(*arguments)
    assert (done.exit_code, done.stdout) == (2, "")
    (line,) = done.stderr.splitlines()
    assert message in line


@pytest.mark.parametrize(
    ("arguments", "message"),
    [(["onyx"], "Error: No such command 'onyx'."), (["c", "--fmi", "2"], "Error: No such option: --fmi")],
)
def test_a_format_or_an_option_that_there_is_not_is_refused(export, arguments, message):
    done = export(*arguments)
    assert (done.exit_code, done.stdout) == (2, "")
    assert message in done.stderr


def test_a_controller_to_a_folder(export):
    done = export("controller", "-o", "firmware", "--json", "--guard", "0.1", "--name", "tank")
    assert done.exit_code == 0, done.output
    document = json.loads(done.stdout)
    assert document["files"] == ["firmware/tank.h", "firmware/tank.c"] and document["guarded"]
    assert document["digest"] in Path("firmware/tank.h").read_text()
    assert "int tank_step(tank_controller *self, const double *X, const double *u, double *U);" in (
        Path("firmware/tank.h").read_text()
    )
    assert run("firmware/tank.c", "-DTANK_TEST").returncode == 0


def run(*arguments):
    """What a compiled program prints."""
    if not shutil.which("gcc"):
        pytest.skip("no gcc on this machine")
    subprocess.run(["gcc", "-std=c99", "-O2", *arguments, "-o", "program", "-lm"], check=True, timeout=60)
    return subprocess.run(["./program"], capture_output=True, text=True, timeout=60)


def test_a_controller_with_a_numerical_predictor(export, trained):
    flags = ("--predictor", "heun", "--precision", "float", "--actuator", "history", "--nx", "21")
    done = export("controller", *flags, model=str(trained / "p.toml"))
    assert done.exit_code == 0, done.output
    assert (
        "warning: the paper's law (12) is made for a measured u; with u from the commands 16 of 30 loops" in done.stderr
    )
    assert "float precision" in done.stdout and "int npred_step(npred_controller *self, const float *X, float *U);" in (
        Path("npred/npred.h").read_text()
    )


def test_a_controller_with_a_watchdog_that_takes_older_samples(export, trained):
    flags = (
        "--predictor",
        "heun",
        "--actuator",
        "history",
        "--nx",
        "21",
        "--watchdog",
        "0.5:zero",
        "--max-sample-age",
        "1.5",
    )
    done = export("controller", *flags, model=str(trained / "p.toml"))
    assert done.exit_code == 0, done.output
    text = Path("npred/npred.c").read_text()
    settings = dict(re.findall(r"^    \.(\w+) = (.*),$", text, re.MULTILINE))
    assert [settings[name] for name in ("watched", "after", "holds", "oldest")] == ["1", "0.5", "0", "300.0"]
    assert run("npred/npred.c", "-DNPRED_TEST").returncode == 0


def test_a_controller_with_the_observer_of_its_pipeline(export, tmp_path):
    """Of the two states only the second is measured; the program in the file repeats steps in Python."""
    lines = ['plant = "chemostat"', "[evaluate]", "X0 = [2.0, 2.0]", "D = 0.5", "D_hat = 0.5", 'adaptation = "frozen"']
    lines += ['actuator = "history"', 'observer = { kind = "ekf", outputs = ["S"], offset = true }']
    (tmp_path / "seen.toml").write_text("\n".join(lines))
    done = export("controller", "--predictor", "rk4", "--nx", "21", model=str(tmp_path / "seen.toml"))
    assert done.exit_code == 0, done.output
    header = Path("npred/npred.h").read_text()
    assert "NPRED_N_OUTPUTS = 1" in header and " * X, a sample: S.\n" in header
    assert f"#define NPRED_DT {config.load(tmp_path / 'seen.toml').evaluate.dt!r}\n" in header
    assert run("npred/npred.c", "-DNPRED_TEST").returncode == 0


@pytest.mark.parametrize(
    ("flags", "message"),
    [
        (("--watchdog", "soon"), "--watchdog: expected TIME[:hold|zero], got 'soon'; as 0.2:zero"),
        (("--watchdog", "1:stop"), "then: expected numbers, a law or one of hold, zero, got 'stop'"),
        (("--max-sample-age", "-1"), "max-sample-age: expected how old a sample may be, at least 0"),
    ],
)
def test_a_watchdog_or_age_that_is_none_is_refused_in_one_line(export, trained, flags, message):
    done = export("controller", "--predictor", "heun", "--actuator", "history", *flags, model=str(trained / "p.toml"))
    (line,) = done.stderr.splitlines()[-1:]
    assert done.exit_code == 2 and message in line


@pytest.mark.parametrize("version", [3, 2])
def test_an_fmu_to_a_file(export, trained, version):
    flags = ("--predictor", "heun", "--actuator", "history", "--nx", "21", "--fmi", str(version), "--name", "tank")
    done = export("fmu", *flags, "--json", model=str(trained / "p.toml"))
    assert done.exit_code == 0, done.output
    document = json.loads(done.stdout)
    assert (document["files"], document["fmi"], document["predictor"]) == (["tank.fmu"], version, "heun")
    assert {"x1", "x2", "U", "D_hat", "D_hat0", "gamma"} < set(document["variables"])
    with zipfile.ZipFile("tank.fmu") as opened:
        assert document["token"] in opened.read("modelDescription.xml").decode()
        assert (document["libraries"] == []) == (c_files.compiler() is None)
        opened.extractall("fmu")
    if shutil.which("gcc"):
        command = ["gcc", "-std=c99", "-DTANK_TEST", "fmu/sources/tank.c", "-o", "own_test", "-lm"]
        subprocess.run(command, check=True, timeout=60)
        assert subprocess.run(["./own_test"], timeout=60).returncode == 0


def test_an_fmu_of_a_network_says_what_it_holds(export, monkeypatch):
    monkeypatch.setattr(c_files, "compiler", lambda: None)
    done = export("fmu", "-o", "net.fmu", "--nx", "21")
    assert done.exit_code == 0 and "as FMI 3.0, sources only, because there is no C compiler here" in done.stdout


@pytest.mark.parametrize(
    ("flags", "message"),
    [
        (("--fmi", "1"), "--fmi: expected 3 or 2, got 1; give one"),
        (("-o", "nowhere/a.fmu"), "nowhere/a.fmu: expected a file that can be written"),
    ],
)
def test_an_fmu_that_cannot_be(export, flags, message):
    done = export("fmu", *flags)
    assert done.exit_code == 2 and message in done.output


@pytest.mark.parametrize(
    ("flags", "message"),
    [
        (("--name", "a b"), "--name: expected a short C identifier in lower case, got 'a b'; take npred"),
        (("--precision", "half"), "--precision: expected one of float, double, got 'half'; name one of them"),
        (("--nx", "1"), "--nx: expected at least 2 nodes"),
    ],
)
def test_a_controller_that_cannot_be(export, flags, message):
    done = export("controller", *flags)
    assert done.exit_code == 2 and message in done.output


@pytest.fixture
def from_python(trained, tmp_path, monkeypatch):
    """A controller with the trained network, in an empty folder."""
    monkeypatch.chdir(tmp_path)
    network = npred.load(f"{trained / 'p.toml'}:deeponet", store=trained / "store", nx=21)
    return npred.controller(network.plant, network, None, 0.01, D_hat=0.5, actuator="measured")


def test_python_exports_a_controller_as_c_with_its_test(from_python):
    files = npred.export(from_python, "controller", "firmware", name="tank")
    assert files == [Path("firmware/tank.h"), Path("firmware/tank.c")]
    assert run("firmware/tank.c", "-DTANK_TEST").returncode == 0
    folder = npred.export(from_python, "controller", "folder", precision="float")
    assert [file.name for file in folder] == ["npred.h", "npred.c"]
    assert "const float *X" in Path("folder/npred.h").read_text()


def test_python_exports_an_fmu(from_python):
    assert npred.export(from_python, "fmu", "out/tank.fmu", name="tank") == [Path("out/tank.fmu")]
    with zipfile.ZipFile("out/tank.fmu") as archive:
        assert b'modelIdentifier="tank"' in archive.read("modelDescription.xml")


def test_python_exports_the_network_of_a_controller_as_c(from_python):
    assert npred.export(from_python, "c", "net.c") == [Path("net.c")]
    assert run("net.c", "-DNPRED_TEST").returncode == 0


def test_python_exports_the_network_of_a_controller_as_onnx(from_python):
    onnxruntime = pytest.importorskip("onnxruntime")
    guarded = npred.guarded(from_python.predictor, 0.1)
    npred.export(
        npred.controller(guarded.plant, guarded, None, 0.01, D_hat=0.5, actuator="measured"), "onnx", "net.onnx"
    )
    session = onnxruntime.InferenceSession("net.onnx")
    X, u, D_hat = np.float32([[0.03, 30.0]]), np.zeros((1, 21, 1), np.float32), np.float32([0.5])
    P = session.run(["P"], dict(zip([entry.name for entry in session.get_inputs()], (X, u, D_hat), strict=True)))[0]
    np.testing.assert_allclose(P, from_python.predictor(X, u, D_hat), atol=1e-4)
    assert from_python.predictor.operator["X_rest"].dtype == float  # the caller's network stays as it is


@pytest.mark.parametrize(
    ("arguments", "options", "message"),
    [
        (("exe", "x"), {}, "form: expected one of controller, fmu, c, onnx, got 'exe'"),
        (("controller", "tank.c"), {}, "path: expected a folder, got 'tank.c'; give the name of its files as name"),
        (("controller", "x"), {"name": "Tank"}, "name: expected a short C identifier in lower case, got 'Tank'"),
        (("controller", "x"), {"platforms": ["linux64"]}, r"platforms: expected an option of controller \(prec"),
        (("fmu", "x.fmu"), {"platform": "win64"}, r"\(precision, name, fmi, platforms\), .*; did you mean platforms"),
        (("fmu", "x.fmu"), {"fmi": "3"}, "fmi: expected a value as 3, got '3'"),
        (("c", "x.c"), {"name": "x"}, r"name: expected an option of c \(it has none\), got name = 'x'; drop it"),
        (("onnx", "x.onnx"), {}, "export onnx: expected a controller with a trained network, got <RK4"),
    ],
)
def test_python_says_what_cannot_be_exported(arguments, options, message, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    plant = npred.plant("scalar")
    controller = npred.controller(plant, npred.predictor(plant, "rk4"), None, 0.01, D_hat=0.5, actuator="measured")
    with pytest.raises(ConfigError, match=message):
        npred.export(controller, *arguments, **options)
    with pytest.raises(ConfigError, match="export: expected a controller, got <Plant scalar"):
        npred.export(plant, "controller", "tank")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("path", ["file", "file/tank", "file/tank.fmu"])
def test_python_says_where_nothing_can_be_written(path, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "file").touch()
    plant = npred.plant("scalar")
    controller = npred.controller(plant, npred.predictor(plant, "rk4"), None, 0.01, D_hat=0.5, actuator="measured")
    with pytest.raises(ConfigError, match=f"path: expected a place to write, got '{path}': "):
        npred.export(controller, "fmu" if path.endswith(".fmu") else "controller", path)


def test_a_key_is_overridden_for_an_export(export, trained):
    flags = ("--predictor", "heun", "--nx", "21", "--set", "evaluate.dt=0.02", "--set", "evaluate.D_hat=0.75")
    assert export("controller", *flags, model=str(trained / "p.toml")).exit_code == 0
    text = Path("npred/npred.c").read_text()
    assert re.findall(r"\.dt = (.*),", text) == ["0.02"] and "0.75" in text
    other = export("c", "--set", "train.deeponet.width=9")
    assert other.exit_code == 2 and "got none (train.deeponet.width: 8 -> 9" in other.stderr
