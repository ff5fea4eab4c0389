"""A trained operator as npred.load gives it: torch where somebody calls it, one compiled function in loops."""

from collections.abc import Callable
from functools import cached_property
from typing import Any

import numpy as np

from npred.predictors.neural import Neural
from npred.runtimes.fused import Fused


class Loaded(Neural):
    """The operator by torch in calls, for any batch and grid, and by its fused function in loops and controllers.

    Both in double precision, equal up to rounding, but for an FNO on a fine grid (npred.runtimes.fused). Nothing is
    compiled before the first loop asks for `lanes`; an evaluation on as many nodes has left the same function on the
    disk.
    """

    @property
    def compiled(self) -> bool:
        return True

    @cached_property
    def fused(self) -> Fused:
        """The operator as the function that a loop calls."""
        return Fused(self.plant, self.operator, self.nx, self.name, precision=np.float64)

    def lanes(self) -> Callable[..., Any]:
        return self.fused.lanes()
