"""The defect of a prediction, carried to x = 1 by the linearised equation, for one constant delay and a traced plant.

With e = P̂ - P, e' = D_hat f_P(P̂, u) e + δ, δ = P̂' - D_hat f(P̂, u), e(0) = P̂(0) - X. Between nodes δ is integrated as
P̂(x_{j+1}) - P̂(x_j) - h (f_j + f_{j+1}) / 2, and e by Heun's method: both of order 2.
"""

from npred.delays import family
from npred.delays.family import Kernel
from npred.plants.base import Plant
from npred.symbolic import called_functions, kernels, programs

BODY = """\
    nx, n, lanes = P.shape
    {parameters}
    e, f, g = np.empty(n), np.empty(n), np.empty(n)
    for l in range(lanes):
        h = D_hat[l] / (nx - 1)
        j = 0
        for c in range(n):
            e[c] = P_hat[0, c, l] - X[c, l]
            P[0, c, l] = X[c, l]
        {velocity}
        for j in range(1, nx):
            {slope}
            for c in range(n):
                g[c] = d[c]
                e[c] += h * d[c]
            {node}
            for c in range(n):
                e[c] += 0.5 * h * (d[c] - g[c]) + P_hat[j, c, l] - P_hat[j - 1, c, l] - 0.5 * h * (f[c] + y[c])
                f[c] = y[c]
                P[j, c, l] = P_hat[j, c, l] - e[c]
"""


def kernel(plant: Plant) -> Kernel:
    """CORRECT: P = P̂ - e."""
    n, trace = plant.n, called_functions.trace(plant)
    x, u, e = trace.vector("x", n), trace.vector("u", plant.m), trace.vector("e", n)
    t = trace.input("t")
    along = trace.df(x, u, t, e)

    def lines(j: str, outputs: dict[str, object]) -> list[str]:
        """The program of those outputs, tuples of n, at node j."""
        names = {f"x{k}": f"P_hat[{j}, {k}, l]" for k in range(n)} | {f"e{k}": f"e[{k}]" for k in range(n)}
        names |= {f"u{k}": f"u[{j}, {k}, l]" for k in range(plant.m)} | {"t": f"(t + ({j}) * h)"}
        values = [value for vector in outputs.values() for value in vector]  # type: ignore[attr-defined]
        targets = [f"{name}{k}" for name in outputs for k in range(n)]
        tuples = [f"{name} = ({', '.join(f'{name}{k}' for k in range(n))},)" for name in outputs]
        return [*programs.lines(values, names, targets), *tuples]

    velocity = [*lines("j", {"y": trace.f(x, u, t)}), *(f"f[{k}] = y[{k}]" for k in range(n))]
    source = kernels.fill(
        BODY,
        parameters=kernels.parameters(len(plant.p)),
        velocity=velocity,
        slope=lines("j - 1", {"d": along}),
        node=lines("j", {"y": trace.f(x, u, t), "d": along}),
    )
    return family.build("correction", family.CORRECT, source, called_functions.imports(trace))
