"""One wrong sample at a random moment of a loop that converges, or at rest: whether the controller comes back.

    python benchmarks/glitches.py [--plants van_der_pol …] [--observers none EKF Luenberger] [--kinds Python C FMU]

The sample is off by 0.3 to 12 half widths, of the box or of the output over it, in every component; it is the first,
or any other until the loop has been at rest as long as it took to settle. The loop has recovered if no later than the
delay after the loop without a wrong sample, or after the wrong sample at rest, it has settled: its distance from the
target, in half widths of the box, stays below BAND. `U at rest` is the largest |U| after a wrong sample at rest, beside
that of the loop without one. A step that is refused holds the last command. `--gate none` believes each sample.
`--noise 0.05` has no wrong sample, and counts those that the gate takes for wrong.
"""

import itertools
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import harness
import numpy as np
from harness import KINDS

import npred
from npred.base.errors import ConfigError, DivergedError
from npred.loop import engine
from npred.loop.actuator import actuate, history
from npred.loop.controller import Controller
from npred.plants.inputs import Past
from npred.prediction.methods import RK4

# dt, D where the plant has none, the length of a loop, all in the plant's time, and BAND
PLANTS = {
    "unicycle": (0.01, 0.6, 8.0, 0.35), "unicycle_time_delay": (0.01, 1.0, 8.0, 0.35),
    "strict_feedforward3": (0.01, 1.0, 18.0, 0.2), "transport_tank": (0.02, 2.0, 24.0, 0.2),
    "van_der_pol": (0.01, 0.5, 8.0, 0.2), "pvtol": (0.01, 0.5, 20.0, 0.2),
    "activator_repressor": (0.01, 1.0, 12.0, 0.2), "scalar": (0.01, 1.0, 20.0, 0.2),
    "chemostat": (0.01, 1.0, 20.0, 0.2), "cart_pole": (0.01, 0.2, 20.0, 0.2), "slow_unicycle": (0.01, 1.0, 20.0, 0.35),
    "strict_feedforward2": (0.01, 1.0, 20.0, 0.2),
    **{f"planar_arm{k}": (0.01, 0.2, 12.0, 0.35) for k in range(2, 8)},
    **dict.fromkeys(("baxter_arm5", "baxter_arm7", "xarm6"), (0.01, 0.2, 12.0, 0.35)),
}  # fmt: skip
OBSERVERS = {"none": None, "EKF": npred.observers.EKF, "Luenberger": npred.observers.Luenberger}
MOMENTS, SIZES, NX = 20, (0.3, 12.0), 41
Step = Callable[[np.ndarray], np.ndarray | None]  # X -> U, None where the step is refused


def made(name: str, gate: float | None, observer: str = "none") -> Controller:
    """The controller of a plant, which reads its own commands and whose estimate of the delay is right."""
    plant, (dt, D, _, _), kind = npred.plant(name), PLANTS[name], OBSERVERS[observer]
    D_hat = None if plant.declares_delay else D
    return npred.controller(
        plant, npred.predictor(plant, "rk4", NX), None, dt, D_hat=D_hat, actuator="history", outlier_limit=gate,
        observer=kind and kind(plant),
    )  # fmt: skip


def told(one: Any) -> Step:
    """The step of one of KINDS, which forgets what was before."""

    def step(X: np.ndarray) -> np.ndarray | None:
        try:
            return one.step(X)
        except DivergedError:
            return None

    one.begin()
    return step


def loop(
    controller: Controller, step: Step, D: float, t_end: float, wrong: Callable[[int, np.ndarray], np.ndarray]
) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
    """The distances of a loop from its target in half widths of the box, (steps,), and the largest |U_j| of each step,
    NaN where it was refused. The samples are `wrong` of the step and of the outputs.
    """
    plant, dt, steps = controller.plant, controller.dt, round(t_end / controller.dt)
    low, high = harness.box(plant)
    X, p = ((3 * high + low) / 4)[:, None], plant.p
    advance, longest = engine.advance_kernel(plant, RK4), np.array([5 * D])
    k, held, total = history(longest[0], longest[0], dt, Past(controller.u0[None]))
    D_now, (U0, U1, share) = plant.ratios[:, None] * D, np.zeros((3, plant.m, 1))
    U, distances, sizes, observer = controller.u0, np.empty(steps), np.empty(steps), controller.observer
    for i in range(steps):
        distances[i] = np.abs((X[:, 0] - plant.target(i * dt)) / ((high - low) / 2)).max()
        sent = step(wrong(i, observer.measured(X[:, 0], i * dt) if observer else X[:, 0]))
        sizes[i], U = np.nan if sent is None else np.abs(sent).max(), U if sent is None else sent
        if plant.declares_delay:
            D_now[:] = plant.delay(X[:, 0], i * dt)
        actuate(k, dt, D_now, np.array(U)[:, None], held, total, U0, U1, share)
        k += 1
        advance(X, U0, U1, share, dt, i * dt, p)
    return distances, sizes


