"""One wrong sample of 21 sizes in a loop that converges: whether the controller comes back, in Python, C and an FMU.

    python benchmarks/glitches.py

Step 20 measures a state that is 2 to 12 half widths of the box off in every component. The loop has recovered if within
the delay and the time that the loop without a wrong sample takes to settle it has settled too: its distance from the
target, in half widths of the box, stays below BAND. A step that is refused holds the last command.
`--gate none` believes each sample. `--noise 0.05` has no wrong sample, and counts those that the gate takes for wrong.
"""

import argparse
import ctypes
import subprocess
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

import npred
from npred.base.errors import DivergedError
from npred.exports import c_controller, fmu
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
    "activator_repressor": (0.01, 1.0, 12.0, 0.2),
}  # fmt: skip
OTHERS = {  # for noise
    "scalar": (0.01, 1.0, 20.0), "cart_pole": (0.01, 0.2, 20.0), "chemostat": (0.01, 1.0, 20.0),
    "strict_feedforward2": (0.01, 1.0, 20.0), "slow_unicycle": (0.01, 1.0, 20.0), "planar_arm2": (0.01, 0.3, 20.0),
    "xarm6": (0.01, 0.3, 5.0),
}  # fmt: skip
SIZES, WRONG, NX = np.linspace(2.0, 12.0, 21), 20, 41
Step = Callable[[np.ndarray], np.ndarray | None]  # X -> U, None where the step is refused


def made(name: str, gate: float | None) -> Controller:
    """The controller of a plant, which reads its own commands and whose estimate of the delay is right."""
    dt, D = (PLANTS | OTHERS)[name][:2]
    plant = npred.plant(name)
    D_hat = None if plant.declares_delay else D
    return npred.controller(
        plant, npred.predictor(plant, "rk4", NX), None, dt, D_hat=D_hat, actuator="history", outlier_limit=gate
    )


def in_python(controller: Controller, folder: Path) -> Iterator[Step]:
    """Fresh controllers, one a loop."""

    def step(X: np.ndarray) -> np.ndarray | None:
        try:
            return one.step(X).copy()
        except DivergedError:
            return None

    while True:
        one = controller.fresh()
        yield step


def in_c(controller: Controller, folder: Path) -> Iterator[Step]:
    """The same of the exported C."""
    for file, text in zip(("npred.h", "npred.c"), c_controller.sources(controller), strict=True):
        (folder / file).write_text(text)
    size = "unsigned long size(void);\nunsigned long size(void) { return sizeof(npred_controller); }\n"
    (folder / "size.c").write_text('#include "npred.c"\n' + size)
    command = ["cc", "-std=c99", "-O2", "-shared", "-fPIC", "size.c", "-o", "npred.so", "-lm"]
    subprocess.run(command, cwd=folder, check=True)
    library = ctypes.CDLL(str(folder / "npred.so"))
    library.size.restype = ctypes.c_ulong

    def step(X: np.ndarray) -> np.ndarray | None:
        X, U = np.ascontiguousarray(X), np.zeros(controller.plant.m)
        code = library.npred_step(memory, *(a.ctypes.data_as(ctypes.c_void_p) for a in (X, U)))
        return None if code else U

    while True:
        memory = ctypes.create_string_buffer(library.size())
        library.npred_init(memory)
        yield step


def in_fmu(controller: Controller, folder: Path) -> Iterator[Step]:
    """The same of the FMU, by FMPy; a step that was refused says so in the log."""
    import fmpy
    from fmpy.fmi3 import FMU3Slave

    path, dt = folder / "controller.fmu", controller.dt
    npred.export(controller, "fmu", path)
    listed = fmu.variables(controller, controller.plant.target(0.0), arrays=True)
    described: Any
    described, unzipped = fmpy.read_model_description(str(path)), fmpy.extract(str(path))
    X_places = [k for k, variable in enumerate(listed) if variable.block == "X"]
    U_places = [k for k, variable in enumerate(listed) if variable.block == "U"]
    messages: list[bytes] = []

    def step(X: np.ndarray) -> np.ndarray | None:
        nonlocal t
        messages.clear()
        slave.setFloat64(X_places, X.tolist())
        slave.doStep(t, dt)
        t += dt
        return None if messages else np.array(slave.getFloat64(U_places))

    while True:
        slave, t = FMU3Slave(
            guid=described.guid, unzipDirectory=unzipped,
            modelIdentifier=described.coSimulation.modelIdentifier, instanceName="one",
        ), 0.0  # fmt: skip
        slave.instantiate(logMessage=lambda *call: messages.append(call[3]))
        slave.enterInitializationMode(startTime=0.0)
        slave.exitInitializationMode()
        yield step
        slave.terminate()
        slave.freeInstance()


