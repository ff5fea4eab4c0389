"""Feedback linearisation: outputs whose derivatives the inputs set, decided on the tape by Lie derivatives."""

from collections.abc import Callable, Sequence
from itertools import combinations
from typing import Any, NamedTuple

import numpy as np

from npred.base.errors import ConfigError
from npred.formulas import Value, programs
from npred.formulas.declared import record
from npred.formulas.tape import M, Vector
from npred.laws import placement
from npred.laws.design import ZERO, Design, acts, samples, solved
from npred.laws.law import Law, rounded, written
from npred.laws.regulator import gains
from npred.plants.base import Plant

REGULAR = 1e-6  # of the largest determinant over the box: below it the decoupling matrix is singular somewhere
MOST = 5000  # combinations of states that are tried as outputs

OutputMap = Callable[[Vector, Value], Value]  # of the components of x, and t
Output = Callable[..., Any] | str | Sequence[str]


class Chain(NamedTuple):
    """An output's derivatives y, y', … that no input moves, r of them; the next without input, and by the inputs."""

    derivatives: list[Value]
    last: Value
    row: list[Value]


def feedback_linearisation(plant: Plant, poles: Sequence[complex] | None = None, output: Output | None = None) -> Law:
    """kappa by which every output y_i obeys e^(r_i) + … + k_0 e = 0, e = y_i - its target (Isidori 1995, sec. 5.3).

    The r_i are the relative degrees of the outputs.

    Parameters
    ----------
    plant : Plant
        From npred.plant.
    poles : complex numbers, 1/s, optional
        The r_1 + r_2 + … poles of the outputs in turn; by default each is minus the geometric mean of the rates of
        the loop of lqr.
    output : names of states, one per input, or function (x, t, p, M), optional
        Y; by default the states with the largest relative degrees r_i that leave a stable rest.

    Returns
    -------
    Law
        A law kappa(x, t, p, M) by the text of its definition, which can be pasted into a plant's class.

    Raises
    ------
    ConfigError
        Where the outputs have no relative degree on the box, or leave a rest that is not stable.
    """
    design = Design(plant, "feedback_linearisation")
    if output is not None:
        return _law(design, _outputs(design, output), poles)
    single = {k: chain for k, name in enumerate(plant.states) if (chain := _chain(design, _state(k)))}
    sets = sorted(combinations(single, plant.m), key=lambda ks: -sum(len(single[k].derivatives) for k in ks))
    fault = None
    for states in sets[:MOST]:
        try:
            return _law(design, [_state(k) for k in states], poles)
        except ConfigError as error:
            fault = fault or error
    raise fault or design.refusal("states on which the inputs act, found none", "pass output, or take lqr")


def _state(k: int) -> OutputMap:
    return lambda x, t: x[k]


def _outputs(design: Design, output: Output) -> list[OutputMap]:
    """One function of x and t per output."""
    plant = design.plant
    words = [output] if isinstance(output, str) else output
    if not callable(words):
        if len(words) != plant.m or not set(words) <= set(plant.states):
            expected = f"an output per input, of {', '.join(plant.states)}, got {words}"
            raise design.refusal(expected, f"name {plant.m}")
        return [_state(plant.states.index(word)) for word in words]
    named, p = record("State", plant.states), record("Parameters", tuple(plant.parameters))(*design.trace.parameters)

    def values(x: Vector, t: Value) -> list[Value]:
        returned = words(named(*x), t, p, M)
        results = list(returned) if isinstance(returned, list | tuple) else [returned]
        if len(results) != plant.m:
            raise design.refusal(f"an output that returns {plant.m} values, got {len(results)}", "return one per input")
        return results

    return [lambda x, t, j=j: values(x, t)[j] for j in range(plant.m)]


def _chain(design: Design, output: OutputMap) -> Chain | None:
    """The derivatives of an output along f until an input acts; None where none does."""
    y = output(design.x, design.t)
    drift = design.trace.f(design.x, np.zeros(design.plant.m), design.t)
    derivatives = []
    for _ in range(design.plant.n):
        derivatives.append(y)
        row = [programs.derivative([y], design.x, column)[0] for column in design.B.T]
        y = programs.derivative([y], [design.t, *design.x], [1.0, *drift])[0]
        values = design.values([*row, y], *_places(design))
        if acts(values[:, :-1] * design.sizes, values[:, -1]):
            return Chain(derivatives, y, row)
    return None


