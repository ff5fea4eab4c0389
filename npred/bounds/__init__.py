"""Bounds of the error of U by interval arithmetic: an extra of `certify`, which only `Guarded.bound` asks for."""
