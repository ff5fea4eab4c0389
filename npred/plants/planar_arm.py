"""A planar chain of rigid links, hanging from its first joint, with a motor at each: a plant whose f is costly."""

from typing import Any

LINKS = 5


def arm(links: int) -> type:
    """The declaration of a chain of so many equal rods.

    States are the links' angles to the vertical, downwards, theta1, theta2, … (rad), and their rates omega1, … (rad/s);
    inputs the joints' torques (N m). Lagrange's equations in absolute angles:
        sum_j c_ij cos(theta_i - theta_j) omega_j' + sum_j c_ij sin(theta_i - theta_j) omega_j² + g d_i sin(theta_i)
            = tau_i - tau_i+1 - friction omega_i,
    with c_ij the coupling of rods i and j and d_i the first moment that hangs on rod i. The law is computed torque
    towards the pose where each link is turned by `pose` from the one before.
    """
    angles = tuple(f"theta{i + 1}" for i in range(links))
    rates = tuple(f"omega{i + 1}" for i in range(links))

    def f(x: Any, u: Any, t: Any, p: Any, M: Any) -> list[Any]:
        torques = [*u, 0.0]
        forces = [torques[i] - torques[i + 1] - load for i, load in enumerate(_loads(x, p, M, links))]
        return [*x[links:], *_solve(_inertia(x, p, M, links), forces)]

    def kappa(x: Any, t: Any, p: Any, M: Any) -> list[Any]:
        wanted = [-p.stiffness * (x[i] - (i + 1) * p.pose) - p.damping * x[links + i] for i in range(links)]
        inertia, loads = _inertia(x, p, M, links), _loads(x, p, M, links)
        forces = [
            load + _sum(a * b for a, b in zip(row, wanted, strict=True))
            for row, load in zip(inertia, loads, strict=True)
        ]
        return [_sum(forces[i:]) for i in range(links)]

    def V(x: Any, t: Any, p: Any, M: Any) -> Any:
        errors = [x[i] - (i + 1) * p.pose for i in range(links)]
        return _sum(e * e for e in errors) + _sum(x[links + i] * x[links + i] for i in range(links))

    return type("PlanarArm", (), {
        "__doc__": f"A planar chain of {links} links under computed torque; see arm.",
        "states": angles + rates,
        "inputs": tuple(f"tau{i + 1}" for i in range(links)),
        "parameters": {"mass": 1.0, "length": 0.5, "gravity": 9.81, "friction": 0.1, "pose": 0.3, "stiffness": 4.0,
                       "damping": 4.0},
        "box": dict.fromkeys(angles, (-0.5, 1.5)) | dict.fromkeys(rates, (-0.5, 0.5)),
        "guess": tuple(0.3 * (i + 1) for i in range(links)) + (0.0,) * links,
        "f": staticmethod(f), "kappa": staticmethod(kappa), "V": staticmethod(V),
    })  # fmt: skip


def _coupling(i: int, j: int, links: int, p: Any) -> Any:
    """c_ij: what rod max(i, j) and those beyond it add, and a rod's own inertia, m l² / 3 about its end."""
    beyond = links - 1 - max(i, j)
    return p.mass * p.length * p.length * (beyond + (1 / 3 if i == j else 0.5))


def _inertia(x: Any, p: Any, M: Any, links: int) -> list[list[Any]]:
    """The mass matrix: c_ij cos(theta_i - theta_j), by the sines and cosines of the angles alone."""
    s, c = _turns(x, M, links)
    return [[_coupling(i, j, links, p) * (c[i] * c[j] + s[i] * s[j]) for j in range(links)] for i in range(links)]


def _loads(x: Any, p: Any, M: Any, links: int) -> list[Any]:
    """Centrifugal forces, weight and friction."""
    s, c = _turns(x, M, links)
    squares = [x[links + j] * x[links + j] for j in range(links)]
    hanging = [p.mass * p.length * (links - 0.5 - i) for i in range(links)]
    return [
        _sum(_coupling(i, j, links, p) * (s[i] * c[j] - c[i] * s[j]) * squares[j] for j in range(links) if j != i)
        + p.gravity * hanging[i] * s[i] + p.friction * x[links + i]
        for i in range(links)
    ]  # fmt: skip


def _turns(x: Any, M: Any, links: int) -> tuple[list[Any], list[Any]]:
    return [M.sin(x[i]) for i in range(links)], [M.cos(x[i]) for i in range(links)]


def _solve(A: list[list[Any]], b: list[Any]) -> list[Any]:
    """A y = b for a symmetric positive definite A, by A = L D L'."""
    n, D = len(b), []
    L: list[list[Any]] = [[] for _ in range(n)]
    for i in range(n):
        for j in range(i):
            L[i].append((A[i][j] - _sum(L[i][k] * D[k] * L[j][k] for k in range(j))) / D[j])
        D.append(A[i][i] - _sum(L[i][k] * L[i][k] * D[k] for k in range(i)))
    y: list[Any] = []
    for i in range(n):
        y.append(b[i] - _sum(L[i][k] * y[k] for k in range(i)))
    for i in reversed(range(n)):
        y[i] = y[i] / D[i] - _sum(L[k][i] * y[k] for k in range(i + 1, n))
    return y


def _sum(terms: Any) -> Any:
    """The sum without the leading zero of sum(): 0.0 for none."""
    total: Any = 0.0
    for k, term in enumerate(terms):
        total = term if k == 0 else total + term
    return total


PlanarArm = arm(LINKS)
