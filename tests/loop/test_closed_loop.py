"""Closed loops: golden trajectories, exact identities, one code for compiled and Python predictors, what goes wrong."""

import numpy as np
import pytest

from npred import plants
from npred.base.errors import ConfigError
from npred.estimation.adaptation import DelayAdaptation
from npred.loop import lyapunov, metrics
from npred.loop.closed_loop import Trajectories, simulate
from npred.plants import Plant
from npred.prediction.methods import RK4, Euler, Heun, Predictor

PLANT = plants.resolve("activator_repressor")
SCALAR = plants.resolve("scalar")
LAW = DelayAdaptation(gamma=1000.0, b=1.0, bounds=(0.1, 4.0))
FIGURE1 = {"D": 1.0, "D_hat": 2.0, "X0": [0.03, 30.0], "t_end": 100.0}


class Interpreted(Predictor):
    """RK4 behind a Python call, as a network is."""

    name = "interpreted"

    def predict(self, X, u, D_hat, t):
        return RK4(self.plant).predict(X, u, D_hat, t)

    def lanes(self):
        def predict(X, u, D_hat, t, p, P):
            P[:] = self.predict(X.T, u.transpose(2, 0, 1), D_hat, t).transpose(1, 2, 0)

        return predict


class Escape:
    """X' = X² leaves the numbers at t = 1 / X(0)."""

    states, inputs, guess = ("X",), ("U",), (0.0,)
    f = lambda x, u, t, p, M: [x.X**2 + 0 * u.U]
    kappa = lambda x, t, p, M: [0 * x.X]
    V = lambda x, t, p, M: x.X**2


@pytest.fixture(scope="module")
def figure1():
    return simulate(PLANT, RK4(PLANT, 101), adaptation=LAW, **FIGURE1)


def test_golden_exact_loop(figure1):
    """The mesh limit of an independent solver; the held input is of first order in dt."""
    for t, X, D_hat in [(1, (0.01119907, 18.284676), 1.999935), (5, (0.05731731, 4.168447), 0.4075),
                        (10, (0.10337582, 5.963860), 1.217051), (30, (0.09388633, 5.251668), 1.192244)]:  # fmt: skip
        k = round(t / 0.005)
        np.testing.assert_allclose(figure1.X[k], X, rtol=0.01)
        np.testing.assert_allclose(figure1.D_hat[k], D_hat, rtol=0.01)
    assert metrics.radius(figure1, PLANT.equilibrium) <= 1e-9
    np.testing.assert_allclose(figure1.D_hat[-1], 1.19226, rtol=0.01)


def test_golden_loop_is_met_at_first_order_in_dt(figure1):
    fine = simulate(PLANT, RK4(PLANT, 201), adaptation=LAW, dt=0.001, every=5, **FIGURE1 | {"t_end": 10.0})
    gaps = [abs(run.D_hat[2000] - 1.217051) for run in (figure1, fine)]
    assert 0.1 < gaps[1] / gaps[0] < 0.35  # a fifth, to first order


def test_golden_loop_with_the_input_clipped():
    """u* < 0 is out of reach with U >= 0: a cycle of radius 1.5e-3 stays. D_hat meets its mesh limit at first order."""
    fine, coarse = (
        simulate(PLANT, RK4(PLANT, nx), adaptation=LAW, input_bounds=[(0.0, np.inf)], dt=dt, **FIGURE1)
        for dt, nx in ((0.0025, 201), (0.005, 101))
    )
    assert coarse.U.min() == 0.0
    np.testing.assert_allclose(2 * fine.D_hat[-1] - coarse.D_hat[-1], 0.4975, rtol=1e-3)
    assert 0.4 < (fine.D_hat[-1] - 0.4975) / (coarse.D_hat[-1] - 0.4975) < 0.6
    np.testing.assert_allclose(metrics.radius(coarse, PLANT.equilibrium), 1.5e-3, rtol=0.01)
    np.testing.assert_allclose(metrics.settle_time(coarse, PLANT.equilibrium), 25.5, atol=0.1)


