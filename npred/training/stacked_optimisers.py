"""SOAP and Adam for a CUDA graph: all parameters in a few tensors that stay in their place, nothing read on the host.

A step of a small network on a GPU takes as long as its launches. So the elementwise part is one vector of all
parameters, the matrices of one shape are one batch, and so are the bases of one size. The parameters of several
networks, stacked along a first axis, are more of the same.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from npred.training.soap import BETA, EPS, EVERY, State

SHIFT = 1e-10  # of the mean eigenvalue: a direction that no gradient has yet keeps its vector
RIDGE = 1e-13  # of the unit columns' Gram matrix: rounding makes that of dependent ones indefinite


class StackedAdam:
    """Adam [Kingma and Ba 2015] as torch.optim.Adam has it, with weight decay in the gradient.

    `leaves` are the parameters (*shape) of a network, or those of `count` networks, (count, *shape). A CUDA graph may
    hold `update`; the host calls `set_rate` before it, and `turn` after it.
    """

    betas = 0.9, 0.999
    names = "exp_avg", "exp_avg_sq"  # of the moments, in a checkpoint

    def __init__(self, leaves: Sequence[Tensor], decay: float = 0.0, count: int | None = None) -> None:
        self.decay, self.count = decay, count or 1
        self.shapes = [leaf.shape[count is not None :] for leaf in leaves]
        self.order = sorted(range(len(leaves)), key=lambda k: _place(self.shapes[k]), reverse=True)
        self.leaves = [leaves[k] for k in self.order]
        self.sizes = [leaf.numel() for leaf in self.leaves]
        like = leaves[0].detach()
        self.first, self.second = (like.new_zeros(sum(self.sizes)) for _ in self.names)
        self.steps = like.new_zeros((), dtype=torch.float64)
        self.rate, self.keep = like.new_zeros(()), like.new_ones(())

    def set_rate(self, rate: float) -> None:
        self.rate.fill_(rate)
        self.keep.fill_(1 - rate * self.decay)

    @torch.no_grad()
    def update(self, gradients: Sequence[Tensor]) -> None:
        """One step along the gradients of the leaves."""
        G = self._decayed(torch.cat([gradients[k].flatten() for k in self.order]))
        beta, beta_2 = self.betas
        self.steps.add_(1)
        self.first.lerp_(G, 1 - beta)
        self.second.lerp_(self._turned(G).square(), 1 - beta_2)
        spread = (self.second / (1 - beta_2**self.steps)).sqrt() + EPS
        step = self._returned(self._turned(self.first) / (1 - beta**self.steps) / spread)
        torch._foreach_sub_(self.leaves, self._pieces(self.rate * step))  # type: ignore  # a launch for all
        self._learn(G)

    def turn(self, step: int) -> None:
        """The work after so many steps that is no part of the graph."""

    def tensors(self) -> list[Tensor]:
        return [self.steps, self.first, self.second]

    def of(self, network: int) -> "NetworkState":
        """The state of one of the networks, to save and to restore."""
        return NetworkState(self, network)

    def moments(self, network: int) -> list[State]:
        """What the plain optimiser has of each parameter of a network, but the step, in the memory that it has here."""
        states: list[State] = [{} for _ in self.order]
        for name, flat in zip(self.names, (self.first, self.second), strict=True):
            for k, piece in zip(self.order, self._pieces(flat), strict=True):
                states[k][name] = piece.view(self.count, *self.shapes[k])[network]
        return states

    def _pieces(self, flat: Tensor) -> list[Tensor]:
        """The part of each leaf, in the leaf's shape."""
        return [part.view_as(leaf) for part, leaf in zip(flat.split(self.sizes), self.leaves, strict=True)]

    def _decayed(self, G: Tensor) -> Tensor:
        return G + self.decay * torch.cat([leaf.flatten() for leaf in self.leaves]) if self.decay else G

    def _turned(self, flat: Tensor) -> Tensor:
        return flat

    def _returned(self, flat: Tensor) -> Tensor:
        return flat

    def _learn(self, G: Tensor) -> None: ...


@dataclass(frozen=True)
class Matrices:
    """The weights of one shape (r, c): where they are among all parameters, and views of their bases and covariances.

    `left`, `Q_left` (N, r, r) and `right`, `Q_right` (N, c, c).
    """

    start: int
    end: int
    shape: tuple[int, int]
    sides: dict[str, Tensor]

    def part(self, flat: Tensor) -> Tensor:
        """(N, r, c) of a vector of all parameters."""
        return flat[self.start : self.end].view(-1, *self.shape)


