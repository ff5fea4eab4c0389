"""The C file: compiles without a warning as C99, and equals the model to 1e-5."""

import copy
import ctypes
import re
import subprocess

import numpy as np
import pytest
from c_controllers import find_nothing, needs_gcc
from conftest import HERE
from operator_samples import PLANT, SMALL, holding, operator, phased, samples, several_inputs

import npred
from npred.base.errors import NpredError
from npred.exports import NetworkAlone, c_files, c_network
from npred.kernels.c_text import comment
from npred.lab.training.neural import Neural
from npred.lab.training.operators import Scaling, build
from npred.loop import metrics

FLAGS = ["-std=c99", "-O2", "-Wall", "-Wextra", "-Wpedantic", "-Werror"]
CASES = [(config, anchor) for config in SMALL for anchor in ("none", "initial", "equilibrium")]
IDS = [f"{type(config).__name__}-{anchor}" for config, anchor in CASES]


def probe(count=4, nx=21, seed=0):
    data = samples(count, nx, seed)
    return data.X, data.u, data.D_hat, np.linspace(1.0, 9.0, count)


@pytest.fixture(scope="module", params=CASES, ids=IDS)
def once(request, tmp_path_factory):
    """A model and the text of its file."""
    config, anchor = request.param
    model, path = operator(config, anchor=anchor), tmp_path_factory.mktemp("c") / "model.c"
    c_network.export(NetworkAlone(model, PLANT, 21, probe()), path)
    return model, path.read_text()


@pytest.fixture
def exported(once, tmp_path):
    """The same for a test that changes them."""
    (tmp_path / "model.c").write_text(once[1])
    return copy.deepcopy(once[0]), tmp_path / "model.c"


def compiled(path, *flags):
    target = path.with_suffix(".out")
    find_nothing(path.parent, path.name, *FLAGS)
    done = subprocess.run(
        ["gcc", *FLAGS, *flags, str(path), "-o", str(target), "-lm"], capture_output=True, text=True, timeout=60
    )
    assert (done.returncode, done.stderr) == (0, "")
    return target


