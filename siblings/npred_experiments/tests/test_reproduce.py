"""`npred reproduce`: names, rows, the store, and the commands that look at its results."""

import json
import re
import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from reproduced import small_loop
from typer.testing import CliRunner

from npred.base import registry
from npred.cli import app
from npred_experiments import EXPERIMENTS
from npred_experiments.experiment import Experiment, Measured, PublishedNumber, networks
from npred_experiments.loop_networks import LoopNetworks

CALLS: list[str] = []


def _measured() -> dict[str, Measured]:
    CALLS.append("measured")
    return {"error": Measured(0.1234567, 1e-9), "end": Measured(2.0, float("nan"))}


TINY = Experiment(
    "a tiny one", "nobody, nowhere", (PublishedNumber("error", "0.1235"), PublishedNumber("end", "")), _measured,
    networks("error", fno="0.2"),
)  # fmt: skip


LOOP = small_loop()
LEARNT = replace(
    TINY,
    train=LoopNetworks(
        {"as published": LOOP, "as meant": LOOP},
        {"fno": {"epochs": 2, "width": 4, "modes": 3, "layers": 1, "nodes": 5}},
    ),
)


@pytest.fixture(autouse=True)
def publish(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Iterator[Callable[..., None]]:
    """A package with experiments, a file each, that are the only ones: `tiny` and `unused`, or others by name."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(EXPERIMENTS, "group", "npred.tests")
    monkeypatch.syspath_prepend(tmp_path)
    CALLS.clear()

    def written(**experiments: str) -> None:
        info, package = Path("published-1.0.dist-info"), Path("published")
        for folder in (info, package):
            folder.mkdir(exist_ok=True)
        (info / "METADATA").write_text("Metadata-Version: 2.1\nName: published\nVersion: 1.0\n")
        entries = [f"{name} = published.{name}:{value}" for name, value in experiments.items()]
        (info / "entry_points.txt").write_text("\n".join(["[npred.tests]", *entries, ""]))
        for name, value in experiments.items():
            (package / f"{name}.py").write_text(f"from {__name__} import {value}\n\nfirst = 1\n")

    written(tiny="TINY", unused="TINY")
    yield written
    for name in [name for name in sys.modules if name.partition(".")[0] == "published"]:
        del sys.modules[name]


def _call(*arguments: str, code: int = 0) -> Any:
    done = CliRunner().invoke(app, list(arguments))
    assert done.exit_code == code, done.output
    return done


def test_the_document_has_these_keys_and_no_others():
    answer = json.loads(_call("reproduce", "tiny", "--json").stdout)
    assert answer == {
        "experiments": [
            {
                "name": "tiny",
                "rows": [
                    {"predictor": "numerical", "metric": "error", "published": 0.1235, "as_published": 0.1234567,
                     "as_meant": 1e-9},
                    {"predictor": "numerical", "metric": "end", "published": None, "as_published": 2.0,
                     "as_meant": None},
                    {"predictor": "fno", "metric": "error", "published": 0.2, "as_published": None,
                     "as_meant": None},
                ],
                "trained": [],
                "times": [],
            }
        ]
    }  # fmt: skip


def test_numbers_have_the_digits_that_are_printed():
    lines = _call("reproduce", "tiny", "--numerical").stdout.splitlines()
    assert [line.split() for line in lines[1:]] == [
        ["tiny", "numerical", "error", "0.1235", "0.1235", "1.00e-09"],
        ["tiny", "numerical", "end", "–", "2.000000", "–"],
    ]


def test_a_result_is_measured_once_per_code():
    for _ in range(2):
        _call("reproduce", "tiny")
    own = Path("published/tiny.py")
    own.write_text(own.read_text().replace("first = 1", "# a comment\nfirst = (1)  # another\n"))
    assert _call("why", "tiny").stdout == "reproduce tiny: up to date\n"
    assert CALLS == ["measured"]
    own.write_text(own.read_text().replace("(1)", "2"))
    tiny, unused = _call("why", "reproduce").stdout.splitlines()
    assert re.fullmatch("reproduce tiny: code.published.tiny: [0-9a-f]{12} -> [0-9a-f]{12}", tiny)
    assert unused == "reproduce unused: no result yet"
    states = [row["state"] for row in json.loads(_call("why", "reproduce", "--json").stdout)["stages"]]
    assert states == ["stale", "missing"]
    _call("reproduce", "tiny")
    _call("reproduce", "tiny", "--force")
    assert CALLS == ["measured"] * 3


def test_show_ls_verify_and_gc_know_such_results():
    _call("reproduce", "tiny")
    Path("p.toml").write_text('name = "p"\nplant = "scalar"\n')
    assert "0.1235" in _call("show", "reproduce").stdout
    assert "tiny" in _call("ls").stdout
    _call("verify")
    assert _call("gc", "p.toml", "--yes").stdout == "nothing to delete\n"
    Path("published/tiny.py").write_text("second = 2\n")
    assert "deleted 1" in _call("gc", "p.toml", "--yes").stdout


def test_gc_imports_no_experiment():
    _call("reproduce", "tiny")
    broken = Path("published/broken.py")
    broken.write_text("raise ValueError\n")
    Path("published-1.0.dist-info/entry_points.txt").write_text("[npred.tests]\nbroken = published.broken:X\n")
    Path("p.toml").write_text('name = "p"\nplant = "scalar"\n')
    registry._entry_points.cache_clear()
    assert "1 to delete" in _call("gc", "p.toml").stdout


def test_an_edit_changes_no_other_experiment(publish: Callable[..., None]):
    _call("reproduce")
    Path("published/unused.py").write_text(f"from {__name__} import TINY\n\nfirst = 2\n")
    states = [row["state"] for row in json.loads(_call("why", "reproduce", "--json").stdout)["stages"]]
    assert states == ["fresh", "stale"]


def test_gc_without_experiments_needs_none(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(EXPERIMENTS, "group", "npred.nobody")
    Path("p.toml").write_text('name = "p"\nplant = "scalar"\n')
    assert _call("gc", "p.toml").stdout == "nothing to delete\n"


def test_a_registered_experiment_that_is_not_there_is_one_line(publish: Callable[..., None]):
    _call("reproduce", "tiny")
    Path("published/tiny.py").unlink()
    sys.modules.pop("published.tiny")
    assert len(_call("reproduce", "tiny", code=2).stderr.splitlines()) == 1
    assert "rows" in _call("show", "reproduce").stdout


def test_a_list_runs_nothing_and_another_name_is_one_line():
    assert "nobody, nowhere" in _call("reproduce", "tiny", "--list").stdout
    done = _call("reproduce", "tinny", code=2)
    assert "tiny" in done.output and len(done.output.splitlines()) == 1
    assert CALLS == []


def test_a_network_is_trained_once_and_an_interrupted_run_goes_on(publish: Callable[..., None]):
    publish(tiny="LEARNT")
    answer = json.loads(_call("reproduce", "tiny", "--json").stdout)["experiments"][0]
    assert [row["predictor"] for row in answer["rows"]] == ["numerical", "numerical", "fno"]
    assert answer["rows"][-1]["as_published"] == pytest.approx(1.0, abs=0.5)
    assert answer["rows"][-1]["as_meant"] == answer["rows"][-1]["as_published"]
    assert [(each["network"], each["loop"], each["epochs"]) for each in answer["trained"]] == [
        ("fno", "as published", 2),
        ("fno", "as meant", 2),
    ]
    assert _call("reproduce", "tiny", "-v").stderr.count("from the store") == 2
    assert "tiny_fno: up to date" in _call("why", "tiny").stdout
    assert _call("reproduce", "tiny", "--numerical").stdout.count("fno") == 0
    Path("p.toml").write_text('name = "p"\nplant = "scalar"\n')
    assert _call("gc", "p.toml", "--yes").stdout == "nothing to delete\n"


def test_the_page_is_html_or_markdown_and_of_all_experiments_in_the_store():
    assert _call("reproduce", "tiny", "-o", "tiny.md").stderr.endswith("page: tiny.md\n")
    assert "| numerical | error | 0.1235 | 0.1235 | 1.00e−09 |" in Path("tiny.md").read_text()
    _call("reproduce", "tiny", "-o", "tiny.html")
    assert Path("tiny.html").read_text().startswith("<!doctype html>")
    assert "no/folder" in _call("reproduce", "tiny", "-o", "no/folder/tiny.html", code=2).output
    _call("reproduce", "tiny")
    assert not Path("artifacts/reproduce.html").exists()
    _call("reproduce")
    assert "tiny" in Path("artifacts/reproduce.html").read_text()
