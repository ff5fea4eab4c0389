"""
The delay from a recording
==========================

A recording of a heater: commands and temperatures. ``npred.identify`` finds the
delay and the gain, each with an interval of 95 %, and says what the recording
cannot tell.
"""

import numpy as np

import npred


class Heater:
    """The temperature over the room's, of a block that is heated."""

    states, inputs = ("T",), ("power",)
    units = {"T": "K", "power": "W"}
    parameters = {"gain": 1.0, "lag": 20.0}
    box = {"T": (0.0, 40.0)}
    input_bounds = ((0.0, 40.0),)
    guess = (20.0,)

    @staticmethod
    def f(x, u, t, p, M):
        return [(p.gain * u.power - x.T) / p.lag]

    @staticmethod
    def kappa(x, t, p, M):
        return [(20.0 - 3.0 * (x.T - 20.0)) / p.gain]


# %%
# The recording is made here, by formulas: the truth has a gain of 1.2, a delay
# of 7.3 s and a sensor with a noise of 0.1 K.

rng = np.random.default_rng(0)
t = np.arange(0.0, 600.0, 1.0)
power = np.repeat(rng.uniform(5, 35, 20), 30)
fine = np.arange(0.0, 600.0, 0.01)
arriving = power[np.clip(((fine - 7.3) // 1.0).astype(int), 0, None)]
T = np.zeros(len(fine))
for k in range(1, len(fine)):
    T[k] = T[k - 1] + 0.01 * (1.2 * arriving[k - 1] - T[k - 1]) / 20.0
measured = T[::100] + 0.1 * rng.standard_normal(len(t))

# %%
heater = npred.plant(Heater)
result = npred.identify(
    heater, t, power[:, None], measured[:, None], free=["gain", "lag"]
)
print(result)
assert result.identifiable[0] and abs(result.D[0] - 7.3) < 0.2

# %%
# A controller with what was learnt:

known = npred.plant(Heater, **result.parameters)
loop = npred.simulate(
    known,
    npred.predictor(known, "rk4"),
    D=7.3,
    D_hat=result.D[0],
    X0=[2.0],
    t_end=120.0,
    dt=0.1,
    u0=[0.0],
)
axes = loop.plot(D=7.3)
