"""The arm of mujoco_arm.xml, a black box: its dynamics are MuJoCo's. Needs the extra npred[mujoco]."""

from pathlib import Path

from npred_robots import mujoco_chain

FILE = Path(__file__).with_name("mujoco_arm.xml")
POSE = (0.0, 0.5, 0.0, 1.0, 0.0, 0.8, 0.0)  # rad: bent, so that gravity pulls
START = {"base": 0.0, "shoulder": 0.75, "upper": 0.27, "elbow": 1.04, "fore": -0.23, "wrist": 0.51, "hand": -0.08}
START |= {"base_rate": 0.45, "shoulder_rate": 0.24, "upper_rate": -0.19, "elbow_rate": -0.45, "fore_rate": -0.29}
START |= {"wrist_rate": 0.13, "hand_rate": 0.43}  # the rates of a wave of 0.3 rad and 1.5 rad/s at t = 0


class Arm(mujoco_chain(FILE, POSE)):
    """It begins near the wave that it is to follow."""

    box = {name: (at - 0.1, at + 0.1) for name, at in START.items()}


class ArmByRK4(mujoco_chain(FILE, POSE, integrator="RK4")):
    """The same arm, rolled forward by another of the engine's integrators."""

    box = Arm.box
