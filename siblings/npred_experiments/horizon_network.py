"""A Fourier neural operator for the inverse of t - D(t): from D at nodes of [0, 13] to ρ(t) - t at those of [0, 12]."""

import time
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np
import torch
from scipy.interpolate import CubicSpline
from torch import Tensor, nn
from torch.nn import functional

from npred.base import randomness
from npred.lab.stages.train.train import SEEDING
from npred.lab.training import training_loop
from npred.lab.training.operators import Operator, Scaling
from npred.lab.training.operators.deeponet import mlp
from npred.lab.training.operators.fno import Spectral
from npred.lab.training.rows import Fit, Rows
from npred_experiments import horizons, latency
from npred_experiments.experiment import AS_MEANT, TrainedForLoop
from npred_experiments.horizons import Delay, T
from npred_experiments.learning import numbers, table_of
from npred_experiments.network_loop import SEED, RecordedCalls

NODES, INSIDE = 131, 121  # on [0, 13], and those of them on [0, 12]: ρ(12) hangs on what D is after 12
COUNT, HELD_OUT = 2200, 200  # delays
WIDTH, MODES, LAYERS, BATCH, EPOCHS = 24, 32, 4, 32, 30
NODE_TIMES = np.linspace(0.0, T + 1.0, NODES)


class HorizonFNO(nn.Module):
    """N = u + project(v_L), v_l+1 = v_l + silu(spectral_l(v_l) + W_l v_l), v_0 = lift(u, x), with D as u.

    Other than npred's predictors it reads u itself, not its means: ρ(t) - t = D(ρ(t)) hangs on D near t alone.
    """

    def __init__(self, width: int, modes: int, layers: int) -> None:
        super().__init__()
        self.lift = nn.Linear(2, width)
        self.spectral = nn.ModuleList(Spectral(width, modes) for _ in range(layers))
        self.local = nn.ModuleList(nn.Linear(width, width) for _ in range(layers))
        self.project = mlp([width, 2 * width, 1])

    def forward(self, X: Tensor, u: Tensor, D_hat: Tensor, stride: int = 1) -> Tensor:
        """N (B, INSIDE, 1) of u (B, NODES, 1), with the call of an operator's networks."""
        x = torch.linspace(-1, 1, u.shape[1], dtype=u.dtype)[:, None].expand(*u.shape)
        v = self.lift(torch.cat([u, x], dim=2))
        for spectral, local in zip(self.spectral, self.local, strict=True):
            v = v + functional.silu(spectral(v) + local(v))
        return (u + self.project(v))[:, :INSIDE]


@cache
def samples(count: int = COUNT) -> RecordedCalls:
    """Feasible delays as u, and their horizons ρ(t) - t as P."""
    generator = randomness.generator(SEED, "horizons")
    delays: list[Delay] = []
    while len(delays) < count:
        delay = horizons.drawn(generator)
        delays += [delay] if horizons.feasible(delay) else []
    inside = NODE_TIMES[:INSIDE]
    D = np.stack([NODE_TIMES - horizons.late(delay, NODE_TIMES) for delay in delays])[..., None]
    ahead = np.stack([horizons.tabulated(delay, inside) - inside for delay in delays])[..., None]
    return RecordedCalls(D[:, 0], D, D[:, 0, 0], ahead, np.zeros(count))


def inverse(operator: Operator, delay: Delay, t: np.ndarray) -> np.ndarray:
    """ρ(t) at many times by a network, with a cubic spline between its nodes."""
    D = torch.as_tensor(NODE_TIMES - horizons.late(delay, NODE_TIMES), dtype=torch.float32)[None, :, None]
    with torch.inference_mode():
        ahead = operator(D[:, 0], D, D[:, 0, 0])[0, :, 0].double().cpu().numpy()
    return t + CubicSpline(NODE_TIMES[:INSIDE], ahead)(t)


def trained(folder: Path, scratch: Path, progress: Any, epochs: int = EPOCHS) -> tuple[Operator, TrainedForLoop]:
    """The network, its weights in a file of the folder, and how its training went.

    An interrupted training continues from its checkpoint in `scratch`.
    """
    torch.set_num_threads(1)  # the same bits on any machine
    start, table = time.perf_counter(), table_of("fno", {"epochs": epochs, "batch": BATCH, "checkpoint_every": 1})
    unseen, learned = samples().parted(HELD_OUT)
    with SEEDING, torch.random.fork_rng(devices=[]):
        torch.manual_seed(randomness.integer(SEED, "train", "horizons"))
        network = HorizonFNO(WIDTH, MODES, LAYERS)
    operator = Operator(network, Scaling.of(learned), "none", torch.zeros(1), torch.zeros(1))
    seed, rows = randomness.integer(SEED, "order", "horizons"), Rows.of(learned)
    square: Any = functional.mse_loss  # in the order of torch, which the published digits are of
    fit = Fit("horizons fno", operator, table, rows, Rows.of(unseen), square, seed)
    scratch.mkdir(parents=True, exist_ok=True)
    last = training_loop.fit(fit, scratch, progress)[-1]
    operator.weights().save(folder / "horizons.safetensors")
    ms = latency.median_of(partial(inverse, operator, horizons.draws()[0], horizons.times()[:-1]))
    return operator, TrainedForLoop(network="fno", loop=AS_MEANT, ms=ms, **numbers(operator, rows, last, start))
