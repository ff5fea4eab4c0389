"""A network of anybody's: built by its name, asked once before it is trained; and constants of the training data."""

import sys
from dataclasses import replace

import numpy as np
import pytest
import torch
from operator_samples import PLANT, SMALL, Arrays, operator, samples, tensors

from npred.base import registry
from npred.base.errors import ConfigError
from npred.lab import config
from npred.lab.config import FNO, DeepONet, Network
from npred.lab.training.operators import Scaling, build, checked

OWN = """
import torch

class Flat(torch.nn.Module):
    def __init__(self, n, m, clock=0, *, level=1.0):
        super().__init__()
        self.level = torch.nn.Parameter(torch.full((n,), float(level)))

    def forward(self, X, u, D_hat, stride=1):
        return self.level.expand(len(X), len(range(0, u.shape[1], stride)), -1)
"""


@pytest.fixture
def own(tmp_path):
    """Write a file of a network, and give its table."""

    def table(text: str = OWN, **sizes: object) -> Network:
        (tmp_path / "own.py").write_text(text)
        return Network(network=f"{tmp_path / 'own.py'}:Flat", sizes=sizes, anchor="initial")

    return table


@pytest.mark.parametrize("kind", [DeepONet, FNO])
def test_defaults_of_the_class_are_those_of_the_table(kind):
    table = kind()
    torch.manual_seed(0)
    first = build(table, PLANT, Scaling(2, 1)).state_dict()
    torch.manual_seed(0)
    second = build(Network(network=table.architecture), PLANT, Scaling(2, 1)).state_dict()
    assert first.keys() == second.keys() and all(torch.equal(first[name], second[name]) for name in first)


def test_a_network_of_a_file_is_made_with_its_sizes(own):
    data = samples(3)
    operator = checked(own(level=2.0), PLANT, Scaling.of(data))
    X, u, D_hat = (torch.as_tensor(a, dtype=torch.float32) for a in (data.X, data.u, data.D_hat))
    P = operator(X, u, D_hat)
    torch.testing.assert_close(P[:, -1], X + 2 * D_hat[:, None] * operator.scaling.speed)


def test_a_network_of_a_package_is_made_by_its_name(package):
    package("flat = shed_of_tanks:Flat", OWN, group="npred.networks")
    train = config.Train.model_validate({"models": ["flat"]})
    assert "shed_of_tanks" not in sys.modules
    assert type(checked(train.table("flat"), PLANT, Scaling(2, 1)).network).__name__ == "Flat"
    registry.NETWORKS.check_keywords("sizes", "flat", ["levle"])  # its text is not looked for
    misspelt = Network(network="flat", sizes={"levle": 1})
    with pytest.raises(ConfigError, match=r"network flat: .* unexpected keyword argument 'levle'"):
        checked(misspelt, PLANT, Scaling(2, 1))


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (", -1)\n", ", -1)[..., :1]\n", r"expected forward to return \(B, nodes, n\), \(2, 5, 2\) .* got \(2, 5, 1\)"),
        (", stride)", ")", r"\(2, 3, 2\) with stride 2, got \(2, 5, 2\) and \(2, 5, 2\)"),
        ("return self", "return self.nothing + self", "AttributeError: .* has no attribute 'nothing'"),
        ("float(level)", "float('much')", "ValueError: could not convert string to float: 'much'"),
        ("(torch.nn.Module)", "", "network .*own.py:Flat: "),
        ("class Flat", "class Round", "expected a class Flat, found Round"),
    ],
)
def test_a_network_that_cannot_be_trained_is_refused_in_one_line(own, old, new, message):
    assert old in OWN
    with pytest.raises(ConfigError, match=message) as refused:
        checked(own(OWN.replace(old, new)), PLANT, Scaling(2, 1))
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize(
    ("text", "sizes", "message"),
    [
        (OWN, {"levle": 1}, r"sizes: expected keyword arguments of Flat \(level\), got levle; did you mean level\?"),
        (OWN.replace("level=1.0", "level, depth=2"), {"depth": 1}, r"Flat \(level, depth\), no level; give it a value"),
        (OWN.replace("Flat", "Round"), {}, "sizes: expected a class Flat in .*own.py, found none"),
        (OWN.replace("return", "retrun x"), {}, "own.py:11: expected Python, got a syntax error"),
    ],
)
def test_sizes_are_checked_by_the_text_of_the_file(own, text, sizes, message):
    with pytest.raises(ConfigError, match=message) as refused:
        registry.NETWORKS.check_keywords("sizes", own("import nowhere\n1 / 0\n" + text[1:]).network, sizes)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize("text", [OWN.replace("*, level=1.0", "**sizes"), OWN.replace("__init__", "make"), OWN])
