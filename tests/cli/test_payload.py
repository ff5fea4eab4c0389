"""Which files of a result come in from elsewhere, and which are drawn again from them."""

from pathlib import Path

import fake_stages
import pytest
from conftest import Call, document, one_line
from store_samples import question

from npred.cli.store_admin import drawn
from npred.errors import StoreError
from npred.pipeline import STAGES
from npred.store import Manifest, Store, archive


def manifest(stage: str, *names: str, folder: Path) -> Manifest:
    folder.mkdir(parents=True)
    for name in ("result.json", *names):
        (folder / name).write_text("{}")
    return Manifest.describe(question(stage=stage), "p", folder)


@pytest.mark.parametrize(
    ("stage", "data", "figures"),
    [
        ("generate", ["data.h5", "data-00000.h5", "data-00012.h5"], []),
        ("train", ["model.safetensors", "model.json", "metrics.jsonl", "snapshot-107.safetensors"], []),
        ("evaluate", ["errors.h5", "figure1.h5", "coverage.h5"], ["figure1.svg", "figure1.png"]),
        ("bench", ["times.h5"], ["speed.svg", "speed.png", "bench.tex"]),
    ],
)
def test_arrays_come_in_and_figures_are_left_out(tmp_path: Path, stage: str, data: list[str], figures: list[str]):
    assert drawn(manifest(stage, *data, *figures, folder=tmp_path / "made")) == set(figures)


@pytest.mark.parametrize(
    ("stage", "name"),
    [
        ("generate", "page.html"), ("generate", "data.svg"), ("train", "figure1.svg"), ("train", "model.py"),
        ("evaluate", "report.html"), ("evaluate", "errors.h5.svgz"), ("evaluate", "Figure.SVG"), ("bench", "times.h5x"),
    ],
)  # fmt: skip
def test_a_name_that_the_stage_does_not_give_is_refused(tmp_path: Path, stage: str, name: str):
    with pytest.raises(StoreError, match=f"expected the files of a result of {stage}, got {name} among them"):
        drawn(manifest(stage, name, folder=tmp_path / "made"))


def test_a_page_and_a_stage_that_is_not_known_are_refused(tmp_path: Path):
    """A page may hold a script, and `npred run` would show it as a page of its own."""
    with pytest.raises(StoreError, match="expected a result, got a page; npred report makes it anew"):
        drawn(manifest("report", "report.html", folder=tmp_path / "page"))
    with pytest.raises(StoreError, match="got one of other; this npred has no such stage"):
        drawn(manifest("other", folder=tmp_path / "other"))


def test_a_figure_with_a_script_does_not_come_in(call: Call, tmp_path: Path):
    made = manifest("evaluate", "errors.h5", folder=tmp_path / "unused").question
    mine = Store(tmp_path / "mine")
    with mine.draft("evaluate", made.key) as folder:
        for name in ("result.json", "errors.h5", "figure1.svg"):
            (folder / name).write_text("{}" if name == "result.json" else "<svg><script>alert(1)</script></svg>")
        archive.export(mine.commit(folder, made, "p"), tmp_path / "a.tar")
    found = document(call("import-artifact", "a.tar", "--json"))
    assert {path.name for path in Path(found["folder"]).iterdir()} == {"result.json", "errors.h5", "manifest.json"}
    assert call("verify").exit_code == 0
    assert "already in the store" in call("import-artifact", "a.tar").stdout
    assert "npred report draws its figures here" in call("import-artifact", "a.tar", "--store", "new").stdout


def test_a_file_of_another_name_refuses_the_whole(call: Call, monkeypatch: pytest.MonkeyPatch):
    page = lambda job: {"bytes": (job.folder / "page.html").write_text("<script>alert(1)</script>")}  # noqa: E731
    monkeypatch.setitem(fake_stages.ANSWERS, "generate", page)
    call("generate", "tiny.toml")
    call("export-artifact", "generate", "-o", "a.tar")
    assert "got page.html among them" in one_line(call("import-artifact", "a.tar", "--store", "new"), 4)
    assert Store(Path("new")).artifacts() == []


@pytest.mark.slow
def test_every_file_that_a_stage_writes_is_known(reported, tmp_path: Path):
    """And what comes in of a result is enough to draw its figures again."""
    for name, outcome in reported[1].items():
        if name != "report":
            figures = drawn(outcome.artifact.manifest)
            assert bool(figures) == (name in STAGES and STAGES[name].draws)
