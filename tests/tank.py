"""A tank with one inflow as the text of a user's file, to be changed a piece at a time."""

TANK = """
class Tank:
    '''Level h, outflow c sqrt(h), inflow U.'''
    states = ("h",)
    inputs = ("U",)
    parameters = {"c": 0.5, "level": 1.0}
    box = {"h": (0.5, 2.0)}
    guess = (0.8,)

    def f(x, u, t, p, M):
        return [u.U - p.c * M.sqrt(x.h)]

    def kappa(x, t, p, M):
        return [p.c * M.sqrt(x.h) + p.level - x.h]

    def V(x, t, p, M):
        return (x.h - p.level) ** 2
"""
