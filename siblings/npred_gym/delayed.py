"""An environment whose actions act late, and whose observations come late."""

import copy
import math
from collections.abc import Callable, Sequence
from typing import Any

import gymnasium as gym
import numpy as np

from npred.base import array_checks
from npred_gym import environment
from npred_gym.environment import expect
from npred_gym.path import NEARLY, Path

Delay = float | Sequence[float] | Callable[[np.random.Generator], float]


class DelayedActions(gym.Wrapper, gym.utils.RecordConstructorArgs):
    """Actions act late by delay + jitter r, r uniform on [-1, 1] anew for each; the newest that has arrived acts.

    `delay` is a number in the `unit`, "steps" of control or "s"; or several, the stages of one path, as inference,
    network and drive, which add up, each with its jitter; or a function of a NumPy generator that draws the delay of
    the next action. An environment of MuJoCo changes its action within a control step, on its own time step, another
    one between control steps: what arrives in between acts from the next on. Until the first action arrives `first`
    acts, by default 0; or, if `held`, the environment stands still and pays nothing, as a robot that is held.
    Observations are `observation_delay` old, in the same unit, rounded up to whole steps. Rewards are those of the
    moment; in a step with several actions the last one counts. `info` has the "queue" (k, …) of actions that may still
    act, oldest first; "acting", the action at the end of the step; "arrived", when actions arrived in this step, by
    number, in steps, but for overtaken ones; and the "observation_age". Raises ConfigError for a setting out of range.
    """

    def __init__(
        self, env: gym.Env, delay: Delay, observation_delay: float = 0.0, jitter: float | Sequence[float] = 0.0, *,
        unit: str = "steps", first: Any = None, held: bool = False,
    ) -> None:  # fmt: skip
        gym.utils.RecordConstructorArgs.__init__(
            self, delay=delay, observation_delay=observation_delay, jitter=jitter, unit=unit, first=first, held=held
        )
        super().__init__(env)
        expect(not layer(env), "DelayedActions: expected one, got one around another; give the stages, as [4, 4]")
        expect(unit in ("steps", "s"), f'unit: expected "steps" or "s", got {unit!r}; write one of them')
        self._unit = environment.control_step(env) if unit == "s" else 1.0
        self._draw = delay if callable(delay) else None
        self._stages, self._jitter = _times("delay", 0.0 if callable(delay) else delay), _times("jitter", jitter)
        many, both = len(self._stages), self._draw and self._jitter.any()
        expect(not both, "jitter: expected a delay in numbers, got a function; draw it in the function")
        expect(len(self._jitter) in (1, many), f"jitter: expected 1 or {many} numbers, got {jitter}; give one a stage")
        low = (self._jitter <= self._stages).all()
        expect(low, f"jitter: expected at most the delay, got {jitter} of {delay}; lower it")
        self.substeps, self.held = environment.substeps(env), held
        space: Any = env.action_space
        self.first = checked(0 * space.low if first is None else first, np.zeros_like(space.low))
        late = _times("observation_delay", observation_delay).sum() / self._unit
        self.observation_delay = math.ceil(late - NEARLY)
        for name in ("delay", "observation_delay"):
            environment.within_episode(name, getattr(self, name) or 0, env)
        self._random, self.observed = np.random.default_rng(), list[tuple[Any, Any]]()

    @property
    def delay(self) -> float | None:
        """The delay without jitter in control steps, rounded up to substeps; None where a function draws it."""
        steps = self._stages.sum() / self._unit
        return None if self._draw else Path(self.first, self.substeps).ticks(steps) / self.substeps

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        if seed is not None:
            self._random = np.random.default_rng([seed, 1])  # other numbers than the environment's
        observation, info = self.env.reset(seed=seed, options=options)
        self.path, self.observed = Path(self.first, self.substeps), []
        return self._observe(observation), info | self._about(0, {})

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        expect(self.observed, "DelayedActions: expected a reset before the first step, got none; reset it first")
        path, begin = self.path, len(self.path) * self.substeps
        end = begin + self.substeps
        path.send(checked(action, self.first), begin + path.ticks(self._next()))
        came = {path.dropped + k: a / self.substeps for k, a in enumerate(path.arrivals) if begin <= a < end}
        if self.held and path.acting(begin) < 0:
            outcome = self.observed[-1][0], 0.0, False, False, {"held": True}
        else:
            outcome = environment.step(self.env, path.pieces(begin, end))
        path.forget(begin)
        observation, reward, terminated, truncated, info = outcome
        return self._observe(observation), reward, terminated, truncated, info | self._about(end - 1, came)

    def _next(self) -> float:
        if not self._draw:
            spread = self._jitter * self._random.uniform(-1, 1, len(self._stages))
            return float((self._stages + spread).sum()) / self._unit
        drawn = array_checks.number("delay", self._draw(self._random))
        good = 0 <= drawn < math.inf
        expect(good, f"delay: expected a function that draws a time, 0 or more, got {drawn}; clip it")
        return drawn / self._unit

    def _observe(self, observation: Any) -> Any:
        """The newest observation that has arrived; `observed` has those under way, with the simulator's states."""
        self.observed.append((observation, environment.snapshot(self.env.unwrapped)))
        del self.observed[: -1 - self.observation_delay]
        return copy.deepcopy(self.observed[0][0])

    def _about(self, tick: int, came: dict[int, float]) -> dict[str, Any]:
        path = self.path
        waiting = path.actions[path.acting(tick) + 1 :]
        return {
            "queue": np.array(waiting, self.first.dtype).reshape(-1, *self.first.shape),
            "acting": path.action(tick).copy(), "arrived": came, "observation_age": len(self.observed) - 1,
        }  # fmt: skip


def layer(env: gym.Env) -> DelayedActions | None:
    """The DelayedActions among the wrappers of an environment."""
    while isinstance(env, gym.Wrapper) and not isinstance(env, DelayedActions):
        env = env.env
    return env if isinstance(env, DelayedActions) else None


def checked(action: Any, like: np.ndarray) -> np.ndarray:
    """The action in the dtype of the space. Raises ConfigError for another shape, NaN, and what predict returns."""
    pair = isinstance(action, tuple) and len(action) == 2 and np.shape(action[0]) == like.shape
    expect(not pair, "policy: expected an action, got a tuple with a state; give the model itself, not model.predict")
    action = np.asarray(array_checks.floats("action", action), like.dtype)
    expect(action.shape == like.shape, f"action: expected shape {like.shape}, got {action.shape}; see the action space")
    expect(np.isfinite(action).all(), "policy: expected finite numbers, got NaN or infinity; look at what it sees")
    return action


def _times(name: str, value: Any) -> np.ndarray:
    times = np.atleast_1d(array_checks.floats(name, value))
    good = times.ndim == 1 and times.size and (np.isfinite(times) & (times >= 0)).all()
    expect(good, f"{name}: expected a time, 0 or more, or several, got {value!r}; give others")
    return times
