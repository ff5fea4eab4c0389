"""The delay that npred.DelayObserver finds, and whether its spread tells the error.

    python benchmarks/estimated_delay.py [outputs] [spread] [held_out] [--seeds 5] [--first 0]

`outputs`: seven plants with an unmeasured state, an offset that is estimated and noise of .4 % of the outputs' ranges;
set-points in four steps, and a load after 40 % of the time. A loop settles that ends within 5 % of half the range of
its output. `spread`: the twelve classes of loops of benchmarks/unmeasured.py, in the middle of their transient and at
their end. `held_out`: the same for plants, starts and seeds which no constant of the law was chosen by.
A true error counts as covered within twice the spread; a spread as wide above a quarter of the range of the bounds.
"""

import argparse
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import unmeasured

import npred
from npred.lab.report.terminal.console import columns

NOISE, LOAD_AT, STEPS_AT, SETTLED = 0.004, 0.4, np.array([0.03, 0.27, 0.5, 0.73]), 0.05
WIDE = 0.25  # of the range of the bounds


class Neutral:
    """The pH of a tank; base comes through a long line."""

    states, inputs, outputs, parameters = ("w", "e"), ("q",), ("pH",), {"aim": 7.0}
    box, guess, input_bounds, time_unit = {"w": (-1.0, 1.0), "e": (4.5, 9.5)}, (0.0, 7.0), ((0.0, 2.0),), "min"

    def f(x: Any, u: Any, t: Any, p: Any, M: Any) -> Any:
        r = x.w / 0.3
        pH = 7 + 2 * M.log(r + M.sqrt(r * r + 1)) / 2.302585
        return [(200 * u.q - 160 - (20 + u.q) * x.w) / 60, (pH - x.e) / 0.15]

    def output(x: Any, t: Any, p: Any, M: Any) -> Any:
        return [x.e]

    def setpoint(x: Any, t: Any, p: Any, M: Any) -> Any:
        return [x.e - p.aim]


class Heated:
    """A heated tank; its sensor lags."""

    states, inputs, outputs, parameters = ("T", "s"), ("P",), ("T_s",), {"aim": 50.0}
    box, guess, input_bounds, time_unit = {"T": (20.0, 80.0), "s": (20.0, 80.0)}, (50.0, 50.0), ((0.0, 100.0),), "min"

    def f(x: Any, u: Any, t: Any, p: Any, M: Any) -> Any:
        return [(20.0 - x.T) / 10.0 + 0.12 * u.P, (x.T - x.s) / 1.5]

    def output(x: Any, t: Any, p: Any, M: Any) -> Any:
        return [x.s]

    def setpoint(x: Any, t: Any, p: Any, M: Any) -> Any:
        return [x.s - p.aim]


class Servo:
    """A servo whose angle is measured; its speed is not, and a load acts."""

    states, inputs, outputs, parameters = ("a", "w"), ("U",), ("angle",), {"aim": 0.0}
    box, guess, input_bounds = {"a": (-2.0, 2.0), "w": (-4.0, 4.0)}, (0.0, 0.0), ((-8.0, 8.0),)

    def f(x: Any, u: Any, t: Any, p: Any, M: Any) -> Any:
        return [x.w, -3.0 * x.w - 0.5 * M.tanh(5 * x.w) + 4.0 * u.U]

    def output(x: Any, t: Any, p: Any, M: Any) -> Any:
        return [x.a]

    def setpoint(x: Any, t: Any, p: Any, M: Any) -> Any:
        return [x.a - p.aim]


class Culture:
    """A chemostat by Monod's law, fed at the rate q; its biomass is not measured."""

    states, inputs, outputs, parameters = ("b", "s"), ("q",), ("s",), {"aim": 1.0}
    box, guess, input_bounds, time_unit = {"b": (1.0, 4.5), "s": (0.2, 3.0)}, (2.2, 1.0), ((0.02, 0.5),), "h"

    def f(x: Any, u: Any, t: Any, p: Any, M: Any) -> Any:
        growth = 0.5 * x.s / (1.0 + x.s)
        return [(growth - u.q) * x.b, u.q * (6.0 - x.s) - growth * x.b / 0.5]

    def output(x: Any, t: Any, p: Any, M: Any) -> Any:
        return [x.s]

    def setpoint(x: Any, t: Any, p: Any, M: Any) -> Any:
        return [x.s - p.aim]


