"""A tank with self-heating contents, whose feed comes through a long pipe the slower the fuller the tank is."""


class TransportTank:
    """h' = (a v - k √h) / A, T' = a v (u - T) / (A h) + s T, v = w √(H - h): level h, temperature T, delay L / v.

    A reservoir of head H feeds the tank by gravity; u is the temperature to which the feed is brought at the far end of
    the pipe, L metres away, and that arrives D = L / v later: the pipe's speed is taken as it is on arrival. T and u
    are relative to the reservoir's. The contents heat themselves at the rate s, faster than the feed cools them
    (s > a v / (A h) at the set point): without control T runs away. The law makes T' = -c (T - T_set) without delay.
    The level settles by itself at H / 2 = 2 m within minutes, and moves the delay between 1.6 and 2.4 minutes in the
    box, in which 1 - D_X f > 0.9. Time is in minutes.
    """

    states = ("h", "T")
    inputs = ("u",)
    labels = {"h": "level h", "T": "temperature T", "u": "feed temperature u"}
    units = {"h": "m", "T": "K", "u": "K"}
    time_unit = "min"
    parameters = {
        "L": 40.0, "w": 15.0, "H": 4.0, "a": 0.06, "A": 2.0, "k": 0.9, "s": 0.5, "c": 0.5, "T_set": 20.0,
    }  # fmt: skip
    box = {"h": (1.2, 2.8), "T": (15.0, 25.0)}
    guess = (2.0, 20.0)

    @staticmethod
    def f(x, u, t, p, M):
        """The dynamics."""
        feed = p.a * _speed(x, p, M)
        return [(feed - p.k * M.sqrt(x.h)) / p.A, feed * (u.u - x.T) / (p.A * x.h) + p.s * x.T]

    @staticmethod
    def kappa(x, t, p, M):
        """The law without delay."""
        minutes = p.A * x.h / (p.a * _speed(x, p, M))  # minutes of feed in the tank
        return [x.T - minutes * (p.s * x.T + p.c * (x.T - p.T_set))]

    @staticmethod
    def V(x, t, p, M):
        """(h - H / 2)² + (T - T_set)²: both states come to rest by themselves along the law's loop."""
        return (x.h - p.H / 2) ** 2 + (x.T - p.T_set) ** 2

    @staticmethod
    def delay(x, t, p, M):
        """L / v(h), in minutes."""
        return p.L / _speed(x, p, M)


def _speed(x, p, M):
    return p.w * M.sqrt(p.H - x.h)
