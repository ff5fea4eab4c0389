"""The signals of the loop: each is a row here, and all that holds them follows: the C structs, the memory, the record.

A row is the name, the axes before the lanes, and what is in it at first. Kinds other than float64 are named.
"""

import ctypes
from collections import namedtuple
from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple

import numpy as np

from npred.kernels.kernel import address, prototype
from npred.loop import clock, measurement
from npred.prediction.delays import problem

C = {"float64": "double", "int64": "int64_t", "bool": "uint8_t", "int": "int"}
NUMBERS = {"float64": ctypes.c_double, "int64": ctypes.c_int64, "int": ctypes.c_int}


class Signal(NamedTuple):
    """A signal: its axes before the lanes, its first value, its kind."""

    name: str
    axes: tuple[str, ...] | None  # None for one number
    start: float = np.nan
    kind: str = "float64"


def _lane(*names: str, start: float = np.nan, kind: str = "float64") -> list[Signal]:
    return [Signal(name, (), start, kind) for name in names]


def _rows(axis: str, *names: str, start: float = np.nan) -> list[Signal]:
    return [Signal(name, (axis,), start) for name in names]


STATE = [
    *_rows("n", "X"),  # the plant's state
    *_rows("n", "X_hat"),  # what the controller sees or estimates of X: X itself by default
    *_rows("n", "Y"),  # the samples that arrive now, NaN where none does: X itself by default
    *_rows("m", "D"),  # the delay of each input
    *_rows("m", "D_seen"),  # the delay by which the controller reads the commands: D itself if u is measured
    *_rows("m", "speed", start=1.0),  # the speed of phi(t) = t - D
    *_lane("longest", start=0.0),  # the plant's longest delay
    Signal("observer", ("observer",)),  # what an observer of the delay remembers
    Signal("past", ("past", "n")),  # the last states
    *_lane("due", start=0.0),  # when the next sample is taken, in control steps
    *_lane("sampled", start=0, kind="int64"),  # samples taken so far
    *_lane("D_hat"),
    Signal("held", ("rows", "m")),
    Signal("total", ("rows", "m")),
    Signal("u", ("nx", "m")),  # means over the nodes' cells
    Signal("u_nodes", ("nx", "m")),  # values at the nodes
    Signal("P", ("nx", "n")),
    *_rows("m", "U", start=0.0),
    *_lane("phi", start=0.0),
    *_lane("phi_before"),  # phi of the step before; NaN at first
    *_lane("N"),
    *_rows("m", "U0", "U1", "share"),  # the delayed input for the first share of a step, and for the rest
    *_lane("drawn", start=0, kind="int64"),  # samples of the record taken so far
    *_lane("error", "fallback", start=0.0),  # the guard's estimate of the error of U; 1 where it answered
    *_lane(
        "kept", "filtered", "unkept", "promised", "withdrawn", start=0.0
    ),  # of a filter: the least h; 1 if it changed U; if no U keeps the limits; if a plan does for good; promises ended
    Signal("plan", ("plan",), 0.0),  # the plan of a safety filter: what it will add to kappa
    *_rows("m", "low", "high", "D_moved"),  # the bounds of U for the filter, and the delays of a prediction
    Signal("ends", ("ends", "n")),  # the states that are predicted for the moments when U acts
    Signal("moments", ("ends",)),
    *_rows("n", "expected"),  # X by a controller's model, from the call before and the commands; NaN before the first
    *_lane("first_refused", "believed_since"),  # npred/kernels/c/gate.h, of a loop in lanes
    *_lane("stray", start=0.0),
    *_lane("missed", start=0.0),  # the last samples in a row that the gate of a controller refused
    Signal("clock", ("clock",)),  # what a controller remembers of its calls: npred/kernels/c/controller.h
    *_rows(
        "outputs", "sample", "innovation", "fate"
    ),  # the sample for an observer of the state, its error, and whether it was used
    Signal("filter", ("filter",)),  # what that observer remembers
]
RECORD = [
    Signal("X", ("row", "n")),
    Signal("P", ("row", "n")),  # the prediction at x = 1
    Signal("U", ("row", "m")),
    *_rows("row", "D_hat", "N"),
    *_rows("row", "energy"),  # the integral of |U - U*|² over the true delay
    Signal("sample_X", ("sample", "n")),  # the last one where a prediction ended
    Signal("sample_u", ("sample", "nx", "m")),
    *_rows("sample", "sample_D_hat"),
    *_lane("escaped", start=-1, kind="int64"),  # the first step whose state is not finite
    *_lane("infeasible", start=-1, kind="int64"),  # the first step at which commands would overtake each other
    *_lane("D_hat_spread"),  # at the end: half the range of the delays whose misfit noise can explain
    *_rows("breach", "breach"),  # state and input there, and the time of that step
    Signal("fallback", ("row",), 0, "bool"),  # whether the guard answered since the row before
    *_lane("fallbacks", start=0, kind="int64"),  # the steps in which it did
    Signal("filtered", ("row",), 0, "bool"),  # whether the safety filter changed U since the row before
    *_lane("changes", start=0, kind="int64"),  # the steps in which it did
    Signal("promised", ("row",), 0, "bool"),  # whether it promises to keep all limits
    *_lane("unkept", start=0, kind="int64"),  # the steps in which no U was found that keeps all limits
]
CONTROLS = [  # the settings of a controller: its export in C has these
    *(Signal(name, None, 0.0) for name in ("dt", "b", "gamma_dt")),  # gamma_dt = gamma dt, or 0 with D_hat frozen
    Signal("gate", None, 0.0),  # how far a sample may be from what is expected, as a share of that
    Signal("oldest", None, 0.0),  # how late a sample may come, in control steps
    Signal("after", None, 0.0),  # how long a watchdog waits for one
    Signal("uncertain", None, 0.0),  # how wrong D_hat may be
    Signal("reads_commands", None, 0, "int"),  # whether the controller reads the actuator state from its commands
    Signal("stores_commands", None, 0, "int"),  # whether the history of commands gives u at the nodes
    Signal("gated", None, 0, "int"),  # whether samples far from what is expected are refused
    Signal("offsets", None, 0, "int"),  # whether an observer of the state estimates a constant added to U
    *(Signal(name, None, 0, "int") for name in ("watched", "holds")),  # a watchdog: its own, that keeps the last U
    Signal("judges_outputs", None, 0, "int"),  # whether an observer of the delay gets samples of the outputs
    Signal("pulls", None, 0, "int"),  # whether an observer of the state corrects it between samples too
    Signal("filter_count", None, 0, "int"),  # numbers that an observer of the state remembers
    Signal("observer_count", None, 0, "int"),  # numbers that an observer of the delay remembers, for a step to undo
    Signal("output_count", None, 0, "int"),  # numbers of a sample
    Signal("end_count", None, 0, "int"),  # predicted states in which limits are kept
    Signal("bounds", ()),  # (2,) of D_hat
    Signal("input_bounds", ()),  # (m, 2)
    Signal("p", ()),
    Signal("ratios", ()),  # (m,), the delay of each input as a share of the longest
    Signal("law", ()),  # settings of an observer of the delay
    Signal("guard", ()),  # settings of the guard
    Signal("reach", ()),  # (n,), how far a sample may be from what is expected near 0
    Signal("sensing", ()),  # settings of an observer of the state
    Signal("anew", ()),  # its memory for a restart; without an observer the middle of the box (n,)
    Signal("widens", ()),  # 1 for the variances in it
    Signal("rescue", ()),  # (m,), the U of a watchdog that declares numbers
    Signal("jump", ()),  # (m,), how far U moves in a call while the watchdog takes or returns it
    Signal("safety", ()),  # settings of a safety filter
]
SIMULATES = [  # those of what is simulated around it: its plant, its sensors, the record
    *(Signal(name, None, 0, "int64") for name in ("every", "row_count", "sample_count", "late")),
    *(Signal(name, None, 0, "int") for name in ("moves", "senses", "tabulates")),
    Signal("disturbed", None, 0, "int"),  # lanes of the disturbance: 0 without one, 1 where it is the same for all
    Signal("u_star", ()),  # (m,)
    Signal("truth_p", ()),  # the parameters of the simulated plant
    *(Signal(name, None, 0.0) for name in ("period", "jitter", "drop")),  # samples; times in control steps
    *(Signal(name, None, 0, "int64") for name in ("age", "seed", "first")),  # first: number of the batch's first loop
    *(Signal(name, ()) for name in measurement.PER_STATE),  # (n,), what sensors make of X
    Signal("delays", ()),  # (steps + 1, m, B), of each input where the delay is a function of time, or empty
    Signal("disturbance", ()),  # (steps, m, disturbed), added to what leaves the actuator, or empty
    Signal("samples", (), 0, "int64"),  # (S, B), sorted steps whose (X, u, D_hat) are kept
]
SETTINGS = [*CONTROLS, *SIMULATES]
EVENTS = [  # one loop on a real clock; times since its start, in control steps
    *(Signal(name, ("count",)) for name in ("at", "gap", "age", "reaches")),  # each step's call: npred/loop/timing.py
    *(Signal(name, ("count",), 0, "bool") for name in ("skipped", "lost")),
    Signal("sample", ("count",), -1, "int64"),  # the row of the sample that it gets
    Signal("taken", ("samples",)),
    Signal("number", ("samples",), 0, "int64"),
    Signal("values", ("samples", "outputs")),  # the samples
    Signal("taken_count", (), 0, "int64"),  # samples taken so far
    Signal("at_plant", (), 0.0),  # how far the plant is
    Signal("sent_at", ("commands",)),  # when commands reached the actuator, or will; those before the start too
    Signal("sent", ("commands", "m")),
    Signal("sent_count", (), 0, "int64"),
    Signal("acting", ("m",), 0, "int64"),  # the number of the command that acts now
    Signal("unsaid", (), 0, "int64"),  # 1 where the last command was lost
    Signal("refusals", (), 0, "int64"),  # calls that gave no U
    Signal("X_hat", ("row", "n")),
    Signal("age_then", ("row",)),  # the age of the last used sample
    Signal("handed_over", ("row",), 0, "bool"),  # whether the watchdog gives U
    Signal("sample_count", None, 0, "int64"),
    Signal("tells", None, 0, "int"),  # whether the controller gets to know that a command was lost
]
PARTS = {
    "horizon": problem.HORIZON, "observer": problem.ESTIMATE, "observe": problem.OBSERVE,
    "model_delay": problem.HORIZON, "predict": problem.PREDICT, "guard": problem.GUARD, "control": problem.CONTROL,
    "update": problem.UPDATE,
    "delay_speed": problem.SPEED, "advance": problem.ADVANCE, "model": problem.ADVANCE,
    "follow": problem.FOLLOW, "correct": problem.CORRECT_BY, "watchdog_law": problem.CONTROL, "output": problem.OUTPUT,
    "protect": problem.PROTECT,
}  # fmt: skip

