"""A plant that tracks and whose errors are known: X' = a X + U follows r(t) = A sin(w t), (X - r)' = -c (X - r)."""

from npred.plants.base import Plant


class Follower:
    states, inputs, box = ("X",), ("U",), {"X": (-1.0, 1.0)}
    parameters = {"a": 0.5, "c": 2.0, "A": 0.3, "w": 1.5}

    @staticmethod
    def f(x, u, t, p, M):
        return [p.a * x.X + u.U]

    @staticmethod
    def kappa(x, t, p, M):
        r, slope = p.A * M.sin(p.w * t), p.A * p.w * M.cos(p.w * t)
        return [slope - p.a * x.X - p.c * (x.X - r)]

    @staticmethod
    def V(x, t, p, M):
        return (x.X - p.A * M.sin(p.w * t)) ** 2

    @staticmethod
    def reference(t, p, M):
        return [p.A * M.sin(p.w * t)]


def follower(**parameters: float) -> Plant:
    return Plant("Follower", Follower, parameters)
