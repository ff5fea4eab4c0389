"""The diagonals of Q and R of kappa = "lqr", as numbers that vary.

K is a parameter of the compiled law, so that other weights solve a Riccati equation, and compile nothing.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Self

import numpy as np

from npred import plants
from npred.laws.design import Design
from npred.laws.law import rounded
from npred.laws.regulator import adjustable, riccati, weights
from npred.plants import Plant

LETTERS = ("Q", "R")


@dataclass(frozen=True)
class LqrWeights:
    """`present` has those of the plant's law, Q.<state> … and R.<input> …; `law` is the plant whose law takes K as
    parameters.
    """

    design: Design
    present: Mapping[str, float]
    law: Plant

    @classmethod
    @lru_cache(maxsize=16)
    def of(cls, plant: Plant) -> Self | None:
        """None for a plant with another law. Raises ConfigError for weights that are no diagonals."""
        table = dict(plant.law_table)
        if table.pop("law", None) != "lqr":
            return None
        design = Design(plant, "lqr")
        both = weights(design, **table)
        if any(np.count_nonzero(matrix - np.diag(np.diag(matrix))) for matrix in both):
            raise design.refusal("diagonals Q and R to tune, got a matrix", "write one weight each")
        names = [*(f"Q.{name}" for name in plant.states), *(f"R.{name}" for name in plant.inputs)]
        present = dict(zip(names, np.concatenate([np.diag(matrix) for matrix in both]).tolist(), strict=True))
        return cls(design, present, adjustable(plant, riccati(*design.linearised, *both)[1]))

    def named(self, free: Sequence[str]) -> list[str]:
        """The names, with all weights for Q and R. Only ratios count: where all weights are free, the last is held."""
        names = [name for name in self.present if name in free or name[0] in free]
        names = names[:-1] if len(names) == len(self.present) else names
        return [*(name for name in free if name not in (*LETTERS, *self.present)), *names]

    def table(self, numbers: Mapping[str, float]) -> dict[str, Any]:
        """The kappa of a pipeline with these weights, and the present ones for the others."""
        both = {letter: [numbers.get(name, self.present[name]) for name in self.present if name[0] == letter]
                for letter in LETTERS}  # fmt: skip
        return {"law": "lqr", **both}

    def varied(self, numbers: Mapping[str, float]) -> Plant:
        """The plant with their gains. Raises ConfigError where the Riccati equation has no solution."""
        table = self.table(numbers)
        K = riccati(*self.design.linearised, np.diag(table["Q"]), np.diag(table["R"]))[1]
        names = list(self.law.parameters)[-K.size :]
        return plants.varied(self.law, tuple(zip(names, rounded(K).ravel().tolist(), strict=True)))
