"""Set-points that a plant can hold, and that it cannot, in other units of time and of its states.

    python benchmarks/rests.py [--exported 1] [--plants NAME ...]

Each of the forty plants of plants.py is asked for 20 set-points that it can hold and 10 that it cannot, one after
the other, in s, ms, min and h, and with its states times 1e9 and 1e-9. SciPy's bounded least squares decides which is
which, from five starts, in the plant's own units; those that it leaves open are not asked. It prints how many of the
one kind are refused, and of the other taken; the largest error of the rests against SciPy's, as a share of the box; and
the largest difference of U, as a share of its bounds, between a controller, its C and its FMU, which are asked in
`exported` of each plant's units.
"""

import tempfile
from collections import namedtuple
from collections.abc import Iterable
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from harness import InC, InFmu, options
from plants import MODELS, Model
from scipy.optimize import least_squares
from setpoints import tried

import npred
from npred.plants import Plant, setpoint

UNITS = {  # of time: how many of it are a second; and the factor of the states
    "s": (1.0, 1.0), "min": (1 / 60, 1.0), "x 1e9": (1.0, 1e9), "ms": (1e3, 1.0), "h": (1 / 3600, 1.0),
    "x 1e-9": (1.0, 1e-9),
}  # fmt: skip
HELD, NOT_HELD, ROUNDS = 20, 10, 4000  # set-points of each kind, and how many are drawn at most to find them
STARTS, CALLS = 4, 100  # of the least squares; calls of each
SOLVED, LEFT = 1e-9, 1e-5  # residuals, as shares of usual ones: below it one is 0, above it is none


class Asked(NamedTuple):
    """A set-point, and SciPy's rest X, U of it within the bounds, (n + m,); None where it cannot be held."""

    aims: np.ndarray
    rest: np.ndarray | None


class Truth:
    """Which set-points a model can hold, by SciPy."""

    def __init__(self, model: Model) -> None:
        self.model, self.rng = model, np.random.default_rng(0)
        self.state = namedtuple("state", model.box)  # type: ignore[misc]
        self.input = namedtuple("input", model.inputs)  # type: ignore[misc]
        box, bounds = np.array([*model.box.values()]), np.array([*model.inputs.values()])
        width = np.ptp(box, axis=1)
        low = np.where(box[:, 0] > 0, 1e-6 * box[:, 0], box[:, 0] - 20 * width)  # what is positive in the box is so
        walls = [model.walls.get(name, (-np.inf, np.inf)) for name in model.box]
        reach = np.clip(np.stack([low, box[:, 1] + 20 * width], axis=1).T, *np.array(walls).T).T
        self.n, self.scale = len(box), np.append(width, np.ptp(bounds, axis=1)) / 2
        self.inner, self.limits = np.concatenate([box, bounds]), np.concatenate([reach, bounds])
        self.guess = np.append(model.guess or box.mean(axis=1), bounds.mean(axis=1))
        draws = self.drawn(200)
        with np.errstate(all="ignore"):
            usual = np.nanmedian(np.abs([self.f(z) for z in draws]), axis=0)
        self.usual = np.where(usual > 0, usual, 1.0)
        self.ranges = np.array([*model.aims.values()])

    def drawn(self, count: int) -> np.ndarray:
        """States of the box with inputs of the bounds, (count, n + m)."""
        return self.rng.uniform(self.inner[:, 0], self.inner[:, 1], (count, len(self.inner)))

    def f(self, z: np.ndarray) -> np.ndarray:
        return np.array(self.model.f(self.state(*z[: self.n]), self.input(*z[self.n :]), np), dtype=float)

    def read(self, z: np.ndarray) -> np.ndarray:
        """What the set-points are of."""
        x, read = self.state(*z[: self.n]), self.model.read
        return np.array([read[name](x, np) if name in read else getattr(x, name) for name in self.model.aims])

    def residual(self, y: np.ndarray, aims: np.ndarray) -> np.ndarray:
        with np.errstate(all="ignore"):
            left = (self.read(y * self.scale) - aims) / np.ptp(self.ranges, axis=1)
            return np.nan_to_num(np.append(self.f(y * self.scale) / self.usual, left), nan=1e6, posinf=1e6, neginf=-1e6)

    def asked(self, aims: np.ndarray) -> Asked | None:
        """A set-point with its rest; None where that is left open."""
        starts = [self.guess, *self.drawn(STARTS)]
        low, high = (self.limits / self.scale[:, None]).T
        least = np.inf
        for start in starts:
            y = np.clip(start / self.scale, low + 1e-9, high - 1e-9)
            accuracy = {"xtol": 1e-14, "ftol": 1e-14, "gtol": 1e-14, "max_nfev": CALLS}
            done = least_squares(self.residual, y, bounds=(low, high), args=(aims,), **accuracy)
            least = min(least, float(np.abs(done.fun).max()))
            if least <= SOLVED:
                return Asked(aims, done.x * self.scale)
        return Asked(aims, None) if least > LEFT else None

    @cached_property
    def setpoints(self) -> list[Asked]:
        """HELD set-points and NOT_HELD, in a random order."""
        held: list[Asked] = []
        never: list[Asked] = []
        for _ in range(ROUNDS):
            kind = self.asked(self.rng.uniform(*self.ranges.T))
            if kind is not None:
                (never if kind.rest is None else held).append(kind)
            if len(held) >= HELD and len(never) >= NOT_HELD:
                break
        chosen = [*held[:HELD], *never[:NOT_HELD]]
        assert len(chosen) == HELD + NOT_HELD, (len(held), len(never))
        return [chosen[k] for k in self.rng.permutation(len(chosen))]


