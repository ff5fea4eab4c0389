"""`npred gc`: what no pipeline needs goes, and what stays when parts of the store are corrupt."""

import errno
import os
from datetime import UTC, datetime
from pathlib import Path

import pytest
from conftest import Call, document, one_line
from store_samples import made_at

from npred.base import devices
from npred.base.errors import NpredError
from npred.lab.store import MARKER, Store

NEVER_MIND = ("run", "tiny.toml", "--jobs", "1")


def planned(call: Call, *arguments: str) -> set[Path]:
    return {Path(row["path"]) for row in document(call("gc", "tiny.toml", "--json", *arguments))["plan"]}


@pytest.fixture
def stale(call: Call) -> list[Path]:
    """Folders of three results that tiny.toml does not need."""
    call(*NEVER_MIND)
    folders = []
    for epochs in (2, 3, 4):
        call("train", "tiny.toml", "--model", "fno", "--set", f"train.fno.epochs={epochs}")
        folders.append(Store(Path("artifacts")).find("fno").folder)
    return folders


def test_what_another_machine_timed_is_needed(call: Call, monkeypatch: pytest.MonkeyPatch):
    """The machine is part of bench's question: one with other cores would ask for other times."""
    call("bench", "tiny.toml", "--jobs", "1")
    monkeypatch.setattr(devices, "hardware", lambda device: {"cpu": "another", "cores": 64, "device": device})
    assert planned(call) == set()
    call("bench", "tiny.toml", "--jobs", "1", "--set", "bench.calls=7")
    assert [path.parent.name for path in planned(call)] == ["bench"]


def test_a_report_draws_the_times_of_another_machine_and_says_so(call: Call, monkeypatch: pytest.MonkeyPatch):
    call(*NEVER_MIND)
    cores = devices.cores()
    monkeypatch.setattr(devices, "hardware", lambda device: {"cpu": "another", "cores": 64, "device": device})
    done = call("report", "tiny.toml", "--json", "--jobs", "1")
    assert {row["action"] for row in document(done)["stages"]} == {"hit"}
    assert "bench is of another machine: hardware.cpu: " in done.stderr
    assert f"hardware.cores: {cores} -> 64; npred bench runs it here" in done.stderr
    planned_here = document(call("bench", "tiny.toml", "--json", "--dry-run"))["stages"]
    assert [row["action"] for row in planned_here if row["stage"] == "bench"] == ["run"]
    other = document(call("report", "tiny.toml", "--json", "--dry-run", "--set", "bench.calls=7"))["stages"]
    assert [row["action"] for row in other if row["stage"] == "bench"] == ["run"]


def test_what_no_pipeline_needs_goes(call: Call, stale: list[Path]):
    assert planned(call) == set(stale)
    assert len(document(call("gc", "tiny.toml", "--json", "--yes"))["deleted"]) == 3
    assert not any(folder.exists() for folder in stale) and planned(call) == set()


def test_what_a_kept_result_was_made_from_is_kept(call: Call):
    """Other samples are the same data here, which the networks were not made from a second time."""
    call("generate", "tiny.toml", "--set", "generate.samples=400")
    data = Store(Path("artifacts")).find("generate").folder
    call("train", "tiny.toml", "--set", "generate.samples=400")
    call(*NEVER_MIND)
    assert planned(call) == set()
    call("generate", "tiny.toml", "--set", "generate.samples=300")
    other = Store(Path("artifacts")).find("generate").folder
    assert planned(call) == {other} and data != other


def test_the_cells_of_a_sweep_stay_when_it_is_named(call: Call, stale: list[Path]):
    assert planned(call, "--set", "train.fno.epochs=2,3") == {stale[2]}
    assert planned(call, "--set", "train.fno.epochs=2:5") == set()


@pytest.mark.parametrize("damage", ["manifest", "all"])
def test_what_depends_on_a_corrupt_result_stays(call: Call, stale: list[Path], damage: str):
    folder = Store(Path("artifacts")).find("generate").folder
    for path in [folder / "manifest.json"] if damage == "manifest" else sorted(folder.iterdir()):
        path.unlink()
    assert planned(call) == {folder, *stale}
    assert len(document(call("gc", "tiny.toml", "--json", "--yes"))["deleted"]) == 4
    rows = document(call(*NEVER_MIND, "--json"))["stages"]
    assert [row["action"] for row in rows] == ["run", *["hit"] * 5]


def test_a_checkpoint_whose_key_cannot_be_known_stays(call: Call):
    call(*NEVER_MIND)
    Path(f"artifacts/.scratch/train-{'0' * 64}").mkdir(parents=True)
    assert len(planned(call)) == 1
    (Store(Path("artifacts")).find("generate").folder / "manifest.json").write_text("")
    assert {path.parent.name for path in planned(call)} == {"generate"}


def test_what_a_run_at_work_has_just_removed_is_nothing(call: Call, stale: list[Path], monkeypatch):
    gone = Path("artifacts/.tmp/train-0")
    monkeypatch.setattr(Store, "leftovers", lambda store: [gone])
    assert planned(call) == set(stale)


def test_a_result_that_was_being_replaced_when_the_store_was_read_stays(call: Call, stale: list[Path], monkeypatch):
    """A forced rerun: one folder is seen without its manifest, and another is made anew after the plan."""
    torn, renewed, old = stale
    survey = Store.survey

    def between(store: Store):
        sound, _ = survey(store)
        made_at(renewed, datetime.now(UTC))
        return [artifact for artifact in sound if artifact.folder != torn], [torn]

    monkeypatch.setattr(Store, "survey", between)
    done = document(call("gc", "tiny.toml", "--json", "--yes"))
    assert {Path(row["path"]) for row in done["plan"]} == set(stale)
    assert done["deleted"] == [str(old)]
    assert [folder.exists() for folder in stale] == [True, True, False]