class StackedSOAP(StackedAdam):
    """npred.training.soap.SOAP, to rounding: W -= lr Q_L adam(Q_L' G Q_R) Q_R', with decoupled weight decay."""

    betas = BETA, BETA
    names = "mean", "square"

    def __init__(self, leaves: Sequence[Tensor], decay: float = 0.0, count: int | None = None) -> None:
        super().__init__(leaves, decay, count)
        in_order = dict.fromkeys(_place(self.shapes[k]) for k in self.order)
        places = {shape: self._range(shape) for shape in in_order if shape}
        counts: dict[int, int] = {}  # bases by size
        for (r, c), (start, end) in places.items():
            for size in (r, c):
                counts[size] = counts.get(size, 0) + (end - start) // (r * c)
        self.covariances = {size: self.first.new_zeros(number, size, size) for size, number in counts.items()}
        self.bases = {size: torch.eye(size).to(A).expand_as(A).contiguous() for size, A in self.covariances.items()}
        self.groups = list(self._grouped(places))
        self.vectors = max((group.end for group in self.groups), default=0)  # where they begin

    def turn(self, step: int) -> None:
        """Every tenth step of the QR iteration: Q = qr(A Q) of each covariance A and its basis."""
        if step % EVERY == 0:
            for size, Q in self.bases.items():
                Q.copy_(turned_bases(self.covariances[size], Q))

    def tensors(self) -> list[Tensor]:
        return [*super().tensors(), *self.covariances.values(), *self.bases.values()]

    def moments(self, network: int) -> list[State]:
        """With covariances and bases."""
        states = super().moments(network)
        for group in self.groups:
            members = [k for k in self.order if _place(self.shapes[k]) == group.shape]
            for name, stack in group.sides.items():
                shares = [self.count * self.shapes[k][:-2].numel() for k in members]
                for k, part in zip(members, stack.split(shares), strict=True):
                    states[k][name] = part.view(self.count, *self.shapes[k][:-2], *stack.shape[1:])[network]
        return states

    def _range(self, shape: tuple[int, ...]) -> tuple[int, int]:
        """Where among all parameters the weights of this shape begin and end."""
        mine = [i for i, k in enumerate(self.order) if _place(self.shapes[k]) == shape]
        return sum(self.sizes[: mine[0]]), sum(self.sizes[: mine[-1] + 1])

    def _grouped(self, places: dict[tuple[int, ...], tuple[int, int]]) -> Iterator[Matrices]:
        taken = dict.fromkeys(self.bases, 0)
        for (r, c), (start, end) in places.items():
            number, sides = (end - start) // (r * c), {}
            for side, size in (("left", r), ("right", c)):
                rows = slice(taken[size], taken[size] + number)
                sides |= {side: self.covariances[size][rows], f"Q_{side}": self.bases[size][rows]}
                taken[size] += number
            yield Matrices(start, end, (r, c), sides)

    def _decayed(self, G: Tensor) -> Tensor:
        """G as it is: the weights themselves decay."""
        if self.decay:
            torch._foreach_mul_(self.leaves, self.keep)  # type: ignore
        return G

    def _turned(self, flat: Tensor) -> Tensor:
        """Q_L' G Q_R of each weight; a vector as it is."""
        return self._each(flat, lambda A, sides: sides["Q_left"].mT @ A @ sides["Q_right"])

    def _returned(self, flat: Tensor) -> Tensor:
        """Q_L G Q_R'."""
        return self._each(flat, lambda A, sides: sides["Q_left"] @ A @ sides["Q_right"].mT)

    def _each(self, flat: Tensor, function: Any) -> Tensor:
        turned = [function(group.part(flat), group.sides).flatten() for group in self.groups]
        return torch.cat([*turned, flat[self.vectors :]])

    def _learn(self, G: Tensor) -> None:
        """Follow the covariances G G' and G' G."""
        for group in self.groups:
            A = group.part(G)
            group.sides["left"].baddbmm_(A, A.mT, beta=BETA, alpha=1 - BETA)
            group.sides["right"].baddbmm_(A.mT, A, beta=BETA, alpha=1 - BETA)


@dataclass(frozen=True)
class NetworkState:
    """What a checkpoint asks of an optimiser, for one of several networks."""

    optimiser: StackedAdam
    network: int

    def state_dict(self) -> dict[str, Any]:
        """The plain optimiser's: what a CPU or an eager step began, a graph goes on with, and the other way round."""
        step = self.optimiser.steps.float().cpu()
        moments = self.optimiser.moments(self.network)
        states = [{"step": step.clone()} | {name: view.clone() for name, view in views.items()} for views in moments]
        return {"state": dict(enumerate(states)), "param_groups": []}

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        """Take over such a state; all networks have done as many steps."""
        for k, views in enumerate(self.optimiser.moments(self.network)):
            saved = state_dict["state"][k]
            self.optimiser.steps.copy_(saved["step"])
            for name, view in views.items():
                view.copy_(saved[name])


@torch.no_grad()
def turned_bases(A: Tensor, Q: Tensor) -> Tensor:
    """The orthonormal factor of (A + SHIFT tr(A) / n I) Q, for A, Q (N, n, n), by Cholesky-QR twice in double.

    A QR of many small matrices is a loop on a GPU; this is a few batched products and triangles. The shift, which no
    eigenvector feels, lets a direction without a gradient keep its vector [Yamamoto et al. 2015, Fukaya et al. 2020].
    """
    A, Z = A.double(), Q.double()
    unit = torch.eye(A.shape[-1], dtype=A.dtype, device=A.device)
    mean = A.diagonal(dim1=-2, dim2=-1).mean(-1)[:, None, None]
    Z = torch.where(mean > 0, A / mean, 0) @ Z + SHIFT * Z
    for _ in range(2):
        Z = Z / Z.norm(dim=-2, keepdim=True)
        R = torch.linalg.cholesky_ex(Z.mT @ Z + RIDGE * unit)[0].mT
        Z = torch.linalg.solve_triangular(R, Z, upper=True, left=False)
    sound = (Z.mT @ Z - unit).abs().amax((-2, -1), keepdim=True) < 1e-4  # else the old basis serves as well
    return torch.where(sound, Z, Q).to(Q)


def _place(shape: torch.Size) -> tuple[int, ...]:
    """Weights by rows and columns, which the vectors have none of."""
    return tuple(shape[-2:]) if len(shape) > 1 else ()
