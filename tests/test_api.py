"""The public names, as a script uses them; and no tensor of a GPU becomes an array before it is fetched."""

import ast
import pydoc
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import npred
from npred.base.errors import ConfigError, MissingError
from npred.prediction.methods import RK4


def test_public_names_are_the_documented_ones():
    names = {"DelayAdaptation", "DelayLaw", "DelayObserver", "L1Adaptation", "Loop", "Measurement", "Predictor"}
    names |= {"SafetyFilter", "Timing", "Watchdog", "compare", "delay_margin", "export"}
    names |= {"as_iosystem", "controller", "guarded", "load", "plant", "policy", "predictor", "simulate"}
    names |= {"evaluate", "generate", "identify", "train"}
    assert set(npred.__all__) == names
    for name in npred.__all__:
        assert callable(getattr(npred, name))
    with pytest.raises(AttributeError, match="has no attribute 'nothing'"):
        _ = npred.nothing


def test_importing_npred_brings_nothing_heavy():
    program = "import sys, npred; print([m for m in ('torch', 'h5py', 'numpy') if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True, timeout=60)
    assert done.stdout.strip() == "[]"


def test_a_loop_from_the_public_names():
    plant = npred.plant("activator_repressor")
    predictor = npred.predictor(plant, "rk4", nx=101)
    P = predictor([0.03, 30.0], np.zeros((101, 1)), 1.0)
    np.testing.assert_array_equal(P[0], [0.03, 30.0])
    adaptation = npred.DelayAdaptation(gamma=1000.0, b=1.0, bounds=(0.1, 4.0))
    loop = npred.simulate(plant, predictor, D=1.0, D_hat=2.0, X0=[0.03, 30.0], t_end=1.0, dt=0.005,
                          adaptation=adaptation, input_bounds=None, u0=0.0)  # fmt: skip
    assert (loop.t.shape, loop.X.shape, loop.U.shape, loop.D_hat.shape) == ((201,), (201, 2), (201, 1), (201,))
    np.testing.assert_allclose(loop.X[-1], P[-1], rtol=1e-6)  # U = 0 until t = D: the predictor at D_hat = D


def test_parameters_by_keyword():
    assert npred.plant("scalar", a=0.3).parameters["a"] == 0.3


def test_unknown_predictor_is_told():
    expected = r"euler, heun, rk4, .*picard, rollout, or a class .*, got 'rk5'; did you mean rk4"
    with pytest.raises(ConfigError, match=expected):
        npred.predictor(npred.plant("scalar"), "rk5")


def test_what_is_no_plant_is_told():
    with pytest.raises(ConfigError, match=r"expected a Plant, got 'scalar'; make one with npred.plant"):
        npred.predictor("scalar", "rk4")  # type: ignore[arg-type]
    with pytest.raises(ConfigError, match=r"expected a name, my_plant\.py:Tank or a class, got 3"):
        npred.plant(3)  # type: ignore[arg-type]


def test_a_device_that_is_not_there_is_told_before_a_model_is_looked_for():
    with pytest.raises(MissingError, match="got 'cuda:99'"):
        npred.load("nowhere.toml:fno", device="cuda:99")
    with pytest.raises(ConfigError, match="expected auto, cpu, cuda or cuda:N, got 'gpu'"):
        npred.load("nowhere.toml:fno", device="gpu")


@pytest.mark.slow
def test_a_trained_model_by_pipeline_artifact_and_snapshot(tmp_path, monkeypatch):
    from npred.cli import main

    path = tmp_path / "p.toml"
    path.write_text(
        'name = "p"\nplant = "activator_repressor"\n'
        "[generate]\nsamples = 60\nrollouts = 3\nt_end = 2.0\ndt = 0.01\nnx = 11\n[train]\n"
        'models = ["deeponet"]\n[train.deeponet]\nepochs = 2\nsnapshots = [1]\nwidth = 8\n'
    )
    store = tmp_path / "store"
    monkeypatch.setattr(sys, "argv", ["npred", "train", str(path), "--store", str(store), "-q"])
    with pytest.raises(SystemExit) as ended:
        main()
    assert ended.value.code == 0
    model, early = (npred.load(f"{path}:deeponet{at}", store=store) for at in ("", "@1"))
    (artifact,) = (p for p in (store / "train").iterdir() if p.is_dir())
    X, u = [0.03, 30.0], np.zeros((21, 1))
    np.testing.assert_array_equal(model(X, u, 1.0), npred.load(str(artifact), store=store)(X, u, 1.0))
    assert not np.array_equal(model(X, u, 1.0), early(X, u, 1.0))
    assert model.plant.name == "activator_repressor" and model.operator is not None
    by_torch = npred.load(f"{path}:deeponet", store=store, runtime="torch")
    np.testing.assert_array_equal(model(X, u, 1.0), by_torch(X, u, 1.0))
    assert model.compiled and not by_torch.compiled  # in a loop
    with pytest.raises(ConfigError, match="expected a trained model"):
        npred.load(f"{path}:fno", store=store)