def test_frozen_wrong_estimate_does_not_converge():
    """With U >= 0 it keeps the article's limit cycle, the same for half the step."""
    for dt in (0.005, 0.0025):
        loop = simulate(PLANT, RK4(PLANT, 101), input_bounds=[(0.0, np.inf)], dt=dt, **FIGURE1)
        assert (loop.D_hat == 2.0).all()
        tail = loop.X[loop.t > 60]
        np.testing.assert_allclose([tail[:, 0].min(), tail[:, 0].max()], [0.058, 0.2153], rtol=0.01)
        np.testing.assert_allclose([tail[:, 1].min(), tail[:, 1].max()], [3.53, 14.05], rtol=0.01)


@pytest.mark.slow
def test_frozen_wrong_estimate_has_no_limit_where_u_may_be_negative():
    """What such a loop does hangs on its step: no figure of it is one of the plant."""
    free = [(-1e9, 1e9)]  # by default U is clipped at ten times the largest |kappa| on the box
    runs = [simulate(PLANT, RK4(PLANT, 101), dt=dt, input_bounds=free, **FIGURE1) for dt in (0.005, 0.0025, 0.00125)]
    peaks = np.array([run.X[:, 1].max() for run in runs])
    assert peaks.min() > 50 and np.ptp(peaks) > 0.1 * peaks.min()
    assert all(run.U.min() < -5 and run.X[:, 0].min() < -0.05 for run in runs)


@pytest.mark.parametrize(
    ("D", "D_hat", "stable"),
    [(1, 0.36, True), (1, 0.34, False), (1, 1.62, True), (1, 1.65, False), (0.5, 1.16, True), (0.5, 1.19, False)],
)
def test_frozen_estimates_are_stable_in_the_known_band(D, D_hat, stable):
    """At D = 1 the band is (.352776, 1.636073), at D = .5 it ends at 1.1768; near rest, growth or decay."""
    X0 = PLANT.equilibrium * (1 + 1e-4)
    u0 = PLANT.u_equilibrium
    loop = simulate(PLANT, RK4(PLANT, 201), D=D, D_hat=D_hat, X0=X0, t_end=300.0, dt=0.0025, u0=u0, every=20)
    distance = np.linalg.norm(loop.X - PLANT.equilibrium, axis=1)
    early, late = distance[(loop.t > 60) & (loop.t < 120)].max(), distance[loop.t > 240].max()
    assert (late < early) == stable


def test_open_loop_limit_cycle():
    loop = simulate(PLANT, None, t_end=200.0, **{k: FIGURE1[k] for k in ("D", "D_hat", "X0")})
    late = loop.t > 100
    cycle = loop.X[late]
    np.testing.assert_allclose(cycle.min(axis=0), [0.00205082, 1.12248366], rtol=5e-3)
    np.testing.assert_allclose(cycle.max(axis=0), [0.78744846, 61.01396041], rtol=5e-3)
    rising = np.flatnonzero((cycle[:-1, 1] < 20) & (cycle[1:, 1] >= 20))
    np.testing.assert_allclose(np.diff(loop.t[late][rising]).mean(), 10.10666158, rtol=5e-3)


def test_known_delay_is_compensated_exactly():
    """D_hat = D: for t >= D, w = 0 and x1(t) = U0 - (U0 - x1(D)) e^{-(t - D)}, U0 = f1 at the set point."""
    loop = simulate(PLANT, RK4(PLANT, 201), D=1.0, D_hat=1.0, X0=[0.03, 30.0], t_end=10.0, dt=0.0025, adaptation=LAW)
    U0, start = 0.0938947845961753, round(1.0 / 0.0025)
    after = loop.t[start:] - 1.0
    exact = U0 - (U0 - loop.X[start, 0]) * np.exp(-after)
    np.testing.assert_allclose(loop.X[start:, 0], exact, atol=1e-4)
    np.testing.assert_allclose(loop.N[start + 5 :], 1 + PLANT.V(loop.X[start + 5 :]), rtol=1e-4)


