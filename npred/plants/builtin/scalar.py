"""X' = a X + U(t - D): the plant whose predictor, transition matrix and w are known in closed form."""


class Scalar:
    """The linear plant X' = a X + U(t - D) with U = -(a + c) X, so that X' = -c X without delay.

    P(x) = exp(a D_hat x) X + D_hat ∫₀ˣ exp(a D_hat (x - y)) u(y) dy and Phi(x, y) = exp(a D_hat (x - y)).
    """

    states = ("X",)
    inputs = ("U",)
    parameters = {"a": 0.5, "c": 1.0}
    box = {"X": (-1.0, 1.0)}
    guess = (0.0,)

    @staticmethod
    def f(x, u, t, p, M):
        """The dynamics."""
        return [p.a * x.X + u.U]

    @staticmethod
    def kappa(x, t, p, M):
        """The control law without delay."""
        return [-(p.a + p.c) * x.X]

    @staticmethod
    def V(x, t, p, M):
        """X², with V' = -2 c V along the loop of kappa."""
        return x.X**2
