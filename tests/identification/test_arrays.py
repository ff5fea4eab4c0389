"""Arrays by name, of .mat and JSON files: vectors, matrices, structures, records, and several runs in one file."""

import gzip
import json

import h5py
import numpy as np
import pytest
from scipy import io

from npred.base.errors import ConfigError
from npred.identification import recordings

T, U, Y = np.arange(4) * 0.5, np.array([0.0, 1, 1, 0]), np.array([0.0, 0, 2, np.nan])


@pytest.fixture
def mat(tmp_path):
    def write(**variables):
        io.savemat(tmp_path / "log.mat", variables)
        return tmp_path / "log.mat"

    return write


@pytest.fixture
def text(tmp_path):
    def write(value, name="log.json"):
        (tmp_path / name).write_text(value if isinstance(value, str) else json.dumps(value))
        return tmp_path / name

    return write


def values(path, name, **options):
    t, column, rows = recordings.read(path, [name], **options).series[name]
    return t.tolist(), column.tolist(), rows.tolist()


@pytest.mark.parametrize("shape", [(4,), (1, 4), (4, 1)])
def test_vectors_of_any_direction_are_columns(mat, shape):
    path = mat(t=T.reshape(shape), u=U.reshape(shape), y=Y.reshape(shape), Ts=0.5, name="a motor")
    assert recordings.opened(path).columns() == ["t", "u", "y"]
    assert values(path, "y") == ([0, 0.5, 1], [0, 0, 2], [1, 2, 3])
    assert values(path, "u", time_unit="min")[0] == [0, 30, 60, 90]


def test_matrices_have_columns_by_number(mat):
    path = mat(data=np.column_stack([T, U, Y]), wide=np.stack([U, Y]))
    assert recordings.opened(path).columns() == ["data[0]", "data[1]", "data[2]", "wide[0]", "wide[1]"]
    assert values(path, "data[1]", time="data[0]") == (T.tolist(), U.tolist(), [1, 2, 3, 4])
    assert values(path, "wide[0]", period=0.25)[0] == [0, 0.25, 0.5, 0.75]
    with pytest.raises(ConfigError, match="expected a column of times"):
        values(path, "data[1]")


def test_structures_have_names_with_dots_and_times_of_their_own(mat):
    fast = {"time": np.arange(8.0), "signals": {"values": np.arange(8.0) ** 2}}
    path = mat(slow={"time": T, "u": U}, fast=fast)
    read = recordings.read(path, ["fast.signals.values", "slow.u"])
    assert read.series["slow.u"].t.tolist() == T.tolist()
    assert read.series["fast.signals.values"].t.tolist() == [*range(8)]
    assert read.notes[0].startswith("log.mat: 8 rows; times from column fast.time, in s, the plant's unit")
    assert ", and 4 rows; times from column slow.time" in read.notes[0]
    with pytest.raises(
        ConfigError, match=r"expected columns with as many rows as their times, got slow.u with 4, fast"
    ):
        values(path, "slow.u", time="fast.time")


def test_version_7_3_is_read(tmp_path):
    with h5py.File(tmp_path / "log.mat", "w", userblock_size=512) as file:
        file["t"], file["u"] = T.reshape(1, 4), U.reshape(1, 4)
        file["s/y"] = np.stack([Y, U])  # as it is written there: the dimensions reversed
    head = b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM"
    with (tmp_path / "log.mat").open("r+b") as file:
        file.write(head)
    assert recordings.opened(tmp_path / "log.mat").columns() == ["s.y[0]", "s.y[1]", "t", "u"]
    assert values(tmp_path / "log.mat", "s.y[1]") == (T.tolist(), U.tolist(), [1, 2, 3, 4])


def test_what_is_no_mat_file_is_refused_in_one_line(tmp_path, mat):
    cut = mat(t=T, u=U).read_bytes()[:-30]
    for content in (b"", b"t,u\n0,1\n", cut):
        (tmp_path / "bad.mat").write_bytes(content)
        with pytest.raises(ConfigError, match=r"bad.mat: expected a .mat file, got: .+; check the file$"):
            recordings.opened(tmp_path / "bad.mat").columns()
    with pytest.raises(
        ConfigError, match=r"expected vectors or structures in a .mat file, got none; save the recording so"
    ):
        recordings.opened(mat(a=1.0, name="motor")).columns()


RECORDS = [{"t": t, "u": u, "at": {"y": y}} for t, u, y in zip(T, U, [0, 0, 2, None], strict=True)]


@pytest.mark.parametrize(
    "value",
    [
        {"t": T.tolist(), "u": U.tolist(), "at": {"y": [0, 0, 2, None]}},
        {"of": "a motor", "limits": [0, 1], "log": {"t": T.tolist(), "u": U.tolist(), "at": {"y": [0, 0, 2, None]}}},
        RECORDS,
        {"config": {"limits": [-1, 1]}, "data": RECORDS},
    ],
    ids=["arrays", "inside", "records", "records inside"],
)
def test_json_as_arrays_or_records(text, value):
    path = text(value)
    y = next(name for name in recordings.opened(path).columns() if name.endswith("at.y"))
    assert values(path, y) == ([0, 0.5, 1], [0, 0, 2], [1, 2, 3])


