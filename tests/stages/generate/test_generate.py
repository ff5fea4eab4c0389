"""The generate stage: rows that solve the predictor equation, split by rollout, whatever the number of jobs."""

import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from jobs import job, tables

from npred import plants
from npred.base import json_files
from npred.base.errors import ConfigError, DivergedError
from npred.lab import config
from npred.lab.scheduler.executors import Processes
from npred.lab.stages.generate import generate, sampling
from npred.lab.training.data import shards
from npred.lab.training.data.dataset import MEANING, Dataset
from npred.loop.simulation import LANES
from npred.prediction.methods import RK4


def rows(tmp_path, name="data", **changes):
    made = job(tmp_path, name, **changes)
    return generate.run(made), Dataset.read(made.folder / "data.h5")


def test_rows_are_what_they_say(tmp_path):
    result, data = rows(tmp_path)
    assert result.samples == len(data) == 300 and data.u.shape == (300, 21, 1) and data.P.shape == (300, 21, 2)
    np.testing.assert_array_equal(data.P[:, 0], data.X)
    exact = RK4(plants.resolve("activator_repressor"))(data.X, data.u, data.D_hat)
    np.testing.assert_allclose(data.P, exact, rtol=1e-9)
    assert (np.diff(data.rollout) >= 0).all() and set(np.bincount(data.rollout)) == {30}
    assert data.t.min() < 0.8 and data.t.max() > 7.2, "the start of the rollouts is in the data"
    assert ((data.D_hat >= 0.05) & (data.D_hat <= 4.0)).all()


def test_no_rollout_is_in_both_parts(tmp_path):
    result, data = rows(tmp_path)
    held_out = set(data.rollout[data.test == 1])
    assert held_out == set(result.held_out) and len(held_out) == 1
    assert not held_out & set(data.rollout[data.test == 0])


@pytest.mark.slow
def test_neither_threads_nor_processes_change_the_bytes(tmp_path, monkeypatch):
    changes = {"rollouts": 130, "samples": 1000}
    two = Processes(2)
    generate.run(job(tmp_path, "one", generate=changes))
    monkeypatch.setattr(sampling, "elsewhere", None)
    generate.run(job(tmp_path, "threads", executor=two, generate=changes))
    monkeypatch.undo()
    monkeypatch.setattr(sampling, "compiled", lambda pipeline, plant: False)
    monkeypatch.setattr(sampling, "rows", None)  # here; the processes have it
    generate.run(job(tmp_path, "processes", executor=two, generate=changes))
    two.shutdown()
    one, *others = ((tmp_path / name / "data.h5").read_bytes() for name in ("one", "threads", "processes"))
    assert others == [one, one]


LAW = """\
from npred import DelayLaw
class Still(DelayLaw):
    def rate(self, plant, X, u, P, D_hat, t): return 0 * D_hat
"""


@pytest.mark.parametrize(
    ("table", "expected"),
    [({}, True), ({"adaptation": "frozen"}, True), ({"predictor": "rk4"}, True), ({"adaptation": "FILE:Still"}, False)],
)
def test_loops_are_compiled_unless_a_part_is_python(tmp_path, table, expected):
    (tmp_path / "law.py").write_text(LAW)
    table = {key: value.replace("FILE", str(tmp_path / "law.py")) for key, value in table.items()}
    made = job(tmp_path, "data", generate=table)
    assert sampling.compiled(made.config, made.plant) is expected


def test_a_thread_ends_at_the_next_report_of_progress(tmp_path):
    made = job(tmp_path, "data")

    def stop(steps):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        sampling.rows(made.config, made.plant, range(3), progress=stop)


def test_all_threads_are_told_to_end(tmp_path, monkeypatch):
    two, told = Processes(2), []
    made = job(tmp_path, "data", executor=two, generate={"rollouts": 130, "samples": 1000})

    def stopped(pipeline, plant, batch, progress):
        made.progress.stop()
        with pytest.raises(KeyboardInterrupt):
            progress(1)
        told.append(batch)
        raise KeyboardInterrupt

    monkeypatch.setattr(sampling, "rows", stopped)
    with pytest.raises(KeyboardInterrupt):
        generate.run(made)
    two.shutdown()
    assert told


SHARDED = {"rollouts": 200, "samples": 600, "t_end": 2.0}  # of 64 rollouts a shard: four


@pytest.fixture
def little(monkeypatch):
    """Data of a few kilobytes count as large."""
    monkeypatch.setattr(shards, "WHOLE", 1)
    monkeypatch.setattr(shards, "SHARD", 1)


