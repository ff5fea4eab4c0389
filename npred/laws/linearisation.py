"""Laws with given poles: of the linearisation, and of outputs by feedback linearisation.

The outputs are those whose derivatives the inputs set, which Lie derivatives decide on the tape.
"""

from collections.abc import Callable, Sequence
from itertools import combinations
from typing import Any, NamedTuple

import numpy as np

from npred.base import randomness
from npred.base.errors import ConfigError
from npred.formulas import Value, programs
from npred.formulas.declared import record
from npred.formulas.tape import M, Vector
from npred.laws.design import ZERO, Design, acts, solved
from npred.laws.law import Law, rounded, written
from npred.laws.regulator import along, gains
from npred.plants.base import Plant

REGULAR = 1e-6  # share of the largest determinant over the box: below it the decoupling matrix is singular
STARTS, SWEEPS, CLEARLY = 4, 100, 0.99  # of the search for eigenvectors; the share by which a start counts as better
TRIES = 20  # random choices of the free parameters of equal poles, of which the best conditioned is taken
ACCURATE = 1e-4  # error of a coefficient of the poles' polynomial, relative to the largest pole's
MOST = 5000  # combinations of states that are tried as outputs

OutputMap = Callable[[Vector, Value], Value]  # its arguments: the components of x, and t
Output = Callable[..., Any] | str | Sequence[str]


class Chain(NamedTuple):
    """An output's derivatives y, y', … that no input moves, r of them; the next without input, and by the inputs."""

    derivatives: list[Value]
    last: Value
    row: list[Value]


def pole_placement(plant: Plant, poles: Sequence[complex]) -> Law:
    """kappa = u - K (x - X) such that A - B K has these n poles, complex ones in pairs.

    One input has one K. Several have many, and K is that of well conditioned eigenvectors (Kautsky, Nichols and Van
    Dooren, Int. J. Control 41, 1985, 1129-1155, method 0): of distinct poles 0.5 to 1.02 times the condition of SciPy's
    place_poles on 100 random plants. Equal poles that allow no such eigenvectors are placed by
    K = G inv(Z) with A Z - Z L = B G (Bhattacharyya and de Souza, Systems & Control Letters 1, 1982, 261-263), the best
    of a few random G.

    Parameters
    ----------
    plant : Plant
        From npred.plant.
    poles : n complex numbers, 1 / the plant's unit of time
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
    values = _checked(design, poles, plant.n)
    A, B = design.linearised
    expected = np.real(np.poly(values))
    for way in (_robust, _chained):
        try:
            K = way(A, B, values)
            actual = np.real(np.poly(A - B @ K))
        except np.linalg.LinAlgError:
            continue
        # The polynomials are compared, for equal roots split by rounding.
        error = np.abs(actual - expected) / np.abs(values).max() ** np.arange(plant.n + 1)
        if error.max() <= ACCURATE:
            return along(design, K)
    raise design.refusal("a linearisation whose poles the inputs move, got another", "take lqr")


def _robust(A: np.ndarray, B: np.ndarray, poles: np.ndarray) -> np.ndarray:
    """K (m, n) by eigenvectors X that are made as orthogonal as they can be, one after the other and again.

    A complex one moves with its conjugate. Another start counts only if it is clearly better, for K enters keys: a tie
    would be decided by rounding.
    """
    poles = np.concatenate([[pole.conj(), pole] if pole.imag else [pole] for pole in _upper(poles)])
    n, rank, draws = len(A), np.linalg.matrix_rank(B), randomness.generator(0, "pole placement")
    free = np.linalg.svd(B)[0][:, rank:].T
    bases = [np.linalg.svd(free @ (A - pole * np.eye(n)))[2].conj().T[:, n - rank :] for pole in poles]
    upper, least, best = np.flatnonzero(np.imag(poles) >= 0), np.inf, np.full((n, n), np.nan + 0j)
    for _ in range(STARTS):
        X = np.zeros((n, n), complex)
        for sweep in range(SWEEPS):
            for j in upper:
                x = bases[j].conj().T @ np.linalg.inv(X)[j].conj() if sweep else draws.standard_normal(rank)
                X[:, j] = bases[j] @ x / np.linalg.norm(x)
                if np.imag(poles[j]):
                    X[:, j - 1] = X[:, j].conj()
        if np.linalg.cond(X) < CLEARLY * least:
            least, best = np.linalg.cond(X), X
    return np.linalg.lstsq(B, A - (best * poles) @ np.linalg.inv(best), rcond=None)[0].real


def _chained(A: np.ndarray, B: np.ndarray, poles: np.ndarray) -> np.ndarray:
    """K (m, n) of equal poles that share an eigenvector: G inv(Z) of A Z - Z L = B G, L with them in chains."""
    n, m = B.shape
    L, at, before = np.zeros((n, n)), 0, None
    for pole in _upper(poles):
        size = 2 if pole.imag else 1
        here = slice(at, at + size)
        L[here, here] = [[pole.real, pole.imag], [-pole.imag, pole.real]] if pole.imag else pole.real
        if pole == before:
            L[at - size : at, here] = np.eye(size)
        at, before = at + size, pole
    draws, eye = randomness.generator(0, "pole placement"), np.eye(n)
    least, K = np.inf, np.zeros((m, n))
    for _ in range(TRIES):
        # A first feedback moves the plant's own poles off those asked for, where the equation has no solution.
        first = draws.standard_normal((m, n)) * np.linalg.norm(A, 2) / np.linalg.norm(B, 2)
        moved, G = A - B @ first, draws.standard_normal((m, n))
        Z = np.linalg.solve(np.kron(moved, eye) - np.kron(eye, L.T), (B @ G).ravel()).reshape(n, n)
        if np.linalg.cond(Z) < least:
            least, K = np.linalg.cond(Z), first + np.linalg.solve(Z.T, G.T).T
    return K


def _upper(poles: np.ndarray) -> list[np.complex128]:
    """The poles without those below the real axis, equal ones side by side."""
    return sorted(poles[np.imag(poles) >= 0], key=lambda pole: (np.real(pole), np.imag(pole)))


def _checked(design: Design, poles: Sequence[complex], count: int) -> np.ndarray:
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


def feedback_linearisation(plant: Plant, poles: Sequence[complex] | None = None, output: Output | None = None) -> Law:
    """kappa by which every output y_i obeys e^(r_i) + … + k_0 e = 0, e = y_i - its target (Isidori 1995, sec. 5.3).

    The r_i are the relative degrees of the outputs.

    Parameters
    ----------
    plant : Plant
        From npred.plant.
    poles : complex numbers, 1 / the plant's unit of time, optional
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
    named, p = record("State", plant.states), record("Parameters", plant.p_names)(*design.trace.parameters)

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
    X, moments = design.samples, design.moments
    times = np.concatenate([np.resize(moments, len(X)), moments])
    return np.concatenate([X, design.targets[0]]), times


