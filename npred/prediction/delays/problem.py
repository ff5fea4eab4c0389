"""The interface of a delay model to the predictors and the loop: five kernels for the prediction problem of one plant.

The problem is dP/dx = D_hat f(P, u(x), t + x D_hat), P(0) = X on x in [0, 1] [DAPF, eq. 10], and U = kappa(P) at its
end. Arrays have their lanes innermost, so that B loops share each instruction.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from typing import ClassVar

import numpy as np

from npred.base.errors import ConfigError
from npred.formulas import Array, Value
from npred.kernels import kernel
from npred.kernels.formula import Formulas
from npred.plants.base import Plant

Kernel = Callable[..., None]  # npred.kernels.kernel.Kernel, or for a black box the same in Python
Step = Callable[..., Array]  # the formula of a one-step method: npred.prediction.methods.base

# The arguments of the kernels, in order; & marks those that are written.
PREDICT = "X, u, D_hat, t, p, &P"
CONTROL = "P, u, D_hat, t, p, &U"
UPDATE = "P, X, u, D_hat, t, p, b, &phi, &N"  # u at the nodes
ADVANCE = "&X, U0, U1, share, dt, t, p"  # in place: the delayed input U0 for the first `share` of a step, then U1
HORIZON = "X, t, p, ratios, &D_hat, &D"  # the delay of each input, and the longest as D_hat where the plant declares it
SPEED = "X, U, t, p, &speed"  # speed of phi(t) = t - D with U acting, 1 - D_X f - D_t
CORRECT = "P_hat, X, u, D_hat, t, p, &P"  # P_hat less its error, as far as its defect says
GUARD = "X, u, D_hat, t, p, guard, &P, &error, &fallback"  # P in place; guard: what npred.guard.guarded is set to
# Laws that estimate D_hat themselves, and write it: X are the samples of step k and time t, NaN where there is none.
OBSERVE = "k, dt, X, held, t, p, law, &memory, &D_hat"
# An observer of the state, with one lane: its memory, which begins with the state and the offsets of the inputs,
# goes on by dt as ADVANCE does, and learns from a sample Y of the outputs that is taken at t, NaN where one is missing.
FOLLOW = "U0, U1, share, dt, t, p, law, &memory"
CORRECT_BY = "Y, t, p, gate, law, &memory, &innovation, &spread"
OUTPUT = "X, t, p, &Y"  # the outputs that an observer of the state gets, one lane
ESTIMATE = "k, origin, dt, D_seen, held, &Y, &X_hat"  # observers of the state in Python: X_hat in place, and Y
# U, changed where the loop that follows, from the states predicted for the moments when U acts, would break a limit
PROTECT = "ends, moments, p, safety, low, high, &U, &plan, &kept, &filtered, &unkept, &promised, &withdrawn"
CURES = {  # the cure for each part that does not serve a plant
    "picard": "use rk4",
    "semi_implicit": "use rosenbrock",
    "rollout": "use rk4",
    "adaptation": 'freeze the estimate, in a pipeline by adaptation = "frozen"',
    "observer": "freeze the estimate",
    "bound": "take error, an estimate",
    "onnx": "use the runtime torch or fused",
    "export c": "use npred.controller",
    "export controller": "use npred.controller",
}
BOUNDED = ("picard", "semi_implicit", "rollout", "adaptation", "observer", "bound")  # where states stop


def build(name: str, arguments: str, body: str) -> kernel.Kernel:
    """The kernel of a body in C99, for laws of yours: arrays have their lanes innermost, d.lanes of them."""
    head = kernel.prototype("KERNEL", arguments)
    return kernel.made(name, arguments, f"static inline {head}\n{{\n    (void)d, (void)work;\n{body}}}\n", {})


def compiled(
    name: str, arguments: str, file: str, of: Formulas, functions: Mapping[str, str], before: Sequence[str] = (),
    **sizes: object,
) -> kernel.Kernel:  # fmt: skip
    """The kernel of a skeleton, which knows the plant's sizes N and M, and of formulas with the functions they call."""
    sizes = {"N": of.plant.n, "M": of.plant.m, "CALLS": int(bool(of.called()))} | sizes
    return kernel.made(name, arguments, kernel.skeleton(file), functions, sizes, before=[*of.called(), *before])


def rows(*lanes: np.ndarray) -> list[np.ndarray]:
    """The loop's memory as functions on batches see it, the axis of its lanes first: views that cannot be written."""
    views = [np.moveaxis(array, -1, 0) for array in lanes]
    for view in views:
        view.flags.writeable = False
    return views


