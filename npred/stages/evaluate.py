"""The evaluate stage: errors on held-out rollouts, what closed loops make of them, and the certificate of both."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np

from npred import metrics, randomness
from npred.adaptation import DelayAdaptation
from npred.closed_loop import Trajectories, simulate
from npred.config import Evaluate
from npred.dataset import Dataset
from npred.plants import Plant
from npred.predictors import METHODS, Predictor
from npred.stages import Job, certificate, coverage, figure1

EVERY = 10  # control steps between two kept states
ROWS = 1024  # held-out rows a call
EXACT = {"mse": 0.0, "eps_sup": 0.0, "eps_kappa": 0.0, "rel_l2": 0.0}  # the numerical predictor is the reference


@dataclass(frozen=True)
class Contender:
    """A predictor in the comparison; without adaptation its D_hat stays at D_hat(0)."""

    name: str
    predictor: Predictor
    network: bool = False
    adapts: bool = True


@dataclass(frozen=True)
class Starts:
    """The loops of an evaluation: first that of Fig. 1, then the cases, then the map D x D_hat(0)."""

    X0: np.ndarray  # (B, n)
    D: np.ndarray  # (B,)
    D_hat0: np.ndarray  # (B,)
    cases: slice
    map: slice

    def of(self, contender: Contender) -> int:
        """How many loops a contender runs: the map only with adaptation."""
        return len(self.D) if contender.adapts else self.cases.stop


def starts(seed: int, config: Evaluate, plant: Plant) -> Starts:
    """Fig. 1's start, random states of the plant's box x case_D_hat0 at delay D, Fig. 1's state over the map."""
    rng = randomness.generator(seed, "evaluate", "cases")
    box = np.array([plant.box[name] for name in plant.states])
    states = rng.uniform(box[:, 0], box[:, 1], (config.case_states, plant.n))
    D, D_hat0 = np.meshgrid(config.map_D, config.map_D_hat0, indexing="ij")
    cases, cells = config.case_states * len(config.case_D_hat0), D.size
    return Starts(
        np.concatenate([[config.X0], np.repeat(states, len(config.case_D_hat0), 0), np.tile(config.X0, (cells, 1))]),
        np.concatenate([np.full(1 + cases, config.D), D.ravel()]),
        np.concatenate([[config.D_hat0], np.tile(config.case_D_hat0, config.case_states), D_hat0.ravel()]),
        slice(1, 1 + cases),
        slice(1 + cases, 1 + cases + cells),
    )


def run(job: Job) -> dict[str, Any]:
    """For the numerical predictor, without adaptation, and each network and snapshot: errors, cases, map, Fig. 1.

    Writes figure1, certificate and coverage (.svg, .png) and figure1.h5. Warns where loops leave the data.
    """
    config, data = job.config.evaluate, Dataset.read(job.inputs["generate"] / "data.h5")
    begin, contenders = starts(job.config.seed, config, job.plant), _contenders(job)
    loops = _all_loops(job, contenders, begin)
    test = data.subset(test=True)
    models = {c.name: _row(job.plant, config, begin, c, test, loops) for c in contenders}
    covered = coverage.measure(job.plant, data, {c.name: loops[c.name] for c in contenders if c.network})
    _warn(job, covered)
    _draw(job, data, models, loops)
    return {
        "plant": job.plant.name,
        "equilibrium": job.plant.equilibrium.tolist(),
        "gain": metrics.gain(job.plant),
        "held_out": len(test),
        "models": models,
        "coverage": covered,
    }


def _contenders(job: Job) -> list[Contender]:
    config = job.config.evaluate
    numerical = METHODS[config.predictor](job.plant, config.nx)
    found = [Contender("numerical", numerical), Contender("no_adaptation", numerical, adapts=False)]
    for model in sorted(set(job.config.train.models)):
        for snapshot in [*getattr(job.config.train, model).snapshots, None]:
            name = model if snapshot is None else f"{model}@{snapshot}"
            found.append(Contender(name, _neural(job, model, snapshot, name), network=True))
    return found


def _all_loops(job: Job, contenders: list[Contender], begin: Starts) -> dict[str, Trajectories]:
    """Every contender's loops, a thread each: compiled kernels and torch let go of the GIL."""
    config = job.config.evaluate
    total = sum(begin.of(contender) for contender in contenders) * (round(config.case_t_end / config.dt) + 1)
    with job.progress.bar("evaluate", total, "steps") as bar, ThreadPoolExecutor(job.jobs) as pool:
        tasks = {c.name: pool.submit(_loops, job.plant, c, config, begin, bar.advance) for c in contenders}
        try:
            return {name: done.result() for name, done in tasks.items()}
        except BaseException:
            job.progress.stop()
            pool.shutdown(wait=False, cancel_futures=True)
            raise


