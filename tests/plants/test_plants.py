"""Plants: declaration, equilibrium, derivatives, arrays and tensors, a user's own file, and what goes wrong."""

import pickle
from pathlib import Path

import numpy as np
import pytest
import torch
from follower import Follower, follower
from hypothesis import given
from hypothesis import strategies as st
from tank import TANK

import npred
from npred import plants
from npred.base.errors import ConfigError
from npred.lab.scheduler.configuration import identity
from npred.plants import BlackBox, Plant

X_STAR = (0.093894784596175314799, 5.2514404348957272692)  # independent solver, 18 digits
U_STAR = -2.62808664394595e-5

CALLED = """
class Tank:
    states, inputs, parameters, guess, traced = ("h",), ("U",), {"c": 0.5}, (0.8,), False

    def f(X, u, t, p):
        return u - p.c * X

    def kappa(X, t, p):
        return p.c - X

    def V(X, t, p):
        return X[:, 0] ** 2
"""


def test_equilibrium_to_machine_precision():
    plant = plants.resolve("activator_repressor")
    np.testing.assert_allclose(plant.equilibrium, X_STAR, rtol=1e-14)
    np.testing.assert_allclose(plant.u_equilibrium, U_STAR, rtol=1e-10)


def test_jacobians_at_the_equilibrium():
    plant = plants.resolve("activator_repressor")
    f_X, f_U = plant.jacobians(np.array(X_STAR), np.array([U_STAR]))
    np.testing.assert_allclose(f_X, [[0.970137859187033, -0.0345073280414935], [55.3557587564355, -0.5]], rtol=1e-12)
    np.testing.assert_allclose(f_U, [[1.0], [0.0]])
    np.testing.assert_allclose(
        plant.kappa_jacobian(np.array(X_STAR)), [[-1.97013785918703, 0.0345073280414935]], rtol=1e-12
    )


@given(st.floats(0.001, 1.0), st.floats(0.1, 60.0), st.floats(-0.5, 0.5))
def test_jacobians_equal_central_differences(x1, x2, U):
    plant = plants.resolve("activator_repressor")
    X, u, steps = np.array([x1, x2]), np.array([U]), np.array([1e-6 * x1, 1e-6 * x2])
    f_X, _ = plant.jacobians(X, u)
    for k, unit in enumerate(np.eye(2)):
        h = steps[k]
        difference = (plant.f(X + h * unit, u) - plant.f(X - h * unit, u)) / (2 * h)
        np.testing.assert_allclose(f_X[:, k], difference, rtol=1e-5, atol=1e-5)
        slope = (plant.kappa(X + h * unit) - plant.kappa(X - h * unit)) / (2 * h)
        np.testing.assert_allclose(plant.kappa_jacobian(X)[:, k], slope, rtol=1e-5, atol=1e-5)


def test_input_enters_the_activator_alone():
    plant, X = plants.resolve("activator_repressor"), np.array([0.1, 5.0])
    np.testing.assert_allclose(plant.f(X, np.array([0.3])) - plant.f(X, np.array([0.0])), [0.3, 0.0], atol=1e-15)


def test_arrays_and_tensors_agree_and_differentiate():
    plant, random = plants.resolve("activator_repressor"), np.random.default_rng(0)
    X, u = random.uniform(0.1, 5, (4, 3, 2)), random.uniform(-1, 1, (4, 3, 1))
    X_t, u_t = torch.tensor(X, requires_grad=True), torch.tensor(u)
    for name, values in (("f", plant.f(X_t, u_t)), ("kappa", plant.kappa(X_t)), ("V", plant.V(X_t))):
        expected = plant.f(X, u) if name == "f" else getattr(plant, name)(X)
        np.testing.assert_allclose(values.detach().numpy(), expected, rtol=1e-14)
    (gradient,) = torch.autograd.grad(plant.kappa(X_t).sum(), X_t)
    np.testing.assert_allclose(gradient[1, 2].numpy(), plant.kappa_jacobian(X[1, 2])[0], rtol=1e-12)