def _law(design: Design, outputs: Sequence[OutputMap], poles: Sequence[complex] | None) -> Law:
    plant = design.plant
    chains = [chain for output in outputs if (chain := _chain(design, output))]
    m, cure = plant.m, "pass another output, or take lqr"
    if len(chains) < m:
        raise design.refusal("outputs on which the inputs act, got one that none moves", cure)
    rows = design.values([b for chain in chains for b in chain.row], *_places(design)).reshape(-1, m, m) * design.sizes
    size = np.linalg.norm(rows, axis=-1, keepdims=True).max(axis=0)
    determinant = np.linalg.det(np.nan_to_num(rows / np.where(size > 0, size, 1.0)))
    smallest = (determinant * np.sign(determinant[np.abs(determinant).argmax()])).min()
    if not smallest > REGULAR * np.abs(determinant).max():  # the inputs do not set the highest derivatives there
        expected = "outputs with a relative degree on the box, got a decoupling matrix that is singular"
        raise design.refusal(expected, cure)
    degrees = [len(chain.derivatives) for chain in chains]
    if poles is None:
        A, B = design.linearised
        rates = np.abs(np.linalg.eigvals(A - B @ gains(design)[1]))
        values = np.full(sum(degrees), -float(f"{np.exp(np.log(rates).mean()):.3g}"))
    else:
        values = _checked(design, poles, sum(degrees))
    right = []
    for chain, output, own_poles in zip(chains, outputs, np.split(values, np.cumsum(degrees)[:-1]), strict=True):
        if not np.allclose(np.poly(own_poles).imag, 0):
            raise design.refusal(f"complex poles in pairs for an output of degree {len(own_poles)}", "order them")
        coefficients = rounded(np.poly(own_poles).real[:0:-1])  # coefficients of 1, s, …
        *goals, highest = _goals(design, output, len(own_poles))
        pull = highest - chain.last
        for k, y, goal in zip(coefficients, chain.derivatives, goals, strict=True):
            pull = pull - k * (y - goal)
        right.append(pull)
    by_input = np.array([chain.row for chain in chains], dtype=object)
    commands = [right[0] / by_input[0, 0]] if m == 1 else solved(by_input, right)
    law = written(design.trace, design.guess, commands)
    if sum(degrees) < plant.n:  # the outputs leave a rest, the zero dynamics
        (X, _), closed = design.targets, plant.controlled(law)
        f_X, f_U = plant.jacobians(X, closed.kappa(X, design.moments), design.moments)
        A = (f_X + f_U @ closed.kappa_jacobian(X, design.moments)).mean(axis=0)
        slowest = np.linalg.eigvals(A).real.max()
        if not slowest < -ZERO * np.linalg.norm(A, 2):
            raise design.refusal(f"outputs that leave a stable rest, got one with the rate {slowest:.3g}", cure)
    return law


def _goals(design: Design, output: OutputMap, degree: int) -> list[Value]:
    """The output and its derivatives by the time along the law's target, degree + 1 of them."""
    X = design.target[0]
    y = output(X, design.t)
    if not (design.follows or design.plant.declares_setpoint):  # a number
        at_rest = design.values([output(design.x, design.t)], design.targets[0][:1], np.zeros(1))
        return [float(f"{at_rest[0, 0]:.12g}"), *[0.0] * degree]
    goals = [y]
    if not design.follows:
        return goals + [0.0] * degree
    for _ in range(degree):
        goals += programs.derivative(goals[-1:], [design.t], [1.0])
    return goals
