"""What a chain declares whose dynamics a library computes, which is called and not traced: functions of arrays."""

from threading import Lock
from typing import Any, Protocol

import numpy as np

from npred.robots.chain import Wave, called_for, motion
from npred.symbolic import array_math


class Dynamics(Protocol):
    """A library's model of a chain of n joints, row by row; arrays are (B, n).

    Libraries work in memory that belongs to the model, and some let other threads run meanwhile: whoever calls has it
    `alone`.
    """

    alone: Lock

    def accelerations(self, q: np.ndarray, rates: np.ndarray, u: np.ndarray, gravity: float) -> np.ndarray:
        """q'' under the torques u."""
        ...

    def torques(
        self, q: np.ndarray, rates: np.ndarray, accelerations: np.ndarray, speeds: np.ndarray, gravity: float
    ) -> np.ndarray:
        """The torques of that motion, with the friction that there would be at `speeds`."""
        ...


def functions(dynamics: Dynamics, wave: Wave) -> dict[str, Any]:
    """f, kappa, V and reference of npred.robots.chain.chain, on rows."""
    n = len(wave.middle)

    def f(X: np.ndarray, u: np.ndarray, t: Any, p: Any) -> np.ndarray:
        with dynamics.alone:
            return np.hstack([X[:, n:], dynamics.accelerations(X[:, :n], X[:, n:], u, p.gravity)])

    def kappa(X: np.ndarray, t: Any, p: Any) -> np.ndarray:
        columns = called_for(X.T, t, p, array_math.NUMPY, wave)
        speeds, accelerations = (np.stack([a + np.zeros(len(X)) for a in rows], axis=1) for rows in columns)
        with dynamics.alone:
            return dynamics.torques(X[:, :n], X[:, n:], accelerations, speeds, p.gravity)

    def V(X: np.ndarray, t: Any, p: Any) -> np.ndarray:
        return ((X - reference(np.broadcast_to(t, len(X)), p)) ** 2).sum(axis=1)

    def reference(t: np.ndarray, p: Any) -> np.ndarray:
        goal, speed, _ = motion(t, p, array_math.NUMPY, wave)
        return np.stack(goal + speed, axis=1)

    return {"f": f, "kappa": kappa, "V": V, "reference": reference}
