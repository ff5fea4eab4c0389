"""An FNO on a fixed grid as a program: its transforms are folded, and N at rest is a series in D_hat."""

from dataclasses import replace

import numpy as np

from npred.base import grid
from npred.networks import matrices, program
from npred.networks.program import Matrix, Product, Program, Series, Shapes, linear_shapes, mlp, product, silu
from npred.networks.weights import Weights

PAIRED, STRIDED = False, True  # the point of rest is a series; on a fine grid every stride-th node is evaluated
SPREAD = 6.0  # standard deviations of D_hat that the series covers; beyond, N at rest is evaluated like the sample
TERMS = 64
SMALL = 1e-2  # share of the rounding of the largest coefficient below which the series ends


def shapes(n: int, m: int, clock: int = 0, *, width: int = 32, modes: int = 8, layers: int = 4) -> Shapes:
    """The arrays of npred.lab.training.operators.fno.FNOnetwork, with its arguments."""
    arrays = linear_shapes("lift", n + clock + 1 + m + 1, width)
    for k in range(layers):
        arrays |= {f"spectral.{k}.{part}": (modes, width, width) for part in ("real", "imag")}
        arrays |= linear_shapes(f"local.{k}", width, width)
    return arrays | program.mlp_shapes("project", [width, 2 * width, n], bias=False)


def append(p: Program, weights: Weights) -> None:
    """Append the network's operations, nodes by channels."""
    n, nx, half = p.n, p.nodes, (p.nodes + 1) // 2
    _lift(p, weights)
    E, O = _layers(p, weights)
    # N (n, nx) = last(silu(first(v)))
    first, last = weights.layers("network.project")
    size, width = first["weight"].shape
    hidden, bias = p.buffer("hidden", 2 * half, size), p.constant("project_bias", first["bias"])
    project, by_last = p.weights("project", first["weight"].T / 2, half), p.constant("last", last["weight"] / 2)
    N = p.buffer("N_parts", 2 * half, n)
    p.operations += [
        Product(hidden, E, project, (half, width, size), bias),
        Product(_after(hidden, half), O, project, (half, width, size)),
        program.SiluParts("hidden", "hidden", half * size),
        program.Dots(N, hidden, by_last, (2 * half, size, n)),
        program.Mirror(Matrix("N", nx), Matrix("N_parts", 1, n), Matrix("N_parts", 1, n, half * n), n, nx),
    ]
    if weights.anchor == "equilibrium" and p.period:  # N at rest depends on two numbers, for which there is no series
        p.twice = True
        p.buffer("N_rest", 1, n * nx)
    elif weights.anchor == "equilibrium":
        p.series = _at_rest(p, weights)


def _lift(p: Program, weights: Weights) -> None:
    """v_0 (nx, width), from the constants X and D_hat, then x and the running mean of u."""
    n, nx, lift = p.n, p.nodes, weights["network.lift.weight"].T
    width = lift.shape[1]
    shift, v = p.buffer("shift", 1, width), p.buffer("waves", nx, width)
    zero = weights["network.lift.bias"] + p.z_zero @ lift[:n] + p.v_zero @ lift[p.columns : -1]
    bias, by_z = p.constant("lift", zero), p.weights("by_z", lift[: p.columns], 1)
    nodes, by_x = p.constant("nodes", 2 * grid.nodes(nx)[:, None] - 1), p.weights("by_x", lift[-1:], nx)
    by_mean = p.weights("by_mean", lift[p.columns : -1], nx)
    p.operations += [
        Product(shift, Matrix("z", p.columns), by_z, (1, p.columns, width), bias),
        Product(v, nodes, by_x, (nx, 1, width), replace(shift, row=0)),
        Product(v, Matrix("r", p.stride, p.nx), by_mean, (nx, p.m, width), adds=True),
    ]