def by_time(
    run: Kernel, inputs: Sequence[np.ndarray], t: np.ndarray, parameters: Sequence[np.ndarray],
    written: Sequence[np.ndarray],
) -> None:  # fmt: skip
    """Call a kernel on batches (B, ...), once for each of the times t (B,), for a call has one; `written` in place."""
    for moment in np.unique(t):
        rows = np.flatnonzero(t == moment)
        lanes = [np.array(np.moveaxis(a[rows], 0, -1), order="C") for a in (*inputs, *written)]
        results = lanes[len(inputs) :]
        run(*lanes[: len(inputs)], float(moment), *parameters, *results)
        for array, lane in zip(written, results, strict=True):
            array[rows] = np.moveaxis(lane, -1, 0)


class PredictionProblem(ABC):
    """The kernels of one plant. A problem refuses by ConfigError, with a cure, the kernels that it lacks.

    `lacks` names the methods, laws, runtimes and formats that do not serve the problem, `cures` what to use instead.
    """

    lacks: ClassVar[Sequence[str]] = ()
    cures: ClassVar[Mapping[str, str]] = CURES
    reads_cells: ClassVar[bool] = False

    def __init__(self, plant: Plant) -> None:
        self.plant = plant

    def expected(self) -> str:
        """The need of all that `lacks` names, and the plant's delay."""
        return ""

    def refusal(self, part: str) -> tuple[str, str] | None:
        """The reason that a method, delay law, runtime or format does not serve the plant, and the cure; else None."""
        if part in self.lacks:
            return self.expected(), self.cures[part]
        if part in BOUNDED and self.plant.state_bounds:
            return f"expected a plant without state_bounds, plant {self.plant.name} has some", CURES[part]
        if part == "semi_implicit" and not self.plant.declares_mechanics:
            reason = f"expected a plant that declares mechanics(x, u, t, p, M), plant {self.plant.name} declares none"
            return reason, "use rosenbrock"
        if part == "rollout" and (self.plant.traced or not self.plant.declares_rollout):
            reason = f"expected traced = False and rollout(X, u, D_hat, t, p), plant {self.plant.name} declares no such"
            return reason, "use rk4"
        return None

    def needs(self, part: str) -> None:
        """Raise ConfigError where the part does not serve the plant."""
        if refusal := self.refusal(part):
            raise ConfigError(f"{part}: {'; '.join(refusal)}")

    @staticmethod
    @abstractmethod
    def serves(plant: Plant) -> bool:
        """True if the problem is that of the plant."""

    @abstractmethod
    def sweep(self, step: Step, cells: bool = False, more: int = 0) -> Kernel:
        """PREDICT by a one-step method over the nodes; with `cells`, where `reads_cells`, u (2 (nx - 1), m, B) has the
        begin and the end of each cell, between which it is a straight line. `more` inputs than the plant's are read by
        the step alone.
        """

    def paired(self, step: Step, cells: bool = False) -> Kernel:
        """PREDICT by two chains of steps over the same nodes, twice the second chain less the first; see `sweep`."""
        self.needs("semi_implicit")
        raise NotImplementedError

    def picard(self, tolerance: float, sweeps: int) -> Kernel:
        """PREDICT by successive approximations."""
        self.needs("picard")
        raise NotImplementedError

    @abstractmethod
    def control(self, step: Step) -> Kernel:
        """CONTROL, U = kappa(P(1)) [DAPF, eq. 9]; `step` predicts between nodes where a delay ends there."""

    def update(self) -> Kernel:
        """UPDATE, the paper's law for D_hat: phi [DAPF, eq. 12] and N = 1 + V + b ∫ (1+x) w²."""
        self.needs("adaptation")
        raise NotImplementedError

    def correction(self) -> Kernel:
        """CORRECT, P_hat less its defect carried along by the linearised equation."""
        self.needs("bound")
        raise NotImplementedError

    def horizon(self) -> Kernel | None:
        """HORIZON of a plant that declares its delay, else None."""
        return None

    def speed(self) -> Kernel | None:
        """SPEED of a plant that declares its delay, else None."""
        return None

    @abstractmethod
    def advance(self, step: Step) -> Kernel:
        """ADVANCE, a step of the plant with held inputs, split where a switch of a delayed input falls inside it."""


def transition(df: Step, x: Array, u: Array, t: Value, h: Value, r: Array, s: Array) -> tuple[Array, Array]:
    """One step of dr/dx = D_hat (f_P r + f_t) by Heun's method: r at this node, and s = h (f_P r + f_t) for the next.

    x, u are of this node; r, s of the one before; h = D_hat / (nx - 1); df(x, u, t, r) is f_P r + f_t.
    """
    new = r + (s + h * df(x, u, t, r + s)) / 2
    return new, h * df(x, u, t, new)
