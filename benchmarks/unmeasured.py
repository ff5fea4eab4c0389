"""Delay laws where nobody measures the actuator: how many loops they keep, and how well they know the delay.

    python benchmarks/unmeasured.py [loops] [map] [plants] [reality] [rest] [cost]
        [outputs] [spread] [--seeds 5] [--first 0]

One thread; all tables, the default, take some minutes. A loop is kept that ends within 1 % of the size of its target
(over the last tenth), and in a real loop, where noise and disturbances remain, within a fifth of it. A jump of D is
found once all estimates stay within 0.05 s.

`outputs`: seven plants with an unmeasured state, an offset that is estimated and noise of .4 % of the outputs' ranges;
set-points in four steps, and a load after 40 % of the time. A loop settles that ends within 5 % of half the range of
its output. `spread`: the loops of `reality`, in the middle of their transient and at their end. A true error counts as
covered within twice the spread of the estimate; a spread as wide above a quarter of the range of the bounds.
"""

import itertools
import time
from typing import Any

import harness
import numpy as np
from plants import AIMED, Follower

import npred
from npred.lab.report.terminal.console import columns
from npred.loop import metrics

PLANT = npred.plant("activator_repressor")
DELAYS, STARTS = [0.83, 1.0, 1.234, 1.37, 1.5], [0.3, 0.5, 1.0, 1.5, 2.0, 3.5]  # s
BOUNDS, JUMP = (0.1, 4.0), 30.0  # s
NOISE, LOAD_AT, STEPS_AT, SETTLED = 0.004, 0.4, np.array([0.03, 0.27, 0.5, 0.73]), 0.05
WIDE = 0.25  # of the range of the bounds
LAWS = {
    "(12), u measured": (npred.DelayAdaptation, 1000.0, "measured"),
    "(12), own commands": (npred.DelayAdaptation, 1000.0, "history"),
    "L1, own commands": (npred.L1Adaptation, 1.0, "history"),
    "observers, own commands": (npred.DelayObserver, 1.0, "history"),
}
# Of other plants: D, D_hat(0), bounds (s), gamma of (12), X0.
PLANTS = {
    "chemostat": ([1.0, 1.4, 1.6, 1.9], [1.2, 1.8], (0.8, 2.2), 1.0, [2.0, 2.0]),
    "scalar": ([0.3, 0.7, 1.0, 1.3], [0.2, 0.5, 1.5], (0.1, 2.0), 1.0, [1.0]),
    "cart_pole": ([0.1, 0.15, 0.2, 0.25, 0.3], [0.05, 0.12, 0.2, 0.3, 0.4], (0.04, 0.5), 1.0, [0.1, 0.0, 0.1, 0.0]),
    "planar_arm2": ([0.2, 0.3, 0.4, 0.5], [0.15, 0.25, 0.35, 0.5, 0.6], (0.1, 0.6), 0.5, [0.6, 0.7, 0.0, 0.0]),
}
HILL = {name: value for name, value in PLANT.parameters.items() if name.startswith("K")}
NOISE_1 = {"measurement": npred.Measurement(relative_noise=0.01)}
NOISE_3 = {"measurement": npred.Measurement(relative_noise=0.03)}
SAMPLED = {"measurement": npred.Measurement(relative_noise=0.01, period=0.05)}


def drift(t: float) -> float:
    """1 s, and 0.3 s more and less over 60 s."""
    return 1.0 + 0.3 * np.sin(2 * np.pi * t / 60)


def jump(t: float) -> float:
    """1 s, 1.5 s from 30 s on."""
    return 1.0 if t < JUMP else 1.5


def wave(size: float) -> dict[str, Any]:
    """A disturbance of the input, size sin(.7 t)."""
    return {"disturbance": lambda t: [size * np.sin(0.7 * t)]}


def off(factor: float) -> dict[str, Any]:
    """The plant with other constants of Hill's functions than its model."""
    return {"truth": npred.plant("activator_repressor", **{name: factor * value for name, value in HILL.items()})}