def test_mathematics_of_parameters_and_time_on_tensors(tank_file):
    law = "M.where(p.level > 0.5, M.exp(-p.c), 2.0) * M.maximum(p.c, x.h) * M.cos(t) * M.minimum(p.c, p.level)"
    tank = plants.resolve(tank_file("p.c * M.sqrt(x.h) + p.level - x.h", law))
    X = np.array([[0.3], [1.7]])
    values = tank.kappa(torch.tensor(X, dtype=torch.float32), 0.4)
    assert values.dtype == torch.float32
    np.testing.assert_allclose(values.numpy(), tank.kappa(X, 0.4), rtol=1e-6)


def test_a_branch_that_is_not_taken_may_be_undefined(tank_file):
    safe = "M.where(x.h > 0, M.sqrt(x.h), 0.0 * x.h)"
    tank = plants.resolve(tank_file("return [u.U - p.c * M.sqrt(x.h)]", f"return [u.U - p.c * {safe} - x.h]"))
    f_X, f_U = tank.jacobians(np.array([-1.0]), np.array([0.0]))
    assert (f_X.item(), f_U.item()) == (-1.0, 1.0)


def test_arrays_of_a_wrong_size_are_told():
    with pytest.raises(ConfigError, match=r"X: expected an array \(..., 2\) for plant activator_repressor, got \(3,\)"):
        plants.resolve("activator_repressor").kappa(np.zeros(3))


def test_parameters_override_and_enter_the_identity():
    plain, changed = plants.resolve("scalar"), plants.resolve("scalar", {"a": 0.7})
    assert changed.parameters == {"a": 0.7, "c": 1.0}
    assert identity(plain) != identity(changed)
    assert identity(plants.resolve("scalar")) == identity(plain)


def test_plants_with_a_name_are_listed():
    names = {row["name"]: row for row in plants.named()}
    assert names["activator_repressor"]["states"] == ["x1", "x2"]
    assert names["scalar"]["inputs"] == ["U"]


def test_own_file(tank_file):
    tank = plants.resolve(tank_file())
    np.testing.assert_allclose(tank.equilibrium, [1.0], atol=1e-14)
    np.testing.assert_allclose(tank.f(np.array([[4.0]]), np.array([[1.0]])), [[0.0]])


def test_identity_follows_the_formulas_and_not_the_text(tank_file):
    before = plants.resolve(tank_file())
    remark = plants.resolve(tank_file("class Tank", "# a remark\nimport os  # unused\nclass Tank"))
    unused = plants.resolve(tank_file("return [u.U", "x.h * x.h  # of no use\n        return [u.U"))
    assert identity(before) == identity(remark) == identity(unused)
    assert len({plant.source.text for plant in (before, remark, unused)}) == 3


@pytest.mark.parametrize(
    ("old", "new", "parts"),
    [
        ("- p.c * M.sqrt", "- 2 * p.c * M.sqrt", {"f"}),
        ("+ p.level - x.h", "+ p.level - 2 * x.h", {"kappa"}),
        ("(x.h - p.level) ** 2", "2 * (x.h - p.level) ** 2", {"V"}),
    ],
)
def test_identity_tells_which_formula_changed(tank_file, old, new, parts):
    before, after = identity(plants.resolve(tank_file())), identity(plants.resolve(tank_file(old, new)))
    assert {name for name, digest in before["program"].items() if after["program"][name] != digest} == parts
    assert {key for key in before if before[key] != after[key]} == {"program"}


def _driven(x, u, t, p, M):
    return [u[0] - x[0]]


def test_names_of_inputs_are_part_of_the_identity():
    before, after = (type("Any", (Follower,), {"inputs": (name,), "f": staticmethod(_driven)}) for name in "ab")
    assert identity(Plant("Any", before)) != identity(Plant("Any", after))