State = namedtuple("State", [signal.name for signal in STATE])
Record = namedtuple("Record", [signal.name for signal in RECORD])
Settings = namedtuple("Settings", [signal.name for signal in SETTINGS])
Events = namedtuple("Events", [signal.name for signal in EVENTS])


def settings(**numbers: Any) -> Settings:
    """The settings that are given, and of the others that none is used."""
    unused = {s.name: 0 if s.axes is None else np.zeros(0, dtype=s.kind) for s in SETTINGS}
    return Settings(**(unused | numbers))


def _structure(name: str, rows: Iterable[Signal]) -> Any:
    fields = [(s.name, NUMBERS[s.kind] if s.axes is None else ctypes.c_void_p) for s in rows]
    return type(name, (ctypes.Structure,), {"_fields_": fields})


_STRUCTURES: dict[type, Any] = {
    State: _structure("State", STATE),
    Record: _structure("Record", RECORD),
    Settings: _structure("Settings", SETTINGS),
    Events: _structure("Events", EVENTS),
}
Pointers = type("Parts", (ctypes.Structure,), {"_fields_": [(name, ctypes.c_void_p) for name in PARTS]})


def declared(events: bool = False) -> tuple[str, str]:
    """The C of the types of the parts and of the stamps of a clock, and of the structs, that of `events` too."""
    types = {arguments: name.capitalize() for name, arguments in reversed(PARTS.items())}
    parts = [f"typedef {prototype(f'(*{name})', arguments)};" for arguments, name in types.items()]
    pointers = [f"    {types[arguments]} {name};" for name, arguments in PARTS.items()]
    kinds = {"State": STATE, "Record": RECORD, "Settings": SETTINGS} | ({"Events": EVENTS} if events else {})
    structs = [_struct(name, rows) for name, rows in kinds.items()] + [_braced("Parts", pointers)]
    return "\n".join([*parts, clock.declared()]), "\n".join(structs)


