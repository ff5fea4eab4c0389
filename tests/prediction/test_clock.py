"""Plants with a clock, and plants whose states stop at bounds: predictions by independent formulas."""

import numpy as np
import pytest
import torch
from driven import driven
from operator_samples import EVERY, NETWORKS

import npred
from npred import plants
from npred.base import grid
from npred.base.errors import ConfigError
from npred.base.registry import METHODS
from npred.formulas import array_math
from npred.lab import config
from npred.lab.scheduler.configuration import identity
from npred.lab.scheduler.pipeline_fit import PipelineFit, clock
from npred.lab.training.neural import Neural
from npred.lab.training.operators import Scaling, build
from npred.lab.training.rows import Rows
from npred.loop.closed_loop import simulate
from npred.networks import predictor
from npred.plants import BlackBox, Plant
from npred.prediction import methods as predictors
from npred.prediction.delays import problem_of
from npred.prediction.delays.problem import BOUNDED
from npred.prediction.methods import RK4

UNICYCLE, IN_TIME = plants.resolve("unicycle"), plants.resolve("unicycle_time_delay")


def network(config):
    torch.manual_seed(0)
    return Neural(UNICYCLE, build(config, UNICYCLE, Scaling(3, 2)), 21)


def inputs(count=5, nx=21):
    random = np.random.default_rng(2)
    return random.normal(size=(count, 3)), random.normal(size=(count, nx, 2)), random.uniform(0.4, 0.8, count)


def test_a_time_a_row_is_a_call_a_row():
    X, u, D_hat = inputs()
    t, rk4 = np.array([0.0, 0.3, 0.3, 1.7, 9.0]), RK4(UNICYCLE, 21)
    P = rk4(X, u, D_hat, t)
    for row in range(5):
        np.testing.assert_allclose(P[row], rk4(X[row], u[row], D_hat[row], t[row]), rtol=1e-12)
    np.testing.assert_allclose(P, rk4(X, u, D_hat, t + 7 * UNICYCLE.period), rtol=1e-9)
    assert np.abs(P[1] - rk4(X[1], u[1], D_hat[1], 0.0)).max() > 0.1


def test_a_time_is_taken_as_it_is():
    X, u, D_hat = inputs()
    rk4 = RK4(UNICYCLE, 21)
    np.testing.assert_array_equal(rk4.predict(X, u, D_hat, -0.7), rk4(X, u, D_hat, -0.7))
    P = rk4.predict(X, u, D_hat, np.array([0.0, np.nan, 0.3, np.nan, -0.7]))
    assert np.isnan(P[[1, 3]]).all() and np.isfinite(P[[0, 2, 4]]).all()
    assert np.isnan(rk4.predict(X, u, D_hat, np.nan)[:, -1, 0]).all()


class Pushed:
    """A mass that is pushed by its input and a wave."""

    states, inputs = ("v", "q"), ("U",)
    f = lambda x, u, t, p, M: [u.U + M.sin(2 * t), x.v]
    mechanics = lambda x, u, t, p, M: ([[1.0]], [u.U + M.sin(2 * t)], [0.0])
    kappa = lambda x, t, p, M: [-x.v - x.q]


PUSHED = Plant("pushed", Pushed)


@pytest.mark.parametrize("lanes", [1, 70])
@pytest.mark.parametrize("method", [name for name in METHODS.builtin if problem_of(PUSHED).refusal(name) is None])
def test_each_node_is_predicted_at_its_time(method, lanes):
    """v and q in closed form, by one lane and by more than a block of them."""
    random, t, U, x = np.random.default_rng(3), 0.7, 0.4, grid.nodes(401)
    X, D_hat = random.normal(size=(lanes, 2)), random.uniform(0.8, 1.3, lanes)
    P = predictors.numerical(method, PUSHED, 401)(X, np.full((lanes, 401, 1), U), D_hat, t)
    s, (v, q) = D_hat[:, None] * x, X.T[:, :, None]
    speed = v + U * s + (np.cos(2 * t) - np.cos(2 * (t + s))) / 2
    place = q + v * s + U * s**2 / 2 + s * np.cos(2 * t) / 2 - (np.sin(2 * (t + s)) - np.sin(2 * t)) / 4
    np.testing.assert_allclose(P, np.stack([speed, place], axis=-1), atol=1e-2 if method == "euler" else 5e-5)


def test_a_time_that_is_unknown_is_refused_where_the_prediction_needs_it():
    X, u, D_hat = inputs()
    with pytest.raises(ConfigError, match=r"t: expected finite numbers, got nan at \[1\]"):
        RK4(UNICYCLE, 21)(X, u, D_hat, [0.0, np.nan, 0.3, 1.0, 2.0])
    arm = plants.resolve("planar_arm2")  # whose law alone knows the time
    X, u = np.zeros((1, 4)), np.zeros((21, 2))
    np.testing.assert_array_equal(RK4(arm, 21)(X, u, 0.4, np.nan), RK4(arm, 21)(X, u, 0.4))


