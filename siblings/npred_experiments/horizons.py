"""Delays D(t) = a + b / (1 + t) + α sin(ω t + φ), and the inverse of t - D(t): when a command of time t acts."""

from typing import Any

import numpy as np

T, DT = 12.0, 0.001  # s: of the loops, and of their steps
ITERATIONS, ROUNDING = 30, 1e-12  # Newton steps at most; the step (s) after which the next is below rounding

RANGES = (0.1, 0.5), (0.1, 0.5), (-0.3, 0.3), (0.0, 2 * np.pi), (0.0, np.pi)  # ranges of a, b, α, ω, φ
Delay = tuple[float, ...]  # a, b, α, ω, φ


def late(delay: Delay, t: Any) -> Any:
    """φ(t) = t - D(t), D = a + b / (1 + t) + α sin(ω t + φ)."""
    a, b, alpha, omega, shift = delay
    return t - (a + b / (1 + t) + alpha * np.sin(omega * t + shift))


def rate(delay: Delay, t: Any) -> Any:
    """φ'(t)."""
    _, b, alpha, omega, shift = delay
    return 1 + b / (1 + t) ** 2 - alpha * omega * np.cos(omega * t + shift)


def times() -> np.ndarray:
    """[0, 12] at steps of 1 ms."""
    return np.arange(round(T / DT) + 1) * DT


def drawn(generator: np.random.Generator) -> Delay:
    """A delay of the published ranges; commands may overtake each other."""
    return tuple(float(generator.uniform(low, high)) for low, high in RANGES)


def feasible(delay: Delay) -> bool:
    """Whether φ' > 0 throughout, and the delay is positive."""
    t = np.linspace(0.0, T, 4001)
    return bool((rate(delay, t) > 0).all() and (late(delay, t) < t).all())


def draws() -> tuple[Delay, Delay]:
    """D1 and D2 of the figure: the first pair of feasible draws."""
    generator = np.random.default_rng(1)
    while True:
        pair = drawn(generator), drawn(generator)
        if all(map(feasible, pair)):
            return pair


def inverse(delay: Delay, t: np.ndarray) -> np.ndarray:
    """ρ(t) = φ⁻¹(t) at many times at once by Newton's method: to rounding."""
    rho = t + (t - late(delay, np.maximum(t, 0.0)))
    for _ in range(ITERATIONS):
        step = (late(delay, rho) - t) / rate(delay, rho)
        rho = rho - step
        if np.abs(step).max(initial=0.0) < ROUNDING:
            break
    return rho


def tabulated(delay: Delay, t: np.ndarray) -> np.ndarray:
    """ρ(t) from a table of φ at steps of 0.1 ms, also where φ' is nearly 0 and Newton's method goes astray."""
    table = np.arange(0.0, T + 3.0, DT / 10)
    return np.interp(t, late(delay, table), table)
