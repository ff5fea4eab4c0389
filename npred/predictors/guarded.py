"""A predictor that is checked in every call: where its error in U may be above a tolerance, numerics answer instead."""

from collections.abc import Callable
from functools import cached_property
from itertools import pairwise
from typing import Any, ClassVar

import numpy as np

from npred import array_checks, grid
from npred.data.domain import MOMENTS, Domain, legendre, unread
from npred.delays import family, family_of
from npred.delays.family import Kernel
from npred.errors import ConfigError
from npred.plants.base import Plant
from npred.predictors import error_bound
from npred.predictors.base import Predictor
from npred.predictors.error_bound import ErrorBound
from npred.predictors.heun import Heun
from npred.predictors.rk4 import RK4
from npred.symbolic import kernels

ESTIMATES = ("auto", "shadow", "defect")
PASSES = 0.4  # of the tolerance: the largest estimate that passes, for an adversary finds errors 2.5 times as large
SHARE = 0.25  # of the tolerance: how far off the estimate of an exact prediction may be …
QUANTILE = 0.99  # … on this share of the data's rows
FEWEST = 4  # intervals of the coarser of two grids

# With A = kappa of the reference, of order 2, on every stride-th node and B of that on fewer, Richardson's
# extrapolation is R = A + (A - B) / (ratio² - 1), and the estimate |kappa(P) - R| + |R - A|: where the reference itself
# is inaccurate, it doubts. Cells of u are read by their means, as the predictors read those of the nodes.
GUARD = """\
    nx, n, lanes = P.shape
    m, last = u.shape[1], nx - 1
    {names}
    U, A, B = np.empty((m, lanes)), np.empty((m, lanes)), np.empty((m, lanes))
    for coarser in range(1, -1, -1):
        stride = int(guard[1 + coarser])
        count = last // stride + 1
        v, Q, R = np.empty((count, m, lanes)), np.empty((count, n, lanes)), np.empty((count, n, lanes))
        for J in range(count):
            low, high = max((J - 0.5) * stride, 0.0), min((J + 0.5) * stride, float(last))
            v[J] = 0.0
            for j in range(int(low + 0.5), min(int(high + 0.5), last) + 1):
                weight = (min(j + 0.5, high) - max(j - 0.5, low)) / (high - low)
                for c in range(m):
                    for l in range(lanes):
                        v[J, c, l] += weight * u[j, c, l]
            for c in range(n):
                for l in range(lanes):
                    R[J, c, l] = P[J * stride, c, l]
        {reference}
        control(Q, v, D_hat, t, p, B if coarser else A)
    if guard[3] > 0.0:
        for j in range(nx):
            J = min(j // stride, count - 2)
            share = j / stride - J
            for c in range(n):
                for l in range(lanes):
                    P[j, c, l] += (1.0 - share) * (Q[J, c, l] - R[J, c, l]) + share * (Q[J + 1, c, l] - R[J + 1, c, l])
    control(P, u, D_hat, t, p, U)
    for l in range(lanes):
        error[l] = 0.0
        for c in range(m):
            extrapolated = A[c, l] + (A[c, l] - B[c, l]) / ((guard[2] / guard[1]) ** 2 - 1.0)
            gap = abs(U[c, l] - extrapolated) + abs(extrapolated - A[c, l])
            error[l] = max(error[l], gap if gap < np.inf else np.inf)  # also of what is not a number
        outside = False
        if guard[4] < np.inf:
            {distance}
            outside = rough or not total <= guard[4] ** 2
        fallback[l] = 1.0 if outside or not error[l] <= guard[0] else 0.0
        if fallback[l] > 0.0:
            x1, u1, D1, P1 = np.empty((n, 1)), np.empty((nx, m, 1)), np.empty(1), np.empty((nx, n, 1))
            x1[:, 0], u1[:, :, 0], D1[0] = X[:, l], u[:, :, l], D_hat[l]
            exact(x1, u1, D1, t, p, P1)
            P[:, :, l] = P1[:, :, 0]
"""

