"""A network instead of a published loop's predictor: its training, and its answers."""

import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch

from npred import randomness
from npred.config import FNO, DeepONet, Network
from npred.config import Training as Table
from npred.operators import Operator, Scaling, checked, save
from npred.parallel import executors
from npred.parallel.executors import Threads
from npred.plants import Plant
from npred.results.reproduce import TrainedForLoop
from npred.stages.reproduce.network_loop import SEED, NetworkLoop, Predict, RecordedCalls, recorded
from npred.stages.train import SEEDING
from npred.training import loss, training_loop
from npred.training.training_loop import Fit, Rows

HELD_OUT = 0.1  # of the rollouts
DEFAULTS: dict[str, dict[str, Any]] = {
    "deeponet": {"epochs": 30, "batch": 512},
    "fno": {"epochs": 12, "width": 24, "layers": 3},
    "deeponet_gru": {"epochs": 20, "batch": 512},
    "fno_gru": {"epochs": 12, "lr": 5e-3, "batch": 256, "sizes": {"width": 24}},
}


def answers(loop: NetworkLoop, operator: Operator) -> Predict:
    """A trained network as a loop's predictor, in float64; P on fewer nodes than u has where the loop reads P(1)."""
    plant, operator = loop.plant(), operator.double().eval()

    @torch.inference_mode()
    def predict(X: np.ndarray, u: np.ndarray, D_hat: np.ndarray, t: Any) -> np.ndarray:
        stride = (u.shape[1] - 1) // (loop.nodes - 1) if loop.nodes and loop.reads_end else 1
        rows = [torch.tensor(np.asarray(a), dtype=torch.float64) for a in (X, u, D_hat)]
        angle = torch.tensor(plant.phase(np.broadcast_to(t, len(X)))) if plant.phased else None
        return operator(*rows, angle, stride=stride).numpy()

    return predict


@dataclass(frozen=True)
class LoopTraining:
    """A network to train for both loops of an experiment: where its files and its checkpoints go."""

    experiment: str
    network: str
    folder: Path
    scratch: Path
    progress: Any

    def run(
        self, loops: Mapping[str, NetworkLoop], sizes: Mapping[str, Any]
    ) -> tuple[dict[str, dict[str, float]], list[Any]]:
        """The metrics of each loop with its network in the predictor's place, and how each network was trained.

        Both are trained side by side, in a thread each. An interrupted training continues from its checkpoint.
        """
        torch.set_num_threads(1)  # the same bits on any machine; the other network takes another core
        with executors.closed(Threads(len(loops))) as threads:
            under_way = {name: threads.submit(self._network, name, loop, sizes) for name, loop in loops.items()}
            done = {name: future.result() for name, future in under_way.items()}
        metrics = {}
        for name, (operator, _) in done.items():
            self.progress.detail(f"{self.title(name)}: in the loop")
            metrics[name] = loops[name].measure(answers(loops[name], operator))
        return metrics, [trained for _, trained in done.values()]

    def title(self, loop: str) -> str:
        """What progress calls the training for a loop."""
        return f"{self.experiment} {self.network}, {loop}"

    def _network(self, name: str, loop: NetworkLoop, sizes: Mapping[str, Any]) -> tuple[Operator, TrainedForLoop]:
        """A trained network, in two files of the result too."""
        start, plant, folder = time.perf_counter(), loop.plant(), self.folder / name.replace(" ", "_")
        scratch = self.scratch / folder.name
        for place in (folder, scratch):
            place.mkdir(parents=True, exist_ok=True)
        table = table_of(self.network, {"anchor": loop.anchor, "nodes": loop.nodes, **sizes})
        fit = self._fit(name, loop, plant, table)
        *_, last = training_loop.fit(fit, scratch, self.progress)
        save(folder, fit.operator, table, plant)
        return fit.operator, TrainedForLoop(
            network=self.network, loop=name, samples=len(fit.train), epochs=last["epoch"], loss=last["loss"],
            parameters=sum(p.numel() for p in fit.operator.parameters()), mse=last["mse"], eps_sup=last["eps_sup"],
            seconds=time.perf_counter() - start,
        )  # fmt: skip

    def _fit(self, name: str, loop: NetworkLoop, plant: Plant, table: Table) -> Fit:
        """What is to be trained: a tenth of the rollouts is held out."""
        samples = recorded(loop)
        held_out = round(HELD_OUT * len(samples.X) / loop.kept) * loop.kept
        parts = slice(held_out, None), slice(0, held_out)
        fitted, test = (RecordedCalls(*(array[part] for array in samples)) for part in parts)
        with SEEDING, torch.random.fork_rng(devices=[]):
            torch.manual_seed(randomness.integer(SEED, "train", self.network))
            operator = checked(table, plant, Scaling.of(fitted))
        rows = Rows.of(fitted, nodes=table.nodes, phase=plant.phase(fitted.t))
        criterion = loss.criterion(table.rows, loss.weights(table, plant, rows.P))
        unseen = Rows.of(test, phase=plant.phase(test.t))
        seed = randomness.integer(SEED, "order", self.network)
        return Fit(self.title(name), operator, table, rows, unseen, criterion, seed)


def table_of(network: str, keys: Mapping[str, Any]) -> Table:
    """The table of a network, its defaults overridden by these keys."""
    keys = {"loss": "standardised", **DEFAULTS[network], **keys}
    tables = {"deeponet": DeepONet, "fno": FNO}
    return tables[network](**keys) if network in tables else Network(network=network, **keys)
