"""SOAP: Adam in the eigenbasis of Shampoo's preconditioner [Vyas et al. 2024, arXiv:2409.11321]."""

import math
from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from inspect import unwrap
from itertools import groupby
from typing import Any

import torch
from torch import Tensor

BETA = 0.95  # decay of every running mean: both moments and both covariances
EVERY = 10  # steps between two corrections of the eigenbases
EPS = 1e-8
SHIFT = 1e-10  # share of the mean eigenvalue: a direction that no gradient has yet keeps its vector
RIDGE = 1e-13  # added to the unit columns' Gram matrix: rounding makes that of dependent ones indefinite
State = dict[str, Any]


class SOAP(torch.optim.Optimizer):
    """W -= lr Q_L adam(Q_L' G Q_R) Q_R', with Q_L, Q_R the eigenvectors of the running means of G G' and G' G.

    A weight of more than two dimensions is a batch of matrices; a vector is left to Adam. On these small networks it
    ends at a mean square error several times below Adam's in the same time. Weight decay is decoupled.
    """

    # torch wraps these to keep its compiler out, which imports the compiler: seconds, and none is used here.
    add_param_group, zero_grad = unwrap(torch.optim.Optimizer.add_param_group), unwrap(torch.optim.Optimizer.zero_grad)
    state_dict = unwrap(torch.optim.Optimizer.state_dict)
    load_state_dict = unwrap(torch.optim.Optimizer.load_state_dict)

    def __init__(self, parameters: Iterable[Tensor], lr: float | Tensor, weight_decay: float = 0.0) -> None:
        super().__init__(parameters, {"lr": lr, "weight_decay": weight_decay})

    @torch.no_grad()
    def step(self, closure: Callable[[], float] | None = None) -> None:  # type: ignore[override]
        for group in self.param_groups:
            for p in group["params"]:
                G, state = p.grad, self.state[p] or self._start(p)
                # not in place: a state that comes from a graph has one for all parameters
                state["step"] = state["step"] + 1
                state["mean"].lerp_(G, 1 - BETA)
                state["square"].lerp_(_turn(G, state).square(), 1 - BETA)
                unbiased = 1 - BETA ** float(state["step"])
                step = _turn(state["mean"], state) / unbiased / ((state["square"] / unbiased).sqrt() + EPS)
                step = state["Q_left"] @ step @ state["Q_right"].mT if p.dim() > 1 else step
                p.mul_(1 - group["lr"] * group["weight_decay"]).sub_(group["lr"] * step)
                if p.dim() < 2:
                    continue
                state["left"].lerp_(G @ G.mT, 1 - BETA)
                state["right"].lerp_(G.mT @ G, 1 - BETA)
                for side in ("left", "right") if int(state["step"]) % EVERY == 0 else ():
                    state[f"Q_{side}"] = torch.linalg.qr(state[side] @ state[f"Q_{side}"])[0].contiguous()

    def _start(self, p: Tensor) -> State:
        state = self.state[p]
        state |= {"step": torch.zeros(()), "mean": torch.zeros_like(p), "square": torch.zeros_like(p)}
        if p.dim() > 1:
            for side, size in (("left", p.shape[-2]), ("right", p.shape[-1])):
                state[side] = torch.zeros((*p.shape[:-2], size, size)).to(p)
                state[f"Q_{side}"] = torch.eye(size).to(p).expand_as(state[side]).contiguous()
        return state


def _turn(G: Tensor, state: State) -> Tensor:
    """G in the eigenbasis; a vector as it is."""
    return state["Q_left"].mT @ G @ state["Q_right"] if "left" in state else G


@dataclass(frozen=True)
class Matrices:
    """The weights of one shape (r, c): where they are among all parameters, and views of their bases and covariances.

    `left`, `Q_left` (N, r, r) and `right`, `Q_right` (N, c, c).
    """

    start: int
    end: int
    shape: tuple[int, ...]
    sides: dict[str, Tensor]

    def part(self, flat: Tensor) -> Tensor:
        """(N, r, c) of a vector of all parameters."""
        return flat[self.start : self.end].view(-1, *self.shape)


