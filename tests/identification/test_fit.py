"""The cost of a fit with what is known beforehand, the size of the noise, and which of two fits the data prefer."""

from dataclasses import replace

import numpy as np
import pytest

import npred
from npred.identification.estimate import correlation_time
from npred.identification.fit import Prior, Problem, SegmentFit, better
from npred.identification.log import Log, Segments
from npred.identification.model import RolloutModel

SEGMENTS = 30
ALONE = np.zeros((0, 0)), np.zeros((0, 0)), 0.0, 0.0  # no jumps, as of segments that are not joined


def fit(costs) -> SegmentFit:
    """A fit with these costs of its segments, without parameters."""
    nothing = Prior(np.zeros(0), np.zeros(0), np.zeros((2, 0)))
    e, shape = np.array(costs, dtype=float), (len(costs), 0)
    return SegmentFit(np.zeros(1), np.zeros((len(e), 1)), np.zeros(0), e, np.zeros(shape), np.zeros((*shape, 0)),
                      nothing, np.zeros((len(e), 9, 1)), *ALONE)  # fmt: skip


def gains(*values: float, others: float = 0.0) -> np.ndarray:
    """Costs of 9 a segment, and so much more in the first ones and in the others."""
    return 9.0 + np.append(values, np.full(SEGMENTS - len(values), others))


@pytest.mark.parametrize(
    ("total", "inflation", "decides"), [(15, 1, True), (8, 1, False), (15, 2, False), (30, 2, True)]
)
def test_what_each_segment_says_decides_where_the_sum_is_clear(total, inflation, decides):
    """10.8 of chi² are; of errors that stay on one side for two samples twice as much."""
    even = gains(others=total / SEGMENTS)
    assert better(fit(gains()), fit(even), inflation) is decides
    assert not better(fit(even), fit(gains()), inflation)


@pytest.mark.parametrize("strange", [(20.0,), (1e6,), (np.inf,), (25.0, -9.0)])
def test_one_strange_segment_alone_decides_nothing(strange):
    """Whatever it says, while the others hardly say the reverse: a pump that was off makes no lag of a delay."""
    assert not better(fit(gains()), fit(gains(*strange, others=-0.05)), 1.0)


@pytest.mark.parametrize("strange", [1e6, np.inf])
def test_one_strange_segment_does_not_outvote_the_others(strange):
    assert better(fit(gains()), fit(gains(strange, others=0.5)), 1.0)


def parabolas(rng: np.random.Generator, q: int = 2) -> SegmentFit:
    """A fit about some theta, of which one has a prior, within limits."""
    roots = rng.standard_normal((SEGMENTS, q, q))
    prior = Prior(np.array([0.3, 0.0]), np.array([0.1, np.inf]), np.array([[-9.0, -9.0], [9.0, 9.0]]))
    g, H = rng.standard_normal((SEGMENTS, q)), roots @ roots.swapaxes(1, 2) + np.eye(q)
    return SegmentFit(np.zeros(1), np.zeros((SEGMENTS, 1)), np.array([0.1, 0.2]), rng.uniform(20, 30, SEGMENTS), g, H,
                      prior, np.zeros((SEGMENTS, 9, 1)), *ALONE)  # fmt: skip


def test_the_cost_is_the_least_of_the_weighted_segments_and_of_what_was_known():
    """By the normal equations of the whole sum; and theta is what gives it, within its limits."""
    rng = np.random.default_rng(3)
    of, weights = parabolas(rng), rng.uniform(0.5, 2.0, (1, SEGMENTS))
    known = np.diag([1 / 0.1**2, 0.0])

    def cost(theta):
        d = theta - of.theta
        each = of.e - 2 * of.g @ d + np.einsum("i,sij,j->s", d, of.H, d)
        return weights[0] @ each + (theta - of.prior.mean) @ known @ (theta - of.prior.mean)

    theta = of.thetas(weights)[0]
    assert of.costs(weights)[0] == pytest.approx(cost(theta), rel=1e-8)
    for step in 1e-3 * np.array([[1, 0], [0, 1], [-1, 0], [0, -1]]):
        assert cost(theta + step) > cost(theta)
    tight = Prior(of.prior.mean, of.prior.deviation, np.array([[0.5, -9.0], [9.0, 9.0]]))
    limited = replace(of, prior=tight)
    assert theta[0] < 0.5 and limited.thetas(weights)[0, 0] == 0.5


