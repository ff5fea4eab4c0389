"""What a plant costs that is called and not traced: microseconds a control step and loop, beside the same plant traced.

    python benchmarks/black_box.py

A pendulum by NumPy, whose functions take a few microseconds: nearly all is the cost of calls from Python. D = 0.3 s,
dt = 10 ms, the fastest of three runs.
"""

import harness
import numpy as np
from plants import Called, Traced

import npred

LOOPS, METHODS = (1, 64, 1024), {"heun": 21, "rk4": 41, "picard": 41}


def microseconds(plant: npred.plants.Plant, method: str, loops: int, steps: int, adapts: bool) -> float:
    """A control step of one loop out of so many side by side."""
    predictor = npred.predictor(plant, method, nx=METHODS[method])
    law = npred.DelayAdaptation(gamma=1.0, bounds=(0.2, 0.4)) if adapts else None
    X0 = np.linspace(-0.3, 0.3, 2 * loops).reshape(loops, 2)
    settings = {"D": 0.3, "D_hat": 0.3, "X0": X0, "dt": 0.01, "adaptation": law, "progress": False}
    npred.simulate(plant, predictor, t_end=0.02, **settings)  # compiles
    run = lambda: npred.simulate(plant, predictor, t_end=0.01 * steps, **settings)  # noqa: E731
    return min(harness.seconds(run)[0] for _ in range(3)) / steps / loops * 1e6


if __name__ == "__main__":
    traced, called = npred.plant(Traced), npred.plant(Called)
    print("method  nodes  loops   traced    called   times")
    for method, adapts in (*((name, False) for name in METHODS), ("heun", True)):
        for loops in LOOPS:
            fast = microseconds(traced, method, loops, max(20, 20_000 // loops), adapts)
            slow = microseconds(called, method, loops, max(20, 200 // loops), adapts)
            name, times = f"{method:7s} {METHODS[method]:5d} {loops:6d}", f"{slow / fast:6.0f}"
            print(f"{name} {fast:6.2f} us {slow:6.4g} us {times}{'  with the law for D_hat' * adapts}", flush=True)
