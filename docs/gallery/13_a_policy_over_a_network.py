"""
A policy that acts late
=======================

A learned policy gets a state, and returns a chunk of actions. They act later:
the policy's server takes its time, and the arm follows late. Here the arm's
delay comes from an episode in LeRobot's format, and ``npred.predictor`` gives
the state of the moment at which the chunk begins to act.
"""

import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd

import npred
from npred.identification import joints

FRAME, FINE = 1 / 30, 20  # s between two actions; steps of the arm in it
DELAY, LAGS = 0.08, np.array([0.12, 0.1])  # of the arm, in s: nobody knows them
rng = np.random.default_rng(0)


class Arm:
    """The simulated arm: each joint follows its command after DELAY."""

    def __init__(self):
        self.q, self.queue = (
            np.zeros(2),
            [np.zeros(2)] * round(DELAY / FRAME * FINE),
        )

    def frame(self, action):
        for _ in range(FINE):
            self.queue.append(np.asarray(action))
            self.q = self.q + (self.queue.pop(0) - self.q) * (
                1 - np.exp(-FRAME / FINE / LAGS)
            )


# %%
# An episode, as a robot records it: a row a frame, with vectors.

arm, rows = Arm(), []
action = np.zeros(2)
for k in range(600):
    if k % 12 == 0:
        action = rng.normal(0.0, 0.5, 2)
    state = arm.q + rng.normal(0.0, 1e-3, 2)
    rows.append([k * FRAME, k, 0, list(action), list(state)])
    arm.frame(action)
names = ["timestamp", "frame_index", "episode_index"]
episode = Path(tempfile.mkdtemp()) / "episode_000000.parquet"
pd.DataFrame(rows, columns=[*names, "action", "observation.state"]).to_parquet(
    episode
)

found = [joints.identified(task) for task in joints.tasks([episode])[0]]
for joint in found:
    print(
        f"joint {joint.name}: delay {1e3 * joint.delay:.1f} ms, "
        f"lag {1e3 * joint.lag:.1f} ms, certain: {joint.certain}"
    )
D = float(np.mean([joint.delay for joint in found]))
assert abs(D - DELAY) < 0.01


# %%
# The model is what was found.


class Follower:
    states, inputs = ("q0", "q1"), ("u0", "u1")
    parameters = {f"lag{k}": joint.lag for k, joint in enumerate(found)}

    @staticmethod
    def f(x, u, t, p, M):
        return [(u.u0 - x.q0) / p.lag0, (u.u1 - x.q1) / p.lag1]


model = npred.plant(Follower)
predictor = npred.predictor(model, "rk4", nx=101)
lags = np.array([joint.lag for joint in found])


# %%
# Any policy fits in here. This stub was, so to say, trained without delay: from
# the state at which its chunk begins it leads the arm to a moving goal.

CHUNK, GAIN = 20, 4.0


def goal(t):
    return np.array([np.sin(1.5 * t), 0.7 * np.cos(2.1 * t)])


def policy(state, t):
    chunk, follows = [], 1 - np.exp(-FRAME / lags)
    for begin in t + FRAME * np.arange(CHUNK):
        left = (state - goal(begin)) * np.exp(-GAIN * FRAME)
        after = goal(begin + FRAME) + left
        chunk.append(state + (after - state) / follows)
        state = after
    return chunk


# %%
# The loop of the policy's server. It answers an observation after 2 to 9
# frames, each packet by itself; a chunk is for frames from START after its
# observation on, and what comes for frames that are past is dropped. The newest
# observation wins.

START = 6  # frames: most answers have come by then


def predicted(state, k, actions):
    """The state at which the action of frame k + START begins to act."""
    horizon = START * FRAME + D
    begin = np.arange(101) / 100 * horizon - D  # of each node, from now
    frames = np.floor(begin / FRAME + 1e-9).astype(int)
    u = np.array([actions(k + j) for j in frames])
    return predictor(state, u, horizon)[-1]


states = {
    "stale state": lambda state, k, actions: state,
    "action as state": lambda state, k, actions: actions(k + START - 1),
    "predicted": predicted,
}


def track(state_for, seconds=20.0):
    arm, latency = Arm(), np.random.default_rng(1)
    plan, source, waiting, seen = {}, {}, [], []  # by frame: action, its packet

    def actions(frame):  # what is, or will be, sent in a frame
        known = [each for each in plan if each <= frame]
        return plan[max(known)] if known else np.zeros(2)

    for k in range(round(seconds / FRAME)):
        for packet in [each for each in waiting if each[0] <= k]:
            waiting.remove(packet)
            _, number, chunk = packet
            for frame, action in enumerate(chunk, number + START):
                if frame >= k and number >= source.get(frame, -1):
                    plan[frame], source[frame] = action, number
        seen.append(arm.q)
        if k % 3 == 0:  # an observation goes to the server
            state = state_for(arm.q, k, actions)
            chunk = policy(state, (k + START) * FRAME + D)
            waiting.append((k + latency.integers(2, 10), k, chunk))
        plan = {j: plan[j] for j in plan if j > k - 20}
        arm.frame(actions(k))
    return np.array(seen)


t = FRAME * np.arange(600)
wanted, rms = np.array([goal(each) for each in t]), {}
figure, axes = plt.subplots(figsize=(8, 3), layout="constrained")
for name, state_for in states.items():
    q = track(state_for)
    error = np.linalg.norm(q - wanted, axis=1)
    rms[name] = np.sqrt(np.mean(error[90:] ** 2))
    axes.plot(t, error, label=name)
    print(f"{name:16} rms of tracking {rms[name]:.4f} rad")
axes.set(xlabel="t / s", ylabel="distance from the goal / rad", yscale="log")
axes.legend()
assert 5 * rms["predicted"] < min(rms["stale state"], rms["action as state"])
