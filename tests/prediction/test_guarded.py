"""Guarded predictors: the estimate against SciPy, what passes and what does not, loops as numerics' own."""

from pathlib import Path

import numpy as np
import pytest
from follower import follower
from guard_samples import BOX, NX, PLANT, Wrong, rows
from hypothesis import given, settings
from hypothesis import strategies as st
from safetensors.numpy import load_file, save_file
from scipy.integrate import solve_ivp
from stiff_plants import Sprung
from varying_delays import with_delay

import npred
from npred import plants
from npred.base import grid
from npred.base.errors import ConfigError
from npred.guard.guarded import Guarded, bare
from npred.loop import metrics
from npred.networks.domain import FILE, Domain, _features, legendre
from npred.plants import Plant
from npred.prediction.methods import RK4, Predictor
from npred.prediction.methods.coarse import Coarse, straight
from npred.prediction.methods.semi_implicit import SemiImplicit


def referee(X, u, D_hat, plant=PLANT):
    """kappa(P(1)) of all rows by SciPy, u linear between nodes."""
    nodes = grid.nodes(NX)

    def f(x, P):
        inputs = np.array([np.interp(x, nodes, row) for row in u[:, :, 0]])[:, None]
        return (D_hat[:, None] * plant.f(P.reshape(X.shape), inputs, 0.0)).ravel()

    end = solve_ivp(f, (0, 1), X.ravel(), rtol=1e-10, atol=1e-12, max_step=0.02).y[:, -1]
    return plant.kappa(end.reshape(X.shape), 0.0)


@pytest.mark.parametrize("size", [0.05, 0.3])
def test_the_estimate_is_the_error_of_U_where_that_decides(size):
    X, u, D_hat = rows()
    model = Wrong(PLANT, error=size)
    U = PLANT.kappa(model(X, u, D_hat)[:, -1], 0.0)
    true = np.abs(U - referee(X, u, D_hat)).max(axis=1)
    decides = true > 0.003
    assert decides.sum() >= 10
    ratio = (npred.guarded(model).error(X, u, D_hat) / true)[decides]
    assert 0.8 < np.median(ratio) < 1.2
    assert (ratio > 0.3).all() and (ratio < 10).all()


def test_of_an_exact_prediction_the_estimate_falls_with_the_cube_of_the_step():
    """The local errors of the shadows are of order h³, and the grids' difference of order 4; one of h² is left over."""
    X, u, D_hat = rows()
    guarded = Guarded(npred.predictor(PLANT, "rk4", 241))
    u = grid.refine(u, 241)
    P = guarded.exact(X, u, D_hat)
    levels = [[10, 20], [20, 40], [40, 80]]
    errors = [np.median(guarded._run(guarded._set(np.inf, pair), P, X, u, D_hat, 0.0)[1]) for pair in levels]
    slope = np.polyfit(np.log([4, 2, 1]), np.log(errors), 1)[0]
    assert slope == pytest.approx(2.0, abs=0.4)


@given(size=st.floats(1e-5, 0.3), row=st.integers(0, 39))
@settings(max_examples=60, deadline=None)
def test_what_is_clearly_wrong_is_answered_by_numerics_and_what_is_clearly_right_is_not(size, row):
    X, u, D_hat = (a[row] for a in rows())
    model, tolerance = Wrong(PLANT, error=size), 0.01
    guarded = Guarded(model, tolerance)
    U, exact = (PLANT.kappa(p(X, u, D_hat)[-1], 0.0) for p in (model, guarded.exact))
    true = np.abs(U - exact).max()
    if true > 1.5 * tolerance:
        assert guarded.fallback(X, u, D_hat)
        np.testing.assert_array_equal(guarded(X, u, D_hat), guarded.exact(X, u, D_hat))
    if true < 0.3 * tolerance:
        assert not guarded.fallback(X, u, D_hat)
        np.testing.assert_array_equal(guarded(X, u, D_hat), model(X, u, D_hat))


def loop(predictor, **arguments):
    settings = {"D": 1.0, "D_hat": np.array([0.5, 2.0]), "X0": [0.03, 30.0], "t_end": 8.0, "dt": 0.01}
    return npred.simulate(PLANT, predictor, adaptation=npred.DelayAdaptation(), **(settings | arguments))


