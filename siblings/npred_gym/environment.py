"""What an environment says of itself: its time, its state, and a twin of it with another state."""

import copy
from collections.abc import Sequence
from typing import Any

import gymnasium as gym
import numpy as np

from npred.base.errors import ConfigError, required
from npred_gym.path import HeldAction


def engine() -> Any:
    """The package mujoco, which is imported where it is needed: an environment without it is none of MuJoCo's."""
    return required("npred_gym", "mujoco", "mujoco", "gym")


def of_mujoco(inner: Any) -> bool:
    """True for an environment like those of gymnasium.envs.mujoco."""
    return all(hasattr(inner, name) for name in ("do_simulation", "frame_skip", "model", "data"))


def substeps(env: gym.Env) -> int:
    """The simulator's steps in a control step. Raises ConfigError for wrappers that change actions or observations."""
    while isinstance(env, gym.Wrapper):
        if isinstance(env, gym.ActionWrapper | gym.ObservationWrapper):
            what = "expected around the delay or in the policy, got it around the plant"
            raise ConfigError(f"{type(env).__name__}: {what}; move it")
        env = env.env
    return getattr(env, "frame_skip", 1) if of_mujoco(env) else 1


def control_step(env: gym.Env) -> float:
    """The control step in seconds. Raises ConfigError for an environment that does not say it."""
    if (dt := getattr(env.unwrapped, "dt", None)) is None:
        raise ConfigError(f"{env.unwrapped}: expected an attribute dt in seconds, got none; give times in steps")
    return float(dt)


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
        mujoco = engine()
        other.model = copy.copy(inner.model)
        other.data = mujoco.MjData(other.model)
    elif getattr(inner, "state", None) is None:
        what = "expected an environment of MuJoCo, or one with an attribute state"
        raise ConfigError(f"simulator: {what}, got {inner}; give a function of (observation, pieces) as predictor")
    return other


def put(other: Any, values: Any) -> None:
    """Set a twin to a snapshot."""
    if of_mujoco(other):
        mujoco = engine()
        mujoco.mj_setState(other.model, other.data, values, mujoco.mjtState.mjSTATE_INTEGRATION)
    else:
        other.state = copy.copy(values)


def place(other: Any, state: Any) -> None:
    """Set a twin to a state: (qpos, qvel) of MuJoCo, or the attribute."""
    if of_mujoco(other):
        mujoco = engine()
        mujoco.mj_resetData(other.model, other.data)
        other.set_state(*(np.asarray(part, dtype=float) for part in state))
    else:
        other.state = np.asarray(state, dtype=float)


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
