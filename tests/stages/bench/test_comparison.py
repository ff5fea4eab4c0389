"""Predictors side by side: names, errors against the exact solution, and what loops make of them."""

import math

import numpy as np
import pytest

import npred
from npred.base.errors import ConfigError
from npred.lab.stages.bench import comparison

PLANT = npred.plant("scalar")
LOOP = {"D": 0.5, "D_hat": 0.5, "X0": [1.0], "t_end": 8.0, "dt": 0.01}


class Growth:
    """X' = a X + U: P(x) is known in closed form where U is held."""

    states, inputs, guess = ("X",), ("U",), (0.0,)
    parameters = {"a": 1.0}
    f = lambda x, u, t, p, M: [p.a * x.X + u.U]
    kappa = lambda x, t, p, M: [-2 * x.X]


@pytest.fixture(scope="module")
def compared():
    plant = npred.plants.Plant("growth", Growth)
    runs = {f"euler {nx}": npred.predictor("euler", plant, nx) for nx in (11, 21, 41)}
    return npred.compare(plant, runs, X0=[1.0], t_end=8.0, D=0.5, D_hat=0.5, dt=0.01)


def test_the_errors_fall_with_the_order_of_the_method(compared):
    eps = [row.eps_sup for row in compared.rows]
    orders = [math.log2(a / b) for a, b in zip(eps, eps[1:], strict=False)]
    assert all(0.8 < order < 1.2 for order in orders)


def test_the_loops_are_those_of_simulate(compared):
    plant = npred.plants.Plant("growth", Growth)
    run = npred.simulate(plant, npred.predictor("euler", plant, 11), X0=[1.0], t_end=8.0, D=0.5, D_hat=0.5, dt=0.01)
    np.testing.assert_array_equal(compared.loops["euler 11"].X, run.X)
    row = compared.rows[0]
    assert row.radius == np.abs(run.X[run.t >= 7.2 - 1e-9]).max()
    outside = np.flatnonzero(np.abs(run.X[:, 0]) > 0.01)
    assert row.converged == 1.0 and row.settle_time == pytest.approx(run.t[outside[-1] + 1])


def test_table_data_frame_and_notebook(compared):
    lines = str(compared).splitlines()
    assert [line.split("  ")[0] for line in lines] == ["predictor", "euler 11", "euler 21", "euler 41"]
    assert compared._repr_html_().count("euler") == 3
    frame = compared.to_dataframe()
    assert list(frame.index) == ["euler 11", "euler 21", "euler 41"] and (frame.us > 0).all()


def test_a_guard_saves_a_wrong_predictor():
    plant = npred.plant("activator_repressor")
    euler = npred.predictor("euler", plant, 11)
    guarded = npred.guarded(euler, 1e-6)
    about = {"D": 1.0, "D_hat": [0.8, 1.0], "X0": [0.03, 30.0], "t_end": 10.0}
    bare, safe = npred.compare(plant, {"bare": euler, "guarded": guarded}, **about).rows
    assert safe.eps_sup < bare.eps_sup


def test_names_of_a_list():
    runs = [npred.predictor("rk4", PLANT, nx) for nx in (11, 21)] + [npred.predictor("heun", PLANT)]
    assert list(comparison._named(runs)) == ["rk4, nx = 11", "rk4, nx = 21", "heun"]
    with pytest.raises(ConfigError, match="expected different ones, got heun, nx = 101; heun, nx = 101; name them"):
        comparison._named([runs[2]] * 2)


@pytest.mark.parametrize("wrong", [[], {}, "rk4", ["rk4"], {"rk4": 3}, None])
def test_what_is_no_predictor_is_refused(wrong):
    with pytest.raises(ConfigError, match="predictors: expected a list of predictors, or a dictionary"):
        npred.compare(PLANT, wrong, **LOOP)


def test_what_is_no_plant_is_refused():
    with pytest.raises(ConfigError, match=r"plant: expected a Plant, got 'scalar'; make one with npred.plant"):
        npred.compare("scalar", [npred.predictor("rk4", PLANT)], **LOOP)


def test_loops_that_are_shorter_than_the_delay_leave_nothing_to_compare():
    with pytest.raises(ConfigError, match=r"t_end: expected loops longer than the delay 0.5, got 0.5; raise it"):
        npred.compare(PLANT, [npred.predictor("rk4", PLANT)], **LOOP | {"t_end": 0.5})


def test_a_delay_that_varies_and_one_that_the_plant_declares():
    runs = [npred.predictor("rk4", PLANT)]
    varying = npred.compare(PLANT, runs, **LOOP | {"D": lambda t: 0.5 + 0.1 * math.sin(t)})
    assert varying.rows[0].eps_sup < 1e-6
    declares = npred.plant("transport_tank")
    X0 = declares.target(0.0) * 1.01
    declared = npred.compare(declares, [npred.predictor("rk4", declares)], X0=X0, t_end=5.0, dt=0.01)
    assert declared.rows[0].eps_sup < 1e-3
