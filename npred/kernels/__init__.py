"""Compiled kernels: C99 skeletons (c/*.h), the formulas of a plant printed into them, and the compiler."""
