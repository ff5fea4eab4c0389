"""The test of a safety filter inside an exported controller: calls of its kernel alone, each from another memory.

How far rounding may move an answer is measured in each call, by the kernel in the precision of the file, with
samples that are rounded otherwise, and with multiply-adds. A call in which rounding chooses the plan is not taken.
"""

from collections import Counter
from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np

from npred.base.randomness import generator
from npred.kernels import compiler
from npred.kernels.c_text import single
from npred.kernels.kernel import Shape, foreign_type
from npred.loop.controller import Controller
from npred.loop.safety.filter import BLOCKS, DRAWN
from npred.plants import Plant

STARTS, LENGTH = 64, 16  # states that loops begin at, and their control steps
ALIKE, TRIED = 4, 12  # calls of a kind that are taken, and that are tried
MOST = 96  # calls that are taken
OUTSIDE = 1.3  # boxes in which half the loops begin
BISECTIONS = 8  # between two calls of different kinds
BEYOND = 0.05  # of the size of h: how far the rest is out of the limits where they are moved
NARROW = 0.25  # of the bounds of U, if U usually needs more
PUSHED = 0.05  # of the box: how far a state is pushed on the way
ROUNDINGS, WIDER = 24, 64.0  # in which answers are compared, and how much larger than one of a sample they are
SAFE = 4.0  # how much more than there answers may differ
SURE = 0.01  # of the usual U: how far rounding may move U
NEVER = 1e29  # less than a time that never comes
FLAGS = 5  # the last numbers of an answer: kept, filtered, unkept, promised, withdrawn


class Cases(NamedTuple):
    """Calls: the margin, the bounds of U, ends, moments, U and memory (calls, …), and answers: U, memory and FLAGS
    numbers (calls, …), which may differ by 2 to the power `rounds`.
    """

    arguments: np.ndarray
    answers: np.ndarray
    rounds: np.ndarray


def cases(controller: Controller, kind: type) -> Cases:
    """Those of a controller in the precision of a type of numbers."""
    exactly = _called(controller, np.float64, kind)
    rounded = [_called(controller, kind, kind, exact) for exact in (True, False)]
    random, usual = generator(0, "filter test"), _usual(controller.plant)
    taken, tried, rows = Counter[tuple[bool, ...]](), Counter[tuple[bool, ...]](), []
    m, size = controller.plant.m, controller.memory.signals.plan.size
    flags = [*(m + BLOCKS * (m + 1) + np.arange(2)), *(m + size + np.arange(1, FLAGS))]
    for arguments, answer, middle in _searched(controller, exactly, kind):
        alike = (middle, *_alike(controller, arguments, answer))
        if taken[alike] >= ALIKE or tried[alike] >= TRIED:
            continue
        tried[alike] += 1
        apart = (
            WIDER
            * np.finfo(kind).eps
            * (arguments != np.rint(arguments))
            * random.uniform(-1, 1, (ROUNDINGS, len(arguments)))
        )
        got = np.array([one(arguments * (1 + off)) for off in (np.zeros(1), *apart) for one in rounded])
        off, errors = np.abs(got - got[0]).max(axis=0), np.abs(got - answer).max(axis=0)
        # a limit that is missed is weighed by the precision: there U in double is another one
        sizes = np.maximum(np.abs(answer), usual)
        sure = np.append(np.where(answer[2 - FLAGS] > 0, off, errors)[:m], off[m:]) <= SURE * sizes
        if sure.all() and (got[:, flags] == answer[flags]).all():
            taken[alike] += 1
            rows.append((taken[alike], arguments, got[0], off + 2 * np.finfo(kind).eps * sizes))
    of_each_kind = sorted(rows, key=lambda row: row[0])[:MOST]
    _, arguments, answers, off = (np.array(column) for column in zip(*of_each_kind, strict=True))
    return Cases(arguments, answers, np.ceil(np.log2(SAFE * np.maximum(off, np.finfo(np.float32).tiny))).astype(int))


def _called(controller: Controller, number: type, kind: type, exact: bool = True) -> Callable[[np.ndarray], np.ndarray]:
    """The kernel in a precision, of its arguments, with settings in another one, as a function."""
    kernel, settings, m, n = controller.parts["protect"], controller.settings, controller.plant.m, controller.plant.n
    text = f"#define WIDE 1\n#define LANES\n{kernel.unit}"
    entry = foreign_type(kernel.arguments)(
        ("entry", compiler.library(single(text) if number is np.float32 else text, exact))
    )
    ends = settings.end_count
    p, safety = (np.ascontiguousarray(a, kind).astype(number) for a in (settings.p, settings.safety))
    shape, work = Shape(1, 1, 0, n, m), np.empty(kernel.work(1, 1, None), number)
    parts = np.cumsum([1, m, m, ends * n, ends, m])

    def run(arguments: np.ndarray) -> np.ndarray:
        safety[n : n + 1], low, high, X, t, U, plan = np.split(arguments.astype(number), parts)
        results = [U, plan, *np.zeros((FLAGS, 1), number)]
        entry(shape, *(a.ctypes.data for a in (X, t, p, safety, low, high, *results, work)))
        return np.concatenate(results).astype(float)

    return run