def payload(folder):
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def test_shards_hold_the_rows_of_the_one_file(tmp_path, monkeypatch):
    result, whole = rows(tmp_path, "whole", generate=SHARDED)
    monkeypatch.setattr(shards, "WHOLE", 1)
    monkeypatch.setattr(shards, "SHARD", 1)
    again, joined = rows(tmp_path, "joined", generate=SHARDED)
    assert again == result.model_copy(update={"shards": 4})
    assert [len(part) for part in shards.parts(tmp_path / "joined" / "data.h5")] == [192, 192, 192, 24]
    for name in MEANING:
        assert getattr(joined, name).tobytes() == getattr(whole, name).tobytes()


def test_an_interrupted_run_keeps_its_shards(tmp_path, little, monkeypatch):
    whole = job(tmp_path, "whole", generate=SHARDED)
    generate.run(whole)
    made, real = [], sampling.elsewhere

    def stopped(pipeline, expected, batch):
        if made == [0, 64]:
            raise KeyboardInterrupt
        made.append(batch.start)
        return real(pipeline, expected, batch)

    monkeypatch.setattr(sampling, "elsewhere", stopped)
    broken = job(tmp_path, "broken", generate=SHARDED)
    with pytest.raises(KeyboardInterrupt):
        generate.run(broken)
    made.clear()
    (folder,) = broken.scratch.glob("shards-*")
    _flip(next(folder.glob("data-00000.h5.*")))
    (folder / ".data-00002.h5-killed").write_bytes(b"half")
    generate.run(broken)
    assert made == [0, 128, 192] and payload(broken.folder) == payload(whole.folder)
    kept = {generate.TOKEN, *(f"{shards.name(k)}.{json_files.sha256(whole.folder / shards.name(k))}" for k in range(4))}
    assert {path.name for path in folder.iterdir()} == kept


def _flip(path):
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 1
    path.write_bytes(content)


def test_a_shard_that_cannot_be_written_leaves_nothing(tmp_path, little, monkeypatch):
    def full(self, path, attributes):
        path.write_bytes(b"half")
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Dataset, "write", full)
    stopped = job(tmp_path, "full", generate=SHARDED)
    with pytest.raises(OSError, match="No space left"):
        generate.run(stopped)
    assert [p.name for p in stopped.scratch.rglob("*") if p.is_file()] == [generate.TOKEN]


def test_a_worker_that_does_not_see_the_folder_sends_its_shard_back(tmp_path, little, monkeypatch):
    near, far = (job(tmp_path, name, generate=SHARDED) for name in ("near", "far"))
    generate.run(near)
    monkeypatch.setattr(generate.ShardFolder, "shared", lambda folder: False)
    generate.run(far)
    assert payload(far.folder) == payload(near.folder)
    assert not [path for path in far.scratch.rglob("*") if path.name.startswith(".data")]


def test_a_folder_of_the_same_name_elsewhere_is_not_taken_for_the_same(tmp_path):
    folder = generate.ShardFolder(tmp_path, "a")
    assert not folder.shared()
    (tmp_path / generate.TOKEN).write_text("b")
    assert not folder.shared() and generate.ShardFolder(tmp_path, "b").shared()


def test_the_data_of_the_paper_are_one_file_and_ten_million_samples_are_not():
    plant = plants.resolve("activator_repressor")
    assert not generate.sharded(plant, config.Generate(samples=100_000, rollouts=1000, nx=101))
    assert generate.sharded(plant, config.Generate(samples=10_000_000, rollouts=50_000, nx=21))


@given(st.integers(2, 5000), st.integers(1, 64))
def test_batches_part_the_rollouts_at_whole_chunks(count, workers):
    batches = generate._ranges(config.Generate(rollouts=count, samples=count), workers)
    assert [r for batch in batches for r in batch] == list(range(count))
    assert all(batch.start % LANES == 0 and len(batch) <= generate.BATCH for batch in batches)


def test_batches_do_not_change_the_bytes():
    """Two chunks in one batch, or each in its own."""
    pipeline = config.parse(tables(generate={"rollouts": 70, "samples": 210, "t_end": 2.0}), "tests")
    plant = plants.resolve(pipeline.plant)
    whole = sampling.rows(pipeline, plant, range(70))
    parts = sampling.joined([sampling.rows(pipeline, plant, batch) for batch in (range(64), range(64, 70))])
    assert {name: a.tobytes() for name, a in whole.items()} == {name: a.tobytes() for name, a in parts.items()}


def test_a_worker_that_would_give_other_rows_is_refused():
    pipeline = config.parse(tables(), "tests")
    expected = sampling.surroundings(pipeline, plants.resolve(pipeline.plant)) | {"numpy": "0.1"}
    with pytest.raises(ConfigError, match=r"expected the same numpy on every worker, got another"):
        sampling.elsewhere(pipeline, expected, range(10))


