"""What of a foreign error is shown, and what of a package that is not installed."""

import sys
from pathlib import Path

import pytest

from npred.base.errors import MissingError, first_line, imported, installed, required


@pytest.mark.parametrize(
    ("error", "line"),
    [
        (ValueError("first\nsecond"), "first"),
        (RuntimeError("\n  after an empty line\n"), "after an empty line"),
        (KeyError(), "KeyError"),
        (OSError(" \n"), "OSError"),
    ],
)
def test_the_first_line_says_something(error: Exception, line: str):
    assert first_line(error) == line


def test_a_text_without_a_word_says_what_is_said_otherwise():
    assert first_line("\n \n", "no word") == "no word" and first_line("\n a \nb", "no word") == "a "


@pytest.fixture
def module(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    """A module that imports torch first, in a process that lacks it."""
    (tmp_path / "takes_torch.py").write_text("import torch\nimport nowhere_to_be_found\n")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setitem(sys.modules, "torch", None)  # type: ignore[arg-type]
    return "takes_torch"


def test_a_module_without_its_package_names_the_extra(module):
    with pytest.raises(
        MissingError, match=r"^a: expected the package torch, found none; pip install 'npred\[train\]'$"
    ):
        imported("a", module)
    with pytest.raises(MissingError, match=r"pip install 'npred\[onnx\]'$"):
        imported("a", module, "onnx")
    with pytest.raises(
        MissingError, match=r"^b: expected the package PyTorch, found none; pip install 'npred\[gpu\]'$"
    ):
        required("b", "torch", "PyTorch", "gpu")
    assert not installed("torch") and installed("numpy") and not installed("nowhere_to_be_found")


def test_a_module_that_lacks_what_no_extra_has_fails_as_it_is(module, monkeypatch):
    monkeypatch.setitem(sys.modules, "torch", sys)
    with pytest.raises(ModuleNotFoundError, match="nowhere_to_be_found"):
        imported("a", module)


def test_a_notebook_shows_the_lines_of_the_caller_and_not_those_of_npred(capsys: pytest.CaptureFixture):
    interactiveshell = pytest.importorskip("IPython.core.interactiveshell")
    shell = interactiveshell.InteractiveShell()
    shell.run_cell(
        "import npred\ndef mine():\n    return npred.generate('smoke', settings={'generate.sample': 2})\nmine()"
    )
    shown = "".join(capsys.readouterr())
    assert "in mine" in shown and "ConfigError: smoke: generate.sample: unknown key" in shown
    assert "runs.py" not in shown and "interactiveshell" not in shown and len(shown.splitlines()) < 8
    shell.run_cell("1 / 0")
    assert "ZeroDivisionError" in capsys.readouterr().out  # as usual
