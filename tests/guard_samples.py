"""A predictor that is wrong by a known amount, and calls of it: what a guard and the bound are tested on."""

import numpy as np

import npred
from npred.base import grid
from npred.prediction.methods import Predictor

PLANT = npred.plant("activator_repressor")
NX = 51
BOX = """
from npred import plants

CART = plants.resolve("cart_pole")


class Box:
    traced = False
    states, inputs, box, parameters = CART.states, CART.inputs, CART.box, CART.parameters

    def f(X, u, t, p):
        return CART.f(X, u)

    def kappa(X, t, p):
        return CART.kappa(X)
"""


class Wrong(Predictor):
    """RK4 with errors that grow along x to `error` times the states, of either sign in turn."""

    def __init__(self, plant, nx=NX, error=0.0):
        super().__init__(plant, nx)
        self.error, self.exact = error, npred.predictor(plant, "rk4", nx)

    def predict(self, X, u, D_hat, t):
        P, x = self.exact(X, u, D_hat, t), grid.nodes(u.shape[1])[:, None]
        return P + self.error * x * (np.abs(P) + 1e-3) * (-1.0) ** np.arange(self.plant.n)


def rows(count=40, seed=0):
    """X, u, D_hat of smooth histories in the region that loops run through."""
    rng = np.random.default_rng(seed)
    x = grid.nodes(NX)
    a, b = rng.uniform(-0.1, 0.1, (2, count, 1))
    u = (a * np.cos(3 * x) + b * x)[..., None]
    return rng.uniform([0.05, 3], [0.15, 9], (count, 2)), u, rng.uniform(0.3, 2.0, count)
