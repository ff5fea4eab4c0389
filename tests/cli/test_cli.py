"""`npred` as people and programs meet it: JSON, exit codes, one line for what goes wrong, interruption."""

import json
import re
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import fake_stages
import pytest
import typer.main
from conftest import HERE, TANK, Call, document, one_line, process_environment
from result_samples import TRAINED
from stopped_runs import Process, stopped_in
from typer.testing import CliRunner, Result

import npred
from npred.base.registry import STAGES, declared_stage
from npred.cli import app, inspect, main
from npred.lab.config.results import Evaluated
from npred.lab.stages.report import UNFINISHED
from npred.lab.store import Question, ResultInput, Store


def actions(result: Result) -> dict[str, str]:
    return {row.get("model", row["stage"]): row["action"] for row in document(result)["stages"]}


def test_run_answers_in_one_document(call: Call):
    found = document(call("run", "tiny.toml", "--json", "--jobs", "3"))
    rows = found["stages"]
    assert [row["stage"] for row in rows] == ["generate", "train", "train", "evaluate", "bench", "report"]
    assert [row.get("model") for row in rows] == [None, "deeponet", "fno", None, None, None]
    assert {row["action"] for row in rows} == {"run"}
    assert all(re.fullmatch("[0-9a-f]{64}", row["key"]) and row["seconds"] >= 0 for row in rows)
    assert found["result"]["rows"] == []
    assert (found["result"]["hardware"]["device"], found["result"]["hardware"]["threads"]) == ("cpu", 3)
    assert set(found["result"]["models"]) == {"generate", "deeponet", "fno"}
    assert set(actions(call("run", "tiny.toml", "--json")).values()) == {"hit"}


def test_a_stage_answers_with_its_own_result(call: Call):
    assert document(call("generate", "tiny.toml", "--json"))["result"] == {"rollouts": 50}
    trained = document(call("train", "tiny.toml", "--json", "--model", "fno"))
    assert trained["result"] == {"fno": TRAINED | {"mse": None, "epochs": 100}}
    assert [row["stage"] for row in trained["stages"]] == ["generate", "train"]
    evaluated = document(call("evaluate", "tiny.toml", "--json"))["result"]
    assert set(evaluated) == set(Evaluated.model_fields) - {"scenarios"}  # of a pipeline that has some


def test_people_get_the_summary_and_its_name(call: Call):
    result = call("bench", "tiny.toml")
    assert result.exit_code == 0
    assert result.stdout.startswith("summary of {'rows'")
    assert re.search(r"^bench: bench/[0-9a-f]{12}$", result.stdout, re.MULTILINE)
    assert "bench: running (no result yet)" in result.stderr


def test_wide_adds_the_table_of_stages_the_details_and_the_folder(call: Call):
    result = call("bench", "tiny.toml", "--wide")
    assert re.search(r"^train fno +[0-9a-f]{12} +run +[0-9.]+ +no result yet$", result.stdout, re.MULTILINE)
    folder = re.search(r"^bench: (.+)$", result.stdout, re.MULTILINE)
    assert folder is not None
    assert (Path(folder[1]) / "manifest.json").is_file()
    assert "details of {'rows'" in result.stdout


def test_a_run_ends_with_the_sentences_one_table_and_the_page(call: Call):
    end = call("run", "tiny.toml").stdout.splitlines()
    assert [line for line in end[:6] if line] == ["Errors.", "Loops.", "Times."]
    assert end[6].split("  ") == ["predictor", "ε sup", "worst radius", "converged", "µs per call"]
    assert [line.split()[0] for line in end[7:10]] == ["DeepONet", "FNO", "generate"]
    assert end[7].split()[1:] == ["0.5", "0.25", "3", "of", "4", "–"]
    assert end[10:] == ["", "report: artifacts/tiny.html"]
    wide = call("run", "tiny.toml", "--wide").stdout
    assert "up to date" in wide and "details of" in wide and wide.endswith("report: artifacts/tiny.html\n")


