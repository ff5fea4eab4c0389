"""The arm of six joints as a URDF file, and its text."""

from pathlib import Path

SIX = Path(__file__).with_name("six_joint.urdf")
TEXT = SIX.read_text()
