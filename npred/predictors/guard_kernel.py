"""The kernel of a guarded predictor: the estimate of its error in U, whether its input is where the data were.

With A = kappa of the reference, of order 2, on a grid and B of that on a coarser one, Richardson's extrapolation is
R = A + (A - B) / (ratio² - 1), and the estimate |kappa(P) - R| + |A - B|: where the reference itself is inaccurate, it
doubts. Where that is above the tolerance, and |kappa(P) - R| - |A - B| is not, the reference may be to blame: then it
is taken on twice as many steps, a few times.

A grid reads u, whose nodes stand for the cells around them, either by the straight line on each of its cells that
is nearest to u in the mean square (a jump inside a long cell keeps its weight and its place), or, where a family of
kernels reads values at nodes alone, by the mean around each of its nodes.
"""

from typing import Any

import numpy as np

from npred.data.domain import MOMENTS
from npred.delays import family, family_of
from npred.delays.family import Kernel
from npred.plants.base import Plant
from npred.predictors.base import Predictor
from npred.predictors.coarse import CELLS, INTEGRALS
from npred.predictors.heun import Heun
from npred.predictors.onestep import OneStep
from npred.symbolic import kernels

GUARD = """\
    nx, n, lanes = P.shape
    m, last = u.shape[1], nx - 1
    {names}
    few = np.empty((5, m, lanes))
    U, A, B, bent, unread = few[0], few[1], few[2], few[3], few[4]
    {integrals}
    ratio, doubts = guard[1] / guard[2], 1
    fallback[:] = DOUBT
    for level in range(-1, LEVELS):
        count = int(guard[2]) if level < 0 else int(guard[1]) * (1 if level < 1 else 2 if level < 2 else 4)
        if level <= int(guard[5]) and doubts > 0:
            if level >= 0:
                A, B = B, A
            {read}
            Q = np.empty((count + 1, n, lanes))
            {reference}
            control(Q, v, D_hat, t, p, A)
            if level == 0:
                {correct}
                control(P, u, D_hat, t, p, U)
            if level >= 0:
                doubts = 0
                for l in range(lanes):
                    if fallback[l] == DOUBT:
                        error[l], certain = 0.0, 0.0
                        for c in range(m):
                            extrapolated = A[c, l] + (A[c, l] - B[c, l]) / (ratio * ratio - 1.0)
                            gap, noise = abs(U[c, l] - extrapolated), abs(A[c, l] - B[c, l])
                            error[l] = max(error[l], gap + noise if gap + noise < np.inf else np.inf)  # also of NaN
                            certain = max(certain, gap - noise if gap - noise < np.inf else 0.0)
                        if error[l] <= guard[0]:
                            fallback[l] = 0.0
                        elif certain > guard[0]:
                            fallback[l] = 1.0
                        else:
                            doubts += 1
    if guard[4] < np.inf:
        {sums}
    for l in range(lanes):
        outside = False
        if guard[4] < np.inf:
            {distance}
            outside = rough or not total <= guard[4] ** 2
        fallback[l] = 1.0 if outside or fallback[l] > 0.0 else 0.0
        if fallback[l] > 0.0:
            x1, u1, D1, P1 = np.empty((n, 1)), np.empty((nx, m, 1)), np.empty(1), np.empty((nx, n, 1))
            for c in range(n):
                x1[c, 0] = X[c, l]
            for j in range(nx):
                for c in range(m):
                    u1[j, c, 0] = u[j, c, l]
            D1[0] = D_hat[l]
            exact(x1, u1, D1, t, p, P1)
            for j in range(nx):
                for c in range(n):
                    P[j, c, l] = P1[j, c, 0]
"""
HEAD = 6  # numbers of the settings before the domain's: tolerance, fine, coarse, correct, limit, refinements
DOUBT = "2.0"

MEANS = """\
stride = last // count
v, R = np.empty((count + 1, m, lanes)), np.empty((count + 1, n, lanes))
for J in range(count + 1):
    low, high = max((J - 0.5) * stride, 0.0), min((J + 0.5) * stride, float(last))
    i, j = min(int(low + 0.5), last), min(int(high + 0.5), last)
    a, b = low - max(i - 0.5, 0.0), high - max(j - 0.5, 0.0)
    for c in range(m):
        for l in range(lanes):
            v[J, c, l] = (mass[j, c, l] - mass[i, c, l] + b * u[j, c, l] - a * u[i, c, l]) / (high - low)
    for c in range(n):
        for l in range(lanes):
            R[J, c, l] = P[J * stride, c, l]"""

