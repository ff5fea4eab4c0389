"""Set-points that are stepped while a loop runs, its delay unknown: in Python, in the exported C and in an FMU.

    python benchmarks/setpoints.py [--steps 50]

Five plants are led from one random set-point to the next by `controller.set`, `npred_set_parameters` and the FMU's
parameters, all three on the same samples. It prints how many set-points the state has come to, within 1 % of their
range, when the next one is set; samples that were refused, and set-points (those without a rest, which are tried too);
the largest share that U's change when one is set has of its bound; and the largest difference of U between the three,
relative to the largest U. The bound is |kappa(P; new) - kappa(P; old)| + |what U would have moved without it|.
"""

import argparse
import copy
import ctypes
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

import npred
from npred import exports, plants
from npred.base.errors import ConfigError
from npred.exports import WholeController, c_controller, c_files, fmu
from npred.loop import engine
from npred.loop.controller import Controller
from npred.plants import Plant
from npred.plants.builtin.chemostat import Chemostat
from npred.plants.builtin.van_der_pol import VanDerPol
from npred.prediction.methods import RK4

SETTLED = 0.01  # of a set-point's range


class Pendulum:
    """A pendulum without friction, lifted by a torque; more than 9 Nm it cannot."""

    states, inputs = ("angle", "rate"), ("torque",)
    parameters = {"pull": 9.81, "aim": 0.3}
    box = {"angle": (-1.5, 1.5), "rate": (-3.0, 3.0)}
    input_bounds = ((-9.0, 9.0),)

    def f(x, u, t, p, M):
        return [x.rate, u.torque - p.pull * M.sin(x.angle)]

    def setpoint(x, t, p, M):
        return [x.angle - p.aim]


class TwoTanks:
    """Two tanks in a row, each with a pump: levels h1 and h2 in metres; h1 flows into h2."""

    states, inputs = ("h1", "h2"), ("q1", "q2")
    parameters = {"c": 0.5, "first": 1.0, "second": 2.0}
    box = {"h1": (0.5, 2.5), "h2": (1.0, 6.0)}
    guess = (1.0, 2.0)
    input_bounds = ((0.0, 2.0), (0.0, 2.0))

    def f(x, u, t, p, M):
        first, second = p.c * M.sqrt(M.maximum(x.h1, 1e-3)), p.c * M.sqrt(M.maximum(x.h2, 1e-3))
        return [u.q1 - first, u.q2 + first - second]

    def setpoint(x, t, p, M):
        return [x.h1 - p.first, x.h2 - p.second]


class Oscillator(VanDerPol):
    """Van der Pol's, held at some x1."""

    parameters = {"mu": 1.0, "aim": 0.0}
    kappa = V = None

    def setpoint(x, t, p, M):
        return [x.x1 - p.aim]


class Reactor(Chemostat):
    """The chemostat, led to some substrate S; which biomass Z that takes follows."""

    parameters = {"a": 3.5, "rho": 1.0, "m": 0.1, "S_in": 2 + 10 / 3, "aim": 2.0}
    kappa = V = None

    def setpoint(x, t, p, M):
        return [x.S - p.aim]


class Oven:
    """A temperature whose kappa reads the set-point itself."""

    states, inputs = ("T",), ("heat",)
    parameters = {"loss": 0.4, "k": 1.5, "aim": 20.0}
    box = {"T": (0.0, 100.0)}

    def f(x, u, t, p, M):
        return [u.heat - p.loss * x.T]

    def kappa(x, t, p, M):
        return [p.loss * p.aim - p.k * (x.T - p.aim)]


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
    tanks, nan = npred.plant(TwoTanks, kappa="lqr"), float("nan")
    return {
        "pendulum": Case(npred.plant(Pendulum, kappa="lqr"), 0.01, 0.12, 0.2, {"aim": (-1.0, 1.0)}, 12.0, {"aim": 1.5}),
        "two tanks": Case(tanks, 0.02, 0.6, 0.3, {"first": (0.6, 2.0), "second": (2.5, 5.0)}, 60.0, {"first": 17.0}),
        "oscillator": Case(
            npred.plant(Oscillator, kappa="feedback_linearisation"), 0.01, 0.3, 0.5, {"aim": (-1.8, 1.8)}, 15.0,
            {"aim": nan},
        ),
        "reactor": Case(npred.plant(Reactor, kappa="lqr"), 0.02, 0.6, 0.3, {"aim": (1.6, 2.4)}, 40.0, {"aim": nan}),
        "oven": Case(npred.plant(Oven), 0.02, 0.8, 0.4, {"aim": (10.0, 90.0)}, 15.0, {"aim": nan}),
    }  # fmt: skip


