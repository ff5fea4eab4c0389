"""Fig. 1's loop with each runtime of a trained network: microseconds a control step, and where the loop ends.

    python benchmarks/closed_loop.py [MODEL] [--store DIR]

100 s of 5 ms, adaptation on, one thread. The radius is sup |X - X*| over the last 10 s.
"""

import harness
import numpy as np
import torch

import npred
from npred import networks as runtimes

T_END, DT, NX = 100.0, 0.005, 101


def row(name: str, predictor, plant) -> str:
    """A line of the table."""
    law = npred.DelayAdaptation(gamma=1000.0, b=1.0, bounds=(0.1, 4.0))
    loop = {"D": 1.0, "D_hat": 2.0, "X0": [0.03, 30.0], "dt": DT, "adaptation": law}
    npred.simulate(plant, predictor, t_end=10 * DT, **loop)  # compiles
    seconds, done = harness.seconds(lambda: npred.simulate(plant, predictor, t_end=T_END, **loop))
    step = seconds / len(done.t) * 1e6
    radius = np.linalg.norm(done.X[-round(10 / DT) :] - plant.equilibrium, axis=-1).max()
    return f"{name:14s}{step:9.1f} us a step   radius {radius:.1e}   D_hat {done.D_hat[-1]:.4f}"


if __name__ == "__main__":
    asked = harness.options(__doc__, {"model": harness.PAPER}, store=str)
    torch.set_num_threads(1)
    networks = {
        name: npred.load(asked.model, store=asked.store, nx=NX, runtime=name) for name in runtimes.RUNTIMES.builtin
    }
    plant = networks["torch"].plant
    for name, predictor in {"rk4": npred.predictor(plant, "rk4", NX), **networks}.items():
        print(row(name, predictor, plant), flush=True)
