"""A y = b for a symmetric positive definite A, on numbers, arrays, tensors or symbols: mechanics has a mass matrix."""

from collections.abc import Iterable

from npred.formulas import Value


def solve(A: list[list[Value]], b: list[Value]) -> list[Value]:
    """y of A y = b, A = L D L' given as rows, of which those below the diagonal are read."""
    return back(*factors(A), b)


def factors(A: list[list[Value]]) -> tuple[list[list[Value]], list[Value]]:
    """L, rows below its diagonal of ones, and 1 / D."""
    L: list[list[Value]] = []
    inverse: list[Value] = []
    for i, row in enumerate(A):
        scaled: list[Value] = []  # the row of L D
        for j in range(i):
            scaled.append(minus(row[j], (scaled[k] * L[j][k] for k in range(j))))
        L.append([a * d for a, d in zip(scaled, inverse, strict=True)])
        inverse.append(1.0 / minus(row[i], (a * c for a, c in zip(scaled, L[i], strict=True))))
    return L, inverse


def back(L: list[list[Value]], inverse: list[Value], b: list[Value]) -> list[Value]:
    """y of L D L' y = b."""
    y: list[Value] = []
    for i, right in enumerate(b):
        y.append(minus(right, (L[i][k] * y[k] for k in range(i))))
    for i in reversed(range(len(b))):
        y[i] = minus(y[i] * inverse[i], (L[k][i] * y[k] for k in range(i + 1, len(b))))
    return y


def minus(a: Value, terms: Iterable[Value]) -> Value:
    """a less all the terms."""
    for term in terms:
        a = a - term
    return a


def total(terms: Iterable[Value]) -> Value:
    """The sum without the leading zero of sum(): 0.0 for none."""
    result: Value = 0.0
    for k, term in enumerate(terms):
        result = term if k == 0 else result + term
    return result
