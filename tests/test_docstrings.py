"""Sections of public docstrings: all parameters are in the table, all rows are used, what is raised exists."""

import inspect
import pydoc
import re
from typing import Any

import pytest

import npred
from npred.base import docstrings, errors
from npred.loop.controller import Controller

LAWS = [getattr(npred.laws, name) for name in npred.laws.__all__]
OBSERVERS = [npred.observers.EKF, npred.observers.Luenberger]
PUBLIC = [*(getattr(npred, name) for name in npred.__all__), *LAWS, *OBSERVERS, docstrings.documented(Controller.step)]
METHODS = [npred.Predictor.predict, npred.DelayAdaptation.phi, npred.DelayLaw.rate]
HEAD = re.compile(r"^(\w+)\n-+\n", re.MULTILINE)
ROW = re.compile(r"^(\S.*)\n    \S", re.MULTILINE)


def sections(thing: Any) -> dict[str, str]:
    """The text of each section by its heading, as a reader sees it."""
    _, *parts = HEAD.split(thing.__doc__)
    return dict(zip(parts[::2], parts[1::2], strict=True))


def parameters(thing: Any) -> list[str]:
    return [name for name in inspect.signature(thing).parameters if name != "self"]


@pytest.mark.parametrize("thing", PUBLIC, ids=lambda thing: thing.__qualname__)
def test_a_public_docstring_has_its_sections(thing):
    rows = {head: ROW.findall(text) for head, text in sections(thing).items()}
    assert [row.split(" : ")[0].strip("*") for row in rows["Parameters"]] == parameters(thing)
    assert all(": " not in row.replace(" : ", "") for row in rows["Parameters"])
    assert isinstance(thing, type) or len(rows["Returns"]) == 1
    raised = rows.get("Raises", []) if thing is npred.laws.Law else rows["Raises"]
    assert all(issubclass(getattr(errors, name), errors.NpredError) for name in raised)
    assert len(set(raised)) == len(raised)


def test_every_row_of_the_table_is_used():
    tables = dict(docstrings.table())
    common, used = set(tables.pop("any")), set()
    for thing in PUBLIC + METHODS:
        particular = set(tables.pop(thing.__qualname__, {}))
        assert particular <= set(parameters(thing))
        used |= set(parameters(thing)) - particular
    assert tables == {} and common == used


def test_help_says_type_unit_default_and_meaning():
    text = pydoc.plain(pydoc.render_doc(npred.simulate))
    assert "dt : float, in the plant's unit of time, default 0.005\n        Control step; U is held over it." in text
    assert "X0 : array (..., n), in the plant's units\n        States at t = 0." in text
    assert "Returns\n    -------\n    Trajectories\n        Closed loops" in text


def test_the_last_paragraphs_become_sections():
    def step(dt: float, *, seed: int = 3, **settings: Any) -> float:
        """A step.

        More of it.
        Returns what
        comes.
        Raises ConfigError for a step of 0;
        DivergedError for one that is too long.
        """
        return dt

    step.__qualname__ = "evaluate"  # whose settings the table has
    assert (
        docstrings.documented(step).__doc__
        == """A step.

More of it.

Parameters
----------
dt : float, in the plant's unit of time
    Control step; U is held over it.
seed : int, default 3
    Seed of the random numbers.
**settings : dict
    Keys of the pipeline, as those of --set, with their values: {"train.deeponet.epochs": 20}.

Returns
-------
float
    What comes.

Raises
------
ConfigError
    For a step of 0.
DivergedError
    For one that is too long."""
    )


def test_a_parameter_that_the_table_lacks_leaves_the_section_out():
    def other(dt: float, unheard_of: int) -> None:
        """Another one."""

    assert docstrings.documented(other).__doc__ == "Another one."
