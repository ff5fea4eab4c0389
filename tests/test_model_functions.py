"""pydantic's models: every interpreter and every pydantic must read the signatures of what they call."""

import importlib
import inspect
import pkgutil
from collections.abc import Callable, Iterator
from functools import partial
from operator import attrgetter
from typing import Annotated, Any

import pytest
from pydantic import BaseModel, BeforeValidator, PlainSerializer

import npred


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