REALITIES = {
    "nothing else": {},
    "3 % noise": NOISE_3,
    "1 % noise each 50 ms ± 15 ms": {"measurement": npred.Measurement(relative_noise=0.01, period=0.05, jitter=0.3)},
    "plant 3 % above its model": off(1.03),
    "plant 3 % below": off(0.97),
    "disturbance .002 sin(.7 t)": wave(0.002),
    "that disturbance, 300 s": {**wave(0.002), "t_end": 300.0},
    "that disturbance, 600 s": {**wave(0.002), "t_end": 600.0},
    "D ± .3 s over 60 s": {"D": drift},
    "D ± .3 s, 1 % noise each 50 ms": {"D": drift, **SAMPLED},
    "D jumps to 1.5 s": {"D": jump},
    "D jumps, 1 % noise each 50 ms": {"D": jump, **SAMPLED},
}
TRACKING = {
    "D jumps to 1.5 s": {"D": jump},
    "D jumps, 1 % noise": {"D": jump, **NOISE_1},
    "D jumps, 1 % noise each 50 ms": {"D": jump, **SAMPLED},
    "D jumps, 3 % noise": {"D": jump, **NOISE_3},
    "D jumps, disturbance .02 sin(.7 t)": {"D": jump, **wave(0.02)},
    "D ± .3 s over 60 s": {"D": drift, "t_end": 120.0},
    "D ± .3 s, 1 % noise": {"D": drift, "t_end": 120.0, **NOISE_1},
}


def kept(plant: npred.plants.Plant, loops: Any, share: float) -> np.ndarray:
    """The loops that end within that share of the size of the target."""
    target = plant.target(loops.t)
    return metrics.radius(loops, target) <= share * metrics.size(target)


def simulated(plant: npred.plants.Plant, law: str, D: Any, D_hat: Any, X0: Any, nx: int = 51, **settings: Any) -> Any:
    """Loops of a law, each D with each D_hat(0)."""
    kind, gamma, actuator = LAWS[law]
    gamma, bounds = settings.pop("gamma", gamma), settings.pop("bounds", BOUNDS)
    if not callable(D) and np.ndim(X0) == 1:
        D, D_hat = np.meshgrid(D, D_hat, indexing="ij")
    settings = {"t_end": 60.0, "dt": 0.005} | settings
    return npred.simulate(
        plant, npred.predictor(plant, "rk4", nx), D=D, D_hat=D_hat, X0=X0, adaptation=kind(gamma, 1.0, bounds),
        actuator=actuator, **settings,
    )  # fmt: skip


def loops_table() -> str:
    """The laws on the paper's plant, 30 loops."""
    rows = []
    for law in LAWS:
        run = simulated(PLANT, law, DELAYS, STARTS, [0.03, 30.0], nx=101)
        radius = metrics.radius(run, PLANT.target(run.t)).max()
        error = np.abs(run.D_hat[..., 2000:] - np.array(DELAYS)[:, None, None]).max()
        rows.append([law, f"{(~kept(PLANT, run, metrics.SETTLED)).sum()}", f"{radius:.1e}", f"{error:.4f}"])
    return columns(["paper's plant, 30 loops", "lost", "worst radius", "|D_hat - D| after 10 s"], rows)


def map_table() -> str:
    """The laws on the paper's plant, 13 delays by 9 first estimates, 100 s: a row of the map for each delay."""
    delays, starts = np.linspace(0.25, 3.25, 13), np.linspace(0.25, 3.75, 9)
    cells = {}
    for law in LAWS:
        run = simulated(PLANT, law, delays, starts, [0.03, 30.0], t_end=100.0, dt=0.01)
        cells[law] = kept(PLANT, run, metrics.SETTLED)
    rows = [[f"{D:.2f}", *(f"{cells[law][i].sum()}" for law in LAWS)] for i, D in enumerate(delays)]
    total = ["all 117", *(f"{cells[law].sum()}" for law in LAWS)]
    return columns(["kept of 9 D_hat(0), D", *LAWS], [*rows, total])


def plants_table() -> str:
    """(12) with u measured and the observers without, on other plants."""
    rows = []
    for name, (D, D_hat, bounds, gamma, X0) in PLANTS.items():
        plant, few = npred.plant(name), ["(12), u measured", "observers, own commands"]
        runs = [simulated(plant, law, D, D_hat, X0, gamma=gamma, bounds=bounds) for law in few]
        measured, observed = (kept(plant, run, metrics.SETTLED) for run in runs)
        error = np.abs(runs[1].D_hat[..., -1] - np.array(D)[:, None])[observed].max()
        counts = measured.size, (~measured).sum(), (~observed).sum(), (measured & ~observed).sum()
        rows.append([name, *(f"{count}" for count in counts), f"{error:.4f}"])
    lost = "lost by (12), u measured", "by observers", "by observers alone"
    return columns(["plant", "loops", *lost, "|D_hat - D| at the end"], rows)


