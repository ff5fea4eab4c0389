"""The activator/repressor clock of two proteins, the plant of [DAPF, sec. V]."""


class ActivatorRepressor:
    """x1' = -x1 + f1(x1, x2) + U(t - D), x2' = -x2/2 + f2(x1): concentrations of activator and repressor protein.

    Hill functions f1 = (K1 x1² + Ka)/(1 + x1² + x2²), f2 = (K2 x1² + Kb)/(1 + x1²) [DAPF, sec. V]. The control law
    replaces f1 by its value at the set point: x1 then decays to it at rate 1 and x2 follows at rate 1/2. The set point
    is rounded as in [DAPF]; the equilibrium of kappa is near it and is solved, not typed.
    """

    states = ("x1", "x2")
    inputs = ("U",)
    figure = "DAPF, Fig. 1"
    parameters = {
        "K1": 300.0, "K2": 300.0, "Ka": 0.04, "Kb": 0.004, "x1_set": 0.0939, "x2_set": 5.2525,
    }  # fmt: skip
    box = {"x1": (0.01, 0.05), "x2": (25.0, 35.0)}
    guess = (0.0939, 5.2525)

    @staticmethod
    def f(x, u, t, p, M):
        """The dynamics; U drives x1 only."""
        repression = (p.K2 * x.x1**2 + p.Kb) / (1 + x.x1**2)
        return [-x.x1 + _f1(x.x1, x.x2, p) + u.U, -x.x2 / 2 + repression]

    @staticmethod
    def kappa(x, t, p, M):
        """The control law without delay [DAPF, sec. V]."""
        return [_f1(p.x1_set, p.x2_set, p) - _f1(x.x1, x.x2, p)]

    @staticmethod
    def V(x, t, p, M):
        """|X - set point|² as in [DAPF]; a normaliser, not a Lyapunov function of the loop (docs/fidelity.md)."""
        return (x.x1 - p.x1_set) ** 2 + (x.x2 - p.x2_set) ** 2


def _f1(x1, x2, p):
    return (p.K1 * x1**2 + p.Ka) / (1 + x1**2 + x2**2)
