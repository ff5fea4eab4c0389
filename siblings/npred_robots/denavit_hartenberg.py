"""A serial chain from its Denavit-Hartenberg table and the masses of its links.

The standard convention: frame i stands behind link i, T = R_z(θ) (shift d along z) (shift a along x) R_x(α), and joint
i turns about z of frame i - 1.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from npred.base.errors import ConfigError
from npred_robots.rigid_body import Body


class Link(NamedTuple):
    """A row of the table, lengths in m and α in rad, with the link's mass (kg), the centre of mass in its frame i, the
    six numbers of its inertia about that centre (kg m²) and the largest torque of its joint (N m).

    `moments` are Ixx, Iyy, Izz and `products` ∫ x y dm, ∫ y z dm, ∫ x z dm: off the diagonal of the inertia tensor
    these stand with the other sign.
    """

    joint: str
    d: float
    a: float
    alpha: float
    mass: float
    centre: tuple[float, float, float]
    moments: tuple[float, float, float]
    products: tuple[float, float, float]
    effort: float = float("inf")

    @property
    def second(self) -> np.ndarray:
        """The moments and products as they stand in the row, a symmetric matrix (3, 3)."""
        (xx, yy, zz), (xy, yz, xz) = self.moments, self.products
        return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])

    @property
    def inertia(self) -> np.ndarray:
        """The inertia tensor about the centre of mass, in frame i, (3, 3)."""
        return 2 * np.diag(self.moments) - self.second

    @property
    def offset(self) -> tuple[np.ndarray, np.ndarray]:
        """Turn (3, 3) and position (3,) of frame i in the frame that the joint has turned."""
        cos, sin = np.cos(self.alpha), np.sin(self.alpha)
        return np.array([[1, 0, 0], [0, cos, -sin], [0, sin, cos]]), np.array([self.a, 0.0, self.d])


def bodies(links: Sequence[Link]) -> list[Body]:
    """The chain for npred_robots.rigid_body, from the base to the tip; without joint friction.

    Raises ConfigError for no link, or one without a mass.
    """
    if not links:
        raise ConfigError("denavit_hartenberg: expected at least one link, got none; give the rows of the table")
    chain: list[Body] = []
    turn, position = np.eye(3), np.zeros(3)
    for link in links:
        if not link.mass > 0:
            raise ConfigError(
                f"denavit_hartenberg: {link.joint} expected a mass above 0 kg, got {link.mass}; give its mass"
            )
        twist, arm = link.offset
        chain.append(Body(
            joint=link.joint, slides=False, turn=turn, position=position, axis=np.array([0.0, 0.0, 1.0]),
            mass=link.mass, centre=twist @ link.centre + arm, inertia=twist @ link.inertia @ twist.T, damping=0.0,
            effort=link.effort, parent=len(chain) - 1,
        ))  # fmt: skip
        turn, position = twist, arm
    return chain