def _neural(job: Job, model: str, snapshot: int | None, name: str) -> Predictor:
    import torch

    from npred import operators
    from npred.predictors.neural import Neural

    torch.set_num_threads(1)  # the contenders share the cores
    operator = operators.load(job.inputs[model], job.plant, snapshot)
    return Neural(job.plant, operator, job.config.evaluate.nx, job.device, name)


def _loops(plant: Plant, contender: Contender, config: Evaluate, begin: Starts, progress: Any) -> Trajectories:
    law, some = DelayAdaptation(config.gamma, config.b, config.bounds), slice(begin.of(contender))
    return simulate(
        plant, contender.predictor, D=begin.D[some], D_hat=begin.D_hat0[some], X0=begin.X0[some], dt=config.dt,
        t_end=config.case_t_end, adaptation=law if contender.adapts else None, input_bounds=config.input_bounds,
        every=EVERY, progress=progress,
    )  # fmt: skip


def _row(
    plant: Plant, config: Evaluate, begin: Starts, contender: Contender, test: Dataset, loops: dict[str, Trajectories]
) -> dict[str, Any]:
    """All that is reported of one contender."""
    run, exact = loops[contender.name], loops["numerical"]
    errors = _errors(plant, contender, test) if contender.network else dict(EXACT)
    cases, reference = run.part(begin.cases), exact.part(begin.cases)
    radii = metrics.radius(cases, plant.equilibrium)
    settle, goal = (metrics.settle_time(some, plant.equilibrium) for some in (cases, reference))
    settled = np.isfinite(goal) & (goal > 0)
    mapped = contender.adapts and begin.map.stop > begin.map.start
    return {
        **errors,
        "radius": {
            "median": metrics.number(np.median(radii)),
            "worst": metrics.number(radii.max()),
            "converged": float(metrics.converged(radii, plant.equilibrium).mean()),
            "cases": len(radii),
            "predicted": metrics.gain(plant) * errors["eps_kappa"],
        },
        "settle_time": metrics.number(np.median(settle)),
        "settle_ratio": _median(settle[settled] / goal[settled]),
        "decay_rate": _median(metrics.decay_rate(cases, plant.equilibrium)),
        "map": certificate.delay_map(plant, config, run.part(begin.map), exact.part(begin.map)) if mapped else None,
        "figure1": figure1.numbers(plant, figure1.first(config, run)),
    }


def _median(values: np.ndarray) -> float | None:
    """The median without NaN; None where nothing is left."""
    known = values[~np.isnan(values)]
    return metrics.number(np.median(known)) if len(known) else None


def _errors(plant: Plant, contender: Contender, test: Dataset) -> dict[str, Any]:
    blocks = [slice(i, i + ROWS) for i in range(0, len(test), ROWS)]
    P_hat = np.concatenate([contender.predictor(test.X[i], test.u[i], test.D_hat[i]) for i in blocks])
    return metrics.errors(plant, P_hat, test.P) | metrics.relative(plant, test.X, test.u, P_hat, test.P)


def _warn(job: Job, covered: dict[str, Any]) -> None:
    for quantity, found in covered.items():
        for contender, share in found["outside"].items():
            if share > coverage.WARN:
                known = f"[{found['data'][0]:.3g}, {found['data'][1]:.3g}]"
                job.progress.warn(
                    f"{contender}: {share:.1%} of the loops' steps have {quantity} outside the data's {known}; "
                    "widen generate's box, D or D_hat0"
                )


def _draw(job: Job, data: Dataset, models: dict[str, Any], loops: dict[str, Trajectories]) -> None:
    config = job.config.evaluate
    firsts = {name: figure1.first(config, run) for name, run in loops.items()}
    figure1.draw(job.folder, job.plant, config.D, firsts)
    certificate.draw(job.folder, config, models, metrics.gain(job.plant), firsts)
    coverage.draw(job.folder, job.plant, data, loops)


def summary(result: dict[str, Any]) -> Any:
    """The contenders as a table."""
    from rich.table import Table

    table = Table(title=f"{result['plant']}: errors on {result['held_out']} held-out samples, and closed loops")
    table.add_column("predictor")
    for column in ("MSE", "ε sup", "ε κ", "radius", "worst", "from ε κ", "converged", "settles", "map", "Fig. 1", "D̂"):
        table.add_column(column, justify="right")
    for name, row in result["models"].items():
        radius, figure = row["radius"], row["figure1"]
        cells = [_text(row[key]) for key in ("mse", "eps_sup", "eps_kappa")]
        cells += [_text(radius[key]) for key in ("median", "worst", "predicted")]
        cells += [f"{radius['converged']:.0%}", "" if row["settle_ratio"] is None else f"{row['settle_ratio']:.2f} ×"]
        cells += [
            f"{row['map']['share']:.0%}" if row["map"] else "",
            _text(figure["radius"]),
            f"{figure['D_hat_end']:.3f}",
        ]
        table.add_row(name, *cells)
    return table


def _text(value: float | None) -> str:
    return "∞" if value is None else f"{value:.2e}"
