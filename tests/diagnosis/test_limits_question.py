"""The question of npred plants check about limits: the shares of loops that break them, with and without a filter."""

import npred
from npred import diagnosis
from npred.plants import Plant


class Cart:
    states, inputs = ("x", "v"), ("u",)
    box, input_bounds = {"x": (-0.9, 0.9), "v": (-0.5, 0.5)}, ((-5.0, 5.0),)
    parameters = {"end": 1.0, "aim": 0.9}
    f = lambda x, u, t, p, M: [x.v, u.u]
    kappa = lambda x, t, p, M: [-4 * (x.x - p.aim) - 1.2 * x.v]
    safe = lambda x, t, p, M: [p.end - x.x, p.end + x.x]


def limits(plant):
    return next((row for row in diagnosis.check(plant, delay=0.3) if row.check == "limits"), None)


def test_the_shares_are_those_of_the_loops():
    row = limits(Plant("cart", Cart))
    assert row.verdict in ("yes", "warn")
    case = diagnosis.Case(Plant("cart", Cart), 0.3, 101, 256)
    plant, X0, dt = case.plant, case.X[:64], 0.015
    free = npred.simulate(plant, npred.predictor(plant, "rk4", 41), D=0.3, D_hat=0.3, X0=X0, t_end=12.0, dt=dt)
    share = (free.safety[:, 20:] < 0).any(axis=(1, 2)).mean()
    assert share > 0.5 and f"in {row.text.split(' in ')[1].split(':')[0]}: {share:.0%} break a limit" in row.text
    assert "0% do not converge, with a filter 0%" in row.text


def test_a_set_point_beyond_a_limit_is_said():
    row = limits(Plant("cart", type("Beyond", (Cart,), {"parameters": {"end": 1.0, "aim": 1.1}})))
    assert row.verdict == "warn" and row.text.endswith("let kappa rest inside the limits, or take no filter")
    assert "with a filter 100%" in row.text


def test_a_plant_without_limits_is_not_asked():
    assert limits(Plant("cart", type("Free", (Cart,), {"safe": None}))) is None
