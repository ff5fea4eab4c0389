"""What several test modules share: a small pipeline file, fake stages, npred as a process."""

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import fake_stages
import pytest

from npred.pipeline import STAGES

HERE = Path(__file__).parent
TINY = """
name = "tiny"
plant = "scalar"
[generate]
samples = 500
rollouts = 50
[train]
models = ["deeponet", "fno"]
[train.deeponet]
epochs = 30
snapshots = [7]
[train.fno]
epochs = 100
lr = 0.002
[evaluate]
X0 = [0.5]
[bench]
calls = 1000
"""


@pytest.fixture
def pipeline(tmp_path: Path) -> Path:
    """A pipeline file beside an empty store."""
    path = tmp_path / "tiny.toml"
    path.write_text(TINY)
    return path


@pytest.fixture
def fakes(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    """Fake stages in the table; the file that gets a line for each of their runs."""
    table = dict(STAGES)
    fake_stages.install(table)
    for name, stage in table.items():
        monkeypatch.setitem(STAGES, name, stage)
    log = tmp_path / "log"
    log.touch()
    monkeypatch.setenv("FAKE_LOG", str(log))
    return log


@pytest.fixture
def npred(tmp_path: Path) -> Callable[..., subprocess.CompletedProcess[str]]:
    """`npred` with fake stages as a process of its own, in tmp_path."""

    def call(*arguments: str, **environment: str) -> subprocess.CompletedProcess[str]:
        command = [sys.executable, str(HERE / "fake_stages.py"), *arguments]
        return subprocess.run(
            command, cwd=tmp_path, env=process_environment(**environment), capture_output=True, text=True, timeout=60
        )

    return call


def process_environment(**more: str) -> dict[str, str]:
    """The environment of a child that imports npred from this checkout."""
    paths = f"{HERE.parent}{os.pathsep}{HERE}"
    kept = {name: value for name, value in os.environ.items() if name != "NPRED_STORE"}
    return kept | {"PYTHONPATH": paths, "COLUMNS": "200", "OMP_NUM_THREADS": "1"} | more