def _layers(p: Program, weights: Weights) -> tuple[Matrix, Matrix]:
    """v = silu(W v + b + F^-1 (R_k F v)), layer after layer, of the sums E and the differences O of v at x and 1 - x:
    a row of F is even or odd, so that half of the nodes do. They are twice v's even and odd part.
    """
    linear, spectral, half = weights.layers("network.local"), _spectral(weights), (p.nodes + 1) // 2
    modes, width, pair = spectral[0].shape  # pair: the real and the imaginary part of R, side by side
    forward, inverse = matrices.fourier(p.nodes, modes)
    even = 2 * np.arange(modes) + np.arange(modes) % 2  # Re of mode 0, Im of 1, Re of 2, …; their partners are odd
    forward[:, half - 1] /= 1 + p.nodes % 2  # the middle counts once
    signs = np.append(np.ones(width), -np.ones(width))  # the partners of an odd mode are (Im, Re): R's conjugate
    by_mode = p.stack("matrix", [mode * signs ** (k % 2) for R in spectral for k, mode in enumerate(R)], 2)
    local = p.stack("local", [layer["weight"].T / 2 for layer in linear], half)
    biases = p.stack("bias", [layer["bias"] for layer in linear])
    E, out = p.buffer("parts", 2 * half, width), p.buffer("sums", 2 * half, width)
    v_hat, y_hat = p.buffer("v_hat", 2 * modes, width), p.buffer("y_hat", 2 * modes, width)
    modal = replace(p.buffer("pairs", 2 * modes, pair), turn=2 * pair), replace(v_hat, row=modes * width, turn=width)
    matrix = replace(by_mode, turn=width * pair, layer=modes * width * pair)
    to, back = [], []
    for name, rows, k in (("even", even, 0), ("odd", even ^ 1, 1)):
        v, sums, transformed = _after(E, k * half), _after(out, k * half), _after(v_hat, k * modes)
        to += [
            Product(sums, v, local, (half, width, width), None if k else biases),
            Product(transformed, p.constant(f"forward_{name}", forward[rows, :half]), v, (modes, half, width)),
        ]
        inverted = p.constant(f"inverse_{name}", inverse[:half, rows])
        back.append(Product(sums, inverted, _after(y_hat, k * modes), (half, modes, width), adds=True))
    through = (
        Product(*modal, matrix, (2, width, pair), repeats=modes),
        program.Recombine("y_hat", "pairs", modes, width),
    )
    layer = (*to, *through, *back, program.SiluParts("parts", "sums", half * width))
    p.operations += [program.Parts("parts", "waves", p.nodes, width), program.Repeat(len(linear), layer)]
    return E, _after(E, half)


def _after(matrix: Matrix, rows: int) -> Matrix:
    """The rows of a matrix after the first ones."""
    return replace(matrix, offset=rows * matrix.row)


def _spectral(weights: Weights) -> list[np.ndarray]:
    """R_k of each layer, (modes, width, 2 width): its real and its imaginary part, side by side."""
    return [np.concatenate([R["real"], R["imag"]], axis=-1) for R in weights.layers("network.spectral")]


def _at_rest(p: Program, weights: Weights) -> Series:
    """N(x; X*, u*, D_hat) as a Chebyshev series in D_hat, from double precision, to rounding."""
    mean, std = (float(weights[f"scaling.D_hat_{part}"]) for part in ("mean", "std"))
    low, high = max(0.0, mean - SPREAD * std), mean + SPREAD * std
    points = np.polynomial.chebyshev.chebpts1(TERMS)
    D_hat = (low + (high - low) * (points + 1) / 2 - mean) / std
    # the same computation as the program, for all of them: v (TERMS, nodes, width)
    lift, nx, linear = weights["network.lift.weight"], p.nodes, weights.layers("network.local")
    rest = np.concatenate([p.z_zero, np.zeros(1), p.v_zero, np.zeros(1)])  # the mean of a constant u is that constant
    constant = lift @ rest + weights["network.lift.bias"]
    v = constant + D_hat[:, None, None] * lift[:, p.n] + (2 * grid.nodes(nx)[:, None] - 1) * lift[:, -1]
    spectral = _spectral(weights)
    forward, inverse = matrices.fourier(nx, len(spectral[0]))
    for layer, R in zip(linear, spectral, strict=True):
        v_hat = product(forward, v).reshape(TERMS, len(R), 2, -1)  # (TERMS, modes, Re and Im, width)
        real, imaginary = np.moveaxis(np.einsum("bmpi,mij->bmpj", v_hat, R), 2, 0)  # (TERMS, modes, 2 width)
        width = v.shape[-1]
        y_hat = real[..., :width] - imaginary[..., width:], real[..., width:] + imaginary[..., :width]
        y_hat = np.stack(y_hat, axis=2).reshape(TERMS, 2 * len(R), width)
        v = silu(product(inverse, y_hat) + (product(v, layer["weight"].T) + layer["bias"]))
    values = mlp(weights.layers("network.project"), v)  # (TERMS, nodes, n)
    polynomials = np.polynomial.chebyshev.chebvander(points, TERMS - 1)  # orthogonal over these points
    series = product(polynomials.T, values.transpose(0, 2, 1).reshape(TERMS, -1)) * 2 / TERMS
    series[0] /= 2
    size = np.abs(series).max(axis=1)
    terms = int(np.flatnonzero(size > SMALL * p.rounding * size.max())[-1]) + 1
    T, N_rest = p.buffer("T", 1, terms), p.buffer("N_rest", 1, p.n * p.nodes)
    operation = Product(N_rest, T, p.weights("series", series[:terms], 1), (1, terms, p.n * p.nodes))
    return Series(low, high, terms, operation)
