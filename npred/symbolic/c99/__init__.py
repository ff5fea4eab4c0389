"""Kernels in C99: the restricted Python that Numba compiles, translated from the same text for shapes that are known."""

from npred.symbolic.c99.unit import Unit
from npred.symbolic.c99.values import Array, Const, Foreign, Record, Scalar, literal

__all__ = ["Array", "Const", "Foreign", "Record", "Scalar", "Unit", "literal"]
