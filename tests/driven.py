"""A plant whose prediction depends on time even with one delay."""

from npred.plants import Plant


def driven(**parts):
    """x' = U + sin 2t."""

    class Driven:
        states, inputs, box = ("x",), ("U",), {"x": (0.0, 1.0)}

        def f(x, u, t, p, M):
            return [u.U + M.sin(2 * t)]

        def kappa(x, t, p, M):
            return [-x.x]

        def V(x, t, p, M):
            return x.x**2

    return Plant("Driven", type("Changed", (Driven,), parts))
