"""A network instead of a published loop's predictor: its training, and its answers."""

import time
from collections.abc import Mapping
from copy import deepcopy
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import torch

from npred import networks as runtimes
from npred.base import defaults, randomness
from npred.lab.config import FNO, DeepONet, Network
from npred.lab.config import Training as Table
from npred.lab.scheduler import executors
from npred.lab.scheduler.executors import Threads
from npred.lab.stages.train.train import SEEDING
from npred.lab.training import loss, training_loop
from npred.lab.training.operators import Operator, Scaling, checked, save
from npred.lab.training.rows import Fit, Rows
from npred.networks.fused import lowering
from npred.plants import Plant
from npred_experiments import latency
from npred_experiments.experiment import Place, TrainedForLoop
from npred_experiments.network_loop import SEED, NetworkLoop, Predict, RecordedCalls, recorded
from npred_experiments.regression import Quadratic

HELD_OUT = 0.1  # share of the rollouts
CORRECTED = {"fno_gru": "FNOGRU", "deeponet_gru": "DeepONetGRU"}  # classes of pipeline/gru.py
ROUND = 4  # a round before the last has this part of the epochs
ROUNDS_APART = 100  # the rounds of a regression and those of a network have other runs
DEFAULTS: dict[str, dict[str, Any]] = {
    "deeponet": {"epochs": 30, "batch": 512},
    "fno": {"epochs": 12, "width": 24, "layers": 3},
    "deeponet_gru": {"epochs": 20, "batch": 512},
    "fno_gru": {"epochs": 12, "lr": 5e-3, "batch": 256, "sizes": {"width": 24}},
}


def answers(loop: NetworkLoop, operator: Operator, regression: Quadratic | None = None) -> Predict:
    """A trained network as a loop's predictor, in float64; P on fewer nodes than u has where the loop reads P(1)."""
    plant, operator = loop.plant(), deepcopy(operator).double().eval()

    @torch.inference_mode()
    def predict(X: np.ndarray, u: np.ndarray, D_hat: np.ndarray, t: Any) -> np.ndarray:
        stride = (u.shape[1] - 1) // (loop.nodes - 1) if loop.nodes and loop.reads_end else 1
        rows = [torch.tensor(np.asarray(a), dtype=torch.float64) for a in (X, u, D_hat)]
        angle = torch.tensor(plant.phase(np.broadcast_to(t, len(X)))) if plant.phased else None
        P = operator(*rows, angle, stride=stride).cpu().numpy()
        return P + regression(X, u) if regression else P

    return predict


@lru_cache(maxsize=2)  # both loops of an experiment: all its networks begin with the same
def first_data(loop: NetworkLoop) -> tuple[RecordedCalls, Quadratic | None]:
    """The data of a network before its own rounds, and the regression whose rest it learns, with its rounds."""
    samples = recorded(loop)
    regression = Quadratic.of(samples) if loop.quadratic else None
    if regression:
        for turn in range(loop.rounds):
            samples = samples.joined(recorded(loop, regression.predict, turn + 1))
            regression = Quadratic.of(samples)
    return samples, regression