DISTANCE = """\
for c in range(n):
    feature[c] = np.arcsinh(X[c, l] / bend[c])
feature[n] = D_hat[l]
for k in range({moments}):
    for c in range(m):
        moment = 0.0
        for j in range(nx):
            moment += weights[k * nx + j] * u[j, c, l]
        feature[n + 1 + c * {moments} + k] = moment
{phase}
total = 0.0
for i in range(size):
    row = 0.0
    for k in range(i + 1):
        row += whiten[i * size + k] * (feature[k] - mean[k])
    total += row * row
rough = False
for c in range(m):
    unread = 0.0
    for j in range(nx - 3):
        kink = u[j, c, l] - u[j + 1, c, l] - u[j + 2, c, l] + u[j + 3, c, l]
        first = 3.0 * u[j, c, l] - 7.0 * u[j + 1, c, l] + 5.0 * u[j + 2, c, l] - u[j + 3, c, l]
        final = 3.0 * u[j + 3, c, l] - 7.0 * u[j + 2, c, l] + 5.0 * u[j + 1, c, l] - u[j, c, l]
        ends = (abs(first) if j == 0 else 0.0) + (abs(final) if j == nx - 4 else 0.0)
        unread += (abs(kink) + ends) / (24.0 * last)
    rough = rough or not D_hat[l] * unread <= roughest[c]
"""


