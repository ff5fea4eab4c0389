"""A robot from its URDF file as a declaration: computed torque about a wave, traced or by a rigid-body library.

from pathlib import Path
from npred_robots.chain import chain

Arm = chain(Path(__file__).with_name("my_arm.urdf"))
"""

import math
import re
from collections.abc import Callable, Mapping, Sequence
from keyword import iskeyword
from pathlib import Path
from threading import Lock
from typing import NamedTuple, Protocol, Unpack

import numpy as np

from npred.base.errors import ConfigError
from npred.formulas import Parameters, Value, array_math
from npred.formulas.ldl import total
from npred.formulas.tape import Functions
from npred_robots import rigid_body, urdf
from npred_robots.rigid_body import Body, Matrix, Vector

GAINS = {"stiffness": 40.0, "damping": 14.0, "amplitude": 0.2, "frequency": 0.6, "gravity": 9.81}
TURNS, SLIDES = ("rad", "rad/s"), ("m", "m/s")  # units of a joint's position and rate


class Joint(Protocol):
    """A declaration's view of a body: its joint's name, whether it slides, the least and the largest input of its
    motor, both 0 without one, the ending of that input's name and its unit, and the positions between which it stays.
    """

    @property
    def joint(self) -> str: ...
    @property
    def slides(self) -> bool: ...
    @property
    def push(self) -> tuple[float, float]: ...
    @property
    def input(self) -> tuple[str, str]: ...
    @property
    def lower(self) -> float: ...
    @property
    def upper(self) -> float: ...


class Dynamics(Protocol):
    """A library's model of n joints, row by row; arrays are (B, n), those of inputs (B, m).

    Libraries work in memory that belongs to the model, and some let other threads run meanwhile: whoever calls has it
    `alone`.
    """

    alone: Lock

    def accelerations(self, q: np.ndarray, rates: np.ndarray, u: np.ndarray, gravity: float) -> np.ndarray:
        """q'' under the torques u."""
        ...

    def torques(
        self, q: np.ndarray, rates: np.ndarray, accelerations: np.ndarray, speeds: np.ndarray, gravity: float
    ) -> np.ndarray:
        """The inputs of that motion, with the friction that there would be at `speeds`."""
        ...


class Wave(NamedTuple):
    """The reference of the joints: middle_i + share_i amplitude sin(frequency t + phase_i)."""

    middle: list[float]
    phase: list[float]
    share: list[float]


def chain(path: str | Path, pose: Sequence[float] | None = None, **options: Unpack[urdf.Options]) -> type:
    """The declaration of the robot of a URDF file, traced: see `serial`; options are those of npred_robots.urdf.read.

    Raises ConfigError for a file, or an option, that this does not take.
    """
    return serial(urdf.read(path, **options), Path(path).name, pose)