def test_a_plant_knows_the_text_that_declares_it(tank_file):
    source = plants.resolve(tank_file()).source
    assert (source.file, source.text) == ("my_plant.py", TANK)
    assert "class Scalar" in plants.resolve("scalar").source.text


def test_time_dependence_means_no_equilibrium(tank_file):
    tank = plants.resolve(tank_file("+ p.level - x.h", "+ p.level + M.sin(t) - x.h"))
    assert not tank.rests
    with pytest.raises(ConfigError, match="f or kappa depends on time; it only tracks"):
        _ = tank.equilibrium
    with pytest.raises(ConfigError, match=r"found neither; declare reference\(t, p, M\)"):
        tank.target(0.0)


def test_the_target_is_the_equilibrium_or_the_reference():
    rests, tracks, t = plants.resolve("scalar"), follower(), np.array([0.0, 0.7])
    assert rests.target(t) is rests.equilibrium and rests.u_target(t) is rests.u_equilibrium
    assert tracks.tracks and not rests.tracks
    np.testing.assert_allclose(tracks.target(0.7), [0.3 * np.sin(1.05)], rtol=1e-15)
    assert tracks.target(t).shape == (2, 1)
    np.testing.assert_allclose(tracks.u_target(t)[1], 0.45 * np.cos(1.05) - 0.15 * np.sin(1.05), rtol=1e-14)


def test_the_reference_is_part_of_the_identity():
    other = type("Other", (Follower,), {"reference": staticmethod(lambda t, p, M: [p.A * M.cos(p.w * t)])})
    assert identity(Plant("Follower", other))["program"] != identity(follower())["program"]


@pytest.mark.parametrize(
    ("reference", "kappa", "message"),
    [
        (lambda t, p, M: [0.0, t], None, r"reference \(test_plants.py:\d+\) expected to return 1 value, got 2; return"),
        (lambda x, t, p, M: [t], None, r"reference failed \(test_plants.py:\d+\): TypeE"),
        (0.5, None, "reference: expected a function, got 0.5"),
        (None, lambda x, t, p, M: [-x.X], r"reference \(follower.py:\d+\) expected a kappa that depends on t"),
    ],
)
def test_a_wrong_reference_is_told(reference, kappa, message):
    changed = {"reference": reference or Follower.reference, "kappa": kappa or Follower.kappa}
    with pytest.raises(ConfigError, match=message):
        _ = identity(Plant("Wrong", type("Wrong", (), vars(Follower) | changed)))