def test_the_size_of_the_noise_is_found_although_each_segment_has_a_state_of_its_own():
    """Of four samples each: their scatter about the fit is three quarters of the noise's."""

    class Decay:
        states, inputs = ("X",), ("U",)
        f = lambda x, u, t, p, M: [u.U - x.X]
        kappa = lambda x, t, p, M: [-x.X]

    rng, t = np.random.default_rng(0), 0.1 * np.arange(4000)
    log = Log.of(t, np.zeros((len(t), 1)), 0.2 * rng.standard_normal((len(t), 1))).held()
    nothing = Prior(np.zeros(0), np.zeros(0), np.zeros((2, 0)))
    plant = npred.plants.make("decay", Decay)
    problem = Problem(RolloutModel(plant, ()), Segments.of(log, 4, 1.0), np.ones(1), nothing)
    assert problem.rescaled(problem.fit(np.zeros(1))).scale[0] == pytest.approx(0.2, rel=0.03)


@pytest.mark.parametrize("unit", [1.0, 1e3, 1e-3])
def test_a_fit_does_not_depend_on_the_unit_of_a_state_that_is_not_measured(unit):
    """A speed that only the position tells of: its initial values leave the noise alone."""

    class Cart:
        states, inputs, outputs = ("X", "Y"), ("U",), ("position",)
        f = lambda x, u, t, p, M: [x.Y / unit, unit * u.U - 0.8 * x.Y]
        kappa = lambda x, t, p, M: [-x.X]
        output = lambda x, t, p, M: [x.X]

    rng, t = np.random.default_rng(0), 0.1 * np.arange(400)
    positions = np.concatenate([0.2 * k + 0.7 * (1 - np.exp(-0.8 * 0.1 * np.arange(20))) / 0.8 for k in range(20)])
    log = Log.of(t, np.zeros((400, 1)), positions[:, None] + 0.01 * rng.standard_normal((400, 1))).held()
    nothing = Prior(np.zeros(0), np.zeros(0), np.zeros((2, 0)))
    plant = npred.plants.make("cart", Cart)
    problem = Problem(RolloutModel(plant, (), steps=4), Segments.of(log, 20, 1.0), np.array([0.01]), nothing)
    found = problem.fit(np.zeros(1))
    assert found.cost / found.count == pytest.approx(1.0, abs=0.15)
    np.testing.assert_allclose(found.X[:, 1] / unit, 0.7, atol=0.08)


class Walls:
    """A room, which is measured, and its walls, which are not."""

    states, inputs = ("X", "Y"), ("U",)
    parameters = {"a": 0.8, "b": 0.3}
    f = lambda x, u, t, p, M: [x.Y - p.a * x.X, u.U - p.b * x.Y]
    kappa = lambda x, t, p, M: [-x.X]