KINDS = {"Python": in_python, "C": in_c, "FMU": in_fmu}


def loop(controller: Controller, step: Step, D: float, t_end: float, wrong: Callable[..., np.ndarray]) -> np.ndarray:
    """The distances of a loop from its target in half widths of the box, (steps,), and how many steps are refused."""
    plant, dt, steps = controller.plant, controller.dt, round(t_end / controller.dt)
    low, high = np.array([plant.box[name] for name in plant.states]).T
    X, p = ((3 * high + low) / 4)[:, None], plant.p
    advance, longest = engine.advance_kernel(plant, RK4), np.array([5 * D])
    k, held, total = history(longest[0], longest[0], dt, Past(controller.u0[None]))
    D_now, (U0, U1, share) = plant.ratios[:, None] * D, np.zeros((3, plant.m, 1))
    U, distances, refused = controller.u0, np.empty(steps), 0
    for i in range(steps):
        distances[i] = np.abs((X[:, 0] - plant.target(i * dt)) / ((high - low) / 2)).max()
        sent = step(wrong(i, X[:, 0], (high - low) / 2))
        refused, U = refused + (sent is None), U if sent is None else sent
        if plant.declares_delay:
            D_now[:] = plant.delay(X[:, 0], i * dt)
        actuate(k, dt, D_now, np.array(U)[:, None], held, total, U0, U1, share)
        k += 1
        advance(X, U0, U1, share, dt, i * dt, p)
    return np.append(distances, refused)


def settled(distances: np.ndarray, band: float) -> int:
    """The step from which on a loop stays within the band; its length where it does not."""
    outside = np.flatnonzero(~(distances <= band))
    return int(outside[-1]) + 1 if len(outside) else 0


def glitches(name: str, kinds: list[str], gate: float | None) -> str:
    """A row of the table: of 21 loops how many recover, how many steps are refused, and how far the worst one goes."""
    dt, D, t_end, band = PLANTS[name]
    controller, cells = made(name, gate), []
    for kind in kinds:
        with tempfile.TemporaryDirectory() as folder:
            steps = KINDS[kind](controller, Path(folder))
            nominal = loop(controller, next(steps), D, t_end, lambda i, X, half: X)[:-1]
            T = settled(nominal, band)
            assert len(nominal) > T, f"{name} does not settle within {t_end}"
            length = (WRONG + T) * dt + D + 1.0
            recovered, refused, farthest = 0, 0, 0.0
            for size in SIZES:
                run = loop(controller, next(steps), D, length, lambda i, X, half, s=size: X + s * half * (i == WRONG))
                recovered += settled(run[:-1], band) <= WRONG + T + round(D / dt)
                refused, farthest = refused + int(run[-1]), max(farthest, run[:-1].max())
        cells.append(f"{recovered:3} of {len(SIZES)} {refused:8} {farthest:9.3g} ({nominal.max():.2g})")
    return f"{name:22} {T * dt:8.2f} " + " | ".join(cells)


def noisy(name: str, noise: float, gate: float | None) -> str:
    """How many samples of a loop under relative noise are not believed."""
    draws = np.random.default_rng(0)
    controller = made(name, gate)
    _, D, t_end = (PLANTS | OTHERS)[name][:3]
    missed = 0

    def step(X: np.ndarray) -> np.ndarray | None:
        nonlocal missed
        try:
            return controller.step(X).copy()
        finally:
            missed += controller.status.missed > 0

    run = loop(controller, step, D, t_end, lambda i, X, half: X * (1 + noise * draws.standard_normal(len(X))))
    return f"{name:22} {missed:6} of {len(run) - 1} samples not believed, {int(run[-1])} steps refused"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--plants", nargs="*", default=None)
    parser.add_argument("--kinds", nargs="*", choices=KINDS, default=list(KINDS))
    parser.add_argument("--gate", default="1")
    parser.add_argument("--noise", type=float)
    options: Any = parser.parse_args()
    gate = None if options.gate == "none" else float(options.gate)
    if options.noise is not None:
        for name in options.plants or [*PLANTS, *OTHERS]:
            print(noisy(name, options.noise, gate), flush=True)
        return
    print(f"{'plant':22} {'settles':>8} " + " | ".join(f"{kind}: recover, refused, farthest" for kind in options.kinds))
    with np.errstate(all="ignore"):
        for name in options.plants or PLANTS:
            print(glitches(name, options.kinds, gate), flush=True)


if __name__ == "__main__":
    main()
