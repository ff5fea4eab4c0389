"""The delay estimate's update law: w, q1, phi and the projection [DAPF, eqs. 11-14]."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, partial
from typing import Any, NamedTuple

import numpy as np

from npred import array_checks
from npred.errors import ConfigError
from npred.loop import array_kernels, multi_delay_control
from npred.loop.delay_law import DelayLaw, interpreted
from npred.plants.base import Plant
from npred.plants.black_box import BlackBox
from npred.symbolic import called_functions, kernels, programs
from npred.symbolic.compile_cache import jit
from npred.symbolic.trace import Trace

# P (nx, n, B), u (nx, m, B), D_hat (B,), t, p -> U (m, B)
CONTROL_SIGNATURE = "void(float64[:,:,::1], float64[:,:,::1], float64[::1], float64, float64[::1], float64[:,::1])"
# P (nx, n, B), X (n, B), u at the nodes (nx, m, B), D_hat (B,), t, p, b -> phi (B,), N (B,)
UPDATE_SIGNATURE = (
    "void(float64[:,:,::1], float64[:,::1], float64[:,:,::1], float64[::1], float64, float64[::1], float64, "
    "float64[::1], float64[::1])"
)

UPDATE = """\
def update(P, X, u, D_hat, t, p, b, phi, N):
    nx, n, lanes = P.shape
    {parameters}
    r, s = np.empty((n, lanes)), np.empty((n, lanes))
    I1, I2 = np.empty(lanes), np.empty(lanes)
    j = 0
    for l in range(lanes):
        h = D_hat[l] / (nx - 1)
        {first}
        I1[l] = 0.5 * i1
        I2[l] = 0.5 * i2
    for j in range(1, nx):
        weight = (1.0 + j / (nx - 1)) * (0.5 if j == nx - 1 else 1.0)
        for l in range(lanes):
            h = D_hat[l] / (nx - 1)
            {node}
            I1[l] += weight * i1
            I2[l] += weight * i2
    for l in range(lanes):
        {end}
        N[l] = 1.0 + v + b * I2[l] / (nx - 1)
        phi[l] = -I1[l] / (nx - 1) / N[l]
"""

CONTROL = """\
def control(P, u, D_hat, t, p, U):
    lanes = P.shape[2]
    {parameters}
    j = P.shape[0] - 1
    for l in range(lanes):
        h = D_hat[l] / j
        {end}
