"""The operations that benchmarks/paired.py times, of the tree that this file is in.

It reads names on stdin, and answers each by the seconds of a call, or null where it cannot be made. With paired.py only
the names and this protocol are shared: what a change renames is renamed here as well, and an operation keeps its name.
Networks are untrained, for weights do not change a time.
"""

import ctypes
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

BATCH = 0.02  # s that a batch of calls takes
PLANTS = ("activator_repressor", "van_der_pol", "cart_pole", "unicycle", "planar_arm5")
GRIDS = {".01": 101, ".005": 201, ".001": 1001}
LANES = {1: "1 lane", 64: "64 lanes"}
STEP = r"""
#include "npred.c"
void steps(int count)
{
    static npred_controller c;
    static int ready;
    REAL_OF_C X[NPRED_N_OUTPUTS] = {0}, U[NPRED_M_INPUTS];
    if (!ready) { npred_init(&c); ready = 1; }
    for (int k = 0; k < count; k++) {
        for (int i = 0; i < NPRED_N_OUTPUTS; i++) { X[i] = 0.1 * (1 + 0.001 * (k % 10)); }
        npred_step(&c, X, U);
    }
}
"""
Call = Callable[[], Any]
Made = Callable[[], Call]  # of an operation: what is done once, and the call that is timed


def operations() -> dict[str, Made]:
    """The operations by name. They use what a user uses, and the kernels' `bound`."""
    made: dict[str, Made] = {}
    for network in ("deeponet", "fno"):
        for dx, nx in GRIDS.items():
            made[f"{network} fused, kernel, dx {dx}"] = lambda network=network, nx=nx: kernel_of(fused(network, nx))
    made["deeponet fused in double, kernel, dx .01"] = lambda: kernel_of(fused("deeponet", 101, np.float64))
    made["kernel of Euler on 4 steps"] = lambda: kernel_of(numerical("activator_repressor", "euler", 5))
    made["p(X, u, D_hat), rk4"] = lambda: called(numerical("activator_repressor"))
    made["guarded p(X, u, D_hat)"] = lambda: called(guarded())
    made["controller.step, rk4"] = controller_step
    made["exported step, rk4"] = exported_step
    for plant in PLANTS:
        for lanes, words in LANES.items():
            name = f"sweep of rk4, {plant}, {words}"
            made[name] = lambda plant=plant, lanes=lanes: kernel_of(numerical(plant), lanes)
    for lanes, words in LANES.items():
        made[f"loop, 400 steps, {words}"] = lambda lanes=lanes: loop(lanes)
    made["generate, 2000 samples"] = generate
    made["cold: first loop with an empty cache"] = cold
    return made


def fused(network: str, nx: int, precision: type = np.float32) -> Any:
    from npred import plants
    from npred.lab import config
    from npred.networks.fused import Fused
    from npred.networks.weights import untrained

    plant = plants.resolve("activator_repressor")
    weights = untrained(config.Train().table(network), plant, np.random.default_rng(0))
    return Fused(plant, weights, nx, network, precision=precision)


def numerical(plant: str, method: str = "rk4", nx: int = 101) -> Any:
    import npred

    return npred.predictor(npred.plant(plant), method, nx=nx)


def guarded() -> Any:
    import npred

    return npred.guarded(numerical("activator_repressor"), tolerance=0.1)


def sample(predictor: Any, lanes: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """X, u and D_hat near the middle of the plant's box, lanes innermost."""
    plant, rng = predictor.plant, np.random.default_rng(1)
    middle = np.array([sum(plant.box[name]) / 2 for name in plant.states])
    X = middle[:, None] * rng.uniform(0.9, 1.1, (plant.n, lanes)) + 1e-3
    return X, rng.uniform(0.0, 0.1, (predictor.nx, plant.m, lanes)), rng.uniform(0.5, 0.6, lanes)


def kernel_of(predictor: Any, lanes: int = 1) -> Call:
    """The kernel on arrays that are there."""
    X, u, D_hat = sample(predictor, lanes)
    run, P = predictor.lanes(), np.empty((predictor.nx, predictor.plant.n, lanes))
    return run.bound(X, u, D_hat, 0.0, predictor.plant.p, P)


def called(predictor: Any) -> Call:
    """The predictor, called from Python with one sample."""
    X, u, D_hat = (a[..., 0] for a in sample(predictor, 1))
    return lambda: predictor(X, u, D_hat)


def controller() -> Any:
    import npred

    predictor = numerical("van_der_pol")
    law = npred.DelayAdaptation(bounds=(0.1, 1.0))
    return npred.controller(predictor.plant, predictor, law, 0.02, D_hat=0.5, actuator="history")


def controller_step() -> Call:
    one, X = controller(), np.array([0.1, 0.2])
    return lambda: one.step(X)


def exported_step() -> Call:
    """Ten steps of a controller in C, through one call."""
    from npred.exports import c_controller

    folder = Path(tempfile.mkdtemp())
    for file, text in zip(("npred.h", "npred.c"), c_controller.sources(controller()), strict=True):
        (folder / file).write_text(text)
    kind = "float" if "float *U" in (folder / "npred.h").read_text() else "double"
    (folder / "steps.c").write_text(STEP.replace("REAL_OF_C", kind))
    flags = ["-std=gnu99", "-O3", "-march=native", "-shared", "-fPIC"]
    subprocess.run(["cc", *flags, "steps.c", "-o", "steps.so", "-lm"], cwd=folder, check=True)
    function = ctypes.CDLL(str(folder / "steps.so")).steps
    return lambda: function(10)


def loop(lanes: int) -> Call:
    import npred

    predictor = numerical("activator_repressor")
    starts = np.array([0.03, 30.0]) * np.linspace(0.9, 1.1, lanes)[:, None]
    settings = {"D": 1.0, "D_hat": 1.0, "dt": 0.05, "t_end": 20.0}
    return lambda: npred.simulate(predictor.plant, predictor, X0=starts, **settings)


def generate() -> Call:
    from npred import plants
    from npred.lab import config
    from npred.lab.stages.generate import sampling

    pipeline, plant = config.parse({"plant": "activator_repressor"}, "paired"), plants.resolve("activator_repressor")
    table = pipeline.generate.model_copy(update={"rollouts": 20, "samples": 2000})
    pipeline = pipeline.model_copy(update={"generate": table})
    return lambda: sampling.rows(pipeline, plant, range(20))


def cold() -> Call:
    """A process with an empty cache that runs a loop."""
    loop = "npred.simulate(p, npred.predictor(p, 'rk4'), X0=[1.0, 0.0], D=0.5, D_hat=0.5, t_end=5)"
    text = f"import npred; p = npred.plant('van_der_pol'); {loop}"

    def call() -> None:
        with tempfile.TemporaryDirectory() as cache:
            environment = os.environ | {"NPRED_CACHE": cache}
            subprocess.run([sys.executable, "-c", text], env=environment, check=True, capture_output=True)

    return call


def timed(call: Call, count: int) -> float:
    before = time.perf_counter()
    for _ in range(count):
        call()
    return (time.perf_counter() - before) / count


def main() -> None:
    made, ready = operations(), {}
    for line in sys.stdin:
        name = line.strip()
        try:
            if name not in ready:
                call = made[name]()
                call()  # which compiles
                ready[name] = call, max(1, int(BATCH / max(timed(call, 3), 1e-7)))
            answer: float | None = timed(*ready[name])
        except Exception as error:
            print(f"{name}: {type(error).__name__}: {error}", file=sys.stderr)
            answer = None
        print(json.dumps(answer), flush=True)


if __name__ == "__main__":
    main()
