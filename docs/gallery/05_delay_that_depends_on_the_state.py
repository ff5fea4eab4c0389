"""
A delay that depends on the state
=================================

The inflow of a tank takes longer if the level is higher. The delay is a part of
the plant: ``delay(x, t, p, M)``. The prediction reaches up to the time when the
command acts, and the loop checks that no command overtakes another.
"""

import npred


class Tank:
    """A level with an outflow in proportion to it."""

    states, inputs, guess = ("level",), ("inflow",), (1.0,)
    box = {"level": (0.2, 2.0)}

    @staticmethod
    def f(x, u, t, p, M):
        return [u.inflow - x.level]

    @staticmethod
    def kappa(x, t, p, M):
        return [1.0 - 3.0 * (x.level - 1.0)]

    @staticmethod
    def delay(x, t, p, M):
        return 0.4 + 0.2 * x.level


tank = npred.plant(Tank)
loops = npred.simulate(
    tank, npred.predictor(tank, "rk4"), X0=[[0.2], [0.6], [2.0]], t_end=8.0
)
axes = loops.plot()
print("commands that overtake others:", int((loops.infeasible >= 0).sum()))
assert abs(loops.X[:, -1] - 1.0).max() < 1e-3