def test_a_loop_that_always_falls_back_is_the_numerical_one_and_counts_every_step():
    run, exact = (loop(p) for p in (npred.guarded(Wrong(PLANT, error=0.5), 1e-12), npred.predictor(PLANT, "rk4", NX)))
    np.testing.assert_array_equal(run.X, exact.X)
    assert run.fallback.all() and (run.fallbacks == run.steps).all() and run.fallback_share == 1.0


class Escape:
    """X' = X² leaves the numbers at t = 1 / X(0)."""

    states, inputs, guess = ("X",), ("U",), (0.0,)
    f = lambda x, u, t, p, M: [x.X**2 + 0 * u.U]
    kappa = lambda x, t, p, M: [-x.X]


def test_a_loop_that_is_lost_falls_back_no_more():
    plant = Plant("escape", Escape)
    guarded = npred.guarded(npred.predictor(plant, "heun", 11), 1e-300)
    run = npred.simulate(plant, guarded, D=0.1, D_hat=0.1, X0=[2.0], t_end=1.0, dt=0.001)
    assert 450 < run.escaped < 700 and run.fallbacks == run.escaped


def test_a_loop_that_never_falls_back_is_the_bare_one():
    heun = npred.predictor(PLANT, "heun", NX)
    guarded = npred.guarded(heun, 0.05)
    run, alone = loop(guarded), loop(heun)
    np.testing.assert_array_equal(run.X, alone.X)
    assert not run.fallback.any() and run.fallback_share == 0.0 and guarded.compiled


def test_kept_states_say_whether_the_guard_answered_since_the_one_before():
    guarded = npred.guarded(Wrong(PLANT, error=0.05), 0.005)
    every, thinned = loop(guarded), loop(guarded, every=7)
    assert 0 < every.fallback_share < 1
    expected = [every.fallback[:, max(k - 6, 0) : k + 1].any(axis=1) for k in range(0, every.X.shape[1], 7)]
    np.testing.assert_array_equal(thinned.fallback, np.transpose(expected))
    np.testing.assert_array_equal(thinned.fallbacks, every.fallbacks)


def test_the_controller_steps_as_the_loop_and_says_when_the_guard_answered():
    guarded = npred.guarded(Wrong(PLANT, error=0.05), 0.005)
    run = loop(guarded, D_hat=0.5, samples=np.array([0, 1, 2, 3]), input_bounds=[[-10.0, 10.0]])
    controller = npred.controller(
        PLANT, guarded, None, 0.01, D_hat=0.5, input_bounds=[[-10.0, 10.0]], actuator="measured"
    )
    for k in range(3):
        U = controller.step(run.samples.X[k], run.samples.u[k])
        np.testing.assert_allclose(U, run.U[k], atol=1e-3)
        assert controller.status.fallback == run.fallback[k]
        assert (controller.status.error > 0.0025) == controller.status.fallback


def test_plants_of_every_family_are_guarded(tmp_path):
    """Distinct delays with a clock, a declared delay, a reference, a black box: exact passes, wrong does not."""
    path = tmp_path / "box.py"
    path.write_text(BOX)
    for plant in (npred.plant("unicycle"), npred.plant("transport_tank"), follower(), npred.plant(f"{path}:Box")):
        rng = np.random.default_rng(1)
        X = np.broadcast_to(np.asarray(plant.target(0.0)), (4, plant.n)) + 0.05 * rng.standard_normal((4, plant.n))
        u = np.full((4, NX, plant.m), 0.1) + (plant.u_equilibrium if plant.rests else 0.0)
        exact = npred.predictor(plant, "rk4", NX)
        assert not Guarded(exact, 0.03).fallback(X, u, 0.5).any(), plant.name
        wrong = Wrong(plant, error=0.1)
        fallback = Guarded(wrong, 1e-6).fallback(X, u, 0.5)
        assert fallback.all(), plant.name
        np.testing.assert_array_equal(Guarded(wrong, 1e-6)(X, u, 0.5), exact(X, u, 0.5))


