"""The evaluate stage: errors on held-out rollouts, and what closed loops make of them."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from npred import metrics, operators, randomness
from npred.adaptation import DelayAdaptation
from npred.closed_loop import Trajectories, simulate
from npred.config import Evaluate
from npred.dataset import Dataset
from npred.errors import ConfigError
from npred.plants import Plant
from npred.predictors import METHODS, Predictor
from npred.stages import Job, figure1

EVERY = 10  # control steps between two kept states
EXACT = {"mse": 0.0, "eps_sup": 0.0, "eps_kappa": 0.0, "rel_l2": 0.0}  # the numerical predictor is the reference


@dataclass(frozen=True)
class Contender:
    """A predictor in the comparison; without adaptation its D_hat stays at D_hat(0)."""

    name: str
    predictor: Predictor
    adapts: bool = True


def run(job: Job) -> dict[str, Any]:
    """For the numerical predictor, without adaptation, and each network and snapshot: errors, cases, Fig. 1's loop.

    Writes figure1.svg, figure1.png and figure1.h5 (the loops). Raises ConfigError for a plant without rest.
    """
    if not job.plant.rests:
        raise ConfigError(
            f"evaluate: expected a plant with an equilibrium, {job.plant.name} has none; radius needs one"
        )
    config, test = job.config.evaluate, Dataset.read(job.inputs["generate"] / "data.h5").subset(test=True)
    X0, D_hat0 = cases(job.config.seed, config, job.plant)
    contenders = _contenders(job)
    results, loops = {}, {}
    with job.progress.bar("evaluate", len(contenders) * len(X0) * _steps(config), "steps") as bar:
        for contender in contenders:
            errors = _errors(job.plant, contender, test)
            run = _loops(job.plant, contender, config, X0, D_hat0, bar.advance)
            results[contender.name] = _summarise(job.plant, config, run, errors)
            loops[contender.name] = run
    figure1.draw(job.folder, job.plant, config, loops)
    return {"plant": job.plant.name, "equilibrium": job.plant.equilibrium.tolist(), "gain": metrics.gain(job.plant),
            "held_out": len(test), "models": results}  # fmt: skip


def cases(seed: int, config: Evaluate, plant: Plant) -> tuple[np.ndarray, np.ndarray]:
    """X0 (1 + cases, n) and D_hat(0) (1 + cases,): the case of Fig. 1, then random states of the box x case_D_hat0."""
    rng = randomness.generator(seed, "evaluate", "cases")
    box = np.array([plant.box[name] for name in plant.states])
    states = rng.uniform(box[:, 0], box[:, 1], (config.case_states, plant.n))
    X0 = np.concatenate([[config.X0], np.repeat(states, len(config.case_D_hat0), axis=0)])
    return X0, np.concatenate([[config.D_hat0], np.tile(config.case_D_hat0, config.case_states)])


def _contenders(job: Job) -> list[Contender]:
    config = job.config.evaluate
    numerical = METHODS[config.predictor](job.plant, config.nx)
    found = [Contender("numerical", numerical), Contender("no_adaptation", numerical, adapts=False)]
    for model in sorted(set(job.config.train.models)):
        for snapshot in [*getattr(job.config.train, model).snapshots, None]:
            name = model if snapshot is None else f"{model}@{snapshot}"
            found.append(Contender(name, _neural(job, model, snapshot, name)))
    return found


def _neural(job: Job, model: str, snapshot: int | None, name: str) -> Predictor:
    from npred.predictors.neural import Neural  # brings torch

    operator = operators.load(job.inputs[model], job.plant, snapshot)
    return Neural(job.plant, operator, job.config.evaluate.nx, job.device, name)


def _errors(plant: Plant, contender: Contender, test: Dataset) -> dict[str, Any]:
    if contender.name in ("numerical", "no_adaptation"):
        return dict(EXACT)
    P_hat = np.concatenate([contender.predictor(test.X[i], test.u[i], test.D_hat[i]) for i in _blocks(len(test))])
    return metrics.errors(plant, P_hat, test.P)


def _blocks(count: int, size: int = 1024) -> list[slice]:
    return [slice(i, i + size) for i in range(0, count, size)]


def _loops(
    plant: Plant, contender: Contender, config: Evaluate, X0: np.ndarray, D_hat0: np.ndarray, progress: Any
) -> Trajectories:
    law = DelayAdaptation(config.gamma, config.b, config.bounds) if contender.adapts else None
    return simulate(
        plant, contender.predictor, D=config.D, D_hat=D_hat0, X0=X0, t_end=config.case_t_end, dt=config.dt,
        adaptation=law, input_bounds=config.input_bounds, every=EVERY, progress=progress,
    )  # fmt: skip


def _summarise(plant: Plant, config: Evaluate, loops: Trajectories, errors: dict[str, Any]) -> dict[str, Any]:
    X_star = plant.equilibrium
    radii, settle = metrics.radius(loops, X_star)[1:], metrics.settle_time(loops, X_star)[1:]
    return {
        **errors,
        "radius": {
            "median": metrics.number(np.median(radii)),
            "worst": metrics.number(radii.max()),
            "converged": float(metrics.converged(radii, X_star).mean()),
            "cases": len(radii),
            "predicted": metrics.gain(plant) * errors["eps_kappa"],
        },
        "settle_time": metrics.number(np.median(settle)),
        "figure1": figure1.numbers(plant, config, loops),
    }


def summary(result: dict[str, Any]) -> Any:
    """The contenders as a table."""
    from rich.table import Table

    table = Table(title=f"{result['plant']}: held-out errors of {result['held_out']} samples, and closed loops")
    for column in (
        "predictor",
        "MSE",
        "ε sup",
        "ε κ",
        "radius: median",
        "worst",
        "from ε κ",
        "converged",
        "Fig. 1 radius",
        "D̂ end",
    ):
        table.add_column(column, justify="left" if column == "predictor" else "right")
    for name, row in result["models"].items():
        radius, figure = row["radius"], row["figure1"]
        errors = [f"{row[key]:.2e}" for key in ("mse", "eps_sup", "eps_kappa")]
        radii = [_text(radius[key]) for key in ("median", "worst", "predicted")]
        ends = [f"{radius['converged']:.0%}", _text(figure["radius"]), f"{figure['D_hat_end']:.3f}"]
        table.add_row(name, *errors, *radii, *ends)
    return table


def _text(value: float | None) -> str:
    return "∞" if value is None else f"{value:.2e}"


def _steps(config: Evaluate) -> int:
    return round(config.case_t_end / config.dt) + 1
