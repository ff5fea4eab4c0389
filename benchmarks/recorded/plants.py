"""The simplest physical plants of the recordings that README.md here lists, with parameters at rough values."""


class Heater:
    """A heated block and its sensor, duty Q of 255, temperature T in K: tau T' = gain Q - (T - ambient)."""

    states = ("T",)
    inputs = ("Q",)
    units = {"T": "K", "Q": "1/255"}
    parameters = {"tau": 150.0, "gain": 0.4, "ambient": 300.0, "target": 330.0, "strength": 2.0}
    box = {"T": (300.0, 345.0)}
    guess = (330.0,)

    def f(x, u, t, p, M):
        return [(p.gain * u.Q - (x.T - p.ambient)) / p.tau]

    def kappa(x, t, p, M):
        return [(p.target - p.ambient - p.strength * (x.T - p.target)) / p.gain]

    def V(x, t, p, M):
        return (x.T - p.target) ** 2


class HeaterFahrenheit(Heater):
    """The same, another board, T in °F."""

    units = {"T": "°F", "Q": "1/255"}
    parameters = {"tau": 150.0, "gain": 0.25, "ambient": 74.0, "target": 110.0, "strength": 2.0}
    box = {"T": (74.0, 130.0)}
    guess = (110.0,)


class HeaterSensor:
    """The block B and a sensor T that lags behind it: the rival of `Heater` with a dead time; T is measured."""

    states = ("T", "B")
    inputs = ("Q",)
    units = {"T": "K", "B": "K", "Q": "1/255"}
    parameters = {"tau": 150.0, "lag": 15.0, "gain": 0.4, "ambient": 300.0, "target": 330.0, "strength": 1.0}
    box = {"T": (300.0, 345.0), "B": (300.0, 345.0)}
    guess = (330.0, 330.0)

    def f(x, u, t, p, M):
        return [(x.B - x.T) / p.lag, (p.gain * u.Q - (x.B - p.ambient)) / p.tau]

    def kappa(x, t, p, M):
        return [(p.target - p.ambient - p.strength * (x.B - p.target)) / p.gain]


class Buck:
    """A buck converter's output filter: voltage v, its rate r in V/ms; v falls as the control voltage u rises."""

    states = ("v", "r")
    inputs = ("u",)
    units = {"v": "V", "r": "V/ms", "u": "V"}
    time_unit = "ms"
    parameters = {"w": 4.0, "zeta": 0.6, "gain": -8.0, "v0": 13.0, "u0": 2.35, "strength": 0.05}
    box = {"v": (11.5, 16.0), "r": (-5.0, 5.0)}
    guess = (13.0, 0.0)

    def f(x, u, t, p, M):
        return [x.r, p.w**2 * (p.v0 + p.gain * (u.u - p.u0) - x.v) - 2 * p.zeta * p.w * x.r]

    def kappa(x, t, p, M):
        return [p.u0 + p.strength * (x.v - p.v0)]
