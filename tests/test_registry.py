"""Named parts: found by name, imported when asked for; and signatures that every interpreter and pydantic must read."""

import importlib
import inspect
import pkgutil
import sys
from collections.abc import Callable, Iterator
from functools import partial
from operator import attrgetter
from typing import Annotated, Any

import pytest
from conftest import TANK
from pydantic import BaseModel, BeforeValidator, PlainSerializer
from typer.testing import CliRunner

import npred
from npred import plants
from npred.base import registry
from npred.base.errors import ConfigError
from npred.cli import app


def test_a_registered_plant_is_found_listed_and_lazily_imported(package):
    package("round_tank = shed_of_tanks:Tank")
    assert plants.resolve("scalar").n == 1
    with pytest.raises(ConfigError, match=r"expected one of .*, round_tank, .*or a file"):
        plants.resolve("nonesuch")
    assert "shed_of_tanks" not in sys.modules
    tank = plants.resolve("round_tank")
    assert (tank.name, tank.states, tank.equilibrium.tolist()) == ("round_tank", ("h",), [1.0])
    assert tank.source is not None and tank.source.file == "shed_of_tanks.py"
    assert "round_tank" in [row["name"] for row in plants.named()]


def test_a_built_in_name_cannot_be_taken(package):
    package("scalar = shed_of_tanks:Tank")
    assert plants.resolve("scalar").states == ("X",)
    assert [row["name"] for row in plants.named()].count("scalar") == 1


def test_a_broken_package_hides_no_other_plant(package):
    package("round_tank = shed_of_tanks:Tank", "import nowhere")
    rows = {row["name"]: row for row in plants.named()}
    assert "failed on import" in rows["round_tank"]["error"] and rows["scalar"]["states"] == ["X"]
    listed = CliRunner().invoke(app, ["plants"])
    assert listed.exit_code == 0 and "scalar" in listed.stdout
    assert listed.stderr.startswith("warning: plant round_tank: shed-of-tanks failed on import")


@pytest.mark.parametrize(
    ("entry", "text", "words"),
    [
        ("round_tank = shed_of_tanks:Tank", "import nowhere", "shed-of-tanks failed on import of shed_of_tanks:Tank"),
        ("round_tank = shed_of_tanks:Vat", TANK, "failed on import of shed_of_tanks:Vat: AttributeError"),
        (
            "round_tank = shed_of_tanks:Tank",
            "Tank = 3",
            "plant round_tank: expected states, inputs, f, found no states",
        ),
    ],
)
def test_a_broken_package_is_told_by_name(package, entry, text, words):
    package(entry, text)
    with pytest.raises(ConfigError, match=words):
        plants.resolve("round_tank")


@pytest.mark.parametrize("parts", [registry.NETWORKS, registry.METHODS, registry.DELAY_LAWS, registry.RUNTIMES])
def test_what_is_built_in_can_be_imported_and_has_a_label(parts):
    for name in parts.builtin:
        assert isinstance(parts.load("part", name), type)
        assert parts.label(name)


def test_a_part_of_a_package_or_of_a_file_stands_beside_those_built_in(package, tmp_path):
    package("round_tank = shed_of_tanks:Tank", group="npred.tanks")
    tanks = registry.Registry("tank", "npred.tanks", {"square": registry.Entry("npred.errors:ConfigError", "Square")})
    assert tanks.names() == ["square", "round_tank"]
    assert (tanks.label("square"), tanks.label("round_tank")) == ("Square", "round_tank")
    assert "shed_of_tanks" not in sys.modules
    assert tanks.load("tank", "round_tank").states == ("h",)
    assert tanks.load("tank", f"{tmp_path}/shed_of_tanks.py:Tank").states == ("h",)
    with pytest.raises(ConfigError, match=r"tank: expected square, round_tank, or a class .* mean square"):
        tanks.load("tank", "sqare")


CODE = b"class Law:\n    gain = 2.0\n\n    def rate(self):\n        return self.gain\n"


@pytest.mark.parametrize(
    ("old", "new", "same"),
    [
        (b"gain = 2.0", b"gain = (2.00)  # of the law", True),
        (b"    gain", b'    """A law."""\n\n    gain', True),
        (b"class", b"# coding: latin-1\n# \xe9\nclass", True),
        (b"2.0", b"2", False),
        (b"2.0", b"'# 2.0'", False),
        (b"self.gain", b"-self.gain", False),
        (b"return", b"pass", False),
    ],
)
def test_code_is_known_by_what_it_does(old, new, same):
    """Comments, docstrings and layout are no part of it."""
    assert old in CODE
    assert (registry.meaning(CODE) == registry.meaning(CODE.replace(old, new))) is same


@pytest.mark.parametrize("content", [b"no python", b"\0", b"(" * 10**4, b"\xff"])
def test_what_is_no_python_is_known_by_its_bytes(content):
    assert registry.meaning(content) == content


def models() -> list[type[BaseModel]]:
    """All models of the package."""
    for module in pkgutil.walk_packages(npred.__path__, "npred."):
        if module.name.startswith(
            ("npred.lab.config", "npred.lab.config.results", "npred.lab.store", "npred.plants.declaration")
        ):
            importlib.import_module(module.name)
    known, found = [BaseModel], []
    for model in known:
        known += model.__subclasses__()
        found += [model] if model.__module__.startswith("npred.") else []
    return found


def called(schema: Any) -> Iterator[Callable[..., Any]]:
    """The functions that a model's schema calls to validate and to serialise."""
    if isinstance(schema, dict):
        if callable(function := schema.get("function")):
            yield function
        schema = list(schema.values())
    if isinstance(schema, list | tuple):
        for part in schema:
            yield from called(part)


def readable(function: Callable[..., Any]) -> bool:
    """Whether the function is written in Python, with parameters that count: what inspect says of others has changed
    from one release of Python to the next, as of attrgetter in 3.12.3.
    """
    while isinstance(function, partial):
        function = function.func
    function = inspect.unwrap(function)  # what a cache holds says its signature in every release
    if not (inspect.isfunction(function) or inspect.ismethod(function)):
        return False
    kinds = [parameter.kind for parameter in inspect.signature(function).parameters.values()]
    return inspect.Parameter.VAR_POSITIONAL not in kinds


def test_models_call_functions_whose_parameters_can_be_counted():
    functions = {f for model in models() for f in called(model.__pydantic_core_schema__)}
    own = {f for f in functions if not getattr(f, "__module__", "").startswith("pydantic")}
    assert [f for f in own if not readable(f)] == []
    assert {"_number", "_null", "parse", "printable", "_listed"} <= {getattr(f, "__name__", "") for f in own}


@pytest.mark.parametrize("function", [BeforeValidator(str.strip), PlainSerializer(attrgetter("real"))])
def test_what_is_not_written_in_python_is_seen(function: Any):
    class Model(BaseModel):
        value: Annotated[Any, function]

    assert [readable(f) for f in called(Model.__pydantic_core_schema__)] == [False]