def test_a_page_that_is_complete_stays_until_there_is_another(call: Call, monkeypatch: pytest.MonkeyPatch):
    page, seen, bench = Path("artifacts/tiny.html"), [], fake_stages.ANSWERS["bench"]
    monkeypatch.setitem(fake_stages.ANSWERS, "bench", lambda job: seen.append(page.read_text()) or bench(job))
    for seed in ("1", "2"):
        call("run", "tiny.toml", "--set", f"seed={seed}")
    assert seen == [UNFINISHED, "complete"] and page.read_text() == "complete"


def test_a_run_leaves_its_log_in_the_store(call: Call):
    call("run", "tiny.toml", "-q")
    (log,) = Path("artifacts/logs").iterdir()
    assert re.fullmatch(r"\d{4}-\d\d-\d\d-\d{6}-tiny.log", log.name)
    text = log.read_text()
    for words in ("npred ", "generate: running (no result yet)", "report: done after "):
        assert words in text
    assert call("status", "tiny.toml").exit_code == 0 and len(list(log.parent.iterdir())) == 1


def test_the_log_has_how_it_ended_with_the_traceback(call: Call, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setitem(fake_stages.ANSWERS, "generate", lambda job: 1 / 0)
    call("run", "tiny.toml")
    (log,) = Path("artifacts/logs").iterdir()
    assert "Traceback" in log.read_text() and "error: ZeroDivisionError" in log.read_text().splitlines()[-1]


def test_set_reruns_what_depends_on_it(call: Call):
    call("run", "tiny.toml")
    result = call("run", "tiny.toml", "--json", "--set", "train.deeponet.epochs=40", "--set", "bench.calls=7")
    assert actions(result) == {"generate": "hit", "deeponet": "run", "fno": "hit", "evaluate": "run", "bench": "run",
                               "report": "run"}  # fmt: skip


@pytest.mark.parametrize("stage", ["generate", "train", "evaluate", "bench", "run"])
@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("2 - x.h", "2 * x.h - 1", r"kappa \(tank.py:8\) does not stabilise without delay: eigenvalues 1 at"),
        ("u.q - x.h", "u.q - M.log(x.h - 1)", r"plant Tank: f \(tank.py:5\) is not finite at h = .*; shrink box"),
        ("u.q - x.h", "u.q, x.h", r"plant Tank: f \(tank.py:5\) expected to return 1 value, got 2; return"),
        ("(x.h - 1)", "(u.q - 1)", r"plant Tank: V failed at tank.py:12: NameError: .*; only f knows the inputs"),
        ("def V", "def _V", r"plant Tank: expected V\(x, t, p, M\).*, found none; npred plants check offers one"),
    ],
)
def test_what_does_not_fit_the_plant_is_told_before_anything_runs(call: Call, fakes: Path, stage, old, new, words):
    assert TANK.count(old) >= 1
    Path("tank.py").write_text(TANK.replace(old, new))
    line = one_line(call(stage, "tiny.toml", "--set", 'plant="tank.py:Tank"'), 2)
    assert re.search(words, line), line
    assert fakes.read_text() == "" and not list(Path().glob("artifacts/*/*/manifest.json"))


def test_a_start_of_another_length_is_told_before_anything_runs(call: Call, fakes: Path):
    line = one_line(call("run", "tiny.toml", "--set", "evaluate.X0=[1.0, 2.0]"), 2)
    assert line.startswith("error: evaluate.X0: expected one number per state (X), got [1.0, 2.0]")
    assert fakes.read_text() == ""


def test_a_dry_run_runs_nothing_and_writes_nothing(call: Call, fakes: Path):
    result = call("run", "tiny.toml", "--dry-run", "--json")
    assert set(actions(result).values()) == {"run"}
    assert document(result)["result"] is None
    assert fakes.read_text() == ""
    assert not Path("artifacts").exists()


def test_a_plan_says_how_long_each_stage_took_the_last_time(call: Call, fakes: Path):
    call("train", "tiny.toml", "--set", "seed=7")
    ran = {row["stage"] + row.get("model", ""): row for row in document(call("run", "tiny.toml", "--json"))["stages"]}
    planned = document(call("run", "tiny.toml", "--dry-run", "--json", "--set", "seed=9"))["stages"]
    for row in planned:
        seconds = ran[row["stage"] + row.get("model", "")]["seconds"]
        assert row["action"] == "run" and 0 <= row["seconds"] <= seconds + 0.001  # the store has written it since
    header, first, *_ = call("run", "tiny.toml", "--dry-run").stdout.splitlines()
    assert header.split()[:6] == ["stage", "key", "action", "s", "last", "time"]
    assert re.search(r"generate +[0-9a-f]{12} +hit +\d+\.\d +up to date", first)


