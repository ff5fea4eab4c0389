"""A wheeled robot that cannot move sideways; its commands to turn and to drive arrive unequally late."""

import math


class Unicycle:
    """x' = v cos θ, y' = v sin θ, θ' = ω: position x, y (m) and heading theta (rad); turning rate ω = U_1(t - D_1)
    (rad/s) and speed v = U_2(t - D_2) (m/s), with D_1 = 0.25 s and D_2 = 0.6 s.

    No continuous law of the state alone brings it to rest at a pose (Brockett 1983). This one depends on time, with
    p = x cos θ + y sin θ and q = x sin θ - y cos θ:
        ω = -5 p² cos 3t - p q (1 + 25 cos² 3t) - θ,   v = -p + 5 q (sin 3t - cos 3t) + q ω.
    It is of the kind of Pomet (Systems & Control Letters 18, 1992, 147-158), and the example of predictor feedback for
    one delay (Bekiaris-Liberis and Krstic, doi:10.1115/1.4005278) and for two (IEEE TAC 62, 2017, 516-531).
    From every pose it leads to the origin, at rest there for every t, but not exponentially: along y the linearised
    loop does not move, and |X| falls as 1/sqrt(t). V is a squared distance, no Lyapunov function: it rises and falls.
    """

    states = ("x", "y", "theta")
    inputs = ("omega", "v")
    units = {"x": "m", "y": "m", "theta": "rad", "omega": "rad/s", "v": "m/s"}
    delays = (0.25, 0.6)
    period = 2 * math.pi / 3
    box = {"x": (-1.0, 1.0), "y": (-1.0, 1.0), "theta": (-1.0, 1.0)}

    @staticmethod
    def f(x, u, t, p, M):
        """The kinematics."""
        return [u.v * M.cos(x.theta), u.v * M.sin(x.theta), u.omega]

    @staticmethod
    def kappa(x, t, p, M):
        """The control law without delay."""
        sin, cos = M.sin(x.theta), M.cos(x.theta)
        ahead, aside = x.x * cos + x.y * sin, x.x * sin - x.y * cos
        sway, swing = M.sin(3 * t), M.cos(3 * t)
        omega = -5 * ahead**2 * swing - ahead * aside * (1 + 25 * swing**2) - x.theta
        return [omega, -ahead + 5 * aside * (sway - swing) + aside * omega]

    @staticmethod
    def reference(t, p, M):
        """The pose to come to."""
        return [0.0, 0.0, 0.0]

    @staticmethod
    def V(x, t, p, M):
        """The squared distance from the origin."""
        return x.x**2 + x.y**2 + x.theta**2


class UnicycleTimeDelay(Unicycle):
    """The unicycle with both commands late by D(t) = (1 + a t) / (1 + b t): 1 s at first, then less, towards a / b.

    The command of time t acts at sigma(t), the solution of s = t + D(s),
        sigma(t) = (a + b t - 1 + sqrt((a + b t - 1)² + 4 b (1 + t))) / (2 b),
    0.71 s after t = 0, and soon 0.5 s later. The example of Bekiaris-Liberis and Krstic (doi:10.1115/1.4005278).
    The prediction depends on the time by D(t) alone, which tells it; so no period is declared.
    """

    parameters = {"a": 1.0, "b": 2.0}
    delays = period = None

    @staticmethod
    def delay(x, t, p, M):
        """D(t), in seconds."""
        return (1 + p.a * t) / (1 + p.b * t)


class SlowUnicycle(Unicycle):
    """The unicycle with D_1 = 0.5 s and D_2 = 1 s, and a law with unit gains that swings with cos t:
        ω = -p² cos t - p q (1 + cos² t) - θ,   v = -p + q (sin t - cos t) + q ω.

    The example of Bekiaris-Liberis and Krstic, IEEE TAC 62 (2017) 516-531, from (0.5, 0.5, 0.5) with no command before.
    """

    delays = (0.5, 1.0)
    period = 2 * math.pi
    box = {"x": (-0.5, 0.5), "y": (-0.5, 0.5), "theta": (-0.5, 0.5)}

    @staticmethod
    def kappa(x, t, p, M):
        """The control law without delay."""
        sin, cos = M.sin(x.theta), M.cos(x.theta)
        ahead, aside = x.x * cos + x.y * sin, x.x * sin - x.y * cos
        sway, swing = M.sin(t), M.cos(t)
        omega = -(ahead**2) * swing - ahead * aside * (1 + swing**2) - x.theta
        return [omega, -ahead + aside * (sway - swing) + aside * omega]


PLANTS = {"unicycle": Unicycle, "unicycle_time_delay": UnicycleTimeDelay, "slow_unicycle": SlowUnicycle}
