"""An FNO on a fixed grid as a program: its transforms are folded, and N at rest is a series in D_hat."""

from dataclasses import replace

import numpy as np
import torch
from torch import nn

from npred import grid
from npred.operators import Operator
from npred.operators.fno import FNOnetwork, Spectral, transforms
from npred.runtimes.program import Matrix, Operation, Product, Program, Repeat, Series, Silu, Transpose, layers

CPU = torch.device("cpu")
PAIRED, STRIDED = False, True  # the point of rest is a series; on a fine grid every stride-th node is evaluated
SPREAD = 6.0  # standard deviations of D_hat that the series covers; beyond, N at rest is evaluated like the sample
TERMS = 64
SMALL = 1e-2  # of the rounding of the largest coefficient: what follows is left out


def append(p: Program, operator: Operator) -> None:
    """Append the network's operations: nodes by channels up to the last two layers, which are channels by nodes."""
    network = operator.network
    assert isinstance(network, FNOnetwork)
    width, nx = network.lift.out_features, p.nodes
    v = _lift(p, network)
    p.operations.append(Repeat(len(network.local), _layer(p, network, v)))
    turned = p.buffer("turned", width, nx)
    p.operations.append(Transpose(turned, v, (nx, width)))
    p.operations += _project(p, network, turned)
    if operator.anchor == "equilibrium" and p.period:  # N at rest depends on two numbers, for which there is no series
        p.twice = True
        p.buffer("N_rest", 1, p.n * p.nx)
    elif operator.anchor == "equilibrium":
        p.series = _at_rest(p, operator)


def _lift(p: Program, network: FNOnetwork) -> Matrix:
    """v_0 (nx, width), from the constants X and D_hat, then x and the running mean of u."""
    n, m, nx, weight = p.n, p.m, p.nodes, network.lift.weight.numpy().T
    width = weight.shape[1]
    shift, waves = p.buffer("shift", 1, width), p.buffer("waves", nx, width)
    zero = network.lift.bias.numpy() + p.z_zero @ weight[:n] + p.v_zero @ weight[p.columns : -1]
    bias, by_z = p.constant("lift", zero), p.constant("by_z", weight[: p.columns])
    nodes, by_x = p.constant("nodes", 2 * grid.nodes(nx)[:, None] - 1), p.constant("by_x", weight[-1:])
    by_mean = p.constant("by_mean", weight[p.columns : -1])
    p.operations += [
        Product(shift, Matrix("z", p.columns), by_z, (1, p.columns, width), bias),
        Product(waves, nodes, by_x, (nx, 1, width), replace(shift, row=0)),
        Product(waves, Matrix("r", p.stride, p.nx), by_mean, (nx, m, width), adds=True),
    ]
    return waves


def _layer(p: Program, network: FNOnetwork, v: Matrix) -> tuple[Operation, ...]:
    """v = silu(W v + b + F^-1 (R_k F v))."""
    width, nx, spectral, linear = v.row, p.nodes, layers(network.spectral, Spectral), layers(network.local, nn.Linear)
    modes = spectral[0].modes
    forward, inverse = (t.numpy() for t in transforms(nx, modes, torch.float64, CPU))
    local = p.stack("local", [layer.weight.numpy().T for layer in linear])
    bias = p.stack("bias", [layer.bias.numpy() for layer in linear])
    pair = 2 * width  # real and imaginary part of a mode, one after the other
    matrix = p.stack("matrix", [layer.matrix().numpy().reshape(-1, pair) for layer in spectral])
    v_hat, y_hat = p.buffer("v_hat", 2 * modes, width), p.buffer("y_hat", 2 * modes, width)
    out = p.buffer("sums", nx, width)
    modal = (Matrix("y_hat", pair, turn=pair), Matrix("v_hat", pair, turn=pair), replace(matrix, turn=pair**2))
    return (
        Product(out, v, local, (nx, width, width), bias),
        Product(v_hat, p.constant("forward", forward), v, (2 * modes, nx, width)),
        Product(*modal, (1, pair, pair), repeats=modes),
        Product(out, p.constant("inverse", inverse), y_hat, (nx, 2 * modes, width), adds=True),
        Silu(v.name, out.name, nx * width),
    )


def _project(p: Program, network: FNOnetwork, v: Matrix) -> tuple[Operation, ...]:
    """N (n, nx) = last(silu(first(v)))."""
    first, last = layers(network.project, nn.Linear)
    size, width, nx = first.out_features, first.in_features, p.nodes
    hidden, ones = p.buffer("hidden", size, nx), p.constant("ones", np.ones((1, nx)))
    N = Matrix("N", nx) if p.stride == 1 else p.buffer("N_coarse", p.n, nx)
    operations = (
        Product(hidden, p.constant("project_bias", first.bias.numpy()[:, None]), ones, (size, 1, nx)),
        Product(hidden, p.constant("project", first.weight.numpy()), v, (size, width, nx), adds=True),
        Silu("hidden", "hidden", size * nx),
        Product(N, p.constant("last", last.weight.numpy()), hidden, (p.n, size, nx)),
    )
    if p.stride == 1:
        return operations
    return (*operations, Product(Matrix("N", p.nx), N, p.constant("refine", _refine(p).T), (p.n, nx, p.nx)))


def _refine(p: Program) -> np.ndarray:
    """(nx, nodes): from the network's nodes to all, by the cubic through four."""
    return grid.refine(np.eye(p.nodes), p.nx)


def _at_rest(p: Program, operator: Operator) -> Series:
    """N(x; X*, u*, D_hat) as a Chebyshev series in D_hat, from double precision, to rounding."""
    mean, std = (float(operator.scaling.get_buffer(f"D_hat_{part}")) for part in ("mean", "std"))
    low, high = max(0.0, mean - SPREAD * std), mean + SPREAD * std
    points = np.polynomial.chebyshev.chebpts1(TERMS)
    D_hat = torch.as_tensor(low + (high - low) * (points + 1) / 2)
    values = grid.refine(operator.at_rest(D_hat, p.nodes).numpy(), p.nx)  # (TERMS, nx, n)
    series = np.polynomial.chebyshev.chebfit(points, values.transpose(0, 2, 1).reshape(TERMS, -1), TERMS - 1)
    size = np.abs(series).max(axis=1)
    terms = int(np.flatnonzero(size > SMALL * p.rounding * size.max())[-1]) + 1
    T, N_rest = p.buffer("T", 1, terms), p.buffer("N_rest", 1, p.n * p.nx)
    operation = Product(N_rest, T, p.constant("series", series[:terms]), (1, terms, p.n * p.nx))
    return Series(low, high, terms, operation)
