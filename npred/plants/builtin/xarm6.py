"""The arm xArm6 that follows a wave: its six joints under computed torque."""

import math

from npred.robots import xarm6
from npred.robots.chain import serial

#: q_i(t) = 0.2 sin(0.6 t + phase_i), the phases from 0 to π/2, with gains 40 and 14: reference and
#: law of arXiv:2603.29119, where every torque comes 0.2 s late.
XArm6 = serial(xarm6.bodies(), "the arm xArm6", phases=[k * math.pi / 10 for k in range(6)])
XArm6.__name__ = "XArm6"

PLANTS = {"xarm6": XArm6}
