"""The question whether a PI controller would do: it and a Smith predictor are tuned on the plant, and compared.

PI: U = U* + k (e + ∫ e dt / T_i), e = Y* - Y, held over dt; the integral waits while U is at a bound and e would take
it farther. Smith predictor [Smith 1957]: the same with e - (y(t) - y(t - D)), y the output of the plant linearised at
rest.
All three get the same step of the load or of the set-point, from rest, with a true delay of 0.9, 1 and 1.1 times the
one that is known. The score is IAE = ∫ |e| dt, the worst of the three delays: gains that are good only where the delay
is exact do not win. The gains of the rivals are the best of a grid that is refined three times. The predictor has the
plant's own kappa, and of three speeds of the estimated offset the best.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from npred.base.errors import ConfigError
from npred.base.matrices import exponential
from npred.diagnosis import disturbance, loops
from npred.diagnosis.case import Case, Verdict
from npred.estimation.observers import EKF
from npred.formulas import array_math
from npred.loop.timing import ROUNDING
from npred.plants import speed
from npred.plants.base import Plant

OFF = np.array([0.9, 1.0, 1.1])  # true delays, times the one that is known
LASTS = 10.0  # times D and the usual time constant of the loop
STEPS = (400, 5)  # control steps in a loop, about, and in a delay at least
GAINS = np.geomspace(0.05, 10.0, 8)  # k times the plant's gain where the loop works
TIMES = np.geomspace(0.1, 20.0, 6)  # T_i over D and the usual time constant
FINER = (2.0, 1.35, 1.12)  # the factors by which the best gains are varied
KEPT = 0.3  # of the largest |e|: a loop that ends farther off is not kept
FASTER = (1.0, 10.0, 100.0)  # times the default spectral density of the offset
WAYS = 5  # of each of the two, in a refinement
WORSE = 1.02  # times the rival's IAE: the predictor is no better


@dataclass(frozen=True)
class StepTask:
    """Steps of the load and of the set-point `aim` at a plant with one input, from rest, and the lengths of time.

    `error` is e (…,) of X (…, n) before the step of the set-point. That step is for benchmarks/pi.py; `compared` makes
    one of the load.
    """

    plant: Plant
    error: Callable[[np.ndarray], np.ndarray]
    D: float
    push: float
    dt: float
    t_end: float
    limits: np.ndarray
    step: float = 0.0
    aim: str = ""

    @property
    def size(self) -> float:
        """The time in which the loop works."""
        return self.D + 1 / speed.rates(self.plant).usual

    def linear(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """A, B and C of the error at rest, e falls with y: C is that of y."""
        plant, rest = self.plant, self.plant.equilibrium
        A, B = plant.jacobians(rest, plant.u_equilibrium)
        h = 1e-6 * np.maximum(np.ptp(plant.ranges(half=0.5), axis=1), 1e-9)
        ends = rest + np.concatenate([np.diag(h), -np.diag(h)])
        e = self.error(ends)
        return A, B[:, 0], (e[plant.n :] - e[: plant.n]) / (2 * h)


@dataclass(frozen=True)
class RivalGains:
    """The best gains of a rival, and its IAE; infinite where none keeps the loop."""

    k: float
    T_i: float
    iae: float


def iae(task: StepTask, k: np.ndarray, T_i: np.ndarray, smith: bool, D: np.ndarray) -> np.ndarray:
    """The score of loops (L,) with those gains and true delays."""
    plant, dt, count = task.plant, task.dt, len(k)
    model_late, steps = round(task.D / dt), round(task.t_end / dt)
    late = np.floor(D / dt + ROUNDING).astype(int)
    share = np.maximum(D / dt - late, 0.0)  # of a control step in which the command before still acts
    A, B, C = task.linear()
    n = len(A)
    ahead = exponential(dt * np.block([[A, B[:, None]], [np.zeros((1, n + 1))]]))[:n]
    X, x = np.tile(plant.equilibrium, (count, 1)), np.zeros((count, n))
    rest, (low, high) = float(plant.u_equilibrium[0]), task.limits[0]
    commands, y = np.full((late.max() + 2, count), rest), np.zeros((model_late + 1, count))
    integral, lanes, errors = np.zeros(count), np.arange(count), np.empty((steps, count))
    with np.errstate(all="ignore"):
        for i in range(steps):
            e = task.error(X) + task.step
            errors[i] = e
            if smith:
                y[i % len(y)] = x @ C
                e = e - (y[i % len(y)] - y[(i - model_late) % len(y)])
            free = rest + k * (e + integral / T_i)
            U = np.clip(free, low, high)
            integral += np.where((free == U) | (k * e * (free - U) < 0), e * dt, 0.0)
            commands[i % len(commands)] = U
            new, old = (commands[(i - each) % len(commands), lanes] for each in (late, late + 1))
            acting = (new + share * (old - new))[:, None] + task.push
            f1 = plant.f(X, acting, 0.0)
            f2 = plant.f(X + dt / 2 * f1, acting, 0.0)
            f3 = plant.f(X + dt / 2 * f2, acting, 0.0)
            X = X + dt / 6 * (f1 + 2 * f2 + 2 * f3 + plant.f(X + dt * f3, acting, 0.0))
            x = x @ ahead[:, :n].T + (U - rest)[:, None] * ahead[:, n]
    return score(errors, dt)


def score(errors: np.ndarray, dt: float) -> np.ndarray:
    """∫ |e| dt of e (steps, L), (L,); infinite where the last tenth is still above KEPT times the largest |e|."""
    with np.errstate(all="ignore"):
        size = np.abs(errors)
        kept = size[-len(size) // 10 :].max(axis=0) <= KEPT * size.max(axis=0)
        return np.where(kept, size.sum(axis=0) * dt, np.inf)


def tuned(task: StepTask, smith: bool) -> RivalGains:
    """The gains with the least IAE, the worst of the delays of OFF, over a grid and its refinements."""
    A, B, C = task.linear()
    s = 1j / task.size
    gain = C @ np.linalg.solve(s * np.eye(len(A)) - A, B.astype(complex))
    unit = float(1 / max(abs(gain), 1e-300))
    ks = unit * np.concatenate([GAINS, -GAINS])
    k, T_i = (each.ravel() for each in np.meshgrid(ks, task.size * TIMES))
    best = RivalGains(unit, task.size, np.inf)
    for finer in (*FINER, None):
        lanes = [np.tile(each, len(OFF)) for each in (k, T_i)]
        scores = iae(task, *lanes, smith, np.repeat(OFF * task.D, len(k))).reshape(len(OFF), -1).max(axis=0)
        i = int(np.argmin(scores))
        if scores[i] < best.iae:
            best = RivalGains(float(k[i]), float(T_i[i]), float(scores[i]))
        if finer is None or not np.isfinite(best.iae):
            return best
        ways = finer ** np.linspace(-1, 1, WAYS)
        k, T_i = (each.ravel() for each in np.meshgrid(best.k * ways, best.T_i * ways))
    return best


def predicted(task: StepTask, case: Case) -> tuple[float, float]:
    """The least IAE of the predictor with the plant's kappa, the worst of the delays of OFF; the `offset` of its EKF.

    That spectral density is the default of `offset=True`, or FASTER times it.
    """
    plant, tries = task.plant, []
    usual = EKF(plant, offset=True).Q[-1, -1]
    parts: dict[str, Any] = {"disturbance": lambda t: [task.push]} if task.push else {}
    if task.step:
        parts["setpoints"] = {task.aim: ([0.0], [plant.parameters[task.aim] + task.step])}
    for faster in FASTER:
        run = loops.run(
            case, task.D, plant.equilibrium[None], task.t_end, task.dt, D=OFF * task.D, u0="equilibrium",
            observer=EKF(plant, offset=faster * usual), **parts,
        )  # fmt: skip
        worst = score(task.error(run.X[:, :-1]).T + task.step, task.dt).max()
        tries.append((float(worst), float(faster * usual)))
    return min(tries)


def applies(case: Case) -> bool:
    """True for a plant with one input, and one output or set-point, whose loops with a disturbance were looked at."""
    plant = case.plant
    if plant.m > 1 or plant.declares_delay or case.verdict("disturbance") is None:
        return False
    return plant.declares_setpoint or len(plant.output(plant.guess)) == 1


def compared(case: Case) -> Verdict:
    """The IAE of the predictor, of a PI and of a Smith predictor, both tuned."""
    task, plant = task_of(case), case.plant
    if task is None:
        return "yes", "not compared: the delay is too short beside the loop's time, or the input has no range"
    try:
        ours, offset = predicted(task, case)
    except ConfigError:  # no observer serves it
        return "yes", "not compared: no observer with offset=True serves this plant"
    PI, smith = tuned(task, False), tuned(task, True)
    names, rivals = ("disturbance", "t_end", "predictor", "offset"), {"PI": PI, "Smith": smith}
    figures: dict[str, Any] = {**loops.numbers(names, np.array([task.push, task.t_end, ours, offset]))}
    figures |= {name: loops.numbers([*vars(one)], np.array([*vars(one).values()])) for name, one in rivals.items()}
    words = [
        f"{_iae(ours)} with the predictor and EKF(offset={offset:.2g})",
        f"{_iae(PI.iae)} with a PI tuned on this plant",
    ]
    said = f"{', '.join(words)} ({_iae(smith.iae)} with a tuned Smith predictor)"
    size = case.amount(plant.inputs[0], task.push)
    text = f"a constant disturbance of {size} at {plant.inputs[0]}, the delay 10 % shorter to 10 % longer: IAE {said}"
    if WORSE * ours > PI.iae:
        return "warn", f"{text}; the PI does as well or better: keep it, or change the gains of kappa", figures
    if not np.isfinite(ours):
        return "warn", f"{text}; the predictor does not keep the loop: change the gains of kappa", figures
    if WORSE * ours > smith.iae:
        return "yes", f"{text}; the Smith predictor does as well or better", figures
    return "yes", text, figures


def task_of(case: Case) -> StepTask | None:
    """The load step of the check; None where the input has no range, or the loop too many steps."""
    plant, D = case.plant, case.D
    sizes = disturbance.sizes(case)
    if not sizes[0] > 0:
        return None
    t_end = LASTS * (D + 1 / speed.rates(plant).usual)
    dt = max(loops.step(case), t_end / STEPS[0])
    steps = max(round(D / dt), 1)  # whole steps in the delay
    return (
        StepTask(plant, error_of(plant), D, float(sizes[0]), D / steps, t_end, case.limits)
        if steps >= STEPS[1]
        else None
    )


def error_of(plant: Plant) -> Callable[[np.ndarray], np.ndarray]:
    """e = Y* - Y of states (..., n), (...,): of the set-point, else of the only output."""
    if plant.declares_setpoint:
        p = plant.p.tolist()
        return lambda X: -plant.call("setpoint", [*np.moveaxis(X, -1, 0)], None, 0.0, p, array_math.of(X))[0]
    goal = plant.output(plant.equilibrium)[0]
    return lambda X: goal - plant.output(X)[..., 0]


def _iae(value: float) -> str:
    return f"{value:.3g}" if value < np.inf else "no end (not kept)"
