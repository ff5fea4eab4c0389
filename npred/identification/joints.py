"""Delay and lag of each joint of a robot: its command and its position are a pair of columns.

A joint follows its command with a delay and a first-order lag, tau y' = gain u(t - D) + offset - y.
"""

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from npred import plants
from npred.base.errors import ConfigError
from npred.identification import recordings
from npred.identification.identify import Settings, of_log, recorded
from npred.identification.log import Log
from npred.plants import Plant

COMMAND = "action command commanded cmd target desired goal setpoint reference ref leader master"
MEASURED = "state observation obs actual measured feedback follower present position pos qpos puppet"
SAMPLES, BLOCK = 4000, 200  # samples that are used, in blocks of so many rows
DOUBTS = "The delay of command is not identifiable: ", "There is no answer: "
NO_LAG = 1e-3  # periods: the least lag that is not 0
LONGEST = 50  # periods: the longest delay that is tried by default


class FirstOrderLag:
    """The model of a joint."""

    states, inputs = ("position",), ("command",)
    parameters = {"gain": 1.0, "tau": 0.1, "offset": 0.0}

    @staticmethod
    def f(x: Any, u: Any, t: Any, p: Any, M: Any) -> list[Any]:
        return [(p.gain * u.command + p.offset - x.position) / p.tau]


@dataclass(frozen=True)
class JointDelay:
    """A joint with the columns of its command and its position, and what the recording tells of it.

    Delay and lag have intervals of 95 %; `certain` is False where `why` says why the delay is not known.
    """

    name: str
    command: str
    measured: str
    delay: float
    delay_interval: tuple[float, float]
    lag: float
    lag_interval: tuple[float, float]
    gain: float
    certain: bool
    why: str
    samples: int


@dataclass(frozen=True)
class JointLog:
    """A joint that is to be identified: its name, its columns, its log, and the longest delay to try."""

    name: str
    command: str
    measured: str
    log: Log
    longest: float | None = None


def tasks(files: Sequence[Path], longest: float | None = None, **reading: Any) -> tuple[list[JointLog], list[str]]:
    """A task for each pair of columns, as action[0] and observation.state[0], q1_cmd and q1; and what there is to say.

    `reading` is as in npred.identify. Raises ConfigError where there is no pair, or a file cannot be read.
    """
    names = recordings.opened(files[0]).columns()
    pairs = dict(_pairs(names))
    if not pairs:
        expected = (
            "pairs of columns with commands and positions, as action[0] and observation.state[0], or q1_cmd and q1"
        )
        raise ConfigError(f"{files[0]}: expected {expected}, found {', '.join(names[:12])}; rename them")
    u, y = ([f"{letter}{k}" for k in range(len(pairs))] for letter in "uy")
    every = plants.plant(type("Joints", (), {"states": y, "inputs": u, "f": lambda x, u, t, p, M: list(u)}))
    columns = dict(zip([*u, *y], [name for kind in zip(*pairs.values(), strict=True) for name in kind], strict=True))
    log, notes = recorded(every, files, columns, **reading)
    logs = [replace(log, U=log.U[:, [k]], Y=log.Y[:, [k]]) for k in range(len(pairs))]
    if len(log.t) > SAMPLES:
        notes.append(f"Of each joint those {SAMPLES} samples are used in which its command moves most.")
    return [JointLog(name, *pairs[name], each, longest) for name, each in zip(pairs, logs, strict=True)], notes


def _pairs(names: Sequence[str]) -> Iterator[tuple[str, tuple[str, str]]]:
    """What is left of a name without words for commands and positions, and the first of each with that."""
    commands, measured = {}, {}
    for name in names:
        words = re.findall(r"[a-z]+|\d+", re.sub(r"(?<=[a-z])(?=[A-Z])", "_", name).lower())
        kinds = [_is_one(word, COMMAND) for word in words], [_is_one(word, MEASURED) for word in words]
        key = "_".join(word for word, *kind in zip(words, *kinds, strict=True) if not any(kind))
        (commands if any(kinds[0]) else measured).setdefault(key, name)
    yield from ((key or "joint", (command, measured[key])) for key, command in commands.items() if key in measured)


def _is_one(word: str, words: str) -> bool:
    return word in words.split() or word.removesuffix("s") in words.split()


def identified(task: JointLog) -> JointDelay:
    """The answer of a joint, by the SAMPLES in which its command moves most."""
    plant, log = _model(), moving(task.log)
    longest = task.longest or min(LONGEST * task.log.period, task.log.span / 5)
    of, none = (task.name, task.command, task.measured), (np.nan, np.nan)
    try:
        answer = of_log(plant, log, Settings(plant.p_names, longest=longest))
    except ConfigError as refusal:
        return JointDelay(*of, np.nan, none, np.nan, none, np.nan, False, str(refusal), len(log.t))
    reasons = (line for line in answer.sentences if line.startswith(DOUBTS))
    certain = bool(answer.identifiable[0])
    why = "" if certain else next(reasons, "the recording does not tell the delay.").removeprefix(DOUBTS[0])
    why = why.partition(" Check the plant")[0]
    gain, lag = (answer.parameters.get(name, np.nan) for name in ("gain", "tau"))
    low, high = answer.interval[0].tolist()
    ends = answer.parameter_intervals.get("tau", none)
    ends = (ends[0] if ends[0] > NO_LAG * log.period else 0.0, ends[1]) if np.isfinite(ends[1]) else none
    return JointDelay(*of, float(answer.D[0]), (low, high), lag, ends, gain, certain, why, len(log.t))


@cache
def _model() -> Plant:
    return plants.plant(FirstOrderLag)


def moving(log: Log) -> Log:
    """The SAMPLES of a log, in whole blocks, in which commands move most, with all commands."""
    if len(log.t) <= SAMPLES:
        return log
    way = np.abs(np.diff(log.arrived(log.t, np.zeros(log.U.shape[1])), axis=0, prepend=np.nan)).sum(axis=1)
    way[np.isnan(way)] = 0.0
    blocks = np.array_split(np.arange(len(way)), -(-len(way) // BLOCK))
    most = sorted(blocks, key=lambda block: -way[block].sum())[: SAMPLES // BLOCK]
    return log.some(np.sort(np.concatenate(most)))
