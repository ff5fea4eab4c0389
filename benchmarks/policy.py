"""A policy as the law: U of twenty policies by each route, and what a step with one of 64 x 64 costs.

    python benchmarks/policy.py

The policies are those of tests/policies.py. Differences of U are from onnxruntime, which computes in float, and from
ONNX's reference in double. A step is that of an exported controller whose predictor is RK4 on 21 nodes: its time on
this machine with -O2, and flash, RAM, stack and instructions on a Cortex-M in QEMU (benchmarks/cortex_m.py).
"""

import os
import subprocess
import sys
import tempfile
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any

import c_controller
import cortex_m
import harness
import numpy as np
from harness import ROOT

import npred

sys.path.insert(0, str(ROOT / "tests"))
policies = import_module("policies")

FLAGS = ["-O2"]


def controller(folder: Path) -> Any:
    """The controller of a pendulum whose law is a policy of 64 x 64."""
    plant = type("Pendulum", (), {
        "states": ("angle", "rate"), "inputs": ("torque",), "box": {"angle": (-1.0, 1.0), "rate": (-1.0, 1.0)},
        "f": lambda x, u, t, p, M: [x.rate, M.sin(x.angle) - 0.2 * x.rate + u.torque],
        "observation": lambda x, u, t, p, M: [M.cos(x.angle), M.sin(x.angle), x.rate],
    })  # fmt: skip
    policies.TORCH["pendulum"] = lambda: policies.mlp([3, 64, 64, 1], policies.nn.Tanh)
    plant = npred.plant(plant, kappa=str(policies.of_torch("pendulum", folder)))
    return npred.controller(plant, npred.predictor(plant, "rk4", 21), None, 0.02, D_hat=0.2)


def main() -> None:
    harness.options(__doc__)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        files = policies.every(folder)
        referees = policies.referees(files)
        harness.head("U by", "from onnxruntime", "from the reference")
        for route, U in policies.routes(policies.in_one_law(files), folder).items():
            harness.row(route, *(f"{np.abs(U - referee).max():.1e}" for referee in referees))
        of = controller(folder)
        harness.head("precision", "µs", "s to compile", "flash KiB", "RAM KiB", "stack B", "instructions", "difference")
        for precision in cortex_m.BOARDS:
            cortex_m.write(of, precision, folder)
            compile_it = partial(subprocess.run, ["cc", *FLAGS, "-c", "npred.c"], cwd=folder, check=True)
            compiled, _ = harness.seconds(compile_it, lambda: os.times().children_user)
            here = c_controller.measure(folder, FLAGS, c_controller.PLAIN)["median_us"]
            row = cortex_m.measure(folder, precision)
            sizes = f"{row['flash'] / 1024:.1f}", f"{row['ram'] / 1024:.1f}", f"{row['stack']:.0f}"
            there = f"{row['instructions']:.0f}", f"{row['difference']:.1e}"
            harness.row(precision, here, f"{compiled:.1f}", *sizes, *there)


if __name__ == "__main__":
    main()
