"""Plants that are called, not traced: the same numbers as traced ones, in the same loop, and failures in one line."""

import textwrap

import numpy as np
import pytest
from jobs import job

import npred
from npred import plants
from npred.base.errors import ConfigError
from npred.diagnosis import check
from npred.estimation.adaptation import DelayAdaptation
from npred.exports import c_network, onnx
from npred.lab.scheduler.configuration import identity
from npred.lab.stages.evaluate import evaluate
from npred.lab.stages.generate import generate
from npred.lab.stages.train import train
from npred.loop.closed_loop import simulate
from npred.plants.black_box import BlackBox
from npred.prediction import methods as predictors
from npred.prediction.delays import arrays

TRACED = plants.resolve("cart_pole")
LAW = DelayAdaptation(gamma=1.0, b=1.0, bounds=(0.1, 0.3))
FILE = """
import numpy as np

from npred import plants

CART = plants.resolve("cart_pole")


class Box:
    '''The pendulum on a cart behind functions that nobody can trace.'''

    traced = False
    states, inputs, box, parameters = CART.states, CART.inputs, CART.box, CART.parameters

    def f(X, u, t, p):
        assert X.shape[1:] == (4,) and u.shape == (len(X), 1)
        return CART.f(X, u)

    def kappa(X, t, p):
        return CART.kappa(X)

    def V(X, t, p):
        return CART.V(X)
"""
GIVEN = """
    def df(X, u, t, p, v):
        return (CART.jacobians(X, u)[0] @ v[..., None])[..., 0]

    def dkappa(X, t, p, v):
        return (CART.kappa_jacobian(X) @ v[..., None])[..., 0]
"""


@pytest.fixture
def write(tmp_path):
    """A plant file with some text replaced; its reference."""

    def write(old="", new="", more=""):
        path = tmp_path / "box.py"
        path.write_text(textwrap.dedent(FILE).replace(old, new) + more if old else FILE + more)
        return f"{path}:Box"

    return write


@pytest.fixture
def plant(write):
    return plants.resolve(write())


def test_a_function_cannot_write_to_the_loops_memory(write):
    plant = plants.resolve(write("return CART.f(X, u)", "X[:] = 0; return CART.f(X, u)"))
    with pytest.raises(ConfigError, match=r"f failed at .*read-only"):
        predictors.numerical("rk4", plant, 5)(np.zeros(4), np.zeros((5, 1)), 0.2)


def test_differences_along_all_directions_are_one_call(write):
    plant = plants.resolve(
        write("assert X.shape[1:]", "rows.append(len(X))\n        assert X.shape[1:]", "\n\nrows = []\n")
    )
    rows = plant.declaration.f.__globals__["rows"]
    plant.jacobians(np.zeros((3, 4)), np.zeros((3, 1)))
    assert rows == [2 * 4 * 3, 2 * 1 * 3]


def test_functions_are_those_declared_on_any_batch(plant):
    random = np.random.default_rng(0)
    X, u = random.uniform(-0.5, 0.5, (3, 2, 4)), random.uniform(-1, 1, (3, 2, 1))
    assert isinstance(plant, BlackBox) and plant.rests and plant.autonomous and plant.phase(0.0) is None
    assert plant.rest is not None and plant.rest[0] is plant.equilibrium
    np.testing.assert_allclose(plant.f(X, u), TRACED.f(X, u), rtol=1e-14)
    np.testing.assert_allclose(plant.kappa(X), TRACED.kappa(X), rtol=1e-14)
    np.testing.assert_allclose(plant.V(X), TRACED.V(X), rtol=1e-14)
    np.testing.assert_allclose(plant.equilibrium, TRACED.equilibrium, atol=1e-12)


@pytest.mark.parametrize("more", ["", GIVEN])
def test_derivatives_are_differences_unless_given(write, more):
    plant, random = plants.resolve(write(more=more)), np.random.default_rng(1)
    X, u, v = random.uniform(-0.5, 0.5, (5, 4)), random.uniform(-1, 1, (5, 1)), random.normal(size=(5, 4))
    for found, wanted in zip(plant.jacobians(X, u), TRACED.jacobians(X, u), strict=True):
        np.testing.assert_allclose(found, wanted, atol=1e-8)
    along = (TRACED.kappa_jacobian(X) @ v[..., None])[..., 0]
    np.testing.assert_allclose(plant.dkappa(X, 0.0, v), along, atol=1e-8)
    assert (plant.df(X, u, 0.0, 0 * v) == 0).all()


