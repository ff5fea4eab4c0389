"""An arm of the Baxter robot: seven links by their Denavit-Hartenberg table, the limits of its joints, and the plants.

Smith, Yang, Li, Ma, Bruce, Dynamic modelling and control of a Baxter robot (IEEE 7558740, 2016), with the inertia about
the mass centres, as the robot's URDF file has it.
"""

import math

from npred_robots.chain import GAINS, serial
from npred_robots.denavit_hartenberg import Link, bodies

_TURN = math.pi / 2

LINKS = (
    Link("s0", 0.2703, 0.069, -_TURN, 5.70044, (-0.05117, 0.07908, 0.00086),
         (0.0470910226, 0.035959884, 0.0376697645), (-0.0061487003, -0.0007808689, 0.0001278755), 50.0),
    Link("s1", 0.0, 0.0, _TURN, 3.22698, (0.00269, -0.00529, 0.06845),
         (0.027885975, 0.020787492, 0.0117520941), (-0.0001882199, 0.0020767576, -0.00030096397), 50.0),
    Link("e0", 0.3644, 0.069, -_TURN, 4.31272, (-0.07176, 0.08149, 0.00132),
         (0.0266173355, 0.012480083, 0.0284435520), (-0.0039218988, -0.001083893, 0.0002927063), 50.0),
    Link("e1", 0.0, 0.0, _TURN, 2.07206, (0.00159, -0.01117, 0.02618),
         (0.0131822787, 0.009268520, 0.0071158268), (-0.0001966341, 0.000745949, 0.0003603617), 50.0),
    Link("w0", 0.3743, 0.01, -_TURN, 2.24665, (-0.01168, 0.13111, 0.0046),
         (0.0166774282, 0.003746311, 0.0167545726), (-0.0001865762, 0.0006473235, 0.0001840370), 15.0),
    Link("w1", 0.0, 0.0, _TURN, 1.60979, (0.00697, 0.006, 0.06048),
         (0.0070053791, 0.005527552, 0.0038760715), (0.0001534806, -0.0002111503, -0.0004438478), 15.0),
    Link("w2", 0.2295, 0.0, 0.0, 0.54218, (0.005137, 0.0009572, -0.06682),
         (0.0008162135, 0.0008735012, 0.0005494148), (0.000128440, 0.0001057726, 0.00018969891), 15.0),
)  # fmt: skip
#: joint angles, rad
ANGLES = ((-1.7016, 1.7016), (-2.147, 1.047), (-3.0541, 3.0541), (-0.05, 2.618), (-3.059, 3.059), (-1.571, 2.094),
          (-3.059, 3.059))  # fmt: skip
#: joint rates, rad/s
FASTEST = (2.0, 2.0, 2.0, 2.0, 4.0, 4.0, 4.0)


def arm(joints: int) -> type:
    """The declaration of the first so many joints under computed torque about the middle of the joints' ranges.

    q_i(t) = middle_i + 0.1 sin t, the same wave for all joints, and errors with e'' + 2 e' + e = 0 without delay: the
    reference and the gains of Bhan, Krstic and Shi (arXiv:2411.18964), where every torque comes 0.5 s late. Their arm
    has another plant and law, for the vector of Coriolis torques stands there as a matrix: docs/reproduce.md.
    """
    names = [link.joint for link in LINKS[:joints]]
    middle = [(low + high) / 2 for low, high in ANGLES[:joints]]
    kind = serial(
        bodies(LINKS[:joints]), f"the Baxter arm's first {joints} joints", middle, [0.0] * joints,
        parameters=GAINS | {"stiffness": 1.0, "damping": 2.0, "amplitude": 0.1, "frequency": 1.0},
        period=2 * math.pi,
        box={name: (at - 0.2, at + 0.2) for name, at in zip(names, middle, strict=True)}
        | {f"{name}_rate": (-0.1, 0.1) for name in names},
    )  # fmt: skip
    kind.__name__ = f"BaxterArm{joints}"
    return kind


BaxterArm5, BaxterArm7 = arm(5), arm(7)
