"""The kernel of a guarded predictor, npred/kernels/c/guard.h, of the parts that it calls."""

import ctypes
from collections.abc import Callable
from typing import Any

import numpy as np

from npred.delays import family, family_of
from npred.kernels.callback import Failure, callback
from npred.kernels.kernel import Kernel, made, skeleton
from npred.plants.base import Plant
from npred.predictors.base import OneStep, Predictor
from npred.predictors.runge_kutta import Heun

HEAD = 6  # numbers of the settings before those of the domain: tolerance, fine, coarse, correct, limit, refinements
POINTERS = {"CONTROL": family.CONTROL, "EXACT": family.PREDICT, "REFERENCE": family.PREDICT}


def kernel(plant: Plant, by: str, exact: Predictor, method: type[OneStep]) -> Callable[..., None]:
    """GUARD of a plant: its parts compiled into it, or, where the plant is not traced, called back."""
    model, defect = family_of(plant), by == "defect"
    cells = model.reads_cells and not defect
    reference = model.correction() if defect else method(plant).cells() if cells else method(plant).lanes()
    parts: dict[str, Any] = {"CONTROL": model.control(Heun.step), "EXACT": exact.lanes(), "REFERENCE": reference}
    n, m, phased = plant.n, plant.m, plant.phased
    compiled = parts if plant.traced else {}

    def work(nx: int, lanes: int, settings: np.ndarray) -> int:
        finest = int(settings[1]) << int(settings[5])
        grids = 3 * m + 2 * (nx + 1) * m + 2 * (finest + 1) * m + (1 + defect) * (finest + 1) * n
        one = n + nx * (m + n) + (compiled["EXACT"].work(nx, 1, None) if compiled else 0)
        rest = [part.work(max(nx, finest + 1), lanes, None) for part in compiled.values()]
        return len(POINTERS) + grids * lanes + max(one, *rest, 0)

    sizes = {"N": n, "M": m, "PHASED": int(phased), "PERIOD": repr(plant.period) if phased else "1.0"}
    sizes |= {"ON_CELLS": int(cells), "DEFECT": int(defect)} | ({} if plant.traced else {"FOREIGN": ""})
    body = skeleton("guard.h")
    guard = made("guarded", family.GUARD, body, {}, sizes, compiled, [skeleton("cells.h")], work=work)
    return guard if plant.traced else _foreign(guard, parts, plant)


def _foreign(guard: Kernel, parts: dict[str, Callable[..., Any]], plant: Plant) -> Callable[..., None]:
    """The guard with parts in Python, whose addresses its scratch memory begins with."""

    def guarded(*values: Any) -> None:
        failure = Failure()
        pointers = [callback(part, POINTERS[name], {"p": plant.p}, failure) for name, part in parts.items()]
        addresses = [ctypes.cast(pointer, ctypes.c_void_p).value for pointer in pointers]
        guard(*values, scratch=np.array(addresses, dtype=np.uint64).view(np.float64))
        failure.raised()

    return guarded
