"""The time loop on flat memory, lanes innermost: one compiled engine for every plant, predictor and number of loops.

It is npred/kernels/c/engine.h. Its parts reach it as function pointers, so it is compiled once per machine; a part in
Python is called back, so that the order of a control step is written once.
"""

import ctypes
import struct
from collections.abc import Callable, Mapping
from functools import cache, partial
from typing import Any

import numpy as np

from npred.kernels import compiler
from npred.kernels.kernel import Failure, Kernel, Shape, address, callback, skeleton
from npred.loop import signals
from npred.loop.signals import PARTS, Events, Record, Settings, State
from npred.plants.base import Plant
from npred.prediction.delays import problem_of
from npred.prediction.methods.base import OneStep

LOOP = ("actuator.h", "hold.h", "onward.h", "sensor_errors.h", "sensor.h", "step.h", "gate.h", "marks.h", "engine.h")
ON_A_PLANT = ("actuator.h", "onward.h", "step.h", "gate.h", "controller.h", "candidates.h", "entries.h")
ON_A_CLOCK = ("actuator.h", "onward.h", "sensor_errors.h", "step.h", "gate.h", "controller.h", "marks.h", "clocked.h")
# in a step: what is not finite, a delay beyond the kept commands, no sample that tells the state
MEASUREMENT, PREDICTION, TOO_LONG, UNKNOWN = 1, 2, 4, 6
INDEX, POINTER = ctypes.c_int64, ctypes.c_void_p
CALL, CALLED = struct.Struct("4d"), ctypes.CFUNCTYPE(ctypes.c_int, POINTER)  # numbers of a call; its function


@cache
def loaded(files: tuple[str, ...]) -> ctypes.CDLL:
    """The compiled engine: of loops with a simulated plant, on control steps or on a clock, or for a real plant."""
    library = compiler.library(_text(files), exact=files is ON_A_PLANT)
    signatures: dict[str, tuple[list[Any], Any]] = {
        "run": ([INDEX, INDEX, INDEX, *(POINTER,) * 6], None),
        "run_clocked": ([INDEX, INDEX, INDEX, *(POINTER,) * 7], None),
        "spreads": ([POINTER] * 4, None),
        "replaced": ([POINTER, POINTER], None),
    }
    names = {LOOP: ["run"], ON_A_CLOCK: ["run_clocked"], ON_A_PLANT: ["spreads", "replaced"]}
    for name in names[files]:
        function = getattr(library, name)
        function.argtypes, function.restype = [Shape, *signatures[name][0]], signatures[name][1]
    return library


@cache
def _text(files: tuple[str, ...]) -> str:
    return "\n".join([skeleton("base.h"), *signals.declared(files is ON_A_CLOCK), *map(skeleton, files)])


def prepare(parts: Mapping[str, Kernel | Callable[..., Any] | None], files: tuple[str, ...] = LOOP) -> None:
    """Compile the engine and those parts that are not compiled yet, side by side."""
    kernels = [part for part in parts.values() if isinstance(part, Kernel) and not part.is_compiled]
    for exact in (False, True):
        units = [kernel.unit for kernel in kernels if kernel.exact is exact]
        if units:
            compiler.prepare([_text(files), *units] if exact is (files is ON_A_PLANT) else units, exact)


