"""The same robot by Pinocchio, a library that cannot be traced: an example of a black box. Extra: npred[pin]."""

from collections.abc import Sequence
from pathlib import Path
from threading import Lock
from typing import Unpack

import numpy as np

from npred.base.errors import required
from npred_robots import rigid_body, urdf
from npred_robots.chain import by_library, declaration, driven, wave_of
from npred_robots.rigid_body import Body


def pin_chain(path: str | Path, pose: Sequence[float] | None = None, **options: Unpack[urdf.Options]) -> type:
    """The declaration of npred_robots.chain.chain with its dynamics by pinocchio's crba and rnea, `traced = False`.

    Raises MissingError without the extra, ConfigError for a file or an option that `chain` does not take.
    """
    bodies = urdf.read(path, **options)
    joints = rigid_body.leaders(bodies)
    wave = wave_of(joints, pose)
    functions = by_library(_Library(bodies), joints, wave)
    return declaration(Path(path).name, joints, wave, functions, traced=False, files=(path,))


class _Library:
    """Pinocchio's model of the bodies, row by row. Its own joints are all of them: q = `spread` y + `offset`."""

    def __init__(self, bodies: list[Body]) -> None:
        self.pin = pin = required("pin_chain", "pinocchio", "pinocchio", "pin")
        self.model, numbers = pin.Model(), [0]  # of the base, then of the bodies
        for body in bodies:
            joint = (pin.JointModelPrismaticUnaligned if body.slides else pin.JointModelRevoluteUnaligned)(body.axis)
            placed = pin.SE3(body.turn, body.position)
            numbers.append(self.model.addJoint(numbers[body.parent + 1], joint, placed, body.joint))
            inertia = pin.Inertia(body.mass, body.centre, body.inertia)
            self.model.appendBodyToJoint(numbers[-1], inertia, pin.SE3.Identity())
        self.data, self.alone = self.model.createData(), Lock()
        joints, moves = rigid_body.leaders(bodies), rigid_body.moves(bodies)
        self.spread, self.offset = np.zeros((len(bodies), len(joints))), np.zeros(len(bodies))
        for number, (k, ratio, offset) in zip(numbers[1:], moves, strict=True):
            self.spread[self.model.joints[number].idx_v, k] = ratio
            self.offset[self.model.joints[number].idx_v] = offset
        self.damping, self.inputs = np.array(rigid_body.damping(bodies)), driven(joints)

    def accelerations(self, q: np.ndarray, rates: np.ndarray, u: np.ndarray, gravity: float) -> np.ndarray:
        """q'' (B, n) by the mass matrix of the composite-rigid-body algorithm."""
        forces = -self._loads(q, rates, np.zeros_like(q), gravity) - self.damping * rates
        forces[:, self.inputs] += u
        return np.linalg.solve(self._masses(q), forces[..., None])[..., 0]

    def torques(
        self, q: np.ndarray, rates: np.ndarray, accelerations: np.ndarray, speeds: np.ndarray, gravity: float
    ) -> np.ndarray:
        """The inputs (B, m) of that motion, friction as at `speeds`."""
        torques = self._loads(q, rates, accelerations, gravity) + self.damping * speeds
        return torques[:, self.inputs]

    def _masses(self, q: np.ndarray) -> np.ndarray:
        at = q @ self.spread.T + self.offset
        upper = np.array([np.triu(self.pin.crba(self.model, self.data, row)) for row in at])
        masses = upper + np.swapaxes(np.triu(upper, 1), 1, 2)
        return self.spread.T @ masses @ self.spread

    def _loads(self, q: np.ndarray, rates: np.ndarray, accelerations: np.ndarray, gravity: float) -> np.ndarray:
        """The torques (B, n) by the recursive Newton-Euler algorithm."""
        self.model.gravity.linear = np.array([0.0, 0.0, -gravity])
        rows = zip(q @ self.spread.T + self.offset, rates @ self.spread.T, accelerations @ self.spread.T, strict=True)
        return np.array([self.pin.rnea(self.model, self.data, *row) for row in rows]) @ self.spread
