"""A neural predictor: a network between scalings, and the anchor that says where it is exact by construction."""

import math
from pathlib import Path

import numpy as np
import torch
from torch import Tensor, nn

from npred.base import source_lines
from npred.base.errors import ConfigError
from npred.base.registry import NETWORKS, in_file
from npred.lab.config import Training
from npred.lab.training.operators.scaling import Scaling
from npred.networks import weights as files
from npred.networks.domain import Domain
from npred.networks.weights import NetworkTable, Weights, check_anchor
from npred.plants.base import Plant

NODES = 5  # nodes of the tiny batch that checks a network


class Operator(nn.Module):
    """P_hat, the approximation of the predictor operator [DAPF, eq. 12] of a state, an actuator state and a delay.

    Where P depends on the time too, N sees cos and sin of its phase in the plant's period, as two components of X.

    With N the network, a mean velocity in units of the data's speed S, the anchors are
        none         P_hat = P_mean + P_std N(x; X, u, D_hat)
        initial      P_hat = X + x D_hat S N(x; X, u, D_hat), so P_hat(0) = X
        equilibrium  P_hat = X + x D_hat S [N(x; X, u, D_hat) - N(x; X*, u*, D_hat)], so also P_hat = X* at rest
    """

    anchor: str
    X_rest: Tensor
    u_rest: Tensor

    def __init__(self, network: nn.Module, scaling: Scaling, anchor: str, X_rest: Tensor, u_rest: Tensor) -> None:
        super().__init__()
        self.network, self.scaling, self.anchor = network, scaling, anchor
        self.domain: Domain | None = None  # the domain of the data, where it was saved with the network
        self.register_buffer("X_rest", X_rest)
        self.register_buffer("u_rest", u_rest)

    @property
    def architecture(self) -> str:
        """The built-in name of the network; that of its class where it has none."""
        kind = type(self.network)  # itself: a class derived from it may compute something else
        target, name = f"{kind.__module__}:{kind.__qualname__}", kind.__name__
        other = target if name in NETWORKS.builtin else name  # anybody's class may have the name of a built-in network
        return next((name for name, entry in NETWORKS.builtin.items() if entry.target == target), other)

    def weights(self) -> Weights:
        """Parameters and buffers as they are now, as arrays."""
        arrays = {name: tensor.detach().cpu().numpy() for name, tensor in self.state_dict().items()}
        return Weights(self.architecture, self.anchor, arrays, self.domain)

    def module(self, plant: Plant) -> "Operator":
        """Itself; npred.networks.weights.Weights make one."""
        return self

    def forward(
        self, X: Tensor, u: Tensor, D_hat: Tensor, phase: Tensor | None = None, rest_nodes: int | None = None,
        stride: int = 1,
    ) -> Tensor:  # fmt: skip
        """P_hat (B, nx, n) of X (B, n), u (B, nx, m) on nx uniform nodes, both ends, and D_hat (B,).

        `phase` (B,), t / period modulo 1, is for plants whose P depends on time.
        `rest_nodes`: the term at rest is interpolated in D_hat through so many points, which halves the work of a
        large batch (training); without it the term is exact, and so is the anchor. `stride`: P_hat on every stride-th
        node only.
        """
        N = self._velocity(X, u, D_hat, phase, stride)
        if self.anchor == "none":
            return self.scaling.P_mean + self.scaling.P_std * N
        if self.anchor == "equilibrium" and phase is None and rest_nodes and rest_nodes < D_hat.shape[0]:
            points, weights = chebyshev(D_hat, rest_nodes)
            N = N - torch.tensordot(weights, self.at_rest(points, N.shape[1]), dims=1)
        elif self.anchor == "equilibrium":
            N = N - self.at_rest(D_hat, N.shape[1], phase)
        x = torch.linspace(0, 1, N.shape[1], dtype=u.dtype, device=u.device)[:, None]  # (nx, 1)
        return X[:, None, :] + x * D_hat[:, None, None] * self.scaling.speed * N

    def at_rest(self, D_hat: Tensor, nx: int, phase: Tensor | None = None) -> Tensor:
        """N(x; X*, u*, D_hat), (B, nx, n): without a clock a function of the delay alone, so a table at inference."""
        u = self.u_rest.expand(D_hat.shape[0], nx, -1)
        return self._velocity(self.X_rest.expand(D_hat.shape[0], -1), u, D_hat, phase)

    def _velocity(self, X: Tensor, u: Tensor, D_hat: Tensor, phase: Tensor | None, stride: int = 1) -> Tensor:
        """N, (B, nx, n)."""
        X, u, D_hat = self.scaling.inputs(X, u, D_hat)
        if phase is not None:
            angle = 2 * math.pi * phase[:, None]
            X = torch.cat([X, torch.cos(angle), torch.sin(angle)], dim=1)
        return self.network(X, u, D_hat, stride)