def _struct(name: str, rows: Iterable[Signal]) -> str:
    return _braced(name, [f"    {C[s.kind]} {'' if s.axes is None else '*'}{s.name};" for s in rows])


def _braced(name: str, lines: Iterable[str]) -> str:
    return "typedef struct {\n" + "\n".join(lines) + f"\n}} {name};\n"


def memory(rows: Iterable[Signal], sizes: Mapping[str, int], lanes: int, arrays: Mapping[str, np.ndarray]) -> Any:
    """The arrays of the rows by name: those given, and new ones."""
    shapes = {s.name: (*(sizes[axis] for axis in s.axes or ()), lanes) for s in rows if s.name not in arrays}
    new = {s.name: np.full(shapes[s.name], s.start, dtype=s.kind) for s in rows if s.name not in arrays}
    return {s.name: arrays.get(s.name, new.get(s.name)) for s in rows}


def joined(records: Iterable[Record]) -> Record:
    """The lanes of several records, one after the other."""
    return Record(*(np.concatenate(arrays, axis=-1) for arrays in zip(*records, strict=True)))


def structure(values: Any) -> Any:
    """The C struct of a State, Record, Settings or Events, whose arrays have to outlive it."""
    passed = {name: address(v) if isinstance(v, np.ndarray) else v for name, v in values._asdict().items()}
    return _STRUCTURES[type(values)](**passed)