class Tanks:
    """Two tanks, one above the other; the level of the lower one is measured."""

    states, inputs, outputs, parameters = ("h", "g"), ("q",), ("level",), {"aim": 10.0}
    box, guess, input_bounds = {"h": (2.0, 25.0), "g": (2.0, 25.0)}, (10.0, 10.0), ((0.0, 30.0),)

    def f(x: Any, u: Any, t: Any, p: Any, M: Any) -> Any:
        above, below = (M.sqrt(M.maximum(level, 0.01)) for level in (x.h, x.g))
        return [(u.q - 4.0 * above) / 20.0, (above - below) / 5.0]

    def output(x: Any, t: Any, p: Any, M: Any) -> Any:
        return [x.g]

    def setpoint(x: Any, t: Any, p: Any, M: Any) -> Any:
        return [x.g - p.aim]


class Pendulum:
    """An upright pendulum whose angle is measured."""

    states, inputs, outputs, parameters = ("a", "w"), ("U",), ("angle",), {"aim": 0.0}
    box, guess, input_bounds = {"a": (-0.8, 0.8), "w": (-2.0, 2.0)}, (0.0, 0.0), ((-4.0, 4.0),)

    def f(x: Any, u: Any, t: Any, p: Any, M: Any) -> Any:
        return [x.w, 2.0 * M.sin(x.a) - 0.3 * x.w + u.U]

    def output(x: Any, t: Any, p: Any, M: Any) -> Any:
        return [x.a]

    def setpoint(x: Any, t: Any, p: Any, M: Any) -> Any:
        return [x.a - p.aim]


class Motor:
    """A DC motor whose speed is measured; its current is not."""

    states, inputs, outputs, parameters = ("w", "i"), ("U",), ("speed",), {"aim": 50.0}
    box, guess, input_bounds = {"w": (0.0, 100.0), "i": (-5.0, 15.0)}, (50.0, 2.0), ((-24.0, 24.0),)

    def f(x: Any, u: Any, t: Any, p: Any, M: Any) -> Any:
        return [(0.1 * x.i - 0.004 * x.w) / 0.005, (u.U - 1.0 * x.i - 0.1 * x.w) / 0.05]

    def output(x: Any, t: Any, p: Any, M: Any) -> Any:
        return [x.w]

    def setpoint(x: Any, t: Any, p: Any, M: Any) -> Any:
        return [x.w - p.aim]


# D, bounds, D_hat(0), dt, length, set-points, load
CASES: dict[type, tuple[float, tuple[float, float], tuple[float, ...], float, float, list[float], float]] = {
    Neutral: (0.5, (0.2, 1.0), (0.3, 0.65, 0.8), 0.01, 30.0, [8.0, 6.0, 7.5, 6.5], 0.0),
    Heated: (2.0, (0.5, 5.0), (0.8, 2.5, 4.0), 0.05, 120.0, [60.0, 40.0, 55.0, 45.0], 5.0),
    Servo: (0.2, (0.05, 0.6), (0.08, 0.25, 0.5), 0.005, 20.0, [1.0, -0.5, 0.5, 0.0], 0.2),
    Culture: (1.0, (0.2, 3.0), (0.4, 1.3, 2.4), 0.02, 60.0, [1.5, 0.7, 1.3, 0.9], 0.02),
    Tanks: (4.0, (1.0, 12.0), (1.5, 5.0, 10.0), 0.1, 600.0, [13.0, 8.0, 12.0, 9.0], 1.0),
    Pendulum: (0.2, (0.05, 0.5), (0.08, 0.25, 0.4), 0.005, 20.0, [0.2, -0.1, 0.1, 0.0], 0.05),
    Motor: (0.1, (0.02, 0.3), (0.04, 0.13, 0.25), 0.002, 6.0, [65.0, 35.0, 60.0, 50.0], 0.5),
}


