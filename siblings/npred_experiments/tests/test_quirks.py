"""What published loops share: a rule that ends short of the delay, a line that smears, commands recalled amiss."""

import numpy as np
import pytest

from npred_experiments import quirks

DX, D = 0.01, 1.3


def test_the_rule_ends_one_and_a_half_cells_short_of_the_delay():
    """Along x' = 1 the prediction is the time that it reaches ahead."""
    line = np.zeros((100, 1))
    (end,) = quirks.half_cell_short(lambda X, u: (1.0,), (0.0,), line, D, DX)[-1]
    assert end == pytest.approx((100 - 1.5) * DX * D)


def test_the_line_smears_a_jump_and_is_early():
    dt, line, passed = 0.005, np.zeros((100, 1)), []
    for _ in range(400):
        line = quirks.upwind(line, dt / (D * DX), 1.0)
        passed.append(line[0, 0])
    t = dt * np.arange(1, 401)
    first, half, last = (t[np.searchsorted(passed, level)] for level in (0.05, 0.5, 0.95))
    assert half == pytest.approx(99 * DX * D, abs=2 * dt)
    assert last - first > 20 * dt


@pytest.mark.parametrize(("factor", "right"), [(True, True), (False, False)])
def test_recalled_commands_need_the_factor_of_a_moving_estimate(factor: bool, right: bool):
    """U(t) = t recalled at D_hat(t) = 1 + t / 2 is t + D_hat (x - 1): u_t = (1 + (x - 1) D_hat') u_x / D_hat."""
    dt, rate, x = 0.002, 0.5, DX * np.arange(101)
    line = (x - 1.0)[:, None]
    for k in range(250):
        D_hat = 1 + rate * k * dt
        speed = 1 + (x[:-1, None] - 1) * rate if factor else 1.0
        line = quirks.upwind(line, speed * dt / (D_hat * DX), (k + 1) * dt)
    expected = 0.5 + (1 + rate * 0.5) * (x - 1)
    assert (np.abs(line[:, 0] - expected).max() < 0.01) == right