def test_what_the_text_does_not_say_is_not_refused(own, text):
    registry.NETWORKS.check_keywords("sizes", own(text).network, ["level"])


def test_inputs_come_out_standardised():
    data = samples(300)
    X, u, D_hat = Scaling.of(data).inputs(*tensors(data))
    for values in (X, u.flatten(0, 1), D_hat):
        torch.testing.assert_close(values.mean(0), torch.zeros_like(values[0]), rtol=0, atol=1e-5)
        torch.testing.assert_close(values.std(0, correction=0), torch.ones_like(values[0]), rtol=1e-5, atol=0)


def test_constants_by_hand():
    X = np.array([[1.0, 10.0], [3.0, 10.0]])
    u = np.array([[[0.0], [2.0]], [[4.0], [6.0]]])
    P = X[:, None] + np.array([[[0, 0], [3, -8]], [[0, 0], [4, 6]]])
    scaling = Scaling.of(Arrays(X, u, np.array([1.0, 2.0]), P))
    assert scaling.X_bend.tolist() == [1, 1] and scaling.X_std.tolist()[1] == 1
    np.testing.assert_allclose(scaling.X_mean, [np.arcsinh([1, 3]).mean(), np.arcsinh(10)], rtol=1e-6)
    assert scaling.u_mean.tolist() == [3] and scaling.D_hat_std.item() == 0.5
    np.testing.assert_allclose(scaling.u_std, np.sqrt(5), rtol=1e-6)
    np.testing.assert_allclose(scaling.speed, np.sqrt(np.array([12.5, 50]) / 2.5), rtol=1e-6)
    np.testing.assert_allclose(scaling.P_mean, P.mean((0, 1)), rtol=1e-6)


@pytest.mark.parametrize("cuts", [[300], [1, 299], [100, 0, 150, 50]])
def test_parts_give_the_constants_of_the_whole(cuts):
    data, stops = samples(300), np.cumsum(cuts)
    far = replace(data, X=data.X + np.array([0, 1e4]), P=data.P + np.array([0, 1e4]))  # cancellation would show

    def parts():
        for count, stop in zip(cuts, stops, strict=True):
            some = slice(stop - count, stop)
            yield Arrays(far.X[some], far.u[some], far.D_hat[some], far.P[some])

    whole, joined = Scaling.of(far).state_dict(), Scaling.of_parts(parts).state_dict()
    for name in whole:
        torch.testing.assert_close(joined[name], whole[name], rtol=1e-6, atol=0)


def test_constant_input_stays_finite():
    data = samples()
    flat = Arrays(data.X, np.zeros_like(data.u), np.full_like(data.D_hat, 1.0), data.P)
    assert all(bool(torch.isfinite(t).all()) for t in Scaling.of(flat).inputs(*tensors(flat)))


def test_scaling_is_part_of_the_saved_tensors():
    names = set(operator(SMALL[0]).state_dict())
    constants = {f"scaling.{v}_{s}" for v in ("X", "u", "D_hat", "P") for s in ("mean", "std")}
    assert constants | {"scaling.X_bend", "scaling.speed", "X_rest", "u_rest"} <= names
