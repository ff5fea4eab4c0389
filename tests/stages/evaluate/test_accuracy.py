"""Held-out rows of every kind: exploring rollouts and redrawn rows that are not in the data, and their errors."""

from dataclasses import replace

import numpy as np
import pytest
from conftest import settings_of
from jobs import job, tables

from npred import plants
from npred.base.errors import DivergedError
from npred.lab import config
from npred.lab.scheduler.plan import Node
from npred.lab.stages.evaluate import accuracy
from npred.lab.stages.generate import generate, sampling
from npred.lab.training.data.dataset import Dataset
from npred.prediction.methods import RK4, Euler

PLANT = plants.resolve("activator_repressor")
RANGES = {"D": 1.0, "D_hat": [(0.9, 1.1)], "explore_D": (0.3, 0.4), "explore_D_hat": (3.0, 3.5), "explore": 0.4}


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Data of which 4 of 10 rollouts explore, and what is held out of each kind."""
    task = job(tmp_path_factory.mktemp("kinds"), "data", generate=RANGES | {"redraw": 0.5, "test_share": 0.5})
    generate.run(task)
    data = Dataset.read(task.folder / "data.h5")
    return task, data, accuracy.held_out(task, data)


def test_every_kind_that_is_trained_on_is_held_out(made):
    _, data, held_out = made
    assert {kind: len(rows.X) for kind, rows in held_out.items()} == {"nominal": 90, "exploring": 60, "redrawn": 150}
    test = data.subset(test=True)
    np.testing.assert_array_equal(held_out["nominal"].P, test.P)
    for rows in held_out.values():
        np.testing.assert_allclose(rows.P, RK4(PLANT)(rows.X, rows.u, rows.D_hat), rtol=1e-9)
    redrawn = held_out["redrawn"]
    assert ((redrawn.D_hat >= 3.0) & (redrawn.D_hat <= 3.5)).all()
    np.testing.assert_array_equal(redrawn.X, np.concatenate([test.X, held_out["exploring"].X]))


def test_redrawn_rows_are_held_out_off_the_loop_as_they_are_trained_on(made):
    task, data, held_out = made
    apart = task.config.model_copy(update={"generate": task.config.generate.model_copy(update={"spread": 0.1})})
    moved = accuracy.held_out(replace(task, config=apart), data)
    np.testing.assert_array_equal(moved["nominal"].X, held_out["nominal"].X)
    rows = moved["redrawn"]
    assert (rows.X != held_out["redrawn"].X).all() and (rows.u != held_out["redrawn"].u).any(axis=(1, 2)).all()
    np.testing.assert_allclose(rows.P, RK4(PLANT)(rows.X, rows.u, rows.D_hat), rtol=1e-9)


def test_no_row_that_is_trained_on_is_held_out(made):
    _, data, held_out = made
    trained = {row.tobytes() for row in data.subset(test=False).u}
    assert len(trained) > 200
    for rows in held_out.values():
        assert not trained & {row.tobytes() for row in rows.u}


def test_held_out_explorers_are_as_those_that_are_trained_on(made):
    task, _, held_out = made
    columns = sampling.rows(task.config, PLANT, range(10, 12))
    assert ((columns["D"] >= 0.3) & (columns["D"] <= 0.4)).all()
    np.testing.assert_array_equal(columns["X"], held_out["exploring"].X)
    first = columns["D_hat"][columns["t"] < 0.1]
    assert len(first) and ((first >= 3.0) & (first <= 3.5)).all(), "the loop's own estimate, not one drawn anew"


def test_explorers_held_out_leave_the_rows_of_the_data_alone(made):
    task, data, _ = made
    again = sampling.rows(task.config, PLANT, range(10))
    assert all(again[name].tobytes() == getattr(data, name).tobytes() for name in again)


def test_as_large_a_share_of_explorers_is_held_out_as_of_the_others():
    paper = config.Generate(samples=100_000, rollouts=1000, explore=0.5)
    assert sampling.explorers(paper, 400) == range(1000, 1050)
    assert sampling.explorers(paper, 7) == range(1000, 1007)
    assert not sampling.explorers(config.Generate(samples=100_000, rollouts=1000), 400)
    assert len(sampling.explorers(config.Generate(samples=100, rollouts=10, explore=0.1), 400)) == 1
    assert accuracy._most(PLANT, paper) > 50
    assert accuracy._most(PLANT, config.Generate(samples=10**6, rollouts=2, t_end=1e4, nx=1001)) == 1


def test_the_share_of_explorers_is_part_of_the_evaluations_key_where_data_are_the_same():
    """One of the 2 other rollouts is held out with either share, but of 8 explorers one or two."""
    few, many = (config.parse(tables(generate={"explore": 0.8, "test_share": share}), "tests") for share in (0.1, 0.2))
    assert sampling.spared(0, few.generate) == sampling.spared(0, many.generate)
    assert len(sampling.explorers(few.generate, 99)) < len(sampling.explorers(many.generate, 99))
    node = Node("evaluate", None, ())
    assert settings_of(node, few) != settings_of(node, many)
    plain = config.parse(tables(generate={"test_share": 0.2}), "tests")
    assert "generate" not in settings_of(node, plain)


def test_data_that_neither_explore_nor_redraw_have_one_kind(made):
    task, data, _ = made
    plain = replace(task, config=config.parse(task.config.model_dump() | {"generate": {"samples": 300}}, "tests"))
    assert list(accuracy.held_out(plain, data)) == ["nominal"]
    redraw = task.config.model_dump() | {"generate": {"redraw": 0.5, "nx": 21}}
    found = accuracy.held_out(replace(task, config=config.parse(redraw, "tests")), data)
    assert list(found) == ["nominal", "redrawn"] and len(found["redrawn"].X) == len(found["nominal"].X)


def test_nobody_knows_the_kind_of_imported_rows(made, tmp_path):
    task, data, held_out = made
    again = job(tmp_path, "again", generate={"data": str(task.folder / "data.h5"), "explore": 0.5, "redraw": 0.5})
    found = accuracy.held_out(again, data)
    assert list(found) == ["imported"]
    np.testing.assert_array_equal(found["imported"].X, held_out["nominal"].X)


def test_a_held_out_explorer_that_diverges_is_left_out_with_a_note(tmp_path, made):
    """States that Euler's method leaves the finite numbers from, at the delay estimates of explorers only."""
    lost = {"explore": 0.4, "explore_D_hat": (0.9, 1.1), "box": {"x1": [1e200, 1e200]}}
    task = job(tmp_path, "lost", generate=lost)
    with pytest.raises(DivergedError):
        sampling.rows(task.config, PLANT, range(10, 11))
    assert list(accuracy.held_out(task, made[1])) == ["nominal"]
    assert any("exploring held-out rows have no finite P; left out" in note for note in task.progress.notes)


def test_errors_by_kind_are_those_of_the_kinds_own_rows(made):
    """Euler's method in the place of a network: `above` counts rows above the first kind's largest error."""
    _, _, held_out = made
    P_hat = {kind: Euler(PLANT)(rows.X, rows.u, rows.D_hat) for kind, rows in held_out.items()}
    found = accuracy.by_kind(PLANT, P_hat, held_out)
    for kind, rows in held_out.items():
        sup = np.linalg.norm(P_hat[kind] - rows.P, axis=-1).max(axis=1)
        assert found[kind].eps_sup == sup.max()
        assert found[kind].mse == np.mean((P_hat[kind] - rows.P) ** 2)
        assert found[kind].above == np.mean(sup > found["nominal"].eps_sup)
    assert found["nominal"].above == 0.0 < found["redrawn"].above