def test_derivatives_at_many_points_and_times_are_those_at_each():
    plant, random = plants.resolve("chemostat"), np.random.default_rng(1)
    X, u = random.uniform(0.5, 3.0, (5, 2)), random.uniform(0.0, 2.0, (5, 1))
    f_X, f_U = plant.jacobians(X, u)
    for k in range(5):
        one_X, one_U = plant.jacobians(X[k], u[k])
        np.testing.assert_allclose(f_X[k], one_X, rtol=1e-14)
        np.testing.assert_allclose(f_U[k], one_U, rtol=1e-14)
        np.testing.assert_allclose(plant.kappa_jacobian(X)[k], plant.kappa_jacobian(X[k]), rtol=1e-14)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("class Tank", "class Tank(", r"my_plant.py:2: expected Python, got a syntax error"),
        ("class Tank", "class Vessel", r"expected a class Tank, found Vessel"),
        ("class Tank", "import nowhere\nclass Tank", r"my_plant.py:2: failed on import: ModuleNotFoundError"),
        ("def kappa", "def _law", r"plant Tank: expected kappa\(x, t, p, M\), found none; declare it, or set"),
        ("M.sqrt(x.h)]", "M.where((x.h > 0) & (x.h < 1), 1, 0)]", r"f failed .* for &: .*; write M.logical_and"),
        ("p.c * M.sqrt(x.h)]", "p['c']]", r"f failed at my_plant.py:11: .*; states, .* have names: write x.name"),
        ("def f(x, u, t, p, M)", "def f(t, x, u, p, M)", r"; look at the order .*: write def f\(x, u, t, p, M\)"),
        ("return [u.U - p.c * M.sqrt(x.h)]", "return [u.U, x.h]", r"10\) expected to return 1 value, got 2; .* h"),
        ("[u.U - p.c", "[u - p.c", r"f failed at my_plant.py:11: TypeError: .*; inputs have names: write u.name"),
        ("M.sqrt(x.h)]", "M.sqrt(x)]", r"f failed at my_plant.py:11: TypeError: .*; states have names: write x.name"),
        ("M.sqrt(x.h)]", "M.sqrt(x.level)]", r"Tank: f failed at my_plant.py:11: AttributeError: .*level"),
        ("+ p.level - x.h", "+ max(x.h, 0)", r"Tank: kappa failed at my_plant.py:14: .*write M.maximum"),
        ("M.sqrt(x.h)]", "M.sinn(x.h)]", r"Tank: f failed at my_plant.py:11: .*M: expected one of .*you mean sin"),
        ("M.sqrt(x.h)]", "M.sqrt(x.h, 2)]", r"Tank: f failed at my_plant.py:11: .*M.sqrt expected 1 argument, got 2"),
        ("def f(x, u, t, p, M)", "def f(x, u)", r"f failed \(my_plant.py:10\): TypeError: .* 2 positional arguments"),
        ("p.c * M.sqrt(x.h)]", "c * M.sqrt(x.h)]", r"f failed at my_plant.py:11: NameError: .*; write p.c"),
        ("M.sqrt(x.h)]", "sqrt(x.h)]", r"f failed at my_plant.py:11: NameError: .*; write M.sqrt"),
        ("M.sqrt(x.h)]", "M.sqrt(h)]", r"f failed at my_plant.py:11: NameError: .*; write x.h"),
        ("p.level - x.h", "p.level - U", r"kappa failed at my_plant.py:14: NameError: .*only f knows the inputs"),
        ("p.level - x.h", "p.level - y", r"kappa failed at my_plant.py:14: NameError: .*expected one of x, t, p, M"),
        ("M.sqrt(x.h)]", "__import__('numpy').sqrt(x.h)]", r"f failed at my_plant.py:11: TypeError: .*; write M.sqrt"),
        ("(x.h - p.level) ** 2", "[x.h]", r"V \(my_plant.py:16\) expected .*, got list; return one number, not a"),
        ("class Tank", "import sys; sys.exit(3)\nclass Tank", r"failed on import: SystemExit"),
        ("+ p.level - x.h", "+ 1 + x.h**2", r"\(my_plant.py:13\) leads to no rest near guess = \[0.8\]: h' = 1"),
    ],
)
def test_mistakes_are_told_in_one_line(tank_file, old, new, message):
    with pytest.raises(ConfigError, match=message) as caught:
        plant = plants.resolve(tank_file(old, new))
        assert identity(plant) and plant.equilibrium.shape
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("name", "parameters", "message"),
    [
        ("protein", {}, "expected one of activator_repressor, .*scalar.*, or a file"),
        ("scalar", {"k": 1.0}, "expected parameters a, c, got 'k'"),
        ("scalar", {"kapa": 1.0}, "got 'kapa'; did you mean kappa?"),
        ("nowhere.py:Tank", {}, "found none at nowhere.py"),
        ("my_plant.py", {}, "expected the class too, got the file alone; write my_plant.py:Tank, say"),
    ],
)
def test_unknown_names_are_told(name, parameters, message):
    with pytest.raises(ConfigError, match=message):
        plants.resolve(name, parameters)


class Lag:
    """A class of this module, without V, which Python can import."""

    states, inputs, parameters = ("x",), ("u",), {"a": 1.0}
    f = lambda x, u, t, p, M: [u.u - p.a * x.x]
    kappa = lambda x, t, p, M: [-x.x]


