"""A grid of pipelines: what cells share is made once, a cell that fails stops nobody, and all of it is one table."""

import csv
import json
import signal
from collections import Counter
from collections.abc import Callable
from concurrent.futures import BrokenExecutor, Future
from pathlib import Path
from typing import Any

import fake_stages
import pytest
from conftest import TANK, Call, document, one_line
from jobs import SMALL
from stopped_runs import stopped_in

from npred.errors import DivergedError
from npred.parallel import executors
from npred.parallel.executors import Here
from npred.pipeline import STAGES, Planner, Runner, nodes
from npred.store import Store
from npred.sweep import Progress, Sweep, cells
from npred.sweep.sweep_table import rows
from npred.sweep.task import Task, alone
from npred.terminal.console import Console

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
    assert "--to: expected one of generate, train" in one_line(sweep("--to", "nowhere"), 2)


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


def test_processes_make_the_same_bytes(tmp_path: Path):
    """Real stages: two processes, each a cell at a time, and one pipeline after the other."""
    path = tmp_path / "p.toml"
    lines = [
        f"[{name}]\n" + "\n".join(f"{k} = {json.dumps(v)}" for k, v in SMALL[name].items()) for name in ("generate",)
    ]
    network = "[train]\nmodels = ['fno']\n[train.fno]\nepochs = 1\nbatch = 64\nwidth = 4\nmodes = 3\nlayers = 1\n"
    path.write_text("plant = 'scalar'\n" + "\n".join(lines) + "\n" + network)
    grid, console = cells(path, ["train.fno.epochs=1,2"]), Console(quiet=True)
    with executors.opened("local", 2) as executor:
        found = Sweep(Store(tmp_path / "a"), "cpu", console, 2, executor).run(grid, ["train"])
    assert [progress.error for progress in found] == [""] * 2
    for cell in grid:
        Runner(Planner(cell.config, Store(tmp_path / "b"), "cpu"), console, 1).run(nodes(cell.config, ["train"]))
    digests = [{a.manifest.key: a.manifest.digest for a in Store(tmp_path / name).artifacts()} for name in "ab"]
    assert digests[0] == digests[1]
    assert len(digests[0]) == 3


@pytest.mark.parametrize("change", ["plant", "packages"])
def test_a_process_with_another_plant_or_package_makes_nothing(tmp_path: Path, monkeypatch, change: str):
    """What a worker reads at the plant's path may have changed, and what is installed there may be another version."""
    tank = tmp_path / "tank.py"
    tank.write_text(TANK)
    path = tmp_path / "p.toml"
    path.write_text("plant = 'tank.py:Tank'\n[generate]\nrollouts = 2\nsamples = 4\n")
    (cell,) = cells(path, [])
    store, (node,) = Store(tmp_path / "s"), nodes(cell.config, ["generate"])
    asked = Planner(cell.config, store, "cpu").question(node, {})
    task = Task.of(cell.config, store, "cpu", node, asked, {})
    monkeypatch.chdir("/")
    if change == "plant":
        tank.write_text(TANK.replace("u.q - x.h", "u.q - 2 * x.h"))
    else:
        task = task._replace(packages=task.packages | {"numpy": "0.1"})
    made = alone(task)
    assert made.artifact is None and store.artifacts() == []
    assert made.error == (
        "generate: expected the same plant, delay law and packages on every worker, got others; install them there"
    )


class Killed(Here):
    """An executor whose processes do not live."""

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        future: Future[Any] = Future()
        future.set_exception(BrokenExecutor("a process was killed"))
        return future


def test_a_process_that_dies_fails_its_cells_only(fakes: Path, pipeline: Path, tmp_path: Path):
    grid = cells(pipeline, ["seed=0:2"])
    found = Sweep(Store(tmp_path / "s"), "cpu", Console(quiet=True), 1, Killed()).run(grid, ["train"])
    assert [progress.error for progress in found] == ["BrokenExecutor: a process was killed"] * 2
    assert runs(fakes) == {"generate:": 2}


def test_a_row_has_errors_radius_and_the_fastest_runtime(
    pipeline: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    found = {"mse": 0.1, "eps_sup": 0.2, "eps_kappa": 0.3, "radius": {"median": 1.0, "worst": None, "converged": 0.5}}
    times = [
        ("fno", 0.01, 1, 9.0),
        ("fno", 0.01, 1, 5.0),
        ("fno", 0.01, 64, 1.0),
        ("fno", 0.005, 1, 2.0),
        ("rk4", 0.01, 1, 3.0),
    ]
    bench = [{"predictor": p, "dx": dx, "batch": b, "median_us": us, "matches": None} for p, dx, b, us in times]
    answers = {
        "evaluate": lambda job: {"models": {"numerical": found, "no_adaptation": found, "fno": found, "fno@7": found}},
        "bench": lambda job: {"rows": bench},
    }
    table = dict(STAGES)
    fake_stages.install(table)
    for name, stage in table.items():
        monkeypatch.setitem(STAGES, name, stage)
    for name, answer in answers.items():
        monkeypatch.setitem(fake_stages.ANSWERS, name, answer)
    grid = cells(pipeline, ["train.models=['fno']", "seed=3,4"])
    (progress, _) = Sweep(Store(tmp_path / "s"), "cpu", Console(quiet=True), 1).run(grid, ["evaluate", "bench"])
    assert isinstance(progress, Progress)
    (fno, snapshot) = rows(progress)
    numbers = {"mse": 0.1, "eps_sup": 0.2, "eps_kappa": 0.3, "radius": 1.0, "radius_worst": None, "converged": 0.5}
    assert fno == {"seed": "3", "model": "fno", **numbers, "latency_us": 5.0, "artifact": fno["artifact"]}
    assert fno["artifact"].startswith("bench/")
    assert (snapshot["model"], snapshot["latency_us"]) == ("fno@7", None)
