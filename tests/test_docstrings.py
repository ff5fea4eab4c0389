"""Sections of public docstrings, in NumPy's style: all parameters are there, and each error that is raised exists."""

import inspect
import pydoc
import re
from typing import Any

import pytest

import npred
from npred.base import errors
from npred.loop.controller import Controller

LAWS = [getattr(npred.laws, name) for name in npred.laws.__all__]
OBSERVERS = [npred.observers.EKF, npred.observers.Luenberger]
PUBLIC = [*(getattr(npred, name) for name in npred.__all__), *LAWS, *OBSERVERS, Controller.step]
FIELDS = (npred.Loop, npred.Measurement, npred.Timing, npred.SafetyFilter, npred.Watchdog)  # their fields have comments
HEAD = re.compile(r"^(\w+)\n-+\n", re.MULTILINE)
ROW = re.compile(r"^(\S.*)\n    \S", re.MULTILINE)


def sections(thing: Any) -> dict[str, str]:
    """The text of each section by its heading, as a reader sees it."""
    _, *parts = HEAD.split(inspect.cleandoc(thing.__doc__))
    return dict(zip(parts[::2], parts[1::2], strict=True))


def parameters(thing: Any) -> list[str]:
    return [name for name in inspect.signature(thing).parameters if name != "self"]


@pytest.mark.parametrize("thing", [t for t in PUBLIC if t in FIELDS], ids=lambda thing: thing.__qualname__)
def test_each_field_has_its_meaning_before_or_behind_it(thing):
    text = "\n".join(inspect.getsource(kind) for kind in thing.__mro__[:-1])
    for name in parameters(thing):
        assert re.search(rf"^    {name}: .*#: \S|^    #: \S.*\n    {name}: ", text, re.MULTILINE), name


@pytest.mark.parametrize("thing", [t for t in PUBLIC if t not in FIELDS], ids=lambda thing: thing.__qualname__)
def test_a_public_docstring_has_its_sections(thing):
    rows = {head: ROW.findall(text) for head, text in sections(thing).items()}
    assert [row.split(" : ")[0].strip("*") for row in rows["Parameters"]] == parameters(thing)
    assert all(": " not in row.replace(" : ", "") for row in rows["Parameters"])
    assert isinstance(thing, type) or len(rows["Returns"]) == 1
    raised = rows.get("Raises", []) if thing is npred.laws.Law else rows["Raises"]
    assert all(issubclass(getattr(errors, name), errors.NpredError) for name in raised)
    assert len(set(raised)) == len(raised)


def test_help_says_type_unit_default_and_meaning():
    text = pydoc.plain(pydoc.render_doc(npred.simulate))
    assert "dt : float, in the plant's unit of time, optional\n        Control step; U is held over it." in text
    assert "X0 : array (..., n), in the plant's units\n        States at t = 0." in text
    assert "Returns\n    -------\n    Trajectories\n        Closed loops" in text
