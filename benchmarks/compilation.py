"""How long a plant takes from an empty cache of kernels, and from a full one, to the first step of the adaptive loop.

    python benchmarks/compilation.py [PLANT ...]

A plant is a name or my_plant.py:Tank; by default some built-in ones and the six-joint arm of the tests' URDF file. The
engine, which serves every plant, is compiled beforehand. Each time is of a process of its own, its imports left out.
"""

import os
import subprocess
import sys
import tempfile
from pathlib import Path

from npred.terminal.console import columns

HERE = Path(__file__).resolve().parent
PLANTS = ("activator_repressor", "planar_arm2", "planar_arm5", "planar_arm7")
URDF = """\
from npred.robots.chain import chain

Arm = chain({path!r})
"""
STEP = """\
import sys, time
import npred
from npred.loop.closed_loop import simulate

start = time.perf_counter()
plant = npred.plant(sys.argv[1])
X0 = [sum(span) / 2 for span in plant.box.values()]
law = npred.DelayAdaptation(gamma=1.0, bounds=(0.1, 0.5))
simulate(plant, npred.predictor("rk4", plant, 11), D=0.2, D_hat=0.3, X0=X0, t_end=0.01, dt=0.01, adaptation=law)
print(time.perf_counter() - start)
"""


def seconds(plant: str, cache: str) -> float:
    """To the first step, in a process of its own."""
    command = [sys.executable, "-c", STEP, plant]
    done = subprocess.run(command, env=os.environ | {"NPRED_CACHE": cache}, stdout=subprocess.PIPE, check=True)
    return float(done.stdout)


def main() -> None:
    """Print the table."""
    with tempfile.TemporaryDirectory() as folder:
        arm = Path(folder, "six_joint.py")
        arm.write_text(URDF.format(path=str(HERE.parent / "tests" / "six_joint.urdf")))
        plants = sys.argv[1:] or [*PLANTS, f"{arm}:Arm"]
        seconds("scalar", folder)
        rows = []
        for plant in plants:
            cache = tempfile.mkdtemp(dir=folder)
            rows.append([Path(plant).name, f"{seconds(plant, cache):.1f}", f"{seconds(plant, cache):.2f}"])
    print(columns(["plant", "cold [s]", "warm [s]"], rows))


if __name__ == "__main__":
    main()
