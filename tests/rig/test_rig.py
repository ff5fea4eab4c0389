"""Both sides of a rig as processes: they end by themselves, the log is whole, and `npred identify` reads it."""

import json
import os
import signal
import subprocess
import sys
import threading
from pathlib import Path

import pytest
from conftest import process_environment

PIPELINE = """
name = "short"
plant = "scalar"
[evaluate]
X0 = [1.0]
D = 0.2
D_hat0 = 0.5
bounds = [0.1, 0.8]
dt = 0.02
nx = 21
t_end = 10.0
case_t_end = 10.0
adaptation = "delay-observer"
measurement = { absolute = 0.002 }
"""


pytestmark = pytest.mark.skipif(not Path("/proc/self/task").exists(), reason="reads processes from /proc")


@pytest.fixture
def start(tmp_path: Path):
    (tmp_path / "short.toml").write_text(PIPELINE)
    started = []

    def begin(*flags: str) -> subprocess.Popen:
        command = [sys.executable, "-m", "npred", "rig", "short.toml", "--json", "--log", "log.csv", *flags]
        pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
        started.append(subprocess.Popen(command, cwd=tmp_path, env=process_environment(), **pipes))
        return started[-1]

    yield begin
    for process in started:
        process.kill()


def wait_for_rows(path: Path, count: int) -> None:
    pause = threading.Event()
    while not path.exists() or path.read_text().count("\n") < count:
        pause.wait(0.05)


def sides(process: subprocess.Popen, path: Path) -> tuple[int, int]:
    """The ids of the controller's process, which writes the log, and of the plant's, which has two sockets as well."""
    children = map(int, Path(f"/proc/{process.pid}/task/{process.pid}/children").read_text().split())
    files = {child: [os.readlink(file) for file in Path(f"/proc/{child}/fd").iterdir()] for child in children}
    (controller,) = [child for child, names in files.items() if str(path) in names]
    (plant,) = [c for c in files if c != controller and sum("socket:" in name for name in files[c]) == 2]
    return controller, plant


def runs(number: int) -> bool:
    try:
        return "(zombie)" not in Path(f"/proc/{number}/status").read_text()
    except OSError:
        return False


def assert_whole(path: Path) -> str:
    text = path.read_text()
    assert text.endswith("\n")
    head, *rows = [line for line in text.splitlines() if not line.startswith("#")]
    assert len(rows) > 20
    assert all(row.count(",") == head.count(",") for row in rows)
    return text.splitlines()[-1]


def test_a_loop_of_two_seconds_says_what_its_stamps_say(start, tmp_path):
    process = start("--seconds", "2", "--delay", "0.06", "--jitter", "0.01", "--loss", "0.05")
    out, err = process.communicate(timeout=120)
    assert process.returncode == 0, err
    said = json.loads(out)
    assert said["calls"] > 20
    assert said["samples"] > 20
    assert 0.2 < said["delay"] < 1.0  # D of the plant and the network's, whatever the machine adds
    assert assert_whole(tmp_path / "log.csv") == "# end: the time is over"


@pytest.mark.parametrize("place", [0, 1])
def test_a_side_that_is_killed_ends_the_other_with_its_log_whole(start, tmp_path, place):
    process, path = start("--seconds", "600"), tmp_path / "log.csv"
    wait_for_rows(path, 60)
    both = sides(process, path)
    os.kill(both[place], signal.SIGKILL)
    _, err = process.communicate(timeout=120)
    assert process.returncode == 1
    assert "expected a whole run" in err
    assert not any(map(runs, both))
    assert (assert_whole(path) == "# end: the plant is gone") == (place == 1)


@pytest.mark.parametrize("number", [signal.SIGINT, getattr(signal, "SIGKILL", None)])
def test_no_process_is_left_where_the_command_ends(start, tmp_path, number):
    process, path = start("--seconds", "600"), tmp_path / "log.csv"
    wait_for_rows(path, 60)
    both = sides(process, path)
    os.kill(process.pid, number)
    process.communicate(timeout=120)
    assert process.returncode in (130, -signal.SIGKILL)
    assert not any(map(runs, both))  # with the pipes of stdout closed, none of them is left
    assert assert_whole(path).startswith("# end: ")


def test_identify_reads_the_log_and_finds_the_delay(start, tmp_path):
    process = start("--seconds", "8", "--delay", "0.06", "--jitter", "0.0")
    out, err = process.communicate(timeout=120)
    assert process.returncode == 0, err
    command = [sys.executable, "-m", "npred", "identify", "log.csv", "--plant", "scalar", "--json"]
    answer = subprocess.run(
        command, cwd=tmp_path, env=process_environment(), capture_output=True, text=True, check=True
    )
    low, high = json.loads(answer.stdout)["interval"][0]
    assert low - 0.02 <= json.loads(out)["delay"] <= high + 0.02  # a control step beside the 95 %
