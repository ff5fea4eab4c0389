"""Arrays as a caller gave them: told in one line where they are no numbers or do not fit together."""

from typing import Any

import numpy as np

from npred.errors import ConfigError


def floats(name: str, given: Any) -> np.ndarray:
    """The float64 array of what was given. Raises ConfigError for text, ragged lists, and other things."""
    try:
        return np.asarray(given, dtype=float)
    except (TypeError, ValueError, RuntimeError):  # torch raises the last, for a tensor that has a gradient
        what = f"a {type(given).__name__}" if hasattr(given, "shape") else repr(given)
        raise ConfigError(f"{name}: expected an array of numbers, got {what}; convert it") from None


def batch(**leading: tuple[int, ...]) -> tuple[int, ...]:
    """The common shape of the leading axes. Raises ConfigError where they do not broadcast."""
    try:
        return np.broadcast_shapes(*leading.values())
    except ValueError:
        found = ", ".join(f"{name} {shape}" for name, shape in leading.items())
        raise ConfigError(
            f"expected batches that broadcast, got leading axes {found}; give each one loop a row"
        ) from None


def fits(given: tuple[int, ...], wanted: tuple[int, ...]) -> bool:
    """Whether an array of the given shape broadcasts to the wanted one."""
    try:
        return np.broadcast_shapes(given, wanted) == wanted
    except ValueError:
        return False
