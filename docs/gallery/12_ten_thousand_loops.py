"""
Ten thousand loops
==================

How wrong may D_hat be, and how far from rest may the loop begin? Run it ten
thousand times. Loops of one call run side by side in compiled lanes.
"""

import time

import numpy as np
from matplotlib import pyplot

import npred


class Pendulum:
    """An inverted pendulum with a bounded torque."""

    states, inputs = ("theta", "omega"), ("u",)
    box, guess = {"theta": (-1.0, 1.0), "omega": (-1.0, 1.0)}, (0.0, 0.0)
    input_bounds = ((-10.0, 10.0),)

    @staticmethod
    def f(x, u, t, p, M):
        return [x.omega, 10.0 * M.sin(x.theta) + u.u]

    @staticmethod
    def kappa(x, t, p, M):
        return [-10.0 * M.sin(x.theta) - 4.0 * x.theta - 4.0 * x.omega]


pendulum = npred.plant(Pendulum)
rk4 = npred.predictor(pendulum, "rk4", nx=21)
rng = np.random.default_rng(0)
loops, D = 10_000, 0.3
D_hat = rng.uniform(0.1, 0.5, loops)
X0 = np.stack([rng.uniform(-1, 1, loops), np.zeros(loops)], axis=1)

begin = time.perf_counter()
run = npred.simulate(
    pendulum,
    rk4,
    D=D,
    D_hat=D_hat,
    X0=X0,
    t_end=12.0,
    dt=0.01,
    every=50,
    actuator="history",
)
print(f"{loops} loops in {time.perf_counter() - begin:.1f} s")

# %%
# A loop is kept if the pendulum is near the top at the end. The dashed lines
# are the margin of the linearised loop, ``npred.delay_margin``.

kept = np.abs(run.X[:, -1, 0]) < 0.2
low, high = npred.delay_margin(pendulum, D=D)
_, axis = pyplot.subplots(figsize=(6.4, 4.0), layout="constrained")
for part, colour, label in ((kept, "C0", "kept"), (~kept, "C3", "lost")):
    axis.plot(
        D_hat[part] - D, X0[part, 0], ".", ms=2, color=colour, label=label
    )
for error in (low, high):
    axis.axvline(error, color="black", linestyle="--")
axis.set_xlabel("D_hat - D (s)")
axis.set_ylabel("theta at the start (rad)")
axis.legend(loc="lower left", bbox_to_anchor=(0, 1), ncols=2, markerscale=6)
print(f"kept: {kept.mean():.1%}")
