"""Rigid-body dynamics of a serial chain by recursion, on numbers, arrays or symbols.

Featherstone, Rigid Body Dynamics Algorithms, 2008: the recursive Newton-Euler algorithm (sec. 5.3) for the torques, the
composite-rigid-body algorithm (sec. 6.2) for the mass matrix. Vectors are lists of three, in the frame of their body.
"""

from dataclasses import dataclass

import numpy as np

from npred.formulas import Value
from npred.formulas.ldl import total
from npred.formulas.tape import Functions

Vector = list[Value]
Matrix = list[Vector]


@dataclass(frozen=True)
class Body:
    """A moving link with the joint that carries it: angles in rad, lengths in m, masses in kg.

    `turn` (3, 3) and `position` (3,) are the joint's frame in that of the body before it, `axis` (3,) the joint's unit
    axis; `mass`, `centre` (3,) and `inertia` (3, 3) about the centre are the link's, in the joint's frame.
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


def torques(
    bodies: list[Body], q: Vector, rates: Vector, accelerations: Vector, gravity: Value, M: Functions
) -> Vector:
    """The joints' torques and forces for those accelerations, damping left out: M(q) q'' + C(q, q') q' + G(q).

    w is a body's angular velocity, dw its derivative, a the acceleration of its origin less that of gravity; f and n
    are force and moment about its origin.
    """
    placed = [_placed(body, angle, M) for body, angle in zip(bodies, q, strict=True)]
    w, dw, a = [0.0] * 3, [0.0] * 3, [0.0, 0.0, gravity]
    loads: list[tuple[Vector, Vector]] = []
    for body, (turn, position), rate, acceleration in zip(bodies, placed, rates, accelerations, strict=True):
        a = back(turn, add(a, cross(dw, position), cross(w, cross(w, position))))
        w, dw, axis = back(turn, w), back(turn, dw), body.axis.tolist()
        joint_v, joint_a = [rate * c for c in axis], [acceleration * c for c in axis]
        if body.slides:
            a = add(a, [2.0 * c for c in cross(w, joint_v)], joint_a)
        else:
            dw = add(dw, cross(w, joint_v), joint_a)
            w = add(w, joint_v)
        centre, inertia = body.centre.tolist(), body.inertia.tolist()
        f = [body.mass * c for c in add(a, cross(dw, centre), cross(w, cross(w, centre)))]
        loads.append((f, add(times(inertia, dw), cross(w, times(inertia, w)), cross(centre, f))))
    shares: Vector = []
    f, n = [0.0] * 3, [0.0] * 3
    for body, (turn, position), (f_body, n_body) in reversed(list(zip(bodies, placed, loads, strict=True))):
        f, n = add(f_body, f), add(n_body, n)  # each body carries those beyond it
        shares.append(dot(body.axis.tolist(), f if body.slides else n))
        f, n = moved(turn, position, f, n)
    return shares[::-1]


def mass_matrix(bodies: list[Body], q: Vector, M: Functions) -> Matrix:
    """M(q), (n, n), symmetric."""
    placed = [_placed(body, angle, M) for body, angle in zip(bodies, q, strict=True)]
    H: Matrix = [[0.0] * len(bodies) for _ in bodies]
    mass, first, second = 0.0, [0.0] * 3, [[0.0] * 3 for _ in range(3)]  # all bodies from here on, about this origin
    for i in reversed(range(len(bodies))):
        body, axis = bodies[i], bodies[i].axis.tolist()
        mass = mass + body.mass
        first = add(first, [body.mass * c for c in body.centre.tolist()])
        c = body.centre
        about_origin = (body.inertia + body.mass * (c @ c * np.eye(3) - np.outer(c, c))).tolist()  # by Steiner
        second = [add(a, b) for a, b in zip(second, about_origin, strict=True)]
        f = [mass * c for c in axis] if body.slides else cross(axis, first)
        n = cross(first, axis) if body.slides else times(second, axis)
        for j in range(i, -1, -1):
            H[i][j] = H[j][i] = dot(bodies[j].axis.tolist(), f if bodies[j].slides else n)
            f, n = moved(*placed[j], f, n)
        first, second = _composite(*placed[i], mass, first, second)
    return H


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