def test_outside_the_data_numerics_answer_although_the_estimate_is_small():
    X, u, D_hat = rows(400)
    X[:, 1], D_hat[:] = 30 + 20 * (D_hat - 1), D_hat  # a state and a delay that come together
    parts = [type("Rows", (), {"X": X, "u": u, "D_hat": D_hat, "t": np.zeros(len(X))})()]
    model = npred.predictor(PLANT, "heun", NX)
    model.operator = type("Operator", (), {"domain": Domain.of_parts(lambda: parts, X.std(axis=0), PLANT.phase)})()
    guarded = Guarded(model, 0.05)
    assert not guarded.fallback(X, u, D_hat).any()
    apart = guarded.fallback(X[:1], u[:1], np.array([0.4 if D_hat[0] > 1 else 1.9]))  # both occur, never together
    assert apart.all() and guarded.error(X[:1], u[:1], D_hat[:1]) < 0.05
    assert guarded.fallback(X[:1] * 3, u[:1], D_hat[:1]).all()


def resolved(count=200):
    """A guard of Heun's method, and smooth rows that its domain is of, all of them examples."""
    X, u, D_hat = rows(count)
    parts = [type("Rows", (), {"X": X, "u": u, "D_hat": D_hat, "t": np.zeros(count)})()]
    model = npred.predictor(PLANT, "heun", NX)
    model.operator = type("Operator", (), {"domain": Domain.of_parts(lambda: parts, X.std(axis=0), PLANT.phase)})()
    return Guarded(model, 0.05), X, u, D_hat


def test_the_kernel_refuses_what_is_beyond_the_data():
    guarded, X, u, D_hat = resolved()
    X = X * np.random.default_rng(2).uniform(0.6, 1.8, X.shape)
    beyond = guarded.beyond(X, u, D_hat, np.zeros(len(X)))
    doubted = guarded.error(X, u, D_hat) > guarded.threshold
    np.testing.assert_array_equal(guarded.fallback(X, u, D_hat), doubted | (beyond > 1))
    assert 0.1 < (beyond > 1).mean() < 0.9 > doubted.mean()
    assert (npred.guarded(npred.predictor(PLANT, "heun", NX)).beyond(X, u, D_hat, 0 * D_hat) == 0).all()


def test_how_u_may_be_read_counts_as_far_as_it_moves_U():
    """A zigzag of the nodes: a cubic reads it as a line does but for the ends, a bend of one sign otherwise."""
    guarded, X, u, D_hat = resolved()
    spread = guarded.error(X, u, D_hat)
    bent = u + 0.1 * (np.arange(NX) > NX - 3)[:, None] * np.arange(NX)[:, None] % 2
    moved = guarded.error(X, bent, D_hat)
    line, cubic = (PLANT.kappa(end) for end in (ends(X, bent, D_hat, k) for k in ("linear", "cubic")))
    apart = np.abs(line - cubic).max(axis=1)
    assert (moved > 0.8 * apart).all() and np.median(moved - spread) > 0.3 * np.median(apart)


def test_a_feature_out_of_its_range_is_outside_although_one_far_row_stretches_the_ellipsoid():
    X, u, D_hat = rows(400)
    u[0] += 30.0
    data = type("Rows", (), {"X": X, "u": u, "D_hat": D_hat, "t": np.zeros(len(X))})()
    model = npred.predictor(PLANT, "heun", NX)
    model.operator = type("Operator", (), {"domain": Domain.of_parts(lambda: [data], X.std(axis=0), PLANT.phase)})()
    guarded, longer = Guarded(model, 0.05), np.array([3.0])
    assert not guarded.fallback(X[1], u[1], D_hat.max() + 0.2)
    features = _features(X[1:2], u[1:2], longer, None, guarded.domain.bend)
    assert np.linalg.norm((features - guarded.domain.mean) @ guarded.domain.whiten.T) < guarded.domain.limit
    assert guarded.beyond(X[1:2], u[1:2], longer, np.zeros(1)) > 1 and guarded.fallback(X[1], u[1], 3.0)


class Squared:
    """A plant that is not affine in its input."""

    states, inputs, guess = ("a", "b"), ("v",), (0.0, 0.0)
    f = lambda x, u, t, p, M: [x.b - x.a, u.v**2 - x.b + 0.2 * u.v * x.a]
    kappa = lambda x, t, p, M: [-x.a - x.b]


