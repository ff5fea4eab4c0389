"""X' = -X + U1(t - D1(X)) + U2(t - D2(X)), zero inputs: X at the time when U2 acts, P2 = x0 exp(-D2(P2)).

After Zhao, Gao, Xu, Kao, Automatica 144 (2022) 110479, whose printed second denominator a public re-implementation
(zhao-2022-reproduction) found to be wrong.
"""

import math
from typing import Any

import numpy as np

import npred
from npred import plants
from npred_experiments.experiment import Experiment, Measured, Measurements, PublishedNumber

STARTS = {0.2: "0.10632902870502527", 0.1: "0.05400009924092605", 0.05: "0.027217489803397023"}
PRINTED = "P2 from 0.2, denominator as printed"


class SecondInput:
    """The plant as its second input meets it."""

    states = ("x",)
    inputs = ("u",)

    @staticmethod
    def f(x: Any, u: Any, t: Any, p: Any, M: Any) -> list[Any]:
        return [u.u - x.x]

    @staticmethod
    def kappa(x: Any, t: Any, p: Any, M: Any) -> list[Any]:
        return [0.0 * x.x]

    @staticmethod
    def delay(x: Any, t: Any, p: Any, M: Any) -> Any:
        return 0.6 + 0.3 * M.tanh(x.x)


def delay(X: float, second: bool) -> float:
    """D2, or D1."""
    return (0.6 if second else 0.3) + (0.3 if second else 0.15) * math.tanh(X)


def solved(x0: float, second: bool = True) -> float:
    """The solution of P = x0 exp(-D(P)), by a fixed-point iteration that contracts."""
    P = x0
    for _ in range(100):
        P = x0 * math.exp(-delay(P, second))
    return P


def by_printed_denominator(x0: float, steps: int = 400) -> float:
    """P2 from P1 over D2 - D1 with the denominator (1 - ∇D1 f)(1 - ∇(D2 - D1) f); right is 1 - ∇D2 f."""

    def rate(P: float) -> float:
        slope = 0.15 / math.cosh(P) ** 2
        return -P / ((1 + slope * P) * (1 + slope * P))

    P = solved(x0, second=False)
    step = (delay(P, True) - delay(P, False)) / steps
    for _ in range(steps):
        a = rate(P)
        b = rate(P + step / 2 * a)
        c = rate(P + step / 2 * b)
        P += step / 6 * (a + 2 * b + 2 * c + rate(P + step * c))
    return P


def meant(x0: float, nodes: int = 401) -> float:
    """P2 by npred's predictor of plants that declare their delay."""
    plant = plants.make("second_input", SecondInput)
    predictor = npred.predictor(plant, "rk4", nx=nodes)
    P = predictor([x0], np.zeros((nodes, 1)), delay(x0, True))
    return float(np.asarray(P)[-1, 0])


def measure() -> Measurements:
    """P2 from each start, and with the denominator as printed."""
    rows = {f"P2 from {x0:g}": Measured(solved(x0), meant(x0)) for x0 in STARTS}
    return rows | {PRINTED: Measured(by_printed_denominator(0.2), meant(0.2))}


EXPERIMENT = Experiment(
    "scalar plant, two state-dependent delays",
    "zhao-2022-reproduction; Zhao, Gao, Xu, Kao, Automatica 144 (2022) 110479",
    (
        *(PublishedNumber(f"P2 from {x0:g}", digits) for x0, digits in STARTS.items()),
        PublishedNumber(PRINTED, "0.10633990646069874"),
    ),
    measure,
)