@pytest.mark.parametrize("size", [1e-4, 0.1, 10.0])
@pytest.mark.parametrize("gap", [False, True])
def test_joined_segments_are_one_least_squares_problem(size, gap):
    """All samples and jumps in one matrix: its cost, step and curvature, and the size of its states' information."""
    rng, t = np.random.default_rng(4), 0.1 * np.arange(90)
    Y = np.stack([np.sin(t) + 0.1 * rng.standard_normal(90), np.full(90, np.nan)], axis=1)
    log = Log.of(np.where(gap & (t > 4.4), t + 3.0, t), rng.standard_normal((90, 1)), Y)
    prior = Prior(np.array([0.8, 0.3]), np.full(2, np.inf), np.array([[-9.0, -9.0], [9.0, 9.0]]))
    model = RolloutModel(npred.plants.make("walls", Walls), (0, 1), steps=2)
    problem = Problem(model, Segments.of(log, 9, 1.0), np.array([0.1, 1.0]), prior, size * np.array([1.0, 2.0]))
    fit, seg = problem.fit(np.array([0.23]), None, 0), problem.segments
    assert seg.follows.sum() == (8 if gap else 9)
    x, J = model.run(fit.X, fit.theta, seg.pieces(fit.delays))
    rows, right, S = [], [], len(seg)
    for s, k in zip(*np.nonzero(np.isfinite(seg.Y[..., 0])), strict=True):
        rows.append(np.zeros(2 * S + 2))
        rows[-1][[2 * s, 2 * s + 1, -2, -1]] = J[s, k, 0] / 0.1
        right.append((seg.Y[s, k, 0] - x[s, k, 0]) / 0.1)
    for s in np.flatnonzero(seg.follows):
        for i in range(2):
            rows.append(np.zeros(2 * S + 2))
            rows[-1][[2 * s - 2, 2 * s - 1, -2, -1]] = -J[s - 1, -1, i] / problem.jump[i]
            rows[-1][2 * s + i] = 1 / problem.jump[i]
            right.append((x[s - 1, -1, i] - fit.X[s, i]) / problem.jump[i])
    A, b = np.array(rows), np.array(right)
    best = np.linalg.lstsq(A, b, rcond=None)[0]
    N, states = A.T @ A, slice(2 * S)
    H = N[-2:, -2:] - N[-2:, states] @ np.linalg.solve(N[states, states], N[states, -2:])
    information = np.linalg.slogdet(N[states, states])[1] + 2 * seg.follows.sum() * np.log(problem.jump).sum()
    np.testing.assert_allclose(fit.best_theta - fit.theta, best[-2:], rtol=1e-5, atol=1e-7)
    np.testing.assert_allclose(fit.H.sum(axis=0), H, rtol=1e-6)
    assert fit.cost == pytest.approx(((A @ best - b) ** 2).sum(), rel=1e-6) and fit.actual == pytest.approx(b @ b)
    assert fit.size == pytest.approx(information, rel=1e-6)
    assert np.linalg.eigvalsh(fit.H).min() > -1e-9 * H.max()  # what each segment adds


def test_what_happens_between_segments_is_estimated():
    """Of a state that jumps at random by 0.3, and of one that does not."""
    rng, t, found = np.random.default_rng(1), 0.1 * np.arange(600), []
    for jump in (0.3, 0.0):
        walk = np.repeat(jump * rng.standard_normal(60).cumsum(), 10)
        Y = np.exp(-t / 20)[:, None] * 5 + walk[:, None] + 0.05 * rng.standard_normal((600, 1))
        log, decay = Log.of(t, np.zeros((600, 1)), Y).held(), npred.plants.make("decay", Slow)
        prior = Prior(np.zeros(0), np.zeros(0), np.zeros((2, 0)))
        problem = Problem(RolloutModel(decay, ()), Segments.of(log, 10, 1.0), np.full(1, 0.05), prior, np.ones(1))
        found.append(problem.joined(problem.fit(np.zeros(1))).jump[0])
    assert 0.1 < found[0] < 0.9 and found[1] < 0.02


class Slow:
    """X' = (U - X) / 20."""

    states, inputs = ("X",), ("U",)
    f = lambda x, u, t, p, M: [(u.U - x.X) / 20]
    kappa = lambda x, t, p, M: [-x.X]


@pytest.mark.parametrize("drifts", [False, True])
def test_a_slow_disturbance_is_seen_in_what_joined_segments_tell_anew(drifts):
    """Of white noise and jumps the surprises are white, of size one."""
    rng, t = np.random.default_rng(3), 0.1 * np.arange(1200)
    inputs = np.where(drifts & (np.sin(t / 8) > 0), 1.0, 0.0) / 20
    X = np.zeros(1200)
    for k in range(1199):
        X[k + 1] = X[k] + 0.1 * (inputs[k] - X[k] / 20) + 0.1 * (k % 10 == 9) * rng.standard_normal()
    log = Log.of(t, np.zeros((1200, 1)), (X + 0.03 * rng.standard_normal(1200))[:, None]).held()
    prior = Prior(np.zeros(0), np.zeros(0), np.zeros((2, 0)))
    model = RolloutModel(npred.plants.make("slow", Slow), ())
    problem = Problem(model, Segments.of(log, 10, 1.0), np.full(1, 0.03), prior, np.full(1, 0.1))
    z = problem.surprises(problem.fit(np.zeros(1)))
    assert np.isnan(z[0]) and (correlation_time(z[None]) > 2) == drifts
    assert drifts or np.nanstd(z) == pytest.approx(1.0, abs=0.15)
