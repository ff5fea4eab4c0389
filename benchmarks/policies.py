"""Policies whose actions act late, and what makes up for it: seven of Gymnasium's environments.

    python benchmarks/policies.py train [NAME ...]           policies by Stable-Baselines3, those without a file yet
    python benchmarks/policies.py networks [NAME ...]        a DeepONet each, in the folder --work
    python benchmarks/policies.py table [NAME ...]           returns, over five seeds
    python benchmarks/policies.py held                       the exact simulator if the robot is held at the start
    python benchmarks/policies.py follower                   seven joints that take positions: actions as states

`train` trains each policy without delay, and the field's baseline with it: observations beside the last eight actions,
which act eight steps late. Their files, in recorded/policies/, say seed, steps and processor time. Extra: npred[gym],
for `train` and `networks` also npred[policies].
"""

import json
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import gymnasium as gym
import harness
import numpy as np

import npred
import npred_gym
from npred_gym import Ahead, DelayedActions, Model, Simulator, environment

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
    "Hopper-v5": ("SAC", 20_000, {"learning_rate": 1e-3, "learning_starts": 2000}),
}


class Stacked(gym.ObservationWrapper):
    """Around DelayedActions: observations beside the actions that were sent last."""

    def __init__(self, env, delay):
        super().__init__(env)
        self.sent, space = [], env.action_space
        sides = ((getattr(env.observation_space, side), getattr(space, side)) for side in ("low", "high"))
        low, high = (np.hstack([seen, *[acts] * delay]).astype(float) for seen, acts in sides)
        self.observation_space = gym.spaces.Box(low, high, dtype=np.float64)
        self.delay, self.zero = delay, 0 * space.low

    def reset(self, **options):
        self.sent = [self.zero] * self.delay
        return super().reset(**options)

    def step(self, action):
        self.sent = [*self.sent, action][1:]
        return super().step(action)

    def observation(self, observation):
        return np.concatenate([observation, *self.sent])


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
    wrapper = (lambda env: Stacked(DelayedActions(env, delay, held=name in HELD), delay)) if delay else None
    environments = make_vec_env(name, options.pop("n_envs", 1), seed, wrapper_class=wrapper)
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
        stored = np.load(path, allow_pickle=False)
        self.about = json.loads(str(stored["about"]))
        self.layers = [(stored[f"W{i}"].astype(float), stored[f"b{i}"].astype(float)) for i in range(3)]
        self.mean, self.std = (stored.get(k) for k in ("mean", "std"))
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


# returns

NAMES = dict.fromkeys(TRAINING)
SEEDS, DELAYS, TRAINED = range(5), (1, 2, 4, 8, 16), range(1, 9)  # those that networks are trained for
HELD = ("InvertedDoublePendulum-v5",)  # falls before the first action acts: held until then
NOISE = 0.02  # standard deviation of an observation's noise, times that of the observation in the loop without delay
WRONG = 1.1  # times the masses, by which the friction is divided
NOISY_ACTIONS = 0.1  # largest standard deviation in the recorded loops, times half the range of the action
TOLERANCE = 0.05  # of the guard, times the largest action


class Noisy(gym.ObservationWrapper):
    """Normal noise on observations; an angle's sine and cosine have it each."""

    def __init__(self, env, sizes):
        super().__init__(env)
        self.sizes, self.random = sizes, np.random.default_rng(0)

    def observation(self, observation):
        return observation + self.sizes * self.random.standard_normal(len(observation))


def episode(env: Any, act: Callable[..., Any], seed: int, seen: list[Any] | None = None) -> float:
    """The return of act(observation, info)."""
    observation, info = env.reset(seed=seed)
    total, over = 0.0, False
    while not over:
        if seen is not None:
            seen.append(observation)
        observation, reward, terminated, truncated, info = env.step(act(observation, info))
        total, over = total + reward, terminated or truncated
    return total


def wrong(twin: Any) -> None:
    """Make a twin's masses 10 % larger, and its friction that much smaller."""
    if not environment.of_mujoco(twin):
        twin.m *= WRONG
        return
    for name, factor in {
        "body_mass": WRONG,
        "body_inertia": WRONG,
        "geom_friction": 1 / WRONG,
        "dof_damping": 1 / WRONG,
    }.items():
        getattr(twin.model, name)[:] *= factor