def test_predictor_and_plant_agree_on_the_control_steps():
    """With one node a control step, Euler for both and the held input at the nodes, P(1, t) is X(t + D) to rounding."""
    steps = np.arange(200, 1800, 50)
    loop = simulate(PLANT, Euler(PLANT, 101), D=0.5, D_hat=0.5, X0=[0.03, 30.0], t_end=10.0, dt=0.005, samples=steps,
                    integrator="euler")  # fmt: skip
    held = np.stack([loop.U[k - 100 : k + 1] for k in steps])
    P = Euler(PLANT, 101)(loop.samples.X, held, 0.5)
    np.testing.assert_allclose(P[:, -1], loop.X[steps + 100], rtol=1e-12, atol=1e-12)
    np.testing.assert_array_equal(loop.samples.X, loop.X[steps])


@pytest.mark.parametrize("adaptation", [LAW, None])
def test_a_python_predictor_runs_the_same_loop(adaptation):
    random = np.random.default_rng(0)
    X0, D_hat = random.uniform([0.01, 25], [0.05, 35], (3, 2)), np.array([0.5, 1.0, 1.7])
    settings = {"D": 1.0, "D_hat": D_hat, "X0": X0, "t_end": 5.0, "adaptation": adaptation}
    compiled, python = (simulate(PLANT, kind(PLANT, 51), **settings) for kind in (RK4, Interpreted))
    np.testing.assert_allclose(python.X, compiled.X, rtol=1e-10)
    np.testing.assert_allclose(python.D_hat, compiled.D_hat, rtol=1e-10)


def test_batches_of_any_shape_equal_single_loops():
    """More loops than a chunk, other delays in each lane; a lane does not see its neighbours."""
    random = np.random.default_rng(1)
    X0, D = random.uniform([0.01, 25], [0.05, 35], (7, 11, 2)), random.uniform(0.3, 1.5, (7, 11))
    loops = simulate(PLANT, Heun(PLANT, 41), D=D, D_hat=0.9, X0=X0, t_end=3.0, dt=0.005, adaptation=LAW, every=10)
    assert loops.X.shape == (7, 11, 61, 2) and loops.t.shape == (61,) and loops.D_hat.shape == (7, 11, 61)
    for i in [(0, 0), (5, 8), (6, 10)]:
        one = simulate(
            PLANT, Heun(PLANT, 41), D=D[i], D_hat=0.9, X0=X0[i], t_end=3.0, dt=0.005, adaptation=LAW, every=10
        )
        np.testing.assert_allclose(loops.X[i], one.X, rtol=1e-9)
        np.testing.assert_allclose(loops.U[i], one.U, rtol=1e-9, atol=1e-12)


def test_parts_of_a_batch_join_to_the_batch():
    loops = simulate(PLANT, RK4(PLANT, 11), D=1.0, D_hat=[0.5, 1.0, 2.0], X0=[0.03, 30.0], t_end=1.0, dt=0.01,
                     samples=np.array([[3, 7]] * 3))  # fmt: skip
    joined = Trajectories.joined([loops.part(slice(0, 1)), loops.part(slice(1, 3))])
    for name in ("t", "X", "U", "D_hat", "N", "energy", "escaped"):
        np.testing.assert_array_equal(getattr(joined, name), getattr(loops, name))
    np.testing.assert_array_equal(joined.samples.u, loops.samples.u)


def test_scalar_loop_matches_the_delay_equation():
    """D_hat = D: after the delay X' = a X - (a + c) X(t_k), the law with its input held over each step."""
    loop = simulate(SCALAR, RK4(SCALAR, 101), D=0.6, D_hat=0.6, X0=[1.0], t_end=4.0, dt=0.002)
    start = round(0.6 / 0.002)
    np.testing.assert_allclose(loop.X[start, 0], np.exp(0.5 * 0.6), rtol=1e-6)
    factor = np.exp(0.5 * 0.002) - 1.5 * np.expm1(0.5 * 0.002) / 0.5
    decay = loop.X[start, 0] * factor ** np.arange(len(loop.t) - start)
    np.testing.assert_allclose(loop.X[start:, 0], decay, rtol=1e-4)


