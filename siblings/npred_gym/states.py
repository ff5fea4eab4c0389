"""The state that an observation tells, for the environments of Gymnasium that leave nothing out that moves."""

from collections.abc import Callable
from typing import Any

import gymnasium as gym
import numpy as np

from npred.base.errors import ConfigError
from npred_gym.environment import of_mujoco

State = Callable[[np.ndarray], Any]  # (qpos, qvel), or the attribute state


def pendulum(o: np.ndarray) -> np.ndarray:
    return np.array([np.arctan2(o[1], o[0]), o[2]], dtype=float)


NAMED: dict[str, State] = {
    "InvertedDoublePendulumEnv": lambda o: (np.concatenate([o[:1], np.arctan2(o[1:3], o[3:5])]), o[5:8]),
    "PendulumEnv": pendulum,
    "ReacherEnv": lambda o: (np.r_[np.arctan2(o[2:4], o[:2]), o[4:6]], np.r_[o[6:8], 0.0, 0.0]),
}


def state_of(env: gym.Env) -> State:
    """(qpos, qvel) of an observation, with 0 for the first coordinates where it leaves them out: where the robot is.

    Raises ConfigError for an environment whose observation is not that of its joints; `state` takes another function.
    """
    inner: Any = env.unwrapped
    if (name := type(inner).__name__) in NAMED:
        return NAMED[name]
    size = env.observation_space.shape
    if not of_mujoco(inner) or size is None or not 0 <= (hidden := inner.model.nq + inner.model.nv - size[0]) <= 2:
        what = "expected an observation of positions and speeds"
        raise ConfigError(f"{inner}: {what}, got another; give state, a function of the observation")
    joints = inner.model.nq - hidden
    return lambda o: (np.concatenate([np.zeros(hidden), o[:joints]]), o[joints:])
