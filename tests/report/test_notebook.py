"""The live view of a notebook: one output, updated in place, and no line of what it shows."""

import sys
from types import ModuleType, SimpleNamespace
from typing import Any

import pytest

from npred.lab.report.terminal import live_view


@pytest.fixture
def outputs(monkeypatch: pytest.MonkeyPatch) -> list[dict[str, str]]:
    """The states of the one output that a cell has."""
    shown: list[dict[str, str]] = []

    def update(bundle: dict[str, str], raw: bool) -> None:
        shown.append(bundle)

    def display(bundle: dict[str, str], raw: bool, display_id: bool) -> Any:
        assert not shown, "a second output"
        shown.append(bundle)
        return SimpleNamespace(update=update)

    fake, inner = ModuleType("IPython"), ModuleType("IPython.display")
    fake.get_ipython = lambda: SimpleNamespace(kernel=object())  # type: ignore[attr-defined]
    inner.display = display  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "IPython", fake)
    monkeypatch.setitem(sys.modules, "IPython.display", inner)
    return shown


def test_the_view_is_one_output_that_ends_with_the_stages(outputs: list[dict[str, str]], capsys: Any):
    console = live_view.NotebookConsole()
    with console.watch("tank", ["generate"]):
        console.doing("generate", "compiling")
        console.note("generate: running")
        with console.bar("generate", 8, "rollouts") as bar:
            bar.advance(8)
        console.finish("generate", "run", 3.0)
    assert "generate" in outputs[0]["text/plain"]
    assert "✓ generate" in outputs[-1]["text/plain"]
    assert "<pre" in outputs[-1]["text/html"]
    assert capsys.readouterr() == ("", "")


def test_a_warning_stands_below(outputs: list[dict[str, str]], capsys: Any):
    live_view.NotebookConsole().warn("few samples")
    assert capsys.readouterr().err == "warning: few samples\n"


def test_only_a_kernel_is_a_notebook(outputs: list[dict[str, str]], monkeypatch: pytest.MonkeyPatch):
    assert live_view.is_notebook()
    monkeypatch.setattr(sys.modules["IPython"], "get_ipython", lambda: None)
    assert not live_view.is_notebook()
