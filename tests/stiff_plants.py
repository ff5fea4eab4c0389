"""Stiff plants for tests."""

import numpy as np


class Oscillator:
    """Van der Pol's equation, late input; stiff for a large mu."""

    states, inputs, parameters, guess = ("x", "v"), ("u",), {"mu": 200.0}, (0.0, 0.0)
    f = lambda x, u, t, p, M: [x.v, p.mu * (1 - x.x**2) * x.v - x.x + u.u]
    kappa = lambda x, t, p, M: [-x.x - x.v]


class Lag:
    """A fast lag that follows a moving goal and its input, and a slow state behind it: stiff, linear, and clocked."""

    states, inputs, parameters = ("fast", "slow"), ("u",), {"rate": 2000.0}
    period = 2 * np.pi
    f = lambda x, u, t, p, M: [-p.rate * (x.fast - M.cos(t) - u.u) + 0.1 * x.slow, x.fast - 2 * x.slow]
    kappa = lambda x, t, p, M: [-0.1 * x.slow + 0.1 * M.sin(t)]
    reference = lambda t, p, M: [M.cos(t), M.cos(t)]


class Sprung:
    """A mass on a spring and a stiff damper; its rate is declared before its position."""

    states, inputs, parameters = ("v", "q"), ("u",), {"drag": 3000.0, "spring": 1.0}
    f = lambda x, u, t, p, M: [(u.u - M.sin(x.q) - p.drag * x.v) / 2.0, x.v]
    mechanics = lambda x, u, t, p, M: ([[2.0]], [u.u - p.spring * M.sin(x.q)], [p.drag])
    kappa = lambda x, t, p, M: [-x.q]