@pytest.mark.parametrize("method", ["euler", "heun", "rk4", "picard"])
def test_predictions_are_those_of_the_compiled_predictor(plant, method):
    random = np.random.default_rng(2)
    X, u, D_hat = random.uniform(-0.3, 0.3, (6, 4)), random.uniform(-1, 1, (6, 11, 1)), random.uniform(0.1, 0.3, 6)
    found, wanted = (predictors.numerical(method, p, 11)(X, u, D_hat) for p in (plant, TRACED))
    np.testing.assert_allclose(found, wanted, rtol=1e-9, atol=1e-11)


@pytest.mark.parametrize("few", [0, 4])
@pytest.mark.parametrize("timed", [False, True])
def test_update_law_is_that_of_the_traced_plant(write, few, timed, monkeypatch):
    monkeypatch.setattr(arrays, "FEW", few)
    if timed:
        text = write("return CART.f(X, u)", "return CART.f(X, u) * (1 + 0.3 * np.sin(np.reshape(t, (-1, 1))))")
        moving = type("Moving", (TRACED.declaration,), {"f": lambda x, u, t, p, M: [
            a * (1 + 0.3 * M.sin(t)) for a in TRACED.declaration.f(x, u, t, p, M)]})  # fmt: skip
        pair = plants.resolve(text), plants.Plant("moving", moving)
        random = np.random.default_rng(4)
        X, u = random.uniform(-0.3, 0.3, (6, 4)), random.uniform(-1, 1, (6, 11, 1))
        P = predictors.numerical("rk4", pair[1], 11)(X, u, 0.2, 0.7)
        np.testing.assert_allclose(*(LAW.phi(plant, X, u, P, 0.2, 0.7) for plant in pair), rtol=1e-6)
        return
    plant, random = plants.resolve(write(more=GIVEN)), np.random.default_rng(3)
    X, u, D_hat = random.uniform(-0.3, 0.3, (6, 4)), random.uniform(-1, 1, (6, 11, 1)), random.uniform(0.1, 0.3, 6)
    P = predictors.numerical("rk4", TRACED, 11)(X, u, D_hat)
    np.testing.assert_allclose(LAW.phi(plant, X, u, P, D_hat), LAW.phi(TRACED, X, u, P, D_hat), rtol=1e-11)


@pytest.mark.parametrize("adaptation", [None, LAW])
def test_the_loop_is_that_of_the_traced_plant(plant, adaptation):
    """Delays off the control steps; with adaptation, differences in place of derivatives."""
    settings = {"D": [0.2, 0.1234], "D_hat": 0.25, "X0": [0.1, 0.0, 0.05, 0.0], "t_end": 1.0, "dt": 0.01}
    runs = [simulate(p, predictors.numerical("rk4", p, 11), adaptation=adaptation, **settings) for p in (plant, TRACED)]
    np.testing.assert_allclose(runs[0].X, runs[1].X, atol=1e-10 if adaptation is None else 1e-6)
    np.testing.assert_allclose(runs[0].D_hat, runs[1].D_hat, atol=1e-7)
    assert adaptation is None or np.ptp(runs[0].D_hat) > 1e-3


def test_controller_steps_are_those_of_the_loop(plant):
    controller = npred.controller(
        plant, predictors.numerical("rk4", plant, 11), LAW, 0.01, D_hat=0.25, actuator="measured"
    )
    loop = simulate(plant, predictors.numerical("rk4", plant, 11), D=0.2, D_hat=0.25, X0=[0.1, 0, 0.05, 0], t_end=0.01,
                    dt=0.01, adaptation=LAW)  # fmt: skip
    np.testing.assert_allclose(controller.step([0.1, 0, 0.05, 0], np.zeros((11, 1))), loop.U[0], rtol=1e-14)
    np.testing.assert_allclose(controller.D_hat, loop.D_hat[1], rtol=1e-14)


def test_the_chain_runs(write, tmp_path):
    """Data, a network, and its evaluation."""
    times = {"gamma": 1.0, "bounds": [0.1, 0.3], "nx": 5, "t_end": 0.4, "dt": 0.02}
    tables = {
        "plant": write(),
        "train": {"models": ["deeponet"]},
        "generate": times | {"D": 0.2, "D_hat": [[0.15, 0.25]], "samples": 60, "rollouts": 4},
        "evaluate": times
        | {"D": 0.2, "D_hat": 0.25, "X0": [0.1, 0, 0, 0], "case_t_end": 0.4, "case_states": 1, "case_D_hat": [0.2]},
    }
    data = job(tmp_path, "generate", **tables)
    assert generate.run(data).json_object()["samples"] == 60
    training = job(tmp_path, "deeponet", inputs={"generate": data.folder}, model="deeponet", **tables)
    train.run(training)
    inputs = {"generate": data.folder, "deeponet": training.folder}
    result = evaluate.run(job(tmp_path, "evaluate", inputs=inputs, **tables)).json_object()
    assert result["gain"] > 0 and result["models"]["deeponet"]["eps_sup"] > 0


