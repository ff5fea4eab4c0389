"""Loops that between them have all parts, with a given compiler or more flags; their results go to a file.

python tests/all_loops.py OUT.npz "FLAGS" [COMPILER ...]
"""

import sys

import numpy as np
from operator_samples import PLANT, SMALL, operator

import npred
from npred.kernels import compiler
from npred.networks.fused import Fused


class Cart:
    """It slows down near a wall."""

    states, inputs, box = ("x", "v"), ("a",), {"x": (-1.0, 1.0), "v": (-0.5, 0.5)}
    input_bounds = ((-2.0, 2.0),)

    def f(x, u, t, p, M):
        return [x.v, u.a]

    def kappa(x, t, p, M):
        return [-4 * (x.x - 0.5) - 2 * x.v]

    def safe(x, t, p, M):
        return [0.3 - x.v]


def loops():
    """A plant, the options of its loop, and the predictor where it is no other one."""
    of, cart = npred.plant, npred.plant(Cart)
    slow, observer = of("slow_unicycle"), npred.DelayObserver(bounds=(0.1, 1.0))
    sensors = npred.Measurement(noise=[0.1, 0.0], relative_noise=0.01, bias=0.1, period=0.1, resolution=[0.0, 0.01],
                                jitter=0.5, delay=0.04, drop=0.1)  # fmt: skip
    rare = npred.Measurement(noise=0.01, period=0.05, jitter=0.5, delay=0.04, drop=0.3)
    known, stored = {"D": 0.5, "D_hat": 0.4}, {"actuator": "history"}
    yield of("scalar"), known | {"adaptation": npred.DelayAdaptation(bounds=(0.1, 1.0))}
    yield of("van_der_pol"), known | stored | {"adaptation": observer, "measurement": sensors}
    yield of("unicycle"), known | stored
    yield slow, {
        "D": lambda t: 0.5 + 0.1 * np.sin(9 * t), "D_hat": 0.5, **stored, "u0": "law",
        "timing": npred.Timing(jitter=0.4, lost=0.2, overrun=0.2, tells=True), "measurement": rare,
        "observer": npred.observers.EKF(slow, offset=True), "watchdog": npred.Watchdog(0.1, "zero", jump=0.1),
    }  # fmt: skip
    yield of("unicycle_time_delay"), {}
    yield of("chemostat"), {"D": lambda t: 0.5 + 0.1 * np.sin(t), "D_hat": 0.5, "disturbance": lambda t: [0.01]}
    yield cart, {"D": 0.2, "D_hat": 0.2, **stored, "u0": [0.0], "safety": npred.SafetyFilter(3.0)}
    yield PLANT, {"D": 0.2, "D_hat": 0.2}, Fused(PLANT, operator(SMALL[0]).double(), 21, precision=np.float64)


def results():
    """X, U and D_hat of each, by the number of the loop and the plant."""
    found = {}
    for number, (plant, options, *network) in enumerate(loops()):
        low, high = np.array([plant.box.get(state, (-0.1, 0.1)) for state in plant.states]).T
        model = network[0] if network else npred.guarded(npred.predictor(plant, "heun", nx=21), 0.01)
        X0 = low + (high - low) * np.linspace(0.4, 0.6, 3)[:, None]
        loop = npred.simulate(plant, model, X0=X0, t_end=2.0, dt=0.02, **options)
        found |= {f"{number} {plant.name} {name}": getattr(loop, name) for name in ("X", "U", "D_hat")}
    return found


if __name__ == "__main__":
    target, flags, *words = sys.argv[1:]
    if words:
        compiler.found = lambda: tuple(words)
    compiler.FLAGS = (*compiler.FLAGS, *flags.split())
    np.savez(target, **results())