def reality_table(title: str, plant: npred.plants.Plant, X0: Any, realities: dict[str, Any]) -> str:
    """The observers in real loops, 30 of each constant delay and first estimate, or 6 of a delay that changes."""
    rows = []
    for label, reality in realities.items():
        settings = {"D": DELAYS, "X0": X0} | reality
        delay, law = settings["D"], "observers, own commands"
        run = simulated(plant, law, D_hat=STARTS, u0="equilibrium" if plant.rests else [0.0], **settings)
        true = np.array([delay(t) for t in run.t]) if callable(delay) else np.array(DELAYS)[:, None, None]
        errors = np.abs(run.D_hat - true).reshape(-1, len(run.t)).max(axis=0)
        late, radius = run.t >= run.t[-1] - 10, metrics.radius(run, plant.target(run.t)).max()
        ends = f"{(~kept(plant, run, 0.2)).sum()}", f"{radius:.1e}", f"{errors[-1]:.4f}", f"{errors[late].max():.4f}"
        rows.append([label, *ends, _seconds(run.t, errors) if delay is jump else ""])
    names = ["lost", "worst radius", "|D_hat - D| at the end", "over the last 10 s", "found after, s"]
    return columns([title, *names], rows)


def _seconds(t: np.ndarray, errors: np.ndarray) -> str:
    """The seconds from the jump until all estimates stay within 0.05 s of D."""
    inside = t[np.flatnonzero(errors > 0.05)[-1] + 1 :]
    return f"{inside[0] - JUMP:.1f}" if len(inside) else "not"


def rest_table() -> str:
    """The observers where D jumps from 1 s at rest: the distance from rest, without and with a pulse at the input."""
    rows = []
    for to, pulse in itertools.product((0.3, 0.5, 1.5, 2.0, 2.5, 3.0), (0.0, 0.01)):
        run = simulated(
            PLANT, "observers, own commands", D=lambda t, to=to: to if t >= JUMP else 1.0, D_hat=2.0, X0=[0.03, 30.0],
            dt=0.01, t_end=150.0, disturbance=lambda t, pulse=pulse: [pulse if 60 <= t < 61 else 0.0],
        )  # fmt: skip
        distance = np.abs(run.X - PLANT.equilibrium).max(axis=-1)
        values = distance[run.t >= JUMP].max(), distance[run.t >= 140].max()
        rows.append([f"{to:g} s", f"{pulse:g}", *(f"{value:.1e}" for value in values), f"{run.D_hat[-1]:.4f} s"])
    return columns(["D from 30 s on", "pulse at 60 s", "farthest", "over the last 10 s", "D_hat at 150 s"], rows)


def cost_table() -> str:
    """A control step of the paper's plant with the observers and with D_hat frozen, side by side, one loop."""
    frozen, observers = None, npred.DelayObserver(bounds=BOUNDS)
    rk4, times = npred.predictor(PLANT, "rk4", 101), np.empty((15, 2))
    for row in times:
        for i, law in enumerate((frozen, observers)):
            start = time.process_time()
            run = npred.simulate(
                PLANT, rk4, D=1.0, D_hat=1.5, X0=[0.03, 30.0], t_end=20.0, adaptation=law, actuator="history"
            )  # fmt: skip
            row[i] = (time.process_time() - start) / len(run.t) * 1e6
    without, with_observers = np.median(times, axis=0)
    added = np.median(np.diff(times, axis=1))
    header = ["one loop, nx = 101", "D_hat frozen", f"{len(observers.thetas(0.005))} observers", "the observers' share"]
    return columns(header, [["µs a control step", *(f"{value:.1f}" for value in (without, with_observers, added))]])


def reality_tables() -> str:
    """Both plants in real loops."""
    follower = npred.plants.Plant("follower", Follower)
    return "\n\n".join([
        reality_table("paper's plant", PLANT, [0.03, 30.0], REALITIES),
        reality_table("a plant that tracks", follower, [0.1], TRACKING),
    ])  # fmt: skip


