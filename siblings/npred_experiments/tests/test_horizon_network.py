"""The network for ρ = φ⁻¹: what it learns from, and that a little training brings it nearer."""

from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import brentq
from silent import Silent

from npred.lab.report.terminal.console import Console
from npred.lab.training.operators import Operator
from npred_experiments import horizon_network, horizons, prediction_horizons
from npred_experiments.experiment import TrainedForLoop


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory) -> tuple[Operator, TrainedForLoop, Path]:
    folder = tmp_path_factory.mktemp("network")
    return *horizon_network.trained(folder, folder / "scratch", Console(quiet=True), epochs=1), folder


def test_its_data_are_the_roots_of_the_drawn_delays():
    calls = horizon_network.samples(3)
    inside = horizon_network.NODE_TIMES[: horizon_network.INSIDE]
    assert calls.u.shape == (3, 131, 1) and calls.P.shape == (3, 121, 1) and inside[-1] == pytest.approx(12.0)
    for u, P in zip(calls.u[..., 0], calls.P[..., 0], strict=True):
        delay = np.interp(inside + P, horizon_network.NODE_TIMES, u)  # the delay when the command acts is the horizon
        assert np.abs(delay - P).max() < 0.02  # the data's grid is coarse


def test_the_table_has_the_roots_also_where_commands_nearly_overtake_each_other():
    steep = (0.3, 0.2, 0.27, 3.6, 1.0)
    fine = np.linspace(0.0, 13.0, 100_001)
    assert 0 < horizons.rate(steep, fine).min() < 0.05
    t = np.linspace(0.0, 12.0, 25)
    roots = [brentq(lambda rho, s=s: horizons.late(steep, rho) - s, 0.0, 15.0, xtol=1e-13) for s in t]
    assert horizons.tabulated(steep, t) == pytest.approx(np.array(roots), abs=1e-6)


def test_one_epoch_is_nearer_than_the_delay_itself(trained: tuple[Operator, TrainedForLoop, Path]):
    operator, row, folder = trained
    delay, t = horizons.draws()[0], prediction_horizons.times()
    untrained = prediction_horizons.missed(delay, t + (t - horizons.late(delay, t)))
    assert prediction_horizons.missed(delay, horizon_network.inverse(operator, delay, t)) < 0.5 * untrained
    assert (row.samples, row.epochs) == (2000, 1) and row.parameters == sum(p.numel() for p in operator.parameters())
    assert (folder / "horizons.safetensors").exists()


def test_a_training_goes_on_from_its_checkpoint(trained: tuple[Operator, TrainedForLoop, Path], tmp_path: Path):
    progress = Silent()
    _, resumed = horizon_network.trained(tmp_path, trained[-1] / "scratch", progress, epochs=2)
    assert progress.notes[0] == "horizons fno: resuming at epoch 2 of 2"
    assert resumed.epochs == 2 and resumed.loss < trained[1].loss
