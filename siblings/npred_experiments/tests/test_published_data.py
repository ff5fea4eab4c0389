"""The authors' layout: there and back, the predictor equation as a check, and what a split by rows hides."""

import dataclasses
import errno
import os
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from jobs import job
from typer.testing import CliRunner

from npred import plants
from npred.base.errors import ConfigError
from npred.cli import app
from npred.lab.stages.generate import generate
from npred.lab.training.data.dataset import Dataset
from npred_experiments import published_data

PLANT = plants.resolve("activator_repressor")
SIZES = {"generate": {"rollouts": 20, "samples": 400, "t_end": 20.0, "nx": 21}}


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    made = job(tmp_path_factory.mktemp("interop"), "data", **SIZES)
    generate.run(made)
    return Dataset.read(made.folder / "data.h5")


def join(data):
    """Inputs (N, nx (1 + m + n)) and outputs (N, nx n) of the samples."""
    rows, nodes = data.u.shape[:2]
    repeated = [np.broadcast_to(a, (rows, nodes, a.shape[-1])) for a in (data.D_hat[:, None, None], data.X[:, None])]
    inputs = np.concatenate([repeated[0], data.u, repeated[1]], axis=-1)
    return inputs.reshape(rows, -1), data.P.reshape(rows, -1)


@given(st.data(), st.sampled_from(["activator_repressor", "cart_pole"]), st.integers(2, 6), st.integers(2, 5))
def test_there_and_back(draw, name, rows, nodes):
    plant = plants.resolve(name)
    numbers = st.floats(-1e6, 1e6)
    given_ = {
        "X": draw.draw(arrays(float, (rows, plant.n), elements=numbers)),
        "u": draw.draw(arrays(float, (rows, nodes, plant.m), elements=numbers)),
        "D_hat": draw.draw(arrays(float, rows, elements=st.floats(0, 5))),
        "P": draw.draw(arrays(float, (rows, nodes, plant.n), elements=numbers)),
    }
    rest = np.zeros(rows)
    inputs, outputs = join(Dataset(**given_, D=rest, t=rest, rollout=rest, test=rest))
    assert inputs.shape == (rows, nodes * (1 + plant.m + plant.n)) and outputs.shape == (rows, nodes * plant.n)
    back = published_data.samples(plant, inputs, outputs)
    for key, value in given_.items():
        np.testing.assert_array_equal(getattr(back, key), value)


def test_a_node_is_the_delay_then_the_input_then_the_state(data):
    inputs, outputs = join(data)
    np.testing.assert_array_equal(inputs[3, :4], [data.D_hat[3], data.u[3, 0, 0], *data.X[3]])
    np.testing.assert_array_equal(inputs[3, -4:], [data.D_hat[3], data.u[3, -1, 0], *data.X[3]])
    np.testing.assert_array_equal(outputs[3, -2:], data.P[3, -1])


def test_a_split_by_rollout_keeps_rollouts_whole(data):
    part = published_data.samples(PLANT, *join(data), rollouts=20)
    held_out = set(part.rollout[part.test == 1])
    assert len(held_out) == 2 and part.test.sum() == 40
    assert not held_out & set(part.rollout[part.test == 0])
    _, rows = published_data.split(400, None)
    assert rows.sum() == 40


def test_a_split_by_rows_asks_for_what_was_trained_on(data):
    """Rows of one rollout lie close together: a held-out row has a twin among those to train on."""
    part = published_data.samples(PLANT, *join(data), rollouts=20)
    _, rows = published_data.split(400, None)
    assert published_data.nearest(part, rows) < 0.1 * published_data.nearest(part, part.test)


def test_shuffled_rows_are_seen(data):
    inputs, outputs = join(data)
    order = np.random.default_rng(0).permutation(len(inputs))
    assert published_data.together(published_data.samples(PLANT, inputs, outputs, 20)) > 0.6
    assert published_data.together(published_data.samples(PLANT, inputs[order], outputs[order], 20)) < 0.1


