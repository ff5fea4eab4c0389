"""The family of kernels that serves a plant: one for each kind, and no kind of plant is told apart elsewhere."""

import re
from pathlib import Path

import pytest

import npred
from npred import plants
from npred.delays import FAMILIES, family_of
from npred.errors import ConfigError
from npred.plants.black_box import BlackBox


class OnArrays:
    """x' = -x + u, called on arrays."""

    states, inputs, traced = ("x",), ("u",), False

    def f(X, u, t, p):
        return u - X

    def kappa(X, t, p):
        return 0 * X

    def V(X, t, p):
        return X[:, 0] ** 2


EACH = {
    "ConstantDelay": plants.resolve("planar_arm2"),
    "DelayPerInput": plants.resolve("unicycle"),
    "ArrayFamily": BlackBox("arrays", OnArrays),
}


@pytest.mark.parametrize("name", EACH)
def test_one_family_serves_a_plant(name: str):
    assert [family.__name__ for family in FAMILIES if family.serves(EACH[name])] == [name]
    assert type(family_of(EACH[name])).__name__ == name


def test_what_a_family_lacks_is_refused_with_the_cure():
    family = family_of(EACH["DelayPerInput"])
    for kernel, cure in ((lambda: family.picard(1e-9, 9), "use rk4"), (family.update, "freeze the estimate")):
        with pytest.raises(ConfigError, match=rf"expected one delay, plant unicycle has delays 0.25 s, 0.6 s; {cure}"):
            kernel()


def test_kinds_of_plants_are_told_apart_by_their_families_alone():
    package = Path(npred.__file__).parent
    asking = [path for path in package.rglob("*.py") if re.search(r"isinstance\([^)]*BlackBox", path.read_text())]
    assert [str(path.relative_to(package)) for path in asking] == ["delays/arrays.py"]
