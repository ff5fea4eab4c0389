"""The environment's own simulator, rolled forward by the actions that are to act."""

import copy
from collections.abc import Callable, Sequence
from functools import cached_property
from typing import Any

import gymnasium as gym
from gymnasium.utils.env_checker import data_equivalence as same

from npred_gym import environment
from npred_gym.delayed import layer
from npred_gym.path import HeldAction


class Simulator:
    """The observation after the pieces, by a twin of the environment: one of MuJoCo, or with an attribute `state`.

    It starts from the environment's own state when the observation was taken, which on a machine nobody has; or, with
    `state(observation)`, from the state that an observation tells: (qpos, qvel) of MuJoCo, else the attribute.
    `change(twin)` makes the model another than the plant: see `twin.model.body_mass`. Raises ConfigError for others.
    """

    def __init__(
        self, env: gym.Env, state: Callable[[Any], Any] | None = None, change: Callable[[Any], None] | None = None
    ) -> None:
        self.env, self.late, self.state, self.change = env, layer(env), state, change
        self._last: tuple[Any, Any] = None, None
        environment.substeps(env)

    @cached_property
    def twin(self) -> Any:
        """The environment that is rolled forward; of one that has a state only after its reset."""
        other = environment.twin(self.env)
        if self.change:
            self.change(other)
        return other

    def __call__(self, observation: Any, pieces: Sequence[HeldAction]) -> Any:
        environment.put(self.twin, self.state(observation) if self.state else self._measured(observation))
        return environment.roll(self.twin, pieces)

    def _measured(self, observation: Any) -> Any:
        """The environment's state when the observation was taken. Raises ConfigError where none moves."""
        late, (before, last) = self.late, self._last
        states = [state for _, state in late.observed] if late else [environment.snapshot(self.env.unwrapped)]
        environment.expect(states, "simulator: got DelayedActions without a state; reset it first")
        moves = (late and late.held) or not same(states[-1], last, True) or same(observation, before, True)
        what = "simulator: expected the environment that is stepped, got one that stands still; give state_of(env)"
        environment.expect(moves, what)
        self._last = copy.deepcopy(observation), states[-1]
        return states[0]
