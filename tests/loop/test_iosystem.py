"""The controller as a block of python-control: the loop is simulate's, and the block is a function of its state."""

import numpy as np
import pytest

import npred
from npred.base.errors import ConfigError, DivergedError
from npred.loop.iosystem import Block
from npred.prediction.methods import RK4

control = pytest.importorskip("control")
PLANT, DT, LATE, STEPS = npred.plant("scalar"), 0.01, 50, 300
LAWS = {"frozen": None, "observer": npred.DelayObserver(bounds=(0.1, 1.0), candidates=10)}


def controller(law=None, actuator="history"):
    return npred.controller(PLANT, npred.predictor(PLANT, "heun", 21), law, DT, D_hat=0.5, actuator=actuator)


def late_plant():
    """The plant with its input LATE steps late, each step by RK4 with the input held: as simulate advances it."""
    n = PLANT.n

    def update(t, x, u, params):
        X, late = x[:n], x[n:]
        now = RK4.step(lambda y, v, s: PLANT.f(y, v, s), X, late[:1], late[:1], late[:1], t, DT)
        return np.concatenate([now, late[1:], u])

    return control.NonlinearIOSystem(
        update, lambda t, x, u, params: x[:n], inputs=list(PLANT.inputs), outputs=list(PLANT.states),
        states=n + LATE, dt=DT, name="plant",
    )  # fmt: skip


@pytest.mark.parametrize("name", LAWS)
def test_the_loop_is_that_of_simulate(name):
    law = LAWS[name]
    block = npred.as_iosystem(controller(law), name="controller")
    outputs = [*PLANT.states, "D_hat"]
    loop = control.interconnect(
        [block, late_plant()], inplist=[], check_unused=False, outputs=outputs,
        outlist=[f"plant.{PLANT.states[0]}", "controller.D_hat"],
        connections=[[f"controller.{s}", f"plant.{s}"] for s in PLANT.states]
        + [[f"plant.{c}", f"controller.{c}"] for c in PLANT.inputs],
    )  # fmt: skip
    x0 = np.zeros(loop.nstates)
    x0[block.nstates] = 1.0
    t = np.arange(STEPS) * DT
    response = control.input_output_response(loop, t, np.zeros((loop.ninputs or 1, STEPS)) if loop.ninputs else 0, x0)
    wanted = npred.simulate(
        PLANT, npred.predictor(PLANT, "heun", 21), D=LATE * DT, D_hat=0.5, X0=[1.0], t_end=(STEPS - 1) * DT, dt=DT,
        adaptation=law, actuator="history",
    )  # fmt: skip
    np.testing.assert_allclose(response.outputs[0], wanted.X[:, 0], rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(response.outputs[1], wanted.D_hat, rtol=1e-12)


@pytest.mark.parametrize("name", LAWS)
def test_a_state_is_all_that_a_step_depends_on(name):
    block, twin = Block(controller(LAWS[name])), Block(controller(LAWS[name]))
    x, rng = block.initial, np.random.default_rng(0)
    for _ in range(40):
        X = rng.uniform(-1, 1, 1)
        twin.output(0.0, block.initial, np.ones(1), None)  # another step in between
        after = block.update(0.0, x, X, None)
        np.testing.assert_array_equal(twin.update(0.0, x, X, None), after)
        np.testing.assert_array_equal(twin.output(0.0, x, X, None), block.output(0.0, x, X, None))
        x = after
    assert len(block.names) == len(x) == len(set(block.names))


def test_where_the_actuator_is_measured_its_nodes_are_inputs():
    own = controller(None, "measured")
    block = npred.as_iosystem(own)
    assert block.input_labels == ["X", *(f"{PLANT.inputs[0]}[{j}]" for j in range(21))] and block.dt == DT
    u = np.linspace(-1, 1, 21)
    U = block.output(0.0, np.zeros(block.nstates), np.concatenate([[0.4], u]))[0]
    assert own.step([0.4], u[:, None])[0] == U
    assert own.t == DT and npred.as_iosystem(own).output(0.0, np.zeros(block.nstates), np.ones(22))[1] == 0.5


def test_what_is_no_controller_and_what_is_no_measurement():
    with pytest.raises(ConfigError, match="as_iosystem: expected a controller, got 'heun'; make one with"):
        npred.as_iosystem("heun")
    block = npred.as_iosystem(controller())
    with pytest.raises(DivergedError, match="expected finite X"):
        block.output(0.0, np.zeros(block.nstates), np.array([np.nan]))