class Engine:
    """Control steps on a state, by parts: kernels, or functions in Python of the same arrays.

    The record `out` is that of a simulated plant. A controller on a real one has none; its last P (nx, n) and U (m,) go
    into `kept`. `events` are those of a controller on its own clock with a simulated plant.
    """

    def __init__(
        self, parts: Mapping[str, Kernel | Callable[..., Any] | None], settings: Settings, state: State,
        out: Record | None = None, events: Events | None = None, kept: tuple[np.ndarray, ...] = (),
    ) -> None:  # fmt: skip
        nx, n, lanes = state.P.shape
        rows, m = state.held.shape[:2]
        if out is None:
            parts = {name: part.exactly if isinstance(part, Kernel) else part for name, part in parts.items()}
        self._failure, self._shape = Failure(), Shape(nx, lanes, rows, n, m)
        prepare(parts, ON_A_CLOCK if events else LOOP if out else ON_A_PLANT)
        fixed = {"ratios": settings.ratios, "law": settings.law, "guard": settings.guard, "memory": state.observer}
        self._functions: dict[str, Any] = {}
        for name, one in parts.items():
            if isinstance(one, Kernel):
                self._functions[name] = one.function
            elif one:
                p = settings.truth_p if name in TRUE else settings.p
                self._functions[name] = callback(one, PARTS[name], fixed | {"p": p}, self._failure)
        pointers = {name: ctypes.cast(f, ctypes.c_void_p).value for name, f in self._functions.items()}
        needed = [part.work(nx, lanes, settings.guard) for part in parts.values() if isinstance(part, Kernel)]
        filters = settings.filter_count + 3 * settings.output_count + 1
        self._work = np.empty(max(needed, default=0) + 2 * n + 3 * m + settings.observer_count + filters + lanes)
        self._arrays = [settings, state, *([out] if out else []), *([events] if events else [])]
        self._structs = [signals.Pointers(**pointers), *map(signals.structure, self._arrays)]
        self._passed = [*map(ctypes.addressof, self._structs)]
        self._scratch = address(self._work)
        if kept:  # ctypes takes a quarter of the time for one argument
            numbers = bytearray(CALL.size)
            self._held = [self._shape, *self._structs, self._work, *kept, self._failure.flag, np.frombuffer(numbers)]
            addresses = (POINTER * len(self._held))(*map(address, self._held))
            self._called = partial(CALLED(("called", loaded(ON_A_PLANT))), ctypes.addressof(addresses))
            self._write, self._addresses = partial(CALL.pack_into, numbers, 0), addresses

    def run(self, origin: int, start: int, stop: int) -> None:
        """Control steps start … stop - 1 of a loop; `origin` is the ring buffers' number of step 0.

        Raises what a part in Python raises, as the other methods do.
        """
        flag = ctypes.addressof(self._failure.flag)
        loaded(LOOP).run(self._shape, origin, start, stop, *self._passed, flag, self._scratch)
        self._failure.raised()

    def run_clocked(self, start: int, stop: int, count: int) -> None:
        """Control steps start … stop - 1, of `count`, of a loop on its own clock."""
        flag = ctypes.addressof(self._failure.flag)
        loaded(ON_A_CLOCK).run_clocked(self._shape, start, stop, count, *self._passed, flag, self._scratch)
        self._failure.raised()

    def call(self, t: float, gap: float, came: bool, age: float) -> int:
        """A call of a controller at time t, `gap` control steps after the last one: U, P and the next D_hat.

        They follow from the sample, where one `came`, taken `age` control steps ago, and from u or the commands before.
        Returns 0, P and U being kept, or why there is no U to send: MEASUREMENT, PREDICTION, TOO_LONG, UNKNOWN. Then
        the last U is booked.
        """
        self._write(t, gap, came, age)
        code = self._called()
        if self._failure.error is not None:
            self._failure.raised()
        return code

    def replace(self, U: np.ndarray) -> None:
        """Put U (m,) for the last command."""
        loaded(ON_A_PLANT).replaced(self._shape, self._passed[2], address(U))


TRUE = ("horizon", "delay_speed", "advance", "output")  # parts of the simulated plant, which may have other parameters


@cache
def advance_kernel(plant: Plant, method: type[OneStep]) -> Callable[..., None]:
    """The step of the plant with held inputs, split where a switch of a delayed input falls inside it."""
    return problem_of(plant).advance(method.step)


def spreads(m: int, law: np.ndarray, memory: np.ndarray, D_hat: np.ndarray) -> np.ndarray:
    """Half the range of the candidates that an observer of the delay cannot tell apart, (B,); NaN at first."""
    out = np.empty(memory.shape[1])
    loaded(ON_A_PLANT).spreads(Shape(0, len(out), 0, 0, m), address(law), address(memory), address(D_hat), address(out))
    return out