class Task:
    """An environment, its policies, and its returns without delay and of random actions."""

    def __init__(self, name: str, work: Path) -> None:
        self.name, self.work, bare, seen = name, work, gym.make(name), []
        self.policy = Policy(FOLDER / f"{name}-0.npz")
        self.best = [episode(bare, lambda o, info: self.policy(o), seed, seen) for seed in SEEDS]
        self.sizes = NOISE * np.std(seen, axis=0)
        bare.action_space.seed(0)
        self.random = np.median([episode(bare, lambda o, info: bare.action_space.sample(), seed) for seed in SEEDS])
        self.took: dict[str, list[float]] = {}

    def late(self, delay: float, jitter: float = 0.0, noisy: bool = False, held: bool | None = None) -> Any:
        held = self.name in HELD if held is None else held
        env = DelayedActions(gym.make(self.name), delay, jitter=jitter, held=held)
        return Noisy(env, self.sizes) if noisy else env

    def returns(self, env: Any, act: Callable[..., Any], title: str = "") -> list[float]:
        """Over the seeds; `title` is that under which the time of a call is kept."""
        times = self.took.setdefault(title, [])

        def timed(observation: Any, info: Any) -> Any:
            start = time.process_time()
            action = act(observation, info)
            times.append(time.process_time() - start)
            return action

        totals = []
        for seed in SEEDS:
            getattr(act, "reset", lambda: None)()
            totals.append(episode(env, timed, seed))
        return totals

    def row(self, title: str, delay: float, jitter: float = 0.0, noisy: bool = False, off: bool = False) -> None:
        """Print the returns of every way to act. The simulator knows the state, unless the observation is noisy."""
        env, kept = self.late(delay, jitter, noisy), self.kept
        read = npred_gym.state_of(env) if noisy else None
        simulator = Simulator(env.env if noisy else env, read, wrong if off else None)
        cells = [kept(self.returns(env, lambda o, info: self.policy(o)))]
        stacked = FOLDER / f"{self.name}-{TRAINED_DELAY}.npz"
        trained = delay == TRAINED_DELAY and not jitter and stacked.exists()
        act = Policy(stacked) if trained else None
        around = Stacked(env, TRAINED_DELAY)
        cells.append(kept(self.returns(around, lambda o, info: act(o))) if act else "")
        cells.append(kept(self.returns(env, Ahead(self.policy, self.inside(env), simulator), "simulator")))
        for guarded in (False, True):
            there = delay in TRAINED and not jitter and self.pipeline.exists()
            there = there and not off and not (guarded and (noisy or delay < TRAINED_DELAY))
            model = Model(self.network(guarded), env) if there else None
            way = "guarded" if guarded else "network"
            cells.append(kept(self.returns(env, Ahead(self.policy, self.inside(env), model), way)) if model else "")
        harness.row(self.name, title, *cells)

    @staticmethod
    def inside(env: Any) -> Any:
        return env.env if isinstance(env, Noisy) else env

    def kept(self, totals: list[float]) -> str:
        """Median, range, and the share of the return without delay that is kept, above that of random actions."""
        share = (np.median(totals) - self.random) / (np.median(self.best) - self.random)
        return f"{np.median(totals):.4g} ({min(totals):.4g} … {max(totals):.4g}) {share:.1%}"

    @property
    def pipeline(self) -> Path:
        return self.work / f"{self.name.partition('-')[0]}.toml"

    def network(self, guarded: bool) -> Any:
        inner = gym.make(self.name).unwrapped
        fine = guarded and environment.of_mujoco(inner)  # the guard reads held actions from nodes on the time steps
        nx = 8 * max(4, inner.frame_skip) + 1 if fine else 9
        network = npred.load(f"{self.pipeline}:deeponet", nx=nx, store=self.work / "store", runtime="fused")
        if not guarded:
            return network
        exact = npred.predictor(network.plant, "rollout", nx=nx)
        return npred.guarded(network, TOLERANCE * float(self.policy.high.max()), exact=exact)


PLANT = """import npred_gym, policies
policy = policies.Policy(policies.FOLDER / "{name}-0.npz")
class {kind}({base}): pass
"""
PIPELINE = """name = "{kind}"
plant = "{kind}_plant.py:{kind}"
generate = {{ data = "{kind}.h5", adaptation = "frozen" }}
evaluate = {{ adaptation = "frozen", X0 = {X0}, D = {D}, D_hat = {D} }}
[train]
models = ["deeponet"]
[train.deeponet]
anchor = "initial"
loss = "standardised"
epochs = {epochs}
batch = 256
width = {width}
depth = 3
basis = {basis}
moments = 9
checkpoint_every = 1000
"""


