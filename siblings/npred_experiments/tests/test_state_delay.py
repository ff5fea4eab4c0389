"""Delays of the state: the robot against its oracle, the scalar plant against its digits."""

import numpy as np
import pytest

import npred
from npred import plants
from npred_experiments import state_delay_two_inputs, state_delay_unicycle


@pytest.mark.parametrize("x0", state_delay_two_inputs.STARTS)
def test_the_arrival_state_to_all_digits(x0: float):
    printed = float(state_delay_two_inputs.STARTS[x0])
    assert state_delay_two_inputs.solved(x0) == pytest.approx(printed, abs=1e-16)
    assert state_delay_two_inputs.meant(x0) == pytest.approx(printed, abs=1e-14)


def test_the_printed_denominator_gives_another_state():
    """The third party's 0.1063399065 is met to 4e-8; its rule of integration is not published."""
    P2 = state_delay_two_inputs.by_printed_denominator(0.2)
    assert pytest.approx(0.10633990646069874, abs=4e-8) == P2
    assert P2 - state_delay_two_inputs.solved(0.2) > 1e-5


@pytest.mark.parametrize(
    ("start", "end"),
    [(1.0, (-0.044566, 0.062750, -0.023026)), (0.5, (-0.037948, 0.053984, -0.017096))],
)
def test_the_oracle_does_not_depend_on_its_step(start: float, end: tuple[float, ...]):
    fine, coarse = (state_delay_unicycle.oracle((start,) * 3, step=step) for step in (0.001, 0.002))
    assert np.abs(fine - coarse).max() < 1e-7
    assert fine == pytest.approx(end, abs=1e-6)


def test_from_ones_the_loop_is_marked_and_ends():
    plant = plants.make("unicycle_state_delay", state_delay_unicycle.UnicycleStateDelay)
    loop = npred.simulate(plant, npred.predictor(plant, "rk4"), X0=[1.0, 1.0, 1.0], t_end=4.0, dt=0.002)
    assert loop.infeasible.any()
    assert np.isnan(loop.X[-1]).all()


def test_the_loop_comes_to_the_oracle_at_first_order():
    errors = [state_delay_unicycle.meant(0.5, dt) for dt in (0.004, 0.002)]
    assert np.log2(errors[0] / errors[1]) == pytest.approx(1.0, abs=0.1)
    assert errors[1] < 5e-4
