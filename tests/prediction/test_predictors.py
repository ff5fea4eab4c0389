"""Numerical predictors: golden numbers, orders, closed form, few cells; and the baselines in plain Python."""

import multiprocessing
import pickle
from concurrent.futures import ProcessPoolExecutor
from types import SimpleNamespace

import numpy as np
import pytest
from conftest import HERE
from golden import CASES, case
from hypothesis import given, settings
from hypothesis import strategies as st
from operator_samples import SMALL, operator
from scipy.integrate import solve_ivp
from stiff_plants import Sprung

import npred
from npred import plants
from npred.base import grid, registry
from npred.base.errors import ConfigError, DivergedError
from npred.base.registry import METHODS
from npred.lab.scheduler.configuration import identity
from npred.loop.closed_loop import simulate
from npred.networks import predictor as predictor_of
from npred.plants import Plant
from npred.plants.black_box import BlackBox
from npred.prediction import methods as predictors
from npred.prediction.delays import problem_of
from npred.prediction.methods import RK4, Euler, Picard, Predictor, method
from npred.prediction.methods.coarse import Coarse, Examples, straight

PLANT = plants.resolve("activator_repressor")
SCALAR = plants.resolve("scalar", {"a": 0.8})
SERVED = [name for name in METHODS.builtin if problem_of(PLANT).refusal(name) is None]


def predict(method, name, nx):
    golden = case(name)
    return predictors.numerical(method, PLANT, nx)(golden.X, golden.means(nx), golden.D_hat)


@pytest.mark.parametrize("name", CASES)
def test_golden_P_on_a_fine_grid(name):
    golden = case(name)
    np.testing.assert_allclose(golden.quarters(predict("rk4", name, 2001)), golden.P, rtol=0, atol=1e-8)


@pytest.mark.parametrize("name", CASES)
def test_golden_transition_matrix_as_derivative_of_P(name):
    """Phi(x, 0) = dP/dX by central differences of the fine RK4 predictor."""
    golden, rk4 = case(name), predictors.numerical("rk4", PLANT, 2001)
    u = golden.means(2001)
    columns = []
    for k, h in enumerate((1e-5 * golden.X[0], 1e-5 * golden.X[1])):
        unit = h * np.eye(2)[k]
        d = [rk4(golden.X + s * unit, u, golden.D_hat) for s in (-2, -1, 1, 2)]
        columns.append(golden.quarters((d[0] - 8 * d[1] + 8 * d[2] - d[3]) / (12 * h)))  # fourth order
    np.testing.assert_allclose(np.stack(columns, axis=-1), golden.Phi, rtol=1e-8, atol=1e-8)


@pytest.mark.parametrize("method", SERVED)
@pytest.mark.parametrize("name", CASES)
def test_fitted_order(method, name):
    golden, intervals = case(name), np.array([100, 200, 400])
    errors = [np.abs(golden.quarters(predict(method, name, n + 1)) - golden.P).max(axis=0) for n in intervals]
    slopes = -np.polyfit(np.log(intervals), np.log(errors), 1)[0]
    if method == "rk4":  # at both ends u is read to order 3
        assert (slopes > 2.8).all()
    else:
        np.testing.assert_allclose(slopes, predictors.method(method).order, atol=0.2)


def test_rk4_is_of_order_3_with_the_cell_means_that_a_loop_gives():
    """u = .05 cos 3x, whose mean over a cell has a formula, against SciPy."""
    X0, intervals, errors = [0.06, 12.0], np.array([40, 80, 160]), []
    exact = solve_ivp(
        lambda s, x: PLANT.f(x, np.array([0.05 * np.cos(3 * s)])), (0, 1), X0, method="DOP853", rtol=1e-12, atol=1e-14
    ).y[:, -1]
    for n in intervals:
        edges = np.clip((np.arange(n + 2) - 0.5) / n, 0, 1)
        means = 0.05 * np.diff(np.sin(3 * edges)) / (3 * np.diff(edges))
        errors.append(np.linalg.norm(predictors.numerical("rk4", PLANT, n + 1)(X0, means[:, None], 1.0)[-1] - exact))
    assert -np.polyfit(np.log(intervals), np.log(errors), 1)[0] > 2.8