def test_force_reruns_the_stage_and_not_what_it_needs(call: Call):
    call("train", "tiny.toml")
    result = call("train", "tiny.toml", "--force", "--json")
    assert actions(result) == {"generate": "hit", "deeponet": "run", "fno": "run"}


def test_status_says_stale_once(call: Call):
    call("run", "tiny.toml")
    lines = call("status", "tiny.toml", "--set", "train.deeponet.epochs=40").stdout.splitlines()
    (late,) = (line for line in lines if line.startswith("evaluate"))
    assert late.split()[2:4] == ["stale", "deeponet"]


def test_status_and_its_gate(call: Call):
    def states(*arguments: str, code: int = 0) -> dict[str, str]:
        rows = document(call("status", "tiny.toml", "--json", *arguments), code)["stages"]
        return {row.get("model", row["stage"]): row["state"] for row in rows}

    assert set(states("--check", code=3).values()) == {"missing"}
    call("run", "tiny.toml")
    assert set(states("--check").values()) == {"fresh"}
    late = states("--check", "--set", "train.fno.epochs=2", code=3)
    assert late == {"generate": "fresh", "deeponet": "fresh", "fno": "stale", "evaluate": "stale", "bench": "stale",
                    "report": "stale"}  # fmt: skip
    data = Store(Path("artifacts")).find("fno").folder / "data.bin"
    data.write_bytes(b"")
    assert str(data) in one_line(call("status", "tiny.toml", "--check"), 4)


def test_why_names_the_key_before_and_after(call: Call):
    call("run", "tiny.toml")
    assert call("why", "train", "tiny.toml").stdout == "train deeponet: up to date\ntrain fno: up to date\n"
    changed = ("--set", "train.deeponet.epochs=40")
    assert call("why", "deeponet", "tiny.toml", *changed).stdout == "train deeponet: train.deeponet.epochs: 30 -> 40\n"
    (row,) = document(call("why", "evaluate", "tiny.toml", "--json", *changed))["stages"]
    assert row["reason"] == "stale: deeponet runs first (train.deeponet.epochs: 30 -> 40)"


def test_show_ls_and_diff(call: Call):
    call("run", "tiny.toml", "--jobs", "1")  # one after the other: the order of two threads is not fixed
    call("train", "tiny.toml", "--set", "train.fno.epochs=2")
    listed = document(call("ls", "--json"))["artifacts"]
    assert [entry["model"] or entry["stage"] for entry in listed] == [
        *("generate", "deeponet", "fno", "evaluate", "bench", "report", "fno")
    ]
    old, new = listed[2]["key"], listed[6]["key"]
    assert len(call("ls").stdout.splitlines()) == 8
    shown = document(call("show", f"train/{old[:8]}", "--json"))
    assert shown["result"] == TRAINED | {"mse": None, "epochs": 100}
    assert shown["manifest"]["question"]["config"]["train"]["fno"]["epochs"] == 100
    assert document(call("show", "--json"))["manifest"]["key"] == new
    text = call("show", "fno").stdout
    for words in ("data.bin", "train.fno.epochs = 2", "from generate", "summary of"):
        assert words in text
    found = document(call("diff", old[:8], new[:8], "--json"))
    assert (found["question"], found["result"]) == (["train.fno.epochs: 100 -> 2"], ["epochs: 100 -> 2"])
    assert call("diff", old[:8], new[:8]).stdout == "train.fno.epochs: 100 -> 2\nresult.epochs: 100 -> 2\n"
    assert "no difference" in call("diff", old[:8], old[:8]).stdout