def chebyshev(values: Tensor, count: int) -> tuple[Tensor, Tensor]:
    """Chebyshev points (count,) on the range of the values (B,), and weights (B, count) that interpolate from them."""
    low, high = values.min(), values.max()
    angle = (torch.arange(count, dtype=values.dtype, device=values.device) + 0.5) * (math.pi / count)
    order = torch.arange(count, dtype=values.dtype, device=values.device)
    s = (2 * (values - low) / (high - low).clamp_min(1e-6) - 1).clamp(-1, 1)
    series = torch.cos(angle[:, None] * order) * torch.where(order > 0, 2, 1) / count  # (count, order)
    weights = torch.cos(torch.acos(s)[:, None] * order) @ series.T
    return low + (high - low) * (1 + torch.cos(angle)) / 2, weights


def build(table: NetworkTable, plant: Plant, scaling: Scaling) -> Operator:
    """An untrained operator: `table` gives network, sizes and anchor, torch's generator the weights.

    Raises ConfigError for an unknown network, and for the anchor `equilibrium` on a plant without one.
    """
    network = NETWORKS.load("network", table.architecture)(plant.n, plant.m, _clock(plant), **table.arguments)
    check_anchor(table.anchor, plant)
    rest = plant.rest or (np.zeros(plant.n), np.zeros(plant.m))
    return Operator(network, scaling, table.anchor, *(torch.as_tensor(a, dtype=torch.float32) for a in rest))


def filled(weights: Weights, plant: Plant) -> Operator:
    """The operator with these weights and the domain of its data, in their precision, for use alone."""
    assert weights.table is not None
    operator = build(weights.table, plant, Scaling(plant.n, plant.m))
    operator.to(torch.from_numpy(weights["X_rest"]).dtype)
    operator.load_state_dict({name: torch.from_numpy(array) for name, array in weights.arrays.items()})
    operator.domain = weights.domain
    return operator.eval().requires_grad_(False)


def kinds(table: NetworkTable, plant: Plant) -> dict[str, tuple[tuple[int, ...], str]]:
    """Shape and type of each parameter and buffer; of a registered network no memory is taken for them."""
    with torch.device("cpu" if in_file(table.architecture) else "meta"):
        tensors = build(table, plant, Scaling(plant.n, plant.m)).state_dict()
    return {name: (tuple(t.shape), str(t.dtype).removeprefix("torch.")) for name, t in tensors.items()}


def save(folder: Path, operator: Operator, config: Training) -> None:
    """Write the files that npred.networks.weights.read reads, `config` without the folders of its files."""
    config = config.map_paths(lambda path: Path(path).name)
    files.save(folder, operator, config, config.model_dump(mode="json"))


def checked(config: Training, plant: Plant, scaling: Scaling) -> Operator:
    """An untrained operator whose network has answered a tiny batch, for it may be anybody's.

    Raises ConfigError, in one line, where it cannot be made, fails, or answers in another shape.
    """
    name, inputs = config.architecture, (torch.zeros(2, plant.n + _clock(plant)), torch.zeros(2, NODES, plant.m))
    try:
        operator = build(config, plant, scaling)
        shapes = [tuple(operator.network(*inputs, torch.zeros(2), stride).shape) for stride in (1, 2)]
    except Exception as error:
        if isinstance(error, ConfigError):
            raise
        reason = source_lines.one_line(error)
        cure = "let forward take X, u, D_hat, stride"
        raise ConfigError(f"network {name}: failed on two samples on {NODES} nodes: {reason}; {cure}") from None
    expected = [(2, len(range(0, NODES, stride)), plant.n) for stride in (1, 2)]
    if shapes != expected:
        raise ConfigError(
            f"network {name}: expected forward to return (B, nodes, n), {expected[0]} for {NODES} nodes and "
            f"{expected[1]} with stride 2, got {shapes[0]} and {shapes[1]}; return those"
        )
    return operator


def _clock(plant: Plant) -> int:
    return 2 if plant.phased else 0
