"""Golden numbers: cases A to D of the activator/repressor plant, from an independent high-order solver."""

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from input_histories import means

INPUTS: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "A": lambda x: 0 * x,
    "B": lambda x: 0.05 * (1 + np.sin(2 * np.pi * x)),
    "C": lambda x: 0.1 * np.exp(-2 * x),
    "D": lambda x: 0.04 + 0.03 * np.cos(np.pi * x),
}
CASES = tuple(INPUTS)


@dataclass(frozen=True)
class Golden:
    """One case: X (2,), u(x), D_hat, and P, Phi, q1, q2, w at x = 1/4, 1/2, 3/4, 1; phi with b = 1."""

    X: np.ndarray
    u: Callable[[np.ndarray], np.ndarray]
    D_hat: float
    P: np.ndarray
    Phi: np.ndarray
    q1: np.ndarray
    q2: np.ndarray
    w: np.ndarray
    phi: float

    def means(self, nx: int) -> np.ndarray:
        """u as a loop gives it: its means over the cells of the nodes, (nx, 1)."""
        return means(lambda x: self.u(x)[..., None], nx)

    def quarters(self, values: np.ndarray) -> np.ndarray:
        """The rows of a nodal array (nx, ...) at x = 1/4, 1/2, 3/4, 1."""
        step = (len(values) - 1) // 4
        return values[step::step]


def case(name: str) -> Golden:
    """The golden numbers of a case."""
    raw = json.loads((Path(__file__).parent / "predictor.json").read_text())[name]
    arrays = {key: np.array(raw[key], dtype=float) for key in ("X", "P", "q1", "q2", "w")}
    Phi = np.array(raw["Phi"], dtype=float).reshape(-1, 2, 2)
    return Golden(u=INPUTS[name], D_hat=float(raw["Dhat"]), Phi=Phi, phi=float(raw["phi_b1_set"]), **arrays)
