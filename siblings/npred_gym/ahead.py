"""A policy that is asked about the moment when its action acts."""

import math
from collections.abc import Callable, Mapping
from numbers import Real
from typing import Any

import gymnasium as gym
import numpy as np

from npred.base import array_checks
from npred.plants import Plant
from npred.prediction.methods import Predictor
from npred_gym import environment
from npred_gym.delayed import DelayedActions, checked, layer
from npred_gym.environment import expect
from npred_gym.model import Model
from npred_gym.path import Path
from npred_gym.simulator import Simulator

HINT = "give control steps, or what npred identify says of a recording"


class Ahead:
    """A policy for late actions: it predicts the observation at the moment when the action acts, and asks the policy.

    Call it with each observation, and with its `info` if that is at hand; `reset` it before an episode. `policy` is a
    function of the observation, or has `predict(observation, deterministic=True)`, as Stable-Baselines3's. `predictor`
    is by default `Simulator(env)`; else a plant or predictor of npred, such as a trained network, guarded or not, which
    becomes a `Model`; or any function of (observation, pieces). `delay` is by default that of DelayedActions; else
    control steps, or the answer of `npred.identify`. With `info` it knows which actions arrived when, and how old the
    observation is; the others are expected at their time, or, if that is over, now.
    Raises ConfigError, in one line, for a delay that is not known, and for what is no policy or predictor.
    """

    def __init__(self, policy: Any, env: gym.Env, predictor: Any = None, delay: Any = None) -> None:
        late = layer(env)
        self.policy, self.substeps = _function(policy), environment.substeps(env)
        self.predictor, self.delay = _predictor(predictor, env), _steps(delay, env, late)
        self.observation_delay = late.observation_delay if late else 0
        self._like = late.first if late else 0 * env.action_space.low  # type: ignore[attr-defined]
        self.first = None if late and late.held else self._like
        self.reset()

    def reset(self) -> None:
        """Forget the actions of the last episode."""
        self.path, self._came = Path(self.first, self.substeps), set[int]()

    def __call__(self, observation: Any, info: Mapping[str, Any] | None = None) -> Any:
        """The action for the moment that is `delay` control steps ahead."""
        info, path, now = info or {}, self.path, len(self.path) * self.substeps
        if "arrived" in info:
            self._hear(info["arrived"], now)
        age = info.get("observation_age", min(len(path), self.observation_delay))
        since, acts = now - age * self.substeps, now + path.ticks(self.delay)
        pieces = path.pieces(since, acts)
        forecast = self.predictor(observation, pieces) if pieces else observation
        got, shape = np.shape(forecast), np.shape(observation)
        expect(got == shape, f"predictor: expected an observation of shape {shape}, got {got}; return one like it")
        action = checked(self.policy(forecast), self._like)
        path.forget(since)
        path.send(action, acts)
        return action

    def _hear(self, arrived: Mapping[int, float], now: int) -> None:
        path = self.path
        self._came |= set(arrived)
        for k, expected in enumerate(path.arrivals):
            number = path.dropped + k
            if number in arrived:
                path.arrivals[k] = path.ticks(arrived[number])
            elif number not in self._came:
                path.arrivals[k] = max(expected, now)


def _function(policy: Any) -> Callable[[Any], Any]:
    if predict := getattr(policy, "predict", None):
        return lambda observation: predict(observation, deterministic=True)[0]
    expect(callable(policy), f"policy: expected a function of the observation, or one with predict, got {policy!r}")
    return policy


def _predictor(predictor: Any, env: gym.Env) -> Any:
    if predictor is None or isinstance(predictor, Plant | Predictor):
        return Simulator(env) if predictor is None else Model(predictor, env)
    fix = f"did you mean delay={predictor}?" if isinstance(predictor, Real) else "see the page on policies"
    what = f"expected a plant or predictor of npred, or a function of (observation, pieces), got {predictor!r}; {fix}"
    expect(callable(predictor) and not isinstance(predictor, type), f"predictor: {what}")
    other = predictor.env if isinstance(predictor, Simulator) else env
    sizes = [(each.observation_space.shape, each.action_space.shape) for each in (env, other)]
    expect(sizes[0] == sizes[1], f"predictor: expected a Simulator with the spaces of {env}, got {other}; give its own")
    return predictor


def _steps(delay: Any, env: gym.Env, late: DelayedActions | None) -> float:
    if delay is None:
        fix = "give its mean or longest in control steps: Ahead(policy, env, delay=4)"
        expect(not late or late.delay is not None, f"delay: DelayedActions draws it by a function; {fix}")
        delay = late.delay if late else None
    elif hasattr(delay, "D"):  # what npred.identify says
        delays = np.atleast_1d(delay.D) / environment.control_step(env)
        single = not getattr(delay, "refused", False) and np.ptp(delays) <= 0.5
        expect(single, f"delay: expected one delay that the recording tells, got D = {delay.D}; {HINT}")
        delay = delays.mean()
    why = " (npred's observers need a traced plant under a law in continuous time)" if isinstance(delay, str) else ""
    expect(delay is not None and not isinstance(delay, str), f"delay: expected a number, got {delay!r}{why}; {HINT}")
    steps = array_checks.number("delay", delay)
    expect(0 <= steps < math.inf, f"delay: expected 0 or more, got {steps}; {HINT}")
    return environment.within_episode("delay", steps, env)
