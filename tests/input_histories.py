"""u at the nodes as a control step reads it, from the commands alone: what the engine's transport is held against.

And as predictors read it: means over the cells of the nodes.
"""

import numpy as np


def at_nodes(U, k, nx, steps):
    """Of commands U (nt, 1) at step k, a delay of `steps`: (nx, 1), linear between the starts of steps.

    U is 0 before t = 0; at x = 1 it is U[k - 1].
    """
    commanded = np.concatenate([np.zeros(steps), U[:k, 0]])
    return np.interp(k - steps * (1 - np.linspace(0, 1, nx)), np.arange(-steps, k), commanded)[:, None]


def means(u, nx):
    """The means of u(x) (..., m) over the cells of nx nodes, (nx, m), by Gauss's rule of five points."""
    edges = np.clip((np.arange(nx + 1) - 0.5) / (nx - 1), 0.0, 1.0)
    places, weights = np.polynomial.legendre.leggauss(5)
    x = (edges[:-1, None] + edges[1:, None] + np.diff(edges)[:, None] * places) / 2
    return np.einsum("jkm,k->jm", u(x), weights) / 2
