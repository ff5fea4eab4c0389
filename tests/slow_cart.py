"""A plant in whose loops every part of npred.Loop can act."""


class Cart:
    """It is to stop at `aim`, and slowly."""

    states, inputs, parameters = ("x", "v"), ("a",), {"aim": 0.5, "drag": 0.1}
    box, outputs = {"x": (-1.0, 1.0), "v": (-0.5, 0.5)}, ("x",)

    def f(x, u, t, p, M):
        return [x.v, u.a - p.drag * x.v]

    def kappa(x, t, p, M):
        return [-4 * (x.x - p.aim) - 2 * x.v]

    def V(x, t, p, M):
        return (x.x - p.aim) ** 2 + x.v**2

    def safe(x, t, p, M):
        return [0.3 - x.v]

    def output(x, t, p, M):
        return [x.x]
