"""A bound of the error of U, where a guard estimates it: for one constant delay and a traced plant.

    from npred_experiments.bounds import bound

    bound(guarded, X, u, D_hat)

Let Q be any curve near P, and R(x) = Q(x) - X - D_hat ∫₀ˣ f(Q, u) its residual. With Q - P = R + w,
    w' = D_hat A (R + w), w(0) = 0,   A(x) = ∫₀¹ f_P(Q + s (P - Q), u) ds,
so that in the norm |v|_W = |W v|
    |Q - P|_W(x) <= |R|_W(x) + ∫₀ˣ exp(D_hat ∫_y^x mu) D_hat ‖A‖_W |R|_W(y) dy
with mu the W-weighted logarithmic norm of A, the largest eigenvalue of the symmetric part of W A W⁻¹ [Söderlind, BIT 46
(2006) 631; Hairer, Nørsett, Wanner, Theorem I.10.6]. A is enclosed by intervals on a tube around Q; where the
bound is inside the tube, P is: it begins there and cannot leave. Q is P̂ less its defect, as the linearised equation
carries it, so that the bound |kappa(P̂(1)) - kappa(Q(1))| + sup |kappa_P W⁻¹| |Q - P|_W(1) is near the error.

u is read as RK4 reads it, by the lines of `grid.lines`. Between nodes Q is the cubic with the slopes D_hat f, and
integrals are Simpson's: it is a bound but for the error of these, of order 4.
"""

import numpy as np
from numpy.typing import ArrayLike

from npred.base import array_checks, grid
from npred.guard.guarded import Guarded
from npred.plants.base import Plant
from npred.prediction.delays import problem_of
from npred.prediction.delays.problem import by_time
from npred_experiments.intervals import Interval, Operand, interval

CELLS = 200  # that Q has at least
SWEEPS = 2  # over the linearised equation
TUBES, WIDER = 12, 2.0  # tried, each so many times the bound that the one before gave
SMALLEST = 1e-12  # least radius of the first tube, relative to the states
TINY = 1e-12  # a rate that stands for 0
DESCENT, RATE, ENOUGH = 300, 0.05, 2000  # steps of Adam that look for W, their size, and the derivatives they see
Inputs = tuple[np.ndarray, np.ndarray, np.ndarray]
MEMORY, TINY_SLOPE = (0.9, 0.999), 1e-8  # Adam's, of the mean slope and of its square, and a slope that is none


def bound(guarded: Guarded, X: ArrayLike, u: ArrayLike, D_hat: ArrayLike, t: ArrayLike = 0.0) -> np.ndarray:
    """A bound of the error that `guarded.error` estimates, (...), in NumPy; infinite where none is found.

    Raises ConfigError for a plant that is not traced, or has not one constant delay.
    """
    P_hat, u = guarded.model(X, u, D_hat, t), array_checks.nodes("u", u, guarded.plant.m)
    batch = P_hat.shape[:-2]
    arrays = (P_hat, P_hat.shape[-2:]), (X, P_hat.shape[-1:]), (u, u.shape[-2:]), (D_hat, ()), (t, ())
    rows = [np.broadcast_to(a, (*batch, *shape)).reshape(-1, *shape) for a, shape in arrays]
    return ErrorBound.of(guarded)(*rows).reshape(batch)


