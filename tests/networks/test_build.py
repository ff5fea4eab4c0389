"""A network of anybody's: made by its name with its sizes, asked once before it is trained, refused in one line."""

import sys

import pytest
import torch
from operator_samples import PLANT, samples

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
