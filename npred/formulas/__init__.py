"""The formula compiler: functions traced to a tape, their derivatives, and programs of them."""

from typing import Any, TypeAlias

Value: TypeAlias = Any  # a number or a symbol; declared functions run on arrays and tensors too
Array: TypeAlias = Any  # an array of NumPy or torch
Parameters: TypeAlias = Any  # values by name, p.a