def test_identity_follows_the_file_the_parameters_and_the_files_it_reads(write, tmp_path):
    data = tmp_path / "data.txt"
    data.write_text("1")
    more = f"\n    files = ({str(data)!r},)\n"
    before = identity(plants.resolve(write(more=more)))
    data.write_text("2")
    changed = identity(plants.resolve(write(more=more)))
    commented = identity(plants.resolve(write(more=more + "# a comment\n")))
    other = identity(plants.resolve(write(more=more + "    _more = 1\n")))
    assert commented == changed
    assert before["program"]["source"] == changed["program"]["source"] != other["program"]["source"]
    read = "files.data.txt"
    assert before["program"][read] != changed["program"][read] == other["program"][read]
    assert set(before["program"]) == {"source", read}
    for name, same in (("data.txt", False), ("data.py", True)):
        read, files = tmp_path / name, []
        for text in ("1", "1  # a comment"):
            read.write_text(text)
            more = f"\n    files = ({str(read)!r},)\n"
            files.append(identity(plants.resolve(write(more=more)))["program"][f"files.{name}"])
        assert (files[0] == files[1]) is same
    with pytest.raises(ConfigError, match="files expected a file to read at"):
        _ = identity(plants.resolve(write(more="\n    files = ('nowhere.urdf',)\n")))


def test_a_function_of_time_is_found_out(write):
    assert not plants.resolve(write("return CART.f(X, u)", "return CART.f(X, u) + t")).autonomous
    assert not plants.resolve(write("return CART.kappa(X)", "return CART.kappa(X) * (1 + t)")).rests


def test_a_law_that_comes_to_no_rest_says_so(write):
    """As that of a robot that walks: nobody searches a rest or asks for stability."""
    plant = plants.resolve(write("traced = False", "traced, rests = False, False"))
    assert plants.resolve(write()).rests and not plant.rests and plant.rest is None
    assert {answer.check for answer in check(plant)}.isdisjoint({"equilibrium", "stability", "convergence"})


def test_a_reference_is_followed(write):
    plant = plants.resolve(write("return CART.kappa(X)", "return CART.kappa(X) + np.reshape(t, (-1, 1))", """
    def reference(t, p):
        return t[:, None] * [1.0, 0.0, 0.0, 0.0]
"""))  # fmt: skip
    assert plant.tracks and plant.rest is None and not plant.clocked
    np.testing.assert_allclose(plant.target(2.0), [2.0, 0, 0, 0])
    np.testing.assert_allclose(plant.target(np.array([1.0, 3.0]))[:, 0], [1.0, 3.0])
    assert plant.u_target(np.array([1.0, 3.0])).shape == (2, 1)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (
            "return CART.f(X, u)",
            "return CART.f(X, u)[:, :3]",
            r"Box: f \(box.py:15\) expected to return shape \(4, 4\), .*, got \(4, 3\); return one deriv.* per state",
        ),
        (
            "return CART.kappa(X)",
            "return -u",
            r"Box: kappa failed at box.py:20: NameError: .*; only f knows the inputs",
        ),
        (
            "return CART.f(X, u)",
            "return foo",
            r"Box: f failed at box.py:17: NameError: .*; expected one of X, u, t, p,",
        ),
        ("return CART.kappa(X)", "raise OSError('no robot')", r"Box: kappa failed at box.py:20: OSError: no robot"),
        (
            "return CART.kappa(X)",
            "raise ValueError('no robot')",
            r"Box: kappa failed at box.py:20: ValueError: no robot",
        ),
        ("return CART.f(X, u)", "return X[:, 9]", r"Box: f failed at box.py:17: IndexError"),
        ("def V(X, t, p)", "def V(X)", r"Box: V failed \(box.py:22\): TypeError.*; write def V\(X, t, p\)"),
        ("traced = False", "traced, delays = False, (0.2,)", None),
    ],
)
def test_failures_are_told_in_one_line(write, old, new, message):
    def run():
        plant = plants.resolve(write(old, new))
        simulate(
            plant,
            predictors.numerical("rk4", plant, 5),
            D=0.2,
            D_hat=0.2,
            X0=[0.1, 0, 0, 0],
            t_end=0.1,
            dt=0.05,
            adaptation=LAW,
        )

    if message is None:
        run()  # one delay, however it is said
        return
    with pytest.raises(ConfigError, match=message) as caught:
        run()
    assert "\n" not in str(caught.value)