class Swing:
    """Pendulum-v1 for npred: a rod of 1 kg and 1 m, whose steps of 50 ms are the environment's."""

    traced, states, inputs, input_bounds = False, ("theta", "rate"), ("torque",), ((-2.0, 2.0),)
    box = {"theta": (-np.pi, np.pi), "rate": (-1.0, 1.0)}

    @staticmethod
    def f(X, u, t, p):
        return np.stack([X[:, 1], 15 * np.sin(X[:, 0]) + 3 * u[:, 0]], axis=1)

    @staticmethod
    def rollout(X, u, D_hat, t, p):
        P, h = np.repeat(X[:, None], u.shape[1], axis=1), D_hat / (u.shape[1] - 1)
        held = sum(npred.base.grid.lines(u)) / 2
        for k in range(u.shape[1] - 1):
            rate = P[:, k, 1] + h * (15 * np.sin(P[:, k, 0]) + 3 * held[:, k, 0])
            P[:, k + 1, 1] = np.clip(rate, -8, 8)
            P[:, k + 1, 0] = P[:, k, 0] + h * P[:, k + 1, 1]
        return P

    @staticmethod
    def _observe(X):
        return np.array([np.cos(X[0]), np.sin(X[0]), X[1]], np.float32)

    _state = staticmethod(npred_gym.states.pendulum)


def swing(policy: Any) -> type:
    """That plant under a policy."""
    law = staticmethod(lambda X, t, p: np.array([policy(Swing._observe(x)) for x in X], dtype=float))
    return type("Pendulum", (Swing,), {"kappa": law})


