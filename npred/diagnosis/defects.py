"""What keeps a plant from being controlled, each in one sentence with the line at fault and the cure, or None."""

import numpy as np

from npred.plants.base import Plant
from npred.symbolic import source_lines


def undeclared(plant: Plant) -> str | None:
    """What the plant lacks that an update law takes; the cure is the caller's."""
    return None if plant.declares_V else f"plant {plant.name}: found no V(x, t, p, M), which the update law takes"


def infinite(plant: Plant, X: np.ndarray, u: np.ndarray) -> str | None:
    """Where kappa, f or V are not finite, or V is negative, at states X (N, n) with inputs u (N, m)."""
    with np.errstate(all="ignore"):
        values = {"kappa": plant.kappa(X), "f": plant.f(X, u), "V": np.reshape(plant.V(X), (-1, 1))}
    for name, value in values.items():
        lost = ~np.isfinite(np.broadcast_to(value, (len(X), value.shape[-1]))).all(axis=-1)
        if lost.any():
            at = source_lines.values(plant.states, X[np.argmax(lost)])
            found = f"not finite at {at}, and on {lost.mean():.0%} of the box"
            return f"{plant.place(name)} is {found}; shrink box, or guard it with M.where"
    lowest = int(np.argmin(values["V"]))
    if values["V"][lowest] < 0:
        found = f"{values['V'][lowest, 0]:.3g} at {source_lines.values(plant.states, X[lowest])}"
        return f"{plant.place('V')} expected at least 0 on the box, got {found}; 1 + V divides: add squares"
    return None


def unstable(plant: Plant) -> str | None:
    """Why the loop of kappa without delay does not come to rest at the equilibrium."""
    A = closed_loop(plant)
    if not np.isfinite(A).all():
        return f"{plant.place('kappa')}: the loop has no derivative at the equilibrium; guard the term that has none"
    rates = np.linalg.eigvals(A)
    if rates.real.max() < 0:
        return None
    at = source_lines.values(plant.states, plant.equilibrium)
    found = f"eigenvalues {eigenvalues(rates)} at {at}, expected all negative"
    return f"{plant.place('kappa')} does not stabilise without delay: {found}; check its signs and gains"


def closed_loop(plant: Plant) -> np.ndarray:
    """f_X + f_U kappa' at the equilibrium, (n, n)."""
    f_X, f_U = plant.jacobians(plant.equilibrium, plant.u_equilibrium)
    return f_X + f_U @ plant.kappa_jacobian(plant.equilibrium)


def eigenvalues(rates: np.ndarray) -> str:
    """Complex numbers in words, the slowest first."""
    return ", ".join(_complex(rate) for rate in sorted(rates, key=lambda rate: -rate.real))


def _complex(rate: complex) -> str:
    return f"{rate.real:.3g}" + (f" {rate.imag:+.3g}i" if rate.imag else "")
