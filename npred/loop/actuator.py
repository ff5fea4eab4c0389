"""The actuator state u(x, t) = U(t + D (x - 1)), the exact solution of D u_t = u_x, u(1, t) = U(t) [DAPF, eqs. 6-7].

The controller holds U over each control step, so the history is piecewise constant and everything here is exact. Rows
of the ring buffers are control steps: `held[k]` is U on [k dt, (k + 1) dt), `total[k]` the sum of U over the steps
before k. D (m, B) has one delay per input. The C of it is npred/kernels/c/actuator.h and hold.h.
"""

import numpy as np

from npred.kernels.kernel import Kernel, made, skeleton
from npred.plants.inputs import Past


def _kernel(name: str, arguments: str, which: int) -> Kernel:
    before = [skeleton("actuator.h"), skeleton("hold.h")]
    return made(name, arguments, skeleton("history.h"), {}, {"WHICH": which}, before=before)


# u(x, k dt) for the delays D: `u` has the mean over each node's cell, `u_nodes` values at the nodes
transport = _kernel("transport", "k, dt, D, held, total, &u, &u_nodes", 0)
# hold U over control step k; what leaves the delay meanwhile is U0 for `share` of the step, then U1
actuate = _kernel("actuate", "k, dt, D, U, &held, &total, &U0, &U1, &share", 1)
# U, the mean of the input that acts during control step k, read from the commands up to that step
acting = _kernel("acting", "k, dt, D, held, &U", 2)


def history(before: float, longest: float, dt: float, past: Past) -> tuple[int, np.ndarray, np.ndarray]:
    """The first step's number, and the ring buffers from `before` t = 0, filled with u0, as long as `longest`."""
    origin, rows = int(before / dt) + 3, int(max(before, longest) / dt) + 4
    commands = past.steps(origin, dt)
    held = np.ascontiguousarray(np.concatenate([commands, np.repeat(commands[-1:], rows - origin, axis=0)]))
    if past.course is None:  # exact sums
        steps = np.arange(rows, dtype=float)[:, None, None]
        return origin, held, steps * held - origin * held
    total = np.concatenate([np.zeros_like(held[:1]), np.cumsum(held[:-1], axis=0)])
    return origin, held, total - total[origin]