def test_nothing_in_a_result_moves_the_cursor(call: Call):
    """A result that somebody else sent may hold any text."""
    store, strange = Store(Path("artifacts")), "\x1b[2J\x9b1m\n"
    asked = Question(stage="generate", version=1, model=None, config={strange: strange}, inputs={})
    with store.draft("generate", asked.key) as folder:
        (folder / "result.json").write_text(json.dumps({strange: strange}))
        store.commit(folder, asked, "p")
    for command in ("show", "ls"):
        done = call(command)
        assert done.exit_code == 0
        assert [line for line in done.stdout.splitlines() if not line.isprintable()] == []
    assert r"\x1b[2J\x9b1m\n" in call("show").stdout


def test_a_result_of_a_stage_that_was_taken_out_is_shown_and_collected_as_any_other(call: Call):
    call("train", "tiny.toml")
    store = Store(Path("artifacts"))
    there = len(store.artifacts())
    sources = {name: ResultInput(key=a.manifest.key, digest=a.manifest.digest)
               for name, a in (("generate", store.find("generate")), ("fno", store.find("fno")))}  # fmt: skip
    asked = Question(stage="refine", version=2, model="fno", config={"refine": {"epochs": 20}}, inputs=sources)
    with store.draft("refine", asked.key) as folder:
        (folder / "result.json").write_text('{"epochs": 20}')
        store.commit(folder, asked, "tiny")
    assert document(call("ls", "--json"))["artifacts"][-1]["stage"] == "refine"
    assert "epochs = 20" in call("show", f"refine/{asked.key[:8]}").stdout
    for command in (["status", "tiny.toml"], ["why", "train", "tiny.toml"], ["verify"], ["train", "tiny.toml"]):
        assert call(*command).exit_code == 0
    (row,) = document(call("gc", "tiny.toml", "--yes", "--json"))["plan"]
    assert row["path"].endswith(asked.key) and len(store.artifacts()) == there
    done = call("refine", "tiny.toml")
    assert (done.exit_code, "No such command 'refine'" in done.stderr) == (2, True)


def test_a_summary_moves_no_cursor():
    assert inspect._summary("report", {"summary": ["\x1b[2J"], "bytes": 1}) == r"\x1b[2J"


def test_a_result_of_another_form_is_shown_by_its_keys():
    text = inspect._summary("report", {"summary": ["Fine."], "bytes": 1, "pages": {"count": 2}})
    assert text.splitlines() == ['summary = ["Fine."]', "bytes = 1", "pages.count = 2"]


def test_gc_plans_first_and_keeps_what_a_pipeline_needs(call: Call):
    call("run", "tiny.toml")
    call("train", "tiny.toml", "--set", "train.fno.epochs=2")
    stale = Store(Path("artifacts")).find("fno").folder
    left, kept = Path(f"artifacts/.tmp/train-{stale.name}"), Path(f"artifacts/.scratch/train-{'0' * 64}")
    for folder in (left, kept):
        folder.mkdir(parents=True)
    planned = document(call("gc", "tiny.toml", "--json"))
    assert {Path(row["path"]) for row in planned["plan"]} == {stale, left, kept}
    assert (planned["deleted"], stale.exists()) == ([], True)
    assert "3 to delete" in call("gc", "tiny.toml").stdout
    assert len(document(call("gc", "tiny.toml", "--yes", "--json"))["deleted"]) == 3
    assert set(actions(call("run", "tiny.toml", "--json")).values()) == {"hit"}
    assert call("gc", "tiny.toml").stdout == "nothing to delete\n"


def test_gc_keeps_the_checkpoint_that_a_pipeline_goes_on_from(call: Call, monkeypatch: pytest.MonkeyPatch):
    with monkeypatch.context() as patch:
        patch.setitem(fake_stages.ANSWERS, "generate", lambda job: 1 / 0)
        call("generate", "tiny.toml")
    assert call("gc", "tiny.toml").stdout == "nothing to delete\n"
    assert call("gc").stdout == "nothing to delete\n"  # the store knows the pipeline


def test_doctor_and_plants(call: Call):
    facts = document(call("doctor", "--json"))
    assert facts["packages"]["torch"]
    assert (facts["store"]["artifacts"], facts["store"]["writable"]) == (0, True)
    assert all(part in call("doctor").stdout for part in ("cores:", "writable yes", "broken none, leftovers none"))
    found = {plant["name"]: plant for plant in document(call("plants", "--json"))["plants"]}
    assert found["activator_repressor"]["states"] == ["x1", "x2"]
    assert "scalar" in call("plants").stdout