def networks(asked: Any) -> None:
    """Record loops of each environment, and train a DeepONet on them for delays of 1 to 8 steps."""
    asked.work.mkdir(parents=True, exist_ok=True)
    for name in asked.names:
        kind, env = name.partition("-")[0], gym.make(name)
        policy = Policy(FOLDER / f"{name}-0.npz")
        base = "policies.swing(policy)" if kind == "Pendulum" else f'npred_gym.plant("{name}", policy)'
        npred_gym.record(asked.work / f"{kind}.h5", env, policy, TRAINED, rows=asked.rows, noise=NOISY_ACTIONS)
        observation, _ = env.reset(seed=0)
        X0 = np.hstack(npred_gym.state_of(env)(observation)).tolist()
        values = {"kind": kind, "name": name, "base": base, "X0": X0, "D": 8 * environment.control_step(env)}
        sizes = {"epochs": asked.epochs, "width": 32 * (2 + len(X0) // 4), "basis": max(8, 2 * len(X0))}
        (asked.work / f"{kind}_plant.py").write_text(PLANT.format(**values))
        (asked.work / f"{kind}.toml").write_text(PIPELINE.format(**values, **sizes))
        words = ["train", f"{asked.work / kind}.toml", "--store", str(asked.work / "store")]
        said = subprocess.run([sys.executable, "-m", "npred", *words], capture_output=True, text=True)
        print(name, said.stdout.strip().splitlines()[-3:], said.stderr.strip().splitlines()[-1:], flush=True)


def table(asked: Any) -> None:
    """Print the table."""
    harness.head("environment", "delay, steps", "late", "stacked, trained with 8", "simulator", "network", "guarded")
    for name in asked.names:
        task = Task(name, asked.work)
        harness.row(name, "none", task.kept(task.best), *[""] * 4)
        noisy = task.returns(task.late(0, noisy=True), lambda o, info, act=task.policy: act(o))
        harness.row(name, "none, noise", task.kept(noisy), *[""] * 4)
        for delay in DELAYS:
            task.row(str(delay), delay)
        task.row("random, 0 to 8", 4, jitter=4)
        task.row("8, noise", 8, noisy=True)
        task.row("8, model 10 % wrong", 8, off=True)
        task.row("8, both", 8, noisy=True, off=True)
        task.row("4, both", 4, noisy=True, off=True)
        print({title: f"{1e3 * np.median(times):.3f} ms" for title, times in task.took.items() if title}, flush=True)


def held(asked: Any) -> None:
    """Print the returns of the exact simulator at 8 steps, where the robot is held until the first action acts."""
    for name in asked.names:
        task = Task(name, asked.work)
        env = task.late(TRAINED_DELAY, held=True)
        harness.row(name, task.kept(task.best), task.kept(task.returns(env, Ahead(task.policy, env))))


LAG, JOINTS = 0.12, 7  # s


class Follower(gym.Env):
    """Joints that follow the positions sent to them every 20 ms with a lag, and the time; they pay the error."""

    dt, action_space = 0.02, gym.spaces.Box(-2.0, 2.0, (JOINTS,))
    observation_space = gym.spaces.Box(-np.inf, np.inf, (JOINTS + 1,), np.float64)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.state = np.append(self.np_random.uniform(-0.5, 0.5, JOINTS), 0.0)
        return self.state.copy(), {}

    def step(self, action):
        q, t = self.state[:-1], self.state[-1]
        self.state = np.append(action + (q - action) * np.exp(-self.dt / LAG), t + self.dt)
        error = self.state[:-1] - wave(self.state[-1])[0]
        return self.state.copy(), -float(error @ error), False, t > 10.0, {}


def wave(t: float) -> tuple[np.ndarray, np.ndarray]:
    """Where the joints are to be, and their speeds."""
    rates = 1.5 + 0.5 * np.arange(JOINTS)
    return np.sin(rates * t), rates * np.cos(rates * t)


def track(observation: np.ndarray) -> np.ndarray:
    """The positions that bring the joints to the wave, without delay."""
    goal, speed = wave(observation[-1])
    return np.clip(observation[:-1] + LAG * (speed + 4 * (goal - observation[:-1])), -2, 2).astype(np.float32)


def follower(asked: Any) -> None:
    """Print the rms error of such joints at 80 ms, where the state is stale, the last action, and predicted."""
    joints = [f"q{k}" for k in range(JOINTS)]
    plant = npred.plant(type("Joints", (), {
        "states": (*joints, "time"), "inputs": tuple(f"u{k}" for k in range(JOINTS)),
        "f": lambda x, u, t, p, M: [(u[k] - x[k]) / LAG for k in range(JOINTS)] + [1.0 + 0.0 * x[0]],
        "kappa": lambda x, t, p, M: [x[k] for k in range(JOINTS)],
    }))  # fmt: skip
    env = DelayedActions(Follower(), 0.08, unit="s")
    last = lambda o, pieces: np.append(pieces[-1].action, o[-1] + env.delay * Follower.dt)  # noqa: E731
    bare = lambda o, info: track(o)  # noqa: E731
    ways = {"without delay": (Follower(), bare), "late": (env, bare), "action as state": (env, Ahead(track, env, last))}
    ways |= {"simulator": (env, Ahead(track, env)), "plant of npred": (env, Ahead(track, env, plant))}
    harness.head("way to act", "rms error, rad: median (range)")
    for title, (around, act) in ways.items():
        errors = []
        for seed in SEEDS:
            getattr(act, "reset", lambda: None)()
            errors.append(np.sqrt(-episode(around, act, seed) / 501 / JOINTS))
        harness.row(title, f"{np.median(errors):.4f} ({min(errors):.4f} … {max(errors):.4f})")


def train_all(asked: Any) -> None:
    """Train what has no file yet."""
    FOLDER.mkdir(parents=True, exist_ok=True)
    for delay in (0, TRAINED_DELAY):
        for name in asked.names:
            if not (path := FOLDER / f"{name}-{delay}.npz").exists():
                arrays, about = train(name, delay)
                np.savez_compressed(path, about=json.dumps(about), **arrays)
                env = DelayedActions(gym.make(name), delay, held=name in HELD)
                policy = Policy(path)
                totals = [episode(Stacked(env, delay), lambda o, info, act=policy: act(o), seed) for seed in SEEDS]
                print(name, delay, np.round(totals, 1), about["processor_seconds"], "s", flush=True)


if __name__ == "__main__":
    commands = {"train": train_all, "networks": networks, "table": table, "held": held, "follower": follower}
    asked = harness.options(__doc__, {"command": ..., "names": NAMES}, work=Path("policies"), rows=20000, epochs=100)
    if asked.command not in commands:
        raise SystemExit(f"policies.py: expected {', '.join(commands)}, got {asked.command}")
    commands[asked.command](asked)
