"""A plant at rest stays there from the first step on, however its loop is run; what the actuator had can be said."""

import ctypes

import numpy as np
import pytest
from c_controllers import InC, library, needs_gcc

import npred
from npred.cli.export import of_table
from npred.lab import config
from npred.prediction.methods import RK4

NAMES = ["chemostat", "pvtol", "transport_tank", "van_der_pol"]


def parts(plant):
    return {} if plant.declares_delay else {"D_hat": 0.3}


@pytest.mark.parametrize("name", NAMES)
def test_a_loop_at_rest_stays_at_rest_in_all_ways_of_running(name):
    plant = npred.plant(name)
    X, U, rk4 = plant.equilibrium, plant.u_equilibrium, RK4(plant, 11)
    own = {} if plant.declares_delay else {"D": 0.3}
    ways = [{"actuator": "measured"}, {"actuator": "history"}]
    ways += [] if own == {} else [{"actuator": "history", "observer": npred.observers.EKF(plant, X0=X)}]
    for way in ways:
        loop = npred.simulate(plant, rk4, X0=X, t_end=1.0, dt=0.01, progress=False, **own, **parts(plant), **way)
        np.testing.assert_allclose(loop.X, np.broadcast_to(X, loop.X.shape), atol=1e-9)
        np.testing.assert_allclose(loop.U, np.broadcast_to(U, loop.U.shape), atol=1e-8)
    one = npred.controller(plant, rk4, None, 0.01, **parts(plant))
    np.testing.assert_allclose(one.u0, U, atol=1e-9)
    for _ in range(40):
        np.testing.assert_allclose(one.step(X), U, atol=1e-8)
    tables = {"plant": name, "evaluate": {"actuator": "history", "X0": X.tolist(), "adaptation": "frozen"}}
    table = config.parse(tables, "tests").evaluate
    np.testing.assert_array_equal(of_table(plant, rk4, table).u0, one.u0)


def test_a_set_point_that_moves_first_finds_the_plant_at_the_rest_before():
    class Tank:
        states, inputs, parameters = ("h",), ("q",), {"aim": 0.5}
        box, input_bounds, guess = {"h": (0.0, 2.0)}, ((0.0, 4.0),), (0.5,)
        f = lambda x, u, t, p, M: [u.q - x.h]
        setpoint = lambda x, t, p, M: [x.h - p.aim]

    plant = npred.plant(Tank, kappa="lqr")
    one = npred.controller(plant, RK4(plant, 11), None, 0.01, D_hat=0.3)
    one.set(aim=1.5)
    assert one.u0 == pytest.approx(0.5) and one.step([0.5])[0] > 1.0


@needs_gcc
def test_the_c_says_what_it_assumes_and_takes_another_command(tmp_path):
    plant = npred.plant("chemostat")

    def make(u0):
        law = npred.DelayObserver(bounds=(0.05, 0.4))
        return npred.controller(plant, RK4(plant, 11), law, 0.01, D_hat=0.2, u0=u0)

    compiled = library(make(None), tmp_path)
    assert (
        "Before the first step the actuator had u = 0.9, or what npred_set_u0 says."
        in (tmp_path / "npred.h").read_text()
    )
    one = InC(compiled, plant)

    def tell(*U):
        return compiled.npred_set_u0(one.memory, np.array(U, float).ctypes.data_as(ctypes.c_void_p))

    assert tell(np.nan) == tell(np.inf) == tell(-0.1) == 3  # the dilution is at least 0
    same, other = make(None), make(0.3)
    rows = 2.0 + 0.1 * np.random.default_rng(0).standard_normal((60, 2))
    for told, controller in ((None, same), (0.3, other)):
        one = InC(compiled, plant)
        assert told is None or tell(told) == 0
        for X in rows:
            np.testing.assert_array_equal(one.step(X), controller.step(X))
        assert tell(0.3) == 3  # too late
