"""UFACTORY's arm xArm6: six joints, with the lengths, masses and inertia of its description xarm6_robot.urdf.

The file stands in the maker's xarm_ros, and in the package pybullet. Its joint damping of 1 N m s/rad is left out: on
the last link, whose inertia is 8e-5 kg m², it would make the arm stiffer than any controller sees.
"""

import math
from typing import NamedTuple

import numpy as np

from npred_robots.chain import serial
from npred_robots.rigid_body import Body


class Segment(NamedTuple):
    """Where the joint stands in the link before: turned by `roll` about x, at `position`; mass, centre and the inertia
    tensor about it, Ixx, Ixy, Ixz, Iyy, Iyz, Izz, of the link behind it; the largest torque (N m).
    """

    roll: float
    position: tuple[float, float, float]
    mass: float
    centre: tuple[float, float, float]
    inertia: tuple[float, float, float, float, float, float]
    effort: float


LINKS = (
    Segment(0.0, (0.0, 0.0, 0.267), 2.16, (-0.002, 0.02692, -0.01332),
         (0.00539427, 1.095e-05, 1.635e-06, 0.0048979, 0.000793, 0.00311573), 50.0),
    Segment(-1.5708, (0.0, 0.0, 0.0), 1.71, (0.03531, -0.21398, 0.03386),
         (0.0248674, -0.00430651, -0.00067797, 0.00485548, 0.00457245, 0.02387827), 50.0),
    Segment(0.0, (0.0535, -0.2845, 0.0), 1.384, (0.06781, 0.10749, 0.01457),
         (0.0053694, 0.0014185, -0.00092094, 0.0032423, -0.00169178, 0.00501731), 32.0),
    Segment(-1.5708, (0.0775, 0.3425, 0.0), 1.115, (-0.00021, 0.02578, -0.02538),
         (0.00439263, 5.028e-05, 1.374e-05, 0.0040077, 0.00045338, 0.00110321), 32.0),
    Segment(1.5708, (0.0, 0.0, 0.0), 1.275, (0.05428, 0.01781, 0.00543),
         (0.001202758, 0.000492428, -0.00039147, 0.0022876, -1.235e-04, 0.0026866), 32.0),
    Segment(-1.5708, (0.076, 0.097, 0.0), 0.1096, (0.0, 0.00064, -0.00952),
         (4.5293e-05, 0.0, 0.0, 4.8111e-05, 0.0, 7.9715e-05), 20.0),
)  # fmt: skip


def bodies() -> list[Body]:
    """The chain for npred_robots.rigid_body, from the base to the tip, without joint friction."""
    chain = []
    for number, link in enumerate(LINKS, 1):
        cos, sin = math.cos(link.roll), math.sin(link.roll)
        xx, xy, xz, yy, yz, zz = link.inertia
        chain.append(Body(
            joint=f"joint{number}", slides=False, turn=np.array([[1.0, 0, 0], [0, cos, -sin], [0, sin, cos]]),
            position=np.array(link.position), axis=np.array([0.0, 0.0, 1.0]), mass=link.mass,
            centre=np.array(link.centre), inertia=np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]), damping=0.0,
            effort=link.effort, parent=len(chain) - 1,
        ))  # fmt: skip
    return chain


#: six joints under computed torque: q_i(t) = 0.2 sin(0.6 t + phase_i), the phases from 0 to π/2, with gains 40 and 14,
#: reference and law of arXiv:2603.29119, where every torque comes 0.2 s late
XArm6 = serial(bodies(), "the arm xArm6", phases=[k * math.pi / 10 for k in range(6)])
XArm6.__name__ = "XArm6"
