"""`npred gc`: what goes by age, by size, by reachability, and what stays when parts of the store are corrupt."""

import os
import time
from pathlib import Path

import pytest
from conftest import Call, document, one_line

from npred import devices
from npred.cli.cleaning import size
from npred.errors import ConfigError
from npred.store import Store

NEVER_MIND = ("run", "tiny.toml", "--jobs", "1")


def planned(call: Call, *arguments: str) -> set[Path]:
    return {Path(row["path"]) for row in document(call("gc", "tiny.toml", "--json", *arguments))["plan"]}


def older(folder: Path, days: float) -> Path:
    """As if it had been made so many days ago."""
    stamp = time.time() - days * 86400
    os.utime(folder / "manifest.json", (stamp, stamp))
    return folder


@pytest.fixture
def stale(call: Call) -> list[Path]:
    """Folders of three results that tiny.toml does not need, a day, ten and a hundred days old."""
    call(*NEVER_MIND)
    folders = []
    for epochs, days in ((2, 100.0), (3, 10.0), (4, 1.0)):
        call("train", "tiny.toml", "--model", "fno", "--set", f"train.fno.epochs={epochs}")
        folders.append(older(Store(Path("artifacts")).find("fno").folder, days))
    return folders


def test_what_another_machine_timed_is_needed(call: Call, monkeypatch: pytest.MonkeyPatch):
    """The machine is part of bench's question: one with other cores would ask for other times."""
    call("bench", "tiny.toml", "--jobs", "1")
    monkeypatch.setattr(devices, "hardware", lambda device: {"cpu": "another", "cores": 64, "device": device})
    assert planned(call) == set()
    call("bench", "tiny.toml", "--jobs", "1", "--set", "bench.calls=7")
    assert [path.parent.name for path in planned(call)] == ["bench"]


def test_by_age(call: Call, stale: list[Path]):
    assert planned(call) == set(stale)
    assert planned(call, "--older", "5") == set(stale[:2])
    assert planned(call, "--older", "1000") == set()


def test_by_size_the_oldest_first(call: Call, stale: list[Path]):
    store = Store(Path("artifacts"))
    total = sum(artifact.size for artifact in store.artifacts())
    assert planned(call, "--keep", f"{total / 1000:.3f}k") == set()
    assert planned(call, "--keep", str(total - 1)) == {stale[0]}
    assert planned(call, "--keep", str(total - 1), "--older", "5") == {stale[0]}
    assert planned(call, "--keep", "0") == set(stale)
    assert len(document(call("gc", "tiny.toml", "--json", "--yes", "--keep", str(total - 1)))["deleted"]) == 1
    assert [folder.exists() for folder in stale] == [False, True, True]


def test_what_a_kept_result_was_made_from_is_kept(call: Call):
    call(*NEVER_MIND)
    call("generate", "tiny.toml", "--set", "generate.rollouts=60")
    data = older(Store(Path("artifacts")).find("generate").folder, 50)
    call("train", "tiny.toml", "--model", "fno", "--set", "generate.rollouts=60")
    assert planned(call, "--older", "20") == set()
    older(Store(Path("artifacts")).find("fno").folder, 50)
    assert data in planned(call, "--older", "20")


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
        os.utime(renewed / "manifest.json")
        return [artifact for artifact in sound if artifact.folder != torn], [torn]

    monkeypatch.setattr(Store, "survey", between)
    done = document(call("gc", "tiny.toml", "--json", "--yes"))
    assert {Path(row["path"]) for row in done["plan"]} == set(stale)
    assert done["deleted"] == [str(old)]
    assert [folder.exists() for folder in stale] == [True, True, False]


def test_sizes_in_words(call: Call):
    assert [size(text) for text in (None, "0", "12", "2k", "2.5MB", "1G")] == [-1, 0, 12, 2000, 2_500_000, 10**9]
    for text in ("", "two", "-1G", "5 G", "nan", "1e9"):
        with pytest.raises(ConfigError, match="expected a size as 500M"):
            size(text)
    assert "--keep" in one_line(call("gc", "tiny.toml", "--keep", "much"), 2)