def test_a_plant_file_is_found_from_another_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    here = config.parse({"plant": "my_plant.py:Tank"}, "tests")
    assert here.with_absolute_paths().plant == f"{tmp_path}/my_plant.py:Tank"
    assert config.parse({"plant": "scalar"}, "tests").with_absolute_paths().plant == "scalar"


def test_seed_and_shares(tmp_path):
    _, data = rows(tmp_path, "a", generate={"samples": 305})
    assert np.bincount(data.rollout).tolist() == [31] * 5 + [30] * 5
    _, other = rows(tmp_path, "b", generate={"samples": 305}, seed=1)
    assert not np.array_equal(data.X, other.X)


def test_more_rollouts_leave_the_first_ones_alone(tmp_path):
    """Each rollout has its own seed: the starts of the first do not depend on how many follow."""
    one = {"D_hat": [(1.0, 2.0)], "D": [0.5, 1.5]}
    _, few = rows(tmp_path, "few", generate=one)
    _, many = rows(tmp_path, "many", generate=one | {"rollouts": 20, "samples": 600})
    for r in range(10):
        assert few.D[few.rollout == r][0] == many.D[many.rollout == r][0]


def test_delays_are_drawn_from_their_ranges(tmp_path):
    _, data = rows(tmp_path, generate={"D": [0.5, 1.5]})
    assert 0.5 <= data.D.min() < data.D.max() <= 1.5


def test_a_diverging_rollout_is_told(tmp_path):
    with pytest.raises(DivergedError, match=r"NaN in rollout \d+ at t = .* s, from X0 = .*; shrink the box, D or dt"):
        rows(tmp_path, generate={"box": {"x1": [1e200, 1e200]}})


def test_summary_says_the_numbers(tmp_path):
    result, _ = rows(tmp_path)
    assert generate.summary(result) == "300 samples of 10 rollouts on 21 nodes, 1 rollout held out"


def test_explorers_have_delays_of_their_own_and_are_not_held_out(tmp_path):
    ranges = {"D": 1.0, "D_hat": [(0.9, 1.1), (1.9, 2.1)], "explore_D": (0.3, 0.4), "explore_D_hat": (3.0, 3.5)}
    result, data = rows(tmp_path, generate=ranges | {"explore": 0.5, "test_share": 0.4})
    explorers = data.rollout >= 5
    assert ((data.D[explorers] >= 0.3) & (data.D[explorers] <= 0.4)).all() and (data.D[~explorers] == 1).all()
    assert len(result.held_out) == 2 and max(result.held_out) < 5


def test_two_rollouts_at_least_do_not_explore():
    assert config.Generate(explore=0.99, rollouts=50).explorers == 48


def test_redrawn_delay_estimates_are_labelled_anew_and_spare_the_held_out_rows(tmp_path):
    one = {"D_hat": [(1.0, 2.0)], "D": 1.0, "explore_D_hat": (3.0, 3.5)}
    _, plain = rows(tmp_path, "plain", generate=one)
    _, data = rows(tmp_path, "redrawn", generate=one | {"redraw": 0.5})
    changed = data.D_hat != plain.D_hat
    assert 0.35 < changed[data.test == 0].mean() < 0.65 and not changed[data.test == 1].any()
    assert ((data.D_hat[changed] >= 3.0) & (data.D_hat[changed] <= 3.5)).all()
    np.testing.assert_array_equal(data.u, plain.u)
    np.testing.assert_allclose(
        data.P, RK4(plants.resolve("activator_repressor"))(data.X, data.u, data.D_hat), rtol=1e-9
    )


def test_redrawn_rows_are_off_the_loop_by_up_to_spread_and_by_far_less(tmp_path):
    one = {"D_hat": [(1.0, 2.0)], "D": 1.0, "redraw": 0.5}
    _, plain = rows(tmp_path, "plain", generate=one)
    _, data = rows(tmp_path, "spread", generate=one | {"spread": 0.1})
    np.testing.assert_array_equal(data.D_hat, plain.D_hat)
    moved = (data.X != plain.X).any(axis=1)
    assert 0.35 < moved[data.test == 0].mean() < 0.65 and not moved[data.test == 1].any()
    np.testing.assert_array_equal(data.u[~moved], plain.u[~moved])
    of_u = np.abs(data.u - plain.u)[moved].max(axis=(1, 2)) / plain.u.std()
    assert of_u.min() < 0.01 and 0.05 < of_u.max() < 1.0
    pushes = (data.u - plain.u)[moved, :, 0]
    assert np.abs(np.diff(pushes, 7)).max() < 1e-2 * np.abs(pushes).max(), "smooth, a polynomial of degree 5"
    np.testing.assert_allclose(
        data.P, RK4(plants.resolve("activator_repressor"))(data.X, data.u, data.D_hat), rtol=1e-9
    )