"""


@dataclass(frozen=True)
class DelayAdaptation(DelayLaw):
    """D_hat' = gamma Proj_[bounds]{D_hat, phi} [DAPF, eq. 11]: gamma the adaptation gain, b > 0, bounds in seconds.

    Raises ConfigError for a gain, b or bounds that make no sense.
    """

    gamma: float = 1000.0

    def check(self, plant: Plant) -> None:
        """Raise ConfigError where inputs have delays of their own."""
        plant.needs_one_delay(
            "adaptation", 'its update law is for one; freeze the estimate, in a pipeline by adaptation = "frozen"'
        )

    def rate(
        self, plant: Plant, X: np.ndarray, u: np.ndarray, P: np.ndarray, D_hat: np.ndarray, t: float
    ) -> np.ndarray:  # fmt: skip
        """gamma phi, which the bounds make gamma Proj{D_hat, phi}."""
        return self.gamma * self.phi(plant, X, u, P, D_hat, t)

    def phi(self, plant: Plant, X: Any, u: Any, P: Any, D_hat: Any, t: float = 0.0) -> np.ndarray:
        """phi = -∫₀¹ (1+x) q1 w dx / (1 + V(X) + b ∫₀¹ (1+x) w² dx) [DAPF, eq. 12, with V at X(t)].

        X (..., n), u (..., nx, m), P (..., nx, n), D_hat (...) to phi (...). w = u - kappa(P, s) at s = t + x D_hat,
        and q1 = kappa_P r + kappa_s with dr/dx = D_hat (f_P r + f_s), r(0) = f(P(0), u(0), t): [DAPF, eq. 14] where
        f and kappa know no time. The integrals by the trapezoidal rule, r by Heun's method.
        Raises ConfigError where the shapes do not fit the plant or each other.
        """
        named = (("X", X), ("u", u), ("P", P), ("D_hat", D_hat))
        X, u, P, D_hat = (array_checks.floats(name, a) for name, a in named)
        self.check(plant)
        _check(plant, X, u, P)
        shape = array_checks.batch(X=X.shape[:-1], u=u.shape[:-2], P=P.shape[:-2], D_hat=D_hat.shape)
        lanes = [np.broadcast_to(a, (*shape, *a.shape[a.ndim - k :])) for a, k in ((X, 1), (u, 2), (P, 2), (D_hat, 0))]
        X, u, P, D_hat = (_lanes_last(a, len(shape)) for a in lanes)
        count = D_hat.shape[0]
        phi, N = np.empty(count), np.empty(count)
        update_law(plant)(P, X, u, D_hat, float(t), plant.p, self.b, phi, N)
        return phi.reshape(shape)


class Part(NamedTuple):
    """The laws as the time loop runs them: U, then phi and N on lanes, and D_hat += gain phi dt within the bounds."""

    control: Callable[..., None]
    update: Callable[..., None]
    gain: float
    b: float
    bounds: np.ndarray
    compiled: bool


def part(plant: Plant, law: DelayLaw | None) -> Part:
    """The laws' part of a control step: compiled for the paper's law and for None, which freezes D_hat."""
    control = control_law(plant)
    if law is None:
        return Part(control, _frozen(), 0.0, 1.0, np.array((0.0, np.inf)), True)
    bounds = np.array(law.bounds, dtype=float)
    papers = DelayAdaptation.rate, DelayAdaptation.phi
    if isinstance(law, DelayAdaptation) and (type(law).rate, type(law).phi) == papers:
        return Part(control, update_law(plant), law.gamma, law.b, bounds, True)
    return Part(control, interpreted(law, plant), 1.0, law.b, bounds, False)


@cache
def _frozen() -> Callable[..., None]:
    """D_hat stays as it is. Compiled on first use: `npred status` looks laws up, and has no use for Numba."""

    @jit(UPDATE_SIGNATURE, nogil=True)
    def frozen(P, X, u, D_hat, t, p, b, phi, N):  # type: ignore[no-untyped-def]
        """Nothing is added."""

    return frozen


def _check(plant: Plant, X: np.ndarray, u: np.ndarray, P: np.ndarray) -> None:
    """The kernel reads what the shapes promise: a wrong one would be read past its end."""
    nx = u.shape[-2] if u.ndim > 1 else 0
    for name, a, wanted in (("u", u, (max(nx, 2), plant.m)), ("P", P, (nx, plant.n)), ("X", X, (plant.n,))):
        if a.shape[-len(wanted) :] != wanted:
            axes = ", ".join(["..."] + ["nx"] * (len(wanted) - 1) + [str(wanted[-1])])
            raise ConfigError(f"{name}: expected shape ({axes}), nx >= 2 the same in u and P, got {a.shape}; fix it")


def _lanes_last(a: np.ndarray, leading: int) -> np.ndarray:
    return np.array(np.moveaxis(a.reshape(-1, *a.shape[leading:]), 0, -1), order="C")


@cache
def update_law(plant: Plant) -> Callable[..., None]:
    """The compiled update law: phi [DAPF, eq. 12] and N = 1 + V + b ∫ (1+x) w²."""
    if isinstance(plant, BlackBox):
        return array_kernels.update(plant, transition)
    trace = called_functions.trace(plant)
    x, u, t, h = trace.vector("x", plant.n), trace.vector("a", plant.m), trace.input("t"), trace.input("h")
    r, s = trace.vector("r", plant.n), trace.vector("s", plant.n)
    first, df = trace.f(x, u, t), partial(trace.df, dt=1.0)
    source = kernels.fill(
        UPDATE,
        parameters=kernels.parameters(len(plant.p)),
        first=_node(trace, x, u, t, h, first, h * df(x, u, t, first)),
        node=_node(trace, x, u, t, h, *transition(df, x, u, t, h, r, s)),
        end=programs.lines([trace.V(trace.vector("X", plant.n), trace.input("t0"))], _bindings(plant), ["v"]),
    )
    return kernels.build("update", UPDATE_SIGNATURE, source, called_functions.imports(trace))


@cache
def control_law(plant: Plant) -> Callable[..., None]:
    """The compiled control law: U_j = kappa_j(P(r_j)) with r_j = 1 for one delay [DAPF, eq. 9]."""
    if isinstance(plant, BlackBox):
        return array_kernels.control(plant)
    if not plant.one_delay:
        return multi_delay_control.build(plant, CONTROL_SIGNATURE)
    trace = called_functions.trace(plant)
    U = trace.kappa(trace.vector("x", plant.n), trace.input("t"))
    end = programs.lines(U, _bindings(plant), [f"U[{k}, l]" for k in range(plant.m)])
    source = kernels.fill(CONTROL, parameters=kernels.parameters(len(plant.p)), end=end)
    return kernels.build("control", CONTROL_SIGNATURE, source, called_functions.imports(trace))


def transition(df: Any, x: Any, u: Any, t: Any, h: Any, r: Any, s: Any) -> tuple[Any, Any]:
    """One step of dr/dx = D_hat (f_P r + f_t) by Heun's method: r at this node, and s = h (f_P r + f_t) for the next.

    x, u are of this node; r, s of the one before; h = D_hat / (nx - 1); df(x, u, t, r) is f_P r + f_t.
    """
    new = r + (s + h * df(x, u, t, r + s)) / 2
    return new, h * df(x, u, t, new)


def _node(trace: Trace, x: Any, u: Any, t: Any, h: Any, r: Any, s: Any) -> list[str]:
    """The lines of one node: r and s stored, i1 = q1·w and i2 = |w|²."""
    kappa, q1 = trace.law(x, t, r, 1.0)
    w, n = u - kappa, trace.plant.n
    targets = [f"r[{k}, l]" for k in range(n)] + [f"s[{k}, l]" for k in range(n)] + ["i1", "i2"]
    return programs.lines([*r, *s, np.dot(q1, w), np.dot(w, w)], _bindings(trace.plant), targets)


def _bindings(plant: Plant) -> dict[str, str]:
    names = {"t": "(t + j * h)", "t0": "t"}
    for k in range(plant.n):
        names |= {f"x{k}": f"P[j, {k}, l]", f"X{k}": f"X[{k}, l]", f"r{k}": f"r[{k}, l]", f"s{k}": f"s[{k}, l]"}
    return names | {f"a{k}": f"u[j, {k}, l]" for k in range(plant.m)}
