"""Initial states of segments and shared parameters by Gauss and Newton's method, the delays being given.

The cost is the sum of squares of residuals over their scale, of (theta - mean) / deviation, and of the jumps of the
state from the end of a segment to the begin of the next one over their deviation, where segments are joined. The
initial states are eliminated segment by segment, by Kalman's filter where they are joined, so that what is left of each
segment, by what is known from those before, is a parabola in theta:
    cost_s(theta + d) = e_s - 2 g_s d + d' H_s d.
"""

from dataclasses import dataclass, replace
from functools import cache, cached_property
from typing import Any

import numpy as np

from npred.identification.log import Pieces, Segments, mean_square
from npred.identification.model import RolloutModel
from npred.kernels import kernel

RIDGE = 1e-12  # share of the largest element: states that nothing measures stay where they are
ROUNDING = 1e-6  # share of a sum of squares below zero
LEAST = 1e-9  # share of the curvature: a combination of theta that the log does not show stays where it is
DAMPINGS = 0.0, 1.0, 10.0, 100.0  # of a step of theta, until the cost falls
BLOCK = 64  # commands
REWEIGHTED, TINY = 20, 1e-3  # fits for the least sum of absolute residuals, and the least one that has a weight
MOST = 25.0  # the most chi² that a segment may add
CLEAR = 10.8  # chi² with one degree of freedom at 99.9 %
CHECKED = 500  # samples by which the steps of the integration are checked
SLIP = 0.02  # share of a residual's scale that twice as many steps may change
STEPS = 64  # of RK4 in a piece, at most
FIXED = 1e-5  # relative deviation of a parameter that is held
JOINED = "k, follows, A, B, F, step, Q, &Z, &K, &all, &size"
JUMPS = tuple(10.0 ** np.arange(-4, 0.6, 0.5))  # sizes of jumps that are tried, in those by which the state moves
SOFT = 0.03  # size of jumps before anything is known
FORGOTTEN = 0.05  # share of a state's error that is left after a segment: less is no reason to join it to the next
TORN = 25.0  # squares of jumps, of residuals one each
ENOUGH = 0.3  # share of the fall of the cost that the parabolas promise, else a step is damped more
NEAR = 0.05  # to the least cost, where chi² with one degree of freedom is 3.84 at 95 %


@dataclass(frozen=True)
class Prior:
    """The prior of theta: mean and deviation (q,), infinite where nothing is, and limits (2, q)."""

    mean: np.ndarray
    deviation: np.ndarray
    limits: np.ndarray

    @cached_property
    def weight(self) -> np.ndarray:
        """1 / deviation², (q,)."""
        return 1.0 / self.deviation**2


