"""An aircraft that takes off and lands vertically, in its plane: thrust and rolling moment arrive late."""

# Upper triangle of the S that solves A' S + S A = -I for four integrators with all poles at -1.
S = {
    (0, 0): 3.125, (0, 1): 4.0, (0, 2): 2.375, (0, 3): 0.5, (1, 1): 8.375,
    (1, 2): 5.5, (1, 3): 1.125, (2, 2): 5.125, (2, 3): 1.0, (3, 3): 0.375,
}  # fmt: skip


class PVTOL:
    """x'' = -u_1 sin θ + ε u_2 cos θ, y'' = u_1 cos θ + ε u_2 sin θ - 1, θ'' = u_2 with u(t - D).

    Position x, y, roll angle θ (rad), thrust u_1 and rolling moment u_2, scaled so that the weight is 1 (Hauser,
    Sastry, Meyer, Automatica 28, 1992, 665-679). The moment's lateral force ε u_2 makes x and y a non-minimum-phase
    output. In the point a = x - ε sin θ, b = y + ε (cos θ - 1) it is gone (Olfati-Saber, IEEE TAC 47, 2002, 1949-1952):
        a'' = -(u_1 - ε θ'²) sin θ,   b'' = (u_1 - ε θ'²) cos θ - 1.
    The thrust makes b'' = r with r = -k² b - 2 k b', so that a'' = -(1 + r) tan θ, and the moment is the one that with
    r = 0 makes a of fourth order with all poles at -k. At |θ| = π/2 no thrust holds the weight, and the law is
    singular. Both commands must be predicted: without them the aircraft falls.
    """

    states = ("x", "y", "theta", "vx", "vy", "omega")
    inputs = ("thrust", "moment")
    labels = {"thrust": "thrust u_1", "moment": "moment u_2", "omega": "roll rate ω"}
    parameters = {"epsilon": 0.5, "k": 1.0}
    box = {"x": (-1.0, 1.0), "y": (-0.5, 0.5), "theta": (-0.2, 0.2), "vx": (-0.2, 0.2), "vy": (-0.2, 0.2),
           "omega": (-0.1, 0.1)}  # fmt: skip

    @staticmethod
    def f(x, u, t, p, M):
        """The dynamics."""
        sin, cos, push = M.sin(x.theta), M.cos(x.theta), p.epsilon * u.moment
        return [x.vx, x.vy, x.omega, -u.thrust * sin + push * cos, u.thrust * cos + push * sin - 1, u.moment]

    @staticmethod
    def kappa(x, t, p, M):
        """The law without delay."""
        a, a_rate, b, b_rate = _free_point(x, p, M)
        cos, slope, k = M.cos(x.theta), M.tan(x.theta), p.k
        climb = -k * k * b - 2 * k * b_rate
        slope_rate = x.omega / cos**2
        bend = k**4 * a + 4 * k**3 * a_rate - 6 * k**2 * slope - 4 * k * slope_rate  # the slope's second derivative
        return [(1 + climb) / cos + p.epsilon * x.omega**2, bend * cos**2 - 2 * x.omega**2 * slope]

    @staticmethod
    def V(x, t, p, M):
        """A sum from the Lyapunov equations of both chains, k = 1, in b, b' and a, a', -tan θ, -(tan θ)'. The climb,
        which disturbs the other chain, counts 40 times: V' < -0.06 V on the box (checked there, not proved beyond).
        """
        a, a_rate, b, b_rate = _free_point(x, p, M)
        chain = [a, a_rate, -M.tan(x.theta), -x.omega / M.cos(x.theta) ** 2]
        climb = 1.5 * b**2 + b * b_rate + 0.5 * b_rate**2
        return 40 * climb + sum((1 if i == j else 2) * s * chain[i] * chain[j] for (i, j), s in S.items())


def _free_point(x, p, M):
    """a, a', b, b': the point that the rolling moment does not accelerate."""
    sin, cos, swing = M.sin(x.theta), M.cos(x.theta), p.epsilon * x.omega
    return x.x - p.epsilon * sin, x.vx - swing * cos, x.y + p.epsilon * (cos - 1), x.vy - swing * sin


PLANTS = {"pvtol": PVTOL}
