"""A predictor that is checked in every call: where its error in U may be above a tolerance, numerics answer instead."""

from collections.abc import Callable
from functools import cached_property
from itertools import pairwise
from typing import TYPE_CHECKING, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from npred import array_checks, grid
from npred.data.domain import Domain, unread
from npred.delays import family_of
from npred.delays.family import Kernel, by_time
from npred.errors import ConfigError
from npred.predictors import method
from npred.predictors.base import Predictor
from npred.predictors.coarse import Examples, Grids
from npred.predictors.guard_kernel import kernel
from npred.predictors.runge_kutta import RK4

if TYPE_CHECKING:  # an extra of certify
    from npred.bounds import ErrorBound

ESTIMATES = ("auto", "shadow", "defect")
PASSES = 0.4  # of the tolerance: the largest estimate that passes, for errors may be larger; a margin, not a bound
SHARE = 0.25  # of the tolerance: how far off the estimate of an exact prediction may be
MISLED = 0.1  # of the tolerance: how far off the shadow itself may be, where it seems to be right
FEWEST = 4  # intervals of the coarser of two grids that read nodes
METHODS = ("heun", "semi_implicit", "rosenbrock")  # of order 2, by which an estimate may be
REFINEMENTS = 2  # of the grids, where they do not decide; the kernel has as many levels


