"""A predictor that is checked in every call: where its error in U may be above a tolerance, numerics answer instead."""

import ctypes
from collections.abc import Callable
from functools import cached_property
from itertools import pairwise
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from npred.base import array_checks, grid
from npred.base.errors import ConfigError
from npred.kernels.kernel import Failure, callback, made, skeleton
from npred.networks.domain import Domain
from npred.plants.base import Plant
from npred.prediction.delays import problem, problem_of
from npred.prediction.delays.problem import Kernel, by_time
from npred.prediction.methods.base import Compiled, OneStep, Predictor
from npred.prediction.methods.coarse import LADDER, Coarse, Examples, one_step
from npred.prediction.methods.runge_kutta import RK4
from npred.prediction.methods.single import SingleCalls

PASSES = 0.8  # times the tolerance: the largest estimate that passes, for errors may be larger; a margin, not a bound
SHARE = 0.25  # times the tolerance: how far off what answers in the network's place may be
METHODS = ("rk4", "semi_implicit", "rosenbrock")  # by which shadows may be taken
FEWEST = 5  # nodes
FEW = 0.01  # share of the examples: for so many the shadows may not decide
WORTH = 0.4  # times the operations of `exact`: what the shadows of the first level may take
LEVELS = 4  # grids that the settings have room for
HEAD = 3 + LEVELS  # numbers of the settings before those of the domain: tolerance, limit, how many levels, their counts
SHADOWS = 4  # predictions side by side, of a method whose steps tell their error; there is one of any other
POINTERS = {"CONTROL": problem.CONTROL, "EXACT": problem.PREDICT, "REFERENCE": problem.PREDICT}


