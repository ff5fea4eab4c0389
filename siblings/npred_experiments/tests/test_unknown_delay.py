"""The two adaptive loops as coded, and the derivatives in them that are no derivatives."""

from types import ModuleType
from typing import Any

import numpy as np
import pytest
from conftest import HERE

from npred.lab import config
from npred_experiments import activator_unknown_delay, chemostat_unknown_delay

STEP = 1e-6


def test_the_chemostat_ends_where_the_published_figure_does():
    X, D_hat = chemostat_unknown_delay.published_loop(1.6)
    assert (*X[-1], D_hat[-1]) == pytest.approx((3.000342, 1.999651, 1.433460), abs=5e-7)
    assert (D_hat.min(), D_hat.max()) == pytest.approx((1.3409, 2.0), abs=5e-5)


@pytest.mark.slow
def test_the_activator_ends_where_the_published_figure_does():
    X, D_hat = activator_unknown_delay.published_loop()
    assert (*X[-1], D_hat[-1]) == pytest.approx((0.09391273, 5.25247145, 0.355024), abs=5e-7)


def test_the_activators_loop_as_meant_is_the_one_that_the_papers_pipeline_draws_first():
    paper, meant = config.load(HERE.parent / "pipeline" / "paper.toml").evaluate, activator_unknown_delay
    assert paper.bounded.input_bounds == [meant.CLIPPED] and paper.input_bounds is None
    assert (paper.D, paper.D_hat, tuple(paper.X0)) == (meant.D, meant.D_HAT, meant.X0)
    assert (paper.gamma, paper.b, paper.bounds, paper.dt) == (meant.GAMMA, meant.B, meant.BOUNDS, meant.DT)


@pytest.mark.slow
def test_the_activators_loop_ends_elsewhere_where_u_may_be_negative():
    """The rest has u* < 0: the loop with U >= 0 ends beside it. Limits: tests/loop/test_closed_loop.py."""
    free, clipped = (activator_unknown_delay.meant(limits=limits) for limits in ((-np.inf, np.inf), (0.0, np.inf)))
    rest = activator_unknown_delay.plant().equilibrium
    assert np.abs(np.subtract(free[:2], rest)).max() < 1e-9 < 1e-6 < abs(clipped[0] - rest[0])
    assert (free[2], clipped[2]) == pytest.approx((1.19226, 0.4975), rel=0.02)


def test_the_activators_first_seconds():
    X, D_hat = activator_unknown_delay.published_loop(steps=800)
    assert (X[0].tolist(), D_hat.max()) == ([0.03, 30.0], pytest.approx(2.0073, abs=5e-5))


@pytest.mark.slow
def test_the_exact_loop_of_signs_has_no_limit_as_the_step_gets_small():
    coarse, fine = (chemostat_unknown_delay.meant(1.6, dt=dt)[2] for dt in (0.002, 0.001))
    assert abs(coarse - fine) > 0.1


def _derivatives(kappa: Any, X: tuple[float, float]) -> tuple[float, float]:
    (x, y), h = X, STEP
    return (
        float(kappa(x + h, y) - kappa(x - h, y)) / (2 * h),
        float(kappa(x, y + h) - kappa(x, y - h)) / (2 * h),
    )


@pytest.mark.parametrize(
    ("module", "X"),
    [
        (chemostat_unknown_delay, (2.5, 1.6)),
        (chemostat_unknown_delay, (2.5, 2.6)),
        (activator_unknown_delay, (0.1, 5.0)),
    ],
)
def test_the_right_slopes_are_derivatives_and_the_published_are_not(module: ModuleType, X: tuple[float, float]):
    expected = _derivatives(module.kappa, X)
    right, published = (slopes(*X)[-2:] for slopes in (module.right_slopes, module.published_slopes))
    assert [float(slope) for slope in right] == pytest.approx(expected, rel=1e-6)
    assert np.abs(np.array(published, dtype=float) - expected).max() > 0.05


def test_the_activators_jacobian():
    x, y, h = 0.1, 5.0, STEP
    f = activator_unknown_delay.rates_on_first
    slope = (f((x, y + h), (0.0,))[0] - f((x, y - h), (0.0,))[0]) / (2 * h)
    assert activator_unknown_delay.right_slopes(x, y)[1] == pytest.approx(slope, rel=1e-6)
    assert activator_unknown_delay.published_slopes(x, y)[1] == pytest.approx(y * slope, rel=1e-6)


def test_the_notebooks_input_moves_the_repressor_too():
    one, both = activator_unknown_delay.rates_on_first, activator_unknown_delay.rates_on_both
    assert np.subtract(both((0.1, 5.0), (1.0,)), one((0.1, 5.0), (1.0,))) == pytest.approx([0.0, 1.0])