def test_only_laws_past_their_delay_and_f_make_a_prediction_depend_on_time():
    assert UNICYCLE.clocked and driven().clocked
    for name in ("planar_arm2", "chemostat"):  # one delay: the law is not in the prediction
        assert not plants.resolve(name).clocked
        assert plants.resolve(name).phase(1.0) is None


@NETWORKS
def test_a_network_sees_the_phase_and_rests_at_all_times(config):
    run, (X, u, D_hat) = network(config), inputs()
    t = np.linspace(0.0, 1.5, 5)
    P = run(X, u, D_hat, t)
    np.testing.assert_allclose(run(X, u, D_hat, t + 1000 * UNICYCLE.period), P, rtol=0, atol=1e-6)
    assert np.abs(run(X, u, D_hat, t + 1.0) - P).max() > 1e-4
    np.testing.assert_array_equal(run(np.zeros(3), np.zeros((21, 2)), D_hat, t), 0.0)


@NETWORKS
def test_the_loop_tells_the_network_its_time(config):
    run = network(config)
    loop = simulate(UNICYCLE, run, D=0.6, D_hat=0.6, X0=[0.1, 0.2, 0.1], t_end=1.0, dt=0.05, samples=np.arange(20))
    P = run(loop.samples.X, loop.samples.u, loop.samples.D_hat, 0.05 * np.arange(20))
    U = UNICYCLE.kappa(P[:, -1], 0.05 * np.arange(20) + 0.6)[:, 1]
    np.testing.assert_allclose(loop.U[:20, 1], U, rtol=1e-4, atol=1e-5)


def test_rows_keep_their_phase():
    class Data:
        X, u, D_hat = inputs(8)
        P = np.zeros((8, 21, 3))

    rows = Rows.of(Data(), phase=np.arange(8) / 8)
    part = Rows.joined([rows[torch.tensor([3, 1])], rows[slice(0, 1)]])
    assert part.phase is not None and part.phase.tolist() == [3 / 8, 1 / 8, 0.0]


@pytest.mark.parametrize("runtime", ["fused", "onnx"])
def test_every_runtime_sees_the_time(runtime):
    if runtime == "onnx":
        pytest.importorskip("onnx"), pytest.importorskip("onnxscript"), pytest.importorskip("onnxruntime")
    X, u, D_hat = inputs(6)
    model, t = network(EVERY[0]), np.linspace(0.0, 5.0, 6)
    P = model(X, u, D_hat, t)
    np.testing.assert_allclose(predictor(runtime, UNICYCLE, model.operator, 21)(X, u, D_hat, t), P, atol=1e-4)


PIPELINE = config.parse({"plant": "scalar"}, "tests")


def test_without_a_period_no_network_can_serve_it():
    u = np.ones((21, 1)) * grid.nodes(21)[:, None]
    assert RK4(driven(), 21)([1.0], u, 0.5, 0.3).shape == (21, 1)
    with pytest.raises(ConfigError, match="Driven: expected a period, for its prediction depends on time"):
        clock(PipelineFit(driven(), PIPELINE, ()))
    with pytest.raises(ConfigError, match="Driven: f and kappa expected to repeat after 3 s; set period"):
        clock(PipelineFit(driven(period=3.0), PIPELINE, ()))
    clock(PipelineFit(driven(period=np.pi), PIPELINE, ()))


@NETWORKS
def test_a_delay_of_time_alone_tells_a_network_the_time(config):
    """The same without a phase, and equal to the prediction's own dependence: t is where D(t) = D_hat."""
    assert IN_TIME.clocked and not IN_TIME.phased and IN_TIME.phase(1.0) is None
    run = Neural(IN_TIME, build(config, IN_TIME, Scaling(3, 2)), 21)
    X, u, D_hat = inputs()
    np.testing.assert_array_equal(run(X, u, D_hat, 0.0), run(X, u, D_hat, 5.0))
    with_period = Plant("late", type("Late", (IN_TIME.declaration,), {"period": 1.0}))
    assert with_period.phased and with_period.phase(1.25) == 0.25
    by_state = Plant("late", type("Late", (IN_TIME.declaration,), {"delay": lambda x, t, p, M: 1 / (1 + t) + x.x**2}))
    assert by_state.phased  # and without a period no network can serve it


def test_a_delay_that_comes_back_to_a_value_does_not_tell_the_time():
    late = lambda x, t, p, M: 1 + 0.5 * M.sin(t)
    clock(PipelineFit(IN_TIME, PIPELINE, ()))
    plant = Plant("late", type("Late", (IN_TIME.declaration,), {"delay": late}))
    with pytest.raises(ConfigError, match=r"expected a delay that only rises or only falls for 100 s.*declare period"):
        clock(PipelineFit(plant, PIPELINE, ()))


