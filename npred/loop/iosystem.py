"""The controller as a block of python-control: a discrete-time system whose states are the controller's memory.

    import control
    block = npred.as_iosystem(npred.controller(plant, predictor, law, dt=0.01, actuator="history"))
    loop = control.interconnect([block, my_plant], …)

python-control calls its functions for the output and for the next state with any state, in any order; so each block has
a separate controller, set to the state before each step.
"""

import copy
import math
from typing import Any

import numpy as np

from npred.base.errors import ConfigError, required
from npred.loop.controller import Controller


def as_iosystem(controller: Controller, name: str = "npred") -> Any:
    """A control.NonlinearIOSystem with the step dt of the controller, which itself is left as it is.

    Inputs are the plant's states, and with actuator="measured" u at the nodes, `U[0]`, `U[1]`, … for an input U;
    outputs the plant's inputs, D_hat, and P(1) as `x_predicted` for a state x. The states are those of
    `controller.state()`: D_hat, phi, the commands within the longest delay, the observers of the delay. A state of
    zeros, python-control's default, is the one that the controller has now. The block has no gate: it believes each X.

    Parameters
    ----------
    controller : Controller
        From npred.controller.
    name : str, default "npred"
        Name of the block.

    Returns
    -------
    Any
        The block, whose step raises DivergedError for a measurement that is not finite.

    Raises
    ------
    ConfigError
        For what is no controller.
    MissingError
        Without the extra `control`.
    """
    control = required("as_iosystem", "control", "control", "control")
    if not isinstance(controller, Controller):
        raise ConfigError(f"as_iosystem: expected a controller, got {controller!r}; make one with npred.controller")
    block = Block(copy.deepcopy(controller))
    plant, nx = controller.plant, controller.predictor.nx
    nodes = [f"{c}[{j}]" for j in range(nx) for c in plant.inputs] if controller.actuator == "measured" else []
    return control.NonlinearIOSystem(
        block.update, block.output, inputs=[*plant.states, *nodes], states=block.names, dt=controller.dt, name=name,
        outputs=[*plant.inputs, "D_hat", *(f"{state}_predicted" for state in plant.states)],
    )  # fmt: skip


class Block:
    """Steps of a controller as functions of a flat state: `initial` is the state that it has now."""

    def __init__(self, controller: Controller) -> None:
        self._controller = controller
        state = controller.state()
        self._commands, self._observer = "commands" in state, len(state.get("observer", []))
        self._shape = np.shape(state["commands"]["held"]) if self._commands else (0, 0)
        self.names = ["D_hat", "phi", "phi_is_known", "steps", "t0"]
        if self._commands:
            indices = list(np.ndindex(*self._shape))
            self.names += ["commands", *(f"{part}_{k}_{c}" for part in ("held", "sum") for k, c in indices)]
        if self._observer:
            self.names += ["observer_runs", *(f"observer_{i}" for i in range(self._observer))]
        self.initial = self._flat(state)
        self._last: tuple[bytes, np.ndarray, np.ndarray] | None = None

    def update(self, t: float, x: np.ndarray, inputs: np.ndarray, params: Any) -> np.ndarray:
        return self._stepped(x, inputs)[0]

    def output(self, t: float, x: np.ndarray, inputs: np.ndarray, params: Any) -> np.ndarray:
        """U, the D_hat of the prediction, and P(1)."""
        return self._stepped(x, inputs)[1]

    def _stepped(self, x: np.ndarray, inputs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The next state and the output; computed once for both calls of a step."""
        key = np.concatenate([x, inputs]).tobytes()
        if self._last is None or self._last[0] != key:
            controller, n = self._controller, self._controller.plant.n
            controller.restore(self._state(x if np.any(x) else self.initial))
            D_hat, u = controller.D_hat, inputs[n:].reshape(-1, controller.plant.m)
            U = controller.step(inputs[:n], *([u] if len(u) else []))
            D_hat = controller.D_hat if self._observer else D_hat  # an observer estimates before it predicts
            output = np.concatenate([U, [D_hat], controller.P[-1]])
            self._last = key, self._flat(controller.state()), output
        return self._last[1], self._last[2]

    def _flat(self, state: dict[str, Any]) -> np.ndarray:
        phi = state["phi"]
        parts = [[state["D_hat"], 0.0 if phi is None else phi, phi is not None, state["step"], state["t0"]]]
        if self._commands:
            commands = state["commands"]
            parts += [[commands["k"]], np.ravel(commands["held"]), np.ravel(commands["sums"])]
        if self._observer:
            runs = state["observer"][-1] is not None
            parts += [[runs], [0.0 if value is None else value for value in state["observer"]]]
        return np.concatenate([np.asarray(part, dtype=float) for part in parts])

    def _state(self, x: np.ndarray) -> dict[str, Any]:
        state: dict[str, Any] = {"D_hat": x[0], "phi": x[1] if x[2] else None, "step": int(x[3]), "t0": x[4]}
        if self._commands:
            count = math.prod(self._shape)
            held, sums = x[6 : 6 + 2 * count].reshape(2, *self._shape).tolist()
            state["commands"] = {"k": int(x[5]), "held": held, "sums": sums}
        if self._observer:
            runs, memory = x[-self._observer - 1], x[-self._observer :]
            state["observer"] = [value if runs else None for value in memory.tolist()]
        return state