@needs_gcc
def test_its_own_test_passes(exported):
    done = subprocess.run([compiled(exported[1], "-DNPRED_TEST")], capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stdout
    assert "of each state's size" in done.stdout


@needs_gcc
def test_a_file_is_run_before_it_is_kept(tmp_path, monkeypatch):
    samples = probe(9)
    model = operator(SMALL[0]).double()
    network = NetworkAlone(model, PLANT, 21, samples)
    facts = c_network.export(network, tmp_path / "model.c").facts
    P = Neural(PLANT, model, 21)(*samples)
    exact = npred.predictor(PLANT, "rk4", 21)(*samples)
    eps = np.linalg.norm(P - exact, axis=-1).max()
    assert 0 < facts["error"] < 1e-4 and facts["eps"] == pytest.approx(eps, rel=1e-4)
    text = c_network.source
    for right, wrong, refusal in (
        ("u, &D_hat", "u, (double[]){D_hat + 0.1}", "P and U within 0.0001 of their sizes, got"),
        ("enum {", "#include <none.h>\nenum {", r"sources that compile, got: .*none\.h"),
    ):
        with monkeypatch.context() as patch:
            patch.setattr(c_network, "source", lambda *asked, a=right, b=wrong: text(*asked).replace(a, b, 1))
            with pytest.raises(NpredError, match=f"export c: expected {refusal}"):
                c_network.export(network, tmp_path / "wrong.c")
    assert not (tmp_path / "wrong.c").exists()
    monkeypatch.setattr(c_files, "compiler", lambda: None)
    assert "not compared" in c_network.export(network, tmp_path / "unseen.c").text
    assert (tmp_path / "unseen.c").read_text() == (tmp_path / "model.c").read_text()


@needs_gcc
def test_several_inputs(tmp_path):
    plant, data = several_inputs()
    model = build(SMALL[0], plant, Scaling.of(data))
    samples = data.X, data.u, data.D_hat, np.linspace(1.0, 9.0, len(data.X))
    c_network.export(NetworkAlone(model, plant, 11, samples), tmp_path / "two.c")
    assert subprocess.run([compiled(tmp_path / "two.c", "-DNPRED_TEST")], timeout=60).returncode == 0


@needs_gcc
def test_a_law_that_depends_on_time_is_tested_at_another_than_zero(tmp_path):
    plant, data = holding()
    samples = data.X, data.u, data.D_hat, np.linspace(1.0, 9.0, len(data.X))
    model = build(SMALL[0], plant, Scaling.of(data))
    c_network.export(NetworkAlone(model, plant, 11, samples), tmp_path / "model.c")
    assert subprocess.run([compiled(tmp_path / "model.c", "-DNPRED_TEST")], timeout=60).returncode == 0
    text = (tmp_path / "model.c").read_text()
    (tmp_path / "model.c").write_text(re.sub(r"(?<!double )\bsine\(", "0 * sine(", text))
    assert subprocess.run([compiled(tmp_path / "model.c", "-DNPRED_TEST")], timeout=60).returncode == 1


@needs_gcc
@pytest.mark.parametrize("anchor", ["initial", "equilibrium"])
@pytest.mark.parametrize("config", SMALL, ids=lambda config: type(config).__name__)
def test_several_delays_and_a_phase_of_the_time(tmp_path, config, anchor):
    plant, data, t = phased()
    model = build(config.model_copy(update={"anchor": anchor}), plant, Scaling.of(data))
    samples = data.X, data.u, data.D_hat, np.linspace(1.0, 9.0, len(data.X))
    c_network.export(NetworkAlone(model, plant, 13, samples), tmp_path / "model.c")
    assert subprocess.run([compiled(tmp_path / "model.c", "-DNPRED_TEST")], timeout=60).returncode == 0
    library = ctypes.CDLL(str(compiled(tmp_path / "model.c", "-shared", "-fPIC")))
    exact = Neural(plant, model.double(), 13)(data.X, data.u, data.D_hat, t)
    for k in range(5):
        P, U = np.empty((13, 3)), np.empty(2)
        D_hat, now = ctypes.c_double(data.D_hat[k]), ctypes.c_double(t[k])
        library.npred_predict(_address(data.X[k]), _address(data.u[k]), D_hat, now, _address(P))
        library.npred_control(_address(P), D_hat, now, _address(U))
        np.testing.assert_allclose(P, exact[k], rtol=2e-5, atol=2e-5)
        np.testing.assert_allclose(U, metrics.law(plant, P[None], now.value, D_hat.value)[0], rtol=1e-12)


@needs_gcc
def test_its_own_test_fails_for_another_model(exported):
    _, path = exported
    text = path.read_text()
    at = text.index("test_P[") + 20
    path.write_text(text[:at] + text[at:].replace("p+", "p+1", 1))
    assert subprocess.run([compiled(path, "-DNPRED_TEST")], capture_output=True, timeout=60).returncode == 1


@needs_gcc
def test_equals_the_model_on_other_samples(exported):
    model, path = exported
    library = ctypes.CDLL(str(compiled(path, "-shared", "-fPIC")))
    X, u, D_hat, _ = probe(6, seed=5)
    D_hat[-1] = 30.0  # far from the data
    wanted = Neural(PLANT, model.double(), 21)(X, u, D_hat)
    size = np.abs(wanted).max(axis=(0, 1))
    for k in range(6):
        P, U = np.empty((21, 2)), np.empty(1)
        library.npred_predict(_address(X[k]), _address(u[k]), ctypes.c_double(D_hat[k]), _address(P))
        library.npred_control(_address(P[-1]), ctypes.c_double(0.0), _address(U))
        assert (np.abs(P - wanted[k]).max(axis=0) < 1e-5 * size).all()
        np.testing.assert_allclose(U, PLANT.kappa(P[-1]), rtol=1e-12)


@needs_gcc
def test_the_example_of_the_documentation_is_the_model(tmp_path):
    model = operator(SMALL[0])
    c_network.export(NetworkAlone(model, PLANT, 21, probe()), tmp_path / "deeponet.c")
    page = (HERE.parent / "docs" / "deployment.md").read_text()
    example = re.findall(r"^```c\n(.*?)^```", page, re.MULTILINE | re.DOTALL)[0]
    (tmp_path / "main.c").write_text(example)
    done = subprocess.run([compiled(tmp_path / "main.c")], capture_output=True, text=True, timeout=60)
    P = Neural(PLANT, model.double(), 21)([0.03, 30.0], np.zeros((21, 1)), 1.0)
    assert float(done.stdout) == pytest.approx(PLANT.kappa(P[-1])[0], rel=1e-4)


def test_no_name_ends_a_comment():
    assert comment("a */ int owned; /* \n??/") == "a * / int owned; / * \\n? ?/"


def _address(array):
    assert array.flags.c_contiguous
    return array.ctypes.data_as(ctypes.c_void_p)


def test_the_text_is_the_same_again_and_calls_libm_alone(exported):
    model, path = exported
    text = path.read_text()
    assert c_network.source(model, PLANT, 21, probe()) == text
    assert [line for line in text.splitlines() if line.startswith("#include")] == [
        "#include <math.h>", "#include <stddef.h>", "#include <stdint.h>", "#include <stdio.h>",
    ]  # fmt: skip
    assert "malloc" not in text
