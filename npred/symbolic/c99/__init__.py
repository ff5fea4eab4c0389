"""Kernels in C99: the restricted Python that Numba compiles, translated from the same text for fixed shapes."""

from npred.symbolic.c99.unit import Function, Unit, constant
from npred.symbolic.c99.values import Array, Const, Fields, Foreign, Term, comment, literal

__all__ = ["Array", "Const", "Foreign", "Function", "Fields", "Term", "Unit", "comment", "constant", "literal"]
