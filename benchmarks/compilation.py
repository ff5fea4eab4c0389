"""How long a plant's first predictor call and first adaptive loop take, from an empty cache of kernels and a full one.

    python benchmarks/compilation.py [PLANT ...]

A plant is a name or my_plant.py:Tank; by default some built-in ones and the six-joint arm of the tests' URDF file. Each
row is of processes of their own, the first with an empty folder of all caches: `wall` is the whole process, interpreter
and imports included, `call` the predictor's call, or the loop, alone.
"""

import os
import subprocess
import sys
import tempfile
from pathlib import Path

import harness

from npred.lab.report.terminal.console import columns

PLANTS = ("activator_repressor", "planar_arm2", "planar_arm5", "planar_arm7")
URDF = """\
from npred_robots.chain import chain

Arm = chain({path!r})
"""
CALL = """\
import sys, time
import numpy as np
import npred

plant = npred.plant(sys.argv[1])
rk4 = npred.predictor(plant, "rk4", 101)
X0 = [sum(span) / 2 for span in plant.box.values()]
start = time.perf_counter()
"""
FIRST = {
    "call": "rk4(X0, np.zeros((101, plant.m)), 0.2)\n",
    "loop": """\
law = npred.DelayAdaptation(gamma=1.0, bounds=(0.1, 0.5))
npred.simulate(plant, rk4, D=0.2, D_hat=0.3, X0=X0, t_end=1.0, dt=0.01, adaptation=law)
""",
}


def seconds(plant: str, what: str, cache: str) -> tuple[float, float]:
    """Of the whole process, and of the call alone."""
    script = CALL + FIRST[what] + "print(time.perf_counter() - start)"
    environment = {name: value for name, value in os.environ.items() if name != "NPRED_CACHE"}
    words, named = [sys.executable, "-c", script, plant], {"env": environment | {"XDG_CACHE_HOME": cache}}
    whole, call = harness.seconds(lambda: subprocess.check_output(words, **named))
    return whole, float(call)


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as folder:
        arm = Path(folder, "six_joint.py")
        arm.write_text(URDF.format(path=str(harness.ROOT / "siblings" / "npred_robots" / "tests" / "six_joint.urdf")))
        rows = []
        for plant in sys.argv[1:] or [*PLANTS, f"{arm}:Arm"]:
            for what in FIRST:
                cache = tempfile.mkdtemp(dir=folder)
                times = [f"{t:.2f}" for _ in ("cold", "warm") for t in seconds(plant, what, cache)]
                rows.append([Path(plant).name, what, *times])
    print(columns(["plant", "first", "cold wall [s]", "cold call [s]", "warm wall [s]", "warm call [s]"], rows))