CORRECT = """\
if guard[3] > 0.0:
    for j in range(nx):
        J = min(j // stride, count - 1)
        share = j / stride - J
        for c in range(n):
            for l in range(lanes):
                P[j, c, l] += (1.0 - share) * (Q[J, c, l] - R[J, c, l]) + share * (Q[J + 1, c, l] - R[J + 1, c, l])"""

# The Legendre moments of u by its sums of 1, j and j², with the trapezoidal rule's weights, and how much of u between
# nodes a line and a cubic read differently: npred.data.domain.unread.
SUMS = """\
for c in range(m):
    for l in range(lanes):
        square, kinks = 0.5 * last * last * u[last, c, l], 0.0
        for j in range(1, last - 1):
            square += j * j * u[j, c, l]
            kinks += abs(u[j - 1, c, l] - u[j, c, l] - u[j + 1, c, l] + u[j + 2, c, l])
        square += (last - 1) * (last - 1) * u[last - 1, c, l]
        if nx > 3:
            kinks += abs(3.0 * u[0, c, l] - 7.0 * u[1, c, l] + 5.0 * u[2, c, l] - u[3, c, l])
            kinks += abs(3.0 * u[last, c, l] - 7.0 * u[last - 1, c, l] + 5.0 * u[last - 2, c, l] - u[last - 3, c, l])
        bent[c, l], unread[c, l] = square, kinks"""

DISTANCE = """\
for c in range(n):
    feature[c] = np.arcsinh(X[c, l] / bend[c])
feature[n] = D_hat[l]
for c in range(m):
    first = mass[nx, c, l] / last
    second = (turn[nx, c, l] + 0.125 * (u[last, c, l] - u[0, c, l])) / (last * last)
    feature[n + 1 + c * {moments}] = first
    feature[n + 2 + c * {moments}] = 2.0 * second - first
    feature[n + 3 + c * {moments}] = 6.0 * (bent[c, l] / (last * last * last) - second) + first
{phase}
total = 0.0
for i in range(size):
    row = 0.0
    for k in range(i + 1):
        row += whiten[i * size + k] * (feature[k] - mean_[k])
    total += row * row
rough = False
for c in range(m):
    rough = rough or not D_hat[l] * unread[c, l] <= 24.0 * last * roughest[c]"""


def kernel(plant: Plant, by: str, exact: Predictor, method: type[OneStep]) -> Kernel:
    """GUARD of a plant: compiled, or, where the plant is not traced, the same text in Python."""
    model, defect = family_of(plant), by == "defect"
    cells = model.reads_cells and not defect
    used = {"control": model.control(Heun.step), "exact": exact.lanes()}
    used["reference"] = model.correction() if defect else method(plant).cells() if cells else method(plant).lanes()
    call = "reference(R, X, v, D_hat, t, p, Q)" if defect else "reference(X, v, D_hat, t, p, Q)"
    source = kernels.fill(
        GUARD.replace("DOUBT", DOUBT).replace("LEVELS", "3" if cells else "1"),
        names=_names(plant),
        integrals=INTEGRALS.splitlines(),
        read=(CELLS if cells else MEANS).splitlines(),
        reference=[call],
        correct=CORRECT.splitlines() if defect else ["pass"],
        sums=SUMS.splitlines(),
        distance=_distance(plant),
    )
    if not plant.traced:
        space: dict[str, Any] = used | {"np": np}
        exec(f"def guarded({family.GUARD}):\n{source}", space)
        return space["guarded"]
    imports = [f"from {part.__module__} import {part.__name__} as {name}\n" for name, part in used.items()]
    return family.build("guarded", family.GUARD, source, "".join(imports))


def _size(plant: Plant) -> int:
    """The number of features of Domain."""
    return plant.n + 1 + MOMENTS * plant.m + (2 if plant.phased else 0)


def _names(plant: Plant) -> list[str]:
    """The lines that name the parts of the settings behind HEAD."""
    size = _size(plant)
    ends = np.cumsum([HEAD, plant.n, size, size * size]).tolist()
    spans = zip(("bend", "mean_", "whiten", "roughest"), ends, [*ends[1:], ""], strict=True)
    names = [f"{name} = guard[{begin}:{end}]" for name, begin, end in spans]
    return [*names, f"size, feature = {size}, np.empty({size})"]


def _distance(plant: Plant) -> list[str]:
    size, angle = _size(plant), f"2.0 * np.pi * t / {plant.period!r}"
    phase = [f"feature[{size - 2}], feature[{size - 1}] = np.cos({angle}), np.sin({angle})"] if plant.phased else []
    return kernels.fill(DISTANCE.format(moments=MOMENTS, phase="{phase}"), phase=phase).splitlines()
