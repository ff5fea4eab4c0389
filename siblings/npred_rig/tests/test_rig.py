"""Both sides of a rig as processes: they end by themselves, the log is whole, and `npred identify` reads it."""

import json
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Callable
from pathlib import Path

import pytest
from conftest import one_line, process_environment
from stopped_runs import hear_interrupts
from typer.testing import CliRunner

import npred
from npred.cli import app
from npred.guard.guarded import Guarded
from npred_rig import rig
from npred_rig.network import Channel
from npred_rig.options import Rigged

PIPELINE = """
name = "short"
plant = "scalar"
[evaluate]
X0 = [1.0]
D = 0.2
D_hat = 0.5
bounds = [0.1, 0.8]
dt = 0.02
nx = 21
t_end = 10.0
case_t_end = 10.0
adaptation = "delay-observer"
measurement = { noise = 0.002 }
"""


pytestmark = pytest.mark.skipif(not Path("/proc/self/task").exists(), reason="reads processes from /proc")


@pytest.fixture
def start(tmp_path: Path):
    (tmp_path / "short.toml").write_text(PIPELINE)
    started = []

    def begin(*flags: str, before: Callable[[], None] = hear_interrupts) -> subprocess.Popen:
        command = [sys.executable, "-m", "npred", "rig", "short.toml", "--json", "--log", "log.csv", *flags]
        pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
        settings = {"env": process_environment(), "preexec_fn": before, "start_new_session": True}
        started.append(subprocess.Popen(command, cwd=tmp_path, **settings, **pipes))
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
    process = start("--seconds", "2", "--latency", "0.06", "--jitter", "0.01", "--loss", "0.05")
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
    assert "expected a complete run" in err
    assert not any(map(runs, both))
    assert (assert_whole(path) == "# end: the plant is gone") == (place == 1)


def in_the_background() -> None:
    """As nohup and a shell's job."""
    for number in (signal.SIGINT, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)


@pytest.mark.parametrize(("number", "code"), [("SIGHUP", 129), ("SIGTERM", 143)])
def test_a_signal_to_all_processes_leaves_a_log_with_its_end(start, tmp_path, number, code):
    """As a terminal sends that is closed, and `timeout`."""
    process, path = start("--seconds", "600"), tmp_path / "log.csv"
    wait_for_rows(path, 60)
    os.killpg(process.pid, getattr(signal, number))
    process.communicate(timeout=120)
    assert (process.returncode, assert_whole(path)) == (code, "# end: interrupted")


def test_a_rig_in_the_background_ends_by_sigterm_alone(start, tmp_path):
    process, path = start("--seconds", "600", before=in_the_background), tmp_path / "log.csv"
    for number in (signal.SIGINT, signal.SIGHUP):
        wait_for_rows(path, 60 + path.read_text().count("\n") if path.exists() else 60)
        os.killpg(process.pid, number)
    wait_for_rows(path, 60 + path.read_text().count("\n"))
    os.kill(process.pid, signal.SIGTERM)
    process.communicate(timeout=120)
    assert (process.returncode, assert_whole(path)) == (143, "# end: interrupted")


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
    process = start("--seconds", "8", "--latency", "0.06", "--jitter", "0.0")
    out, err = process.communicate(timeout=120)
    assert process.returncode == 0, err
    command = [sys.executable, "-m", "npred", "identify", "log.csv", "--plant", "scalar", "--json"]
    answer = subprocess.run(command, cwd=tmp_path, env=process_environment(), capture_output=True, text=True)
    assert answer.returncode in (0, 3), answer.stderr  # 3: a loop without a test signal does not tell its delay
    low, high = json.loads(answer.stdout)["interval"][0]
    assert low - 0.02 <= json.loads(out)["delay"] <= high + 0.02  # a control step beside the 95 %


SERVO = """
class Servo:
    states, inputs, parameters, box = ("x",), ("u",), {"aim": 0.0}, {"x": (-2.0, 2.0)}
    def f(x, u, t, p, M):
        return [u.u - x.x]
    def setpoint(x, t, p, M):
        return [x.x - p.aim]
"""


def test_it_steps_the_set_points_of_the_table(start, tmp_path):
    """Its distance at the end is that to the last one."""
    (tmp_path / "servo.py").write_text(SERVO)
    table = PIPELINE.replace('"scalar"', '"servo.py:Servo"\nkappa = "lqr"')
    (tmp_path / "short.toml").write_text(table + "setpoints.aim = { at = [3.0], to = [1.5] }\n")
    process = start("--seconds", "9", "--latency", "0.05")
    out, err = process.communicate(timeout=120)
    assert process.returncode == 0, err
    assert json.loads(out)["radius"] < 0.15


