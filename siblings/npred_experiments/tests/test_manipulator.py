"""The arm: its matrices against the recursive algorithms and an energy identity, the loop against its digits."""

import numpy as np
import pytest

from npred_experiments import baxter, manipulator
from npred_robots import denavit_hartenberg, rigid_body

Q, RATES = np.array([0.3, -0.5, 0.2, 1.0, 0.4]), np.array([0.5, -0.2, 0.3, 0.1, -0.6])


def test_the_matrices_are_those_of_the_recursive_algorithms():
    M, h, G = baxter.dynamics(Q, RATES, baxter.pseudo_inertia(about_centre=True))
    bodies, math = denavit_hartenberg.bodies(baxter.TABLE), np
    assert np.array(rigid_body.mass_matrix(bodies, list(Q), math), float) == pytest.approx(M, abs=1e-13)
    loads = rigid_body.torques(bodies, list(Q), list(RATES), [0.0] * 5, baxter.GRAVITY, math)
    assert np.array(loads, float) == pytest.approx(h + G, abs=1e-12)


@pytest.mark.parametrize("about_centre", [True, False])
def test_both_kinds_of_matrices_agree(about_centre: bool):
    states = np.random.default_rng(0).standard_normal((2, 7, 5))
    expected = baxter.dynamics(*states, baxter.pseudo_inertia(about_centre))
    for ours, theirs in zip(manipulator.recursive(about_centre)(*states), expected, strict=True):
        assert ours == pytest.approx(theirs, abs=1e-12)


@pytest.mark.parametrize("about_centre", [True, False])
def test_coriolis_torques_do_half_the_work_of_the_changing_mass(about_centre: bool):
    """q' · h = q' M' q' / 2 at any rate, and the published q' · (h · q') 1 is no such thing."""
    J, step = baxter.pseudo_inertia(about_centre), 1e-6
    ends = [baxter.dynamics(Q + sign * step * RATES, RATES, J)[0] for sign in (1, -1)]
    work = RATES @ (ends[0] - ends[1]) @ RATES / (2 * step) / 2
    h = baxter.dynamics(Q, RATES, J)[1]
    assert RATES @ h == pytest.approx(work, rel=1e-6)
    assert abs(RATES @ manipulator.spun(h, RATES) - work) > 0.5 * abs(work)


def test_the_published_loop_gives_the_printed_digits():
    X, P = manipulator.loop(manipulator.published())
    assert manipulator.tracking(X) == pytest.approx(8.814357614, abs=5e-9)
    assert f"{manipulator.prediction(X, P):.6f}" == "0.000000"
    assert manipulator.prediction(X, P) == pytest.approx(3.446e-8, rel=0.01)


@pytest.mark.slow
@pytest.mark.parametrize(("about_centre", "expected"), [(False, 8.707970867), (True, 8.845369)])
def test_the_right_arm_in_the_same_loop(about_centre: bool, expected: float):
    assert manipulator.tracking(manipulator.loop(manipulator.right(about_centre))[0]) == pytest.approx(
        expected, abs=1e-6
    )


def test_the_law_makes_the_right_arm_linear():
    X = np.concatenate([manipulator.MIDDLE + 0.1, 0.2 * np.ones(5)])
    target, arm = manipulator.reference(1.3), manipulator.right()
    acceleration = arm.rate(X, arm.law(X, target))[5:]
    e = target[0] - X[:5]
    assert target[2] - acceleration == pytest.approx(-(2 * (target[1] - X[5:]) + e), abs=1e-10)


@pytest.mark.slow
def test_small_errors_of_the_prediction_cost_much_of_the_tracking():
    """0.001 in each state costs 5 % where it is white, and about a third where it is constant."""
    arm, rng = manipulator.published(), np.random.default_rng(0)
    exact, constant = manipulator.euler(arm), 1e-3 * rng.standard_normal((manipulator.RUNS, 1, 10))
    white, biased = (
        manipulator.tracking(manipulator.loop(arm, predict)[0])
        for predict in (
            lambda *asked: exact(*asked) + 1e-3 * rng.standard_normal(constant.shape),
            lambda *asked: exact(*asked) + constant,
        )
    )
    assert 1.03 < white / 8.814358 < 1.07
    assert 1.2 < biased / 8.814358 < 1.6
