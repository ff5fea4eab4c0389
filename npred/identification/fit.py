"""Initial states of segments and shared parameters by Gauss and Newton's method, the delays being given.

The cost is the sum of squares of residuals over their scale, and of (theta - mean) / deviation. The initial states are
eliminated segment by segment, so that what is left of each segment is a parabola in theta:
    cost_s(theta + d) = e_s - 2 g_s d + d' H_s d.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from npred.identification.log import Pieces, Segments, mean_square
from npred.identification.model import RolloutModel

RIDGE = 1e-12  # share of the largest element: states that nothing measures stay where they are
ROUNDING = 1e-6  # share of a sum of squares below zero
LEAST = 1e-9  # share of the curvature: a combination of theta that the log does not show stays where it is
HALVINGS = 5
BLOCK = 64  # commands
REWEIGHTED, TINY = 20, 1e-3  # fits for the least sum of absolute residuals, and the least one that has a weight
MOST = 25.0  # the most chi² that a segment may add
CLEAR = 10.8  # chi² with one degree of freedom at 99.9 %
CHECKED = 500  # samples by which the steps of the integration are checked
SLIP = 0.02  # share of a residual's scale that twice as many steps may change
STEPS = 64  # of RK4 in a piece, at most
FIXED = 1e-5  # relative deviation of a parameter that is held
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
        """Residuals less the fit to them."""
        return int(np.isfinite(self.residuals).sum()) - self.X.size - int(np.isinf(self.prior.deviation).sum())

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

    def _sums(self, weights: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        gap = self.prior.mean - self.theta
        gap = np.where(self.prior.weight > 0, gap, 0.0)
        e = weights @ self.e + (self.prior.weight * gap**2).sum()
        g = weights @ self.g + self.prior.weight * gap
        H = np.einsum("bs,sij->bij", weights, self.H) + np.diag(self.prior.weight)
        return e, g, H + LEAST * H * np.eye(H.shape[-1])


@dataclass(frozen=True)
class Problem:
    """Segments to be fitted by a model; `scale` (outputs,) is the size of a residual."""

    model: RolloutModel
    segments: Segments
    scale: np.ndarray
    prior: Prior

    def some(self, rows: int) -> "Problem":
        """The same for segments spread over the log, of about so many samples together."""
        every = max(1, round(self.segments.mask.sum() / rows))
        return replace(self, segments=self.segments.some(slice(None, None, every)))

    def with_lag(self) -> "Problem":
        """The same for a model with lags."""
        return replace(self, model=replace(self.model, lag=True))

    def rescaled(self, fit: SegmentFit) -> "Problem":
        """The same with the size of the residuals of a fit as their scale."""
        r = fit.residuals.reshape(-1, len(self.scale))
        share = np.isfinite(r).sum() / max(fit.count, 1)
        size = np.sqrt(mean_square(r) * share)
        return replace(self, scale=self.scale * np.where(size > 0, size, 1.0))

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
        """The mean logarithm of the rms of the residuals of each output, whatever their scale."""
        lost = (~np.isfinite(fit.residuals) & np.isfinite(self.segments.Y)).any()
        with np.errstate(all="ignore"):
            size = np.log(mean_square(fit.residuals * self.scale) + 1e-300).mean() / 2
        return np.inf if lost else float(size)

    def begun(self, fit: SegmentFit) -> SegmentFit:
        """A fit of other segments as a beginning for these: its theta, and the states as they are measured."""
        return replace(fit, X=self.start()[0])

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
        for _ in range(steps):
            if self.actual(best) - best.cost < NEAR:  # the parabolas' least cost is right to second order
                break
            dX, dtheta = moved
            for halving in range(HALVINGS):
                share = 0.5**halving
                new_theta = np.clip(best.theta + share * dtheta, *self.prior.limits)
                new, move = self._linear(delays, best.X + share * dX, new_theta, pieces, lag)
                if self.actual(new) <= self.actual(best) or not np.isfinite(self.actual(best)):
                    break
            else:
                return best
            best, moved = new, move
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

    def actual(self, fit: SegmentFit) -> float:
        """The cost where the fit stands, not where its parabolas are least."""
        r = np.where(np.isfinite(fit.residuals) | ~np.isfinite(self.segments.Y), fit.residuals, np.inf)
        gap = np.where(self.prior.weight > 0, fit.theta - self.prior.mean, 0.0)
        with np.errstate(all="ignore"):
            return float(np.nansum(r**2) + (self.prior.weight * gap**2).sum())

    def _linear(
        self, delays: np.ndarray, X: np.ndarray, theta: np.ndarray, pieces: Any, lag: Any
    ) -> tuple[SegmentFit, tuple[np.ndarray, np.ndarray]]:
        """The parabolas about a point, and the way to their least cost."""
        segments, n = self.segments, self.model.plant.n
        x, J = self.model.run(X, theta, pieces, lag)
        y, G = self.model.outputs(x, J, segments.t, self.model.parameters(theta))
        with np.errstate(all="ignore"):
            residuals = (segments.Y - y) / self.scale
        r = np.where(np.isfinite(segments.Y), residuals, 0.0)
        G = np.where(np.isfinite(segments.Y)[..., None], G / self.scale[:, None], 0.0)
        r, G = r.reshape(len(X), -1), G.reshape(len(X), -1, G.shape[-1])
        with np.errstate(all="ignore"):
            A, b = G.swapaxes(1, 2) @ G, (G.swapaxes(1, 2) @ r[..., None])[..., 0]
            right = np.concatenate([b[:, :n, None], A[:, :n, n:]], axis=2)
            corner = A[:, :n, :n]  # it may be singular
            size = np.maximum(np.nanmax(np.abs(corner), axis=(1, 2), initial=0.0), 1e-300)
            solved = _solve(corner + RIDGE * size[:, None, None] * np.eye(n), right)
            e = (r**2).sum(axis=1) - (b[:, :n] * solved[..., 0]).sum(axis=1)
            g = b[:, n:] - (A[:, n:, :n] @ solved[..., :1])[..., 0]
            H = A[:, n:, n:] - A[:, n:, :n] @ solved[..., 1:]
        lost = ~np.isfinite(e) | ~np.isfinite(H).all(axis=(1, 2)) | ~np.isfinite(g).all(axis=1)
        e, g, H = np.where(lost, np.inf, e), np.where(lost[:, None], 0.0, g), np.where(lost[:, None, None], 0.0, H)
        fit = SegmentFit(np.asarray(delays), X, theta, e, g, H, self.prior, residuals)
        dtheta = fit.best_theta - theta
        dX = np.where(lost[:, None], 0.0, solved[..., 0] - (solved[..., 1:] @ dtheta))
        return fit, (dX, dtheta)


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