@dataclass(frozen=True)
class SegmentFit:
    """States X (S, n) and theta (q,) at given delays (m,), and the parabolas in theta around there."""

    delays: np.ndarray
    X: np.ndarray
    theta: np.ndarray
    e: np.ndarray  # (S,)
    g: np.ndarray  # (S, q)
    H: np.ndarray  # (S, q, q)
    prior: Prior
    residuals: np.ndarray  # (S, K, outputs), over their scale; NaN where there is no sample
    jumps: np.ndarray  # (S, n) before segments that are joined to those before, over their deviation, else NaN
    filtered: np.ndarray  # (S, n) the states by the samples of each segment and those before
    actual: float  # the cost where the fit stands, not where its parabolas are least
    size: float  # logarithm of the determinant of the variance of all samples, in that of their noise

    @cached_property
    def cost(self) -> float:
        """The least cost of the parabolas."""
        return float(self.costs(np.ones((1, len(self.e))))[0])

    @cached_property
    def best_theta(self) -> np.ndarray:
        """Theta (q,) where that is."""
        return self.thetas(np.ones((1, len(self.e))))[0]

    @property
    def count(self) -> int:
        """Residuals and jumps less the fit to them."""
        squares = np.isfinite(self.residuals).sum() + np.isfinite(self.jumps).sum()
        return int(squares) - self.X.size - int(np.isinf(self.prior.deviation).sum())

    def costs(self, weights: np.ndarray) -> np.ndarray:
        """The least cost (B,) with segments weighted (B, S), theta being optimal for each row of weights."""
        e, g, H = self._sums(weights)
        with np.errstate(all="ignore"):
            costs = e - np.einsum("bi,bi->b", g, _solve(H, g))
            return np.where(np.isfinite(e) & (costs >= -ROUNDING * e), costs, np.inf)  # else the parabolas are lost

    def thetas(self, weights: np.ndarray) -> np.ndarray:
        """The optimal theta (B, q) for each row of weights, within its limits."""
        _, g, H = self._sums(weights)
        return np.clip(self.theta + _solve(H, g), *self.prior.limits)

    def cost_at(self, theta: np.ndarray) -> float:
        """The cost of the parabolas at some theta."""
        e, g, H = self._sums(np.ones((1, len(self.e))))
        d = theta - self.theta
        return float(e[0] - 2 * g[0] @ d + d @ H[0] @ d)

    def step(self, damping: float) -> np.ndarray:
        """The way (q,) to the optimal theta, by Levenberg and Marquardt's damping."""
        _, g, H = self._sums(np.ones((1, len(self.e))))
        return _solve(H + damping * H * np.eye(H.shape[-1]), g)[0]

    def _sums(self, weights: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        gap = self.prior.mean - self.theta
        gap = np.where(self.prior.weight > 0, gap, 0.0)
        e = weights @ self.e + (self.prior.weight * gap**2).sum()
        g = weights @ self.g + self.prior.weight * gap
        H = np.einsum("bs,sij->bij", weights, self.H) + np.diag(self.prior.weight)
        return e, g, H + LEAST * H * np.eye(H.shape[-1])


@dataclass(frozen=True)
class Problem:
    """Segments to be fitted by a model; `scale` (outputs,) is the size of a residual, and `jump` (n,) that of the state
    from one segment to the next: None for any.
    """

    model: RolloutModel
    segments: Segments
    scale: np.ndarray
    prior: Prior
    jump: np.ndarray | None = None

    def some(self, rows: int) -> "Problem":
        """The same for about so many samples: of segments spread over the log, or all along joined ones."""
        every = max(1, round(self.segments.mask.sum() / rows))
        if every == 1:
            return self
        if self.jump is None:
            return replace(self, segments=self.segments.some(slice(None, None, every)))
        return replace(self, segments=self.segments.sparser(min(every, max(1, self.segments.t.shape[1] // 4))))

    def with_lag(self) -> "Problem":
        """The same for a model with lags."""
        return replace(self, model=replace(self.model, lag=True))

    def rescaled(self, fit: SegmentFit) -> "Problem":
        """The same with the size of the residuals of a fit as their scale."""
        r = fit.residuals.reshape(-1, len(self.scale))
        share = np.isfinite(r).sum() / max(fit.count, 1) * (1 + np.nansum(fit.jumps**2) / max(np.nansum(r**2), 1e-300))
        size = np.sqrt(mean_square(r) * share)
        jump = None if self.jump is None else self.jump * np.exp(np.log(size[size > 0]).mean() if size.any() else 0.0)
        return replace(self, scale=self.scale * np.where(size > 0, size, 1.0), jump=jump)

    def softened(self, fit: SegmentFit) -> "Problem":
        """The same with segments that are joined softly, if the plant remembers for longer than a segment."""
        memory, moved = self._joints(fit)
        return replace(self, jump=SOFT * moved) if memory > FORGOTTEN**2 else self.apart()

    def apart(self) -> "Problem":
        """The same with segments that are not joined."""
        return replace(self, segments=self.segments.apart(), jump=None)

    def joined(self, fit: SegmentFit) -> "Problem":
        """The same with the size of jumps that is most likely at the delays of a fit, or any if the plant forgets."""
        if self.jump is None:
            return self
        memory, moved = self._joints(fit)
        if not memory > FORGOTTEN:
            return self.apart()
        rows = []
        for size in reversed(JUMPS):
            problem = replace(self, jump=size * moved)
            fit = problem.fit(fit.delays, fit, 20)
            likely = max(fit.count, 1) * np.log(max(fit.actual, 1e-300)) + fit.size
            rows.append((likely if np.isfinite(likely) else np.inf, problem))
        return min(rows, key=lambda row: row[0])[1]

    def _joints(self, fit: SegmentFit) -> tuple[float, np.ndarray]:
        """What is left of an error after a segment, 0 if none goes on, and by how much each state moves in one (n,)."""
        x, J = self.model.run(fit.X, fit.theta, *self._inputs(fit.delays, None))
        x, F = x[self.segments.joins, -1], J[self.segments.joins, -1, :, : len(fit.X.T)]
        good = np.isfinite(F).all(axis=(1, 2)) & np.isfinite(x).all(axis=1)
        moved = np.sqrt(mean_square((x - fit.X[self.segments.joins])[good]))
        memory = np.abs(np.linalg.eigvals(F[good])).max(axis=1) if good.any() else np.zeros(1)
        return float(np.median(memory)), np.where(moved > 0, moved, 1.0)

    def pinned(self, place: int, value: float) -> "Problem":
        """The same with one of theta at this value."""
        mean, deviation = self.prior.mean.copy(), self.prior.deviation.copy()
        mean[place], deviation[place] = value, FIXED * max(abs(value), 1e-9)
        return replace(self, prior=Prior(mean, deviation, self.prior.limits))

    def refined(self, fit: SegmentFit) -> "Problem":
        """The same with so many steps of RK4 that twice as many would change less than SLIP of a residual's scale at
        this fit; with more than STEPS where there are none.
        """
        every = slice(None, None, max(1, round(self.segments.mask.sum() / CHECKED)))
        few, part = replace(self, segments=self.segments.some(every)), replace(fit, X=fit.X[every])
        steps, last = self.model.steps, None
        while steps <= 2 * STEPS:
            with np.errstate(all="ignore"):
                outputs = replace(few, model=replace(self.model, steps=steps)).outputs(part)[few.segments.mask]
                if last is not None and np.mean(np.abs(outputs - last) < SLIP * self.scale) > 0.99:
                    break
            last, steps = outputs, 2 * steps
        return replace(self, model=replace(self.model, steps=steps // 2))

    def size_of(self, fit: SegmentFit) -> float:
        """The mean logarithm of the rms of the residuals of each output, whatever their scale, and, where segments are
        joined, of that by which jumps make the log less likely.
        """
        lost = (~np.isfinite(fit.residuals) & np.isfinite(self.segments.Y)).any()
        with np.errstate(all="ignore"):
            size = np.log(mean_square(fit.residuals * self.scale) + 1e-300).mean() / 2
            if self.jump is not None:
                squares, count = np.nansum(fit.residuals**2), np.isfinite(fit.residuals).sum()
                size += (np.log1p(np.nansum(fit.jumps**2) / (squares + 1e-300)) + fit.size / max(count, 1)) / 2
        return np.inf if lost else float(size)

    def begun(self, fit: SegmentFit) -> SegmentFit:
        """A fit of other segments as a beginning for these: its theta, and its states, or those that are measured."""
        return fit if len(fit.X) == len(self.segments) else replace(fit, X=self.start()[0])

    def at(self, delays: np.ndarray, start: SegmentFit | None) -> SegmentFit:
        """The fit with these delays from another one nearby, for a search."""
        return self.fit(delays, start, 2)

    def start(self) -> tuple[np.ndarray, np.ndarray]:
        """Initial states as they are measured, else the plant's guess, and theta as it is thought to be."""
        X = self.model.measured_states(self.segments.Y[:, 0])
        return X, self.prior.mean

    def fit(
        self, delays: np.ndarray, start: SegmentFit | None = None, steps: int = 3, tau: np.ndarray | None = None
    ) -> SegmentFit:
        """The fit with these delays, and lags (m,) of a model with lags, after at most so many steps from another."""
        X, theta = (start.X, start.theta) if start else self.start()
        theta = np.clip(theta, *self.prior.limits)
        pieces, lag = self._inputs(delays, tau)
        best, moved = self._linear(delays, X, theta, pieces, lag)
        if np.nansum(best.jumps**2) > TORN * max(best.count, 1):  # first states that go on from one to the next
            best, moved = self._linear(delays, best.X + np.nan_to_num(moved[..., 0]), theta, pieces, lag)
        for _ in range(steps):
            if best.actual - best.cost < NEAR:  # the parabolas' least cost is right to second order
                break
            tried = best, moved
            for damping in DAMPINGS[: steps + 1]:
                new_theta = np.clip(best.theta + best.step(damping), *self.prior.limits)
                new_X = best.X + np.nan_to_num(moved @ np.append(1.0, new_theta - best.theta))
                new = self._linear(delays, new_X, new_theta, pieces, lag)
                if not new[0].actual > tried[0].actual:
                    tried = new
                    if not best.actual - tried[0].actual < ENOUGH * (best.actual - best.cost_at(new_theta)):
                        break
                elif tried[0] is not best:
                    break
            if tried[0] is best:
                break
            best, moved = tried
        return best

    def tolerant(self, fit: SegmentFit) -> np.ndarray:
        """The residuals of a fit with those initial states that make the sum of their absolute values least.

        A bad sample moves these far less than those of the least sum of squares, which spread it over its segment.
        """
        pieces, _ = self._inputs(fit.delays, None)
        x, J = self.model.run(fit.X, fit.theta, pieces)
        G = self.model.outputs(x, J, self.segments.t, self.model.parameters(fit.theta))[1][..., : fit.X.shape[1]]
        measured = np.isfinite(fit.residuals)
        r = np.where(measured, fit.residuals, 0.0).reshape(len(fit.X), -1)
        G = np.where(measured[..., None], G / self.scale[:, None], 0.0).reshape(*r.shape, -1)
        rest = r
        for _ in range(REWEIGHTED):  # least squares, each residual weighted by its inverse
            weighted = (G / np.maximum(np.abs(rest), TINY)[..., None]).swapaxes(1, 2)
            A = weighted @ G
            size = np.maximum(np.abs(A).max(axis=(1, 2), initial=0.0), 1e-300)
            dX = _solve(A + RIDGE * size[:, None, None] * np.eye(A.shape[-1]), (weighted @ r[..., None])[..., 0])
            rest = r - (G @ np.nan_to_num(dX)[..., None])[..., 0]
        return np.where(measured, rest.reshape(measured.shape), np.nan)

    def outputs(self, fit: SegmentFit, tau: np.ndarray | None = None) -> np.ndarray:
        """The outputs (S, K, outputs) that the model of a fit has at the samples."""
        pieces, lag = self._inputs(fit.delays, tau)
        x, J = self.model.run(fit.X, fit.theta, pieces, lag)
        return self.model.outputs(x, J, self.segments.t, self.model.parameters(fit.theta))[0]

    def _inputs(self, delays: np.ndarray, tau: np.ndarray | None) -> tuple[Pieces, Any]:
        """The pieces with these delays, and the states of lags with tau."""
        lag = None if tau is None else (lag_states(self.segments, delays, tau), tau)
        return self.segments.pieces(delays), lag

    def _linear(
        self, delays: np.ndarray, X: np.ndarray, theta: np.ndarray, pieces: Any, lag: Any
    ) -> tuple[SegmentFit, np.ndarray]:
        """The parabolas about a point, and the changes of X (S, n, 1 + q) by (1, dtheta) to their least cost."""
        with np.errstate(all="ignore"):
            residuals, A, B, squares, ends = self._equations(X, theta, pieces, lag)
            before, jumps, filtered, moved, size, _ = self._chained(X, A, B, *ends)
            right = B - A @ before
            crossed = before.swapaxes(1, 2) @ (B + right)
            left = squares - (crossed + crossed.swapaxes(1, 2)) / 2 - right.swapaxes(1, 2) @ (filtered - before)
        e, g, H = left[:, 0, 0], -left[:, 1:, 0], left[:, 1:, 1:]
        lost = np.logical_not(np.isfinite(left).all(axis=(1, 2)))
        e, g, H = np.where(lost, np.inf, e), np.where(lost[:, None], 0.0, g), np.where(lost[:, None, None], 0.0, H)
        gap = np.where(self.prior.weight > 0, theta - self.prior.mean, 0.0)
        diverged = (~np.isfinite(residuals) & np.isfinite(self.segments.Y)).any()
        actual = squares[:, 0, 0].sum() + np.nansum(jumps**2) + (self.prior.weight * gap**2).sum()
        fit = SegmentFit(
            np.asarray(delays), X, theta, e, g, H, self.prior, residuals, jumps, X + filtered[..., 0],
            float("inf" if diverged else actual), size,
        )  # fmt: skip
        return fit, np.where(lost[:, None, None], 0.0, moved)

    def _equations(
        self, X: np.ndarray, theta: np.ndarray, pieces: Pieces, lag: Any
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, tuple[np.ndarray, np.ndarray]]:
        """The residuals, and of each segment A, B and c, where it alone asks A dx = B (1, dtheta), and costs
        (1, dtheta)' c (1, dtheta) at dx = 0; the ends of the segments, and their derivatives.
        """
        n, Y = self.model.plant.n, self.segments.Y
        x, J = self.model.run(X, theta, pieces, lag)
        y, G = self.model.outputs(x, J, self.segments.t, self.model.parameters(theta))
        residuals = (Y - y) / self.scale
        r = np.where(np.isfinite(Y), residuals, 0.0).reshape(len(X), -1, 1)
        G = np.where(np.isfinite(Y)[..., None], G / self.scale[:, None], 0.0).reshape(len(X), -1, G.shape[-1])
        L = np.concatenate([r, -G[..., n:]], axis=2)  # a residual is L (1, dtheta) - G dx
        A, B, squares = (a.swapaxes(1, 2) @ b for a, b in ((G[..., :n], G[..., :n]), (G[..., :n], L), (L, L)))
        largest = np.maximum(np.nanmax(np.abs(A), axis=(1, 2), initial=0.0), 1e-300)[:, None, None]
        return residuals, A + RIDGE * largest * np.eye(n), B, squares, (x[:, -1], J[:, -1])  # A may be singular

    def surprises(self, fit: SegmentFit) -> np.ndarray:
        """(S, n) how far the samples of each segment that is joined are from what those before say, in deviations."""
        with np.errstate(all="ignore"):
            _, A, B, _, ends = self._equations(fit.X, fit.theta, *self._inputs(fit.delays, None))
            before, _, _, _, _, K = self._chained(fit.X, A, B, *ends)
            right = (B - A @ before)[..., 0]
            variance = A @ np.linalg.pinv(np.eye(len(A[0])) - K @ A)
            z = right / np.sqrt(np.diagonal(variance, axis1=1, axis2=2))
        return np.where(self.segments.follows[:, None] & np.isfinite(z), z, np.nan)

    def _chained(
        self, X: np.ndarray, A: np.ndarray, B: np.ndarray, ends: np.ndarray, J: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, float, np.ndarray]:
        """The changes dx of initial states as functions of (1, dtheta), (S, n, 1 + q): by the samples before a segment,
        by its own too, by all; the jumps between; the size of the samples' variance; and that of dx by a segment and
        those before it.

        `A` dx = `B` (1, dtheta) are the equations of each segment's own samples, `ends` its end, with derivatives `J`.
        """
        S, n, follows = *X.shape, self.segments.follows
        if self.jump is None or not follows.any():
            changes = _solve(A, B)
            return np.zeros(B.shape), np.full(X.shape, np.nan), changes, changes, 0.0, np.zeros(A.shape)
        steps = np.concatenate([np.append(ends[:-1] - X[1:], X[-1:], axis=0)[..., None], J[..., n:]], axis=2)
        before, everything, K, size = np.empty(B.shape), np.empty(B.shape), np.empty(A.shape), np.empty(S)
        run = _joining(n, B.shape[2])
        arrays = follows.astype(float), A, B, J[..., :n], steps, self.jump**2
        run(S, *map(np.ascontiguousarray, arrays), before, K, everything, size)
        jumps = np.where(follows[:, None], np.append(X[:1], X[1:] - ends[:-1], axis=0) / self.jump, np.nan)
        return before, jumps, before + K @ (B - A @ before), everything, float(size.sum()), K


@cache
def _joining(n: int, columns: int) -> kernel.Kernel:
    return kernel.made("joined", JOINED, kernel.skeleton("joined.h"), {}, {"N": n, "COLUMNS": columns})


def better(one: SegmentFit, other: SegmentFit, inflation: float, deviations: float = 1.0) -> bool:
    """True if the data clearly prefer `one`: in the sum of its costs, and by so many deviations of that sum.

    The second says whether few segments alone decide [Vuong, Econometrica 57 (1989) 307]; a segment counts for MOST at
    most, since one that diverges has a cost without an end.
    """

    def per_segment(fit: SegmentFit) -> np.ndarray:
        """The cost of each segment at the common optimum of theta."""
        d = fit.best_theta - fit.theta
        return fit.e - 2 * fit.g @ d + np.einsum("i,sij,j->s", d, fit.H, d)

    gain = np.clip((per_segment(other) - per_segment(one)) / inflation, -MOST, MOST)
    scatter = np.sqrt(len(gain)) * gain.std(ddof=1)
    return bool(other.cost - one.cost > CLEAR * inflation and gain.sum() > deviations * scatter)


def lag_states(segments: Segments, delays: np.ndarray, tau: np.ndarray) -> np.ndarray:
    """The states (S, m) of first-order lags of the delayed commands at the begin of each segment."""
    log, starts = segments.log, segments.t[:, 0]
    states = np.empty((len(segments), log.U.shape[1]))
    for j, U in enumerate(log.U.T):
        at = _lagged(U, np.exp(-np.diff(log.t_U) / tau[j]))
        k = np.maximum(np.searchsorted(log.t_U + delays[j], starts, side="right") - 1, 0)
        rest = np.exp(-np.maximum(starts - log.t_U[k] - delays[j], 0.0) / tau[j])
        states[:, j] = U[k] + (at[k] - U[k]) * rest
    return states


def _lagged(U: np.ndarray, shares: np.ndarray) -> np.ndarray:
    """a (K,) with a_0 = U_0 and a_k+1 = U_k + (a_k - U_k) shares_k, in blocks that go side by side.

    A block makes of what it begins with an affine function; the blocks' begins follow one from the other.
    """
    count = -(-len(shares) // BLOCK)
    missing = count * BLOCK - len(shares)
    by_last = np.pad(shares, (0, missing), constant_values=1.0).reshape(count, BLOCK)
    by_U = np.pad(U[:-1] * (1 - shares), (0, missing)).reshape(count, BLOCK)
    slope, offset = np.ones((count, BLOCK + 1)), np.zeros((count, BLOCK + 1))
    for k in range(BLOCK):
        slope[:, k + 1] = slope[:, k] * by_last[:, k]
        offset[:, k + 1] = offset[:, k] * by_last[:, k] + by_U[:, k]
    begins, a = [], float(U[0])
    for by, more in zip(slope[:, -1].tolist(), offset[:, -1].tolist(), strict=True):
        begins.append(a)
        a = by * a + more
    inside = (np.array(begins)[:, None] * slope + offset)[:, :-1].ravel()
    return np.append(inside, a)[: len(U)] if len(inside) == len(shares) else inside[: len(U)]


def _solve(A: np.ndarray, right: np.ndarray) -> np.ndarray:
    """A⁻¹ right for stacks of matrices; NaN where there is none."""
    column = right.ndim < A.ndim
    right = right[..., None] if column else right
    good = np.isfinite(A).all(axis=(-2, -1)) & np.isfinite(right).all(axis=(-2, -1))
    solved = np.full(right.shape, np.nan)
    if A.shape[-1]:
        try:
            solved[good] = np.linalg.solve(A[good], right[good])
        except np.linalg.LinAlgError:
            solved[good] = np.linalg.pinv(A[good], hermitian=True) @ right[good]
    return solved[..., 0] if column else solved