def _places(design: Design) -> tuple[np.ndarray, np.ndarray]:
    """States of the box, and those that the law leads to, with times."""
    X, moments = samples(design.plant), design.moments
    times = np.concatenate([np.resize(moments, len(X)), moments])
    return np.concatenate([X, design.targets[0]]), times


def _law(design: Design, outputs: Sequence[OutputMap], poles: Sequence[complex] | None) -> Law:
    plant = design.plant
    chains = [chain for output in outputs if (chain := _chain(design, output))]
    _check_degree(design, chains)
    degrees = [len(chain.derivatives) for chain in chains]
    if poles is None:
        A, B = design.linearised
        values = placement.default(A - B @ gains(design)[1], sum(degrees))
    else:
        values = placement.checked(design, poles, sum(degrees))
    right = []
    for chain, output, own_poles in zip(chains, outputs, np.split(values, np.cumsum(degrees)[:-1]), strict=True):
        if not np.allclose(np.poly(own_poles).imag, 0):
            raise design.refusal(f"complex poles in pairs for an output of degree {len(own_poles)}", "order them")
        coefficients = rounded(np.poly(own_poles).real[:0:-1])  # of 1, s, …
        *goals, highest = _goals(design, output, len(own_poles))
        pull = highest - chain.last
        for k, y, goal in zip(coefficients, chain.derivatives, goals, strict=True):
            pull = pull - k * (y - goal)
        right.append(pull)
    rows = np.array([chain.row for chain in chains], dtype=object)
    law = written(design.trace, design.guess, [right[0] / rows[0, 0]] if plant.m == 1 else solved(rows, right))
    if sum(degrees) < plant.n:
        _check_rest(design, law)
    return law


def _goals(design: Design, output: OutputMap, degree: int) -> list[Value]:
    """The output and its derivatives by the time along what the law leads to, degree + 1 of them."""
    X = design.target[0]
    y = output(X, design.t)
    if not design.follows:  # a number
        at_rest = design.values([output(design.x, design.t)], design.targets[0][:1], np.zeros(1))
        return [float(f"{at_rest[0, 0]:.12g}"), *[0.0] * degree]
    goals = [y]
    for _ in range(degree):
        goals += programs.derivative(goals[-1:], [design.t], [1.0])
    return goals


def _check_degree(design: Design, chains: list[Chain]) -> None:
    """Raise ConfigError unless the inputs set the highest derivatives everywhere on the box."""
    m, cure = design.plant.m, "pass another output, or take lqr"
    if len(chains) < m:
        raise design.refusal("outputs on which the inputs act, got one that none moves", cure)
    rows = design.values([b for chain in chains for b in chain.row], *_places(design)).reshape(-1, m, m)
    rows = rows * design.sizes
    size = np.linalg.norm(rows, axis=-1, keepdims=True).max(axis=0)
    determinant = np.linalg.det(np.nan_to_num(rows / np.where(size > 0, size, 1.0)))
    smallest = (determinant * np.sign(determinant[np.abs(determinant).argmax()])).min()
    if not smallest > REGULAR * np.abs(determinant).max():
        expected = "outputs with a relative degree on the box, got a decoupling matrix that is singular"
        raise design.refusal(expected, cure)


def _check_rest(design: Design, law: Law) -> None:
    """Raise ConfigError unless what the outputs leave, the zero dynamics, is stable where the law leads."""
    X, _ = design.targets
    closed = design.plant.controlled(law)
    u = closed.kappa(X, design.moments)
    f_X, f_U = design.plant.jacobians(X, u, design.moments)
    A = (f_X + f_U @ closed.kappa_jacobian(X, design.moments)).mean(axis=0)
    slowest = np.linalg.eigvals(A).real.max()
    if not slowest < -ZERO * np.linalg.norm(A, 2):
        expected = f"outputs that leave a stable rest, got one with the rate {slowest:.3g}"
        raise design.refusal(expected, "pass another output, or take lqr")
