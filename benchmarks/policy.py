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

import c_controller
import cortex_m
import harness
import numpy as np
from harness import ROOT

sys.path.insert(0, str(ROOT / "tests"))
policies = import_module("policies")

FLAGS = ["-O2"]


def main() -> None:
    harness.options(__doc__)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        files = policies.every(folder)
        referees = policies.referees(files)
        harness.head("U by", "from onnxruntime", "from the reference")
        for route, U in policies.routes(policies.in_one_law(files), folder).items():
            harness.row(route, *(f"{np.abs(U - referee).max():.1e}" for referee in referees))
        of = cortex_m.learned(folder)
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
