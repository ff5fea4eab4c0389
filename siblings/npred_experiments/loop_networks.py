"""What trains the networks of an experiment, when it is asked to."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from npred_experiments.experiment import Place, TrainedForLoop
from npred_experiments.network_loop import NetworkLoop


@dataclass(frozen=True)
class LoopNetworks:
    """Networks in the predictor's place: one is trained for each of the loops, as published and as it is meant.

    `sizes` are keys of the networks' tables that differ from those of npred_experiments.learning.
    """

    loops: Mapping[str, NetworkLoop]
    sizes: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)

    def __call__(
        self, experiment: str, network: str, place: Place
    ) -> tuple[dict[str, dict[str, float]], list[TrainedForLoop]]:
        from npred_experiments.learning import LoopTraining  # brings torch

        return LoopTraining(experiment, network, place).run(self.loops, self.sizes.get(network, {}))