class Waves:
    """Each state is the integral of an input that does not hang on it, and of a wave."""

    states, inputs = ("a", "b"), ("u", "v")
    f = lambda x, u, t, p, M: [u.u + M.cos(5 * t), u.v + M.cos(3 * t)]
    kappa = lambda x, t, p, M: [M.sin(3 * t), M.cos(2 * t)]


@pytest.mark.parametrize("delays", [(1.0, 1.0), (0.37, 1.0)])
def test_a_step_that_a_switch_falls_into_reads_each_piece_at_its_time(delays):
    plant, dt, D = Plant("waves", type("Waves", (Waves,), {"delays": delays})), 0.05, 0.537
    loop = simulate(plant, RK4(plant, 5), D=D, D_hat=0.0, X0=[0.0, 0.0], t_end=3.0, dt=dt, u0=[0.0, 0.0])
    for c, (late, wave) in enumerate(zip(D * np.array(delays), (5.0, 3.0), strict=True)):
        total = np.concatenate([[0.0], np.cumsum(loop.U[:-1, c]) * dt])
        wanted = np.interp(loop.t - late, loop.t, total, left=0.0) + np.sin(wave * loop.t) / wave
        np.testing.assert_allclose(loop.X[:, c], wanted, rtol=0, atol=1e-5)  # Simpson's rule


def test_each_input_has_bounds_of_its_own():
    plant, bounds = Plant("waves", Waves), np.array([(-0.3, 0.2), (-0.5, 0.7)])
    loop = simulate(
        plant, RK4(plant, 5), D=0.5, D_hat=0.0, X0=[0.0, 0.0], t_end=3.0, dt=0.05, u0=[0.0, 0.0], input_bounds=bounds
    )
    wanted = np.clip(np.stack([np.sin(3 * loop.t), np.cos(2 * loop.t)], axis=-1), *bounds.T)
    np.testing.assert_allclose(loop.U, wanted, rtol=0, atol=1e-12)


def test_an_escaping_loop_is_seen_and_leaves_the_others_alone():
    plant = Plant("Escape", Escape)
    loops = simulate(plant, Heun(plant, 11), D=0.1, D_hat=0.1, X0=[[0.1], [2.0]], t_end=1.0, dt=0.001)
    assert loops.escaped[0] == -1 and 450 < loops.escaped[1] < 700
    assert np.isfinite(loops.X[0]).all() and not np.isfinite(loops.X[1, -1]).all()
    np.testing.assert_allclose(loops.X[0, -1], 0.1 / (1 - 0.1), rtol=1e-6)
    assert metrics.radius(loops, plant.equilibrium)[1] == np.inf


class EscapeOfTheSecond:
    """The same behind a state that stays."""

    states, inputs, guess = ("still", "X"), ("U",), (0.0, 0.0)
    f = lambda x, u, t, p, M: [u.U - x.still, x.X**2]
    kappa = lambda x, t, p, M: [-x.still]


def test_a_loop_is_lost_with_any_of_its_states():
    plant = Plant("EscapeOfTheSecond", EscapeOfTheSecond)
    loop = simulate(plant, Heun(plant, 11), D=0.1, D_hat=0.1, X0=[0.0, 2.0], t_end=1.0, dt=0.001)
    assert np.isfinite(loop.X[loop.escaped - 1]).all() and not np.isfinite(loop.X[loop.escaped, 1])
    assert 450 < loop.escaped < 700


def test_functionals_of_the_proof_start_and_end_where_they_must(figure1):
    W = lyapunov.W(figure1.N, 1.0, figure1.D_hat, LAW.gamma, LAW.b)
    Gamma = lyapunov.Gamma(figure1.X, PLANT.equilibrium, figure1.energy, 1.0, figure1.D_hat)
    assert W[0] == pytest.approx(np.log(figure1.N[0]) + 1 / 1000)
    at_rest = np.log1p(PLANT.V(PLANT.equilibrium))  # the set point of V is rounded: V(X*) is not 0
    assert W[-1] == pytest.approx(at_rest + (1 - figure1.D_hat[-1]) ** 2 / 1000, abs=1e-9)
    assert Gamma[-1] == pytest.approx((1 - figure1.D_hat[-1]) ** 2, abs=1e-9)
    assert Gamma[0] > 600