def _searched(
    controller: Controller, exactly: Callable[[np.ndarray], np.ndarray], kind: type
) -> Iterator[tuple[np.ndarray, np.ndarray, bool]]:
    """The calls of loops, and where two that follow one another are of different kinds, calls between them."""
    before: tuple[tuple[bool, ...], np.ndarray] | None = None
    for arguments, answer in _met(controller, exactly, kind):
        yield arguments, answer, False
        after = _alike(controller, arguments, answer), arguments
        for _ in range(BISECTIONS):
            if before is None or before[0][:3] == after[0][:3]:
                break
            middle = (0.5 * (before[1] + after[1])).astype(kind).astype(float)
            middle[-controller.memory.signals.plan.size :] = before[1][-controller.memory.signals.plan.size :]
            answer = exactly(middle)
            if not np.isfinite(answer).all():
                break
            yield middle, answer, True
            between = _alike(controller, middle, answer), middle
            before, after = (between, after) if between[0][:3] == before[0][:3] else (before, between)
        before = _alike(controller, arguments, answer), arguments


def _met(
    controller: Controller, exactly: Callable[[np.ndarray], np.ndarray], kind: type
) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Calls of loops from the box and beyond, pushed on the way, and their answers."""
    plant, dt, random = controller.plant, controller.dt, generator(0, "filter test", "loops")
    box = np.ptp(plant.ranges(half=0.0), axis=1)
    apart = np.array([0.0, -1.0, 1.0])[: controller.settings.end_count, None] * controller.settings.uncertain
    rooms = list(_rooms(controller))
    for k, x in enumerate(plant.drawn("filter test", STARTS)):
        room, plan, t = rooms[k % len(rooms)], np.zeros(controller.memory.signals.plan.size), controller.t
        x = plant.target(0.0) + (x - plant.target(0.0)) * (OUTSIDE if k % 3 == 2 else 1.0)
        for s in range(LENGTH):
            U = plant.kappa(x, t)
            samples = x + apart * plant.f(x, U, t), t + apart
            arguments = np.concatenate([np.ravel(a) for a in (*room, *samples, U, plan)]).astype(kind).astype(float)
            answer = exactly(arguments)
            if not np.isfinite(answer).all():
                break
            yield arguments, answer
            U, plan = np.split(answer[:-FLAGS], [plant.m])
            middle_x = x + dt / 2 * plant.f(x, U, t)
            x, t = x + dt * plant.f(middle_x, U, t + dt / 2), t + dt
            for first in (0, 2 + BLOCKS * (plant.m + 1)) if s % 4 == 3 else ():  # a block that is over in the next step
                plan[first : first + BLOCKS] -= max(plan[first] - dt, 0.0)
            if s % 12 == 11:
                x = x + PUSHED * box * random.uniform(-1, 1, plant.n)


def _rooms(controller: Controller) -> Iterator[tuple[np.ndarray, ...]]:
    """The margin and the bounds of U; also a margin that the plant's rest is a little beyond, and narrow bounds."""
    plant, (low, high) = controller.plant, controller.settings.input_bounds.reshape(-1, 2).T
    margin, rest, usual = controller.settings.safety[plant.n], plant.u_target(0.0), _usual(plant)
    beyond = BEYOND * np.median(np.abs(plant.safe(plant.drawn("limits", DRAWN))))
    narrow = rest - np.minimum(usual, NARROW * (rest - low)), rest + np.minimum(usual, NARROW * (high - rest))
    for least in (margin, max(np.min(plant.safe(plant.target(0.0))), margin) + beyond):
        yield from ((least, *bounds) for bounds in ((low, high), narrow))


def _usual(plant: Plant) -> float:
    """How far U is from its rest in the box."""
    return np.median(np.abs(plant.kappa(plant.drawn("limits", DRAWN)) - plant.u_target(0.0)), axis=0).max()


def _alike(controller: Controller, arguments: np.ndarray, answer: np.ndarray) -> tuple[bool, ...]:
    """The kind of a call: what came of it, which parts of its memory are there, before and after, and what is at a
    bound.
    """
    m, size = controller.plant.m, len(answer) - FLAGS - controller.plant.m
    parts, size_of_plan = np.cumsum([BLOCKS, BLOCKS * m, 1, 1, BLOCKS, BLOCKS * m, 1, 1, m, m]), BLOCKS * (m + 1) + 2
    there = [
        part.any() and (part < NEVER).all()
        for memory in (arguments[-size:], answer[m : m + size])
        for part in np.split(memory, parts)[:-1]
    ]
    bounds = controller.settings.input_bounds.reshape(-1, 2)
    later = answer[[m, m + size_of_plan]] > arguments[[-size, size_of_plan - size]]  # where a block was split
    kinds = (
        answer[m] > 0,
        *(answer[2 - FLAGS : 4 - FLAGS] > 0),
        answer[-1] > 0,
        *there,
        *later,
        *(np.abs(answer[:m, None] - bounds) == 0).any(axis=0),
    )
    return tuple(map(bool, kinds))
