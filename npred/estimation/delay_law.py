"""Delay laws: the base class, a rate D_hat' kept within bounds; laws by name; and their kernels for the time loop."""

import copy
from abc import ABC, abstractmethod
from dataclasses import dataclass
from functools import cache
from typing import Any, ClassVar, NamedTuple, Self

import numpy as np

from npred.base import array_checks, source_lines
from npred.base.errors import ConfigError
from npred.base.registry import DELAY_LAWS, FROZEN, Adaptation
from npred.estimation.observers import Observer
from npred.plants.base import Plant
from npred.plants.speed import rates
from npred.prediction.delays import problem, problem_of
from npred.prediction.delays.problem import Kernel
from npred.prediction.methods import RK4


@dataclass(frozen=True)
class DelayLaw(ABC):
    """D_hat' = Proj_[bounds]{D_hat, rate}: a delay law that you write is a subclass with `rate`, in NumPy.

    `rate` uses of gamma, b and bounds, which are a pipeline's, what it needs. Bounds that are left out are None until a
    loop says how long delays are: see `suited`. simulate, controller and the stages of a pipeline take it; it runs in
    Python, batch by batch, unless it has a `kernel`. A subclass that changes a method of such a law, `check` aside,
    runs in Python again.

    Parameters
    ----------
    gamma : float above 0, default 1.0
        Adaptation gain.
    b : float above 0, default 1.0
        Weight of w in N = 1 + V + b ∫₀¹ (1 + x) w² dx.
    bounds : (low, high), in the plant's unit of time, optional
        The range of D_hat; by default 0.1 to 4 times the longest delay of a loop, widened to D and D_hat.

    Raises
    ------
    ConfigError
        For a gain, b or bounds that make no sense.
    """

    integrates: ClassVar = True  # whether D_hat follows from a rate, step by step
    gamma: float = 1.0
    b: float = 1.0
    bounds: tuple[float, float] = None  # type: ignore[assignment]

    def __init_subclass__(cls, **settings: Any) -> None:
        super().__init_subclass__(**settings)
        methods = {name for name, value in vars(cls).items() if callable(value) and not name.startswith("__")}
        if "kernel" not in methods and methods - {"check"}:
            cls.kernel = DelayLaw.kernel  # the base class's kernel does not compute the new rate

    def __post_init__(self) -> None:
        gains = array_checks.floats("adaptation: gamma, b", (1.0 if self.gamma is None else self.gamma, self.b))
        if not (gains > 0).all() or not np.isfinite(gains).all():
            raise ConfigError(f"adaptation: expected gamma > 0 and b > 0, got gamma = {self.gamma}, b = {self.b}")
        bounds = array_checks.floats("adaptation: bounds", (0.0, 0.0) if self.bounds is None else self.bounds)
        if bounds.shape != (2,) or not 0 <= bounds[0] <= bounds[1] < np.inf:
            raise ConfigError(f"adaptation: expected bounds 0 <= low <= high, got {self.bounds}; give (low, high)")

    def check(self, plant: Plant) -> None:  # noqa: B027  a law that serves every plant has nothing to refuse
        """Raise ConfigError where the delay law is not for this plant; asked before anything runs."""

    def suited(self, plant: Plant, D: Any, D_hat: Any) -> Self:
        """The law with its defaults filled in, for delays D (...) and first estimates D_hat (...).

        The bounds are those of the paper for D = 1, 0.1 D to 4 D of the longest delay, widened to D and D_hat.
        """
        ends = np.concatenate([np.ravel(D), np.ravel(D_hat)])
        longest = delay(plant, D, D_hat)
        bounds = (float(min(0.1 * longest, *ends)), float(max(4.0 * longest, *ends)))
        return self if self.bounds is not None else self._with("bounds", bounds)

    def _with(self, name: str, value: Any) -> Self:
        law = copy.copy(self)
        object.__setattr__(law, name, value)
        return law

    @abstractmethod
    def rate(self, plant: Plant, X: np.ndarray, u: np.ndarray, P: np.ndarray, D_hat: np.ndarray, t: float) -> Any:
        """D_hat' (B,) of B loops side by side: X (B, n), u (B, nx, m), P (B, nx, n), D_hat (B,), t.

        u has its values at the nodes. plant.f, plant.kappa and plant.V work on these arrays. The estimate is clipped
        to the bounds after each step.
        """

    def kernel(self, plant: Plant) -> Kernel | None:
        """The law compiled for a plant, problem.UPDATE of npred.prediction.delays: D_hat' = gamma phi; None
        where `rate` has to run.

        It writes phi (B,), and N (B,) where the law has one: W takes it (npred.loop.lyapunov).
        """
        return None

    def observer(
        self, plant: Plant, dt: float, of_state: Observer | None = None
    ) -> tuple[Kernel, np.ndarray, int] | None:
        """A law that finds D_hat from X and its own commands: problem.OBSERVE of npred.prediction.delays, compiled
        for the plant.

        With it come the numbers that it is set to, and how many it remembers per loop, NaN at first. It writes D_hat
        before the prediction of the step. None for a law that gives a rate. Where samples of X arrive, it gets them
        at the step k at which they were taken, NaN in the loops without one. Where `of_state` estimates X from outputs,
        it gets samples of these instead, and how many steps after k they were taken.
        """
        return None

    def ends(self, dt: float) -> tuple[float, float]:
        """The estimates from which on outwards D_hat is at its bound."""
        return self.bounds