@pytest.mark.parametrize("method", SERVED)
@given(X=st.floats(-3, 3), a=st.floats(-1, 1), c=st.floats(-1, 1), D_hat=st.floats(0, 2))
@settings(max_examples=20)
def test_scalar_closed_form(method, X, a, c, D_hat):
    """P(x) = e^{g x} X + D_hat ∫ e^{g (x - y)} (a + c y) dy with g = 0.8 D_hat."""
    x, nx = grid.nodes(401), 401
    P = predictors.numerical(method, SCALAR, nx)([X], (a + c * x)[:, None], D_hat)[:, 0]
    g = 0.8 * D_hat
    ramp = (np.expm1(g * x) / g if g > 1e-6 else x), ((np.expm1(g * x) / g - x) / g if g > 1e-3 else x**2 / 2)
    exact = np.exp(g * x) * X + D_hat * (a * ramp[0] + c * ramp[1])
    np.testing.assert_allclose(P, exact, atol=0.1 if method == "euler" else 2e-3)


@pytest.mark.parametrize("method", SERVED)
def test_no_delay_predicts_the_state_and_P_starts_at_X(method):
    u = np.linspace(0, 1, 31)[:, None]
    predictor = predictors.numerical(method, PLANT, 31)
    np.testing.assert_array_equal(predictor([0.1, 5.0], u, 0.0), np.tile([0.1, 5.0], (31, 1)))
    np.testing.assert_array_equal(predictor([0.1, 5.0], u, 1.3)[0], [0.1, 5.0])


@pytest.mark.parametrize("method", ["euler", "heun"])
@given(split=st.integers(1, 39), D_hat=st.floats(0.1, 2))
@settings(max_examples=20)
def test_semigroup_in_x(method, split, D_hat):
    """Predicting to x_k and on from there with the rest of u is predicting through."""
    u = 0.1 * np.cos(7 * grid.nodes(41))[:, None]
    predictor = predictors.numerical(method, PLANT, 41)
    P = predictor([0.05, 8.0], u, D_hat)
    rest = predictor(P[split], u[split:], D_hat * (40 - split) / 40)
    np.testing.assert_allclose(rest, P[split:], rtol=1e-12)


@pytest.mark.parametrize("method", SERVED)
def test_batch_equals_single_calls(method):
    """Many lanes and one lane are different code; they agree."""
    random = np.random.default_rng(1)
    X, u, D_hat = (
        random.uniform(0.1, 2, (2, 6, 2)),
        random.uniform(0, 0.2, (2, 6, 41, 1)),
        random.uniform(0.2, 1.5, (2, 6)),
    )
    predictor = predictors.numerical(method, PLANT, 41)
    P = predictor(X, u, D_hat)
    assert P.shape == (2, 6, 41, 2)
    for i in np.ndindex(2, 6):
        np.testing.assert_allclose(P[i], predictor(X[i], u[i], D_hat[i]), rtol=1e-12)


@pytest.mark.parametrize("nx", [2, 3, 4, 5])
def test_few_nodes(nx):
    """A level input is read exactly on any grid."""
    P, x, g = RK4(SCALAR, nx)([1.0], np.full((nx, 1), 0.3), 0.5), grid.nodes(nx), 0.4
    np.testing.assert_allclose(P[:, 0], np.exp(g * x) + 0.5 * 0.3 * np.expm1(g * x) / g, atol=1e-3 if nx == 2 else 1e-4)


@pytest.mark.parametrize(
    ("X", "u", "message"),
    [
        ([0.1], np.zeros((5, 1)), r"X: expected shape \(..., 2\)"),
        ([0.1, 5.0], np.zeros((5, 2)), r"u: expected shape \(..., nx, 1\)"),
        ([0.1, 5.0], np.zeros((1, 1)), r"nx >= 2"),
    ],
)
def test_wrong_shapes_are_told(X, u, message):
    with pytest.raises(ConfigError, match=message):
        Euler(PLANT)(X, u, 1.0)


@pytest.mark.parametrize("nx", [1, 0, 10.5, "many"])
def test_too_few_nodes_are_told(nx):
    with pytest.raises(ConfigError, match="nx: expected at least 2 nodes"):
        Euler(PLANT, nx)


def test_batches_that_do_not_fit_are_told():
    with pytest.raises(ConfigError, match=r"leading axes X \(3,\), u \(\), D_hat \(4,\)"):
        Euler(PLANT)(np.ones((3, 2)), np.zeros((5, 1)), np.ones(4))


