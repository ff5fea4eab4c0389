"""One call of npred's FNO beside neuraloperator's, of the same width, modes and layers: batch 1, one thread, untrained.

    pip install neuraloperator
    python benchmarks/neuraloperator_fno.py

Times do not hang on the weights. npred's call has more in it: scaling, the running mean of u, the anchor at rest.
"""

import warnings

import numpy as np
import torch

from npred import networks as runtimes
from npred import plants
from npred.lab.config import FNO
from npred.lab.stages.bench import timing
from npred.lab.training import operators
from npred.lab.training.operators import Scaling

GRIDS, CALLS, SECONDS = (101, 1001), 2000, 4.0


def theirs(config: FNO, channels: int, n: int, nx: int):
    """neuraloperator's FNO with as many complex modes kept; it wants twice the number."""
    warnings.simplefilter("ignore")
    try:
        from neuralop.models import FNO as Theirs
    except ImportError:
        raise SystemExit("error: expected neuraloperator, found none; pip install neuraloperator") from None

    torch.manual_seed(0)
    modes = 2 * (config.modes - 1)
    model = Theirs((modes,), channels, n, hidden_channels=config.width, n_layers=config.layers).eval()
    sample = torch.rand(1, channels, nx)

    @torch.inference_mode()
    def call(k: int) -> None:
        model(sample)

    return call


def ours(runtime: str, config: FNO, nx: int):
    """npred's, as a loop calls it."""
    plant = plants.resolve("activator_repressor")
    torch.manual_seed(0)
    operator = operators.build(config, plant, Scaling(plant.n, plant.m)).eval().requires_grad_(False)
    predict = runtimes.predictor(runtime, plant, operator, nx).lanes()
    X, u, D_hat = np.array([[0.1], [5.0]]), np.full((nx, 1, 1), 0.01), np.ones(1)
    P = np.empty((nx, plant.n, 1))
    return lambda k: predict(X, u, D_hat, 0.0, plant.p, P)


if __name__ == "__main__":
    torch.set_num_threads(1)
    config = FNO()
    print(f"width {config.width}, modes {config.modes}, layers {config.layers}; microseconds a call, median (p99.9)")
    for nx in GRIDS:
        calls = {"neuraloperator": theirs(config, 4, 2, nx)} | {
            name: ours(name, config, nx) for name in runtimes.RUNTIMES.builtin
        }
        found = {name: timing.quantiles(t) for name, t in timing.sample(calls, CALLS, SECONDS).items()}
        base = found["neuraloperator"]["median_us"]
        for name, t in found.items():
            print(f"nx = {nx:4d}  {name:15s}{t['median_us']:9.1f} ({t['p999_us']:.1f})   {base / t['median_us']:.1f}x")