def settled(distances: np.ndarray, band: float) -> int:
    """The step from which on a loop stays within the band; its length where it does not."""
    outside = np.flatnonzero(~(distances <= band))
    return int(outside[-1]) + 1 if len(outside) else 0


def half_widths(controller: Controller) -> np.ndarray:
    """Those of the samples: of the box, or of the outputs over it."""
    return controller.observer.sizes.dy if controller.observer else harness.half_widths(controller.plant)


def glitches(name: str, observer: str, kinds: list[str], gate: float | None) -> str:
    """A row of the table: of MOMENTS loops how many recover, how many steps are refused, how far the worst one goes."""
    dt, D, t_end, band = PLANTS[name]
    controller, cells = made(name, gate, observer), []
    half, late = half_widths(controller), round(D / dt)
    for kind in kinds:
        draws = np.random.default_rng(0)
        with tempfile.TemporaryDirectory() as folder:
            one = KINDS[kind](controller, Path(folder))
            distances, U = loop(controller, told(one), D, t_end, lambda i, Y: Y)
            T = settled(distances, band)
            if len(distances) == T:
                return f"{name:20} {observer:10} does not settle within {t_end:g}: {distances[-1]:.2g}"
            recovered, refused, farthest, at_rest = 0, 0, 0.0, 0.0
            for number in range(MOMENTS):
                at = int(draws.integers(0, 2 * T)) if number else 0
                push = draws.choice([-1, 1]) * np.exp(draws.uniform(*np.log(SIZES))) * half
                length = (max(2 * T, at) + 3 * late) * dt + 1.0
                gaps, sent = loop(controller, told(one), D, length, lambda i, Y, at=at, s=push: Y + s * (i == at))
                recovered += settled(gaps, band) <= max(T, at) + late
                refused, farthest = refused + int(np.isnan(sent).sum()), max(farthest, gaps.max())
                at_rest = max(at_rest, np.nanmax(sent[at:])) if at >= T else at_rest
        cells.append(
            f"{recovered:3} of {MOMENTS} {refused:8} {farthest:9.3g} ({distances.max():.2g}) "
            f"{at_rest:8.3g} ({np.nanmax(U):.3g})"
        )
    return f"{name:20} {observer:10} {T * dt:8.2f} " + " | ".join(cells)


def noisy(name: str, noise: float, gate: float | None) -> str:
    """How many samples of a loop under relative noise are not believed."""
    draws = np.random.default_rng(0)
    controller = made(name, gate)
    _, D, t_end, _ = PLANTS[name]
    missed = 0

    def step(X: np.ndarray) -> np.ndarray | None:
        nonlocal missed
        try:
            return controller.step(X).copy()
        finally:
            missed += controller.status.missed > 0

    _, U = loop(controller, step, D, t_end, lambda i, Y: Y * (1 + noise * draws.standard_normal(len(Y))))
    return f"{name:22} {missed:6} of {len(U)} samples not believed, {np.isnan(U).sum()} steps refused"


def main() -> None:
    options = harness.options(__doc__, plants=[*PLANTS], observers=OBSERVERS, kinds=["Python"], gate="1", noise=float)
    gate = None if options.gate == "none" else float(options.gate)
    if options.noise is not None:
        for name in options.plants:
            print(noisy(name, options.noise, gate), flush=True)
        return
    head = " | ".join(f"{kind}: recover, refused, farthest, U at rest" for kind in options.kinds)
    print(f"{'plant':20} {'observer':10} {'settles':>8} {head}")
    with np.errstate(all="ignore"):
        for name, observer in itertools.product(options.plants, options.observers):
            try:
                print(glitches(name, observer, options.kinds, gate), flush=True)
            except ConfigError as refusal:  # an observer that does not serve the plant
                print(f"{name:20} {observer:10} {refusal}", flush=True)


if __name__ == "__main__":
    main()