class ErrorBound:
    """Bounds of |kappa(P̂(1)) - kappa(P(1))|; W (n, n) weighs the errors of the states against each other.

    Raises ConfigError for a plant that is not traced, or has not one constant delay.
    """

    def __init__(self, plant: Plant, W: np.ndarray) -> None:
        problem_of(plant).needs("bound")
        self.plant, self.W, self.inverse = plant, W, np.linalg.inv(W)
        self.reach = np.linalg.norm(self.inverse, axis=1)  # how far each state may be off where |v|_W is 1, (n,)

    @classmethod
    def of(cls, guarded: Guarded) -> "ErrorBound":
        """The bound with the W that suits examples of the data; without these, no state outweighs another."""
        if guarded.domain is None:
            return cls(guarded.plant, np.eye(guarded.plant.n))
        calls = guarded.examples.calls
        return cls(guarded.plant, weight(guarded.plant, guarded.exact(*calls), *calls[1:]))

    def __call__(self, P_hat: np.ndarray, X: np.ndarray, u: np.ndarray, D_hat: np.ndarray, t: np.ndarray) -> np.ndarray:
        """The bound (B,) of the predictions P_hat (B, nx, n) of X (B, n), u (B, nx, m), D_hat (B,), t (B,).

        Infinite where no tube holds P: P_hat is too far from it, or the plant too sensitive.
        """
        plant, parts = self.plant, -(-CELLS // (u.shape[1] - 1))
        nx, inputs = parts * (u.shape[1] - 1) + 1, _inputs(u, parts)
        P_hat, u = grid.refine(P_hat, nx), grid.means(u, nx)
        correction, times = problem_of(plant).correction(), np.zeros(len(X)) if plant.autonomous else t
        with np.errstate(all="ignore"):
            Q = P_hat
            for _ in range(SWEEPS):
                corrected = np.empty_like(Q)
                by_time(correction, (Q, X, u, D_hat), times, (plant.p,), (corrected,))
                Q = corrected
            distance = self._distance(Curve(plant, Q, X, inputs, D_hat, t))
            at, s = Q[:, -1], t + D_hat
            slope = self._slope(at, np.where(np.isfinite(distance), distance, 0.0), s)
            gap = np.abs(plant.kappa(P_hat[:, -1], s) - plant.kappa(at, s)).max(axis=-1)
            bound = gap + slope * distance
        return np.where(np.isfinite(bound), bound, np.inf)

    def growth(self, P: np.ndarray, u: np.ndarray, D_hat: np.ndarray, t: np.ndarray) -> np.ndarray:
        """exp(D_hat ∫ mu), (B,): how much larger than at x = 0 a small error may be at x = 1, by this W."""
        A = _jacobians(self.plant, P, u, D_hat, t)
        return np.exp(D_hat * (_logarithmic_norm(self.W @ A @ self.inverse) @ grid.trapezoid(u.shape[1])))

    def _distance(self, curve: "Curve") -> np.ndarray:
        """The bound of |Q - P|_W at x = 1, (B,)."""
        residuals = np.linalg.norm(curve.residuals @ self.W.T, axis=-1)
        size = np.linalg.norm(curve.highest @ self.W.T, axis=-1).max(axis=1)
        tube = np.maximum(WIDER * residuals.max(axis=1), SMALLEST * size)[:, None].repeat(residuals.shape[1] // 2, 1)
        distance = np.full(len(tube), np.inf)
        for _ in range(TUBES):
            errors, end = self._errors(curve, residuals, tube)
            holds = np.all(errors <= tube, axis=1)
            distance = np.where(holds, np.minimum(distance, end), distance)
            if holds.all():
                break
            tube = np.where(holds[:, None], tube, WIDER * np.maximum(errors, tube))
        return distance

    def _errors(self, curve: "Curve", residuals: np.ndarray, tube: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The bound in each cell (B, cells) and at x = 1 (B,), if P is within `tube` of the curve in each cell."""
        reach = tube[..., None] * self.reach
        X = _components(curve.lowest - reach, curve.highest + reach)
        entries = self.plant.derivatives["f_x"](*X, *_components(*curve.u), Interval(*curve.times), *self.plant.p)
        middle, radius = _matrices(entries, tube.shape, self.plant.n)
        A = self.W @ middle @ self.inverse
        spread = np.linalg.norm(np.abs(self.W) @ radius @ np.abs(self.inverse), axis=(-2, -1))
        rate = _logarithmic_norm(A) + spread
        z = curve.h[:, None] * np.where(np.abs(rate) < TINY, TINY, rate)
        R = np.maximum.reduce((residuals[:, :-1:2], residuals[:, 1::2], residuals[:, 2::2]))
        push = curve.h[:, None] * (np.linalg.norm(A, axis=(-2, -1)) + spread) * R * np.expm1(z) / z
        w = np.zeros((len(tube), tube.shape[1] + 1))
        for j in range(tube.shape[1]):
            w[:, j + 1] = np.exp(z[:, j]) * w[:, j] + push[:, j]
        errors = R + np.maximum(w[:, :-1], w[:, 1:])
        return np.where(np.isnan(errors), np.inf, errors), residuals[:, -1] + w[:, -1]

    def _slope(self, Q: np.ndarray, distance: np.ndarray, t: np.ndarray) -> np.ndarray:
        """sup |kappa_P W⁻¹| (B,) within that distance of Q (B, n), over the inputs too."""
        reach = distance[..., None] * self.reach
        entries = self.plant.derivatives["kappa_x"](*_components(Q - reach, Q + reach), t, *self.plant.p)
        middle, radius = _matrices(entries, distance.shape, self.plant.n)
        rows = np.linalg.norm(middle @ self.inverse, axis=-1) + np.linalg.norm(radius @ np.abs(self.inverse), axis=-1)
        return rows.max(axis=-1)


class Curve:
    """The cubic through Q (B, nx, n) with the slopes D_hat f, by cells of the width h (B,).

    `inputs` are those at the begin, the middle and the end of each cell, each (B, cells, m): u may jump at a node.
    `residuals` (B, 2 nx - 1, n) are R at nodes and middles in turn. In each cell the curve is between `lowest` and
    `highest` (B, cells, n), the input between the two of `u` (B, cells, m), the time between the two of `times`.
    """

    def __init__(
        self, plant: Plant, Q: np.ndarray, X: np.ndarray, inputs: Inputs, D_hat: np.ndarray, t: np.ndarray
    ) -> None:
        nx, first, last = Q.shape[1], Q[:, :-1], Q[:, 1:]
        s = t[:, None] + D_hat[:, None] * grid.nodes(2 * nx - 1)
        self.times = s[:, :-1:2], s[:, 2::2]
        self.h = D_hat / (nx - 1)
        h, f_first = self.h[:, None, None], plant.f(first, inputs[0], self.times[0])
        f_last = plant.f(last, inputs[2], self.times[1])
        middle = (first + last) / 2 + h / 8 * (f_first - f_last)
        f_middle = plant.f(middle, inputs[1], s[:, 1::2])
        whole = h / 6 * (f_first + 4 * f_middle + f_last)
        half = h / 24 * (5 * f_first + 8 * f_middle - f_last)
        total = np.concatenate([np.zeros_like(X)[:, None], np.cumsum(whole, axis=1)], axis=1)
        self.residuals = np.empty((len(X), 2 * nx - 1, plant.n))
        self.residuals[:, ::2] = Q - X[:, None] - total
        self.residuals[:, 1::2] = middle - X[:, None] - total[:, :-1] - half
        hull = first, first + h / 3 * f_first, last - h / 3 * f_last, last  # Bézier's points
        self.lowest, self.highest = np.minimum.reduce(hull), np.maximum.reduce(hull)
        self.u = np.minimum.reduce(inputs), np.maximum.reduce(inputs)


def _inputs(u: np.ndarray, parts: int) -> Inputs:
    """u (B, nx, m) at the begin, the middle and the end of each of `parts` equal cells between two nodes."""
    begin, end = (np.repeat(ends, parts, axis=1) for ends in grid.lines(u))
    slope, low = (end - begin) / parts, np.tile(np.arange(parts), u.shape[1] - 1)[:, None]
    return begin + low * slope, begin + (low + 0.5) * slope, begin + (low + 1) * slope


def weight(plant: Plant, P: np.ndarray, u: np.ndarray, D_hat: np.ndarray, t: np.ndarray) -> np.ndarray:
    """The W, upper triangular (n, n), with the least mean of D_hat ∫ mu over predictions P (B, nx, n) of u (B, nx, m).

    By gradient descent, Adam [Kingma and Ba 2015, arXiv:1412.6980], from the states' spreads. W is free up to a factor.
    """
    shares = (D_hat[:, None] * grid.trapezoid(u.shape[1]) / len(D_hat)).reshape(-1)
    kept = slice(None, None, max(1, shares.size // ENOUGH))
    A, share = _jacobians(plant, P, u, D_hat, t).reshape(-1, plant.n, plant.n)[kept], shares[kept]
    spread = P.reshape(-1, plant.n).std(axis=0)
    log_diagonal, above = -np.log(np.where(spread > 0, spread, 1.0)), np.zeros((plant.n, plant.n))
    values = log_diagonal, above
    means, squares = ([np.zeros_like(value) for value in values] for _ in range(2))
    best, W_best = np.inf, np.diag(np.exp(log_diagonal))
    for count in range(1, DESCENT + 1):
        diagonal, unit = np.exp(log_diagonal), np.eye(plant.n) + np.triu(above, 1)
        W = diagonal[:, None] * unit
        mean_norm, slope_W = _mean_norm(A, share, W)
        if mean_norm < best:
            best, W_best = mean_norm, W
        slopes = (slope_W * W).sum(axis=1), np.triu(diagonal[:, None] * slope_W, 1)
        for value, mean, square, slope in zip(values, means, squares, slopes, strict=True):  # in place
            mean += (1 - MEMORY[0]) * (slope - mean)
            square += (1 - MEMORY[1]) * (slope**2 - square)
            size = np.sqrt(square / (1 - MEMORY[1] ** count)) + TINY_SLOPE
            value -= RATE * mean / (1 - MEMORY[0] ** count) / size
    return W_best


def _mean_norm(A: np.ndarray, share: np.ndarray, W: np.ndarray) -> tuple[float, np.ndarray]:
    """The mean of the logarithmic norms of A (B, n, n) with the weights W, and its derivative by W (n, n).

    With v the eigenvector of the largest eigenvalue of the symmetric part of B = W A W⁻¹, that grows by v' dB v, and
    dB = dW W⁻¹ B - B dW W⁻¹.
    """
    inverse = np.linalg.inv(W)
    B = W @ A @ inverse
    values, vectors = np.linalg.eigh((B + B.swapaxes(-1, -2)) / 2)
    v = vectors[..., -1]
    forth, back = (B @ v[..., None])[..., 0], (v[..., None, :] @ B)[..., 0, :]
    slope = np.einsum("b,bi,bj->ij", share, v, forth) - np.einsum("b,bi,bj->ij", share, back, v)
    return float(share @ values[..., -1]), slope @ inverse.T


def _jacobians(plant: Plant, P: np.ndarray, u: np.ndarray, D_hat: np.ndarray, t: np.ndarray) -> np.ndarray:
    s = t[:, None] + D_hat[:, None] * grid.nodes(u.shape[1])
    return plant.jacobians(P, u, s)[0]


def _logarithmic_norm(A: np.ndarray) -> np.ndarray:
    """The largest eigenvalue of the symmetric part of A (..., n, n), (...); infinite where A is not finite."""
    finite = np.all(np.isfinite(A), axis=(-2, -1))
    symmetric = np.where(finite[..., None, None], (A + np.swapaxes(A, -1, -2)) / 2, 0.0)
    return np.where(finite, np.linalg.eigvalsh(symmetric)[..., -1], np.inf)


def _components(low: np.ndarray, high: np.ndarray) -> list[Interval]:
    return [Interval(low[..., k], high[..., k]) for k in range(low.shape[-1])]


def _matrices(columns: list[Operand], shape: tuple[int, ...], n: int) -> tuple[np.ndarray, np.ndarray]:
    """The middles of matrices (*shape, rows, n) whose entries are intervals or numbers, and their halves' widths."""
    entries = [interval(a) for a in columns]
    low, high = (
        np.stack([np.broadcast_to(a, shape) for a in ends], axis=-1).reshape(*shape, n, -1).swapaxes(-1, -2)
        for ends in ([a.low for a in entries], [a.high for a in entries])
    )
    return (low + high) / 2, (high - low) / 2