def rough(plant, size):
    """A guard of a model that reads lines on 4 cells, and calls X, u, D_hat. u turns from node to node; neither
    the straight lines of the level that decides nor the moments of the domain tell of that.
    """
    X, u, D_hat = rows(200)
    data = type("Rows", (), {"X": X, "u": u, "D_hat": D_hat, "t": np.zeros(len(X))})()
    model = Coarse(plant, RK4, 4, NX)
    model.operator = type("Operator", (), {"domain": Domain.of_parts(lambda: [data], X.std(axis=0), plant.phase)})()
    guarded = Guarded(model, 0.01)
    lines = straight(np.eye(NX)[..., None], guarded.reference[1][1])[..., 0]
    lines = np.concatenate([lines, legendre(NX).T], axis=1)
    turns = np.random.default_rng(3).choice([-1.0, 1.0], (len(X), NX))
    turns -= turns @ lines @ np.linalg.pinv(lines)
    return guarded, (X, u + size * turns[..., None], D_hat)


@pytest.mark.parametrize("plant, size", [(PLANT, 4.0), (Plant("squared", Squared), 0.3)], ids=["affine", "not affine"])
def test_inputs_that_are_rough_between_the_shadows_lines_pass_only_where_U_hardly_moves(plant, size):
    guarded, calls = rough(plant, size)
    wrong = np.abs(plant.kappa(guarded.model(*calls)[:, -1]) - referee(*calls, plant)).max(axis=1) > 0.011
    assert wrong.sum() > 20 and guarded.fallback(*calls)[wrong].all()
    slight, calls = rough(plant, size / 30)
    assert slight.fallback(*calls).mean() < 0.05


def ends(X, u, D_hat, kind):
    """P(1) by SciPy for each reading of u."""
    nodes = grid.nodes(NX)

    def f(x, P):
        inputs = [
            np.interp(x, nodes, row) if kind == "linear" else grid.read(row[:, None], np.array([x]))[0, 0]
            for row in u[:, :, 0]
        ]
        return (D_hat[:, None] * PLANT.f(P.reshape(X.shape), np.array(inputs)[:, None], 0.0)).ravel()

    return solve_ivp(f, (0, 1), X.ravel(), rtol=1e-8, atol=1e-10, max_step=0.02).y[:, -1].reshape(X.shape)


@pytest.mark.parametrize(
    "plant", [with_delay(lambda x, t, p, M: 0.3 + x.x**2 + 0 * x.y), npred.plant("unicycle_time_delay")]
)
def test_the_law_is_read_at_the_time_of_each_row(plant):
    """Whether the prediction depends on the time, or the law alone."""
    t, D = np.array([0.0, 0.7, 2.0]), 0.39
    X, u = np.full((3, plant.n), 0.3), np.full((3, NX, plant.m), 0.2)
    guarded = npred.guarded(Wrong(plant, error=0.05))
    U, exact = (metrics.law(plant, p(X, u, D, t), t, D) for p in (guarded.model, guarded.exact))
    true = np.abs(U - exact).max(axis=1)
    np.testing.assert_allclose(guarded.error(X, u, D, t), true, rtol=0.05)
    assert np.ptp(true) > 0.2 * true.max()


def test_a_delay_that_tells_the_time_is_a_feature_of_the_domain_and_its_phase_is_none():
    plant, t = npred.plant("unicycle_time_delay"), np.linspace(0.0, 8.0, 200)
    rng = np.random.default_rng(4)
    X, u, D = (
        rng.uniform(-1, 1, (200, 3)),
        np.ones((200, NX, 2)) * rng.uniform(-1, 1, (200, 1, 2)),
        (1 + t) / (1 + 2 * t),
    )
    parts = [type("Rows", (), {"X": X, "u": u, "D_hat": D, "t": t})()]
    model = npred.predictor(plant, "heun", NX)
    model.operator = type("Operator", (), {"domain": Domain.of_parts(lambda: parts, np.ones(3), plant.phase)})()
    guarded = Guarded(model, 1.0)
    assert not guarded.fallback(X, u, D, t).any()
    assert guarded.fallback(X, u, D + 0.6, t).all()


