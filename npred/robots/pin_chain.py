"""The same chain by Pinocchio, a library that cannot be traced: an example of a black box. Extra: npred[pin]."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from npred.errors import required
from npred.robots import urdf
from npred.robots.chain import called_for, declaration, motion, wave_of
from npred.symbolic import array_math


def pin_chain(path: str | Path, pose: Sequence[float] | None = None) -> type:
    """The declaration of npred.robots.chain.chain with its dynamics by pinocchio's aba and rnea, `traced = False`.

    Raises MissingError without the extra, ConfigError for a file that is no such chain.
    """
    bodies = urdf.read(path)
    wave, library = wave_of(bodies, pose), _Library(Path(path))
    n = len(bodies)

    def f(X: np.ndarray, u: np.ndarray, t: Any, p: Any) -> np.ndarray:
        return np.hstack([X[:, n:], library.accelerations(X[:, :n], X[:, n:], u, p.gravity)])

    def kappa(X: np.ndarray, t: Any, p: Any) -> np.ndarray:
        sought = called_for(X.T, t, p, array_math.NUMPY, wave)
        speeds, accelerations = (np.stack([a + np.zeros(len(X)) for a in rows], axis=1) for rows in sought)
        torques = library.torques(X[:, :n], X[:, n:], accelerations, p.gravity)
        return torques + library.model.damping * speeds

    def V(X: np.ndarray, t: Any, p: Any) -> np.ndarray:
        return ((X - reference(np.broadcast_to(t, len(X)), p)) ** 2).sum(axis=1)

    def reference(t: np.ndarray, p: Any) -> np.ndarray:
        goal, speed, _ = motion(t, p, array_math.NUMPY, wave)
        return np.stack(goal + speed, axis=1)

    functions = {"f": f, "kappa": kappa, "V": V, "reference": reference}
    return declaration(Path(path).name, bodies, wave, functions, traced=False, files=(path,))


class _Library:
    """Pinocchio's model of a file, row by row."""

    def __init__(self, path: Path) -> None:
        self.pin = required("pin_chain", "pinocchio", "pinocchio", "pin")
        self.model = self.pin.buildModelFromUrdf(str(path))
        self.data = self.model.createData()

    def accelerations(self, q: np.ndarray, rates: np.ndarray, u: np.ndarray, gravity: float) -> np.ndarray:
        """q'' (B, n) by the articulated-body algorithm."""
        self._pull(gravity)
        forces = u - self.model.damping * rates
        rows = zip(q, rates, forces, strict=True)
        return np.array([self.pin.aba(self.model, self.data, self._at(a), b, c) for a, b, c in rows])

    def torques(self, q: np.ndarray, rates: np.ndarray, accelerations: np.ndarray, gravity: float) -> np.ndarray:
        """The torques (B, n) of that motion without friction, by the recursive Newton-Euler algorithm."""
        self._pull(gravity)
        rows = zip(q, rates, accelerations, strict=True)
        return np.array([self.pin.rnea(self.model, self.data, self._at(a), b, c) for a, b, c in rows])

    def _pull(self, gravity: float) -> None:
        self.model.gravity.linear = np.array([0.0, 0.0, -gravity])

    def _at(self, q: np.ndarray) -> np.ndarray:
        """The library's coordinates: two for a joint without limits."""
        return self.pin.integrate(self.model, self.pin.neutral(self.model), q)