def declared(truth: Truth, unit: str) -> tuple[Any, np.ndarray, np.ndarray]:
    """A model as a user would write it in these units, with the factors of its states and inputs and of its aims."""
    model, (per_second, factor) = truth.model, UNITS[unit]
    sizes = {name: factor / (per_second if name in model.rates else 1.0) for name in model.box}
    of_aims = {name: 1.0 if name in model.read else sizes[name] for name in model.aims}
    first = dict(zip(model.aims, truth.read(truth.guess), strict=True))

    def plain(x: Any) -> Any:
        return truth.state(*(getattr(x, name) / size for name, size in sizes.items()))

    def f(x: Any, u: Any, t: Any, p: Any, M: Any) -> list[Any]:
        return [size / per_second * v for size, v in zip(sizes.values(), model.f(plain(x), u, M), strict=True)]

    def setpoint(x: Any, t: Any, p: Any, M: Any) -> list[Any]:
        aims = [(name, getattr(p, f"aim_{name}")) for name in model.aims]
        return [(model.read[k](plain(x), M) if k in model.read else getattr(x, k)) - aim for k, aim in aims]

    def ranges(of: Any) -> dict[str, tuple[float, ...]]:
        return {name: tuple(sizes[name] * end for end in pair) for name, pair in of.items()}

    parts: dict[str, Any] = {
        "states": tuple(model.box), "inputs": tuple(model.inputs), "input_bounds": tuple(model.inputs.values()),
        "box": ranges(model.box), "state_bounds": ranges(model.walls), "time_unit": unit if unit in "ms min h" else "s",
        "guess": tuple(truth.guess[: truth.n] * [*sizes.values()]), "f": f, "setpoint": setpoint,
        "parameters": {f"aim_{name}": value * of_aims[name] for name, value in first.items()},
    }  # fmt: skip
    inputs = [1.0] * len(model.inputs)
    return type("Declared", (), parts), np.array([*sizes.values(), *inputs]), np.array([*of_aims.values()])


class Counted(NamedTuple):
    """Set-points that were wrongly refused and wrongly taken, the largest error of a rest, and difference of U."""

    refused: int = 0
    taken: int = 0
    error: float = 0.0
    apart: float = 0.0

    def __add__(self, other: "Counted") -> "Counted":  # type: ignore[override]
        return Counted(
            self.refused + other.refused, self.taken + other.taken, max(self.error, other.error),
            max(self.apart, other.apart),
        )  # fmt: skip


class Alone:
    """What `controller.set` asks, without a controller."""

    def __init__(self, plant: Plant) -> None:
        self.plant, self.p = plant, plant.p
        self.limits = setpoint.bounds(plant, np.array(plant.input_bounds, dtype=float))

    def set(self, **values: float) -> None:
        self.p = setpoint.changed(self.plant, self.p, values, {}, self.limits)


def counted(truth: Truth, unit: str, exported: bool, setpoints: Iterable[Asked] | None = None) -> Counted:
    """The set-points of a model, asked for in these units: of a controller, its C and its FMU, if it is exported."""
    total = Counted()
    kind, sizes, of_aims = declared(truth, unit)
    plant, dt = npred.plant(kind, kappa="lqr"), 0.01 * truth.model.second * UNITS[unit][0]
    n, m = plant.n, plant.m
    with tempfile.TemporaryDirectory() as folder:
        kinds: list[Any] = [Alone(plant)]
        if exported:
            predictor = npred.predictor(plant, "rk4", nx=5)
            one = npred.controller(plant, predictor, None, dt, D_hat=20 * dt, u0="equilibrium")
            kinds = [one, InC(one, Path(folder)), InFmu(one, Path(folder))]
        for aims, expected in truth.setpoints if setpoints is None else setpoints:
            values = {f"aim_{name}": aim for name, aim in zip(truth.model.aims, aims * of_aims, strict=True)}
            wrong = sum(tried(each, values) != (expected is not None) for each in kinds)
            total += Counted(**{"taken" if expected is None else "refused": wrong})
            if expected is None or wrong:
                continue
            rest = (one.settings.p if exported else kinds[0].p)[-n - m :]
            total += Counted(error=float(np.abs((expected - rest / sizes) / truth.scale).max()))
            if exported:
                U = np.array([each.step(rest[:n]).copy() for each in kinds])
                total += Counted(apart=float((np.ptp(U, axis=0) / truth.scale[n:]).max()))
    return total


if __name__ == "__main__":
    asked = options(__doc__, exported=1, plants=MODELS)
    print(f"{'plant':26} refused  taken    error  U apart")
    total = Counted()
    for k, name in enumerate(asked.plants):
        truth, units = Truth(MODELS[name]), [*UNITS]
        units = units[k % len(units) :] + units[: k % len(units)]  # each plant is exported in others
        row = sum((counted(truth, unit, j < asked.exported) for j, unit in enumerate(units)), start=Counted())
        total += row
        print(f"{name:26} {row.refused:7} {row.taken:6} {row.error:8.1e} {row.apart:8.1e}", flush=True)
    count = len(asked.plants) * len(UNITS)
    print(f"{'all':26} {total.refused:7} {total.taken:6} {total.error:8.1e} {total.apart:8.1e}")
    print(f"of {count * HELD} that can be held and {count * NOT_HELD} that cannot")