def test_dir_and_help_list_the_public_names_and_stay_light():
    program = "import sys, npred; print(*dir(npred)); print([m for m in ('torch', 'numpy') if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True, timeout=60)
    names, heavy = done.stdout.splitlines()
    modules = {"errors", "laws", "lyapunov", "metrics", "observers", "plants"}
    assert set(names.split()) == {*npred.__all__, *modules, "__doc__", "__version__"}
    assert heavy == "[]"
    text = pydoc.plain(pydoc.render_doc(npred))
    assert all(f"    {name}(" in text or f"    class {name}(" in text for name in npred.__all__)


def test_documented_modules_are_there_before_they_are_imported():
    program = "import npred; print(npred.errors.ConfigError.exit_code, npred.plants.resolve('scalar').name)"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True, timeout=60)
    assert done.stdout.split() == ["2", "scalar"]


def test_type_checkers_are_told_that_the_package_has_types():
    assert (Path(npred.__file__).parent / "py.typed").is_file()


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: npred.delay_margin("scalar", 1.0), "plant: expected a Plant, got 'scalar'; make one with npred.plant"),  # type: ignore[arg-type]
        (lambda: npred.identify("scalar", [0], [0], [0]), "plant: expected a Plant, got 'scalar'; make one"),  # type: ignore[arg-type]
        (lambda: npred.observers.EKF("scalar"), "plant: expected a Plant, got 'scalar'; make one"),  # type: ignore[arg-type]
        (lambda: npred.observers.EKF(npred.plant("scalar"), outputs="X"), 'got \'X\'; write ("X",)'),
        (lambda: npred.plant("scalar").safe([1.0]), "plant scalar: expected safe(x, t, p, M), found none; declare it"),
        (lambda: npred.plant("scalar").delay([1.0]), "plant scalar: expected delay(x, t, p, M), found none; declare"),
        (lambda: npred.evaluate(3), "source: expected a pipeline or a plant, by name, file or as an object, got 3"),  # type: ignore[arg-type]
        (lambda: npred.load("smoke"), "smoke: expected PIPELINE:MODEL, got no model; write smoke:deeponet, say"),
        (lambda: npred.guarded(RK4(npred.plant("scalar")), exact="rk4"), "exact: expected a Predictor, got 'rk4'"),  # type: ignore[arg-type]
    ],
)  # fmt: skip
def test_a_mistake_is_one_line_with_a_cure(call, message):
    with pytest.raises(ConfigError) as error:
        call()
    assert message in str(error.value) and "\n" not in str(error.value)


ROOT = Path(__file__).parent.parent
# `tensor.numpy()` raises on a GPU alone: each call says `.cpu()` before it or `force=True`, but in these modules, whose
# tensors are always the CPU's.
OF_THE_CPU = {
    "siblings/npred_experiments/bounds.py",  # its own search, on arrays
    "npred/lab/training/operators/scaling.py",  # made of arrays, before a network moves
    "siblings/npred_experiments/evolution.py",  # its own search, on arrays
}
SAVED = ("npred/networks/", "npred/exports/")  # what is fused or exported was loaded from files, to the CPU
MODULES = [*(ROOT / "npred").rglob("*.py"), *ROOT.glob("siblings/*/*.py")]


def unfetched(text: str) -> list[int]:
    """The lines of `x.numpy()` without `.cpu()` before it and without `force=True`."""
    calls = [node for node in ast.walk(ast.parse(text)) if isinstance(node, ast.Call)]
    named = [call for call in calls if isinstance(call.func, ast.Attribute) and call.func.attr == "numpy"]
    return [call.lineno for call in named if not call.keywords and not _fetched(call.func.value)]  # type: ignore[union-attr]


def _fetched(node: ast.expr) -> bool:
    """True if `.cpu()` is among the calls that the expression chains."""
    while isinstance(node, ast.Call | ast.Attribute):
        if isinstance(node, ast.Attribute) and node.attr == "cpu":
            return True
        node = node.func if isinstance(node, ast.Call) else node.value
    return False


def test_a_tensor_is_fetched_before_it_is_an_array():
    names = {path.relative_to(ROOT).as_posix(): path for path in MODULES}
    seen = {name: path for name, path in names.items() if name not in OF_THE_CPU and not name.startswith(SAVED)}
    found = [f"{name}:{line}" for name, path in seen.items() for line in unfetched(path.read_text())]
    assert names.keys() >= OF_THE_CPU and not found, "\n".join(found)


def test_an_unfetched_tensor_is_found():
    lines = [
        "a.numpy()",
        "b.cpu().numpy()",
        "c.cpu().flatten().numpy().data",
        "d.numpy(force=True)",
        "e.double().numpy()",
    ]
    assert unfetched("\n".join(lines)) == [1, 5]