def test_our_own_data_solve_the_predictor_equation(data):
    found = published_data.checks(PLANT, data)
    assert found["start"] == {"x1": 0.0, "x2": 0.0}
    assert max(found["relative"].values()) < 0.03 and found["relative"]["x2"] < 0.003
    assert found["horizon"] == pytest.approx(1, abs=5e-3)


def test_nodes_that_end_before_1_show_in_the_horizon(data):
    short = dataclasses.replace(data, u=data.u[:, :-1], P=data.P[:, :-1])
    assert published_data.checks(PLANT, short)["horizon"] == pytest.approx(0.95, abs=5e-3)


def test_the_input_in_another_equation_shows_in_its_residual(data):
    """What the authors' code does: U drives x2 as well."""
    slope = data.D_hat[:, None] * (np.cumsum(data.u[..., 0], axis=1) - data.u[:, :1, 0]) / 20
    moved = data.P + np.stack([np.zeros_like(slope), 50 * slope], axis=-1)
    found = published_data.checks(PLANT, dataclasses.replace(data, P=moved))["relative"]
    assert found["x2"] > 10 * published_data.checks(PLANT, data)["relative"]["x2"]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda i, o: (i[:, :-1], o), "expected inputs (N, 4 nx) and outputs (N, 2 nx)"),
        (lambda i, o: (o, i), "got (400, 42) and (400, 84); check the plant and the order of the files"),
        (lambda i, o: (i, o[:-1]), "got (400, 84) and (399, 42)"),
        (lambda i, o: (with_value(i, (7, 4), 3.0), o), "expected D_hat the same on every node of a row, got a change"),
        (lambda i, o: (with_value(i, (7, 6), 3.0), o), "expected X the same on every node"),
        (lambda i, o: (i, with_value(o, (9, 0), np.nan)), "expected finite numbers, got others in row 9"),
        (lambda i, o: (i - 50, o), "expected D_hat >= 0"),
    ],
)
def test_what_does_not_fit_is_told(data, change, message):
    with pytest.raises(ConfigError) as caught:
        published_data.samples(PLANT, *change(*join(data)))
    assert message in str(caught.value)


@pytest.mark.parametrize("name", ["unicycle", "unicycle_time_delay"])
def test_a_plant_whose_predictions_the_files_do_not_hold_is_refused(data, name):
    with pytest.raises(ConfigError, match=f"expected one delay and a prediction free of time, got {name}"):
        published_data.samples(plants.resolve(name), *join(data))


def with_value(array, index, value):
    changed = array.copy()
    changed[index] = value
    return changed


@pytest.mark.parametrize("rollouts", [3, 401, 1])
def test_rollouts_must_divide_the_rows(rollouts):
    with pytest.raises(ConfigError, match="give --rollouts a divisor"):
        published_data.split(400, rollouts)


def test_files_that_are_no_matrix_of_numbers_are_told(tmp_path):
    path = tmp_path / "a.npy"
    for write in (
        lambda: path.write_bytes(b"no array"),
        lambda: np.save(path, np.array([{"a": 1}], dtype=object), allow_pickle=True),
        lambda: np.save(path, np.zeros(5)),
        lambda: np.save(path, np.array([["a", "b"]])),
        lambda: np.savez(path.open("wb"), a=np.zeros((2, 2))),
        lambda: cut_short(path),
        lambda: np.save(path, np.zeros((0, 4))),
        lambda: path.write_bytes(b"PK\x03\x04 cut short"),
        lambda: with_header(path, b"{'shape': (("),
        lambda: with_header(path, b"{'descr': '<f8', 'fortran_order': False, 'shape': (%d, 4)}" % 2**62),
        lambda: with_header(path, b"{'descr': '<f8', 'fortran_order': False, 'shape': (%d, 4)}" % 2**70),
        lambda: with_header(path, b"{'descr': '<f8', 'fortran_order': False, 'shape': (-2, 4)}"),
        lambda: with_header(path, b"{'descr': '<f8', 'fortran_order': False, 'shape': " + b"(" * 5000),
        lambda: with_header(path, b"{'descr': [['<f8']], 'fortran_order': False, 'shape': (2, 4)}"),
        lambda: with_header(path, b"{'descr': '<f8', 'fortran_order': 3, 'shape': (2, 4)}"),
        lambda: with_header(path, b"{'descr': '<f8', 'fortran_order': False, 'shape': 4}"),
        lambda: with_header(path, b"{[]: 3}"),
        lambda: with_header(path, b" " * 20000),
    ):
        write()
        with pytest.raises(ConfigError, match=r"a\.npy: expected") as caught:
            published_data.read(path)
        assert len(str(caught.value).splitlines()) == 1
    with pytest.raises(ConfigError, match="No such file"):
        published_data.read(tmp_path / "none.npy")


