"""CMA-ES against functions whose maximum is known."""

import numpy as np
import pytest

from npred_experiments import evolution


def evolved(score, starts, steps, seed=0):
    points, counts = [], []

    def noted(x):
        points.append(x)
        return score(x)

    evolution.evolve(noted, starts, steps, np.random.default_rng(seed), counts.append)
    return np.array(points), counts


def test_it_comes_to_the_maximum_of_an_ill_conditioned_quadratic():
    rng = np.random.default_rng(3)
    Q, _ = np.linalg.qr(rng.normal(size=(8, 8)))
    top, A = rng.normal(size=8), Q * np.logspace(0, 4, 8) @ Q.T
    points, counts = evolved(lambda x: -np.einsum("bi,ij,bj->b", x - top, A, x - top), np.zeros((20, 8)), 400)
    assert np.linalg.norm(points - top, axis=-1).min() < 1e-4
    assert counts == [20] * 400 and points.shape == (400, 20, 8)


@pytest.mark.parametrize(("rows", "asked"), [(1, 4), (3, 4), (19, 19), (31, 31), (50, 50)])
def test_a_point_for_each_start_and_four_at_least(rows, asked):
    points, _ = evolved(lambda x: -(x**2).sum(axis=1), np.ones((rows, 5)), 3)
    assert points.shape == (3, asked, 5)


def test_a_distribution_that_has_converged_starts_again():
    """On a flat score it stops at once; its points then are near another of its starts."""
    starts = 100.0 * np.arange(10)[:, None] * np.ones(3)
    points, _ = evolved(lambda x: np.zeros(len(x)), starts, 200)
    assert len(np.unique(np.round(points[..., 0] / 100))) > 3


def test_scores_that_are_no_numbers_are_the_worst():
    points, _ = evolved(lambda x: np.where(x[:, 0] > 0.5, np.nan, x[:, 0]), np.zeros((20, 3)), 120)
    x = points[..., 0]
    assert x[x <= 0.5].max() > 0.499 and x.max() < 5  # it goes up to the edge, and not on where there are no scores


def test_the_same_seed_gives_the_same_points_and_numpys_own_generator_is_left_alone():
    before = np.random.get_state()[1].copy()
    one, two, other = (evolved(lambda x: -(x**2).sum(axis=1), np.ones((8, 4)), 30, seed)[0] for seed in (5, 5, 6))
    np.testing.assert_array_equal(one, two)
    assert (one != other).any()
    np.testing.assert_array_equal(np.random.get_state()[1], before)


def test_many_coordinates_take_a_diagonal(monkeypatch):
    monkeypatch.setattr(evolution, "FULL", 5)
    points, _ = evolved(lambda x: -(x**2).sum(axis=1), np.ones((20, 12)), 150)
    assert np.linalg.norm(points[-1], axis=-1).min() < 0.05


@pytest.mark.parametrize("nx", [2, 5, 21, 50, 101])
@pytest.mark.parametrize("shape", evolution.SHAPES)
def test_every_shape_reaches_every_history(shape, nx):
    basis = evolution.SHAPES[shape](nx)
    np.testing.assert_allclose(np.linalg.inv(basis) @ basis, np.eye(nx), atol=1e-9)


def test_stairs_jump_and_lines_bend_in_the_middle_first():
    np.testing.assert_allclose(evolution.stairs(4)[:3], [[1, 1, 1, 1], [1, 1, -1, -1], [0.5, -0.5, 0, 0]])
    np.testing.assert_allclose(evolution.lines(5)[:3], [[1, 1, 1, 1, 1], [-1, -0.5, 0, 0.5, 1], [0, 0.5, 1, 0.5, 0]])


def test_waves_reach_smooth_histories_first():
    waves = evolution.waves(21)
    drawn = np.random.default_rng(0).normal(size=(200, 21)) @ waves
    kinks = np.abs(np.diff(drawn, 2)).sum(axis=1) / np.ptp(drawn, axis=1)
    assert np.median(kinks) < 3 < np.median(np.abs(np.diff(np.random.default_rng(1).normal(size=(200, 21)), 2)).sum(1))
