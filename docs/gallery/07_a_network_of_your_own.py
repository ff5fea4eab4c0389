"""
Your own network
================

A network is a class of torch in a file. npred generates data from closed loops,
trains the network to predict X(t + D), and closes the loop with it. This one is
tiny, so that the page is built in seconds.
"""

import tempfile
from pathlib import Path

import npred

folder = Path(tempfile.mkdtemp())
(folder / "my_net.py").write_text(
    '''
import torch


class MyNet(torch.nn.Module):
    """N(x) from X, D_hat, x and the share of u that has come in up to x."""

    def __init__(self, n, m, clock=0, *, width=32):
        super().__init__()
        self.layers = torch.nn.Sequential(
            torch.nn.Linear(n + clock + m + 2, width), torch.nn.SiLU(),
            torch.nn.Linear(width, width), torch.nn.SiLU(),
            torch.nn.Linear(width, n),
        )

    def forward(self, X, u, D_hat, stride=1):
        so_far = torch.cumsum(u, dim=1)[:, ::stride] / u.shape[1]
        x = torch.linspace(0, 1, u.shape[1], dtype=u.dtype, device=u.device)
        x = x[None, ::stride, None].expand(u.shape[0], -1, 1)
        constants = torch.cat([X, D_hat[:, None]], dim=1)[:, None]
        constants = constants.expand(-1, x.shape[1], -1)
        return self.layers(torch.cat([constants, so_far, x], dim=2))
'''
)
(folder / "my_net.toml").write_text(
    """
plant = "scalar"

[generate]
samples = 4000
rollouts = 60
t_end = 10.0

[train]
models = ["mine"]

[train.mine]
network = "my_net.py:MyNet"
sizes = { width = 24 }
epochs = 30

[evaluate]
X0 = [0.5]
"""
)

# %%
trained = npred.train(
    folder / "my_net.toml", store=folder / "results", progress=False
)

# %%
# The trained network is a predictor as any other.

plant = npred.plant("scalar")
loop = {"D": 1.0, "D_hat": 1.0, "X0": [0.5], "t_end": 12.0, "dt": 0.01}
exact = npred.simulate(plant, npred.predictor(plant, "rk4"), **loop)
network = npred.simulate(plant, trained.network, **loop)
axes = exact.plot(label="RK4")
network.plot(ax=axes, label="network")
print(f"X at the end: {network.X[-1, 0]:.1e} with the network")