def serial(
    bodies: list[Body], title: str, pose: Sequence[float] | None = None, phases: Sequence[float] | None = None,
    **more: object,
) -> type:  # fmt: skip
    """The declaration of a tree of bodies, traced; `title` says in its docstring which, `more` are further attributes.

    M(q) q'' + C(q, q') q' + G(q) + joint damping q' = U(t - D); states are the positions and rates of the joints that
    mimic no other, by the joints' names (rad or m, and per second), inputs the torques or forces of those with a motor,
    bounded by the bodies' efforts. `safe` are the joints' limits, which f does not have.

    Where all have a motor the law is computed torque towards
    q_i(t) = pose_i + share_i amplitude sin(frequency t + phase_i), by default about 0 with the phases 0, 1, 2, …, and
    where a joint has limits moved and made smaller to lie within them. It compensates friction at the rate that the
    error e calls for, r' - damping e / 2, not at the measured one, which would turn errors of a prediction into
    torques: without delay M (e'' + damping e' + stiffness e) = -(joint damping) (e' + damping e / 2). Else there is no
    law (kappa = "lqr" designs one), and `pose` is where the search for its rest starts.

    Raises ConfigError for a pose or phases of another number than the joints', a pose beyond their limits, and joints
    with one name.
    """
    joints, rubs = rigid_body.leaders(bodies), rigid_body.damping(bodies)
    n, wave, motors = len(joints), wave_of(joints, pose, phases), driven(joints)
    limits = [(i, body.lower, 1) for i, body in enumerate(joints)] + [(i, b.upper, -1) for i, b in enumerate(joints)]
    limits = [(i, end, sign) for i, end, sign in limits if math.isfinite(end)]

    def net(x: Vector, u: Vector, p: Parameters, M: Functions) -> Vector:
        """The inputs less the torques that gravity and the motion take."""
        pushes = dict(zip(motors, u, strict=True))
        loads = rigid_body.torques(bodies, list(x[:n]), list(x[n:]), [0.0] * n, p.gravity, M)
        return [pushes[i] - load if i in pushes else -load for i, load in enumerate(loads)]

    def f(x: Vector, u: Vector, t: Value, p: Parameters, M: Functions) -> Vector:
        rates = list(x[n:])
        forces = [a - c * rate for a, c, rate in zip(net(x, u, p, M), rubs, rates, strict=True)]
        return [*rates, *M.solve(rigid_body.mass_matrix(bodies, list(x[:n]), M), forces)]

    def mechanics(x: Vector, u: Vector, t: Value, p: Parameters, M: Functions) -> tuple[Matrix, Vector, list[float]]:
        return rigid_body.mass_matrix(bodies, list(x[:n]), M), net(x, u, p, M), rubs

    def safe(x: Vector, t: Value, p: Parameters, M: Functions) -> Vector:
        return [sign * (x[i] - end) for i, end, sign in limits]

    def kappa(x: Vector, t: Value, p: Parameters, M: Functions) -> Vector:
        q, rates = list(x[:n]), list(x[n:])
        speeds, accelerations = commanded(x, t, p, M, wave)
        torques = rigid_body.torques(bodies, q, rates, accelerations, p.gravity, M)
        return [a + c * speed for a, c, speed in zip(torques, rubs, speeds, strict=True)]

    def V(x: Vector, t: Value, p: Parameters, M: Functions) -> Value:
        return total((a - b) * (a - b) for a, b in zip(x, reference(t, p, M), strict=True))

    def reference(t: Value, p: Parameters, M: Functions) -> Vector:
        goal, speed, _ = motion(t, p, M, wave)
        return goal + speed

    functions = {"f": f, "mechanics": mechanics} | ({"safe": safe} if limits else {})
    law = {"kappa": kappa, "V": V, "reference": reference} if len(motors) == n else {}
    return declaration(title, joints, wave, functions | law, **more)


def driven(joints: Sequence[Joint]) -> list[int]:
    """The numbers of the joints with a motor."""
    return [i for i, joint in enumerate(joints) if any(joint.push)]


def by_library(dynamics: Dynamics, joints: Sequence[Joint], wave: Wave) -> dict[str, Callable[..., np.ndarray]]:
    """f, and where all joints have a motor kappa, V and reference of `serial` on rows, of dynamics that a library
    computes: called, and not traced.
    """
    n = len(wave.middle)

    def f(X: np.ndarray, u: np.ndarray, t: Value, p: Parameters) -> np.ndarray:
        with dynamics.alone:
            return np.hstack([X[:, n:], dynamics.accelerations(X[:, :n], X[:, n:], u, p.gravity)])

    def kappa(X: np.ndarray, t: Value, p: Parameters) -> np.ndarray:
        columns = commanded(X.T, t, p, array_math.NUMPY, wave)
        speeds, accelerations = (np.stack([a + np.zeros(len(X)) for a in rows], axis=1) for rows in columns)
        with dynamics.alone:
            return dynamics.torques(X[:, :n], X[:, n:], accelerations, speeds, p.gravity)

    def V(X: np.ndarray, t: Value, p: Parameters) -> np.ndarray:
        return ((X - reference(np.broadcast_to(t, len(X)), p)) ** 2).sum(axis=1)

    def reference(t: np.ndarray, p: Parameters) -> np.ndarray:
        goal, speed, _ = motion(t, p, array_math.NUMPY, wave)
        return np.stack(goal + speed, axis=1)

    law = {"kappa": kappa, "V": V, "reference": reference} if len(driven(joints)) == n else {}
    return {"f": f} | law