@pytest.fixture
def elsewhere(call: Call, tmp_path: Path) -> Path:
    """A pipeline file of another folder whose results, with another seed, are in the store; gc names tiny.toml only."""
    file = tmp_path / "elsewhere" / "mine.toml"
    file.parent.mkdir()
    file.write_text("seed = 5\n" + Path("tiny.toml").read_text())
    call("run", file, "--jobs", "1")
    call(*NEVER_MIND)
    return file


def test_what_a_pipeline_file_elsewhere_asks_for_stays_while_it_exists_and_asks_for_it(call: Call, elsewhere: Path):
    assert planned(call) == set()
    text = elsewhere.read_text()
    elsewhere.write_text(text.replace("seed = 5", "seed = 6"))
    assert len(planned(call)) == 6
    elsewhere.write_text(text)
    assert planned(call) == set()
    elsewhere.unlink()
    assert len(planned(call)) == 6


def test_gc_needs_no_names_where_the_store_knows_its_pipelines(
    call: Call, elsewhere: Path, tmp_path: Path, monkeypatch
):
    store = str(Path("artifacts").absolute())
    (tmp_path / "empty").mkdir()
    monkeypatch.chdir(tmp_path / "empty")
    assert "to delete" in call("gc", "--store", store).output
    unknown = one_line(call("gc", "--store", str(tmp_path / "none")), 2)
    assert "none that this store was run with; name them" in unknown


def test_what_an_override_asks_for_is_not_what_the_file_asks_for(call: Call, elsewhere: Path):
    call("generate", elsewhere, "--set", "seed=6")
    assert planned(call) == {Store(Path("artifacts")).find("generate").folder}


def test_what_a_run_elsewhere_was_interrupted_in_stays(call: Call, tmp_path: Path):
    call(*NEVER_MIND)
    (tmp_path / "mine.toml").write_text("seed = 5\n" + Path("tiny.toml").read_text())
    key = document(call("generate", "mine.toml", "--dry-run", "--json"))["stages"][0]["key"]
    scratch = Path(f"artifacts/.scratch/generate-{key}")
    scratch.mkdir(parents=True)
    assert planned(call) == {scratch}
    call("generate", "mine.toml", "--set", "seed=6")
    assert scratch not in planned(call)


def test_a_pipeline_file_that_is_broken_now_keeps_what_it_last_asked_for(call: Call, elsewhere: Path):
    elsewhere.write_text("seed = [")
    done = call("gc", "tiny.toml")
    assert done.stdout == "nothing to delete\n"
    (warning,) = done.stderr.splitlines()
    assert "expected a TOML file" in warning and "the results that it last used stay" in warning


def test_the_plant_of_a_pipeline_that_another_user_ran_is_not_run(call: Call, elsewhere: Path, monkeypatch):
    """In a store that several share: whoever can write there can write an entry."""
    Path("elsewhere/evil.py").write_text("open('ran', 'w')\n")
    elsewhere.write_text(elsewhere.read_text().replace('"scalar"', '"evil.py:Tank"'))
    uid = os.geteuid()
    monkeypatch.setattr(os, "geteuid", lambda: uid + 1)
    assert planned(call) == set() and not Path("ran").exists()
    monkeypatch.undo()


def test_a_strange_entry_is_none(call: Call, stale: list[Path]):
    for number, text in enumerate(["[]", "{", '{"file": 3}', '{"file": "a\\u0000b", "keys": 1}', '{"keys": {}}']):
        Path(f"artifacts/.pipelines/{number}.json").write_text(text)
    assert planned(call) == set(stale)


def test_a_folder_without_the_marker_is_refused_until_npred_has_results_in_it(call: Call, stale: list[Path]):
    (Path("artifacts") / MARKER).unlink()
    line = one_line(call("gc", "tiny.toml", "--yes"), 4)
    assert "artifacts: expected a store of npred, found no .npred-store in it; if npred made its results" in line
    assert all(folder.exists() for folder in stale)
    call(*NEVER_MIND)
    assert planned(call) == set(stale)


def test_what_is_not_npreds_stays_in_a_store(call: Call, stale: list[Path]):
    """Files of other programs in its folders, and other programs' folders that are named by a digest."""
    names = [".tmp/mine/data", ".scratch/train-1/data", f"layers/{'a' * 64}/data", f"train/{'b' * 64}x/data"]
    for name in names:
        (Path("artifacts") / name).parent.mkdir(parents=True)
        (Path("artifacts") / name).write_text("x")
    assert planned(call) == set(stale)
    call("gc", "tiny.toml", "--yes")
    assert all((Path("artifacts") / name).exists() for name in names) and not any(path.exists() for path in stale)


def test_where_a_full_disk_has_no_room_for_a_lock_the_others_make_it(call: Call, stale: list[Path], monkeypatch):
    lock, tried = Store.lock, set()

    def full(self, stage, key, waiting=None):
        if key == stale[0].name and key not in tried:
            tried.add(key)
            raise NpredError from OSError(errno.ENOSPC, "No space left on device")
        return lock(self, stage, key, waiting)

    monkeypatch.setattr(Store, "lock", full)
    assert len(document(call("gc", "tiny.toml", "--yes", "--json"))["deleted"]) == 3
