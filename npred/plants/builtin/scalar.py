"""X' = a X + U(t - D): the plant whose predictor, transition matrix and w are known in closed form."""

from typing import Any


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
    def f(x: Any, u: Any, t: Any, p: Any, M: Any) -> list[Any]:
        """The dynamics."""
        return [p.a * x.X + u.U]

    @staticmethod
    def kappa(x: Any, t: Any, p: Any, M: Any) -> list[Any]:
        """The control law without delay."""
        return [-(p.a + p.c) * x.X]

    @staticmethod
    def V(x: Any, t: Any, p: Any, M: Any) -> Any:
        """X², with V' = -2 c V along the loop of kappa."""
        return x.X**2