def loop(kind: type, D_hat: float, seed: int) -> tuple[Any, float]:
    """A loop, and how far its output is from the last set-point at most, in half ranges, over its last tenth."""
    D, bounds, _, dt, t_end, aims, load = CASES[kind]
    plant = npred.plant(kind, kappa="lqr")
    observer = npred.observers.EKF(plant, offset=True)
    size = float(observer.sizes.dy[0])
    run = npred.simulate(
        plant, npred.predictor(plant, "heun", nx=51), D=D, D_hat=D_hat, X0=plant.equilibrium, t_end=t_end, dt=dt,
        actuator="history", u0="equilibrium", adaptation=npred.DelayObserver(bounds=bounds), observer=observer,
        setpoints={"aim": ((STEPS_AT * t_end).tolist(), aims)}, progress=False,
        measurement=npred.Measurement(noise=NOISE * 2 * size, seed=seed),
        disturbance=lambda t: [load if t > LOAD_AT * t_end else 0.0],
    )  # fmt: skip
    last = observer.measured(run.X[-(len(run.t) // 10) :])[:, 0]
    return run, float(np.abs(last - aims[-1]).max()) / size


def outputs_table(asked: argparse.Namespace) -> str:
    """The loops of each plant from a low, a near and a high first estimate."""
    rows, seeds = [], range(asked.first, asked.first + asked.seeds)
    for kind, (D, bounds, starts, *_) in CASES.items():
        runs = [loop(kind, D_hat, seed) for D_hat in starts for seed in seeds]
        errors = np.array([abs(run.D_hat[-1] - D) for run, _ in runs]) / D
        spreads = np.array([run.D_hat_spread for run, _ in runs]) / D
        counts = sum(off < SETTLED for _, off in runs), (errors <= 2 * spreads).sum()
        numbers = np.median(errors), errors.max(), np.median(spreads)
        wide = (spreads * D > WIDE * (bounds[1] - bounds[0])).sum()
        rows.append([kind.__name__, f"{len(runs)}", *map(str, counts), *(f"{v:.3f}" for v in numbers), f"{wide}"])
    header = ["loops", "settle", "covered", "median error, D", "largest", "median spread, D", "wide"]
    return columns(["unmeasured state, offset", *header], rows)


def spread_row(label: str, run: Any, D: Any, bounds: tuple[float, float]) -> list[str]:
    """A row about the ends of some loops."""
    error, spread = np.abs(run.D_hat[..., -1] - D).ravel(), run.D_hat_spread.ravel()
    wide = (spread > WIDE * (bounds[1] - bounds[0])).sum()
    covered = f"{(error <= 2 * spread).sum()} of {error.size}"
    numbers = f"{np.median(error):.4f}", f"{error.max():.4f}", f"{np.median(spread):.3f}"
    return [label, f"{run.t[-1]:g}", covered, *numbers, f"{wide}"]


HEADER = ["after, s", "covered", "median error", "largest", "median spread", "wide"]


def spread_table(_: argparse.Namespace, seed: int = 0, X0: Any = (0.03, 30.0)) -> str:
    """The paper's plant in the twelve realities."""
    rows = []
    for label, reality in unmeasured.REALITIES.items():
        for t_end in (7.0, reality.get("t_end", 60.0)):
            parts: dict[str, Any] = {"D": unmeasured.DELAYS} | reality | {"t_end": t_end, "every": 20}
            if "measurement" in parts:
                parts["measurement"] = replace(parts["measurement"], seed=seed)
            D = parts.pop("D")
            true = D(t_end) if callable(D) else np.array(D)[:, None]
            run = unmeasured.simulated(
                unmeasured.PLANT, "observers, own commands", D, unmeasured.STARTS, list(X0), u0="equilibrium", **parts
            )
            rows.append(spread_row(label, run, true, unmeasured.BOUNDS))
    return columns(["paper's plant", *HEADER], rows)


def held_out_table(asked: argparse.Namespace) -> str:
    """The same from another start and with other noise; other plants with 1 % noise; one that always moves."""
    rows = []
    for name, (D, D_hat, bounds, gamma, X0) in unmeasured.PLANTS.items():
        for t_end in (7.0, 60.0):
            run = unmeasured.simulated(
                npred.plant(name), "observers, own commands", D, D_hat, X0, gamma=gamma, bounds=bounds, t_end=t_end,
                every=20, measurement=npred.Measurement(relative_noise=0.01, seed=11),
            )  # fmt: skip
            rows.append(spread_row(f"{name}, 1 % noise", run, np.array(D)[:, None], bounds))
    follower = npred.plants.Plant("follower", unmeasured.Follower)
    for label, reality in unmeasured.TRACKING.items():
        parts = {"X0": [0.1]} | reality | {"t_end": 60.0, "every": 20}
        D = parts.pop("D")
        run = unmeasured.simulated(follower, "observers, own commands", D, unmeasured.STARTS, u0=[0.0], **parts)
        rows.append(spread_row(f"follower, {label}", run, D(60.0), unmeasured.BOUNDS))
    return spread_table(asked, 11, (0.02, 20.0)) + "\n\n" + columns(["other plants", *HEADER], rows)


TABLES: dict[str, Callable[[argparse.Namespace], str]] = {
    "outputs": outputs_table, "spread": spread_table, "held_out": held_out_table,
}  # fmt: skip

if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("tables", nargs="*", choices=[*TABLES, []], default=[])
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--first", type=int, default=0)
    given = parser.parse_args()
    for name in given.tables or TABLES:
        print(TABLES[name](given) + "\n", flush=True)