def test_energy_is_the_integral_of_the_past_input(figure1):
    k = 2000
    past = figure1.U[k - 200 : k, 0] - PLANT.u_equilibrium[0]
    assert figure1.energy[k] == pytest.approx(0.005 * np.sum(past**2), rel=1e-3)


@pytest.mark.parametrize("D", [1.0, 0.737])
def test_energy_is_over_the_true_delay_where_the_controller_reads_its_commands_by_another(D):
    loop = simulate(PLANT, RK4(PLANT, 21), D=D, D_hat=1.6, X0=[0.03, 30.0], t_end=4.0, dt=0.01, actuator="history")
    edges, k = np.arange(401) * 0.01, 300
    inside = np.clip(np.minimum(edges[1:], 3.0) - np.maximum(edges[:-1], 3.0 - D), 0.0, None)  # seconds of each command
    wanted = np.sum(inside * (loop.U[:400, 0] - PLANT.u_equilibrium) ** 2)
    assert loop.energy[k] == pytest.approx(wanted, rel=1e-9)


class Pumped:
    """Two tanks at rest where u = 1 and v = 3."""

    states, inputs, guess = ("a", "b"), ("u", "v"), (0.0, 0.0)
    f = lambda x, u, t, p, M: [u.u - 1 - x.a, u.v - 3 - x.b]
    kappa = lambda x, t, p, M: [1 - x.a, 3 - x.b]


@pytest.mark.parametrize("delays", [(1.0, 1.0), (0.37, 1.0)])
@pytest.mark.parametrize("actuator", ["measured", "history"])
def test_energy_is_of_each_input_from_its_own_rest_over_its_own_delay(delays, actuator):
    plant, D = Plant("pumped", type("Pumped", (Pumped,), {"delays": delays})), 0.737
    loop = simulate(
        plant, RK4(plant, 21), D=D, D_hat=0.6, X0=[0.2, 0.1], t_end=0.1, dt=0.01, u0=[0.5, 1.0], actuator=actuator
    )
    assert loop.energy[0] == pytest.approx(D * (0.5**2 * delays[0] + 2.0**2 * delays[1]), rel=1e-9)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"D_hat": 5.0}, r"D_hat: expected within the bounds"),
        ({"D": -1.0}, r"D: expected a delay of at least 0"),
        ({"dt": 0.0}, r"dt: expected a control step above 0"),
        ({"X0": [0.1]}, r"X0: expected shape \(..., 2\) for plant activator_repressor, got \(1,\)"),
        ({"X0": [np.nan, 1.0]}, r"X0: expected finite"),
        ({"input_bounds": [(1.0, 0.0)]}, r"input_bounds: expected low <= high for U, got \(1, 0\); swap them"),
    ],
)
def test_mistakes_are_told(change, message):
    with pytest.raises(ConfigError, match=message):
        simulate(PLANT, Euler(PLANT), adaptation=LAW, **FIGURE1 | change)


def test_progress_counts_every_step_of_every_loop():
    told = []
    simulate(SCALAR, Euler(SCALAR, 5), D=0.1, D_hat=0.1, X0=np.ones((70, 1)), t_end=6.0, dt=0.01, progress=told.append)
    assert sum(told) == 70 * 601


def test_progress_can_be_a_bar(capsys):
    simulate(SCALAR, Euler(SCALAR, 5), D=0.1, D_hat=0.1, X0=np.ones((70, 1)), t_end=6.0, dt=0.01, progress=True)
    assert "42.1k/42.1k" in capsys.readouterr().err
    simulate(SCALAR, Euler(SCALAR, 5), D=0.1, D_hat=0.1, X0=[1.0], t_end=1.0, dt=0.01, progress=False)
    assert capsys.readouterr().err == ""