class Guarded(Predictor):
    """`model`, with its error in U estimated in every call; `exact` answers where that may be above `tolerance`.

    `tolerance` is in units of U, the largest |kappa(P̂(1)) - kappa(P(1))| over the inputs that is to pass; the model
    answers where 1.25 times the estimate is within it. A pass is an estimate, not a bound, and an answer of `exact` has
    the error of its nodes, which `tolerance` does not limit (docs/guard.md). Shadows,
    predictions on few intervals to which local errors are added with different signs, estimate it: the distance of U
    from the first of them, and how far they come apart. Where that does not decide, they are taken on more intervals.
    The method (RK4, or an implicit one where the plant is stiff), the intervals, and what `exact` is by default follow
    from examples of the data, which trained models carry; other models are compared on all nodes, and `exact` is RK4.
    Outside the data, as Domain has it, `exact` answers whatever the estimate is.
    Raises ConfigError for a tolerance that is not above 0, and for fewer than five nodes.
    """

    name: ClassVar[str] = "guarded"

    def __init__(self, model: Predictor, tolerance: float = 0.01, *, exact: Predictor | None = None) -> None:
        if not isinstance(model, Predictor):
            raise ConfigError(f"guarded: expected a Predictor, got {model!r}; load one with npred.load")
        if exact is not None and not isinstance(exact, Predictor):
            raise ConfigError(f"exact: expected a Predictor, got {exact!r}; make one with npred.predictor")
        super().__init__(model.plant, model.nx)
        self.plant.own("exact", exact)
        if not array_checks.number("tolerance", tolerance) > 0:
            raise ConfigError(f"tolerance: expected a number above 0, in units of U, got {tolerance!r}; give another")
        if self.nx < FEWEST:
            what = f"expected a model on {FEWEST} nodes or more, got {self.nx}"
            raise ConfigError(f"guarded: {what}; load it with another nx")
        self.model, self.tolerance, self._exact = model, float(tolerance), exact
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
        """The kernel of the model; the loop calls `guard` after it."""
        return self.model.lanes()

    @cached_property
    def guard(self) -> Kernel:
        """GUARD: the estimate, and `exact` where that is above the tolerance."""
        return self._kernel(self.reference[0])

    @cached_property
    def settings(self) -> np.ndarray:
        """The settings of the kernel: tolerance, the limit of the distance, the levels, and the domain."""
        return self._set(self.threshold, self.reference[1])

    @cached_property
    def reference(self) -> tuple[str, list[int]]:
        """The method of the shadows and the intervals of their levels.

        Among methods that are cheap enough at the first level, it is the cheapest that decides all but 1 % as many
        examples of the data as the best. An example is decided if the shadows differ by at most half of what passes.
        This matters for cost alone, because `exact` answers a call that no level decides. Cost is counted in
        operations of the programs, not timed, so that the same guard answers the same calls on every machine.
        If inputs are read at nodes only (several delays, or a declared one), wider intervals miss how inputs act
        together, on both grids alike: shadows are then on all nodes, and on twice as many intervals.
        """
        last = self.nx - 1
        if self.domain is None or not problem_of(self.plant).reads_cells:
            name = self.exact.name if self.exact.name in self._methods else METHODS[0]
            return name, [last, 2 * last]
        # Where RK4 answers in the network's place, the plant is not stiff: implicit methods are not even compiled.
        names = METHODS[:1] if self.exact.name == METHODS[0] else self._methods
        each = {name: one_step(name).operations(self.plant) * one_step(name).steps_of_pair for name in names}
        counts = [count for count in LADDER if 2 * count < self.nx]
        counted = self.exact if isinstance(self.exact, Coarse | OneStep) else RK4(self.plant)  # else unknown
        P, worth = self.exact(*self.examples.calls), WORTH * counted.call_operations(self.nx - 1)
        tried: list[tuple[float, float, str, int]] = []
        for cost, name, first in sorted((count * cost, name, count) for name, cost in each.items() for count in counts):
            if cost > worth and any(undecided < 0.5 for undecided, *_ in tried):
                break
            if any(undecided <= FEW and total < cost for undecided, total, *_ in tried):
                break  # the remaining ones cost more
            tried.append((*self._undecided(P, name, [first * 2**k for k in range(LEVELS)]), name, first))
        enough = min(undecided for undecided, *_ in tried) + FEW
        _, name, first = min((cost, name, first) for undecided, cost, name, first in tried if undecided <= enough)
        return name, [first * 2**k for k in range(LEVELS)]

    def _undecided(self, P: np.ndarray, name: str, levels: list[int]) -> tuple[float, float]:
        """The share of the examples, whose predictions are P, that no level decides, and the operations of one call."""
        kind, left = one_step(name), np.ones(len(P), dtype=bool)
        steps = float(levels[0])
        for pair in pairwise(levels):
            steps += left.mean() * pair[1]
            settings = self._set(self.threshold / 2, [*pair])
            left &= self._run(settings, P, *self.examples.calls, run=self._kernel(name))[2]
        return float(left.mean()), steps * kind.operations(self.plant) * kind.steps_of_pair

    @cached_property
    def examples(self) -> Examples:
        """Some rows of the data, u on the nodes of the guard."""
        domain = self.domain
        assert domain is not None
        return Examples(self.plant, domain.X, grid.means(domain.u, self.nx), domain.D_hat, domain.t)

    @cached_property
    def exact(self) -> Predictor:
        """The predictor that answers where the guard doubts: RK4 on all nodes, or, where examples of the data are too
        stiff for 50 of its steps, the cheapest implicit method on as few cells as keep U within SHARE of the tolerance.
        """
        if self._exact is None and self.domain is not None and problem_of(self.plant).reads_cells:
            return self.examples.exact(self._methods[1:], SHARE * self.tolerance)
        return self._exact or RK4(self.plant, self.nx)

    @property
    def _methods(self) -> list[str]:
        return [name for name in METHODS if problem_of(self.plant).refusal(name) is None]

    @cached_property
    def _kernels(self) -> dict[str, Kernel]:
        return {}

    def _kernel(self, name: str) -> Kernel:
        """GUARD with shadows by the method, put together once."""
        if name not in self._kernels:
            self._kernels[name] = kernel(self.plant, self.exact, one_step(name))
        return self._kernels[name]

    @property
    def _reads_time(self) -> bool:
        """Whether the prediction, or the law by which the guard compares, depends on time."""
        return self.plant.clocked or not self.plant.rests

    @cached_property
    def _single(self) -> SingleCalls | None:
        model = self.model
        if not isinstance(model, Compiled) or type(self).predict is not Guarded.predict or model._single is None:
            return None

        def chain(nx: int) -> list[tuple[Kernel, tuple[np.ndarray, ...], int]] | None:
            return [(model.on(nx), (), 0), (self.guard, (self.settings,), 2)] if nx == self.nx else None

        return SingleCalls(self.plant, self._reads_time, chain)

    def predict(self, X: np.ndarray, u: np.ndarray, D_hat: np.ndarray, t: np.ndarray | float) -> np.ndarray:
        return self._run(self.settings, self.model(X, u, D_hat, t), X, u, D_hat, t)[0]

    def error(self, X: ArrayLike, u: ArrayLike, D_hat: ArrayLike, t: ArrayLike = 0.0) -> np.ndarray:
        """The estimate of |kappa(P̂(1)) - kappa(P(1))|, (...), in units of U."""
        return self.judge(self.model(X, u, D_hat, t), X, u, D_hat, t)[0]

    def fallback(self, X: ArrayLike, u: ArrayLike, D_hat: ArrayLike, t: ArrayLike = 0.0) -> np.ndarray:
        """Whether the numerical predictor answers, (...) bool."""
        return self.judge(self.model(X, u, D_hat, t), X, u, D_hat, t)[1]

    def beyond(self, X: np.ndarray, u: np.ndarray, D_hat: np.ndarray, t: np.ndarray) -> np.ndarray:
        """The distance of inputs from the data, relative to the trusted distance, (B,); 0 without a domain."""
        if self.domain is None:
            return np.zeros(len(X))
        return self.domain.distance(X, u, D_hat, self.plant.phase(t))

    def judge(
        self, P_hat: ArrayLike, X: ArrayLike, u: ArrayLike, D_hat: ArrayLike, t: ArrayLike = 0.0
    ) -> tuple[np.ndarray, np.ndarray]:
        """The estimate and whether the numerical predictor answers, (...), where the model has said P_hat."""
        shape, rows = self._rows(X, u, D_hat, t)
        P_hat = array_checks.floats("P_hat", P_hat)
        P_hat = P_hat.reshape(-1, *P_hat.shape[-2:])
        _, error, fallback = self._run(self.settings, P_hat, *rows)
        return error.reshape(shape), fallback.reshape(shape)

    def _run(
        self, settings: np.ndarray, P_hat: np.ndarray, *call: np.ndarray | float, run: Kernel | None = None
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """P (B, nx, n), the estimate (B,) and whether `exact` answered (B,), of P_hat (B, nx, n) and X, u, D_hat, t."""
        X, u, D_hat, t = map(np.asarray, call)
        if u.shape[-2] != self.nx:
            raise ConfigError(f"u: expected {self.nx} nodes, those of the guard, got {u.shape[-2]}; load another nx")
        P, error, fallback = np.array(P_hat, dtype=float), np.empty(len(X)), np.empty(len(X))
        times = np.broadcast_to(t, len(X)) if self._reads_time else np.zeros(len(X))
        by_time(run or self.guard, (X, u, D_hat), times, (self.plant.p, settings), (P, error, fallback))
        return P, error, fallback > 0

    def _set(self, tolerance: float, levels: list[int]) -> np.ndarray:
        domain = self.domain
        head = [tolerance, np.inf if domain is None else domain.limit.item(), len(levels), *levels]
        head += [0.0] * (HEAD - len(head))
        if domain is None:
            return np.array(head)
        return np.concatenate([head, domain.bend, domain.mean, domain.middle, domain.half, domain.whiten.T.ravel()])


def kernel(plant: Plant, exact: Predictor, method: type[OneStep]) -> Callable[..., None]:
    """GUARD of a plant: its parts compiled into it, or, where the plant is not traced, called back."""
    model, n, m, phased = problem_of(plant), plant.n, plant.m, plant.phased
    cells, signed = model.reads_cells, method.paired
    reference = model.sweep(method.shadow(), cells, more=1) if signed else method(plant).cells()
    parts: dict[str, Any] = {"CONTROL": model.control(RK4.step), "EXACT": exact.lanes(), "REFERENCE": reference}
    compiled, shadows = parts if plant.traced else {}, SHADOWS if signed else 1

    def work(nx: int, lanes: int, settings: np.ndarray) -> int:
        finest = int(settings[3:HEAD].max()) + 1
        side = shadows + (cells and signed)
        one = n + nx * (m + n) + 3 * (nx + 1) * m + m * side  # a lane, and what its levels share
        grid = finest * (3 * m + side * (2 * (m + signed) + n)) + side * (n + 1)
        rest = [part.work(max(nx, finest), max(lanes, side), None) for part in compiled.values()]
        return len(POINTERS) + m * lanes + one + grid + max(0, *rest, 0)

    sizes = {"N": n, "M": m, "PHASED": int(phased), "PERIOD": repr(plant.period) if phased else "1.0"}
    sizes |= {"ON_CELLS": int(cells), "SIGNED": int(signed), "SHADOWS": shadows}
    sizes |= {"ORDER": method.order, "LEVELS": LEVELS} | ({} if plant.traced else {"FOREIGN": ""})
    guard = made("guarded", problem.GUARD, skeleton("guard.h"), {}, sizes, compiled, [skeleton("cells.h")], work=work)
    if plant.traced:
        return guard

    def guarded(*values: Any) -> None:  # its scratch memory begins with the addresses of the parts
        failure = Failure()
        pointers = [callback(part, POINTERS[name], {"p": plant.p}, failure) for name, part in parts.items()]
        addresses = [ctypes.cast(pointer, ctypes.c_void_p).value for pointer in pointers]
        guard(*values, scratch=np.array(addresses, dtype=np.uint64).view(np.float64))
        failure.raised()

    return guarded


def bare(predictor: Predictor) -> Predictor:
    """The model inside a guarded predictor; any other predictor itself."""
    return getattr(predictor, "model", predictor)


def guarded(model: Predictor, tolerance: float = 0.01, *, exact: Predictor | None = None) -> Predictor:
    """`model`, checked in every call: `exact` answers where |kappa(P̂(1)) - kappa(P(1))| is estimated to be above
    `tolerance`; see Guarded.

    A pass is an estimate, not a bound, and `tolerance` does not limit the error of `exact`: docs/guard.md says what an
    adversary finds.

    Parameters
    ----------
    model : Predictor
        A network from npred.load, or any other.
    tolerance : float, in the inputs' units, default 0.01
        Largest error of U that is accepted.
    exact : Predictor, optional
        Answers in place of the model; by default RK4, or a method that suits the data of a trained model.

    Returns
    -------
    Predictor
        P(x) = X + D_hat ∫₀ˣ f(P(y), u(y)) dy on nx uniform nodes, both ends in [DAPF, eq. 10].

    Raises
    ------
    ConfigError
        For a tolerance that is not above 0, and for a model on fewer than five nodes.
    """
    return Guarded(model, tolerance, exact=exact)
