"""Policies trained without delay, and the field's baseline: stacked actions trained with it."""

import json
import sys
import time
from collections import deque
from pathlib import Path

import gymnasium as gym
import numpy as np

FOLDER = Path(__file__).parent / "recorded" / "policies"
TRAINED_DELAY = 8  # steps: what the stacked actions are trained with
PPO = {"n_envs": 8, "n_steps": 256, "batch_size": 512, "n_epochs": 10, "learning_rate": 3e-4}
TRAINING = {  # the cheapest first; the algorithm, its steps and its options
    "Pendulum-v1": ("SAC", 8_000, {"learning_rate": 1e-3, "learning_starts": 500}),
    "InvertedPendulum-v5": ("PPO", 120_000, PPO | {"gamma": 0.999}),
    "Reacher-v5": ("PPO", 250_000, PPO | {"gamma": 0.9, "gae_lambda": 0.9}),
    "InvertedDoublePendulum-v5": ("PPO", 250_000, PPO | {"gamma": 0.98, "gae_lambda": 0.9}),
    "Swimmer-v5": (
        "PPO",
        300_000,
        PPO | {"n_envs": 4, "n_steps": 1024, "gamma": 0.9999, "gae_lambda": 0.98, "learning_rate": 6e-4},
    ),
    "HalfCheetah-v5": ("SAC", 30_000, {"learning_rate": 1e-3, "learning_starts": 5000}),
    "Hopper-v5": ("SAC", 30_000, {"learning_rate": 1e-3, "learning_starts": 2000}),
}


class Stacked(gym.Wrapper):
    """An environment whose actions act `delay` steps late, observed together with the actions under way."""

    def __init__(self, env, delay):
        super().__init__(env)
        self.delay = delay
        low, high = (
            np.concatenate([getattr(env.observation_space, side), np.tile(getattr(env.action_space, side), delay)])
            for side in ("low", "high")
        )
        self.observation_space = gym.spaces.Box(low, high, dtype=np.float64)

    def reset(self, **options):
        observation, info = self.env.reset(**options)
        self.queue = deque([np.zeros(self.action_space.shape)] * self.delay)
        return self.stacked(observation), info

    def step(self, action):
        self.queue.append(np.array(action))
        observation, *rest = self.env.step(self.queue.popleft().astype(self.action_space.dtype))
        return self.stacked(observation), *rest

    def stacked(self, observation):
        return np.concatenate([observation, *self.queue])


def train(name, delay, seed=0):
    """Weights of the deterministic policy, with what it cost: processor seconds, steps."""
    import stable_baselines3
    import torch
    from stable_baselines3.common.env_util import make_vec_env
    from stable_baselines3.common.vec_env import VecNormalize

    torch.set_num_threads(1)
    algorithm, steps, options = TRAINING[name]
    options = dict(options)
    ppo = algorithm == "PPO"
    wrapper = (lambda env, delay: Stacked(env, delay)) if delay else None
    environments = make_vec_env(
        name, options.pop("n_envs", 1), seed, wrapper_class=wrapper, wrapper_kwargs={"delay": delay} if delay else None
    )
    if ppo:
        environments = VecNormalize(environments, gamma=options["gamma"])
    model = getattr(stable_baselines3, algorithm)(
        "MlpPolicy", environments, seed=seed, device="cpu", policy_kwargs={"net_arch": [64, 64]}, **options
    )
    started = time.process_time()
    model.learn(steps)
    policy = model.policy
    body, head = (
        (policy.mlp_extractor.policy_net, policy.action_net) if ppo else (policy.actor.latent_pi, policy.actor.mu)
    )
    arrays = {}
    for index, layer in enumerate([m for m in [*body, head] if hasattr(m, "weight")]):
        arrays |= {f"W{index}": layer.weight.detach().numpy(), f"b{index}": layer.bias.detach().numpy()}
    if ppo:
        arrays |= {"mean": environments.obs_rms.mean, "std": np.sqrt(environments.obs_rms.var + environments.epsilon)}
    arrays |= {"low": model.action_space.low, "high": model.action_space.high}
    about = {
        "environment": name,
        "delay": delay,
        "algorithm": algorithm,
        "steps": steps,
        "seed": seed,
        "options": options,
        "processor_seconds": round(time.process_time() - started),
        "hidden": "tanh" if ppo else "relu",
        "output": "clip" if ppo else "tanh",
    }
    return arrays, about


class Policy:
    """The deterministic policy of a stored file, in numpy."""

    def __init__(self, path):
        stored = np.load(path)
        self.about = json.loads(str(stored["about"]))
        self.layers = [(stored[f"W{i}"].astype(float), stored[f"b{i}"].astype(float)) for i in range(3)]
        self.mean, self.std = (stored[k] if k in stored else None for k in ("mean", "std"))
        self.low, self.high = stored["low"], stored["high"]

    def __call__(self, observation):
        h = np.asarray(observation, float)
        if self.mean is not None:
            h = np.clip((h - self.mean) / self.std, -10, 10)
        for W, b in self.layers[:-1]:
            h = W @ h + b
            h = np.tanh(h) if self.about["hidden"] == "tanh" else np.maximum(h, 0)
        h = self.layers[-1][0] @ h + self.layers[-1][1]
        if self.about["output"] == "tanh":
            h = self.low + (np.tanh(h) + 1) / 2 * (self.high - self.low)
        return np.clip(h, self.low, self.high).astype(self.low.dtype)


def returned(env, policy, seed):
    observation, _ = env.reset(seed=seed)
    total, over = 0.0, False
    while not over:
        observation, reward, terminated, truncated, _ = env.step(policy(observation))
        total, over = total + reward, terminated or truncated
    return total


def train_all():
    FOLDER.mkdir(parents=True, exist_ok=True)
    for delay in (0, TRAINED_DELAY):
        for name in TRAINING:
            path = FOLDER / f"{name}-{delay}.npz"
            if path.exists():
                continue
            arrays, about = train(name, delay)
            np.savez_compressed(path, about=json.dumps(about), **arrays)
            env = gym.make(name)
            policy = Policy(path)
            returns = [returned(Stacked(env, delay) if delay else env, policy, seed) for seed in range(5)]
            print(name, delay, np.round(returns, 1), about["processor_seconds"], "s", path.stat().st_size, flush=True)


if __name__ == "__main__" and sys.argv[1:] == ["train"]:
    train_all()