PENDULUM = """
class Pendulum:
    states, inputs, outputs = ("theta", "omega"), ("torque",), ("angle",)
    box = {"theta": (-0.5, 0.5), "omega": (-0.5, 0.5)}
    def f(x, u, t, p, M):
        return [x.omega, 10 * M.sin(x.theta) + u.torque]
    def kappa(x, t, p, M):
        return [-10 * M.sin(x.theta) - 4 * x.theta - 4 * x.omega]
    def output(x, t, p, M):
        return [x.theta]
"""
SWINGING = """
name = "short"
plant = "pendulum.py:Pendulum"
[evaluate]
X0 = [0.3, 0.0]
D = 0.05
D_hat = 0.06
adaptation = "frozen"
actuator = "history"
observer = { kind = "luenberger" }
"""


def test_a_plant_that_swings_has_a_radius_whatever_its_output_is_called(start, tmp_path):
    """Its delay is six times D_hat."""
    (tmp_path / "pendulum.py").write_text(PENDULUM)
    (tmp_path / "short.toml").write_text(SWINGING)
    process = start("--seconds", "3", "--latency", "0.3", "--jitter", "0", "--figure", "rig.svg")
    out, err = process.communicate(timeout=120)
    assert process.returncode == 3, err
    assert json.loads(out)["radius"] > 0.3
    assert "expected a loop that stays" in err


@pytest.mark.parametrize(
    ("override", "words"),
    [
        ("measurement.delay=0.1", "got evaluate.measurement.delay;"),
        ("measurement.drop=0.1", "got evaluate.measurement.drop;"),
        ("measurement={period = 0.02, jitter = 0.1}", "got evaluate.measurement.jitter;"),
        ("timing.overrun=0.1", "got evaluate.timing.overrun;"),
        ("X0=[1.0, 2.0]", "X0: expected shape (..., 1)"),
        ("measurement.relative_noise=[0.1, 0.2]", "measurement: expected relative_noise as one number or 1"),
    ],
)
def test_what_the_rig_does_not_honour_is_refused_by_name(tmp_path, monkeypatch, override, words):
    monkeypatch.chdir(tmp_path)
    Path("short.toml").write_text(PIPELINE)
    flags = ["--set", "evaluate.actuator=history", "--set", f"evaluate.{override}"]
    assert words in one_line(CliRunner().invoke(app, ["rig", "short.toml", *flags]), 2)
    assert not Path("short-rig.csv").exists()


def test_the_network_is_that_of_the_overrides_and_has_the_guard(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("short.toml").write_text(PIPELINE)
    overrides, asked = ["train.deeponet.width=8", "evaluate.guard.tolerance=0.02"], []
    options, plant = (
        Rigged(pipeline_name="short.toml", set=overrides, model="deeponet", quiet=True),
        npred.plant("scalar"),
    )
    monkeypatch.setattr(rig, "load_model", lambda *arguments: asked.append(arguments))
    monkeypatch.setattr(rig, "loaded", lambda stored, nx, device, runtime: npred.predictor(plant, "heun", nx))
    predictor = rig._controller(options, plant, Channel()).predictor
    assert asked == [("short.toml:deeponet", options.store, overrides)]
    assert isinstance(predictor, Guarded) and predictor.tolerance == 0.02


CART = """
class Cart:
    states, inputs, guess, box = ("x", "v"), ("u",), (0.95, 0.0), {"x": (-0.6, 0.6), "v": (-0.4, 0.4)}

    def f(x, u, t, p, M):
        return [x.v, u.u]

    def kappa(x, t, p, M):
        return [-4 * (x.x - 0.95) - 1.2 * x.v]

    def safe(x, t, p, M):
        return [1.0 - x.x, 1.0 + x.x]
"""


def test_the_controller_has_the_filter_of_the_pipeline(tmp_path):
    (tmp_path / "cart.py").write_text(CART)
    (tmp_path / "cart.toml").write_text(
        'plant = "cart.py:Cart"\n[evaluate]\nX0 = [-0.6, 0.2]\nD = 0.3\nadaptation = "frozen"\n'
    )
    options = Rigged(pipeline_name=str(tmp_path / "cart.toml"), set=["evaluate.safety.margin=0.01"])
    plant = npred.plant(f"{tmp_path / 'cart.py'}:Cart")
    controller = rig._controller(options, plant, Channel(0.1, 0.0, 0.0, 0.0, 0.0, 0))
    assert controller.safety == npred.SafetyFilter(margin=0.01)