def test_predictions_of_kept_steps_are_kept():
    """P(1, t) of every kept step, compiled or not; there is none in the open loop."""
    steps = np.arange(0, 401, 40)
    given = {"D": 1.0, "D_hat": [0.8, 1.3], "X0": [0.03, 30.0], "t_end": 2.0, "every": 40, "samples": steps}
    for predictor in (RK4(PLANT, 51), Interpreted(PLANT, 51)):
        loops = simulate(PLANT, predictor, adaptation=LAW, **given)
        P = predictor(loops.samples.X, loops.samples.u, loops.samples.D_hat)
        np.testing.assert_allclose(loops.P, P[..., -1, :], rtol=1e-12)
    np.testing.assert_array_equal(loops.part(slice(1, 2)).P, loops.P[1:])
    assert np.isnan(simulate(PLANT, None, **given).P).all()


FOUR = {
    "planar_arm2": {"D": 0.5, "X0": [0.6, 0.7, 0.0, 0.0]},
    "cart_pole": {"D": 0.2, "X0": [0.1, 0.0, 0.1, 0.0]},
    "scalar": {"D": 1.0, "X0": [1.0]},
    "activator_repressor": {"D": 1.0, "X0": [0.03, 30.0]},
}


@pytest.mark.parametrize("name", FOUR)
def test_the_prediction_in_the_loop_does_not_jump_with_the_grid(name):
    """|P(1, t) - X(t + D)| past 2 D on a grid as fine as the control step, and on one that has one node less."""
    plant, case, dt = plants.resolve(name), FOUR[name], 0.005
    late, errors = round(case["D"] / dt), []
    for nx in (late, late + 1):
        loop = simulate(plant, RK4(plant, nx), **case, D_hat=case["D"], t_end=6.0, dt=dt)
        errors.append(np.abs(loop.P[:-late] - loop.X[late:])[2 * late :].max())
    # by cubics, which the means of held commands overshoot: 3.3e-5, 5.6e-6, 8.1e-7 and 1.5e-6 on the second grid
    assert (
        max(errors) < {"planar_arm2": 2e-5, "cart_pole": 3.3e-6, "scalar": 4.5e-7, "activator_repressor": 8.5e-7}[name]
    )


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "D_hat", "law", "today"),  # today: the errors of one reading of u for both, at nx = D / dt and one more
    [
        ("planar_arm2", 0.35, DelayAdaptation(0.5, 1.0, (0.1, 0.6)), (3.90e-3, 7.43e-4)),
        ("cart_pole", 0.3, DelayAdaptation(1.0, 1.0, (0.1, 0.3)), (3.81e-3, 3.34e-3)),
        ("scalar", 2.0, DelayAdaptation(1.0, 1.0, (0.5, 2.0)), (5.35e-3, 4.08e-3)),
        ("activator_repressor", 2.0, DelayAdaptation(1000.0, 1.0, (0.1, 4.0)), (1.15e-2, 9.97e-3)),
    ],
)
def test_the_estimate_is_closer_to_its_mesh_limit_than_with_one_reading_of_u(name, D_hat, law, today):
    """D_hat at the end against the limit dt to 0, extrapolated from two finer runs of first order."""
    plant, case = plants.resolve(name), FOUR[name]
    t_end = {"planar_arm2": 12.0, "cart_pole": 10.0, "scalar": 12.0, "activator_repressor": 20.0}[name]

    def end(dt, nx):
        loop = simulate(plant, RK4(plant, nx), **case, D_hat=D_hat, t_end=t_end, dt=dt, adaptation=law)
        return loop.D_hat[round(t_end / dt) - round(0.005 / dt)]

    finer = [end(0.005 / split, round(case["D"] * split / 0.005) + 1) for split in (4, 8)]
    limit, late = 2 * finer[1] - finer[0], round(case["D"] / 0.005)
    for nx, before in zip((late, late + 1), today, strict=True):
        assert abs(end(0.005, nx) - limit) <= before
