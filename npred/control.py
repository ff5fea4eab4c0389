"""The controller alone, for a real plant: one step a call, on memory taken at the start."""

import math
import operator
from collections.abc import Mapping
from numbers import Real
from typing import Any

import numpy as np

from npred import arguments, engine, shapes
from npred.adaptation import part
from npred.delay_estimate import DelayLaw
from npred.errors import ConfigError, DivergedError
from npred.plants import inputs
from npred.plants.base import Plant
from npred.predictors import Predictor


class Controller:
    """U = kappa(P(1)), P from the predictor, and D_hat' = gamma Proj{D_hat, phi} [DAPF, eqs. 9-14], each dt seconds.

    The actuator state u is measured, so D_hat, phi of the last step and the step number are all that it remembers.
    `D_hat` (seconds) is the estimate that the next step uses, by default the middle of the adaptation's bounds;
    `adaptation=None` freezes it. U is clipped to `input_bounds` (m, 2), by default the plant's. Steps equal those of
    npred.simulate.
    Raises ConfigError for parts that do not fit together.
    """

    def __init__(
        self, plant: Plant, predictor: Predictor, adaptation: DelayLaw | None, dt: float, *,
        D_hat: float | None = None, input_bounds: Any = None,
    ) -> None:  # fmt: skip
        arguments.parts(plant, predictor, adaptation, "rk4", 1)
        if predictor is None:
            raise ConfigError("predictor: expected one, got None; make one with npred.predictor or npred.load")
        if not isinstance(dt, Real) or not 0 < dt < math.inf:
            raise ConfigError(f"dt: expected a control step above 0 s, got {dt!r}; give seconds")
        self.plant, self.predictor, self.adaptation, self.dt = plant, predictor, adaptation, float(dt)
        law, self._limits = part(plant, adaptation), inputs.bounds(plant, input_bounds)
        self._predict, self._control, self._update = predictor.lanes(), law.control, law.update
        self._gain, self._b, self._bounds = law.gain * self.dt, law.b, law.bounds
        n, m, nx = plant.n, plant.m, predictor.nx
        self._X, self._P, self._U = np.zeros((n, 1)), np.empty((nx, n, 1)), np.zeros((m, 1))
        self._u, self._u_nodes = np.zeros((nx, m, 1)), np.zeros((nx, m, 1))
        self._given, self._D_hat, self._N = np.zeros(m), np.empty(1), np.empty(1)
        self._phi, self._phi_before = np.zeros(1), np.empty(1)
        self.restore({"D_hat": self._start(D_hat), "step": 0})
        self._warm_up()

    @property
    def D_hat(self) -> float:
        """The delay estimate of the next step, in seconds."""
        return float(self._D_hat[0])

    def step(self, X: Any, u: Any, u_nodes: Any = None) -> np.ndarray:
        """U (m,) for the state X (n,) and the actuator state u (nx, m) on the predictor's nodes, both measured now.

        The predictor integrates u: where the measurement can tell them apart, `u` has the mean over each node's cell
        and `u_nodes` the values at the nodes, which the update law compares with kappa(P); by default they are u.
        U is the controller's own memory, overwritten by the next step. Raises ConfigError for shapes that do not fit,
        and DivergedError for a measurement that is not finite, or that the prediction leaves the finite numbers from;
        the controller, and that memory, then stand as before.
        """
        X, u, expected = shapes.floats("X", X), shapes.floats("u", u), (self._X.shape[:1], self._u.shape[:2])
        u_nodes = u if u_nodes is None else shapes.floats("u_nodes", u_nodes)
        for measured in (u, u_nodes):
            if (X.shape, measured.shape) != expected:  # broadcasting would hide a sensor that is lost
                shapes_seen = f"{X.shape} and {measured.shape}"
                raise ConfigError(
                    f"step: expected X {expected[0]} and u {expected[1]}, got {shapes_seen}; measure those"
                )
        self._X[:, 0], self._u[:, :, 0], self._u_nodes[:, :, 0] = X, u, u_nodes
        if not math.isfinite(self._X.sum() + self._u.sum() + self._u_nodes.sum()):
            raise DivergedError("step: expected finite X and u, got one that is not; hold the last U and measure again")
        before = self._D_hat[0], self._phi_before[0]
        self._advance()
        if not math.isfinite(self._U.sum() + self._D_hat[0]):
            self._D_hat[0], self._phi_before[0] = before
            raise DivergedError("step: the prediction from X and u is not finite; hold the last U and measure again")
        self._step += 1
        self._given[:] = self._U[:, 0]
        return self._given

    def state(self) -> dict[str, Any]:
        """What it remembers, ready for JSON."""
        phi = float(self._phi_before[0])
        return {"D_hat": self.D_hat, "phi": None if math.isnan(phi) else phi, "step": self._step}

    def restore(self, state: Mapping[str, Any]) -> None:
        """Go on from a saved state; without phi as from a first step. Raises ConfigError for one that is none."""
        try:
            D_hat, step, phi = float(state["D_hat"]), operator.index(state["step"]), state.get("phi")
            phi = math.nan if phi is None else float(phi)
        except (KeyError, TypeError, ValueError):
            raise ConfigError(f"state: expected D_hat and step, got {state!r}; save it with state()") from None
        low, high = self._bounds
        if not (low <= D_hat <= high and D_hat < math.inf and step >= 0):
            raise ConfigError(
                f"D_hat: expected within [{low:g}, {high:g}] s, got {D_hat:g}; widen the bounds or move D_hat"
            )
        self._D_hat[0], self._phi_before[0], self._step = D_hat, phi, step

    def _start(self, D_hat: float | None) -> float:
        if D_hat is not None:
            given = shapes.floats("D_hat", D_hat)
            if given.ndim:
                raise ConfigError(f"D_hat: expected one delay in seconds, got {D_hat!r}; give a number")
            return float(given)
        if self.adaptation is None:
            raise ConfigError("D_hat: expected a delay in seconds, for nothing adapts it, got none; give D_hat")
        return sum(self.adaptation.bounds) / 2

    def _advance(self) -> None:
        """One control step on the buffers, as in the engine's loop."""
        t, p = self._step * self.dt, self.plant.p
        self._predict(self._X, self._u, self._D_hat, t, p, self._P)
        self._control(self._P, self._u, self._D_hat, t, p, self._U)
        engine.clip(self._U, self._limits)
        self._update(self._P, self._X, self._u_nodes, self._D_hat, t, p, self._b, self._phi, self._N)
        engine.adapt(self._D_hat, self._phi, self._phi_before, self._gain, self._bounds)

    def _warm_up(self) -> None:
        """Compile and load all that a step runs, so that the first step takes no longer than the others."""
        state = self.state()
        self._advance()
        self.restore(state)