class Guarded(Predictor):
    """`model`, with its error in U estimated in every call; `exact` answers where that may be above `tolerance`.

    `tolerance` is in units of U, the largest |kappa(P̂(1)) - kappa(P(1))| over the inputs that is to pass; the model
    answers where 2.5 times the estimate is within it. A pass is an estimate, not a bound (docs/guard.md). The estimate
    is by a `shadow`, a method of order 2 on few steps, or by the `defect` P̂' - D_hat f(P̂, u), carried to x = 1 by the
    linearised equation; `auto` is the shadow, of fewer operations per node. Which method (Heun's, or an implicit one
    where the plant is stiff), how few steps, and what `exact` is by default follow from examples of the data, which
    trained models carry; other models are compared on all nodes, by the method of `exact` where that is implicit, and
    `exact` is RK4. Outside the data, as Domain has it, and where u is rougher than theirs, `exact` answers whatever the
    estimate is. With `correct`, the defect's error is subtracted from P̂ first; that is not advised, for of what is left
    the first term of the estimate says nothing.
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
        if not _grids(self.nx):
            raise ConfigError(
                f"guarded: expected a model on nodes of which every second, third or so makes {FEWEST} intervals or "
                f"more, got {self.nx} nodes; load it with nx = {self.nx // 10 * 10 + 11}"
            )
        self.model, self.tolerance, self.correct = model, float(tolerance), bool(correct)
        self._exact = exact
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
        return self._kernel(self.reference[0])

    @cached_property
    def settings(self) -> np.ndarray:
        """What the kernel is set to: tolerance, grids, whether it corrects, and the domain."""
        return self._set(self.reference[1])

    @cached_property
    def reference(self) -> tuple[str, Grids]:
        """The method that the estimate is by, and the steps of its two grids: the cheapest for the data's examples.

        Where an example of the data makes the coarse shadow and the fine one agree, to what passes, both agree with
        `exact`, to MISLED of the tolerance. Cost is counted in operations of the programs, with those of `exact` where
        the guard doubts, so that the same guard answers the same calls on every machine.
        """
        family = family_of(self.plant)
        if self.by == "defect" or not family.reads_cells:
            return "heun", self._divided()
        if self.domain is None:
            last = self.nx - 1
            return (self.exact.name if self.exact.name in self._methods else "heun"), (last, max(last // 2, 1))
        return self.examples.shadow(self.model, self.exact, self._methods, self.threshold, MISLED * self.tolerance)

    def _divided(self) -> Grids:
        """The steps of two grids of the nodes, as few as the data's examples allow."""
        finest, *coarser = _grids(self.nx)
        if self.domain is None:
            return finest
        calls = self.examples.calls
        P = self.exact(*calls)
        for counts in reversed(coarser):
            error = self._run(self._set(counts, tolerance=np.inf), P, *calls, run=self._kernel("heun"))[1]
            if error.max() <= SHARE * self.tolerance:
                return counts
        return finest

    @cached_property
    def examples(self) -> Examples:
        """Some rows of the data, u on the nodes of the guard."""
        domain = self.domain
        assert domain is not None
        return Examples(self.plant, domain.X, grid.refine(domain.u, self.nx), domain.D_hat, domain.t)

    @cached_property
    def exact(self) -> Predictor:
        """What answers where the guard doubts: RK4 on all nodes, or, where the examples of the data are too stiff for
        50 of its steps, the cheapest implicit method on as few cells as keep U within SHARE of the tolerance.
        """
        if self._exact is None and self.domain is not None and family_of(self.plant).reads_cells:
            return self.examples.exact(self._methods[1:], SHARE * self.tolerance)
        return self._exact or RK4(self.plant, self.nx)

    @property
    def _methods(self) -> list[str]:
        return [name for name in METHODS if family_of(self.plant).refusal(name) is None]

    def _kernel(self, name: str) -> Kernel:
        return kernel(self.plant, self.by, self.exact, method(name))  # type: ignore[arg-type]

    def predict(self, X: np.ndarray, u: np.ndarray, D_hat: np.ndarray, t: np.ndarray | float) -> np.ndarray:
        return self._run(self._on(u), self.model(X, u, D_hat, t), X, u, D_hat, t)[0]

    def error(self, X: ArrayLike, u: ArrayLike, D_hat: ArrayLike, t: ArrayLike = 0.0) -> np.ndarray:
        """The estimate of |kappa(P̂(1)) - kappa(P(1))|, (...), in units of U; of the corrected P̂ with `correct`."""
        return self.judge(self.model(X, u, D_hat, t), X, u, D_hat, t)[0]

    def fallback(self, X: ArrayLike, u: ArrayLike, D_hat: ArrayLike, t: ArrayLike = 0.0) -> np.ndarray:
        """Whether the numerical predictor answers, (...) bool."""
        return self.judge(self.model(X, u, D_hat, t), X, u, D_hat, t)[1]

    def bound(self, X: ArrayLike, u: ArrayLike, D_hat: ArrayLike, t: ArrayLike = 0.0) -> np.ndarray:
        """A bound of what `error` estimates, (...), in NumPy: see npred.bounds.

        Infinite where none is found. Raises ConfigError for a plant that is not traced, or has not one constant delay.
        """
        shape, rows = self._rows(X, u, D_hat, t)
        return self.error_bound(self.model(*rows), *rows).reshape(shape)

    @cached_property
    def error_bound(self) -> "ErrorBound":
        """The bound with the weights that suit examples of the data; without these, no state outweighs another."""
        from npred.bounds import ErrorBound, weight

        if self.domain is None:
            return ErrorBound(self.plant, np.eye(self.plant.n))
        calls = self.examples.calls
        return ErrorBound(self.plant, weight(self.plant, self.exact(*calls), *calls[1:]))

    def beyond(self, X: np.ndarray, u: np.ndarray, D_hat: np.ndarray, t: np.ndarray) -> np.ndarray:
        """How far inputs are from the data, as a share of how far the model is trusted, (B,); 0 where it has none."""
        if self.domain is None:
            return np.zeros(len(X))
        away = self.domain.distance(X, u, D_hat, self.plant.phase(t)) / self.domain.limit
        with np.errstate(divide="ignore", invalid="ignore"):
            rough = np.nan_to_num(D_hat[:, None] * unread(u) / self.domain.roughest(self.nx))
        return np.maximum(away, rough.max(axis=1))

    def judge(
        self, P_hat: np.ndarray, X: ArrayLike, u: ArrayLike, D_hat: ArrayLike, t: ArrayLike = 0.0
    ) -> tuple[np.ndarray, np.ndarray]:
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
        self, settings: np.ndarray, P_hat: np.ndarray, *call: np.ndarray | float, run: Kernel | None = None
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """P (B, nx, n), the estimate (B,) and whether `exact` answered (B,), of P_hat (B, nx, n) and X, u, D_hat, t."""
        X, u, D_hat, t = map(np.asarray, call)
        P, error, fallback = np.array(P_hat, dtype=float), np.empty(len(X)), np.empty(len(X))
        reads_time = self.plant.clocked or not self.plant.rests  # the prediction, or the law that the guard compares by
        times = np.broadcast_to(t, len(X)) if reads_time else np.zeros(len(X))
        by_time(run or self.guard, (X, u, D_hat), times, (self.plant.p, settings), (P, error, fallback))
        return P, error, fallback > 0

    def _set(self, counts: Grids, tolerance: float | None = None) -> np.ndarray:
        head = [self.threshold if tolerance is None else tolerance, *counts, float(self.correct)]
        cells = self.by != "defect" and family_of(self.plant).reads_cells
        levels = float(REFINEMENTS if cells and self.domain is not None else 0)
        domain = self.domain
        if domain is None or tolerance is not None:
            return np.array([*head, np.inf, levels])
        parts = (domain.bend, domain.mean, domain.whiten.ravel(), domain.roughest(self.nx))
        return np.concatenate([[*head, domain.limit.item(), levels], *parts])


def _grids(nx: int) -> list[Grids]:
    """The pairs of numbers of intervals of nx nodes, each with the next smaller one, the finest first."""
    last = nx - 1
    return list(pairwise(last // s for s in range(1, last // FEWEST + 1) if last % s == 0))


def bare(predictor: Predictor) -> Predictor:
    """The model inside a guarded predictor; any other predictor itself."""
    return getattr(predictor, "model", predictor)