def test_the_store_may_be_elsewhere(call: Call, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    call("generate", "tiny.toml", "--store", "here")
    assert Path("here/generate").is_dir()
    monkeypatch.setenv("NPRED_STORE", str(tmp_path / "there"))
    call("generate", "tiny.toml")
    assert (tmp_path / "there" / "generate").is_dir()


def test_the_executor_may_be_set_for_good_and_is_in_no_key(call: Call, monkeypatch: pytest.MonkeyPatch):
    call("generate", "tiny.toml")
    monkeypatch.setenv("NPRED_EXECUTOR", "ray")
    assert one_line(call("generate", "tiny.toml"), 2).startswith("error: --executor: expected local or")
    assert actions(call("generate", "tiny.toml", "--executor", "local", "--json")) == {"generate": "hit"}


@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        (["run", "none.toml"], 2, "none.toml: expected a pipeline file"),
        (["run", "tiny.toml", "--set", "generate.dtt=1"], 2, "generate.dtt: unknown key"),
        (["run", "tiny.toml", "--set", "bench.dx=[-0.1]"], 2, "bench.dx[0]: expected a number above 0, got -0.1"),
        (["run", "tiny.toml", "--set", "plant=nonesuch"], 2, "nonesuch"),
        (["run", "tiny.toml", "--set", "plant=broken.py:Tank"], 2, "broken.py"),
        (["run", "tiny.toml", "--set", "parameters.zz=1"], 2, "zz"),
        (["train", "tiny.toml", "--model", "cnn"], 2, "--model: expected one of deeponet, fno, got 'cnn'"),
        (["run", "tiny.toml", "--device", "gpu"], 2, "--device: expected auto, cpu, cuda or cuda:N, got 'gpu'"),
        (["run", "tiny.toml", "--device", "cuda:99"], 5, "got 'cuda:99'"),
        (["run", "tiny.toml", "--executor", "ray"], 2, "--executor: expected local or dask:ADDRESS, got 'ray'"),
        (["why", "tuning", "tiny.toml"], 2, "got 'tuning'"),
        (["show"], 2, "empty store"),
        (["show", "train/0123"], 2, "expected one artifact"),
        (["show", "generte"], 2, "generte: expected one artifact of artifacts, got none; did you mean generate?"),
        (["why", "generte", "tiny.toml"], 2, "got 'generte'; did you mean generate?"),
        (
            ["why", "tiny.toml"],
            2,
            "why: expected a stage or a network, got a pipeline; write npred why train tiny.toml",
        ),
        (
            ["run", "tiny.toml", "--set", "generate.D=-1"],
            2,
            "generate.D: expected a list or a number above 0, got -1",
        ),
        (["identify", "log.csv", "--plant", "scalar", "--input", "q"], 2, "expected --input NAME=COLUMN, got 'q'"),
        (["diff", "0123", "4567"], 2, "expected one artifact"),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, list) else None,
)
def test_bad_input_is_one_line_and_its_exit_code(call: Call, arguments: list[str], code: int, words: str):
    Path("broken.py").write_text("class Tank:\n    states = (\n")
    line = one_line(call(*arguments), code)
    assert line.startswith("error: ")
    assert words in line


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["nonsense"], "No such command 'nonsense'"),
        (["runn"], r"No such command 'runn'. Did you mean 'run'"),
        (["plants", "chek"], "No such command 'chek'. Did you mean 'check'"),
        (["run", "--nonsense"], "No such option: --nonsense"),
        (["run", "--stoer", "x"], r"No such option: --stoer.*--store"),
        (["run", "--jobs", "many"], "Invalid value for '--jobs': .*integer"),
        (["run", "--jobs=0"], "Invalid value for '--jobs': .*(range|greater)"),
        (["rig", "--seconds", "sixty"], "Invalid value for '--seconds': .*(number|float)"),
        (["run", "a.toml", "b.toml"], "(?i:got unexpected extra argument)"),
        (["evaluate", "--set"], "Option '--set' requires an argument"),
        (["evaluate", "--json=3"], "Option '--json' does not take a value"),
        (["why"], "Missing argument '(?i:stage)'"),
        (["plants", "check"], "Missing argument 'PLANT'"),
    ],
)
def test_bad_usage_is_said_by_typer_with_exit_code_2(call: Call, arguments: list[str], words: str):
    result = call(*arguments)
    assert (result.exit_code, result.stdout) == (2, "")
    assert re.search(words, result.stderr.splitlines()[-1])


