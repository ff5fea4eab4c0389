"""A grid of pipelines: what cells share is made once, a cell that fails stops nobody, and all of it is one table."""

import csv
import json
import signal
from collections import Counter
from pathlib import Path
from typing import Any

import fake_stages
import pytest
from conftest import Call, document, one_line
from stopped_runs import stopped_in

from npred.base.errors import DivergedError
from npred.lab.store import Store

GRID = ("--set", "train.fno.width=4,8", "--set", "seed=0:2")


@pytest.fixture
def sweep(call: Call) -> Call:
    """`npred sweep tiny.toml` with fake stages, which are in this process alone."""
    return lambda *arguments: call("sweep", "tiny.toml", "--jobs", "1", *arguments)


def runs(log: Path) -> Counter[str]:
    return Counter(line.rpartition(":")[0] for line in log.read_text().splitlines())


def test_what_cells_share_is_made_once(sweep: Call, fakes: Path):
    found = document(sweep(*GRID, "--json"))
    assert (found["total"], found["done"]) == (4, 4)
    assert [cell["set"] for cell in found["cells"]] == [
        {"train.fno.width": w, "seed": s} for w in ("4", "8") for s in ("0", "1")
    ]
    assert runs(fakes) == {"generate:": 2, "train:deeponet": 2, "train:fno": 4, "evaluate:": 2}
    again = document(sweep(*GRID, "--json"))
    assert {stage["action"] for cell in again["cells"] for stage in cell["stages"]} == {"hit"}
    assert again["rows"] == found["rows"]
    assert len(fakes.read_text().splitlines()) == 10


def test_a_cell_is_what_run_makes_of_it(sweep: Call, call: Call):
    sweep(*GRID)
    for width, seed in ((4, 0), (8, 1)):
        made = document(
            call("evaluate", "tiny.toml", "--json", "--set", f"train.fno.width={width}", "--set", f"seed={seed}")
        )
        assert {row["action"] for row in made["stages"]} == {"hit"}


def test_the_table_for_people_and_for_programs(sweep: Call):
    shown = sweep(*GRID)
    assert shown.exit_code == 0, shown.output
    assert shown.stdout.splitlines()[0].split()[:5] == ["row", "train.fno.width", "seed", "model", "mse"]
    files = [f"sweep-tiny/{name}" for name in ("table.csv", "front.svg", "front.png")]
    assert shown.stdout.splitlines()[-3:] == files
    assert "sweep: 4/4 cells in" in shown.stderr
    with Path("sweep-tiny/table.csv").open() as file:
        table = list(csv.DictReader(file))
    assert [row["seed"] for row in table if row["model"] == "fno"] == ["0", "1", "0", "1"]
    assert sweep(*GRID, "--csv", "-o", "there").stdout == Path("there/table.csv").read_text()


def test_ls_shows_what_sets_the_results_of_a_sweep_apart(sweep: Call, call: Call):
    sweep(*GRID)
    listed = document(call("ls", "--show", "train.fno.width", "--show", "seed", "--json"))["artifacts"]
    shown = [entry["settings"] for entry in listed if entry["stage"] == "evaluate"]
    assert {row["seed"] for row in shown} == {"0", "1"}
    assert {row["train.fno.width"] for row in shown} <= {"4", "8"}  # of the networks that were evaluated
    assert {entry["settings"]["train.fno.width"] for entry in listed if entry["stage"] == "generate"} == {None}
    assert call("ls", "--show", "seed").stdout.splitlines()[0].endswith("seed")


def test_where_a_sweep_ends(sweep: Call, fakes: Path):
    found = document(sweep(*GRID, "--to", "train", "--json"))
    assert runs(fakes).keys() == {"generate:", "train:deeponet", "train:fno"}
    keys = {s["model"]: f"train/{s['key'][:12]}" for s in found["cells"][0]["stages"] if s["stage"] == "train"}
    assert {row["model"]: row["artifact"] for row in found["rows"][:2]} == keys
    assert document(sweep(*GRID, "--to", "generate", "--json"))["rows"] == []
    sweep(*GRID, "--to", "bench")
    assert runs(fakes)["bench:"] > 0
    assert "--to: expected one of identify, generate, train" in one_line(sweep("--to", "nowhere"), 2)


def test_without_a_row_it_says_what_is_done(sweep: Call):
    assert sweep("--to", "generate", "--set", "seed=0:2").stdout.strip() == "done: 2 cells; rows come from train on"


def test_a_file_in_the_place_of_the_folder_is_told_before_anything_runs(sweep: Call, fakes: Path):
    Path("taken").write_text("")
    line = one_line(sweep("--set", "seed=0:2", "-o", "taken"), 2)
    assert "--output: expected a folder for the table, taken is a file" in line and fakes.read_text() == ""