class Guarded(Predictor):
    """`model`, with its error in U estimated in every call; `exact` answers where that may be above `tolerance`.

    `tolerance` is in units of U, the largest |kappa(P̂(1)) - kappa(P(1))| over the inputs that passes; the model
    answers where 2.5 times the estimate is within it. The estimate is by a `shadow`, Heun's method on few nodes, or by
    the `defect` P̂' - D_hat f(P̂, u), carried to x = 1 by the linearised equation; `auto` is the shadow, which takes
    fewer operations per node. How few nodes follows from examples of the data, which trained models carry; other models
    are compared on all nodes. Outside the data, as Domain has it, and where u is rougher than theirs, `exact` answers
    whatever the estimate is. With `correct`, the defect's error is subtracted from P̂ first.
    Raises ConfigError for a tolerance that is not above 0, and for an estimate that the plant's family lacks.
    """

    name: ClassVar[str] = "guarded"

    def __init__(
        self, model: Predictor, tolerance: float = 0.01, by: str = "auto", *, exact: Predictor | None = None,
        correct: bool = False,
    ) -> None:  # fmt: skip
        if not isinstance(model, Predictor):
            raise ConfigError(f"guarded: expected a Predictor, got {model!r}; load one with npred.load")
        super().__init__(model.plant, model.nx)
        if not array_checks.number("tolerance", tolerance) > 0:
            raise ConfigError(f"tolerance: expected a number above 0, in units of U, got {tolerance!r}; give another")
        if by not in ESTIMATES:
            raise ConfigError(f"by: expected {', '.join(ESTIMATES)}, got {by!r}; choose one")
        if not _strides(self.nx):
            raise ConfigError(
                f"guarded: expected a model on nodes of which every second, third or so makes {FEWEST} intervals or "
                f"more, got {self.nx} nodes; load it with nx = {self.nx // 10 * 10 + 11}"
            )
        self.model, self.tolerance, self.correct = model, float(tolerance), bool(correct)
        self.exact = exact or RK4(model.plant, model.nx)
        self.by = {"auto": "defect" if correct else "shadow"}.get(by, by)
        if correct and self.by != "defect":
            raise ConfigError("correct: expected by = 'defect', whose error is subtracted, got 'shadow'; leave it out")
        if self.by == "defect":
            family_of(model.plant).needs("defect")
        self.name = f"guarded {model.name}"  # type: ignore[misc]

    @property
    def compiled(self) -> bool:
        return self.model.compiled

    @property
    def domain(self) -> Domain | None:
        """The domain of the data, where the model carries one."""
        return getattr(getattr(self.model, "operator", None), "domain", None)

    @property
    def threshold(self) -> float:
        """The largest estimate with which the model answers, in units of U."""
        return PASSES * self.tolerance

    def lanes(self) -> Callable[..., None]:
        """That of the model; the loop calls `guard` after it."""
        return self.model.lanes()

    @cached_property
    def guard(self) -> Kernel:
        """GUARD: the estimate, and `exact` where that is above the tolerance."""
        return kernel(self.plant, self.by, self.exact)

    @cached_property
    def settings(self) -> np.ndarray:
        """What the kernel is set to: tolerance, stride, whether it corrects, and the domain."""
        return self._set(self.strides)

    @cached_property
    def strides(self) -> tuple[int, int]:
        """The intervals between two nodes of the estimate's grids: as many as the data's examples allow."""
        finest, *coarser = _strides(self.nx)
        if self.domain is None:
            return finest
        X, u, D_hat, t = self.domain.X, grid.refine(self.domain.u, self.nx), self.domain.D_hat, self.domain.t
        P = self.exact(X, u, D_hat, t)
        for strides in reversed(coarser):
            error = self._run(self._set(strides, tolerance=np.inf), P, X, u, D_hat, t)[1]
            if np.quantile(error, QUANTILE) <= SHARE * self.tolerance:
                return strides
        return finest

    def predict(self, X: np.ndarray, u: np.ndarray, D_hat: np.ndarray, t: Any) -> np.ndarray:
        return self._run(self._on(u), self.model(X, u, D_hat, t), X, u, D_hat, t)[0]

    def error(self, X: Any, u: Any, D_hat: Any, t: Any = 0.0) -> np.ndarray:
        """The estimate of |kappa(P̂(1)) - kappa(P(1))|, (...), in units of U; of the corrected P̂ with `correct`."""
        return self.judge(self.model(X, u, D_hat, t), X, u, D_hat, t)[0]

    def fallback(self, X: Any, u: Any, D_hat: Any, t: Any = 0.0) -> np.ndarray:
        """Whether the numerical predictor answers, (...) bool."""
        return self.judge(self.model(X, u, D_hat, t), X, u, D_hat, t)[1]

    def bound(self, X: Any, u: Any, D_hat: Any, t: Any = 0.0) -> np.ndarray:
        """A bound of what `error` estimates, (...), in NumPy: see npred.predictors.error_bound.

        Infinite where none is found. Raises ConfigError for a plant that is not traced, or has not one constant delay.
        """
        shape, rows = self._rows(X, u, D_hat, t)
        return self.error_bound(self.model(*rows), *rows).reshape(shape)

    @cached_property
    def error_bound(self) -> ErrorBound:
        """The bound with the weights that suit examples of the data; without these, no state outweighs another."""
        domain = self.domain
        if domain is None:
            return ErrorBound(self.plant, np.eye(self.plant.n))
        rows = domain.X, grid.refine(domain.u, self.nx), domain.D_hat, domain.t
        return ErrorBound(self.plant, error_bound.weight(self.plant, self.exact(*rows), *rows[1:]))

    def beyond(self, X: np.ndarray, u: np.ndarray, D_hat: np.ndarray, t: np.ndarray) -> np.ndarray:
        """How far inputs are from the data, as a share of how far the model is trusted, (B,); 0 where it has none."""
        if self.domain is None:
            return np.zeros(len(X))
        away = self.domain.distance(X, u, D_hat, self.plant.phase(t)) / self.domain.limit
        with np.errstate(divide="ignore", invalid="ignore"):
            rough = np.nan_to_num(D_hat[:, None] * unread(u) / self.domain.roughest(self.nx))
        return np.maximum(away, rough.max(axis=1))

    def judge(self, P_hat: np.ndarray, X: Any, u: Any, D_hat: Any, t: Any = 0.0) -> tuple[np.ndarray, np.ndarray]:
        """The estimate and whether the numerical predictor answers, (...), where the model has said P_hat."""
        shape, rows = self._rows(X, u, D_hat, t)
        P_hat = P_hat.reshape(-1, *P_hat.shape[-2:])
        _, error, fallback = self._run(self._on(rows[1]), P_hat, *rows)
        return error.reshape(shape), fallback.reshape(shape)

    def _on(self, u: np.ndarray) -> np.ndarray:
        """The settings for inputs on these nodes. Raises ConfigError for others than those of `nx`."""
        if u.shape[-2] != self.nx:
            raise ConfigError(f"u: expected {self.nx} nodes, those of the guard, got {u.shape[-2]}; load another nx")
        return self.settings

    def _run(
        self, settings: np.ndarray, P_hat: np.ndarray, X: np.ndarray, u: np.ndarray, D_hat: np.ndarray, t: Any
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:  # fmt: skip
        """P (B, nx, n), the estimate (B,) and whether `exact` answered (B,), of P_hat (B, nx, n)."""
        P, error, fallback = np.array(P_hat, dtype=float), np.empty(len(X)), np.empty(len(X))
        reads_time = self.plant.clocked or not self.plant.rests  # the prediction, or the law that the guard compares by
        times = np.broadcast_to(t, len(X)) if reads_time else np.zeros(len(X))
        for moment in np.unique(times):  # a call of the kernel has one time
            rows = np.flatnonzero(times == moment)
            lanes = [np.array(np.moveaxis(a[rows], 0, -1), order="C") for a in (X, u, D_hat, P, error, fallback)]
            self.guard(*lanes[:3], float(moment), self.plant.p, settings, *lanes[3:])
            P[rows], error[rows], fallback[rows] = np.moveaxis(lanes[3], -1, 0), *lanes[4:]
        return P, error, fallback > 0

    def _set(self, strides: tuple[int, int], tolerance: float | None = None) -> np.ndarray:
        head = [self.threshold if tolerance is None else tolerance, *strides, float(self.correct)]
        domain = self.domain
        if domain is None or tolerance is not None:
            return np.array([*head, np.inf])
        parts = (domain.bend, domain.mean, domain.whiten.ravel(), domain.roughest(self.nx), legendre(self.nx).ravel())
        return np.concatenate([[*head, domain.limit.item()], *parts])


def _strides(nx: int) -> list[tuple[int, int]]:
    """The pairs of grids that have some of nx nodes, each with the next coarser one, the finest first."""
    divisors = [s for s in range(1, (nx - 1) // FEWEST + 1) if (nx - 1) % s == 0]
    return list(pairwise(divisors))


def bare(predictor: Predictor) -> Predictor:
    """The model inside a guarded predictor; any other predictor itself."""
    return getattr(predictor, "model", predictor)


def kernel(plant: Plant, by: str, exact: Predictor) -> Kernel:
    """GUARD of a plant: compiled, or, where the plant is not traced, the same text in Python."""
    model = family_of(plant)
    used = {"control": model.control(Heun.step), "exact": exact.lanes()}
    used["reference"] = model.correction() if by == "defect" else model.sweep(Heun.step)
    call = "reference(R, X, v, D_hat, t, p, Q)" if by == "defect" else "reference(X, v, D_hat, t, p, Q)"
    size = plant.n + 1 + MOMENTS * plant.m + (2 if plant.phased else 0)
    ends = np.cumsum([5, plant.n, size, size * size, plant.m]).tolist()
    spans = zip(("bend", "mean", "whiten", "roughest", "weights"), ends, [*ends[1:], ""], strict=True)
    names = [f"{name} = guard[{begin}:{end}]" for name, begin, end in spans] + [f"feature = np.empty({size})"]
    angle = f"2.0 * np.pi * t / {plant.period!r}"
    phase = [f"feature[{size - 2}], feature[{size - 1}] = np.cos({angle}), np.sin({angle})"] if plant.phased else []
    distance = kernels.fill(DISTANCE.format(moments=MOMENTS, phase="{phase}"), phase=phase).splitlines()
    source = kernels.fill(GUARD, names=[*names, f"size = {size}"], reference=[call], distance=distance)
    if not plant.traced:
        space: dict[str, Any] = used | {"np": np}
        exec(f"def guarded({family.GUARD}):\n{source}", space)
        return space["guarded"]
    imports = [f"from {part.__module__} import {part.__name__} as {name}\n" for name, part in used.items()]
    return family.build("guarded", family.GUARD, source, "".join(imports))
