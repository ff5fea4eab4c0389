"""Joints of a robot: columns that are a pair, the delay and the lag of each, the table of the command."""

import json
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from npred.base.errors import ConfigError
from npred.cli import app
from npred.identification import joints

FINE, PERIOD, ROWS = 20, 0.02, 700  # steps in a row


def robot(path: Path) -> Path:
    """A log of three joints: delays of 60 and 110 ms with lags of 80 and 40 ms, and one that is not moved."""
    rng = np.random.default_rng(3)
    held = np.cumsum(rng.normal(0, 0.3, (ROWS // 14, 2)) * (rng.random((ROWS // 14, 2)) < 0.7), axis=0)
    u = np.repeat(held, 14, axis=0)
    y = np.zeros((ROWS, 2))
    for j, (delay, lag) in enumerate(((0.06, 0.08), (0.11, 0.04))):
        share, late = np.exp(-PERIOD / FINE / lag), round(delay / PERIOD * FINE)
        state, fine = u[0, j], np.repeat(u[:, j], FINE)
        for k in range(ROWS * FINE):
            y[k // FINE, j] = state if k % FINE == 0 else y[k // FINE, j]
            state += (1 - share) * (fine[max(k - late, 0)] - state)
    y += rng.normal(0, 1e-3, y.shape)
    table = np.column_stack([np.arange(ROWS) * PERIOD, u, np.ones(ROWS), y, 1 + rng.normal(0, 1e-3, ROWS)])
    names = ["t", *(f"action[{k}]" for k in range(3)), *(f"observation.state[{k}]" for k in range(3))]
    np.savetxt(path, table, "%.6g", ",", header=",".join(names), comments="")
    return path


def test_a_table_of_joints(tmp_path):
    path = robot(tmp_path / "log.csv")
    arguments = ["identify", str(path), "--joints", "--longest", "0.3", "--jobs", "1"]
    done = CliRunner().invoke(app, [*arguments, "--json"])
    assert done.exit_code == 0, done.output
    answer = json.loads(done.stdout)["joints"]
    assert [(joint["name"], joint["command"], joint["measured"]) for joint in answer] == [
        (str(k), f"action[{k}]", f"observation.state[{k}]") for k in range(3)
    ]
    for joint, delay, lag in zip(answer, (0.06, 0.11), (0.08, 0.04), strict=False):
        assert joint["certain"] and joint["delay_interval"][0] <= delay <= joint["delay_interval"][1]
        assert np.ptp(joint["delay_interval"]) < 0.01 and joint["lag"] == pytest.approx(lag, rel=0.05)
        assert joint["gain"] == pytest.approx(1, rel=0.01)
    assert not answer[2]["certain"] and answer[2]["why"].startswith("command never changes.")


def test_the_table_is_printed_with_the_reasons(tmp_path, monkeypatch):
    low_high, nan = (0.1, 0.12), float("nan")
    known = joints.JointDelay("0", "action[0]", "state[0]", 0.11, low_high, 0.05, (0.04, 0.06), 1.0, True, "", 700)
    open_one = joints.JointDelay(
        "1", "action[1]", "state[1]", nan, (0.0, 0.5), nan, (nan, nan), nan, False, "it rests.", 9
    )
    tasks = [joints.JointLog(each.name, "", "", None) for each in (known, open_one)]
    monkeypatch.setattr(joints, "tasks", lambda *_, **__: (tasks, ["a note"]))
    monkeypatch.setattr(joints, "identified", lambda task: {"0": known, "1": open_one}[task.name])
    done = CliRunner().invoke(app, ["identify", str(tmp_path / "log.csv"), "--joints", "--jobs", "1"])
    lines = [line.split() for line in done.stdout.splitlines()]
    assert lines[2] == ["0", "action[0]", "state[0]", "0.11", "0.1", "to", "0.12", "0.05", "0.04", "to", "0.06", "1"]
    assert lines[3] == ["1", "action[1]", "state[1]", "–", "0", "to", "0.5", "–", "–", "–"]
    assert lines[4] == ["1:", "it", "rests."]


@pytest.mark.parametrize(
    ("names", "pairs"),
    [
        (["t", "q1_cmd", "q1_actual", "q2_cmd", "q2"], {"q_1": ("q1_cmd", "q1_actual"), "q_2": ("q2_cmd", "q2")}),
        (["target_q_0", "actual_q_0", "actual_qd_0"], {"q_0": ("target_q_0", "actual_q_0")}),
        (["action.shoulder.pos", "observation.state.shoulder.pos"],
         {"shoulder": ("action.shoulder.pos", "observation.state.shoulder.pos")}),
        (["/joint_commands.position[0]", "/joint_states.position[0]", "/joint_states.velocity[0]"],
         {"joint_0": ("/joint_commands.position[0]", "/joint_states.position[0]")}),
        (["action[0]", "observations.qvel[0]", "observations.qpos[0]"], {"0": ("action[0]", "observations.qpos[0]")}),
        (["wristCommanded", "wrist"], {"wrist": ("wristCommanded", "wrist")}),
        (["u", "y"], {}),
    ],
)  # fmt: skip
def test_columns_are_a_pair_by_their_names(names, pairs):
    assert dict(joints._pairs(names)) == pairs


def test_without_pairs_and_with_flags_of_a_plant_it_is_refused(tmp_path):
    (tmp_path / "log.csv").write_text("t,u,y\n0,1,2\n1,2,3\n")
    with pytest.raises(ConfigError, match=r"expected pairs of columns .*, found t, u, y; rename them"):
        joints.tasks([tmp_path / "log.csv"])
    done = CliRunner().invoke(app, ["identify", "log.csv", "--joints", "--plant", "x.py:X", "--accept"])
    assert done.exit_code == 2 and "expected none of the flags of a plant, got --plant, --accept" in done.stderr


def test_of_a_long_log_the_part_that_moves_is_used():
    log = joints.Log.of(np.arange(20_000.0), np.where(np.arange(20_000) > 15_000, np.arange(20_000) % 7, 0)[:, None],
                        np.zeros((20_000, 1)))  # fmt: skip
    used = joints.moving(log)
    assert len(used.t) == joints.SAMPLES and used.t.min() >= 14_800 and used.U.shape == log.U.shape
