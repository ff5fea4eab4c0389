"""Times of predictions and their errors, published and here."""

from dataclasses import replace

import numpy as np
import pytest
import reproduced

from npred import plants
from npred_experiments import experiment, latency
from npred_experiments import rows as experiment_rows
from npred_experiments.experiment import PredictionTime, Reproduced, TrainedForLoop
from npred_experiments.network_loop import recorded
from npred_experiments.regression import Quadratic


@pytest.fixture(scope="module")
def calls() -> latency.PredictorInputs:
    """PredictorInputs with a level u, which is read without an error on any grid."""
    made = latency.PredictorInputs.of(recorded(reproduced.small_loop()))
    return made._replace(u=np.full(made.u.shape, 0.3))


def test_errors_fall_with_the_steps_by_the_order_of_each_method(calls: latency.PredictorInputs):
    methods = {f"{name} {nx}": (name, nx) for name in ("euler", "rk4") for nx in (11, 21)}
    rows = {row.setting: row for row in latency.numerical(plants.resolve("scalar"), calls, methods)}
    for name, order in (("euler", 1), ("rk4", 4)):
        coarse, fine = (rows[f"{name} {nx}"].error or 0.0 for nx in (11, 21))
        assert np.log2(coarse / fine) == pytest.approx(order, abs=0.5)
    assert all(row.ms and row.predictor == experiment.NUMERICAL for row in rows.values())


def test_a_regression_is_in_the_time_of_its_network(calls: latency.PredictorInputs, monkeypatch: pytest.MonkeyPatch):
    asked = []
    samples = recorded(reproduced.small_loop())
    rest = Quadratic.of(samples)
    monkeypatch.setattr(Quadratic, "__call__", lambda self, X, u: asked.append(X.shape) or np.zeros((1, u.shape[1], 1)))
    assert latency.milliseconds(reproduced.numerical(), calls, rest) > 0
    assert set(asked) == {(1, 1)}


def test_published_times_stand_beside_those_taken_here(monkeypatch: pytest.MonkeyPatch):
    printed = (
        *experiment.published_times("Euler, 5 steps", numerical=10.0, fno=2.0),
        *experiment.published_times("Euler, 100 steps", numerical=200.0, fno=3.0),
    )
    monkeypatch.setattr(experiment_rows, "load", lambda name: replace(REAL, times=printed))
    trained = TrainedForLoop(network="fno", loop=experiment.AS_MEANT, parameters=1, samples=1, epochs=1, loss=1.0,
                             mse=1.0, eps_sup=0.5, seconds=1.0, ms=0.25)  # fmt: skip
    here = [
        PredictionTime(predictor=experiment.NUMERICAL, setting=setting, ms=0.1, error=0.2)
        for setting in ("Euler, 5 steps", "RK4, 5 steps")
    ]
    parts = [Reproduced(name="x", rows=[], times=here), Reproduced(name="x", rows=[], trained=[trained])]
    rows = {(each.predictor, each.setting): each for each in experiment_rows.joined(parts, networks=True).times}
    shown = {key: (each.published_ms, each.ms, each.error) for key, each in rows.items()}
    assert shown == {
        ("numerical", "Euler, 5 steps"): (10.0, 0.1, 0.2),
        ("fno", "Euler, 5 steps"): (2.0, 0.25, 0.5),
        ("numerical", "Euler, 100 steps"): (200.0, None, None),
        ("fno", "Euler, 100 steps"): (3.0, None, None),
        ("numerical", "RK4, 5 steps"): (None, 0.1, 0.2),
    }
    assert "200" in experiment_rows.times_table([Reproduced(name="x", rows=[], times=list(rows.values()))])


REAL = experiment.load("unicycle_constant")


def test_a_time_is_the_median_of_the_calls_in_milliseconds(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(
        latency.timing, "sample", lambda calls, *limits: dict.fromkeys(calls, np.array([1, 2, 9]) * 1e6)
    )
    assert latency.median_of(lambda: None) == pytest.approx(2.0)
