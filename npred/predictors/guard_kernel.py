"""The kernel of a guarded predictor, npred/kernels/c/guard.h, of the parts that it calls."""

import ctypes
from collections.abc import Callable
from typing import Any

import numpy as np

from npred.delays import family, family_of
from npred.kernels.callback import Failure, callback
from npred.kernels.kernel import made, skeleton
from npred.plants.base import Plant
from npred.predictors.base import OneStep, Predictor
from npred.predictors.runge_kutta import RK4

LEVELS = 4  # of grids that the settings have room for
HEAD = 3 + LEVELS  # numbers of the settings before those of the domain: tolerance, limit, how many levels, their counts
SHADOWS = 4  # predictions side by side, of a method whose steps tell their error; there is one of any other
POINTERS = {"CONTROL": family.CONTROL, "EXACT": family.PREDICT, "REFERENCE": family.PREDICT}


def kernel(plant: Plant, exact: Predictor, method: type[OneStep]) -> Callable[..., None]:
    """GUARD of a plant: its parts compiled into it, or, where the plant is not traced, called back."""
    model, n, m, phased = family_of(plant), plant.n, plant.m, plant.phased
    cells, signed = model.reads_cells, method.paired
    reference = model.sweep(method.shadow(), cells, more=1) if signed else method(plant).cells()
    parts: dict[str, Any] = {"CONTROL": model.control(RK4.step), "EXACT": exact.lanes(), "REFERENCE": reference}
    compiled, shadows = parts if plant.traced else {}, SHADOWS if signed else 1

    def work(nx: int, lanes: int, settings: np.ndarray) -> int:
        finest = int(settings[3:HEAD].max()) + 1
        side = shadows + (cells and signed)
        one = n + nx * (m + n) + 2 * (nx + 1) * m + m * side  # of a lane, and what its levels share
        grid = finest * (2 * m + side * (2 * (m + signed) + n)) + side * (n + 1)
        rest = [part.work(max(nx, finest), max(lanes, side), None) for part in compiled.values()]
        return len(POINTERS) + m * lanes + one + grid + max(0, *rest, 0)

    sizes = {"N": n, "M": m, "PHASED": int(phased), "PERIOD": repr(plant.period) if phased else "1.0"}
    sizes |= {
        "ON_CELLS": int(cells),
        "SIGNED": int(signed),
        "SHADOWS": shadows,
        "ORDER": method.order,
        "LEVELS": LEVELS,
    }
    sizes |= {} if plant.traced else {"FOREIGN": ""}
    guard = made("guarded", family.GUARD, skeleton("guard.h"), {}, sizes, compiled, [skeleton("cells.h")], work=work)
    if plant.traced:
        return guard

    def guarded(*values: Any) -> None:  # its scratch memory begins with the addresses of the parts
        failure = Failure()
        pointers = [callback(part, POINTERS[name], {"p": plant.p}, failure) for name, part in parts.items()]
        addresses = [ctypes.cast(pointer, ctypes.c_void_p).value for pointer in pointers]
        guard(*values, scratch=np.array(addresses, dtype=np.uint64).view(np.float64))
        failure.raised()

    return guarded