def test_picard_that_does_not_contract_says_so():
    with pytest.raises(DivergedError, match="expected a change below 1e-12 within 5 sweeps"):
        Picard(PLANT, 101, sweeps=5)([0.5, 5.0], np.zeros((101, 1)), 2.0)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("kind", [RK4, "own"])
@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"D_hat": -1.0}, "D_hat: expected a delay of at least 0, got -1"),
        ({"D_hat": [0.5, np.nan]}, r"D_hat: expected a delay of at least 0, got nan at \[1\]"),
        ({"D_hat": np.inf}, "D_hat: expected a delay of at least 0, got inf"),
        ({"X": [np.nan, 5.0]}, r"X: expected finite numbers, got nan at \[0\]"),
        ({"X": [0.1 + 1j, 5.0]}, "X: expected an array of real numbers"),
        ({"X": np.ma.array([0.1, 5.0], mask=[0, 1])}, "X: expected an array of real numbers, got a masked array"),
        ({"u": np.full((5, 1), np.inf)}, r"u: expected finite numbers, got inf at \[0, 0\]"),
    ],
)
def test_what_a_loop_refuses_a_call_refuses_too(kind, change, message):
    predictor = Bent(PLANT, 5) if kind == "own" else kind(PLANT, 5)
    with pytest.raises(ConfigError, match=message):
        predictor(**{"X": [0.1, 5.0], "u": np.zeros((5, 1)), "D_hat": 1.0} | change)


class Bent(Predictor):
    """A predictor of one's own, on arrays: P = X + x D_hat f(X, u(0))."""

    def __init__(self, plant, nx=101, shape=None):
        super().__init__(plant, nx)
        self.shape, self.seen = shape, []

    def predict(self, X, u, D_hat, t):
        self.seen.append(np.ndim(t))
        x = grid.nodes(u.shape[1])[:, None]
        P = X[:, None] + x * D_hat[:, None, None] * self.plant.f(X, u[:, 0])[:, None]
        return P if self.shape is None else P.reshape(self.shape)


def test_a_predictor_of_ones_own_needs_predict_alone():
    bent, u = Bent(SCALAR, 2), np.zeros((3, 2, 1))
    np.testing.assert_allclose(bent([[1.0], [2.0], [3.0]], u, 0.5), Euler(SCALAR, 2)([[1.0], [2.0], [3.0]], u, 0.5))
    settings = {"D": 0.3, "D_hat": [0.2, 0.3], "X0": [1.0], "t_end": 1.0, "dt": 0.01}
    loops = simulate(SCALAR, bent, **settings)
    np.testing.assert_allclose(loops.X, simulate(SCALAR, Euler(SCALAR, 2), **settings).X, rtol=1e-12)
    assert set(bent.seen) == {0, 1}
    assert repr(bent) == "<Bent 'predictor' of plant scalar, nx = 2>"


def test_a_predictor_of_ones_own_may_not_write_to_the_loop_nor_return_another_shape():
    class Writes(Bent):
        def predict(self, X, u, D_hat, t):
            u[:] = 0.0
            return super().predict(X, u, D_hat, t)

    settings = {"D": 0.3, "D_hat": 0.3, "X0": [1.0], "t_end": 1.0, "dt": 0.01}
    with pytest.raises(ValueError, match="read-only"):
        simulate(SCALAR, Writes(SCALAR, 2), **settings)
    for act in (lambda: simulate(SCALAR, Bent(SCALAR, 2, (2, 1)), **settings),
                lambda: Bent(SCALAR, 2, (2, 1))([1.0], np.zeros((2, 1)), 0.1)):  # fmt: skip
        with pytest.raises(ConfigError, match=r"Bent.predict: expected to return P \(1, 2, 1\), .* got shape \(2, 1\)"):
            act()


@pytest.mark.parametrize("kind", [*map(predictors.method, SERVED), Bent])
def test_a_predictor_pickles_without_what_it_compiled(kind):
    predictor, u = kind(SCALAR, 5), np.linspace(0, 1, 5)[:, None]
    P = predictor([1.0], u, 0.4)
    copy = pickle.loads(pickle.dumps(predictor))
    assert (copy.nx, copy.name, identity(copy.plant)) == (5, predictor.name, identity(SCALAR))
    np.testing.assert_array_equal(copy([1.0], u, 0.4), P)


