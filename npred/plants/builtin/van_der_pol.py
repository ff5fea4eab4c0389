"""Van der Pol's oscillator with a force that arrives late."""


class VanDerPol:
    """x1' = x2, x2' = mu (1 - x1²) x2 - x1 + U(t - D).

    Without control the origin is unstable, at a rate of 1/2 for mu = 1, and all else ends on the limit cycle. The law
    U = -6 x1 - 4 x2 makes the loop x1'' + (3 + x1²) x1' + 7 x1 = 0 for mu = 1. Its gains put the poles of
    [[0, 1], [0, -1]] at -2 and -3, those of the plant's own linearisation at -1.5 ± 2.2i: they are those of a public
    code on predictor feedback with D = 1, starts from [-2, 2]².
    """

    states = ("x1", "x2")
    inputs = ("u",)
    parameters = {"mu": 1.0, "k1": 6.0, "k2": 4.0}
    box = {"x1": (-2.0, 2.0), "x2": (-2.0, 2.0)}

    @staticmethod
    def f(x, u, t, p, M):
        """The dynamics."""
        return [x.x2, p.mu * (1 - x.x1**2) * x.x2 - x.x1 + u.u]

    @staticmethod
    def kappa(x, t, p, M):
        """The law without delay, linear."""
        return [-p.k1 * x.x1 - p.k2 * x.x2]

    @staticmethod
    def V(x, t, p, M):
        """X' S X of the Lyapunov equation of the linearised loop of the default parameters: V' < 0 for |x1| < 8.6."""
        return 65 / 42 * x.x1**2 + x.x1 * x.x2 / 7 + 4 / 21 * x.x2**2
