"""A trained operator and a grid to a program: scalings and anchor here, the network in a file of its own."""

import copy
from collections.abc import Callable
from typing import Any

import numpy as np
import torch

from npred import grid
from npred.delays import family_of
from npred.errors import ConfigError
from npred.operators import Operator
from npred.operators.deeponet import DeepONetwork
from npred.operators.fno import FNOnetwork
from npred.plants.base import Plant
from npred.runtimes import deeponet, fno
from npred.runtimes.program import Program

NETWORKS: dict[type, Callable[[Program, Operator], None]] = {DeepONetwork: deeponet.append, FNOnetwork: fno.append}


@torch.no_grad()
def fold(operator: Operator, plant: Plant, nx: int, stride: int = 1, precision: Any = np.float32) -> Program:
    """The operator on nx nodes as a program; an FNO is evaluated on every stride-th of them, with cubics between.

    `precision` is that of the network: np.float32 or np.float64.

    Raises ConfigError for a network without a program, or one that sees the clock.
    """
    family_of(plant).needs("fused")
    if type(operator.network) not in NETWORKS:
        known = " or ".join(network.__name__ for network in NETWORKS)
        raise ConfigError(f"fold: expected a {known}, got {type(operator.network).__name__}; use the runtime torch")
    operator = _exact(operator, plant)
    paired = operator.anchor == "equilibrium" and isinstance(operator.network, DeepONetwork)
    rows, stride = 2 if paired else 1, stride if isinstance(operator.network, FNOnetwork) else 1
    p = Program(plant.n, plant.m, nx, rows, stride, precision)
    _inputs(p, operator)
    NETWORKS[type(operator.network)](p, operator)
    scaling = operator.scaling
    if operator.anchor == "none":
        p.scale("base", scaling.P_mean.numpy())
        p.constant("gain", np.repeat(scaling.P_std.numpy()[:, None], nx, axis=1))
    else:
        p.constant("gain", scaling.speed.numpy()[:, None] * grid.nodes(nx))
    return p


def _exact(operator: Operator, plant: Plant) -> Operator:
    """A copy in double precision, the point of rest too."""
    operator = copy.deepcopy(operator).double()
    if operator.anchor == "equilibrium" and plant.rest:
        operator.X_rest.copy_(torch.as_tensor(plant.rest[0]))
        operator.u_rest.copy_(torch.as_tensor(plant.rest[1]))
    return operator


def _inputs(p: Program, operator: Operator) -> None:
    """How the inputs are scaled, and where z and v are zero: at rest, or at the mean of the data."""
    scaling, rests = operator.scaling, operator.anchor == "equilibrium"
    X_bend, X_mean, X_std = (scaling.get_buffer(f"X_{part}").numpy() for part in ("bend", "mean", "std"))
    u_mean, u_std = scaling.u_mean.numpy(), scaling.u_std.numpy()
    X_zero = np.arcsinh(operator.X_rest.numpy() / X_bend) if rests else X_mean
    u_zero = operator.u_rest.numpy() if rests else u_mean
    for name, values in {
        "X_bend": 1 / X_bend, "X_zero": X_zero, "X_gain": 1 / X_std, "u_zero": u_zero, "u_gain": 1 / u_std,
        "D_hat_zero": scaling.D_hat_mean.numpy(), "D_hat_gain": 1 / scaling.D_hat_std.numpy(),
    }.items():  # fmt: skip
        p.scale(name, values)
    p.z_zero, p.v_zero = (X_zero - X_mean) / X_std, (u_zero - u_mean) / u_std
