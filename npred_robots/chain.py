"""A robot arm from its URDF file as a declaration: computed torque about a wave, traced or by a rigid-body library.

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
from typing import NamedTuple, Protocol

import numpy as np

from npred.base.errors import ConfigError
from npred.formulas import Parameters, Value, array_math
from npred.formulas.ldl import total
from npred.formulas.tape import Functions
from npred_robots import rigid_body, urdf
from npred_robots.rigid_body import Body, Matrix, Vector

GAINS = {"stiffness": 40.0, "damping": 14.0, "amplitude": 0.2, "frequency": 0.6, "gravity": 9.81}
TURNS, SLIDES = ("rad", "rad/s", "N m"), ("m", "m/s", "N")  # units of a joint's position, rate and input


class Joint(Protocol):
    """A declaration's view of a body: its joint's name, whether it slides, and the largest torque or force."""

    @property
    def joint(self) -> str: ...
    @property
    def slides(self) -> bool: ...
    @property
    def effort(self) -> float: ...


class Dynamics(Protocol):
    """A library's model of a chain of n joints, row by row; arrays are (B, n).

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
        """The torques of that motion, with the friction that there would be at `speeds`."""
        ...


class Wave(NamedTuple):
    """The reference of the joints: middle_i + amplitude sin(frequency t + phase_i)."""

    middle: list[float]
    phase: list[float]


def chain(path: str | Path, pose: Sequence[float] | None = None) -> type:
    """The declaration of the serial chain of a URDF file, traced: see `serial`.

    Raises ConfigError for a file that is no such chain.
    """
    return serial(urdf.read(path), Path(path).name, pose)


def serial(
    bodies: list[Body], title: str, pose: Sequence[float] | None = None, phases: Sequence[float] | None = None,
    **more: object,
) -> type:  # fmt: skip
    """The declaration of a chain of bodies, traced; `title` says in its docstring which, `more` are further attributes.

    M(q) q'' + C(q, q') q' + G(q) + joint damping q' = U(t - D); states are the joints' positions and rates, by the
    joints' names (rad or m, and per second), inputs their torques or forces. The law is computed torque towards
    q_i(t) = pose_i + amplitude sin(frequency t + phase_i), by default about 0 with the phases 0, 1, 2, … It compensates
    friction at the rate that the error e calls for, r' - damping e / 2, not at the measured one, which would turn
    errors of a prediction into torques: without delay M (e'' + damping e' + stiffness e) = -(joint damping) (e' +
    damping e / 2). Inputs are bounded by the bodies' efforts where every joint has one. Raises ConfigError for a pose
    or phases of another number than the joints'.
    """
    n, rubs, wave = len(bodies), [body.damping for body in bodies], wave_of(bodies, pose, phases)

    def f(x: Vector, u: Vector, t: Value, p: Parameters, M: Functions) -> Vector:
        q, rates = list(x[:n]), list(x[n:])
        loads = rigid_body.torques(bodies, q, rates, [0.0] * n, p.gravity, M)
        forces = [a - b - c * rate for a, b, c, rate in zip(u, loads, rubs, rates, strict=True)]
        return [*rates, *M.solve(rigid_body.mass_matrix(bodies, q, M), forces)]

    def mechanics(x: Vector, u: Vector, t: Value, p: Parameters, M: Functions) -> tuple[Matrix, Vector, list[float]]:
        q, rates = list(x[:n]), list(x[n:])
        loads = rigid_body.torques(bodies, q, rates, [0.0] * n, p.gravity, M)
        return rigid_body.mass_matrix(bodies, q, M), [a - b for a, b in zip(u, loads, strict=True)], rubs

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

    functions = {"f": f, "kappa": kappa, "V": V, "reference": reference}
    return declaration(title, bodies, wave, functions | {"mechanics": mechanics}, **more)


def by_library(dynamics: Dynamics, wave: Wave) -> dict[str, Callable[..., np.ndarray]]:
    """f, kappa, V and reference of `serial` on rows, of dynamics that a library computes: called, and not traced."""
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

    return {"f": f, "kappa": kappa, "V": V, "reference": reference}


def declaration(
    title: str, bodies: Sequence[Joint], wave: Wave, functions: Mapping[str, Callable[..., object]], **more: object
) -> type:
    """The class that declares a chain of these bodies with its functions, and more attributes."""
    names = [_name(body.joint) for body in bodies]
    rates, efforts = [f"{name}_rate" for name in names], [body.effort for body in bodies]
    inputs = tuple(f"{name}_{'force' if body.slides else 'torque'}" for name, body in zip(names, bodies, strict=True))
    units: dict[str, str] = {}
    for body, *joint in zip(bodies, names, rates, inputs, strict=True):
        units |= zip(joint, SLIDES if body.slides else TURNS, strict=True)
    ranges = {name: (at - 0.3, at + 0.3) for name, at in zip(names, wave.middle, strict=True)}
    return type("Chain", (), {
        "__doc__": f"The chain of {title} under computed torque; see npred_robots.chain.",
        "states": (*names, *rates),
        "inputs": inputs,
        "units": units,
        "parameters": dict(GAINS),
        "box": ranges | dict.fromkeys(rates, (-0.2, 0.2)),
        "input_bounds": [(-e, e) for e in efforts] if all(map(math.isfinite, efforts)) else None,
        **{name: staticmethod(function) for name, function in functions.items()},
        **more,
    })  # fmt: skip


def _name(joint: str) -> str:
    """The joint's name as Python and npred accept it."""
    name = re.sub(r"\W", "_", joint)
    return name if name.isidentifier() and not iskeyword(name) and name[0] != "_" else f"joint_{name.lstrip('_')}"


def wave_of(bodies: Sequence[Joint], pose: Sequence[float] | None, phases: Sequence[float] | None = None) -> Wave:
    """The wave about these positions. Raises ConfigError for another number of them, or of phases."""
    middle = [0.0] * len(bodies) if pose is None else [float(at) for at in pose]
    phase = [float(i) for i in range(len(bodies))] if phases is None else [float(at) for at in phases]
    for name, asked, numbers in (("pose", pose, middle), ("phases", phases, phase)):
        if len(numbers) != len(bodies):
            raise ConfigError(
                f"chain: {name} expected {len(bodies)} numbers, one per joint that moves, got {asked!r}; give as many"
            )
    return Wave(middle, phase)


def motion(t: Value, p: Parameters, M: Functions, wave: Wave) -> tuple[Vector, Vector, Vector]:
    """The desired positions, rates and accelerations."""
    turns = [p.frequency * t + at for at in wave.phase]
    waves = [p.amplitude * M.sin(turn) for turn in turns]
    speed = [p.amplitude * p.frequency * M.cos(turn) for turn in turns]
    return [at + w for at, w in zip(wave.middle, waves, strict=True)], speed, [-(p.frequency**2) * w for w in waves]


def commanded(x: Vector | np.ndarray, t: Value, p: Parameters, M: Functions, wave: Wave) -> tuple[Vector, Vector]:
    """The rates that the errors call for, and the accelerations that make the errors linear."""
    n, (goal, speed, push) = len(wave.middle), motion(t, p, M, wave)
    errors = [x[i] - goal[i] for i in range(n)]
    rates = [speed[i] - 0.5 * p.damping * errors[i] for i in range(n)]
    return rates, [push[i] - p.stiffness * errors[i] - p.damping * (x[n + i] - speed[i]) for i in range(n)]
