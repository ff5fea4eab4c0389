"""
A motor over a network
======================

The commands of a DC motor travel 60 ms through a network. The position is read
by an encoder, late and with losses, and the delay is not known.
"""

import numpy as np

import npred


class Motor:
    """A position loop: the speed follows the voltage with a lag of 50 ms."""

    states, inputs = ("angle", "speed"), ("voltage",)
    units = {"angle": "rad", "speed": "rad/s", "voltage": "V"}
    parameters = {"gain": 40.0, "lag": 0.05}
    box = {"angle": (-2.0, 2.0), "speed": (-20.0, 20.0)}
    input_bounds = ((-12.0, 12.0),)
    guess = (0.0, 0.0)

    @staticmethod
    def f(x, u, t, p, M):
        return [x.speed, (p.gain * u.voltage - x.speed) / p.lag]

    @staticmethod
    def kappa(x, t, p, M):
        return [-1.0 * x.angle - 0.03 * x.speed]


motor = npred.plant(Motor)
heun = npred.predictor(motor, "heun")
network = {
    "D": 0.06,
    "actuator": "history",
    "X0": [1.5, 0.0],
    "t_end": 2.0,
    "dt": 0.002,
    "measurement": npred.Measurement(
        noise=[2e-3, 0.2], period=0.004, drop=0.05
    ),
}

# %%
# Without a prediction (``D_hat=0``) the same law oscillates with growing
# amplitude, up to the limits of the voltage.

bare = npred.simulate(motor, heun, D_hat=0.0, **network)
axes = bare.plot(label="no prediction")

# %%
# With the prediction, a delay law finds the 60 ms from the commands and the
# samples, beginning at 20 ms.

law = npred.DelayObserver(bounds=(0.01, 0.12))
kept = npred.simulate(motor, heun, D_hat=0.02, adaptation=law, **network)
axes = bare.plot(label="no prediction")
kept.plot(ax=axes, label="delay observer")
print(f"D_hat at the end: {1e3 * kept.D_hat[-1]:.1f} ms")
assert abs(kept.D_hat[-1] - 0.06) < 0.004
assert (
    np.abs(kept.X[-200:, 0]).max() < 0.01 < 1 < np.abs(bare.X[-200:, 0]).max()
)