def test_what_picard_was_asked_for_is_pickled():
    copy = pickle.loads(pickle.dumps(Picard(SCALAR, 5, tolerance=1e-6, sweeps=7)))
    assert (copy.tolerance, copy.sweeps) == (1e-6, 7)


@pytest.mark.slow
def test_predictors_and_controllers_work_in_a_process_that_was_spawned():
    u, X = np.zeros((21, 1)), [0.03, 30.0]
    runs = [RK4(PLANT, 21), predictor_of("torch", PLANT, operator(SMALL[1]), 21)]
    controller = npred.controller(PLANT, runs[0], None, 0.01, D_hat=1.0, actuator="measured")
    with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as pool:
        for run in runs:
            np.testing.assert_array_equal(pool.submit(run, X, u, 1.0).result(), run(X, u, 1.0))
        np.testing.assert_array_equal(pool.submit(controller.step, X, u).result(), controller.step(X, u))


@pytest.mark.slow
def test_joblib_runs_predictors_and_controllers_in_processes():
    joblib = pytest.importorskip("joblib")
    u, X = np.zeros((21, 1)), [0.03, 30.0]
    run = RK4(PLANT, 21)
    controller = npred.controller(PLANT, run, None, 0.01, D_hat=1.0, actuator="measured")
    with joblib.parallel_config(backend="loky"):
        calls = [joblib.delayed(run)(X, u, D_hat) for D_hat in (0.5, 1.0)]
        *predictions, U = joblib.Parallel(n_jobs=2)([*calls, joblib.delayed(controller.step)(X, u)])
    for P, D_hat in zip(predictions, (0.5, 1.0), strict=True):
        np.testing.assert_array_equal(P, run(X, u, D_hat))
    np.testing.assert_array_equal(U, controller.step(X, u))


SPRUNG = Plant("sprung", Sprung)


def test_the_lines_are_those_of_least_squares():
    """Each node stands for the cell around it, half a cell at the ends; cells that cut these in any place."""
    rng, fine = np.random.default_rng(0), 4000
    u = rng.normal(size=(2, 21, 3))
    for count in (1, 3, 7):
        s = (np.arange(count * fine) + 0.5) / (count * fine) * 20
        dense = u[:, np.minimum((s + 0.5).astype(int), 20)]
        found = straight(u, count)
        for J in range(count):
            part = slice(J * fine, (J + 1) * fine)
            z = (s[part] - J * 20 / count) / (20 / count)
            for row in range(2):
                slope, begin = np.polyfit(z, dense[row, part], 1)
                np.testing.assert_allclose(found[row, 2 * J], begin, atol=2e-3)
                np.testing.assert_allclose(found[row, 2 * J + 1], begin + slope, atol=2e-3)


@pytest.mark.parametrize("name", ["heun", "rosenbrock", "semi_implicit"])
def test_the_order_holds_where_u_jumps_inside_a_cell(name):
    """Of a mass on a damper that is not stiff; by reading u at nodes it would be 1."""
    plant, X, nx, counts = Plant("sprung", Sprung, {"drag": 3.0}), [0.2, 0.5], 2001, np.array([10, 20, 40, 80])
    u, P = [], []
    f = lambda t, P, held: plant.f(P, np.array([held]))
    for node in range(800, 1000, 17):
        u.append(np.where(np.arange(nx) < node, -1.0, 2.0)[:, None])
        place, end = (node - 0.5) / (nx - 1), np.array(X)  # where the nodes' cells change
        for span, held in (((0, place), -1.0), ((place, 1), 2.0)):
            end = solve_ivp(f, span, end, args=(held,), rtol=1e-11, atol=1e-13).y[:, -1]
        P.append(end)
    errors = [np.abs(Coarse(plant, method(name), n, nx)(X, np.array(u), 1.0)[:, -1] - P).max() for n in counts]
    assert -np.polyfit(np.log(counts), np.log(errors), 1)[0] > 1.7
    assert errors[0] < 5e-3


def test_between_the_ends_of_cells_P_is_a_straight_line():
    u = np.sin(3 * grid.nodes(41))[:, None]
    P = Coarse(SPRUNG, method("rosenbrock"), 4, 41)([0.0, 0.5], u, 1.0)
    np.testing.assert_array_equal(P[0], [0.0, 0.5])
    np.testing.assert_allclose(np.diff(P[10:21], 2, axis=0), 0.0, atol=1e-15)