def test_a_failure_is_a_document_too(call: Call, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch):
    result = call("status", "nothing.toml", "--json")
    error = json.loads(result.stdout)["error"]
    assert result.exit_code == 2 and error["kind"] == "ConfigError" and error["exit_code"] == 2
    assert result.stderr == f"error: {error['message']}\n" and call("status", "nothing.toml").stdout == ""
    gate = call("status", "--check", "--json")  # which has its answer on stdout already
    assert gate.exit_code == 3 and set(json.loads(gate.stdout)) == {"stages"}
    monkeypatch.setattr(inspect, "nodes", lambda *_: 1 / 0)
    broken = call("status", "--json")
    assert broken.exit_code == 1 and json.loads(broken.stdout)["error"]["kind"] == "ZeroDivisionError"
    capsys.readouterr()
    monkeypatch.setattr(sys, "argv", ["npred", "status", "--nonsense", "--json"])
    with pytest.raises(SystemExit, match="2"):
        main()
    said = capsys.readouterr()
    error = json.loads(said.out)["error"]
    assert error["kind"] == "UsageError" and "--nonsense" in error["message"] and error["message"] in said.err


@pytest.mark.parametrize(
    ("command", "unused"),
    [
        ("generate", "--tensorboard"),
        ("identify", "--tensorboard --wide --dry-run --executor"),
        ("status", "--jobs"),
        ("why", "--jobs"),
        ("tune", "--dry-run --executor"),
        ("rig", "--jobs --device"),
    ],
)
def test_a_command_has_no_flag_that_it_does_not_use(call: Call, command: str, unused: str):
    for flag in unused.split():
        result = call(command, flag, "1")
        assert result.exit_code == 2 and f"No such option: {flag}" in result.stderr
    assert "--tensorboard" in call("run", "-h").stdout


@pytest.mark.parametrize("arguments", [["run", "--help"], ["run", "-h"], ["help", "run"]])
def test_help_has_three_names_and_a_flag_no_type(call: Call, arguments: list[str]):
    result = call(*arguments)
    assert result.exit_code == 0
    assert re.search(r"Usage: \S+ run ", result.stdout)
    assert re.search(r"--json +Print one JSON", result.stdout)
    assert re.search(r"-h, --help +Show", result.stdout)
    assert "bool" not in result.stdout.lower()


def test_help_of_all_of_a_group_and_of_nothing(call: Call):
    assert call("help").stdout == call("--help").stdout
    assert call("help", "plants", "check").stdout == call("plants", "check", "-h").stdout
    assert call("help", "nonsense").exit_code == 2 and "No such command 'nonsense'" in call("help", "nonsense").stderr


def test_the_version_is_the_packages(call: Call):
    assert call("--version").stdout == f"npred {npred.__version__}\n"


def test_a_pipeline_has_a_name_and_a_folder_a_default(call: Call, monkeypatch: pytest.MonkeyPatch):
    assert (
        actions(call("run", "--dry-run", "--json")).keys()
        == actions(call("run", "tiny.toml", "--dry-run", "--json")).keys()
    )
    call("run", "smoke", "-q")
    assert Path("artifacts/smoke.html").is_file()
    late = call("status", "smoke", "--check", "--set", "seed=7")
    assert late.exit_code == 3 and "smoke.toml" in late.stderr
    monkeypatch.setenv("NPRED_PIPELINE", "smoke")
    assert set(actions(call("run", "--json")).values()) == {"hit"}
    Path("other.toml").touch()
    monkeypatch.delenv("NPRED_PIPELINE")
    assert "got other.toml, tiny.toml; name a pipeline" in one_line(call("run"), 2)


def test_diff_across_stages_says_so(call: Call):
    call("train", "tiny.toml", "--jobs", "1")
    first = call("diff", "generate", "fno").stdout.splitlines()[0]
    assert first == "these are results of different stages: generate and train fno"
    assert document(call("diff", "generate", "fno", "--json"))["stages"] == ["generate", "train fno"]
    assert "different stages" not in call("diff", "fno", "fno").stdout


