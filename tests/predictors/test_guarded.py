"""Guarded predictors: the estimate against SciPy, what passes and what does not, loops as numerics' own."""

import numpy as np
import pytest
from follower import follower
from guard_samples import BOX, NX, PLANT, Wrong, rows
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp
from stiff_plants import Sprung
from varying_delays import with_delay

import npred
from npred import grid
from npred.data.domain import Domain, unread
from npred.errors import ConfigError
from npred.loop import metrics
from npred.plants import Plant
from npred.predictors import Predictor
from npred.predictors.coarse import Coarse
from npred.predictors.guard_kernel import HEAD
from npred.predictors.guarded import Guarded, bare
from npred.predictors.runge_kutta import Heun
from npred.predictors.semi_implicit import SemiImplicit


def referee(X, u, D_hat):
    """kappa(P(1)) of all rows by SciPy, u linear between nodes."""
    nodes = grid.nodes(NX)

    def f(x, P):
        inputs = np.array([np.interp(x, nodes, row) for row in u[:, :, 0]])[:, None]
        return (D_hat[:, None] * PLANT.f(P.reshape(X.shape), inputs, 0.0)).ravel()

    end = solve_ivp(f, (0, 1), X.ravel(), rtol=1e-10, atol=1e-12, max_step=0.02).y[:, -1]
    return PLANT.kappa(end.reshape(X.shape), 0.0)


@pytest.mark.parametrize("by", ["shadow", "defect"])
@pytest.mark.parametrize("size", [0.05, 0.3])
def test_the_estimate_is_the_error_of_U_where_that_decides(by, size):
    X, u, D_hat = rows()
    model = Wrong(PLANT, error=size)
    U = PLANT.kappa(model(X, u, D_hat)[:, -1], 0.0)
    true = np.abs(U - referee(X, u, D_hat)).max(axis=1)
    decides = true > 0.003
    assert decides.sum() >= 10
    ratio = (npred.guarded(model, by=by).error(X, u, D_hat) / true)[decides]
    assert 0.8 < np.median(ratio) < 1.2
    assert (ratio > 0.3).all() and (ratio < 10).all()


@pytest.mark.parametrize("by", ["shadow", "defect"])
def test_of_an_exact_prediction_the_estimate_falls_with_the_square_of_the_step(by):
    X, u, D_hat = rows()
    guarded = Guarded(npred.predictor("rk4", PLANT, 241), by=by)
    u = grid.refine(u, 241)
    P = guarded.exact(X, u, D_hat)
    grids = [(48, 24), (24, 12), (12, 6)]
    errors = [np.median(guarded._run(guarded._set(pair, np.inf), P, X, u, D_hat, 0.0)[1]) for pair in grids]
    slope = np.polyfit(np.log([5, 10, 20]), np.log(errors), 1)[0]
    assert slope == pytest.approx(2.0, abs=0.3)


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
    run, exact = (loop(p) for p in (npred.guarded(Wrong(PLANT, error=0.5), 1e-12), npred.predictor("rk4", PLANT, NX)))
    np.testing.assert_array_equal(run.X, exact.X)
    assert run.fallback.all() and (run.fallbacks == run.steps).all() and run.fallback_share == 1.0


def test_a_loop_that_never_falls_back_is_the_bare_one():
    heun = npred.predictor("heun", PLANT, NX)
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
    controller = npred.controller(PLANT, guarded, None, 0.01, D_hat=0.5, input_bounds=[[-10.0, 10.0]])
    for k in range(3):
        U = controller.step(run.samples.X[k], run.samples.u[k])
        np.testing.assert_allclose(U, run.U[k], atol=1e-3)
        assert controller.fallback == run.fallback[k]
        assert (controller.error > 0.0025) == controller.fallback


def test_correction_takes_away_the_error_by_its_square():
    X, u, D_hat = rows()
    errors = []
    for size in (0.2, 0.1):
        model = Wrong(PLANT, error=size)
        exact = model.exact(X, u, D_hat)[:, -1]
        corrected = npred.guarded(model, 1e9, "defect", correct=True)(X, u, D_hat)[:, -1]
        before = np.linalg.norm(model(X, u, D_hat)[:, -1] - exact, axis=1)
        after = np.linalg.norm(corrected - exact, axis=1)
        assert np.median(after / before) < 0.2
        errors.append(np.median(after))
    assert errors[0] > 3 * errors[1]  # of second order in the error, up to that of the grid


def test_plants_of_every_family_are_guarded(tmp_path):
    """Distinct delays with a clock, a declared delay, a reference, a black box: exact passes, wrong does not."""
    path = tmp_path / "box.py"
    path.write_text(BOX)
    for plant in (npred.plant("unicycle"), npred.plant("transport_tank"), follower(), npred.plant(f"{path}:Box")):
        rng = np.random.default_rng(1)
        X = np.broadcast_to(np.asarray(plant.target(0.0)), (4, plant.n)) + 0.05 * rng.standard_normal((4, plant.n))
        u = np.full((4, NX, plant.m), 0.1) + (plant.u_equilibrium if plant.rests else 0.0)
        exact = npred.predictor("rk4", plant, NX)
        assert not Guarded(exact, 0.03).fallback(X, u, 0.5).any(), plant.name
        wrong = Wrong(plant, error=0.1)
        fallback = Guarded(wrong, 1e-6).fallback(X, u, 0.5)
        assert fallback.all(), plant.name
        np.testing.assert_array_equal(Guarded(wrong, 1e-6)(X, u, 0.5), exact(X, u, 0.5))


