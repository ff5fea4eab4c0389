"""A plant whose prediction depends on time even with one delay."""

from npred.plants import Plant


def driven(**parts):
    """x' = U + sin 2t."""

    class Driven:
        states, inputs, box = ("x",), ("U",), {"x": (0.0, 1.0)}
        f = lambda x, u, t, p, M: [u.U + M.sin(2 * t)]
        kappa = lambda x, t, p, M: [-x.x]
        V = lambda x, t, p, M: x.x**2

    return Plant("Driven", type("Changed", (Driven,), parts))
