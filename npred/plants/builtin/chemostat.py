"""A continuous stirred bioreactor: biomass fed by substrate, controlled by the dilution rate."""


class Chemostat:
    """Z' = (rho μ(S) - m - u) Z, S' = u (S_in - S) - μ(S) Z: biomass Z, substrate S, dilution rate u = U(t - D) >= 0.

    Haldane growth μ(S) = a S / (1 + S + S²) with a = 7/2, yield rho = 1, mortality m = 1/10, feed S_in = 2 + 10/3 and
    kappa with delta = 10, alpha = 1/2 are those of the delay-adaptive example of Bhan, Krstic and Shi (arXiv
    2509.26443): start (2, 2), D = 1.5, D_hat in [1, 2], gamma = 1. The law is of the kind of Karafyllis, Loko, Krstic
    and Chaillet (arXiv 2502.09310). The set point (Z, S) = (3, 2), u = 9/10 is an equilibrium exactly, since μ(2) = 1
    and 9/10 · 10/3 = 3; with u held there it is a saddle. Units are the publication's, time in seconds. A dilution rate
    cannot be negative; kappa never is.
    """

    states = ("Z", "S")
    inputs = ("u",)
    labels = {"Z": "biomass Z", "S": "substrate S", "u": "dilution rate u"}
    units = {"u": "1/s"}
    parameters = {
        "a": 3.5, "rho": 1.0, "m": 0.1, "S_in": 2 + 10 / 3, "Z_set": 3.0, "S_set": 2.0, "u_set": 0.9, "delta": 10.0,
    }  # fmt: skip
    box = {"Z": (1.0, 4.0), "S": (1.0, 3.0)}
    guess = (3.0, 2.0)
    input_bounds = ((0.0, float("inf")),)

    @staticmethod
    def f(x, u, t, p, M):
        """The dynamics."""
        growth = _growth(x.S, p)
        return [(p.rho * growth - p.m - u.u) * x.Z, u.u * (p.S_in - x.S) - growth * x.Z]

    @staticmethod
    def kappa(x, t, p, M):
        """u* μ(S) Z / (μ* Z*), and where substrate is short, S < S*, delta m |μ(S)/μ* - 1|^(3/2) more.

        Of class C¹: the slope of the second term begins at 0, and is kept from 0/0 where that term vanishes.
        """
        growth, growth_set = _growth(x.S, p), _growth(p.S_set, p)
        gap = M.where(p.S_set > x.S, M.abs(growth / growth_set - 1), 0.0)
        surplus = M.where(gap > 0, M.where(gap > 0, gap, 1.0) ** 1.5, 0.0)
        return [p.u_set * growth * x.Z / (growth_set * p.Z_set) + p.delta * p.m * surplus]

    @staticmethod
    def V(x, t, p, M):
        """|X - set point|²: V' < -0.46 V along the loop of kappa on the box (checked there, not proved beyond)."""
        return (x.Z - p.Z_set) ** 2 + (x.S - p.S_set) ** 2


def _growth(S, p):
    return p.a * S / (1 + S + S**2)
