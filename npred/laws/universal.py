"""Sontag's universal formula: a law from a function V that falls for some input."""

from collections.abc import Callable
from typing import Any

import numpy as np

from npred.formulas import Value, programs
from npred.formulas.declared import record
from npred.formulas.tape import M, names
from npred.formulas.trace import python
from npred.laws.design import SAMPLES, Design
from npred.laws.law import Law, rounded, written
from npred.laws.regulator import gains, weights
from npred.plants.base import Plant

LQR = "lqr"  # the V of the regulator's Riccati equation
SMOOTH = 1e-6  # share of the usual (a, b) on the box: where the formula passes into the linear law
DOUBLINGS = 40  # the most doublings of the linear law's gain


def sontag(plant: Plant, V: Callable[..., Any] | str | None = None) -> Law:
    """kappa = u - s b' (a + sqrt(a² + β² + ε²)) / (β + ε / g), β = b s b', with a = V_t + V_x f(x, u), b = V_x f_U.

    Sontag (Systems & Control Letters 13, 1989, 117-123) has ε = 0, s = 1, and no derivative where it rests. Here s are
    the inputs' sizes squared, ε is SMOOTH of the usual size of (a, β) on the box, and g the gain, doubled from 1/2,
    with which the linear law -g s b' makes V fall near rest: V' < 0 wherever a < 0, or β sqrt(a² + β² + ε²) > a ε / g.
    With V = "lqr" the root is that of a² + q β + ε (β / 2 + 2 q) + ε², q the regulator's e'Qe (Freeman and Primbs, CDC
    1996, 3926-3931). Of a linear plant at rest that is the square of β / 4 + q + ε, and the law is the regulator's.

    Parameters
    ----------
    plant : Plant
        From npred.plant.
    V : function (x, t, p, M) or "lqr", optional
        "lqr" is e'Se of the regulator; by default the V of the plant, and "lqr" without one.

    Returns
    -------
    Law
        A law kappa(x, t, p, M) by the text of its definition, which can be pasted into a plant's class.

    Raises
    ------
    ConfigError
        For an f that is not affine in the inputs, and for a V that no input makes fall near rest.
    """
    design = Design(plant, "sontag")
    value, cost = _value(design, V)
    u = design.target[1]
    velocity = design.trace.f(design.x, np.array(u, dtype=object), design.t)
    rate = programs.derivative([value], [design.t, *design.x], [1.0, *velocity])[0]
    row = [programs.derivative([value], design.x, column)[0] for column in design.B.T]
    squares = rounded(design.sizes**2)
    effect: Value = 0.0
    for b, weight in zip(row, squares, strict=True):
        effect = effect + weight * (b * b)
    slopes = [programs.derivative([value], design.x, unit)[0] for unit in np.eye(plant.n)]
    curvature = [y for unit in np.eye(plant.n) for y in programs.derivative(slopes, design.x, unit)]
    function = python(curvature, [*names("x", plant.n), "t", *names("p", len(plant.p))])
    H = np.array(function(*design.targets[0][0], 0.0, *plant.p), dtype=float).reshape(plant.n, plant.n) / 2
    A, B = design.linearised
    # the least g = 1/2, 1, 2, … with which V falls along the linear law near rest
    for g in (0.5 * 2.0 ** np.arange(DOUBLINGS)).tolist() if np.linalg.eigvalsh(H).min() > 0 else []:
        fall = H @ A + A.T @ H - 4 * g * (H @ B * squares) @ (B.T @ H)
        if np.linalg.eigvalsh(fall).max() < 0:
            break
    else:
        expected = "a V that some input makes fall near rest, got another"
        raise design.refusal(expected, f'pass V = "{LQR}", or another V')
    usual = np.hypot(*design.values([rate, effect], design.samples, np.zeros(SAMPLES)).T)
    small = float(f"{SMOOTH * np.nanmedian(usual):.1g}")
    more = effect * effect if cost is None else cost * effect + small * (effect / 2 + 2 * cost)
    size = M.sqrt(rate * rate + more + small**2)
    # where a < 0 the sum a + size cancels, and is written as the quotient that it equals
    sum_of_both = M.where(rate < 0, (more + small**2) / (size - rate), rate + size)
    pull = sum_of_both / (effect + small / g)
    u = [a - weight * b * pull for a, b, weight in zip(u, row, squares, strict=True)]
    return written(design.trace, design.guess, u)


def _value(design: Design, V: Callable[..., Any] | str | None) -> tuple[Value, Value | None]:
    """V on the tape, and e'Qe of the regulator whose V it is."""
    plant = design.plant
    if callable(V):
        p = record("Parameters", plant.p_names)(*design.trace.parameters)
        return V(record("State", plant.states)(*design.x), design.t, p, M), None
    if V is None and plant.declares_V:
        return design.trace.V(design.x, design.t), None
    if V not in (None, LQR):
        raise design.refusal(f'V(x, t, p, M) or "{LQR}", got {V!r}', "pass one of them")
    errors = [a - b for a, b in zip(design.x, design.target[0], strict=True)]
    forms = []
    for matrix in (rounded(gains(design)[0]), weights(design)[0]):
        total: Value = 0.0
        for i, row in enumerate(matrix):
            for j in range(i + 1):
                total = total + (1 if i == j else 2) * row[j] * (errors[i] * errors[j])
        forms.append(total)
    return forms[0], forms[1]
