"""The same chain by Pinocchio, a library that cannot be traced: an example of a black box. Extra: npred[pin]."""

from collections.abc import Sequence
from pathlib import Path
from threading import Lock

import numpy as np

from npred.base.errors import required
from npred_robots import urdf
from npred_robots.chain import by_library, declaration, wave_of


def pin_chain(path: str | Path, pose: Sequence[float] | None = None) -> type:
    """The declaration of npred_robots.chain.chain with its dynamics by pinocchio's aba and rnea, `traced = False`.

    Raises MissingError without the extra, ConfigError for a file that is no such chain.
    """
    bodies = urdf.read(path)
    wave = wave_of(bodies, pose)
    functions = by_library(_Library(Path(path)), wave)
    return declaration(Path(path).name, bodies, wave, functions, traced=False, files=(path,))


class _Library:
    """Pinocchio's model of a file, row by row."""

    def __init__(self, path: Path) -> None:
        self.pin = required("pin_chain", "pinocchio", "pinocchio", "pin")
        self.model = self.pin.buildModelFromUrdf(str(path))
        self.data, self.alone = self.model.createData(), Lock()

    def accelerations(self, q: np.ndarray, rates: np.ndarray, u: np.ndarray, gravity: float) -> np.ndarray:
        """q'' (B, n) by the articulated-body algorithm."""
        self._pull(gravity)
        forces = u - self.model.damping * rates
        rows = zip(q, rates, forces, strict=True)
        return np.array([self.pin.aba(self.model, self.data, self._at(a), b, c) for a, b, c in rows])

    def torques(
        self, q: np.ndarray, rates: np.ndarray, accelerations: np.ndarray, speeds: np.ndarray, gravity: float
    ) -> np.ndarray:
        """The torques (B, n) of that motion by the recursive Newton-Euler algorithm, friction as at `speeds`."""
        self._pull(gravity)
        rows = zip(q, rates, accelerations, strict=True)
        torques = np.array([self.pin.rnea(self.model, self.data, self._at(a), b, c) for a, b, c in rows])
        return torques + self.model.damping * speeds

    def _pull(self, gravity: float) -> None:
        self.model.gravity.linear = np.array([0.0, 0.0, -gravity])

    def _at(self, q: np.ndarray) -> np.ndarray:
        """The library's coordinates: two for a joint without limits."""
        return self.pin.integrate(self.model, self.pin.neutral(self.model), q)
