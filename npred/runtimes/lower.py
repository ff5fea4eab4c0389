"""A trained operator and a grid to a program: scalings and anchor here, each network in another file."""

import copy
from importlib import import_module
from typing import Any

import numpy as np
import torch

from npred import grid
from npred.delays import family_of
from npred.errors import ConfigError
from npred.operators import Operator
from npred.plants.base import Plant
from npred.registry import NETWORKS
from npred.runtimes.program import Program


def lowering(operator: Operator) -> str:
    """The module that lowers the operator's network, empty where there is none."""
    kind = type(operator.network)  # itself: a class derived from it may compute something else
    target = f"{kind.__module__}:{kind.__qualname__}"
    return next((entry.lowering for entry in NETWORKS.builtin.values() if entry.target == target), "")


def require(operator: Operator, what: str, cure: str, name: str = "") -> None:
    """Raise ConfigError, after `what` wants it, unless the operator's network can be lowered; `name`: its own."""
    if not lowering(operator):
        names = ", ".join(name for name, entry in NETWORKS.builtin.items() if entry.lowering)
        name = name or type(operator.network).__name__
        raise ConfigError(f"{what}: expected a network that can be lowered ({names}), got {name}; {cure}")


@torch.no_grad()
def fold(operator: Operator, plant: Plant, nx: int, stride: int = 1, precision: Any = np.float32) -> Program:
    """The operator on nx nodes as a program; an FNO is evaluated on every stride-th of them, with cubics between.

    `precision` is that of the network: np.float32 or np.float64.

    Raises ConfigError for a network without a program, a plant whose family has none, or whose time has no period.
    """
    plant.phase(0.0)
    family_of(plant).needs("fused")
    require(operator, "fold", "use the runtime torch or onnx")
    network, operator = import_module(lowering(operator)), _exact(operator, plant)
    rows = 2 if network.PAIRED and operator.anchor == "equilibrium" else 1
    period = plant.period if plant.phased else None
    p = Program(plant.n, plant.m, nx, rows, stride if network.STRIDED else 1, period, precision=precision)
    _inputs(p, operator)
    network.append(p, operator)
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
    """The scaling of the inputs; z and v are zero at rest, or at the mean of the data."""
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
