"""The promise of a safety filter in exported C: that of Python to the bit in double, and held in float."""

import numpy as np
import pytest
from c_controllers import InC, library, needs_gcc

import npred
from npred.plants import Plant

pytestmark = needs_gcc


class Mass:
    """A mass with |u| <= 1 that is sent to 5, in front of a wall at 5.5."""

    states, inputs = ("x", "v"), ("u",)
    box, input_bounds, guess = {"x": (-1.0, 1.0), "v": (-1.0, 1.0)}, ((-1.0, 1.0),), (5.0, 0.0)
    f = lambda x, u, t, p, M: [x.v, u.u]
    kappa = lambda x, t, p, M: [-25 * (x.x - 5.0) - 10 * x.v]
    safe = lambda x, t, p, M: [5.5 - x.x]


class Led(Mass):
    """One that follows a reference which goes beyond the wall, and never ends."""

    reference = lambda t, p, M: [6.0 * M.sin(0.3 * t), 1.8 * M.cos(0.3 * t)]
    kappa = lambda x, t, p, M: [-9.0 * (x.x - 6.0 * M.sin(0.3 * t)) - 6.0 * (x.v - 1.8 * M.cos(0.3 * t))]


@pytest.mark.parametrize(("declaration", "v"), [(Mass, 0.0), (Led, 0.0), (Mass, -5.0)])
@pytest.mark.parametrize("precision", ["double", "float"])
def test_a_far_wall_is_kept_as_promised(tmp_path, precision, declaration, v):
    plant, dt, late = Plant("mass", declaration), 0.02, 15
    python = npred.controller(
        plant, npred.predictor(plant, "rk4", 31), None, dt, D_hat=late * dt, actuator="history", u0=[0.0],
        safety=npred.SafetyFilter(),
    )  # fmt: skip
    c = InC(library(python, tmp_path, precision), plant, precision)
    x, sent, promises, least = np.array([0.0, v]), [0.0] * late, [], np.inf
    for k in range(600):
        code, U = c.step_at(k * dt, x, k * dt)
        promises.append(bool(c.status(2).promised))
        if precision == "double":
            assert (python.step(x) == U).all() and c.status(2).promised == python.status.promised
        assert code == 0
        sent.append(float(U[0]))
        u = sent[k]
        x, least = np.array([x[0] + dt * x[1] + dt**2 / 2 * u, x[1] + dt * u]), min(least, 5.5 - x[0])
    assert all(promises) and least > 0 and (v < 0 or least < 0.6)
    assert declaration is Led or v < 0 or x == pytest.approx([5.0, 0.0], abs=0.02)