def test_no_command_asks_for_help(call: Call):
    result = call()
    assert result.exit_code == 2
    assert "Usage: npred" in result.stdout + result.stderr and "error:" not in result.stderr


def test_a_flipped_byte_is_exit_code_4_and_nothing_is_overwritten(call: Call):
    call("run", "tiny.toml")
    data = Store(Path("artifacts")).find("generate").folder / "data.bin"
    damaged = bytes([data.read_bytes()[0] ^ 1]) + data.read_bytes()[1:]
    data.write_bytes(damaged)
    for arguments in (
        ["run", "tiny.toml"],
        ["train", "tiny.toml"],
        ["show", "generate"],
        ["run", "tiny.toml", "--json"],
    ):
        assert str(data) in one_line(call(*arguments), 4)
        assert data.read_bytes() == damaged


def test_a_failure_that_nobody_foresaw_is_one_line_and_v_shows_where(call: Call, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setitem(fake_stages.ANSWERS, "generate", lambda job: 1 / 0)
    last = call("run", "tiny.toml").stderr.splitlines()[-1]
    assert re.fullmatch(
        r"error: ZeroDivisionError: division by zero; the traceback is in artifacts/logs/\S+-tiny\.log", last
    )
    result = call("run", "tiny.toml", "-v")
    assert result.exit_code == 1
    assert "Traceback" in result.stderr


def test_quiet_says_nothing_but_the_answer(call: Call):
    assert call("run", "tiny.toml", "-q").stderr == ""


@pytest.mark.parametrize("stage", ["generate", "train", "evaluate", "bench"])
def test_kill_9_leaves_no_half_result_and_the_next_run_goes_on(npred: Any, pipeline: Path, stage: str):
    with stopped_in(stage, pipeline.parent, "run", "tiny.toml", "--jobs", "1") as running:
        running.end(signal.SIGKILL)
    store = Store(pipeline.parent / "artifacts")
    finished = [artifact.verify().manifest.question.stage for artifact in store.artifacts()]
    assert stage not in finished
    assert store.survey()[1] == []
    assert sorted(path.parent.name for path in store.leftovers()) == [".scratch", ".tmp"]
    done = npred("run", "tiny.toml", "--json", "--jobs", "1", FAKE_LOG=str(pipeline.parent / "log"))
    assert done.returncode == 0, done.stderr
    hits = [row["stage"] for row in json.loads(done.stdout)["stages"] if row["action"] == "hit"]
    assert hits == sorted(finished, key=["generate", "train", "evaluate", "bench"].index)
    log = (pipeline.parent / "log").read_text().splitlines()
    assert [line for line in log if line.endswith("resumed")] == [line for line in log if line.startswith(stage)][1:2]
    assert store.leftovers() == []


@pytest.mark.skipif(not hasattr(signal, "SIGHUP"), reason="this system sends no signals to a process")
@pytest.mark.parametrize(("name", "code"), [("SIGINT", 130), ("SIGTERM", 143), ("SIGHUP", 129)])
def test_an_interrupted_run_keeps_its_checkpoint(pipeline: Path, name: str, code: int):
    with stopped_in("train", pipeline.parent, "train", "tiny.toml") as running:
        assert running.end(getattr(signal, name)) == code
        out, err = running.process.communicate()
    assert out == ""
    assert "Traceback" not in err
    assert [line[:18] for line in err.splitlines() if "error" in line] == ["error: interrupted"]
    assert [path.parent.name for path in Store(pipeline.parent / "artifacts").leftovers()] == [".scratch"]


def test_two_runs_at_once_make_one_result(pipeline: Path):
    with stopped_in("generate", pipeline.parent, "generate", "tiny.toml", "--json") as first:
        second = Process(pipeline.parent, "generate", "tiny.toml", "--json")
        assert second.process.stderr is not None
        message = second.process.stderr.readline()
        assert f"is being made by process {first.process.pid} on " in message
        first.let_go()
        rows = [json.loads(p.process.communicate(timeout=30)[0])["stages"][0] for p in (first, second)]
    assert [row["action"] for row in rows] == ["run", "hit"]
    assert rows[0]["key"] == rows[1]["key"]
    assert (pipeline.parent / "log").read_text().splitlines() == ["generate::new"]


def test_a_reader_that_leaves_early_is_no_traceback(pipeline: Path):
    command = f"{sys.executable} {HERE / 'fake_stages.py'} run tiny.toml -q --json | true"
    done = subprocess.run(
        ["bash", "-c", command], cwd=pipeline.parent, env=process_environment(), capture_output=True, text=True
    )
    assert done.stderr == ""


def test_no_answer_of_a_stage_moves_the_cursor(call: Call, monkeypatch: pytest.MonkeyPatch):
    """What a run, an evaluation or a failure says may come from a plant or an artifact that somebody else wrote."""
    strange = "\x1b[2J\x9b1m\u202e[red]"
    answers = {"evaluate": {"models": {strange: fake_stages.MODEL}}, "report": {"summary": [strange], "bytes": 0}}
    for name, answer in answers.items():
        before = fake_stages.ANSWERS[name]
        monkeypatch.setitem(fake_stages.ANSWERS, name, lambda job, a=answer, b=before: b(job) | a)
    run, evaluated = call("run", "tiny.toml", "-v"), call("evaluate", "tiny.toml")
    assert (run.exit_code, evaluated.exit_code) == (0, 0)
    monkeypatch.setitem(fake_stages.ANSWERS, "generate", lambda job: {}[strange])
    failed = call("generate", "tiny.toml", "--force")
    assert failed.exit_code == 1 and r"\u202e[red]" in failed.stderr
    for done in (run, evaluated, failed):
        assert [line for line in (done.stdout + done.stderr).split("\n") if not line.isprintable()] == []
    assert r"\x1b[2J\x9b1m\u202e[red]" in run.stdout


@pytest.mark.parametrize("name", STAGES)
def test_every_stage_is_a_command_with_its_line_of_the_table(call: Call, name: str):
    result = call(name, "--help")
    words = " ".join(result.stdout.replace("│", " ").split())
    assert result.exit_code == 0 and declared_stage(name).help in words and "--force" in words


@pytest.mark.parametrize(("text", "said"), [("\nlost", "lost"), ("", "no message"), (" \n ", "no message")])
def test_an_error_that_nobody_foresaw_has_words(call: Call, monkeypatch: pytest.MonkeyPatch, text: str, said: str):
    def fail(job: object) -> None:
        raise RuntimeError(text)

    monkeypatch.setitem(fake_stages.ANSWERS, "generate", fail)
    assert one_line(call("generate", "tiny.toml", "-q"), 1).startswith(f"error: RuntimeError: {said}; ")


def test_the_pipeline_that_is_taken_is_named_and_a_plan_has_no_seconds(call: Call):
    plan = call("run", "--dry-run")
    assert plan.exit_code == 0 and plan.stderr.startswith("pipeline tiny.toml")
    assert plan.stdout.splitlines()[0].split() == ["stage", "key", "action", "reason"] and " 0.0 " not in plan.stdout
    assert call("run", "tiny.toml", "--dry-run").stderr == "" == call("run", "--dry-run", "-q").stderr


def commands(command: Any, *path: str) -> Iterator[tuple[tuple[str, ...], Any]]:
    """All commands as typer has them, by their words."""
    yield path, command
    for name, child in getattr(command, "commands", {}).items():
        yield from commands(child, *path, name)


@pytest.mark.parametrize(("path", "command"), [*commands(typer.main.get_command(app))])
def test_help_says_all_that_is_declared_brackets_too(path: tuple[str, ...], command: Any):
    """rich would take a word in square brackets for markup, and leave it out."""
    shown = CliRunner().invoke(app, [*path, "--help"], env={"COLUMNS": "1000", "TERMINAL_WIDTH": "1000"}).stdout
    shown = "".join(shown.split())  # a line may end within a word, behind its hyphen
    texts = [one.help for one in (command, *command.params, *getattr(command, "commands", {}).values()) if one.help]
    assert [text for text in texts if "".join(text.split()) not in shown] == []
    assert path != ("tune",) or "ontheloopsof[evaluate];" in shown