def declaration(
    title: str, bodies: Sequence[Joint], wave: Wave, functions: Mapping[str, Callable[..., object]], **more: object
) -> type:
    """The class that declares these bodies with its functions, and more attributes.

    Raises ConfigError for joints whose states or inputs would have one name.
    """
    names, motors = [_name(body.joint) for body in bodies], driven(bodies)
    rates = [f"{name}_rate" for name in names]
    pushed = [f"{name}_{body.input[0]}" for name, body in zip(names, bodies, strict=True)]
    owners: dict[str, int] = {}
    units: dict[str, str] = {}
    for i, (body, *joint) in enumerate(zip(bodies, names, rates, pushed, strict=True)):
        for name in joint:
            if owners.setdefault(name, i) != i:
                what = f"the joints {bodies[owners[name]].joint} and {body.joint} both make {name}"
                raise ConfigError(f"{title}: expected joints that make different names, got: {what}; rename one")
        units |= zip(joint, (*(SLIDES if body.slides else TURNS), body.input[1]), strict=True)
    inputs, bounds = tuple(pushed[i] for i in motors), [bodies[i].push for i in motors]
    ranges = {
        name: (max(at - 0.3, body.lower), min(at + 0.3, body.upper))
        for name, at, body in zip(names, wave.middle, bodies, strict=True)
    }
    rest = {"parameters": {"gravity": GAINS["gravity"]}, "guess": (*wave.middle, *[0.0] * len(rates))}
    law = {"parameters": dict(GAINS)} if "kappa" in functions else rest
    return type("Chain", (), {
        "__doc__": f"The chain of {title} under computed torque; see npred_robots.chain.",
        "states": (*names, *rates),
        "inputs": inputs,
        "units": {name: units[name] for name in (*names, *rates, *inputs)},
        "box": ranges | dict.fromkeys(rates, (-0.2, 0.2)),
        "input_bounds": bounds if np.isfinite(bounds).any() else None,
        **{name: staticmethod(function) for name, function in functions.items()},
        **(law | more),
    })  # fmt: skip


def _name(joint: str) -> str:
    """The joint's name as Python and npred accept it."""
    name = re.sub(r"\W", "_", joint)
    return name if name.isidentifier() and not iskeyword(name) and name[0] != "_" else f"joint_{name.lstrip('_')}"


def wave_of(bodies: Sequence[Joint], pose: Sequence[float] | None, phases: Sequence[float] | None = None) -> Wave:
    """The wave about these positions, by default about those next to 0 with room for it between the joints' limits.

    Raises ConfigError for another number of positions or phases, and for a position beyond a limit.
    """
    largest = GAINS["amplitude"]
    rooms = [1.5 * min(largest, (body.upper - body.lower) / 4) for body in bodies]
    clear = [min(max(0.0, body.lower + room), body.upper - room) for body, room in zip(bodies, rooms, strict=True)]
    middle = clear if pose is None else [float(at) for at in pose]
    phase = [float(i) for i in range(len(bodies))] if phases is None else [float(at) for at in phases]
    for name, asked, numbers in (("pose", pose, middle), ("phases", phases, phase)):
        if len(numbers) != len(bodies):
            raise ConfigError(
                f"chain: {name} expected {len(bodies)} numbers, one per joint that moves, got {asked!r}; give as many"
            )
    for body, at in zip(bodies, middle, strict=True):
        if not body.lower <= at <= body.upper:
            limits = f"{body.joint} within its limits {body.lower:g} and {body.upper:g}"
            raise ConfigError(f"chain: pose expected {limits}, got {at:g}; move it inside")
    distances = [min(at - body.lower, body.upper - at) / 1.5 for body, at in zip(bodies, middle, strict=True)]
    return Wave(middle, phase, [min(1.0, distance / largest) for distance in distances])


def motion(t: Value, p: Parameters, M: Functions, wave: Wave) -> tuple[Vector, Vector, Vector]:
    """The desired positions, rates and accelerations."""
    turns = [p.frequency * t + at for at in wave.phase]
    heights = [p.amplitude if share == 1.0 else p.amplitude * share for share in wave.share]
    waves = [height * M.sin(turn) for height, turn in zip(heights, turns, strict=True)]
    speed = [height * p.frequency * M.cos(turn) for height, turn in zip(heights, turns, strict=True)]
    return [at + w for at, w in zip(wave.middle, waves, strict=True)], speed, [-(p.frequency**2) * w for w in waves]


def commanded(x: Vector | np.ndarray, t: Value, p: Parameters, M: Functions, wave: Wave) -> tuple[Vector, Vector]:
    """The rates that the errors call for, and the accelerations that make the errors linear."""
    n, (goal, speed, push) = len(wave.middle), motion(t, p, M, wave)
    errors = [x[i] - goal[i] for i in range(n)]
    rates = [speed[i] - 0.5 * p.damping * errors[i] for i in range(n)]
    return rates, [push[i] - p.stiffness * errors[i] - p.damping * (x[n + i] - speed[i]) for i in range(n)]