def by_name(name: Adaptation | str) -> DelayLaw | None:
    """The law of a name, or of a file, with its defaults; None for "frozen". Raises ConfigError for any other."""
    if fault := DELAY_LAWS.fault(name, FROZEN):
        raise ConfigError(f"adaptation: {fault}")
    return None if name == FROZEN else DELAY_LAWS.subclass("adaptation", name, DelayLaw)()


def delay(plant: Plant, D: Any, D_hat: Any = 0.0) -> float:
    """The delay that a law is made for: the longest, else the longest estimate, else the usual time constant."""
    return float(np.max(D, initial=0.0)) or float(np.max(D_hat, initial=0.0)) or 1 / rates(plant).usual


class Part(NamedTuple):
    """The laws as the time loop runs them: U, then phi and N on lanes, and D_hat += gamma phi dt within the bounds."""

    control: Kernel | None
    bounds: np.ndarray
    update: Kernel | None = None
    gamma: float = 0.0
    b: float = 1.0
    compiled: bool = True
    observe: Kernel | None = None
    settings: np.ndarray = np.zeros(0)
    memory: int = 1


def part(plant: Plant, law: DelayLaw | None, dt: float, of_state: Observer | None = None) -> Part:
    """The laws' part of a control step of dt, of a controller with an observer of the state; None freezes D_hat."""
    control = control_law(plant)
    if law is None:
        return Part(control, np.array((0.0, np.inf)))
    bounds = np.array(law.bounds, dtype=float)
    if observer := law.observer(plant, dt, of_state):
        observe, settings, memory = observer
        return Part(control, bounds, observe=observe, settings=settings, memory=memory)
    kernel = law.kernel(plant)
    if kernel is None:
        return Part(control, bounds, _interpreted(law, plant), 1.0, law.b, compiled=False)
    return Part(control, bounds, kernel, law.gamma, law.b)


@cache
def control_law(plant: Plant) -> Kernel:
    """U_j = kappa_j(P(r_j)) with r_j = 1 for one delay [DAPF, eq. 9]; between nodes P(r_j) is a step of RK4."""
    return problem_of(plant).control(RK4.step)


def _interpreted(law: DelayLaw, plant: Plant) -> Kernel:
    """The law on the loop's memory: phi = rate, N unknown. It raises ConfigError, with the line of the law's file,
    where the law fails or returns anything but D_hat' (B,), or one for all.
    """
    location = f"adaptation {type(law).__name__}: rate ({source_lines.line(law.rate)})"

    def step(P: Any, X: Any, u: Any, D_hat: Any, t: float, p: Any, b: float, phi: Any, N: Any) -> None:
        try:
            X, u, P, rows = problem.rows(X, u, P, D_hat)
            returned = law.rate(plant, X, u, P, rows, t)
            rates = np.asarray(returned, dtype=float)
        except ConfigError:
            raise
        except Exception as error:
            reason = f"failed{source_lines.where(error, law.rate)}: {source_lines.one_line(error)}"
            raise ConfigError(f"{location} {reason}; let it return D_hat' (B,)") from None
        if returned is None or not array_checks.fits(rates.shape, D_hat.shape):
            came = None if returned is None else rates.shape
            raise ConfigError(f"{location} expected to return {D_hat.shape}, one per loop, got {came}; return that")
        phi[:] = rates

    return step
