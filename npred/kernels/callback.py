"""Parts in Python for loops in C: a function pointer that calls a function on views of the loop's memory."""

import ctypes
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from npred.kernels.kernel import AXES, NUMBERS, Shape, foreign_type, names


class Failure:
    """Whether a part in Python has failed, for the loop in C to see, and of what."""

    def __init__(self) -> None:
        self.flag = ctypes.c_int(0)
        self.error: BaseException | None = None

    def raised(self) -> None:
        """Raise that error, once."""
        error, self.error, self.flag.value = self.error, None, 0
        if error is not None:
            raise error


def callback(function: Callable[..., Any], arguments: str, fixed: Mapping[str, np.ndarray], failure: Failure) -> Any:
    """The pointer to a function of these arguments; `fixed` are arrays whose shape the sizes of a call do not tell."""
    argument_names = names(arguments)
    views: dict[tuple[int, tuple[int, ...]], np.ndarray] = {}

    def viewed(name: str, value: Any, shape: Shape) -> Any:
        if name in NUMBERS or name in fixed:
            return fixed.get(name, value)
        sizes = (*(getattr(shape, axis) for axis in AXES[name]), shape.lanes)
        if (value, sizes) not in views:
            numbers = (ctypes.c_double * int(np.prod(sizes))).from_address(value)
            views[value, sizes] = np.ctypeslib.as_array(numbers).reshape(sizes)
        return views[value, sizes]

    def call(shape: Shape, *values: Any) -> None:
        if failure.error is None:
            try:
                with np.errstate(all="ignore"):  # a lost loop is NaN, and no cause for a warning
                    passed = zip(argument_names, values[:-1], strict=True)
                    function(*(viewed(name, value, shape) for name, value in passed))
            except BaseException as error:  # it cannot pass through C
                failure.error = error
                failure.flag.value = 1

    return foreign_type(arguments)(call)
