"""Plants of rigid bodies: chains, URDF files, Pinocchio, and MuJoCo's MJCF files."""

from npred_robots.mjcf import mujoco_chain

__all__ = ["mujoco_chain"]