def test_outside_the_data_numerics_answer_although_the_estimate_is_small():
    X, u, D_hat = rows(400)
    X[:, 1], D_hat[:] = 30 + 20 * (D_hat - 1), D_hat  # a state and a delay that come together
    parts = [type("Rows", (), {"X": X, "u": u, "D_hat": D_hat, "t": np.zeros(len(X))})()]
    model = npred.predictor("heun", PLANT, NX)
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
    model = npred.predictor("heun", PLANT, NX)
    model.operator = type("Operator", (), {"domain": Domain.of_parts(lambda: parts, X.std(axis=0), PLANT.phase)})()
    return Guarded(model, 0.05), X, u, D_hat


def test_what_the_nodes_do_not_resolve_is_answered_by_numerics():
    guarded, X, u, D_hat = resolved()
    rough = u + 0.05 * (-1.0) ** np.arange(NX)[:, None]
    assert not guarded.fallback(X, u, D_hat).any() and guarded.fallback(X, rough, D_hat).all()
    faint = u + 1e-6 * (-1.0) ** np.arange(NX)[:, None]
    assert guarded.fallback(X, faint, D_hat).mean() < 0.02  # the row that the limit is of may be just outside


def test_no_input_of_the_data_that_both_grids_agree_on_misleads_the_shadow():
    X, u, D_hat = rows(200)
    jumps = np.random.default_rng(6).uniform(0.2, 0.9, (200, 1, 1))
    u = np.where(grid.nodes(NX)[:, None] < jumps, u, u - 0.1)
    parts = [type("Rows", (), {"X": X, "u": u, "D_hat": D_hat, "t": np.zeros(200)})()]
    model, tolerance = npred.predictor("rk4", PLANT, NX), 0.01
    model.operator = type("Operator", (), {"domain": Domain.of_parts(lambda: parts, X.std(axis=0), PLANT.phase)})()
    name, (fine, coarse) = Guarded(model, tolerance).reference
    U = PLANT.kappa(model(X, u, D_hat)[:, -1])

    def misled(count):
        A, B = (PLANT.kappa(Coarse(PLANT, Heun, k, NX)(X, u, D_hat)[:, -1]) for k in (2 * count, count))
        R = A + (A - B) / 3
        return ((np.abs(A - B) <= 0.4 * tolerance) & (np.abs(R - U) > 0.1 * tolerance)).any()

    assert name == "heun" and fine == 2 * coarse
    assert not misled(coarse) and misled(2)


def test_the_kernel_refuses_what_is_beyond_the_data():
    guarded, X, u, D_hat = resolved()
    u = u + np.random.default_rng(2).uniform(0, 0.002, len(u))[:, None, None] * (-1.0) ** np.arange(NX)[:, None]
    beyond = guarded.beyond(X, u, D_hat, np.zeros(len(X)))
    doubted = guarded.error(X, u, D_hat) > guarded.threshold
    np.testing.assert_array_equal(guarded.fallback(X, u, D_hat), doubted | (beyond > 1))
    assert 0.1 < (beyond > 1).mean() < 0.9 > doubted.mean()
    assert (npred.guarded(npred.predictor("heun", PLANT, NX)).beyond(X, u, D_hat, 0 * D_hat) == 0).all()


@given(seed=st.integers(0, 10**6), nx=st.integers(4, 30))
def test_the_bound_of_what_is_unread_holds_and_is_reached(seed, nx):
    """Simpson's rule with the midpoints of the cubic, and the trapezoid rule, on the same nodes."""
    u = np.random.default_rng(seed).normal(size=(3, nx, 2))
    fine = grid.refine(u, 2 * nx - 1)
    h = 1 / (nx - 1)
    simpson = h / 6 * (fine[:, :-2:2] + 4 * fine[:, 1::2] + fine[:, 2::2]).sum(axis=1)
    trapezoid = h / 2 * (u[:, :-1] + u[:, 1:]).sum(axis=1)
    gap = np.abs(simpson - trapezoid)
    assert (gap <= unread(u) * (1 + 1e-9)).all()
    bent = np.linspace(0, 1, nx)[:, None] ** 2 + np.zeros((1, nx, 1))  # all kinks of one sign
    simpson = h**2 / 6  # the error of the trapezoid rule
    np.testing.assert_allclose(unread(bent), simpson, rtol=1e-9)


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
    model = npred.predictor("heun", plant, NX)
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