class GraphSOAP(SOAP):
    """SOAP to rounding, for a CUDA graph: few launches in a step, tensors that stay in place, no read on the host.

    A step of a small network on a GPU takes as long as its launches. So the elementwise part is one vector of all
    parameters, the matrices of one shape are one batch, and so are the bases of one size. The state of a parameter has
    the names that SOAP gives, and is views of these: either goes on with the other's checkpoint. `turn`, which the host
    calls after each EVERY-th step, is no part of the graph.
    """

    def __init__(self, parameters: Iterable[Tensor], lr: Tensor, weight_decay: float = 0.0) -> None:
        super().__init__(parameters, lr, weight_decay)
        self.parameters = sorted(self.param_groups[0]["params"], key=_matrix, reverse=True)  # vectors last
        self.sizes, like = [p.numel() for p in self.parameters], self.parameters[0].detach()
        self.mean, self.square = (like.new_zeros(sum(self.sizes)) for _ in range(2))
        self.steps = like.new_zeros((), dtype=torch.float32)
        for p, mean, square in zip(self.parameters, self._pieces(self.mean), self._pieces(self.square), strict=True):
            self.state[p] = {"step": self.steps, "mean": mean, "square": square}
        counts = Counter[int]()  # number of bases by size
        for p in self.parameters:
            for size in _matrix(p):
                counts[size] += math.prod(p.shape[:-2])
        self.covariances = {size: like.new_zeros(count, size, size) for size, count in counts.items()}
        self.bases = {size: torch.eye(size).to(A).expand_as(A).contiguous() for size, A in self.covariances.items()}
        self.groups: list[Matrices] = []
        taken, start = dict.fromkeys(self.bases, 0), 0
        for shape, several in groupby(self.parameters, _matrix):
            if not shape:
                break
            members = list(several)
            counted, end = [math.prod(p.shape[:-2]) for p in members], start + sum(p.numel() for p in members)
            sides: dict[str, Tensor] = {}
            for side, size in zip(("left", "right"), shape, strict=True):
                place = slice(taken[size], taken[size] + sum(counted))
                sides |= {side: self.covariances[size][place], f"Q_{side}": self.bases[size][place]}
                taken[size] += sum(counted)
            for name, stack in sides.items():
                for p, part in zip(members, stack.split(counted), strict=True):
                    self.state[p][name] = part.view(*p.shape[:-2], *stack.shape[1:])
            self.groups.append(Matrices(start, end, shape, sides))
            start = end
        self.vectors = start  # where they begin

    @torch.no_grad()
    def step(self, closure: Callable[[], float] | None = None) -> None:  # type: ignore[override]
        rate, decay = self.param_groups[0]["lr"], self.param_groups[0]["weight_decay"]
        G = torch.cat([p.grad.flatten() for p in self.parameters])
        if decay:
            torch._foreach_mul_(self.parameters, (1 - rate * decay).to(G))  # type: ignore  # a launch for all
        self.steps.add_(1)
        self.mean.lerp_(G, 1 - BETA)
        self.square.lerp_(self._each(G, lambda A, Q_left, Q_right: Q_left.mT @ A @ Q_right).square(), 1 - BETA)
        unbiased = 1 - BETA ** self.steps.double()
        mean = self._each(self.mean, lambda A, Q_left, Q_right: Q_left.mT @ A @ Q_right)
        adam = mean / unbiased / ((self.square / unbiased).sqrt() + EPS)
        step = self._each(adam, lambda A, Q_left, Q_right: Q_left @ A @ Q_right.mT)
        torch._foreach_sub_(self.parameters, self._pieces(rate * step))  # type: ignore
        for group in self.groups:
            A = group.part(G)
            group.sides["left"].baddbmm_(A, A.mT, beta=BETA, alpha=1 - BETA)
            group.sides["right"].baddbmm_(A.mT, A, beta=BETA, alpha=1 - BETA)

    def turn(self) -> None:
        """The step of the QR iteration: Q = qr(A Q) of each covariance A and its basis."""
        for size, Q in self.bases.items():
            Q.copy_(turned_bases(self.covariances[size], Q))

    @torch.no_grad()
    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        """Copy such a state, or SOAP's, to where the tensors are."""
        for k, p in enumerate(self.param_groups[0]["params"]):
            for name, tensor in self.state[p].items():
                tensor.copy_(state_dict["state"][k][name])

    def _pieces(self, flat: Tensor) -> list[Tensor]:
        """The part of each parameter, in its shape."""
        return [part.view_as(p) for part, p in zip(flat.split(self.sizes), self.parameters, strict=True)]

    def _each(self, flat: Tensor, turn: Callable[[Tensor, Tensor, Tensor], Tensor]) -> Tensor:
        """`turn` of the matrices of each shape and their bases; the vectors as they are."""
        turned = [turn(g.part(flat), g.sides["Q_left"], g.sides["Q_right"]).flatten() for g in self.groups]
        return torch.cat([*turned, flat[self.vectors :]])


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


def _matrix(p: Tensor) -> tuple[int, ...]:
    """Rows and columns of a parameter's matrices; a vector has none."""
    return tuple(p.shape[-2:]) if p.dim() > 1 else ()