@dataclass(frozen=True)
class LoopTraining:
    """A network to train for both loops of an experiment."""

    experiment: str
    network: str
    place: Place

    def run(
        self, loops: Mapping[str, NetworkLoop], sizes: Mapping[str, Any]
    ) -> tuple[dict[str, dict[str, float]], list[TrainedForLoop]]:
        """The metrics of each loop with its network in the predictor's place, and how each network was trained.

        Both are trained side by side, in a thread each. An interrupted training continues from its checkpoint.
        """
        torch.set_num_threads(1)  # the same bits on any machine; the other network takes another core
        with executors.closed(Threads(len(loops))) as threads:
            under_way = {name: threads.submit(self._network, name, loop, sizes) for name, loop in loops.items()}
            done = {name: future.result() for name, future in under_way.items()}
        metrics, rows = {}, []
        for name, fitted in done.items():
            self.place.progress.detail(f"{self.title(name)}: in the loop")
            metrics[name] = loops[name].measure(answers(loops[name], fitted.operator, fitted.regression))
            rows.append(TrainedForLoop(network=self.network, loop=name, ms=fitted.milliseconds(), **fitted.numbers))
        return metrics, rows

    def title(self, loop: str) -> str:
        """The name of the training for a loop in progress lines."""
        return f"{self.experiment} {self.network}, {loop}"

    def _network(self, name: str, loop: NetworkLoop, sizes: Mapping[str, Any]) -> "LearnedNetwork":
        """A network trained for a loop, in two files of the result too."""
        start, plant, folder = time.perf_counter(), loop.plant(), self.place.folder / name.replace(" ", "_")
        folder.mkdir(parents=True, exist_ok=True)
        table = table_of(self.network, {"anchor": loop.anchor, "nodes": loop.nodes, **sizes})
        samples, regression = first_data(loop)

        def rows(calls: RecordedCalls, nodes: int | None = None) -> Rows:
            return Rows.of(calls, nodes=nodes, phase=plant.phase(calls.t))

        rest = regression.rest if regression else _itself
        test, train = rest(samples).parted(round(HELD_OUT * len(samples.X) / loop.kept) * loop.kept)
        learned = rows(train, table.nodes)
        operator = self._operator(table, plant, train)
        criterion = loss.Criterion(table.rows, loss.weights(table, plant, learned.P))
        seed = randomness.integer(SEED, "order", self.network)
        fit = Fit(self.title(name), operator, table, learned, rows(test), criterion, seed)
        for turn in range(loop.rounds):
            self._trained(fit, folder, turn, max(1, table.epochs // ROUND))
            more = recorded(loop, answers(loop, operator, regression), ROUNDS_APART + turn)
            learned = Rows.joined([learned, rows(rest(more), table.nodes)])
            fit = replace(fit, train=learned)
        last = self._trained(fit, folder, loop.rounds, table.epochs)
        save(folder, operator, table)
        if regression:
            regression.save(folder)
        return LearnedNetwork(plant, operator, regression, test, numbers(operator, learned, last, start))

    def _trained(self, fit: Fit, folder: Path, turn: int, epochs: int) -> dict[str, Any]:
        """The last epoch's metrics of a round; no other shares its checkpoints."""
        scratch = self.place.scratch / folder.name / str(turn)
        scratch.mkdir(parents=True, exist_ok=True)
        config = fit.config.model_copy(update={"epochs": epochs})
        return training_loop.fit(replace(fit, config=config), scratch, self.place.progress)[-1]

    def _operator(self, table: Table, plant: Plant, train: RecordedCalls) -> Operator:
        """A network to train, with the scales of its outputs."""
        with SEEDING, torch.random.fork_rng(devices=[]):
            torch.manual_seed(randomness.integer(SEED, "train", self.network))
            return checked(table, plant, Scaling.of(train))


@dataclass(frozen=True)
class LearnedNetwork:
    """A network and the regression whose rest it has learned; calls that it has not seen, and how its training went."""

    plant: Plant
    operator: Operator
    regression: Quadratic | None
    unseen: RecordedCalls
    numbers: Mapping[str, Any]

    def milliseconds(self) -> float:
        """The median time of one prediction, fused into one function where the network's kind can be."""
        nx = self.unseen.u.shape[1]
        runtime = "fused" if lowering(self.operator) else "torch"
        run = runtimes.predictor(runtime, self.plant, deepcopy(self.operator), nx)
        return latency.milliseconds(run, latency.PredictorInputs.of(self.unseen), self.regression)


def _itself(calls: RecordedCalls) -> RecordedCalls:
    return calls


def numbers(operator: Operator, learned: Rows, last: Mapping[str, Any], start: float) -> dict[str, Any]:
    """How a training went that began at `start`: its rows, the metrics of its last epoch, its weights and seconds."""
    metrics = {"epochs": last["epoch"], **{key: last[key] for key in ("loss", "mse", "eps_sup")}}
    parameters = sum(p.numel() for p in operator.parameters())
    return metrics | {"samples": len(learned), "parameters": parameters, "seconds": time.perf_counter() - start}


def table_of(network: str, keys: Mapping[str, Any]) -> Table:
    """The table of a network, its defaults overridden by these keys."""
    keys = {"loss": "standardised", **DEFAULTS[network], **keys}
    tables = {"deeponet": DeepONet, "fno": FNO}
    if network in tables:
        return tables[network](**keys)
    file = defaults.shipped()["networks"].with_name("gru.py")  # beside the pipelines that npred brings
    return Network(network=f"{file}:{CORRECTED[network]}", **keys)
