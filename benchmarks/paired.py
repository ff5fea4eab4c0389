"""What became slower or faster since a commit: operations of both, interleaved in one run on one core each.

    python benchmarks/paired.py BASE [--rounds 15] [--only WORDS]

A worktree of the commit BASE is made beside this one, and each compiles into a cache of its own. Per round both trees
run each operation in turn, in an order that alternates; a row is the median time of each, the median of the ratios of
the rounds, and the range of their middle half. A ratio above 1.05 is marked. Networks are untrained, for weights do not
change a time. An operation that a tree lacks prints "–". Operations that take a process (a cold start) run in few
rounds. Run it alone on the machine.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

HERE = Path(__file__).resolve().parent.parent
BATCH, SLOWER = 0.02, 1.05  # s that a batch of calls takes; a ratio above it is marked
FEW = 5  # rounds of an operation that takes longer than LONG
LONG = 0.5  # s
PLANTS = ("activator_repressor", "van_der_pol", "cart_pole", "unicycle", "planar_arm5")
GRIDS = {".01": 101, ".005": 201, ".001": 1001}
LANES = (1, 64)
STEP = r"""
#include "npred.c"
void steps(int count)
{
    static npred_controller c;
    static int ready;
    REAL_OF_C X[NPRED_N_OUTPUTS] = {0}, U[NPRED_M_INPUTS];
    if (!ready) { npred_init(&c); ready = 1; }
    for (int k = 0; k < count; k++) {
        for (int i = 0; i < NPRED_N_OUTPUTS; i++) { X[i] = START[i] * (1 + 0.001 * (k % 10)); }
        npred_step(&c, X, U);
    }
}
"""
Call = Callable[[], Any]
Made = Callable[[], Call]  # of an operation: what is done once, and the call that is timed


def operations() -> dict[str, Made]:
    """The operations by name. They use what a user uses, and the kernels' `bound`, which both trees have."""
    made: dict[str, Made] = {}
    for network in ("deeponet", "fno"):
        for dx, nx in GRIDS.items():
            made[f"{network} fused, kernel, dx {dx}"] = lambda network=network, nx=nx: kernel_of(_fused(network, nx))
    made["deeponet fused in double, kernel, dx .01"] = lambda: kernel_of(_fused("deeponet", 101, np.float64))
    made["kernel of Euler on 4 steps"] = lambda: kernel_of(_numerical("activator_repressor", "euler", 5))
    made["p(X, u, D_hat), rk4"] = lambda: called(_numerical("activator_repressor", "rk4", 101))
    made["guarded p(X, u, D_hat)"] = lambda: called(_guarded())
    made["controller.step, rk4"] = controller_step
    made["exported step, rk4"] = exported_step
    for plant in PLANTS:
        for lanes in LANES:
            name = f"sweep of rk4, {plant}, {lanes} lane{'s' if lanes > 1 else ''}"
            made[name] = lambda plant=plant, lanes=lanes: kernel_of(_numerical(plant, "rk4", 101), lanes)
    for lanes in LANES:
        made[f"loop, 400 steps, {lanes} lane{'s' if lanes > 1 else ''}"] = lambda lanes=lanes: loop(lanes)
    made["generate, 2000 samples"] = generate
    made["cold: first loop with an empty cache"] = cold
    return made


def _fused(network: str, nx: int, precision: type = np.float32) -> Any:
    from npred import plants
    from npred.lab import config
    from npred.networks.fused import Fused
    from npred.networks.weights import untrained

    plant = plants.resolve("activator_repressor")
    weights = untrained(config.Train().table(network), plant, np.random.default_rng(0))
    return Fused(plant, weights, nx, network, precision=precision)


def _numerical(plant: str, method: str, nx: int) -> Any:
    import npred

    return npred.predictor(npred.plant(plant), method, nx=nx)


def _guarded() -> Any:
    import npred

    return npred.guarded(_numerical("activator_repressor", "rk4", 101), tolerance=0.1)