# D, bounds, D_hat(0), dt, length, set-points, load
LOADED: dict[str, tuple[float, tuple[float, float], tuple[float, ...], float, float, list[float], float]] = {
    "Neutral": (0.5, (0.2, 1.0), (0.3, 0.65, 0.8), 0.01, 30.0, [8.0, 6.0, 7.5, 6.5], 0.0),
    "Heated": (2.0, (0.5, 5.0), (0.8, 2.5, 4.0), 0.05, 120.0, [60.0, 40.0, 55.0, 45.0], 5.0),
    "Servo": (0.2, (0.05, 0.6), (0.08, 0.25, 0.5), 0.005, 20.0, [1.0, -0.5, 0.5, 0.0], 0.2),
    "Culture": (1.0, (0.2, 3.0), (0.4, 1.3, 2.4), 0.02, 60.0, [1.5, 0.7, 1.3, 0.9], 0.02),
    "Tanks": (4.0, (1.0, 12.0), (1.5, 5.0, 10.0), 0.1, 600.0, [13.0, 8.0, 12.0, 9.0], 1.0),
    "Pendulum": (0.2, (0.05, 0.5), (0.08, 0.25, 0.4), 0.005, 20.0, [0.2, -0.1, 0.1, 0.0], 0.05),
    "Motor": (0.1, (0.02, 0.3), (0.04, 0.13, 0.25), 0.002, 6.0, [65.0, 35.0, 60.0, 50.0], 0.5),
}


def loaded(name: str, D_hat: float, seed: int) -> tuple[Any, float]:
    """A loop, and how far its output is from the last set-point at most, in half ranges, over its last tenth."""
    D, bounds, _, dt, t_end, aims, load = LOADED[name]
    plant = npred.plant(AIMED[name], kappa="lqr")
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


def outputs_table(seeds: range) -> str:
    """The loops of each plant from a low, a near and a high first estimate."""
    rows = []
    for name, (D, bounds, starts, *_) in LOADED.items():
        runs = [loaded(name, D_hat, seed) for D_hat in starts for seed in seeds]
        errors = np.array([abs(run.D_hat[-1] - D) for run, _ in runs]) / D
        spreads = np.array([run.D_hat_spread for run, _ in runs]) / D
        counts = sum(off < SETTLED for _, off in runs), (errors <= 2 * spreads).sum()
        numbers = np.median(errors), errors.max(), np.median(spreads)
        wide = (spreads * D > WIDE * (bounds[1] - bounds[0])).sum()
        rows.append([name, f"{len(runs)}", *map(str, counts), *(f"{v:.3f}" for v in numbers), f"{wide}"])
    header = ["loops", "settle", "covered", "median error, D", "largest", "median spread, D", "wide"]
    return columns(["unmeasured state, offset", *header], rows)


def spread_table() -> str:
    """The paper's plant in the twelve realities."""
    rows = []
    for label, reality in REALITIES.items():
        for t_end in (7.0, reality.get("t_end", 60.0)):
            parts: dict[str, Any] = {"D": DELAYS} | reality | {"t_end": t_end, "every": 20}
            D = parts.pop("D")
            true = D(t_end) if callable(D) else np.array(D)[:, None]
            run = simulated(PLANT, "observers, own commands", D, STARTS, [0.03, 30.0], u0="equilibrium", **parts)
            error, spread = np.abs(run.D_hat[..., -1] - true).ravel(), run.D_hat_spread.ravel()
            wide, covered = (spread > WIDE * (BOUNDS[1] - BOUNDS[0])).sum(), (error <= 2 * spread).sum()
            numbers = f"{np.median(error):.4f}", f"{error.max():.4f}", f"{np.median(spread):.3f}"
            rows.append([label, f"{run.t[-1]:g}", f"{covered} of {error.size}", *numbers, f"{wide}"])
    header = ["after, s", "covered", "median error", "largest", "median spread", "wide"]
    return columns(["paper's plant", *header], rows)


TABLES = {
    "loops": loops_table, "map": map_table, "plants": plants_table, "reality": reality_tables, "rest": rest_table,
    "cost": cost_table, "outputs": outputs_table, "spread": spread_table,
}  # fmt: skip

if __name__ == "__main__":
    asked = harness.options(__doc__, {"tables": TABLES}, seeds=5, first=0)
    for name in asked.tables:
        print(TABLES[name](*[range(asked.first, asked.first + asked.seeds)] * (name == "outputs")) + "\n", flush=True)
