"""Rigid-body dynamics of a tree of bodies by recursion, on numbers, arrays or symbols.

Featherstone, Rigid Body Dynamics Algorithms, 2008: the recursive Newton-Euler algorithm (sec. 5.3) for the torques, the
composite-rigid-body algorithm (sec. 6.2) for the mass matrix. Vectors are lists of three, in the frame of their body.
Joints that mimic another move with it: their torques and inertias are seen by that one, through their ratio.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from npred.formulas import Value
from npred.formulas.ldl import total
from npred.formulas.tape import Functions

Vector = list[Value]
Matrix = list[Vector]


class Mimic(NamedTuple):
    """The position of a joint is ratio times that of the joint of body number `body`, plus offset."""

    body: int
    ratio: float
    offset: float


@dataclass(frozen=True)
class Body:
    """A moving link with the joint that carries it: angles in rad, lengths in m, masses in kg.

    `turn` (3, 3) and `position` (3,) are the joint's frame in that of the body before it, `axis` (3,) the joint's unit
    axis; `mass`, `centre` (3,) and `inertia` (3, 3) about the centre are the link's, in the joint's frame. `effort` is
    0 for a joint without a motor. `parent` is the number of the body before it, which comes earlier; -1 is the base.
    """

    joint: str
    slides: bool
    turn: np.ndarray
    position: np.ndarray
    axis: np.ndarray
    mass: float
    centre: np.ndarray
    inertia: np.ndarray
    damping: float
    effort: float
    parent: int = -1
    lower: float = -math.inf
    upper: float = math.inf
    mimic: Mimic | None = None

    @property
    def push(self) -> tuple[float, float]:
        """The least and the largest torque or force of its motor."""
        return -self.effort, self.effort

    @property
    def input(self) -> tuple[str, str]:
        """The ending of the name of that torque or force, and its unit."""
        return pushes(self.slides)


def pushes(slides: bool) -> tuple[str, str]:
    """What moves a joint: the ending of its name, and its unit."""
    return ("force", "N") if slides else ("torque", "N m")


def leaders(bodies: Sequence[Body]) -> list[Body]:
    """The bodies whose joints mimic no other: each is a coordinate."""
    return [body for body in bodies if body.mimic is None]


def moves(bodies: Sequence[Body]) -> list[tuple[int, float, float]]:
    """How each body's joint moves: the number of its coordinate, its ratio to it, and its offset."""
    numbers = [i for i, body in enumerate(bodies) if body.mimic is None]
    mimics = [body.mimic or Mimic(i, 1.0, 0.0) for i, body in enumerate(bodies)]
    return [(numbers.index(mimic.body), mimic.ratio, mimic.offset) for mimic in mimics]


def damping(bodies: Sequence[Body]) -> list[float]:
    """The damping (n,) of the coordinates."""
    return _shared(bodies, [body.damping * ratio for body, (_, ratio, _) in zip(bodies, moves(bodies), strict=True)])


def torques(
    bodies: list[Body], q: Vector, rates: Vector, accelerations: Vector, gravity: Value, M: Functions
) -> Vector:
    """The coordinates' torques and forces for those accelerations, damping left out: M(q) q'' + C(q, q') q' + G(q).

    w is a body's angular velocity, dw its derivative, a the acceleration of its origin less that of gravity; f and n
    are force and moment about its origin.
    """
    placed = _all_placed(bodies, q, M)
    rates, accelerations = ([_times(ratio, v[k]) for k, ratio, _ in moves(bodies)] for v in (rates, accelerations))
    motions = [([0.0] * 3, [0.0] * 3, [0.0, 0.0, gravity])]  # of the base, then of the bodies
    loads: list[tuple[Vector, Vector]] = []
    for body, (turn, position), rate, acceleration in zip(bodies, placed, rates, accelerations, strict=True):
        w, dw, a = motions[body.parent + 1]
        a = back(turn, add(a, cross(dw, position), cross(w, cross(w, position))))
        w, dw, axis = back(turn, w), back(turn, dw), body.axis.tolist()
        joint_v, joint_a = [rate * c for c in axis], [acceleration * c for c in axis]
        if body.slides:
            a = add(a, [2.0 * c for c in cross(w, joint_v)], joint_a)
        else:
            dw = add(dw, cross(w, joint_v), joint_a)
            w = add(w, joint_v)
        motions.append((w, dw, a))
        centre, inertia = body.centre.tolist(), body.inertia.tolist()
        f = [body.mass * c for c in add(a, cross(dw, centre), cross(w, cross(w, centre)))]
        loads.append((f, add(times(inertia, dw), cross(w, times(inertia, w)), cross(centre, f))))
    shares: Vector = [0.0] * len(bodies)
    for i in reversed(range(len(bodies))):
        body, (f, n) = bodies[i], loads[i]
        shares[i] = dot(body.axis.tolist(), f if body.slides else n)
        if body.parent >= 0:  # each body carries those beyond it
            before = zip(loads[body.parent], moved(*placed[i], f, n), strict=True)
            loads[body.parent] = (add(*next(before)), add(*next(before)))
    return _shared(bodies, shares)


