"""What an environment says of itself: its time, its state, and a twin of it with another state."""

import copy
from collections.abc import Sequence
from typing import Any

import gymnasium as gym
import numpy as np

from npred.base.errors import ConfigError, required
from npred_gym.path import HeldAction


def expect(holds: Any, message: str) -> None:
    """Raise ConfigError with the message, one line, where it does not hold."""
    if not holds:
        raise ConfigError(" ".join(message.split()))


def engine() -> Any:
    """The package mujoco, which is imported where it is needed: an environment without it is none of MuJoCo's."""
    return required("npred_gym", "mujoco", "mujoco", "gym")


def of_mujoco(inner: Any) -> bool:
    """True for an environment like those of gymnasium.envs.mujoco."""
    return all(hasattr(inner, name) for name in ("do_simulation", "frame_skip", "model", "data"))


def substeps(env: gym.Env) -> int:
    """The simulator's steps in a control step. Raises ConfigError for wrappers that change actions or observations."""
    while isinstance(env, gym.Wrapper):
        inside = env.has_wrapper_attr("observation_delay")
        what = "around DelayedActions; give the DelayedActions inside" if inside else "around the plant; move it"
        changes = isinstance(env, gym.ActionWrapper | gym.ObservationWrapper)
        changes = changes or env.observation_space.shape != env.env.observation_space.shape
        expect(not changes, f"{type(env).__name__}: expected around the delay or in the policy, got it {what}")
        env = env.env
    space, what = env.action_space, "expected actions of a Box"
    expect(isinstance(space, gym.spaces.Box), f"{env}: {what}, got {space}; choose such an environment")
    return getattr(env, "frame_skip", 1) if of_mujoco(env) else 1


def within_episode(name: str, steps: float, env: gym.Env) -> float:
    longest = getattr(env.spec, "max_episode_steps", None) or steps
    expect(steps <= longest, f"{name}: these are {steps:g} control steps, of episodes of {longest}; is it in ms?")
    return steps


def control_step(env: gym.Env) -> float:
    """The control step in seconds. Raises ConfigError for an environment that does not say it."""
    inner: Any = env.unwrapped
    expect(hasattr(inner, "dt"), f"{inner}: expected an attribute dt in seconds, got none; give times in steps")
    return float(inner.dt)


def snapshot(inner: Any) -> Any:
    """All that the next step depends on but the action: MuJoCo's state, or the attribute; None without either."""
    if not of_mujoco(inner):
        return copy.copy(getattr(inner, "state", None))
    mujoco = engine()
    kind = mujoco.mjtState.mjSTATE_INTEGRATION
    values = np.empty(mujoco.mj_stateSize(inner.model, kind))
    mujoco.mj_getState(inner.model, inner.data, values, kind)
    return values


def twin(env: gym.Env) -> Any:
    """An environment of the same kind with another state, and a copy of the model; no window."""
    inner: Any = env.unwrapped
    other = copy.copy(inner)
    other.render_mode = None
    if of_mujoco(inner):
        other.model = copy.copy(inner.model)
        other.data = engine().MjData(other.model)
    else:
        what = f"got {inner} without a state; reset it first, or give a function of (observation, pieces) as predictor"
        expect(getattr(inner, "state", None) is not None, f"simulator: {what}")
    return other


def put(other: Any, state: Any) -> None:
    """Set a twin to a snapshot, or to a state: (qpos, qvel) of MuJoCo, or the attribute."""
    if not of_mujoco(other):
        other.state = copy.copy(state)
    elif len(state) == 2:
        engine().mj_resetData(other.model, other.data)
        other.set_state(*(np.asarray(part, dtype=float) for part in state))
    else:
        engine().mj_setState(other.model, other.data, state, engine().mjtState.mjSTATE_INTEGRATION)


def roll(other: Any, pieces: Sequence[HeldAction]) -> Any:
    """The observation of a twin after one piece or more."""
    if not of_mujoco(other):
        return [other.step(action)[0] for action, steps in pieces for _ in range(round(steps))][-1]
    for action, steps in pieces:
        other.do_simulation(action, round(steps * other.frame_skip))
    return other._get_obs()


def step(env: gym.Env, pieces: Sequence[HeldAction]) -> tuple[Any, ...]:
    """A control step in which the action may change: the reward is that of the last action."""
    if len(pieces) == 1:
        return env.step(pieces[0].action)
    inner: Any = env.unwrapped
    simulate = inner.do_simulation

    def changing(action: Any, frames: int) -> None:
        for piece in pieces:
            simulate(piece.action, round(piece.steps * inner.frame_skip))

    inner.do_simulation = changing
    try:
        return env.step(pieces[-1].action)
    finally:
        del inner.do_simulation