POWERS = '''
import math

import numpy as np


class Powers:
    """x' = x³ + u and a root, by functions of Python's own floats, which raise where arrays give NaN."""

    traced = False
    states, inputs, box = ("x",), ("u",), {"x": (-1.0, 1.0)}

    def f(X, u, t, p):
        return np.array([[math.pow(x, 3) + v] for x, v in zip(X[:, 0], u[:, 0], strict=True)])

    def kappa(X, t, p):
        return np.array([[-2 * x - math.pow(x, 3) + 0 * math.sqrt(50 - x)] for x in X[:, 0]])

    def V(X, t, p):
        return X[:, 0] ** 2
'''


@pytest.fixture
def powers(tmp_path):
    (tmp_path / "powers.py").write_text(POWERS)
    return plants.resolve(f"{tmp_path / 'powers.py'}:Powers")


def test_a_function_that_raises_loses_its_own_loop_alone(powers):
    """From 1e200 f overflows, from 60 kappa leaves its domain; the third loop is as if it ran alone."""
    settings = {"D": 0.1, "D_hat": 0.1, "t_end": 0.5, "dt": 0.05}
    loops = simulate(powers, predictors.numerical("rk4", powers, 5), X0=[[1e200], [60.0], [0.5]], **settings)
    alone = simulate(powers, predictors.numerical("rk4", powers, 5), X0=[0.5], **settings)
    assert (loops.escaped >= 0).tolist() == [True, True, False]
    np.testing.assert_array_equal(loops.X[2], alone.X)
    assert np.isnan(powers.f(np.array([1e200]), np.zeros(1))).all(), "one row, and not at the guess"


def test_plants_check_asks_what_can_be_asked(plant, write, monkeypatch):
    monkeypatch.setattr("npred.diagnosis.adaptive_loop.MOST", 800)  # control steps of a loop
    found = {answer.check: answer for answer in check(plant, 0.2, 21, samples=16)}
    assert {name: answer.verdict for name, answer in found.items() if answer.verdict != "yes"} == {"trace": "warn"}
    assert "smooth law" not in found and "V" in found
    monkeypatch.setattr("npred.diagnosis.adaptive_loop.MOST", 20)
    rising = plants.resolve(write("return CART.V(X)", "return 1 / (1 + CART.V(X))"))
    assert {answer.check: answer.verdict for answer in check(rising, 0.2, 21, samples=16)}["V"] == "warn"


def test_exports_that_write_the_law_out_refuse_it(plant):
    with pytest.raises(ConfigError, match="export c: expected a plant that is traced, Box says traced = False"):
        c_network.source(None, plant, 11, ())  # type: ignore[arg-type]
    for package in ("onnx", "onnxscript"):
        pytest.importorskip(package)
    with pytest.raises(ConfigError, match="onnx: expected a plant that is traced, Box says traced = False"):
        onnx.graph(None, plant, 11)  # type: ignore[arg-type]


def test_a_class_of_no_file_is_reported():
    space = {}
    exec(FILE, space)
    space["Box"].__module__ = "nowhere"
    with pytest.raises(ConfigError, match=r"expected a class in a file, as tank\.py:Tank"):
        plants.make("Box", space["Box"])


class Explosive:
    """x' = x³ + u, too fast for the delay: loops leave the finite numbers at once."""

    traced = False
    states, inputs, box = ("x",), ("u",), {"x": (-1.0, 1.0)}
    f = lambda X, u, t, p: X**3 + u
    kappa = lambda X, t, p: -(X**3) - X
    V = lambda X, t, p: X[:, 0] ** 2


@pytest.mark.filterwarnings("error::RuntimeWarning")
@pytest.mark.parametrize("method", ["euler", "rk4", "picard"])
def test_a_loop_that_explodes_is_nan_without_a_warning(method: str):
    plant = plants.make("explosive", Explosive)
    predictor = predictors.numerical(method, plant, nx=11)
    loop = simulate(plant, predictor, D=0.2, D_hat=0.3, X0=[3.0], t_end=0.5, dt=0.01, adaptation=LAW)
    assert not np.isfinite(loop.X[-1]).all()