NOISY = {"measurement": {"relative_noise": 0.02, "period": 0.1}, "actuator": "history"}


def test_noise_is_the_rollouts_own_whatever_the_batches(tmp_path, monkeypatch):
    nominal = rows(tmp_path, "nominal", generate=SHARDED)[1]
    _, whole = rows(tmp_path, "whole", generate=SHARDED | NOISY)
    monkeypatch.setattr(shards, "WHOLE", 1)
    monkeypatch.setattr(shards, "SHARD", 1)
    _, joined = rows(tmp_path, "joined", generate=SHARDED | NOISY)
    assert all(getattr(joined, name).tobytes() == getattr(whole, name).tobytes() for name in MEANING)
    assert not np.array_equal(whole.X, nominal.X)
    exact = RK4(plants.resolve("activator_repressor"))(whole.X, whole.u, whole.D_hat)
    np.testing.assert_allclose(whole.P, exact, rtol=1e-9)


DECLARED = """
class Declared:
    states, inputs, box = ("x",), ("u",), {"x": (0.5, 1.0)}
    parameters = {"slope": 0.1}
    def f(x, u, t, p, M): return [0.3 * x.x + u.u]
    def kappa(x, t, p, M): return [-2 * x.x]
    def delay(x, t, p, M): return 0.5 + p.slope * x.x
"""


@pytest.fixture
def declared(tmp_path):
    path = tmp_path / "declared.py"
    path.write_text(DECLARED)
    return f"{path}:Declared"


def test_the_declared_delay_takes_the_place_of_D_hat(tmp_path, declared):
    _, data = rows(tmp_path, plant=declared)
    np.testing.assert_allclose(data.D_hat, 0.5 + 0.1 * data.X[:, 0], rtol=1e-12)
    np.testing.assert_array_equal(data.D, data.D_hat)
    plant = plants.resolve(declared)
    np.testing.assert_allclose(data.P, RK4(plant)(data.X, data.u, data.D_hat, data.t), rtol=1e-9)
    assert np.ptp(data.X) > 0.5 and np.isfinite(data.P).all()


def test_commands_that_overtake_each_other_name_rollout_step_state_and_value(tmp_path, declared):
    with pytest.raises(DivergedError) as error:
        generate.run(job(tmp_path, "data", plant=declared, generate={"u0": [12.0]}))
    words = r"overtake each other in 10 of 10 rollouts, in rollout 0 first at control step 0, x = 0.[\d]+: 1 - D_X"
    found = re.search(words + r" f - D_t = (-0.[\d]+), expected above 0; shrink the box", str(error.value))
    assert found is not None, error.value
    assert -0.231 < float(found[1]) < -0.2  # 1 - 0.1 (0.3 x + 12)


def test_each_range_of_estimates_has_an_equal_share_of_the_rollouts(tmp_path):
    task = job(tmp_path, "any", generate={"D_hat": [(0.5, 0.6), (1.5, 1.6)]})
    _, _, D_hat, _ = sampling.starts(0, task.config.generate, task.plant, range(10))
    assert ((D_hat[:5] >= 0.5) & (D_hat[:5] <= 0.6)).all() and ((D_hat[5:] >= 1.5) & (D_hat[5:] <= 1.6)).all()


def test_displacements_are_of_all_orders_of_magnitude_and_smooth():
    """Their size s has ln s uniform on [ln .005, ln .5]: E ln s = ln .05, E s² = .25 (1 - 1e-4) / ln 1e4.

    Those of u are Legendre series on [0, 1] whose k-th coefficient has the standard deviation s / (1 + k).
    """
    rng, of = np.random.default_rng(3), config.Generate(spread=0.5)
    X, u = rng.normal(size=(20_000, 2)) * [1.0, 50.0], rng.normal(size=(20_000, 11, 1)) * 4.0
    aside, push = (a / b.std(axis=0) for a, b in zip(sampling.spread(rng, of, X, u), (X, u.ravel()), strict=True))
    square = 0.25 * (1 - 1e-4) / np.log(1e4)
    np.testing.assert_allclose((aside**2).mean(axis=0), square, rtol=0.1)
    log_normal = -(np.log(2) + np.euler_gamma) / 2  # E ln |z| of a standard normal z
    np.testing.assert_allclose(np.log(np.abs(aside)).mean(axis=0), np.log(0.05) + log_normal, atol=0.05)
    x = 2 * np.linspace(0, 1, 11) - 1
    coefficients = np.polynomial.legendre.legfit(x, push[..., 0].T, 8)  # (9, N)
    np.testing.assert_allclose((coefficients[:6] ** 2).mean(axis=1), square / np.arange(1, 7) ** 2, rtol=0.15)
    assert np.abs(coefficients[6:]).max() < 1e-12
