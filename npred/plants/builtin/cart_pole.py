"""An inverted pendulum on a cart, the textbook's unstable plant."""

# Upper triangle of the S that solves (A + B K)' S + S (A + B K) = -(I + K' K) at the equilibrium of the default
# parameters: the cost-to-go of the regulator, to four decimals.
S = {
    (0, 0): 2.4106, (0, 1): 2.4055, (0, 2): 10.7039, (0, 3): 3.4055, (1, 1): 4.7077,
    (1, 2): 22.3976, (1, 3): 7.1184, (2, 2): 182.7646, (2, 3): 56.7870, (3, 3): 17.8223,
}  # fmt: skip


class CartPole:
    """(mass_cart + mass) p'' + mass length (θ'' cos θ - θ'² sin θ) = F, p'' cos θ + length θ'' = gravity sin θ.

    Cart position p (m) and speed v (m/s), angle theta from upright (rad) and rate omega (rad/s), force F = U(t - D)
    (N); the mass sits at the end of a rod without mass, and nothing rubs. Upright is unstable at a rate of
    sqrt(gravity (1 + mass/mass_cart) / length) = 3.3 1/s: a delay of 0.3 s lets a fall grow e times.
    The gains are those of the linear-quadratic regulator of the linearisation for the default parameters, weights I
    on the state and 1 on F, rounded; other masses and lengths may want others.
    """

    states = ("p", "v", "theta", "omega")
    inputs = ("F",)
    units = {"p": "m", "v": "m/s", "theta": "rad", "omega": "rad/s", "F": "N"}
    parameters = {
        "mass_cart": 1.0, "mass": 0.1, "length": 1.0, "gravity": 9.81,
        "k_p": 1.0, "k_v": 2.4106, "k_theta": 34.3894, "k_omega": 10.7039,
    }  # fmt: skip
    box = {"p": (-0.2, 0.2), "v": (-0.1, 0.1), "theta": (-0.1, 0.1), "omega": (-0.1, 0.1)}

    @staticmethod
    def f(x, u, t, p, M):
        """The dynamics, solved for both accelerations."""
        sin, cos = M.sin(x.theta), M.cos(x.theta)
        push = u.F + p.mass * sin * (p.length * x.omega**2 - p.gravity * cos)
        acceleration = push / (p.mass_cart + p.mass * sin**2)
        return [x.v, acceleration, x.omega, (p.gravity * sin - acceleration * cos) / p.length]

    @staticmethod
    def mechanics(x, u, t, p, M):
        """Mass matrix of (p, theta), forces, and no friction."""
        arm = p.mass * p.length
        inertia = [[p.mass_cart + p.mass, arm * M.cos(x.theta)], [arm * M.cos(x.theta), arm * p.length]]
        return inertia, [u.F + arm * x.omega**2 * M.sin(x.theta), arm * p.gravity * M.sin(x.theta)], [0.0, 0.0]

    @staticmethod
    def kappa(x, t, p, M):
        """The control law without delay, linear."""
        return [p.k_p * x.p + p.k_v * x.v + p.k_theta * x.theta + p.k_omega * x.omega]

    @staticmethod
    def V(x, t, p, M):
        """X' S X of the Lyapunov equation of the linearised loop."""
        return sum((1 if i == j else 2) * s * x[i] * x[j] for (i, j), s in S.items())
