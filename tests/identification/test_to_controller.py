"""From a recording of a plant that is not its model to a controller of that plant: five plants, five loops."""

import numpy as np
import pytest
from recorded import looped, steps

import npred

CASES = {  # the plant, its true delay, the sampling period, the size of the test signal, the start, the loop's length
    "scalar": (0.4, 0.05, 0.5, [0.8], 15.0),
    "van_der_pol": (0.35, 0.05, 1.0, [1.0, 0.5], 25.0),
    "chemostat": (0.9, 0.1, 0.1, [2.5, 1.6], 60.0),
    "activator_repressor": (0.6, 0.1, 0.05, [0.05, 20.0], 80.0),
    "tank": (0.6, 0.1, 0.3, [0.6], 20.0),
}


class Tank:
    """The tank of the documentation."""

    states, inputs = ("h",), ("q",)
    parameters = {"area": 1.0, "outflow": 0.5, "level": 1.0, "gain": 1.0}
    box, guess = {"h": (0.5, 2.0)}, (1.0,)
    f = lambda x, u, t, p, M: [(u.q - p.outflow * M.sqrt(x.h)) / p.area]
    kappa = lambda x, t, p, M: [p.outflow * M.sqrt(x.h) - p.gain * (x.h - p.level)]
    V = lambda x, t, p, M: (x.h - p.level) ** 2


def made(name: str, **parameters: float) -> npred.plants.Plant:
    return npred.plants.make("tank", Tank, parameters) if name == "tank" else npred.plant(name, **parameters)


@pytest.mark.slow
@pytest.mark.parametrize("name", CASES)
def test_the_identified_controller_stabilises_the_true_plant(name: str):
    D, period, size, start, t_end = CASES[name]
    model, rng = made(name), np.random.default_rng(3)
    in_f = [key for key in model.parameters if key not in ("c", "level", "gain", "delta") and "_set" not in key]
    truth = {key: model.parameters[key] * (1 + 0.03 * rng.uniform(-1, 1)) for key in in_f}
    real = made(name, **truth)
    shrunk = model.u_equilibrium
    law = lambda x: shrunk + 0.5 * (model.kappa(x) - shrunk)  # half the gain bears the delay
    table = looped(real.f, law, model.equilibrium, steps(500, model.m, 8, 1, size), D, period, 0.01, 1)
    found = npred.identify(model, *table, longest=2.0, free=in_f[:1])
    assert found.identifiable.all() and abs(found.D[0] - D) < period
    controlled = made(name, **found.parameters)
    loop = npred.simulate(
        controlled, npred.predictor("rk4", controlled, nx=41), D=D, D_hat=float(found.D[0]), X0=start, t_end=t_end,
        dt=period / 10, u0="equilibrium", truth=real,
    )  # fmt: skip
    gap = np.linalg.norm((loop.X - real.equilibrium) / (1 + np.abs(real.equilibrium)), axis=-1)
    assert gap[-1] < 0.1 and gap[-1] < 0.3 * gap[0]