def _sample(predictor: Any, lanes: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """X, u and D_hat near the middle of the plant's box, lanes innermost."""
    plant, rng = predictor.plant, np.random.default_rng(1)
    middle = np.array([sum(plant.box[name]) / 2 for name in plant.states])
    X = middle[:, None] * rng.uniform(0.9, 1.1, (plant.n, lanes)) + 1e-3
    return X, rng.uniform(0.0, 0.1, (predictor.nx, plant.m, lanes)), rng.uniform(0.5, 0.6, lanes)


def kernel_of(predictor: Any, lanes: int = 1) -> Call:
    """The kernel on arrays that are there."""
    X, u, D_hat = _sample(predictor, lanes)
    run, P = predictor.lanes(), np.empty((predictor.nx, predictor.plant.n, lanes))
    return run.bound(X, u, D_hat, 0.0, predictor.plant.p, P)


def called(predictor: Any) -> Call:
    """The predictor, called from Python with one sample."""
    X, u, D_hat = (a[..., 0] for a in _sample(predictor, 1))
    return lambda: predictor(X, u, D_hat)


def _controller() -> Any:
    import npred

    predictor = _numerical("van_der_pol", "rk4", 101)
    law = npred.DelayAdaptation(bounds=(0.1, 1.0))
    return npred.controller(predictor.plant, predictor, law, 0.02, D_hat=0.5, actuator="history")


def controller_step() -> Call:
    controller, X = _controller(), np.array([0.1, 0.2])
    return lambda: controller.step(X)


def exported_step() -> Call:
    """Ten steps of a controller in C, through one call."""
    import ctypes

    from npred.exports import c_controller

    folder = Path(tempfile.mkdtemp())
    for file, text in zip(("npred.h", "npred.c"), c_controller.sources(_controller()), strict=True):
        (folder / file).write_text(text)
    kind = "float" if "float *U" in (folder / "npred.h").read_text() else "double"
    text = STEP.replace("REAL_OF_C", kind).replace("START[i]", "0.1")
    (folder / "steps.c").write_text(text)
    flags = ["-std=gnu99", "-O3", "-march=native", "-shared", "-fPIC"]
    subprocess.run(["cc", *flags, "steps.c", "-o", "steps.so", "-lm"], cwd=folder, check=True)
    function = ctypes.CDLL(str(folder / "steps.so")).steps
    return lambda: function(10)


def loop(lanes: int) -> Call:
    import npred

    predictor = _numerical("activator_repressor", "rk4", 101)
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


def work(tree: str) -> None:
    """Answer lines: the name of an operation by the seconds of its call, or null where it cannot be made."""
    import npred

    assert Path(npred.__file__).is_relative_to(tree), f"expected npred of {tree}, got {npred.__file__}"
    made, ready = operations(), {}
    for line in sys.stdin:
        name = line.strip()
        try:
            if name not in ready:
                call = made[name]()
                call()  # which compiles
                ready[name] = call, max(1, int(BATCH / max(_timed(call, 3), 1e-7)))
            answer: float | None = _timed(*ready[name])
        except Exception as error:
            print(f"{name}: {error}", file=sys.stderr)
            answer = None
        print(json.dumps(answer), flush=True)


def _timed(call: Call, count: int) -> float:
    before = time.perf_counter()
    for _ in range(count):
        call()
    return (time.perf_counter() - before) / count


class Tree:
    """A process that works for one tree, by the tree's script, which knows its modules, with a separate cache."""

    def __init__(self, tree: Path, cache: Path) -> None:
        environment = os.environ | {"PYTHONPATH": str(tree), "NPRED_CACHE": str(cache), "OMP_NUM_THREADS": "1"}
        script = tree / "benchmarks" / "paired.py"
        command = [sys.executable, str(script if script.exists() else Path(__file__).resolve()), "--work", str(tree)]
        pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
        self.process = subprocess.Popen(command, cwd=cache, env=environment, text=True, **pipes)

    def seconds(self, name: str) -> float | None:
        """Those of one call."""
        assert self.process.stdin is not None and self.process.stdout is not None
        print(name, file=self.process.stdin, flush=True)
        return json.loads(self.process.stdout.readline())


def rows(trees: list[Tree], rounds: int, only: str) -> Iterator[str]:
    """The rows of the table: base, here, the ratio and the range of its middle half."""
    for name in operations():
        if only not in name:
            continue
        first = [tree.seconds(name) for tree in trees]
        times = []
        for turn in range(FEW if max(s or 0.0 for s in first) > LONG else rounds):
            if None in first:
                break
            order = trees if turn % 2 else trees[::-1]
            taken = {id(tree): tree.seconds(name) for tree in order}
            times.append([taken[id(tree)] for tree in trees])
        if not times:
            yield f"| {name} | {' | '.join('–' if s is None else f'{1e6 * s:.2f}' for s in first)} | – | – | |"
            continue
        base, here = np.array(times).T
        ratio, (low, high) = np.median(here / base), np.quantile(here / base, (0.25, 0.75))
        mark = "slower" if ratio > SLOWER else ""
        yield (
            f"| {name} | {1e6 * np.median(base):.2f} | {1e6 * np.median(here):.2f} | {ratio:.2f} |"
            f" {low:.2f} to {high:.2f} | {mark} |"
        )


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("base", nargs="?", default="HEAD~1")
    parser.add_argument("--rounds", type=int, default=15)
    parser.add_argument("--only", default="")
    parser.add_argument("--work", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.work:
        return work(options.work)
    with tempfile.TemporaryDirectory() as folder:
        tree = Path(folder) / "base"
        git = ["git", "-C", str(HERE), "worktree"]
        subprocess.run([*git, "add", "--quiet", "--detach", str(tree), options.base], check=True)
        try:
            caches = [Path(folder) / name for name in ("cache_base", "cache_here")]
            for cache in caches:
                cache.mkdir()
            trees = [Tree(tree, caches[0]), Tree(HERE, caches[1])]
            print(f"| µs | {options.base} | here | ratio | its middle half | |\n|---|---|---|---|---|---|", flush=True)
            for row in rows(trees, options.rounds, options.only):
                print(row, flush=True)
        finally:
            subprocess.run([*git, "remove", "--force", str(tree)], check=True)


if __name__ == "__main__":
    main()