def test_the_bench_stage_comes_last_and_the_data_first(sweep: Call, fakes: Path):
    sweep(*GRID, "--to", "bench")
    order = [line.partition(":")[0] for line in fakes.read_text().splitlines()]
    assert order[:2] == ["generate"] * 2
    assert [name for name in order if name != "bench"] + ["bench"] * order.count("bench") == order


def test_a_cell_that_fails_does_not_stop_the_others(sweep: Call, fakes: Path, monkeypatch: pytest.MonkeyPatch):
    real = fake_stages.ANSWERS["train"]

    def train(job: Any) -> dict[str, Any]:
        if job.model == "fno" and job.config.train.fno.width == 8:
            raise DivergedError("no finite loss") if job.config.seed else ZeroDivisionError("by zero")
        return real(job)

    monkeypatch.setitem(fake_stages.ANSWERS, "train", train)
    found = sweep(*GRID, "--json")
    assert found.stderr.splitlines()[-1] == (
        "error: sweep: 2 of 4 cells failed: train.fno.width=8 seed=0: train fno: ZeroDivisionError: by zero; "
        "and 1 more, as --json says"
    )
    assert "sweep: 4/4 cells" in found.stderr
    listed = document(found, 1)
    assert (listed["done"], len({row["artifact"] for row in listed["rows"]})) == (2, 2)
    assert [cell["error"] for cell in listed["cells"]][2:] == [
        "train fno: ZeroDivisionError: by zero",
        "no finite loss",
    ]
    monkeypatch.setitem(fake_stages.ANSWERS, "train", real)
    assert document(sweep(*GRID, "--json"))["done"] == 4


def test_a_corrupt_result_fails_its_cells_only(sweep: Call):
    sweep(*GRID)
    rows = document(sweep(*GRID, "--json"))["cells"]
    key = next(stage["key"] for stage in rows[0]["stages"] if stage["stage"] == "generate")
    (Path("artifacts/generate") / key / "data.bin").write_bytes(b"")
    found = document(sweep(*GRID, "--json"), 1)
    assert [cell["state"] for cell in found["cells"]] == ["failed", "done", "failed", "done"]


def test_a_dry_run_says_what_would_run(sweep: Call, fakes: Path):
    assert sweep(*GRID, "--dry-run").stdout.splitlines()[0].startswith("train.fno.width=4 seed=0  generate: run")
    assert len(document(sweep(*GRID, "--dry-run", "--json"))["cells"]) == 4
    assert fakes.read_text() == ""
    assert not Path("artifacts").exists()


def test_a_bad_cell_is_told_before_anything_runs(sweep: Call, fakes: Path):
    assert "got -1" in one_line(sweep("--set", "train.fno.width=4,-1"), 2)
    assert "nonesuch" in one_line(sweep("--set", "plant=scalar,nonesuch"), 2)
    assert fakes.read_text() == ""


def test_a_sweep_that_was_killed_goes_on(npred: Any, pipeline: Path):
    with stopped_in("train", pipeline.parent, "sweep", "tiny.toml", "--jobs", "1", *GRID) as running:
        running.end(signal.SIGKILL)
    done = npred("sweep", "tiny.toml", "--jobs", "1", "--json", *GRID, FAKE_LOG=str(pipeline.parent / "log"))
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["done"] == 4
    counts = runs(pipeline.parent / "log")
    assert counts["generate:"] == 2  # those made before are hits
    assert Store(pipeline.parent / "artifacts").leftovers() == []


def test_the_folders_of_two_pipelines_of_one_name_are_two(sweep: Call, call: Call):
    Path("other").mkdir()
    Path("other/tiny.toml").write_text(Path("tiny.toml").read_text())
    sweep("--to", "train")
    first = Path("sweep-tiny/table.csv").read_text()
    second = call("sweep", "other/tiny.toml", "--jobs", "1", "--to", "train", "--set", "seed=0:2")
    assert second.exit_code == 0, second.output
    assert "sweep-tiny belongs to tiny.toml; the one of other/tiny.toml is sweep-tiny-other" in second.stderr
    assert Path("sweep-tiny/table.csv").read_text() == first
    assert len(Path("sweep-tiny-other/table.csv").read_text().splitlines()) == 5
    assert sweep("--to", "train").stdout.splitlines()[-1] == "sweep-tiny/table.csv"
    Path("tiny.toml").rename("grid.toml")  # files are named after the file, not after the `name` in it
    assert call("sweep", "grid.toml", "--to", "train", "--set", "seed=0:2").stdout.endswith("sweep-grid/table.csv\n")
