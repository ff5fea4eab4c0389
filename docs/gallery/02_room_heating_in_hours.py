"""
A heated room, in hours
=======================

The heat of a floor reaches the air of a room three quarters of an hour late.
All times of this plant are hours: ``time_unit`` says so to figures and tables.
"""

import numpy as np

import npred


class Room:
    """Air and walls; the floor's heat arrives late, and the outside is cold."""

    states, inputs = ("air", "walls"), ("heat",)
    units = {"air": "°C", "walls": "°C", "heat": "kW"}
    time_unit = "h"
    parameters = {"outside": 0.0, "aim": 21.0, "gain": 4.0}
    box = {"air": (12.0, 24.0), "walls": (10.0, 20.0)}
    input_bounds = ((0.0, 12.0),)
    guess = (21.0, 15.0)

    @staticmethod
    def f(x, u, t, p, M):
        to_walls = 1.5 * (x.air - x.walls)
        out = 0.05 * (x.air - p.outside)
        return [
            2.0 * u.heat - to_walls - out,
            0.3 * to_walls - 0.1 * (x.walls - p.outside),
        ]

    @staticmethod
    def kappa(x, t, p, M):
        # what holds the air where it is, and a share of what is missing
        losses = 1.5 * (x.air - x.walls) + 0.05 * (x.air - p.outside)
        return [0.5 * losses + p.gain * (p.aim - x.air)]


room = npred.plant(Room)
rk4 = npred.predictor(room, "rk4")
evening = {
    "D": 0.75,
    "X0": [15.0, 12.0],
    "t_end": 10.0,
    "dt": 0.01,
    "u0": [0.0],
}

switching = npred.simulate(room, rk4, D_hat=0.0, **evening)
steady = npred.simulate(room, rk4, D_hat=0.75, **evening)
axes = switching.plot(label="law on what is measured")
steady.plot(ax=axes, label="law on what is predicted")

last = slice(-200, None)
print("swing of the air in the last two hours, K:")
print(f"  without prediction {np.ptp(switching.X[last, 0]):.2f}")
print(f"  with prediction    {np.ptp(steady.X[last, 0]):.3f}")
assert np.ptp(steady.X[last, 0]) < 0.1 < np.ptp(switching.X[last, 0])
