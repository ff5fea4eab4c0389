"""An arm of the Baxter robot that follows a wave: its first five joints, or all seven."""

import math

from npred.robots import baxter, denavit_hartenberg
from npred.robots.chain import GAINS, serial


def arm(joints: int) -> type:
    """The declaration of the first so many joints under computed torque about the middle of the joints' ranges.

    q_i(t) = middle_i + 0.1 sin t, the same wave for all joints, and errors with e'' + 2 e' + e = 0 without delay: the
    reference and the gains of Bhan, Krstic and Shi (arXiv:2411.18964), where every torque comes 0.5 s late. Their arm
    has another plant and law, for the vector of Coriolis torques stands there as a matrix: docs/reproduce.md.
    """
    names = [link.joint for link in baxter.LINKS[:joints]]
    middle = [(low + high) / 2 for low, high in baxter.ANGLES[:joints]]
    kind = serial(
        denavit_hartenberg.bodies(baxter.LINKS[:joints]), f"the Baxter arm's first {joints} joints", middle,
        [0.0] * joints,
        parameters=GAINS | {"stiffness": 1.0, "damping": 2.0, "amplitude": 0.1, "frequency": 1.0},
        period=2 * math.pi,
        box={name: (at - 0.2, at + 0.2) for name, at in zip(names, middle, strict=True)}
        | {f"{name}_rate": (-0.1, 0.1) for name in names},
    )  # fmt: skip
    kind.__name__ = f"BaxterArm{joints}"
    return kind


PLANTS = {f"baxter_arm{joints}": arm(joints) for joints in (5, 7)}
