"""
A quadrotor's altitude
======================

The thrust of a quadrotor answers 0.25 s late: radio, filter and motors. The law
has no formula here: ``npred.laws.lqr`` designs it from ``f``.
"""

import npred


class Altitude:
    """Height and climb of 1.2 kg, with the drag of the frame."""

    states, inputs = ("height", "climb"), ("thrust",)
    units = {"height": "m", "climb": "m/s", "thrust": "N"}
    parameters = {"mass": 1.2, "drag": 0.1}
    box = {"height": (-1.0, 1.0), "climb": (-1.0, 1.0)}
    input_bounds = ((0.0, 24.0),)
    guess = (0.0, 0.0)

    @staticmethod
    def f(x, u, t, p, M):
        drag = p.drag * x.climb * M.abs(x.climb)
        return [x.climb, (u.thrust - drag) / p.mass - 9.81]


# The weights of height and climb, and of the thrust.
costs = {"law": "lqr", "Q": [100.0, 1.0], "R": [0.1]}
drone = npred.plant(Altitude, kappa=costs)
rk4 = npred.predictor(drone, "rk4")
low, high = npred.delay_margin(drone, D=0.25)
print(f"the loop bears an error of D_hat from {low:+.3f} to {high:+.3f} s")

flight = {
    "D": 0.25,
    "X0": [-1.0, 0.0],
    "t_end": 6.0,
    "dt": 0.005,
    "u0": "equilibrium",
}
axes = npred.simulate(drone, rk4, D_hat=0.0, **flight).plot(label="D_hat = 0")
for D_hat in (0.15, 0.25):
    npred.simulate(drone, rk4, D_hat=D_hat, **flight).plot(
        ax=axes, label=f"D_hat = {D_hat}"
    )
