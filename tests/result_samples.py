"""Results of the stages with made-up numbers, whole enough to be read back; any of them can be changed by key."""

from typing import Any

from npred.lab.config.results.bench import CallTimes
from npred.lab.config.results.evaluate import Evaluated, Scores

ERRORS = {"mse": 1.2e-7, "eps_sup": 0.0184, "eps_kappa": 3.4e-3, "rel_l2": 1e-4}
RADIUS = {"median": 9e-15, "worst": 5.2e-5, "converged": 0.98, "cases": 50, "predicted": None}
MAP = {"D": [0.5, 1.0], "D_hat": [0.3, 0.6, 0.9], "converged": [[True] * 3] * 2, "share": 0.96, "band": None}
END = {"X_end": [0.0], "D_hat_end": None, "radius": 0.0, "settle_time": 3.0}
SCORES = {
    **ERRORS, "kinds": {kind: ERRORS | {"above": 0.1} for kind in ("nominal", "exploring")}, "fresh": ERRORS,
    "in_loop": 2.5e-4, "radius": RADIUS, "settle_time": 3.0, "settle_ratio": 1.02, "decay_rate": None, "map": MAP,
    "figure1": END,
}  # fmt: skip
TRAINED = {"model": "fno", "parameters": 10, "samples": 9, "epochs": 3, "loss": 0.1, "mse": 0.1, "eps_sup": 0.2}
HARDWARE = {"cpu": "A processor with a long name, 2.70 GHz", "cores": 2, "device": "cpu", "threads": 1, "versions": {}}
STOPS = {"per_s": 0.0, "median_us": 0.0, "sentence": "The machine stops."}
BENCHED = {"rows": [], "calls": 20_000, "crossover": [], "stops": STOPS, "hardware": HARDWARE}
CROSSOVER = {
    "plant": "arm", "predictor": "fno", "runtime": "fused", "dx": 0.005, "eps_sup": 0.02, "eps_relative": 0.01,
    "eps_median": 3e-3,
    "network_us": 10.0, "numerical": [{"predictor": "rk4", "steps": 10, "median_us": 5.0, "eps_sup": 0.01,
    "eps_median": 1e-3}, {"predictor": "euler", "steps": 99, "median_us": 9.0, "eps_sup": 0.02, "eps_median": 4e-3}],
    "by_median": [{"predictor": "rk4", "steps": 7, "median_us": 4.0, "eps_sup": 0.03, "eps_median": 2e-3}],
    "best": "rk4", "best_steps": 10, "best_us": 5.0, "network_speedup": 0.5, "f_ns": 80.0,
    "pays_from_ns": 200.0,
}  # fmt: skip


def evaluated(models: dict[str, Any]) -> dict[str, Any]:
    """The JSON of an evaluation of these contenders."""
    return {
        "plant": "activator_repressor", "equilibrium": [0.0], "gain": None, "held_out": 12345,
        "held_out_kind": "nominal", "kinds": {"nominal": {"rows": 12345}, "exploring": {"rows": 100}}, "fresh": 2000,
        "in_loop": {"D": 1.0, "from": 2.0, "to": 5.0, "loops": 3}, "models": models,
        "coverage": {"x": {"data": [0.0, 1.0], "outside": dict.fromkeys(models, 0.0)}},
    }  # fmt: skip


def evaluation(*names: str, **changes: Any) -> Evaluated:
    """An evaluation of these contenders, with changes of all their scores."""
    return Evaluated.of(evaluated(dict.fromkeys(names, SCORES | changes)), "a test")


def scores(**changes: Any) -> Scores:
    """One contender's."""
    return Scores.of(SCORES | changes, "a test")


def timing(predictor: str, runtime: str = "compiled", dx: float = 0.1, us: float = 2.0, **changes: Any) -> CallTimes:
    """A row of the benchmark."""
    row = {
        "batch": 1,
        "matches": None,
        "device": "cpu",
        "copies": None,
        "calls": 10,
        "eps_sup": 0.0184,
        "eps_median": 0.002,
    }
    times = {"median_us": us, "p95_us": us, "p999_us": us, "max_us": us}
    ratios = {"speedup_published": None, "speedup_compiled": 1.5}
    return CallTimes.of(
        {"predictor": predictor, "runtime": runtime, "dx": dx} | row | times | ratios | changes, "a test"
    )
