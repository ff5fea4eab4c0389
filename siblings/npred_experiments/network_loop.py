"""A loop that asks any predictor, so that a network may replace it, and the calls that the network learns from."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from npred.base import randomness
from npred.lab.config import Anchor
from npred.plants import Plant
from npred.prediction.methods import Predictor

SEED = 2025  # gives other rollouts than the published ones, which come from other generators

Predict = Callable[[np.ndarray, np.ndarray, np.ndarray, Any], np.ndarray]
"""P (B, nx, n) of X (B, n), u (B, nx, m), D_hat (B,) and t, as npred's Predictor.predict."""


class RecordedCalls(NamedTuple):
    """N calls of a predictor: X (N, n), u (N, nx, m), D_hat (N,), P (N, nx, n), t (N,)."""

    X: np.ndarray
    u: np.ndarray
    D_hat: np.ndarray
    P: np.ndarray
    t: np.ndarray

    def joined(self, others: "RecordedCalls") -> "RecordedCalls":
        """These calls, then others."""
        return RecordedCalls(*(np.concatenate(pair) for pair in zip(self, others, strict=True)))

    def parted(self, first: int) -> tuple["RecordedCalls", "RecordedCalls"]:
        """The `first` calls, and those after them."""
        return RecordedCalls(*(a[:first] for a in self)), RecordedCalls(*(a[first:] for a in self))


@dataclass(frozen=True)
class NetworkLoop:
    """A closed loop that asks any predictor: the published one, or the one that its article means.

    `measure` gives the published metrics of the published runs. `explore(predict, rng)` runs other rollouts, side by
    side, from wider starts. `numerical` makes the predictor that a network learns. Of the `calls` of a rollout `kept`
    are learned from, P on `nodes` nodes. `reads_end`: of P the loop reads P(1) alone. `spread`, `noise`: see Recorder.
    `rounds`: so many times, calls of runs that a network disturbs are added to what it has learned from, and its
    training goes on. `quadratic`: the network learns what a quadratic regression leaves of P.
    """

    plant: Callable[[], Plant]
    numerical: Callable[[], Predict]
    explore: Callable[[Predict, np.random.Generator], object]
    measure: Callable[[Predict], dict[str, float]]
    calls: int
    kept: int = 50
    nodes: int | None = None
    reads_end: bool = False
    spread: float = 0.02
    noise: float = 0.0
    anchor: Anchor = "initial"
    rounds: int = 0
    quadratic: bool = False


class Recorder:
    """The numerical predictor: it keeps some of its `calls`, in each rollout `kept` others, and answers with an error.

    A network's errors lead its loop away from the exact one. Errors of two kinds bring such states and such inputs into
    the data: a bias, drawn once per rollout and state, of `spread` times what P moves by, and white noise, in each
    rollout of another standard deviation between a hundredth of `noise` and all of it. What is kept is exact.

    Once there is a network, `learned`, the error is a share of the network's, in each rollout another one between a
    tenth and all of it, and at most twice the standard deviations of both kinds: so the data have what its loop meets,
    but near the exact loop, also while the network would lose it [Ross, Gordon, Bagnell 2011, DAgger].
    """

    def __init__(self, loop: NetworkLoop, rng: np.random.Generator, learned: Predict | None = None) -> None:
        self.loop, self.rng, self.predict, self.learned = loop, rng, loop.numerical(), learned
        self.count, self.kept = 0, []
        self.chosen = self.tilt = self.level = self.share = np.zeros(())

    def __call__(self, X: np.ndarray, u: np.ndarray, D_hat: np.ndarray, t: Any) -> np.ndarray:
        P = self.predict(X, u, D_hat, t)
        if not self.count:
            self._draw(*X.shape)
        rows = np.flatnonzero((self.chosen == self.count).any(axis=1))
        times = np.broadcast_to(np.asarray(t, dtype=float), len(X))
        self.kept.append([rows, *(np.array(array[rows], dtype=np.float32) for array in (X, u, D_hat, P, times))])
        self.count += 1
        if self.learned:
            return self._disturbed(P, self.learned(X, u, D_hat, t), X)
        return P + self.tilt * np.abs(P - X[:, None]) + self.level * self.rng.standard_normal(self.tilt.shape)

    def _disturbed(self, P: np.ndarray, P_hat: np.ndarray, X: np.ndarray) -> np.ndarray:
        """P with a share of a network's error; P(1) alone where the network gives P on other nodes."""
        if P_hat.shape != P.shape:
            P, P_hat = P[:, -1:], P_hat[:, -1:]
        largest = 2 * (self.loop.noise + self.loop.spread * np.abs(P - X[:, None]))
        return P + np.clip(np.nan_to_num(self.share * (P_hat - P)), -largest, largest)

    def _draw(self, rollouts: int, n: int) -> None:
        """The calls to keep (B, kept), and the errors of each rollout."""
        calls = np.arange(self.loop.calls)
        self.chosen = np.stack([self.rng.choice(calls, self.loop.kept, replace=False) for _ in range(rollouts)])
        self.tilt = self.loop.spread * self.rng.standard_normal((rollouts, 1, n))
        self.level = self.loop.noise * 10 ** self.rng.uniform(-2, 0, (rollouts, 1, 1))
        self.share = 10 ** self.rng.uniform(-1, 0, (rollouts, 1, 1))

    def samples(self) -> RecordedCalls:
        """The calls, those of one rollout together."""
        rollout, *arrays = (np.concatenate(parts) for parts in zip(*self.kept, strict=True))
        order = np.argsort(rollout, kind="stable")
        return RecordedCalls(*(array[order] for array in arrays))


def recorded(loop: NetworkLoop, learned: Predict | None = None, turn: int = 0) -> RecordedCalls:
    """The training data of a network: `kept` calls of each rollout; those of another `turn` are other rollouts."""
    rng = randomness.generator(SEED, "reproduce", *([turn] if turn else []))
    recorder = Recorder(loop, rng, learned)
    loop.explore(recorder, rng)
    return recorder.samples()


class Called(Predictor):
    """Any function as npred's predictor."""

    def __init__(self, plant: Plant, nx: int, function: Predict) -> None:
        super().__init__(plant, nx)
        self.function = function

    def predict(self, X: np.ndarray, u: np.ndarray, D_hat: np.ndarray, t: Any) -> np.ndarray:
        return self.function(X, u, D_hat, t)
