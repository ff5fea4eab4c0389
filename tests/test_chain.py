"""The real chain as processes: killed in every stage it continues, twice is once, a flipped byte is found."""

import contextlib
import json
import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from conftest import process_environment
from typer.testing import CliRunner, Result

from npred.cli import app

pytestmark = pytest.mark.slow

TINY = """
plant = "activator_repressor"
name = "tiny"
seed = 1
[generate]
samples = 400
rollouts = 8
t_end = 8.0
dt = 0.01
nx = 21
[train.deeponet]
epochs = 6
batch = 16
width = 16
snapshots = [2]
checkpoint_every = 1
[train.fno]
epochs = 3
batch = 32
width = 8
layers = 2
checkpoint_every = 1
[evaluate]
X0 = [0.03, 30.0]
t_end = 3.0
case_t_end = 3.0
case_states = 2
case_D_hat = [1.0]
dt = 0.01
nx = 21
[bench]
dx = [0.1]
calls = 10
batches = [1]
runtimes = ["torch"]
"""
STAGES = ["generate", "train deeponet", "train fno", "evaluate", "bench", "report"]
RUN = ("run", "tiny.toml", "--jobs", "1", "--store")


@pytest.fixture
def chain(tmp_path):
    (tmp_path / "tiny.toml").write_text(TINY)
    return tmp_path


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """The store of one run that nothing stopped."""
    folder = tmp_path_factory.mktemp("whole")
    (folder / "tiny.toml").write_text(TINY)
    done = here(folder, *RUN, "whole")
    assert done.exit_code == 0, done.output
    return folder / "whole"


def command(store: str, *more: str) -> list[str]:
    return [sys.executable, "-m", "npred", *RUN, store, *more]


def here(folder: Path, *arguments: str) -> Result:
    """A command in this process, in a folder; what runs as a process of its own draws its report."""
    with contextlib.chdir(folder):
        return CliRunner().invoke(app, [*arguments])


def killed_in(folder: Path, store: str, stage: str) -> None:
    """Start a run and kill -9 it as soon as it says that the stage is running."""
    process = subprocess.Popen(command(store), cwd=folder, env=process_environment(), stderr=subprocess.PIPE, text=True,
                               stdout=subprocess.DEVNULL)  # fmt: skip
    assert process.stderr is not None
    for line in process.stderr:
        if line.startswith(f"{stage}: running"):
            break
    else:
        pytest.fail(f"{stage} never ran")
    os.kill(process.pid, signal.SIGKILL)
    assert process.wait() == -signal.SIGKILL


def digests(store: Path) -> dict[str, dict[str, str]]:
    """The digests of the payload files of every result, by stage and network."""
    found = {}
    for path in store.glob("*/*/manifest.json"):
        manifest = json.loads(path.read_text())
        question = manifest["question"]
        name = f"{question['stage']} {question['model'] or ''}".strip()
        assert name not in found, "one result a question"
        found[name] = {file: payload["sha256"] for file, payload in manifest["files"].items()}
    return found


def test_killed_in_every_stage_it_ends_with_the_same_bytes(chain, whole):
    for stage in STAGES:
        killed_in(chain, "hurt", stage)
    after = here(chain, *RUN, "hurt", "--json")
    assert after.exit_code == 0, after.stderr
    actions = {f"{s['stage']} {s.get('model') or ''}".strip(): s["action"] for s in json.loads(after.stdout)["stages"]}
    assert actions == dict.fromkeys(STAGES, "hit") | {"report": "run"}
    hurt, unhurt = digests(chain / "hurt"), digests(whole)
    assert set(hurt) == set(unhurt) == set(STAGES)
    for stage in STAGES[:-2]:  # bench holds times, and the report shows them
        assert hurt[stage] == unhurt[stage], stage


def test_two_runs_at_once_make_each_result_once_and_a_third_none(chain):
    both = [subprocess.Popen(command("shared", "--json"), cwd=chain, env=process_environment(), stdout=subprocess.PIPE,
                             stderr=subprocess.DEVNULL, text=True) for _ in range(2)]  # fmt: skip
    answers = [json.loads(process.communicate(timeout=200)[0])["stages"] for process in both]
    for first, second in zip(*answers, strict=True):
        assert {first["action"], second["action"]} == {"run", "hit"} and first["key"] == second["key"]
        assert (first["action"], second["action"]) != ("run", "run")
    again = json.loads(here(chain, *RUN, "shared", "--json").stdout)["stages"]
    assert {s["action"] for s in again} == {"hit"}


def test_a_flipped_byte_is_found_on_read(chain, whole):
    shutil.copytree(whole, chain / "store")
    (data,) = (chain / "store" / "generate").glob("*/data.h5")
    content = bytearray(data.read_bytes())
    content[len(content) // 2] ^= 1
    os.chmod(data, 0o644)
    data.write_bytes(content)
    after = here(chain, "run", "tiny.toml", "--store", "store", "--set", "train.deeponet.epochs=7")
    assert after.exit_code == 4
    (line,) = [line for line in after.stderr.splitlines() if line.startswith("error:")]
    assert "data.h5" in line
    assert data.read_bytes() == bytes(content), "nothing is overwritten"


def test_changed_epochs_rerun_only_what_depends_on_them_and_why_says_so(chain, whole):
    shutil.copytree(whole, chain / "store")
    change = ("--set", "train.deeponet.epochs=7")
    why = here(chain, "why", "train", "tiny.toml", "--store", "store", *change)
    assert "train.deeponet.epochs: 6 -> 7" in why.stdout
    done = here(chain, *RUN, "store", "--json", *change)
    stages = json.loads(done.stdout)["stages"]
    actions = {f"{s['stage']} {s.get('model') or ''}".strip(): s["action"] for s in stages}
    assert actions == dict.fromkeys(STAGES, "run") | {"generate": "hit", "train fno": "hit"}