def test_a_plant_that_reads_nodes_alone_is_refused():
    with pytest.raises(ConfigError, match="coarse: expected a traced plant with one constant delay, got unicycle"):
        Coarse(npred.plant("unicycle"), method("heun"), 4)


class Known(Examples):
    """Examples whose U by a method on so many cells is known."""

    U = {}

    def on_cells(self, name, count):
        return self.U[name, count][:, None]


def known(count):
    nobody = np.zeros(count)
    return Known(SimpleNamespace(kappa=lambda P, t: P), nobody, np.zeros((count, 51, 1)), nobody, nobody)


def test_a_step_is_short_enough_for_all_but_one_of_a_hundred_examples(monkeypatch):
    ends = {50: np.zeros(200), 100: np.random.default_rng(0).permutation(200).astype(float)}
    monkeypatch.setattr(Known, "U", {("rk4", count): U for count, U in ends.items()})
    assert known(200).move("rk4", 50) == 198.0
    ends[50][:3] = np.nan
    assert known(200).move("rk4", 50) == np.inf


FILE = HERE.parent / "pipeline" / "interpreted.py"
Published, EulerPython = (registry.BASELINES.load("test", f"{FILE}:{name}") for name in ("Published", "EulerPython"))


@pytest.mark.parametrize("baseline", [EulerPython, Published])
def test_they_equal_euler(baseline):
    golden, nx = case("B"), 41
    u = golden.u(grid.nodes(nx))[:, None]
    np.testing.assert_allclose(baseline(PLANT, nx)(golden.X, u, 1.0), Euler(PLANT, nx)(golden.X, u, 1.0), rtol=1e-12)


def test_a_prediction_that_leaves_the_floats_is_nan_from_there_on():
    plant = plants.resolve("van_der_pol")
    X, u, D_hat = np.full((1, plant.n), 30.0), np.zeros((1, 201, plant.m)), np.full(1, 9.0)
    compiled, interpreted = Euler(plant, 201), EulerPython(plant, 201)
    P, Q = (np.isfinite(one.predict(X, u, D_hat, np.zeros(1))).all(axis=2)[0] for one in (compiled, interpreted))
    assert P[0] and not P[-1] and (P == Q).all()


def test_euler_in_python_works_on_floats_of_python():
    """NumPy's numbers would make the baseline several times slower, and flatter what is compared with it."""
    euler = EulerPython(plants.resolve("planar_arm2"), 11)
    values = euler._f(*[0.1] * 4, *[0.2] * 2, 0.0, *euler.plant.p.tolist())
    assert {type(value) for value in values} == {float}


@pytest.mark.parametrize("baseline", [EulerPython, Published])
def test_they_call_a_plant_that_is_not_traced(baseline):
    class Box:
        traced, states, inputs, box = False, ("x",), ("U",), {"x": (0, 1)}
        f = lambda X, u, t, p: u - X**2
        kappa = lambda X, t, p: -X
        V = lambda X, t, p: X[:, 0] ** 2

    plant, (X, u) = BlackBox("box", Box), (np.array([0.4]), np.full((5, 1), 0.3))
    np.testing.assert_allclose(
        baseline(plant, 5)(X, u, 0.2), predictors.numerical("euler", plant, 5)(X, u, 0.2), rtol=1e-12
    )


@pytest.mark.parametrize("name", ["unicycle", "unicycle_time_delay"])
def test_a_plant_with_other_delays_is_refused(name: str):
    with pytest.raises(ConfigError, match=rf"published: expected a plant with one constant delay .* plant {name} is"):
        Published(plants.resolve(name))


@pytest.mark.parametrize("name", ["euler", "heun", "rk4"])
def test_a_plant_without_a_law_is_predicted_as_with_one(name: str):
    """Another program has the law: a policy, say."""

    class Follower:
        states, inputs, parameters, guess = ("x",), ("u",), {"lag": 0.1}, (0.0,)
        f = lambda x, u, t, p, M: [(u.u - x.x) / p.lag]

    led = type("Led", (Follower,), {"kappa": lambda x, t, p, M: [-x.x]})
    u = np.sin(np.arange(21.0))[:, None]
    both = [npred.predictor(npred.plant(kind), name, nx=21)([1.0], u, 0.2) for kind in (Follower, led)]
    assert np.array_equal(*both) and np.isfinite(both[0]).all()