def test_a_domain_is_read_back_as_it_was_saved(tmp_path):
    X, u, D_hat = rows(30)
    parts = [type("Rows", (), {"X": X, "u": u, "D_hat": D_hat, "t": np.zeros(30)})()]
    domain = Domain.of_parts(lambda: parts, np.ones(2), PLANT.phase)
    domain.save(tmp_path)
    loaded = Domain.load(tmp_path)
    for name in vars(domain):
        np.testing.assert_array_equal(getattr(loaded, name), getattr(domain, name))
    assert Domain.load(tmp_path / "none") is None
    tensors = {name: array for name, array in load_file(tmp_path / FILE).items() if name not in ("middle", "half")}
    save_file(tensors, tmp_path / FILE)
    assert np.isinf(Domain.load(tmp_path).half).all()  # of a network that was trained before there were ranges


def test_errors_of_predictions_are_in_units_of_U():
    X, u, D_hat = rows()
    model = Wrong(PLANT, error=0.02)
    guarded = npred.guarded(model)
    U, exact = (metrics.law(PLANT, p(X, u, D_hat), 0.0, D_hat) for p in (model, model.exact))
    np.testing.assert_allclose(guarded.error(X, u, D_hat), np.abs(U - exact).max(axis=1), rtol=0.25, atol=5e-5)
    assert bare(guarded) is model and guarded.error(X[0], u[0], D_hat[0]).shape == ()


def test_refusals_are_one_line_each():
    heun = npred.predictor(PLANT, "heun", NX)
    for refused, call in {
        "tolerance: expected a number above 0": lambda: npred.guarded(heun, 0.0),
        "guarded: expected a Predictor": lambda: npred.guarded("deeponet"),
        "guarded: expected a model on 5 nodes or more, got 4": lambda: npred.guarded(npred.predictor(PLANT, "heun", 4)),
        "u: expected 51 nodes": lambda: npred.guarded(heun)([0.03, 30.0], np.zeros((21, 1)), 1.0),
    }.items():
        with pytest.raises(ConfigError, match=refused) as error:
            call()
        assert "\n" not in str(error.value)


class Smooth(Predictor):
    """A stiff plant's prediction with an error of the rates and positions that the input drives."""

    def __init__(self, plant, rows, nx=NX, error=0.0):
        super().__init__(plant, nx)
        self.error, self.fine = error, Coarse(plant, SemiImplicit, 200, nx)
        domain = Domain.of_parts(lambda: [rows], rows.X.std(axis=0), plant.phase)
        self.operator = type("Operator", (), {"domain": domain})()

    def predict(self, X, u, D_hat, t):
        P, x = self.fine(X, u, D_hat, t), grid.nodes(u.shape[1])[:, None]
        return P + self.error * x * np.sin(37 * X[:, :1] + u.mean(axis=1))[:, None]


@pytest.fixture(scope="module")
def stiff():
    """A stiff plant, and rows whose input jumps inside the delay."""
    plant, rng, count = Plant("sprung", Sprung, {"drag": 300.0}), np.random.default_rng(5), 300
    x, jumps = grid.nodes(NX), rng.uniform(0.2, 0.8, (count, 1))
    u = 200.0 * np.where(x < jumps, rng.normal(size=(count, 1)), rng.normal(size=(count, 1)))[..., None]
    X, D_hat = rng.normal(size=(count, 2)) * [0.01, 0.5], rng.uniform(0.8, 1.2, count)
    return plant, type("Rows", (), {"X": X, "u": u, "D_hat": D_hat, "t": np.zeros(count)})()


def test_on_a_stiff_plant_an_implicit_method_estimates_and_answers_on_few_steps(stiff):
    plant, rows = stiff
    guarded = Guarded(Smooth(plant, rows, error=0.002), 0.01)
    name, levels = guarded.reference
    assert name in ("semi_implicit", "rosenbrock") and levels[1] <= 24
    assert isinstance(guarded.exact, Coarse) and guarded.exact.count < 50
    assert np.abs(npred.predictor(plant, "rk4", NX)(rows.X, rows.u, rows.D_hat)[:, -1]).max() > 1e6
    assert guarded.fallback(rows.X, rows.u, rows.D_hat).mean() < 0.01