@pytest.mark.parametrize("name", ["log.jsonl", "log.json", "log.jsonl.gz"])
def test_json_in_lines(text, name):
    lines = "\n".join(map(json.dumps, RECORDS)) + "\n"
    path = text("", name)
    path.write_bytes(gzip.compress(lines.encode()) if name.endswith("gz") else lines.encode())
    assert values(path, "at.y") == ([0, 0.5, 1], [0, 0, 2], [1, 2, 3])


def test_records_with_a_time_may_hold_vectors(text):
    path = text([{"t": 0.5 * k, "action": [k, 2 * k], "state": {"q": [k, k, k]}} for k in range(3)])
    assert recordings.opened(path).columns() == [
        "t",
        "action[0]",
        "action[1]",
        "state.q[0]",
        "state.q[1]",
        "state.q[2]",
    ]
    assert values(path, "action[1]") == ([0, 0.5, 1], [0, 2, 4], [1, 2, 3])


def test_groups_of_hdf5_are_structures(tmp_path):
    path = tmp_path / "log.hdf5"
    with h5py.File(path, "w") as file:
        file["action"], file["observations/qpos"] = np.arange(8).reshape(4, 2), np.arange(12.0).reshape(4, 3)
        file["log/table"] = np.array(list(zip(T, U, strict=True)), dtype=[("t", "f8"), ("u", "f8")])
        file["note"] = "a robot"
    assert values(path, "observations.qpos[2]", period=0.5)[:2] == (T.tolist(), [2, 5, 8, 11])
    assert values(path, "log.table.u") == (T.tolist(), U.tolist(), [1, 2, 3, 4])


def test_numbered_groups_of_hdf5_are_runs(tmp_path):
    path = tmp_path / "log.h5"
    with h5py.File(path, "w") as file:
        for k in range(3):
            file[f"data/demo_{k}/actions"], file[f"data/demo_{k}/obs/q"] = np.full((4, 2), k), np.full((4, 2), -k)
    assert values(path, "obs.q[1]", period=0.5)[:2] == ([0, 0.5, 1, 1.5] * 3, [0] * 4 + [-1] * 4 + [-2] * 4)


def test_arrays_of_numpy(tmp_path):
    np.savez(tmp_path / "log.npz", t=T, y=np.stack([Y, U], axis=1))
    assert values(tmp_path / "log.npz", "y[1]") == (T.tolist(), U.tolist(), [1, 2, 3, 4])
    np.savez(tmp_path / "log.npz", t=np.array([{}], dtype=object))
    with pytest.raises(ConfigError, match=r"expected an .npz file, got: Object arrays"):
        recordings.opened(tmp_path / "log.npz")


def test_json_as_rows(text):
    assert values(text([[0, 1], [0.5, 2]]), "2", time="1") == ([0, 0.5], [1, 2], [1, 2])


def test_stamps_in_json(text):
    path = text([{"time": "2024-05-01T12:00:00Z", "q": "1,5"}, {"time": "2024-05-01T12:00:30Z", "q": "Bad"}] * 2)
    assert values(path, "q", unit="min") == ([0, 0], [1.5, 1.5], [1, 3])
    assert recordings.read(path, ["q"]).notes[1:] == [
        "column q: cells that hold no number are left out: 2, as 'Bad' in line 2."
    ]


@pytest.mark.parametrize("key", ["runs", "data"])
def test_runs_begin_their_clock_anew(text, key):
    runs = [{"t": [0, 1, 2], "y": [1, 2, 3], "tags": ["a"]}, {"t": [0, 1], "y": [4, 5], "tags": []}]
    path = text({"hz": 50, key: runs})
    assert values(path, "y") == ([0, 1, 2, 0, 1], [1, 2, 3, 4, 5], [1, 2, 3, 4, 5])
    assert values(path, "y", period=0.1)[0] == pytest.approx([0, 0.1, 0.2, 0, 0.1])
    read = recordings.read(path, ["y"], period=0.1)
    assert read.notes == [
        "log.json: 5 rows; row k of each run is at k times 0.1 s (period).",
        "the file holds 2 runs; their rows are counted through.",
    ]


def test_a_run_is_as_long_as_its_longest_array(text):
    path = text([{"u": [0, 1, 2], "y": [0, 1, 4], "limits": [0, 1]}, {"u": [3, 4], "y": [5, 6]}])
    assert values(path, "y", period=1) == ([0, 1, 2, 0, 1], [0, 1, 4, 5, 6], [1, 2, 3, 4, 5])


@pytest.mark.parametrize("value", ["", "{", "3", "[]", "{}", '{"a": 1}', '{"a": "b"}', "[1, 2", "[" * 100_000])
def test_what_is_no_recording_is_refused_in_one_line(text, value):
    with pytest.raises(ConfigError, match=r"log.json: expected .*JSON text, got") as refusal:
        recordings.opened(text(value)).columns()
    assert "\n" not in str(refusal.value)
