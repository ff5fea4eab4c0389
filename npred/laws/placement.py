"""Pole placement for the linearisation."""

from collections.abc import Sequence

import numpy as np

from npred.base import randomness
from npred.laws.design import Design
from npred.laws.law import Law
from npred.laws.regulator import along
from npred.plants.base import Plant

TRIES = 20  # random choices of the free parameters of several inputs, of which the best conditioned is taken
ACCURATE = 1e-4  # of a coefficient of the polynomial of the poles, whose scale is 1 + the largest of them


def pole_placement(plant: Plant, poles: Sequence[complex]) -> Law:
    """kappa = u - K (x - X) such that A - B K has these n poles, complex ones in pairs.

    K = G inv(Z) with A Z - Z L = B G, L of the poles (Bhattacharyya and de Souza, Systems & Control Letters 1, 1982,
    261-263): one input has one K, of several the G that gives the best conditioned Z of a few.

    Parameters
    ----------
    plant : Plant
        From npred.plant.
    poles : n complex numbers, 1/s
        Poles of the loop without delay.

    Returns
    -------
    Law
        A law kappa(x, t, p, M) by the text of its definition, which can be pasted into a plant's class.

    Raises
    ------
    ConfigError
        For another number of poles, for one that is not stable, and where they cannot be placed.
    """
    design = Design(plant, "pole_placement")
    L = _block(design, checked(design, poles, plant.n))
    A, B = design.linearised
    draws = randomness.generator(0, "pole placement")
    best, K = np.inf, np.zeros((plant.m, plant.n))
    for _ in range(TRIES):
        # A first feedback moves the plant's own poles off those asked for, where the equation has no solution.
        first = draws.standard_normal(K.shape) * np.linalg.norm(A, 2) / np.linalg.norm(B, 2)
        moved, G = A - B @ first, draws.standard_normal(K.shape)
        eye = np.eye(plant.n)
        left = np.kron(moved, eye) - np.kron(eye, L.T)
        try:
            Z = np.linalg.solve(left, (B @ G).ravel()).reshape(A.shape)
            if np.linalg.cond(Z) < best:
                best, K = np.linalg.cond(Z), first + np.linalg.solve(Z.T, G.T).T
        except np.linalg.LinAlgError:
            continue
    # The polynomials are compared, for equal roots split by rounding.
    values = np.asarray(poles, dtype=complex)
    expected, actual = np.real(np.poly(values)), np.real(np.poly(A - B @ K))
    error = (np.abs(actual - expected) / (1 + np.abs(values).max()) ** np.arange(len(expected))).max()
    if not error <= ACCURATE:
        raise design.refusal("a linearisation whose poles the inputs move, got another", "take lqr")
    return along(design, K)


def checked(design: Design, poles: Sequence[complex], count: int) -> np.ndarray:
    """The poles, (count,). Raises ConfigError for other numbers of them, without their conjugates, or not stable."""
    try:
        values = np.array(poles, dtype=complex).ravel()
    except (TypeError, ValueError):
        raise design.refusal(f"{count} poles, got {poles!r}", "write a list of numbers") from None
    paired = np.allclose(np.sort_complex(values), np.sort_complex(values.conj()))
    if len(values) != count or not paired or not (np.isfinite(values).all() and (np.real(values) < 0).all()):
        expected = f"{count} poles with negative real parts, complex ones in pairs, got {poles}"
        raise design.refusal(expected, "write as many")
    return values


def _block(design: Design, poles: np.ndarray) -> np.ndarray:
    """A real matrix with these eigenvalues, equal ones in one chain."""
    upper = sorted((pole for pole in poles if pole.imag >= 0), key=lambda pole: (np.real(pole), np.imag(pole)))
    L, at, before = np.zeros((len(poles), len(poles))), 0, None
    for pole in upper:
        size = 2 if pole.imag else 1
        here = slice(at, at + size)
        L[here, here] = [[pole.real, pole.imag], [-pole.imag, pole.real]] if pole.imag else pole.real
        if pole == before:
            L[at - size : at, here] = np.eye(size)
        at, before = at + size, pole
    return L


def default(closed: np.ndarray, count: int) -> np.ndarray:
    """`count` poles at one place: minus the geometric mean of the sizes of the rates of a closed loop, three digits."""
    rate = np.exp(np.log(np.abs(np.linalg.eigvals(closed))).mean())
    return np.full(count, -float(f"{rate:.3g}"))
