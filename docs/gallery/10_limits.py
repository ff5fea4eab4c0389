"""
Limits that are kept
====================

A cart on a track of 1 m to either side is sent to 5 cm before the end. Its law
does not know that the track ends. ``npred.SafetyFilter`` changes U as little as
needed, at the predicted state.
"""

import npred


class Cart:
    """A mass on a track."""

    states, inputs = ("x", "v"), ("u",)
    units = {"x": "m", "v": "m/s", "u": "N"}
    box, input_bounds = {"x": (-1.0, 1.0), "v": (-1.0, 1.0)}, ((-5.0, 5.0),)

    @staticmethod
    def f(x, u, t, p, M):
        return [x.v, u.u]

    @staticmethod
    def kappa(x, t, p, M):
        return [-4 * (x.x - 0.95) - 1.2 * x.v]

    @staticmethod
    def safe(x, t, p, M):
        return [1.0 - x.x, 1.0 + x.x]  # each is 0 or more on the track


cart = npred.plant(Cart)
rk4 = npred.predictor(cart, "rk4", nx=31)
loop = {
    "D": 0.3,
    "D_hat": 0.3,
    "X0": [-0.6, 0.2],
    "t_end": 8.0,
    "dt": 0.01,
    "actuator": "history",
    "u0": [0.0],
}
free = npred.simulate(cart, rk4, **loop)
kept = npred.simulate(cart, rk4, safety=npred.SafetyFilter(), **loop)

axes = free.plot(label="law only")
kept.plot(ax=axes, label="with the filter")
axes[0].axhline(1.0, color="black", linestyle=":")
print(f"beyond the track: {-free.safety.min():.2f} m without the filter")
print(f"left of the track: {kept.safety.min():.4f} m with it")
assert free.safety.min() < -0.3 and kept.safety.min() > 0