@pytest.mark.parametrize("period", [0.0, -1.0, "often"])
def test_a_period_that_is_none_is_told(period):
    with pytest.raises(ConfigError, match="period"):
        driven(period=period)


HIGH, D, NX = 0.5, 1.0, 201


class Slide:
    """The integral of what arrives, which stops at 0.5; y follows behind, free."""

    states, inputs, state_bounds = ("x", "y"), ("u", "v"), {"x": (-np.inf, HIGH)}
    box = {"x": (-0.2, 0.2), "y": (-0.2, 0.2)}
    f = lambda x, u, t, p, M: [u.u, u.v - x.y]
    kappa = lambda x, t, p, M: [-x.x, -x.y]
    V = lambda x, t, p, M: x.x**2 + x.y**2


class SlideTwoDelays(Slide):
    delays = (D, 0.5)


class SlideDeclared(Slide):
    delay = lambda x, t, p, M: D + 0.0 * x.x


class SlideCalled(Slide):
    traced = False
    f = lambda X, u, t, p: np.stack([u[:, 0], u[:, 1] - X[:, 1]], axis=-1)
    kappa = lambda X, t, p: -X
    V = lambda X, t, p: (X**2).sum(axis=-1)


PLANTS = [Plant(kind.__name__, kind) for kind in (Slide, SlideTwoDelays, SlideDeclared)] + [
    BlackBox("Called", SlideCalled)
]


def stopped(free):
    """A path that stops at HIGH: the free one less the most that it was above so far (Skorokhod)."""
    return free - np.maximum.accumulate(np.maximum(free - HIGH, 0.0), axis=-1)


@pytest.mark.parametrize("lanes", [1, 6])
@pytest.mark.parametrize("plant", PLANTS, ids=lambda plant: plant.name)
def test_predictions_stop_at_the_bound_and_leave_it(plant, lanes):
    x, starts = np.linspace(0, 1, NX), np.linspace(-0.1, 0.3, lanes)
    u = np.stack([2.0 * np.sin(5.5 * x), 0.0 * x], axis=-1)
    P = RK4(plant, NX)(np.stack([starts, 0 * starts], axis=-1), np.broadcast_to(u, (lanes, NX, 2)), D)[..., 0]
    free = starts[:, None] + 2.0 / 5.5 * (1 - np.cos(5.5 * x))
    assert (free.max(axis=-1) > HIGH).all() and free[0, -1] < HIGH
    np.testing.assert_allclose(P, stopped(free), atol=1e-4)
    assert P.max() <= HIGH


@pytest.mark.parametrize("plant", PLANTS, ids=lambda plant: plant.name)
def test_the_simulated_plant_stops_too_and_is_where_it_was_predicted(plant):
    named = {} if plant.declares_delay else {"D": D, "D_hat": D}
    loop = npred.simulate(plant, RK4(plant, 51), X0=[0.2, 0.0], t_end=4.0, dt=0.02, u0=[1.0, 0.0], **named)
    x, ahead = loop.X[:, 0], round(D / 0.02)
    np.testing.assert_allclose(x[:ahead], np.minimum(0.2 + loop.t[:ahead], HIGH), atol=1e-12)
    assert x.max() == HIGH
    np.testing.assert_allclose(loop.P[:-ahead, 0], x[ahead:], atol=0.02)
    assert abs(x[-1]) < 0.1


def test_what_is_not_finite_stays_visible():
    values = PLANTS[0].stopped([np.array([np.nan, 2.0, -np.inf]), np.zeros(3)], array_math.NUMPY)[0]
    np.testing.assert_array_equal(values, [np.nan, HIGH, -np.inf])


@pytest.mark.parametrize("part", BOUNDED)
def test_what_reads_f_at_the_bound_is_refused_with_what_to_do(part):
    with pytest.raises(ConfigError, match="expected a plant without state_bounds, plant Slide has some; "):
        problem_of(PLANTS[0]).needs(part)


def test_a_start_outside_is_refused():
    with pytest.raises(ConfigError, match=r"X0: expected x within its state_bounds \[-inf, 0.5\], got 0.6 to 0.6"):
        npred.simulate(PLANTS[0], None, D=D, D_hat=D, X0=[0.6, 0.0], t_end=1.0)


def test_the_bounds_are_part_of_the_identity():
    free = Plant("Slide", type("Free", (Slide,), {"state_bounds": {}}))
    assert identity(free)["state_bounds"] == {}
    assert identity(PLANTS[0])["state_bounds"] == {"x": ["-inf", HIGH]}


def test_a_delay_observer_is_refused():
    with pytest.raises(ConfigError, match="freeze the estimate"):
        law = npred.DelayObserver(bounds=(0.1, 2.0))
        npred.simulate(PLANTS[0], RK4(PLANTS[0], 21), D=D, D_hat=D, X0=[0.0, 0.0], t_end=1.0, adaptation=law)
