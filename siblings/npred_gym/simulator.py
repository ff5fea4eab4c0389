"""The environment's own simulator, rolled forward by the actions that are to act."""

from collections.abc import Callable, Sequence
from functools import cached_property
from typing import Any

import gymnasium as gym

from npred_gym import environment
from npred_gym.delayed import layer
from npred_gym.path import HeldAction


class Simulator:
    """The observation after the pieces, by a twin of the environment: one of MuJoCo, or with an attribute `state`.

    It starts from the environment's own state when the observation was taken, which on a machine nobody has; or, with
    `state(observation)`, from the state that an observation tells: (qpos, qvel) of MuJoCo, else the attribute.
    `change(twin)` makes the model another than the plant: its masses are `twin.model.body_mass`.
    Raises ConfigError for other environments.
    """

    def __init__(
        self, env: gym.Env, state: Callable[[Any], Any] | None = None, change: Callable[[Any], None] | None = None
    ) -> None:
        self.env, self.late, self.state, self.change = env, layer(env), state, change
        environment.substeps(env)

    @cached_property
    def twin(self) -> Any:
        """The environment that is rolled forward; of one that has a state only after its reset."""
        other = environment.twin(self.env)
        if self.change:
            self.change(other)
        return other

    def __call__(self, observation: Any, pieces: Sequence[HeldAction]) -> Any:
        """The observation at the end of the pieces."""
        if self.state is not None:
            environment.place(self.twin, self.state(observation))
        else:
            late = self.late
            environment.put(self.twin, late.measured if late else environment.snapshot(self.env.unwrapped))
        return environment.roll(self.twin, pieces)