class InC:
    """An exported controller, compiled, with `set` and `step` as npred.controller has them."""

    def __init__(self, controller: Controller, folder: Path) -> None:
        sizes = "unsigned long size(void);\nunsigned long size(void) { return sizeof(npred_controller); }\n"
        npred.export(controller, "controller", folder / "c")
        (folder / "c" / "size.c").write_text('#include "npred.c"\n' + sizes)
        c_files.build([folder / "c" / "size.c"], folder / "npred.so", "controller")
        self.library, self.values = ctypes.CDLL(str(folder / "npred.so")), c_controller.settable(controller)
        self.library.size.restype = ctypes.c_ulong
        self.memory = ctypes.create_string_buffer(self.library.size())
        self.library.npred_init(self.memory)
        self.U = np.zeros(controller.plant.m)

    def set(self, **values: float) -> None:
        wanted = self.values | values
        numbers = np.array([*wanted.values()])
        if self.library.npred_set_parameters(self.memory, numbers.ctypes.data_as(ctypes.c_void_p)):
            raise ConfigError("refused")
        self.values = wanted

    def step(self, X: np.ndarray) -> np.ndarray:
        pointers = (a.ctypes.data_as(ctypes.c_void_p) for a in (np.ascontiguousarray(X), self.U))
        assert self.library.npred_step(self.memory, *pointers) == 0
        return self.U


class InFmu:
    """The same of its FMU, by FMPy."""

    def __init__(self, controller: Controller, folder: Path) -> None:
        import fmpy
        from fmpy.fmi3 import FMU3Slave

        path, self.t, self.dt = folder / "controller.fmu", 0.0, controller.dt
        exports.writer("fmu", {})(WholeController(controller), path)
        listed = fmu.variables(controller, np.zeros(controller.plant.n), arrays=True)
        self.places = {variable.name: k for k, variable in enumerate(listed)}
        self.X, self.U = ([k for k, one in enumerate(listed) if one.block == block] for block in "XU")
        described: Any = fmpy.read_model_description(str(path))
        self.slave = FMU3Slave(
            guid=described.instantiationToken, unzipDirectory=fmpy.extract(str(path), str(folder / "fmu")),
            modelIdentifier=described.coSimulation.modelIdentifier, instanceName="one",
        )  # fmt: skip
        self.slave.instantiate(logMessage=lambda *_: None)
        self.slave.enterInitializationMode(startTime=0.0)
        self.slave.exitInitializationMode()

    def set(self, **values: float) -> None:
        places = [self.places[f"parameter.{name}"] for name in values]
        try:
            self.slave.setFloat64(places, [*values.values()])
        except fmpy_error() as error:
            raise ConfigError("refused") from error

    def step(self, X: np.ndarray) -> np.ndarray:
        self.slave.setFloat64(self.X, X.tolist())
        self.slave.doStep(self.t, self.dt)
        self.t += self.dt
        return np.array(self.slave.getFloat64(self.U))


def fmpy_error() -> type[Exception]:
    """What FMPy raises for an answer that is not fmi3OK."""
    from fmpy.fmi1 import FMICallException

    return FMICallException


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
        twin, after = copy.deepcopy(first), plants.varied(plant, tuple((first.parameters | values).items()))
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


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--steps", type=int, default=50)
    steps = parser.parse_args().steps
    print(f"{'plant':12} settled  samples refused  set-points refused  ΔU / bound  C - Python  FMU - Python")
    for name, case in cases().items():
        with tempfile.TemporaryDirectory() as folder:
            rows = [stepped(case, one := controller(case), [kind(one, Path(folder))], steps) for kind in (InC, InFmu)]
        c, f = rows
        print(
            f"{name:12} {c.settled:2} of {c.of:2} {c.samples_refused:16} {c.refused:19} {c.share:11.3f} "
            f"{c.apart:11.1e} {f.apart:13.1e}"
        )


if __name__ == "__main__":
    main()