class Called(Lag):
    """The same behind functions of arrays."""

    traced = False
    f = lambda X, u, t, p: u - p.a * X
    kappa = lambda X, t, p: -X
    V = lambda X, t, p: X[:, 0] ** 2


def pickled(plant):
    """The plant after a look at all that it derives, through pickle."""
    plant.jacobians(plant.guess, np.zeros(plant.m))
    return pickle.loads(pickle.dumps(plant))


@pytest.mark.parametrize("name", ["activator_repressor", "planar_arm3", "unicycle"])
def test_a_plant_with_a_name_pickles_by_its_name(name):
    plant = plants.resolve(name)
    copy = pickled(plant)
    assert identity(copy) == identity(plant) and copy is not plant
    assert pickled(plant) is copy  # once a process: it keeps what is compiled
    assert len(pickle.dumps(plant)) < 2000


def test_a_plant_of_a_class_pickles_with_it():
    for kind, declaration in ((Plant, Lag), (BlackBox, Called)):
        plant = kind("lag", declaration, {"a": 2.5})
        copy = pickled(plant)
        assert type(copy) is kind and copy.parameters == {"a": 2.5} and identity(copy) == identity(plant)
        assert copy.declares_V == plant.declares_V


@pytest.mark.parametrize("traced", [True, False])
def test_a_plant_of_a_file_pickles_by_its_path(tank_file, traced, monkeypatch):
    spec = tank_file() if traced else tank_file(text=CALLED)
    path = Path(spec.removesuffix(":Tank"))
    monkeypatch.chdir(path.parent)
    plant = plants.resolve(f"{path.name}:Tank", {"c": 0.7})
    text = pickle.dumps(plant)
    monkeypatch.chdir("/")
    copy = pickle.loads(text)
    assert type(copy) is type(plant) and identity(copy) == identity(plant) and copy.parameters["c"] == 0.7


def test_a_pickled_plant_whose_file_changed_or_went_is_refused(tank_file):
    spec = tank_file()
    text = pickle.dumps(plants.resolve(spec, {"c": 0.8}))
    Path(spec.removesuffix(":Tank")).write_text(TANK + "\nedited = 1")
    with pytest.raises(ConfigError, match=r"my_plant.py:Tank: expected the file that was pickled, got another text"):
        pickle.loads(text)
    Path(spec.removesuffix(":Tank")).unlink()
    with pytest.raises(ConfigError, match="expected a Python file, found none"):
        pickle.loads(text)


def test_a_class_that_nobody_can_import_pickles_by_value_where_the_pickler_can():
    cloudpickle = pytest.importorskip("cloudpickle")

    class Local(Lag):
        pass

    plant = Plant("local", Local)
    with pytest.raises((pickle.PicklingError, AttributeError), match="Local"):
        pickle.dumps(plant)
    assert identity(pickle.loads(cloudpickle.dumps(plant))) == identity(plant)


def test_plants_say_what_they_are():
    assert repr(plants.resolve("scalar", {"a": 0.3})) == "<Plant scalar: states X; inputs U; a = 0.3, c = 1>"
    assert repr(BlackBox("lag", Called)) == "<BlackBox lag: states x; inputs u; a = 1>"
    assert len(repr(plants.resolve("planar_arm7"))) < 200


def test_a_class_is_a_plant_with_parameters_and_a_law():
    class Lag:
        states, inputs, parameters, box = ("x",), ("u",), {"rate": 1.0}, {"x": (-1.0, 1.0)}
        f = lambda x, u, t, p, M: [-p.rate * x.x + u.u]

    lag = npred.plant(Lag, kappa="lqr", rate=2.0)
    assert (lag.name, lag.parameters["rate"]) == ("Lag", 2.0)
    assert lag.f(np.array([1.0]), np.array([0.0]))[0] == -2.0
    assert lag.kappa(np.array([1.0]))[0] < 0
    with pytest.raises(ConfigError, match=r"a name, my_plant\.py:Tank or a class"):
        npred.plant(Lag.f)  # type: ignore[arg-type]
