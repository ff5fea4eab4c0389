"""Checks of a caller's arrays: refused in one line where they are not real numbers or do not fit together."""

import os
import reprlib
import sys
from numbers import Real

import numpy as np

from npred.base.errors import ConfigError, bytes_text


def floats(name: str, value: object, kind: str = "an array of real numbers") -> np.ndarray:
    """The float64 array of real numbers. Raises ConfigError for text, dates, complex numbers, masked arrays, others.

    A masked value and the imaginary part of a complex one would be lost without a word, and a date has no unit. True is
    no number; a recorded array of them is the course of a switch.
    """
    if type(value) is np.ndarray and value.dtype.char == "d":  # the usual case, without a copy
        return value
    try:
        array = np.asarray(None if _masked(value) else value)
        # NumPy counts time differences among the integers
        real = (isinstance(item, Real) and not isinstance(item, np.timedelta64) for item in array.flat)
        switched = array.dtype.kind == "b" and array.ndim
        if switched or array.dtype.kind in "iuf" or (array.dtype == object and all(real)):
            return array.astype(float, copy=False)
    except (TypeError, ValueError, RuntimeError, OverflowError):  # torch raises the third, for a tensor with a gradient
        pass
    came = f"a {type(value).__name__}" if hasattr(value, "shape") else reprlib.repr(value)
    if isinstance(value, np.ndarray) or _masked(value):
        came = "a masked array" if _masked(value) else f"an array of {np.asarray(value).dtype}"
    raise ConfigError(f"{name}: expected {kind}, got {came}; convert it")


def nodes(name: str, value: object, m: int) -> np.ndarray:
    """The values at nodes, (..., nx, m); those of a single input may come flat, (nx,). Raises as `floats`."""
    array = floats(name, value)
    return array[:, None] if m == 1 and array.ndim == 1 else array


def number(name: str, value: object) -> float:
    """One real number, which may be infinite. Raises ConfigError for an array with axes and where `floats` does."""
    array = floats(name, value, "a real number")
    if array.ndim:
        raise ConfigError(f"{name}: expected a real number, got an array of shape {array.shape}; give one number")
    return float(array)


def finite(name: str, array: np.ndarray) -> None:
    """Raise ConfigError for an array with NaN or infinity."""
    _all(np.isfinite(array), array, f"{name}: expected finite numbers", "replace it")


def finite_rows(X: np.ndarray, u: np.ndarray, D_hat: np.ndarray) -> np.ndarray:
    """A mask (...) of the finite samples X (..., n), u (..., nx, m), D_hat (...): those that a predictor takes."""
    return np.isfinite(X).all(axis=-1) & np.isfinite(u).all(axis=(-2, -1)) & np.isfinite(D_hat)


def at_least_0(name: str, array: np.ndarray, what: str) -> None:
    """Raise ConfigError unless all are finite numbers of at least 0."""
    _all(np.isfinite(array) & (array >= 0), array, f"{name}: expected {what} of at least 0", "give 0 or more")


def delays(name: str, array: np.ndarray) -> None:
    """Raise ConfigError unless all are finite delays of at least 0."""
    at_least_0(name, array, "a delay")


def within(name: str, array: np.ndarray, bounds: tuple[float, float], unit: str = "s") -> None:
    """Raise ConfigError for a delay estimate outside the bounds, both ends in, with the unit of its times."""
    low, high = bounds
    inside = (low <= array) & (array <= high) & np.isfinite(array)
    expected = f"{name}: expected within the bounds [{low:g}, {high:g}] {unit}".rstrip()
    _all(inside, array, expected, f"widen them or move {name}")


def _all(right: np.ndarray, array: np.ndarray, expected: str, cure: str) -> None:
    """Raise ConfigError with the first value that is not right, and its index in the array."""
    if not right.all():
        index = tuple(int(k) for k in np.argwhere(~right)[0])
        at = f" at {list(index)}" if index else ""
        raise ConfigError(f"{expected}, got {array[index]:g}{at}; {cure}")


def _masked(value: object) -> bool:
    """Whether the value is a masked array, or a list of some: np.asarray would take the values below the mask."""
    items = value if isinstance(value, list | tuple) else (value,)
    return any(isinstance(item, np.ma.MaskedArray) for item in items)


def batch(**leading: tuple[int, ...]) -> tuple[int, ...]:
    """The common shape of the leading axes. Raises ConfigError where they do not broadcast."""
    try:
        return np.broadcast_shapes(*leading.values())
    except ValueError:
        axes = ", ".join(f"{name} {shape}" for name, shape in leading.items())
        cure = "give each one loop a row"
        raise ConfigError(f"expected batches that broadcast, got leading axes {axes}; {cure}") from None


def fits(shape: tuple[int, ...], target: tuple[int, ...]) -> bool:
    """Whether an array of the shape broadcasts to the target."""
    try:
        return np.broadcast_shapes(shape, target) == target
    except ValueError:
        return False


def memory() -> int:
    """The bytes that this machine has; where the system does not say it, as on Windows, no size is too large."""
    if "SC_PHYS_PAGES" not in getattr(os, "sysconf_names", ()):
        return sys.maxsize
    return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")


def room(name: str, what: str, needed: float, cure: str) -> None:
    """Raise ConfigError for an array of more bytes than this machine has."""
    if needed > memory():
        came = f"{what} of {bytes_text(needed)}"
        raise ConfigError(f"{name}: expected what fits into memory, {bytes_text(memory())}, got {came}; {cure}")
