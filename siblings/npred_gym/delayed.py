"""An environment whose actions act late, and whose observations come late."""

import copy
import math
from collections.abc import Callable, Sequence
from typing import Any

import gymnasium as gym
import numpy as np

from npred.base import array_checks
from npred.base.errors import ConfigError
from npred_gym import environment
from npred_gym.path import NEARLY, Path

Delay = float | Sequence[float] | Callable[[np.random.Generator], float]


class DelayedActions(gym.Wrapper, gym.utils.RecordConstructorArgs):
    """Actions act late by delay + jitter r, r uniform on [-1, 1] anew for each; the newest that has arrived acts.

    `delay` is a number in the `unit`, "steps" of control or "s"; or several, the stages of one path, as inference,
    network and drive, which add up, each with its jitter; or a function of a NumPy generator that draws the delay of
    the next action. An environment of MuJoCo changes its action within a control step, on its own time step, another
    one between control steps: what arrives in between acts from the next on. Until the first action arrives `first`
    acts, by default 0; or, if `held`, the environment stands still and pays nothing, as a robot that is held.
    Observations are `observation_delay` old, in whole steps. Rewards are those of the moment; in a step with several
    actions the last one counts.

    `info` has the "queue" (k, …) of actions that were sent and may still act, oldest first; "acting", the action at the
    end of the step; "arrived", when actions arrived in this step, by number, in steps, but for those that came after a
    newer one; and the "observation_age" in steps. Raises ConfigError, in one line, for a setting out of range.
    """

    def __init__(
        self, env: gym.Env, delay: Delay, observation_delay: float = 0.0, jitter: float | Sequence[float] = 0.0, *,
        unit: str = "steps", first: Any = None, held: bool = False,
    ) -> None:  # fmt: skip
        gym.utils.RecordConstructorArgs.__init__(
            self, delay=delay, observation_delay=observation_delay, jitter=jitter, unit=unit, first=first, held=held
        )
        super().__init__(env)
        if unit not in ("steps", "s"):
            raise ConfigError(f'unit: expected "steps" or "s", got {unit!r}; write one of them')
        self._unit = environment.control_step(env) if unit == "s" else 1.0
        self._draw = delay if callable(delay) else None
        self._stages, self._jitter = _times("delay", 0.0 if callable(delay) else delay), _times("jitter", jitter)
        if len(self._jitter) not in (1, len(self._stages)) or (self._jitter > self._stages).any():
            raise ConfigError(f"jitter: expected at most the delay, got {jitter} of {delay}; lower it")
        self.substeps, self.held = environment.substeps(env), held
        self.first = _first(first, env.action_space)
        late = _times("observation_delay", observation_delay).sum() / self._unit
        self.observation_delay = math.ceil(late - NEARLY)
        self._random = np.random.default_rng()

    @property
    def delay(self) -> float | None:
        """The delay without jitter in control steps, rounded up to substeps; None where a function draws it."""
        steps = self._stages.sum() / self._unit
        return None if self._draw else Path(self.first, self.substeps).ticks(steps) / self.substeps

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        if seed is not None:
            self._random = np.random.default_rng([seed, 1])  # other numbers than the environment's
        observation, info = self.env.reset(seed=seed, options=options)
        self.path, self._observed = Path(self.first, self.substeps), list[tuple[Any, Any]]()
        return self._observe(observation), info | self._about(0, {})

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        path, begin = self.path, len(self.path) * self.substeps
        end = begin + self.substeps
        path.send(_action(action, self.first), begin + path.ticks(self._next()))
        came = {path.dropped + k: a / self.substeps for k, a in enumerate(path.arrivals) if begin <= a < end}
        if self.held and path.acting(begin) < 0:
            outcome = self._observed[-1][0], 0.0, False, False, {"held": True}
        else:
            outcome = environment.step(self.env, path.pieces(begin, end))
        path.forget(begin)
        observation, reward, terminated, truncated, info = outcome
        return self._observe(observation), reward, terminated, truncated, info | self._about(end - 1, came)

    def _next(self) -> float:
        """The delay of the next action in control steps. Raises ConfigError for one below 0."""
        if not self._draw:
            spread = self._jitter * self._random.uniform(-1, 1, len(self._stages))
            return float((self._stages + spread).sum()) / self._unit
        drawn = array_checks.number("delay", self._draw(self._random))
        if not 0 <= drawn < math.inf:
            raise ConfigError(f"delay: expected a function that draws a time, 0 or more, got {drawn}; clip it")
        return drawn / self._unit

    def _observe(self, observation: Any) -> Any:
        """The newest observation that has arrived; `measured` is the simulator's state when it was taken."""
        self._observed.append((observation, environment.snapshot(self.env.unwrapped)))
        del self._observed[: -1 - self.observation_delay]
        oldest, self.measured = self._observed[0]
        return copy.deepcopy(oldest)

    def _about(self, tick: int, came: dict[int, float]) -> dict[str, Any]:
        path = self.path
        waiting = path.actions[path.acting(tick) + 1 :]
        return {
            "queue": np.array(waiting, self.first.dtype).reshape(-1, *self.first.shape),
            "acting": path.action(tick).copy(), "arrived": came, "observation_age": len(self._observed) - 1,
        }  # fmt: skip


def layer(env: gym.Env) -> DelayedActions | None:
    """The DelayedActions among the wrappers of an environment."""
    while isinstance(env, gym.Wrapper) and not isinstance(env, DelayedActions):
        env = env.env
    return env if isinstance(env, DelayedActions) else None


def _action(action: Any, like: np.ndarray) -> np.ndarray:
    if (action := np.asarray(action, like.dtype)).shape != like.shape:
        raise ConfigError(f"action: expected shape {like.shape}, got {action.shape}; see the action space")
    return action


def _first(first: Any, space: gym.Space) -> np.ndarray:
    """What acts until the first action arrives, by default 0. Raises ConfigError for actions that are no numbers."""
    if not isinstance(space, gym.spaces.Box):
        raise ConfigError(f"DelayedActions: expected actions of a Box, got {space}; choose such an environment")
    return _action(0 * space.low if first is None else array_checks.floats("first", first), np.zeros_like(space.low))


def _times(name: str, value: Any) -> np.ndarray:
    """A time or several, (k,). Raises ConfigError for others."""
    times = np.atleast_1d(array_checks.floats(name, value))
    if times.ndim != 1 or not (np.isfinite(times) & (times >= 0)).all():
        raise ConfigError(f"{name}: expected a time, 0 or more, or several, got {value!r}; give others")
    return times