@pytest.mark.parametrize("error", [0.004, 0.015, 0.05])
def test_on_a_stiff_plant_the_estimate_is_the_error_and_what_is_wrong_is_answered(stiff, error):
    plant, rows = stiff
    model = Smooth(plant, rows, error=error)
    guarded, inputs = Guarded(model, 0.01), (rows.X, rows.u, rows.D_hat)
    true = np.abs(plant.kappa(model(*inputs)[:, -1]) - plant.kappa(model.fine(*inputs)[:, -1])).max(axis=1)
    estimate, fallback = guarded.error(*inputs), guarded.fallback(*inputs)
    decides = true > 0.003
    assert decides.any() and 0.5 < np.median((estimate / true)[decides]) < 2
    assert np.quantile((estimate / true)[decides], (0.01, 0.99)) == pytest.approx([1.6, 1.6], abs=1.4)
    assert fallback[true > 0.01].all() and fallback[true < 0.002].mean() < 0.02
    answered = plant.kappa(guarded(*inputs)[:, -1])[fallback]
    np.testing.assert_allclose(answered, plant.kappa(model.fine(*inputs)[:, -1])[fallback], atol=0.005)


def test_the_next_level_is_asked_where_one_does_not_decide_and_not_where_it_does(stiff):
    plant, rows = stiff
    guarded = Guarded(Smooth(plant, rows, error=0.0002), 0.001)
    P, inputs = guarded.model(rows.X, rows.u, rows.D_hat), (rows.X, rows.u, rows.D_hat, np.zeros(len(rows.X)))
    settings = (guarded._set(guarded.threshold, levels) for levels in ([2, 4], [2, 4, 8, 16]))
    (_, first, doubted), (_, last, refined) = (guarded._run(s, P, *inputs) for s in settings)
    assert refined.sum() < doubted.sum()
    np.testing.assert_array_equal(first[~doubted], last[~doubted])


def test_the_guard_of_one_call_is_that_of_many(stiff):
    plant, rows = stiff
    guarded = Guarded(Smooth(plant, rows, error=0.006), 0.01)
    together = guarded.error(rows.X[:20], rows.u[:20], rows.D_hat[:20])
    alone = [guarded.error(*row) for row in zip(rows.X[:20], rows.u[:20], rows.D_hat[:20], strict=True)]
    np.testing.assert_allclose(together, alone, rtol=1e-9)


def test_without_examples_the_method_of_an_implicit_exact_predictor_estimates():
    plant = Plant("sprung", Sprung)
    model, exact = (npred.predictor(plant, "rosenbrock", NX) for _ in range(2))
    assert Guarded(model, 0.01, exact=exact).reference[0] == "rosenbrock"
    assert not Guarded(model, 0.01, exact=exact).fallback([0.0, 0.5], np.zeros((NX, 1)), 1.0)
    assert Guarded(model, 0.01).fallback([0.0, 0.5], np.zeros((NX, 1)), 1.0)  # RK4's diverges: it doubts


class Crossed:
    """Two states and two inputs, of which the second one's law is the steeper."""

    states, inputs, guess = ("a", "b"), ("v", "w"), (0.0, 0.0)
    f = lambda x, u, t, p, M: [x.b - x.a**3 + u.v, u.w - x.a * x.b]
    kappa = lambda x, t, p, M: [3 * x.a + x.b, -x.a - 2 * x.b]


