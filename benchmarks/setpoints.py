"""Set-points that are stepped while a loop runs, its delay unknown: in Python, in the exported C and in an FMU.

    python benchmarks/setpoints.py [--steps 50]

Five plants are led from one random set-point to the next by `controller.set`, `npred_set_parameters` and the FMU's
parameters, all three on the same samples. It prints how many set-points the state has come to, within 1 % of their
range, when the next one is set; samples that were refused, and set-points (those without a rest, which are tried too);
the largest share that U's change when one is set has of its bound; and the largest difference of U between the three,
relative to the largest U. The bound is |kappa(P; new) - kappa(P; old)| + |what U would have moved without it|.
"""

import copy
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import harness
import numpy as np
import plants

import npred
from npred.base.errors import ConfigError
from npred.loop import engine
from npred.loop.controller import Controller
from npred.plants import Plant, varied
from npred.prediction.methods import RK4

SETTLED = 0.01  # of a set-point's range


class Case(NamedTuple):
    """A plant with its law; dt, the true delay and the first estimate; the ranges of its set-points, how long each of
    them is held; and set-points that are to be refused.
    """

    plant: Plant
    dt: float
    D: float
    D_hat: float
    ranges: dict[str, tuple[float, float]]
    hold: float
    never: dict[str, float]


def cases() -> dict[str, Case]:
    """The five plants. NaN is refused by all of them."""
    nan = float("nan")

    def case(kind: type, law: Any, *numbers: float, hold: float, never: dict[str, float], **ranges: Any) -> Case:
        return Case(npred.plant(kind, kappa=law) if law else npred.plant(kind), *numbers, ranges, hold, never)

    return {
        "pendulum": case(plants.Lifted, "lqr", 0.01, 0.12, 0.2, aim=(-1.0, 1.0), hold=12.0, never={"aim": 1.5}),
        "two tanks": case(
            plants.TwoTanks, "lqr", 0.02, 0.6, 0.3, first=(0.6, 2.0), second=(2.5, 5.0), hold=60.0,
            never={"first": 17.0},
        ),
        "oscillator": case(
            plants.Oscillator, "feedback_linearisation", 0.01, 0.3, 0.5, aim=(-1.8, 1.8), hold=15.0, never={"aim": nan}
        ),
        "reactor": case(plants.Reactor, "lqr", 0.02, 0.6, 0.3, aim=(1.6, 2.4), hold=40.0, never={"aim": nan}),
        "oven": case(plants.Oven, None, 0.02, 0.8, 0.4, aim=(10.0, 90.0), hold=15.0, never={"aim": nan}),
    }  # fmt: skip


class Stepped(NamedTuple):
    """Set-points that were reached, of how many; samples and set-points refused; the largest share that a change of U
    has of its bound, and the largest difference of U between the kinds of controllers.
    """

    settled: int
    of: int
    samples_refused: int
    refused: int
    share: float
    apart: float


def controller(case: Case, **parts: Any) -> Controller:
    """A controller that does not know the delay."""
    law = npred.DelayObserver(bounds=(0.3 * case.D, 3.0 * case.D))
    predictor = parts.pop("predictor", None) or npred.predictor(case.plant, "rk4", nx=31)
    parts = {"actuator": "history", "D_hat": case.D_hat, "u0": "equilibrium"} | parts
    return npred.controller(case.plant, predictor, law, case.dt, **parts)


def tried(one: Any, values: dict[str, float]) -> bool:
    """Whether a controller takes set-points."""
    try:
        one.set(**values)
    except ConfigError:
        return False
    return True


def stepped(
    case: Case, first: Controller, others: list[Any], steps: int, seed: int = 0, push: float = 0.0,
    output: Callable[[np.ndarray], Any] = lambda X: X,
) -> Stepped:  # fmt: skip
    """The loop of the first controller, whose samples the others get too; `push` is added to the plant's inputs."""
    plant, rng, (low, high) = case.plant, np.random.default_rng(seed), np.array([*case.ranges.values()]).T
    advance, share, D = engine.advance_kernel(plant, RK4), np.ones((plant.m, 1)), round(case.D / case.dt)
    X, sent = plant.target(0.0)[:, None].copy(), [first.u0.copy()] * (D + 1)
    settled = refused = t = 0
    largest, size, apart, before = 0.0, 0.0, 0.0, plant
    for k in range(steps):
        answers = {tried(one, case.never) for one in (first, *others)}
        assert answers == {False} and first.plant.parameters | first.parameters == before.parameters
        refused += 1
        drawn = rng.uniform(low, high)
        if k % 5 == 0:  # across the whole range
            drawn = np.where(rng.uniform(size=len(low)) < 0.5, low, high)
        values = dict(zip(case.ranges, drawn.tolist(), strict=True))
        twin, after = copy.deepcopy(first), varied(plant, tuple((first.parameters | values).items()))
        for one in (first, *others):
            one.set(**values)
        for j in range(round(case.hold / case.dt)):
            Y = np.asarray(output(X[:, 0]), dtype=float)
            U, last = first.step(Y).copy(), sent[-1]
            apart = max([apart, *(float(np.abs(one.step(Y) - U).max()) for one in others)])
            size = max(size, float(np.abs(U).max()))
            if j == 0 and k:
                usual, P = np.abs(twin.step(Y) - last), first.P[-1]
                bound = np.abs(after.kappa(P) - before.kappa(P)) + usual
                largest = max(largest, float((np.abs(U - last) / (bound + 1e-9 * size)).max()))
            sent.append(U)
            acting = sent[-1 - D][:, None] + push
            advance(X, acting, acting, share, case.dt, t * case.dt, plant.p)
            t += 1
        goal, before = after.target(0.0), after
        read = [X[plant.states.index(name), 0] - goal[plant.states.index(name)] for name in plant.states]
        settled += bool(np.abs(read).max() <= SETTLED * (high - low).max())
    return Stepped(settled, steps, first.status.refused, refused, largest, apart / size)


if __name__ == "__main__":
    steps = harness.options(__doc__, steps=50).steps
    print(f"{'plant':12} settled  samples refused  set-points refused  ΔU / bound  C - Python  FMU - Python")
    for name, case in cases().items():
        with tempfile.TemporaryDirectory() as folder:
            kinds = harness.InC, harness.InFmu
            c, f = (stepped(case, one := controller(case), [kind(one, Path(folder))], steps) for kind in kinds)
        counts = f"{name:12} {c.settled:2} of {c.of:2} {c.samples_refused:16} {c.refused:19} {c.share:11.3f}"
        print(f"{counts} {c.apart:11.1e} {f.apart:13.1e}", flush=True)
