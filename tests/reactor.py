"""A reactor that is cooled: its input is a temperature near 300 K, and 0 K before t = 0 would be no experiment."""


class Reactor:
    """A stirred tank with an exothermic reaction; the water of its jacket arrives late. Time is in seconds."""

    states = ("c", "T")  # concentration in mol/l, temperature in K
    inputs = ("Tc",)  # temperature of the coolant in K
    parameters = {"rate": 1 / 60, "k0": 1.2e9, "E": 8750.0, "heat": 209.205, "jacket": 2.092 / 60, "gain": 5.0}
    box = {"c": (0.4, 0.6), "T": (340.0, 360.0)}
    guess = (0.5, 350.0)
    input_bounds = [(250.0, 350.0)]

    def f(x, u, t, p, M):
        reaction = p.k0 * M.exp(-p.E / x.T) * x.c
        return [p.rate * (1 - x.c) - reaction, p.rate * (350 - x.T) + p.heat * reaction + p.jacket * (u.Tc - x.T)]

    kappa = lambda x, t, p, M: [300.0 - p.gain * (x.T - 350.0)]

    def V(x, t, p, M):
        c, T = x.c - 0.5, x.T - 350.0
        return 2853 * c**2 + 54 * c * T + 2.35 * T**2