def shadows(plant, X, u, D_hat, count, K=4):
    """kappa at the ends of the guard's shadows (K, B, m), written once more: lines on cells, RK4, the midpoint rule."""
    h, lines, ends, loss = D_hat[:, None] / count, straight(u, count), [], lost(u, count)
    for k in range(K):
        x = X
        for j in range(count):
            tilt = {1: 1 / np.pi, 2: np.sqrt(1.5)}.get(k, 0.0) * np.sqrt(loss[j // 2]) if j // 2 < len(loss) else 0.0
            a, b = lines[:, 2 * j] + (-1) ** j * tilt, lines[:, 2 * j + 1] - (-1) ** j * tilt
            k1 = plant.f(x, a)
            k2 = plant.f(x + h / 2 * k1, (a + b) / 2)
            k3 = plant.f(x + h / 2 * k2, (a + b) / 2)
            k4 = plant.f(x + h * k3, b)
            y = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
            x = y + {0: 0.0, 1: -1.0, 2: 1.0, 3: sign(K * j + k)}[k] * (y - x - h * k2)
        ends.append(plant.kappa(x))
    return np.array(ends)


def lost(u, count):
    """The mean square of what straight lines lose of u, of each two cells, (count // 2, B, m): on 2400 places."""
    s = (np.arange(2400) + 0.5) / 2400
    cell, part, lines = (s * count).astype(int), (s * count % 1)[:, None], straight(u, count)
    w = u[:, np.rint(s * (NX - 1)).astype(int)] - (1 - part) * lines[:, 2 * cell] - part * lines[:, 2 * cell + 1]
    return [np.mean(w[:, cell // 2 == pair] ** 2, axis=1) for pair in range(count // 2)]


def sign(number):
    """The last of three multiplications of the bits of a number, modulo 2³²."""
    bits = number * 2654435769 % 2**32
    for factor, shift in ((2246822507, 16), (3266489909, 13)):
        bits = (bits ^ (bits >> shift)) * factor % 2**32
    return 1.0 if bits >> 31 else -1.0


@pytest.mark.parametrize("levels", [[3, 6], [4, 12]])
def test_the_estimate_is_the_gap_to_the_shadows_and_how_far_they_come_apart(levels):
    """|U - R| + 2 max |U_k - U_0| + |U_0 - B| with R = U_0 + (U_0 - B) / (ratio⁴ - 1), the largest over the inputs."""
    plant, rng = Plant("crossed", Crossed), np.random.default_rng(11)
    X, D_hat = 0.4 * rng.normal(size=(60, 2)), rng.uniform(0.5, 1.0, 60)
    u = 0.4 * rng.normal(size=(60, 1, 2)) * np.cos(np.outer(9 * rng.uniform(size=60), grid.nodes(NX)))[..., None]
    u[:, NX // 3 :] += rng.normal(size=(60, 1, 2))
    P = Wrong(plant, error=0.003)(X, u, D_hat)
    U, (B, *_), (A, *others) = plant.kappa(P[:, -1]), *(shadows(plant, X, u, D_hat, k) for k in levels)
    gap = np.abs(U - A - (A - B) / ((levels[1] / levels[0]) ** 4 - 1))
    spread = 2 * np.abs(np.array(others) - A).max(axis=0) + np.abs(A - B)
    expected = (gap + spread).max(axis=1)
    guarded = Guarded(Wrong(plant), 1.25 * np.median(expected))  # what passes is 0.8 of the tolerance
    _, estimate, fallback = guarded._run(guarded._set(guarded.threshold, levels), P, X, u, D_hat, 0.0)
    np.testing.assert_allclose(estimate, expected, rtol=1e-5)  # `lost` is by quadrature
    clear = np.abs(expected / np.median(expected) - 1) > 1e-5
    np.testing.assert_array_equal(fallback[clear], (expected > np.median(expected))[clear])
    assert 0.1 < np.median(spread.max(axis=1) / expected) < 0.9  # both parts count
    assert 0.1 < np.mean((gap + spread).argmax(axis=1)) < 0.9  # and both inputs


def test_inputs_that_are_read_at_nodes_only_have_shadows_on_all_of_them_and_on_twice_as_many_intervals(monkeypatch):
    """In wider intervals two grids lose alike what two inputs do together."""
    guarded = Guarded(RK4(plants.resolve("unicycle"), 51), 0.05)
    monkeypatch.setattr(Guarded, "domain", object())
    assert guarded.reference == ("rk4", [50, 100])


def test_calls_that_an_adversary_has_passed_fall_back_now():
    """Rough inputs with two delays, a network's P̂, and its true error, 1.3 to 5 times the tolerance (DOP853)."""
    calls = np.load(Path(__file__).parent.parent / "guard_calls.npz")
    guarded = Guarded(RK4(plants.resolve("unicycle"), 51), 0.05)
    _, fallback = guarded.judge(*(calls[name] for name in ("P_hat", "X", "u", "D_hat", "t")))
    assert (calls["error"] > 0.06).all() and fallback.all()