def test_errors_of_predictions_are_in_units_of_U():
    X, u, D_hat = rows()
    model = Wrong(PLANT, error=0.02)
    guarded = npred.guarded(model)
    U, exact = (metrics.law(PLANT, p(X, u, D_hat), 0.0, D_hat) for p in (model, model.exact))
    np.testing.assert_allclose(guarded.error(X, u, D_hat), np.abs(U - exact).max(axis=1), rtol=0.25, atol=5e-5)
    assert bare(guarded) is model and guarded.error(X[0], u[0], D_hat[0]).shape == ()


def test_refusals_are_one_line_each():
    heun, unicycle = npred.predictor("heun", PLANT, NX), npred.plant("unicycle")
    for refused, call in {
        "tolerance: expected a number above 0": lambda: npred.guarded(heun, 0.0),
        "by: expected auto, shadow, defect": lambda: npred.guarded(heun, by="both"),
        "guarded: expected a Predictor": lambda: npred.guarded("deeponet"),
        "nodes": lambda: npred.guarded(npred.predictor("heun", PLANT, 6)),
        "correct: expected by = 'defect'": lambda: npred.guarded(heun, by="shadow", correct=True),
        "defect: ": lambda: npred.guarded(npred.predictor("heun", unicycle, NX), by="defect"),
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
    name, (fine, coarse) = guarded.reference
    assert name in ("semi_implicit", "rosenbrock") and coarse < fine <= 24
    assert isinstance(guarded.exact, Coarse) and guarded.exact.count < 50
    assert np.abs(npred.predictor("rk4", plant, NX)(rows.X, rows.u, rows.D_hat)[:, -1]).max() > 1e6
    assert not guarded.fallback(rows.X, rows.u, rows.D_hat).any()


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
    assert fallback[true > 0.01].all() and not fallback[true < 0.002].any()
    answered = plant.kappa(guarded(*inputs)[:, -1])[fallback]
    np.testing.assert_allclose(answered, plant.kappa(model.fine(*inputs)[:, -1])[fallback], atol=0.005)


def test_grids_are_refined_where_few_steps_do_not_decide_and_not_where_they_do(stiff):
    plant, rows = stiff
    guarded = Guarded(Smooth(plant, rows, error=0.0002), 0.001)
    coarse = guarded._set((2, 1))
    once = coarse.copy()
    once[HEAD - 1] = 0.0
    P, inputs = guarded.model(rows.X, rows.u, rows.D_hat), (rows.X, rows.u, rows.D_hat, np.zeros(len(rows.X)))
    (_, first, doubted), (_, last, refined) = (guarded._run(s, P, *inputs) for s in (once, coarse))
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
    model, exact = (npred.predictor("rosenbrock", plant, NX) for _ in range(2))
    assert Guarded(model, 0.01, exact=exact).reference[0] == "rosenbrock"
    assert not Guarded(model, 0.01, exact=exact).fallback([0.0, 0.5], np.zeros((NX, 1)), 1.0)
    assert Guarded(model, 0.01).fallback([0.0, 0.5], np.zeros((NX, 1)), 1.0)  # Heun's diverges: it doubts


class Crossed:
    """Two states and two inputs, of which the second one's law is the steeper."""

    states, inputs, guess = ("a", "b"), ("v", "w"), (0.0, 0.0)

    def f(x, u, t, p, M):
        return [x.b - x.a**3 + u.v, u.w - x.a * x.b]

    def kappa(x, t, p, M):
        return [3 * x.a + x.b, -x.a - 2 * x.b]


@pytest.mark.parametrize(("grids", "share"), [((6, 3), 3.0), ((6, 2), 8.0)])
def test_the_estimate_is_the_gap_to_the_extrapolated_law_and_what_the_grids_differ_by(grids, share):
    """|U - R| + |A - B| with R = A + (A - B) / (ratio² - 1), the largest over the inputs; A, B by Heun's method."""
    plant, rng = Plant("crossed", Crossed), np.random.default_rng(11)
    X, D_hat = 0.4 * rng.normal(size=(60, 2)), rng.uniform(0.5, 1.0, 60)
    u = 0.4 * rng.normal(size=(60, 1, 2)) * np.cos(np.outer(3 * rng.uniform(size=60), grid.nodes(NX)))[..., None]
    P = Wrong(plant, error=0.03)(X, u, D_hat)
    U, A, B = (plant.kappa(Q[:, -1]) for Q in (P, *(Coarse(plant, Heun, k, NX)(X, u, D_hat) for k in grids)))
    gap, noise = np.abs(U - A - (A - B) / share), np.abs(A - B)
    expected = (gap + noise).max(axis=1)
    guarded = Guarded(Wrong(plant), 2.5 * np.median(expected))  # what passes is 0.4 of the tolerance
    _, estimate, fallback = guarded._run(guarded._set(grids), P, X, u, D_hat, 0.0)
    np.testing.assert_allclose(estimate, expected, rtol=1e-9)
    np.testing.assert_array_equal(fallback, expected > np.median(expected))
    assert 0.1 < np.median(noise.max(axis=1) / expected) < 0.8  # both parts count
    assert 0.2 < np.mean((gap + noise).argmax(axis=1)) < 0.8  # and both inputs
