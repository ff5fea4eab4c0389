"""Random samples and untrained operators for the tests of the networks."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
import torch

from npred import plants
from npred.base.registry import short_name
from npred.lab.config import FNO, DeepONet, Network, Training
from npred.lab.training.operators import Operator, Scaling, build

PLANT = plants.resolve("activator_repressor")
PIPELINES = Path(__file__).parents[1] / "pipeline"
SMALL = [DeepONet(width=16, depth=2, basis=6, trunk=8, moments=5), FNO(width=6, modes=4, layers=2)]  # with a fused form
EVERY = [
    *SMALL,
    Network(network=f"{PIPELINES}/averaging.py:AveragingNetwork", sizes={"width": 8, "layers": 2}),
    Network(network=f"{PIPELINES}/gru.py:GRUNetwork", sizes={"width": 6, "steps": 4}),
    Network(network=f"{PIPELINES}/gru.py:FNOGRU", sizes={"width": 6, "modes": 4, "layers": 2, "units": 5, "steps": 4}),
    Network(
        network=f"{PIPELINES}/gru.py:DeepONetGRU",
        sizes={"width": 16, "depth": 2, "basis": 6, "trunk": 8, "moments": 5, "units": 5},
    ),
]
NETWORKS = pytest.mark.parametrize("config", EVERY, ids=lambda config: short_name(config.architecture))


@dataclass(frozen=True)
class Arrays:
    X: np.ndarray
    u: np.ndarray
    D_hat: np.ndarray
    P: np.ndarray


def samples(count: int = 40, nx: int = 21, seed: int = 0) -> Arrays:
    """Smooth actuator states, and displacements P - X that grow with x and with both inputs."""
    random = np.random.default_rng(seed)
    x = np.linspace(0, 1, nx)
    X = random.uniform([0.01, 2.0], [0.2, 30.0], (count, 2))
    D_hat = random.uniform(0.3, 2.0, count)
    u = 0.05 * np.sin(3 * x + random.uniform(0, 6, (count, 1)))[..., None]
    drift = np.concatenate([u, -X[:, None, 1:] * np.ones((1, nx, 1))], axis=-1)
    return Arrays(X, u, D_hat, X[:, None] + D_hat[:, None, None] * x[:, None] * drift)


def several_inputs() -> tuple[plants.Plant, Arrays]:
    """A plant of three states and two inputs, and random rows for it."""

    class Two:
        states, inputs, box = ("a", "b", "c"), ("U", "V"), {}
        f = lambda x, u, t, p, M: [u.U - x.a, u.V - x.b, x.a * x.b - x.c]
        kappa = lambda x, t, p, M: [-x.a, -x.b]
        V = lambda x, t, p, M: x.a**2

    random = np.random.default_rng(0)
    X, u, D_hat = random.normal(size=(4, 3)), random.normal(size=(4, 11, 2)), random.uniform(0.3, 2, 4)
    return plants.Plant("two", Two), Arrays(X, u, D_hat, random.normal(size=(4, 11, 3)))


def holding() -> tuple[plants.Plant, Arrays]:
    """A plant that tracks a reference which stands still, X = 0.5, by a law that depends on time, and random rows."""

    class Holding:
        states, inputs, box = ("X",), ("U",), {}
        f = lambda x, u, t, p, M: [u.U - x.X]
        kappa = lambda x, t, p, M: [0.5 - (2 + M.sin(t)) * (x.X - 0.5)]
        V = lambda x, t, p, M: (x.X - 0.5) ** 2
        reference = lambda t, p, M: [0.5]

    random = np.random.default_rng(0)
    X, u, D_hat = random.normal(size=(4, 1)), random.normal(size=(4, 11, 1)), random.uniform(0.3, 2, 4)
    return plants.Plant("holding", Holding), Arrays(X, u, D_hat, random.normal(size=(4, 11, 1)))


def phased() -> tuple[plants.Plant, Arrays, np.ndarray]:
    """The unicycle, whose two delays let its prediction depend on the time, random rows for it, and their times."""
    random = np.random.default_rng(0)
    X, u, D_hat = random.normal(size=(5, 3)), random.normal(size=(5, 13, 2)), random.uniform(0.5, 0.7, 5)
    rows = Arrays(X, u, D_hat, random.normal(size=(5, 13, 3)))
    return plants.resolve("unicycle"), rows, random.uniform(0, 100, 5)


def operator(config: Training, seed: int = 0, **changes: object) -> Operator:
    """An untrained operator of the activator-repressor plant."""
    torch.manual_seed(seed)
    return build(config.model_copy(update=changes), PLANT, Scaling.of(samples()))


def tensors(data: Arrays) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """The operator's inputs in float32."""
    return tuple(torch.as_tensor(a, dtype=torch.float32) for a in (data.X, data.u, data.D_hat))  # type: ignore[return-value]
