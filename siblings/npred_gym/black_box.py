"""An environment of MuJoCo as a black box for the pipeline, and its recorded loops as data for networks."""

from collections.abc import Callable, Sequence
from pathlib import Path
from threading import Lock
from typing import Any

import gymnasium as gym
import numpy as np

from npred.base import grid, randomness
from npred_gym import environment
from npred_gym.model import nodes
from npred_gym.path import HeldAction
from npred_gym.states import State, state_of


def plant(env: gym.Env | str, policy: Callable[[Any], Any], state: State | None = None) -> type:
    """The class of a black box: the states are those of the joints, with their speeds, and the law is the policy.

    It need not come to rest; where it does, say `rests = True`, and `npred run` also evaluates its loops.
    Derive the plant of a file from it: `class Hopper(npred_gym.plant("Hopper-v5", policy)): pass`. X' is mj_forward's,
    `rollout` takes the simulator's own steps, as many as make one of its time step at most; the box is that of 32
    resets. `state(observation)` gives (qpos, qvel), for Gymnasium's own environments by default.
    Raises ConfigError for one that is not of MuJoCo's, whose actuators have states, and with ball or free joints.
    """
    env = gym.make(env) if isinstance(env, str) else env
    inner: Any = env.unwrapped
    simple = environment.of_mujoco(inner) and not inner.model.na and inner.model.nq == inner.model.njnt
    what = "expected an environment of MuJoCo, hinges and slides, and actuators without a state"
    environment.expect(simple, f"plant: {what}, got {inner}; declare a plant with f")
    mujoco = environment.engine()
    space, alone, tell = env.action_space, Lock(), state or state_of(env)
    starts = np.array([_vector(env.unwrapped) for seed in range(32) if env.reset(seed=seed)])
    other = environment.twin(env)
    model, data, n = other.model, other.data, other.model.nq

    def f(X: np.ndarray, u: np.ndarray, t: Any, p: Any) -> np.ndarray:
        slopes = np.empty(X.shape)
        with alone:
            for row, x, action in zip(slopes, X, u, strict=True):
                data.qpos, data.qvel, data.ctrl = x[:n], x[n:], action
                mujoco.mj_forward(model, data)
                row[:n], row[n:] = data.qvel, data.qacc
        return slopes

    def observe(X: np.ndarray) -> Any:
        with alone:
            environment.put(other, (X[:n], X[n:]))
            return other._get_obs()

    def rollout(X: np.ndarray, u: np.ndarray, D_hat: np.ndarray, t: Any, p: Any) -> np.ndarray:
        P, (begin, end) = np.repeat(X[:, None], u.shape[1], axis=1), grid.lines(u)
        file_step = model.opt.timestep
        with alone:
            for row, held, D in zip(P, (begin + end) / 2, D_hat, strict=True):
                count = max(1, round(D / (len(row) - 1) / file_step))
                model.opt.timestep = D / (len(row) - 1) / count
                environment.put(other, (row[0, :n], row[0, n:]))
                for k, action in enumerate(held if D else ()):
                    data.ctrl = action
                    mujoco.mj_step(model, data, count)
                    row[k + 1] = np.concatenate([data.qpos, data.qvel])
            model.opt.timestep = file_step
        return P

    names = [model.joint(k).name or f"q{k}" for k in range(n)]
    names += [f"{name}_rate" for name in names]
    return type(type(inner).__name__.removesuffix("Env"), (), {
        "__doc__": f"{inner.spec.id if inner.spec else inner} under a policy, a black box.",
        "traced": False, "rests": False,
        "states": tuple(names), "inputs": tuple(f"u_{model.actuator(k).name or k}" for k in range(model.nu)),
        "input_bounds": tuple(zip(space.low.tolist(), space.high.tolist(), strict=True)),  # type: ignore[attr-defined]
        "box": {name: (low, high) for name, low, high in zip(names, starts.min(0), starts.max(0), strict=True)},
        "f": staticmethod(f), "rollout": staticmethod(rollout), "_observe": staticmethod(observe),
        "kappa": staticmethod(lambda X, t, p: np.array([policy(observe(x)) for x in X], dtype=float)),
        "_state": staticmethod(lambda observation: np.concatenate(tell(observation))),
    })  # fmt: skip


def _vector(inner: Any) -> np.ndarray:
    return np.concatenate([inner.data.qpos, inner.data.qvel]) if environment.of_mujoco(inner) else np.array(inner.state)


def record(
    path: Path | str, env: gym.Env, policy: Callable[[Any], Any], delays: Sequence[int], *, rows: int = 20000,
    episodes: int = 200, steps: int = 250, noise: float = 0.1, state: State | None = None, nx: int = 9, seed: int = 0,
) -> None:  # fmt: skip
    """Write data for `[generate] data`: `rows` at most of what comes of a state over the delays, in control steps.

    The policy acts without delay for up to `steps`, with normal noise on its actions of up to `noise` half ranges, from
    none in the first episode on; every tenth episode is held out. Rows are dense at the begin of episodes, where these
    differ most. States between control steps are those of a cubic.
    """
    from npred.lab.training.data.dataset import Dataset

    rng, dt, tell = randomness.generator(seed, "record"), environment.control_step(env), state or state_of(env)
    columns: dict[str, list[Any]] = {name: [] for name in Dataset.__dataclass_fields__}
    for episode in range(episodes):
        observations, X, u = _episode(env, policy, noise * episode / episodes, steps, seed + episode, rng)
        for d in rng.choice(delays, rows // episodes):
            if (room := len(u) - d) < 0:
                continue
            first = int(rng.random() ** 2 * (room + 1))
            ahead = X[first : first + d + 1]
            shifted = ahead + (np.hstack(tell(observations[first])) - ahead[0])
            pieces = [HeldAction(action, 1.0) for action in u[first : first + d]]
            row = shifted[0], nodes(pieces, nx), d * dt, grid.refine(shifted, nx), d * dt, first * dt
            for name, value in zip(columns, (*row, episode, episode % 10 == 9), strict=True):
                columns[name].append(value)
    kinds: dict[str, Any] = {"rollout": np.int32, "test": np.uint8}
    data = Dataset(**{name: np.array(values, kinds.get(name, float)) for name, values in columns.items()})
    data.write(Path(path), {"source": "recorded"})


def _episode(
    env: gym.Env, policy: Callable[[Any], Any], noise: float, steps: int, seed: int, rng: np.random.Generator
) -> tuple[list[Any], np.ndarray, np.ndarray]:
    space: Any = env.action_space
    observation, _ = env.reset(seed=seed)
    observations, X, u, over = [observation], [_vector(env.unwrapped)], [], [False]
    while not any(over) and len(u) < steps:
        spread = noise * rng.standard_normal(space.shape) * (space.high - space.low) / 2
        action = np.clip(policy(observation) + spread, space.low, space.high).astype(space.dtype)
        observation, _, *over, _ = env.step(action)
        for column, value in ((observations, observation), (X, _vector(env.unwrapped)), (u, action)):
            column.append(value)
    return observations, np.array(X), np.array(u)