def mass_matrix(bodies: list[Body], q: Vector, M: Functions) -> Matrix:
    """M(q), (n, n) of the n coordinates, symmetric."""
    placed = _all_placed(bodies, q, M)
    H: Matrix = [[0.0] * len(bodies) for _ in bodies]
    # mass, first moment and inertia about its origin of what each body carries
    carried: list[tuple[Value, Vector, Matrix]] = [(0.0, [0.0] * 3, [[0.0] * 3] * 3) for _ in bodies]
    for i in reversed(range(len(bodies))):
        body, axis, (mass, first, second) = bodies[i], bodies[i].axis.tolist(), carried[i]
        mass = mass + body.mass
        first = add(first, [body.mass * c for c in body.centre.tolist()])
        c = body.centre
        about_origin = (body.inertia + body.mass * (c @ c * np.eye(3) - np.outer(c, c))).tolist()  # by Steiner
        second = [add(a, b) for a, b in zip(second, about_origin, strict=True)]
        f = [mass * c for c in axis] if body.slides else cross(axis, first)
        n = cross(first, axis) if body.slides else times(second, axis)
        j = i
        while j >= 0:
            H[i][j] = H[j][i] = dot(bodies[j].axis.tolist(), f if bodies[j].slides else n)
            f, n = moved(*placed[j], f, n)
            j = bodies[j].parent
        if body.parent >= 0:
            m, a, b = carried[body.parent]
            first, second = _composite(*placed[i], mass, first, second)
            carried[body.parent] = (m + mass, add(a, first), [add(x, y) for x, y in zip(b, second, strict=True)])
    rows = [_shared(bodies, row) for row in H]
    columns = [_shared(bodies, list(column)) for column in zip(*rows, strict=True)]
    return [list(row) for row in zip(*columns, strict=True)]


def _shared(bodies: Sequence[Body], values: Vector) -> Vector:
    """What the coordinates (n,) see of the bodies' torques: a joint that mimics adds its own through its ratio."""
    shares: list[Vector] = [[] for _ in leaders(bodies)]
    for value, (k, ratio, _) in zip(values, moves(bodies), strict=True):
        shares[k].append(_times(ratio, value))
    return [total(share) for share in shares]


def _times(ratio: float, value: Value) -> Value:
    return value if ratio == 1.0 else ratio * value


def _all_placed(bodies: list[Body], q: Vector, M: Functions) -> list[tuple[Matrix, Vector]]:
    positions = [_times(ratio, q[k]) + offset if offset else _times(ratio, q[k]) for k, ratio, offset in moves(bodies)]
    return [_placed(body, at, M) for body, at in zip(bodies, positions, strict=True)]


def _composite(turn: Matrix, position: Vector, mass: Value, first: Vector, second: Matrix) -> tuple[Vector, Matrix]:
    """First moment and inertia about the origin of the body before: turned, then shifted by `position`."""
    first = times(turn, first)
    columns = [times(turn, row) for row in second]  # second is symmetric: rows are columns
    turned = [times(turn, [columns[j][i] for j in range(3)]) for i in range(3)]
    shifted = [first[i] + mass * position[i] for i in range(3)]
    inner = dot(position, first) + dot(position, shifted)
    for i in range(3):
        for j in range(i + 1):
            less = position[i] * first[j] + shifted[i] * position[j]
            turned[i][j] = turned[j][i] = turned[i][j] + (inner if i == j else 0.0) - less
    return shifted, turned


def _placed(body: Body, q: Value, M: Functions) -> tuple[Matrix, Vector]:
    """Turn and position of the body's frame in that of the body before, at joint position q."""
    if body.slides:
        along = (body.turn @ body.axis).tolist()
        return body.turn.tolist(), [p + q * a for p, a in zip(body.position.tolist(), along, strict=True)]
    x, y, z = body.axis.tolist()
    K = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    parts = (body.turn @ part for part in (np.eye(3) + K @ K, K, -K @ K))
    # numbers that only rounding keeps from 0 are 0: the program leaves those out
    constant, sine, cosine = (np.where(np.abs(part) < 1e-15, 0.0, part).tolist() for part in parts)
    s, c = M.sin(q), M.cos(q)
    turn = [[constant[i][j] + sine[i][j] * s + cosine[i][j] * c for j in range(3)] for i in range(3)]
    return turn, body.position.tolist()


def moved(turn: Matrix, position: Vector, f: Vector, n: Vector) -> tuple[Vector, Vector]:
    """Force and moment as the body before sees them."""
    f = times(turn, f)
    return f, add(times(turn, n), cross(position, f))


def times(A: Matrix, v: Vector) -> Vector:
    """A v."""
    return [dot(row, v) for row in A]


def back(A: Matrix, v: Vector) -> Vector:
    """A' v: of a turn, v in the frame of the body."""
    return [dot([row[k] for row in A], v) for k in range(3)]


def dot(a: Vector, b: Vector) -> Value:
    """a · b."""
    return total(x * y for x, y in zip(a, b, strict=True))


def cross(a: Vector, b: Vector) -> Vector:
    """a × b."""
    return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]


def add(*vectors: Vector) -> Vector:
    """The sum of vectors."""
    return [total(parts) for parts in zip(*vectors, strict=True)]