def test_a_pipe_is_no_matrix(tmp_path):
    os.mkfifo(tmp_path / "pipe.npy")
    with pytest.raises(ConfigError, match=r"pipe\.npy: expected an \.npy file of numbers, got: .*a pipe"):
        published_data.read(tmp_path / "pipe.npy")


def cut_short(path):
    """A header that promises more than the file holds, as a hostile one would."""
    np.save(path, np.zeros((1000, 8)))
    path.write_bytes(path.read_bytes()[:200])


def with_header(path, header):
    """An .npy file of version 1 with that header and a few bytes of data."""
    path.write_bytes(b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header + bytes(64))


@pytest.fixture
def bring(data, tmp_path, monkeypatch, capsys):
    """The command in an empty folder, on such a pair of files: its exit code, stdout and stderr."""
    monkeypatch.chdir(tmp_path)
    for name, array in zip(("i.npy", "o.npy"), join(data), strict=True):
        np.save(name, array)

    def call(*arguments):
        code = published_data.main(["i.npy", "o.npy", *arguments])
        return code, *capsys.readouterr()

    return call


def test_the_file_holds_the_samples_and_people_are_told_of_them(bring, data):
    code, told, doubts = bring("--rollouts", "20")
    assert (code, doubts) == (0, "")
    for words in ("400 samples on 21 nodes", "split by rows: 40 rows held out", 'data = "theirs.h5" below [generate]'):
        assert words in told
    back = Dataset.read(Path("theirs.h5"))
    for name in ("X", "u", "D_hat", "P", "rollout"):
        np.testing.assert_array_equal(getattr(back, name), getattr(data, name))
    Path("theirs.toml").write_text('plant = "activator_repressor"\n[generate]\ndata = "theirs.h5"\n')
    done = CliRunner().invoke(app, ["generate", "theirs.toml", "--store", "store"])
    assert done.exit_code == 0 and "400 samples of 20 rollouts" in done.stdout


def test_doubts_are_warned_of(bring):
    outputs, inputs = np.load("o.npy").reshape(400, 21, 2), np.load("i.npy").reshape(400, 21, 4)
    order = np.random.default_rng(0).permutation(400)
    np.save("i.npy", inputs[order, :-1].reshape(400, -1))
    np.save("o.npy", (outputs * [1.0, 1.5])[order, :-1].reshape(400, -1))
    _, _, warned = bring("--rollouts", "20")
    for words in ("x2: P = X + D_hat ∫ f(P, u) leaves", "do the nodes end at x = 1?", "the rows look shuffled"):
        assert words in warned


def test_a_residual_that_is_no_number_is_doubted(bring):
    """The square of what P moves leaves the finite numbers, and a NaN is above no limit."""
    outputs = np.load("o.npy")
    outputs[3, -1] = 1e200
    np.save("o.npy", outputs)
    code, _, warned = bring()
    assert code == 0 and "x2: P = X + D_hat ∫ f(P, u) leaves" in warned and "Warning" not in warned


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--output", "i.npy"), "--output: expected another file than the two, got i.npy; name one"),
        (("--plant", "cart_pole"), "expected inputs (N, 6 nx) and outputs (N, 4 nx) for plant cart_pole"),
    ],
)
def test_mistakes_are_told_in_one_line(bring, arguments, words):
    code, told, said = bring(*arguments)
    assert (code, told) == (2, "") and len(said.splitlines()) == 1 and words in said


def test_a_full_disk_is_one_line(bring, monkeypatch):
    def full(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(Dataset, "write", full)
    code, told, said = bring()
    assert (code, told) == (1, "") and "expected room to write, got a full disk" in said
