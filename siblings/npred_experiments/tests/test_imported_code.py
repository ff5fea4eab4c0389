"""The code behind a part of a package: its module and what it imports there, read and not run."""

from pathlib import Path

import pytest

from npred_experiments.planner import imported_code

PACKAGE = {
    "__init__.py": "raise ValueError('run')",
    "first.py": "import numpy\nfrom laboratory import shared, NUMBER\n\ndef late():\n    from .rooms.inner import f",
    "other.py": "from laboratory import shared",
    "shared.py": "",
    "unused.py": "import laboratory.first",
    "rooms/__init__.py": "",
    "rooms/inner.py": "from .. import other\nfrom . import *\nimport laboratory.first",
    "broken.py": "def (",
}


@pytest.fixture(autouse=True)
def laboratory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    for name, text in PACKAGE.items():
        path = tmp_path / "laboratory" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    (tmp_path / "one_file.py").write_text("import laboratory.first")
    monkeypatch.syspath_prepend(tmp_path)
    return tmp_path / "laboratory"


@pytest.mark.parametrize(
    ("module", "expected"),
    [
        ("first", ["", "first", "other", "rooms", "rooms.inner", "shared"]),
        ("other", ["", "other", "shared"]),
        ("rooms", ["", "rooms"]),
        ("broken", ["", "broken"]),
        ("absent", []),
    ],
)
def test_the_modules_are_those_that_the_module_imports_at_last(module: str, expected: list[str]):
    assert list(imported_code(f"laboratory.{module}")) == [f"laboratory.{name}".rstrip(".") for name in expected]


def test_a_package_of_one_file_has_no_other_module():
    assert list(imported_code("one_file")) == ["one_file"]


@pytest.mark.parametrize("module", ["nobody_has_this", "nobody_has_this.below", "math"])
def test_what_has_no_text_has_no_code(module: str):
    assert imported_code(module) == {}


def test_a_comment_changes_no_digest(laboratory: Path):
    before = imported_code("laboratory.first")["laboratory.shared"].sha256
    (laboratory / "shared.py").write_text("# a comment\n")
    assert imported_code("laboratory.first")["laboratory.shared"].sha256 == before
    (laboratory / "shared.py").write_text("x = 1\n")
    assert imported_code("laboratory.first")["laboratory.shared"].sha256 != before
