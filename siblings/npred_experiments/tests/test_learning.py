"""What a network learns of an experiment: exact calls, a training that goes on, and its answers in the loop."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import reproduced

from npred.lab.report.terminal.console import Console
from npred.networks.weights import read
from npred_experiments import learning, loop_networks, network_loop
from npred_experiments.experiment import Place
from npred_experiments.experiment import load as load_experiment
from npred_experiments.regression import Quadratic

TABLE = {"epochs": 3, "width": 4, "modes": 3, "layers": 1, "nodes": 5}


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, dict[str, float]], list]:
    folder = tmp_path_factory.mktemp("network")
    training = learning.LoopTraining("small", "fno", Place(folder, folder / "scratch", Console(quiet=True)))
    return folder, *training.run({"as meant": reproduced.small_loop()}, TABLE)


def test_the_recorded_calls_are_exact_and_those_of_a_rollout_lie_together():
    loop = reproduced.small_loop()
    samples = network_loop.recorded(loop)
    assert [len(array) for array in samples] == [400] * 5
    assert np.all(np.diff(samples.t.reshape(40, 10)) > 0)
    P = loop.numerical()(samples.X.astype(float), samples.u.astype(float), samples.D_hat.astype(float), 0.0)
    assert np.abs(P - samples.P).max() < 1e-5


def test_the_answers_while_recording_are_not_exact():
    loop = replace(reproduced.small_loop(), numerical=lambda: lambda X, u, D, t: np.ones((4, 3, 2)), calls=1, kept=1)
    recorder = network_loop.Recorder(loop, np.random.default_rng(0))
    P = recorder(np.zeros((4, 2)), np.zeros((4, 3, 1)), np.ones(4), 0.0)
    assert np.abs(P - 1).min() > 0
    assert np.all(recorder.samples().P == 1)


def test_a_network_disturbs_runs_by_a_share_of_its_error_and_by_no_more_than_its_first_data_were():
    exact = replace(reproduced.small_loop(), numerical=lambda: lambda X, u, D, t: np.ones((4, 3, 2)), calls=1, kept=1)
    wrong = lambda X, u, D, t: np.full((4, 3, 2), 2.0)
    for noise, spread, largest in ((0.0, 0.02, 0.04), (0.05, 0.02, 0.14), (1.0, 0.0, 1.0)):
        recorder = network_loop.Recorder(replace(exact, noise=noise, spread=spread), np.random.default_rng(0), wrong)
        error = recorder(np.zeros((4, 2)), np.zeros((4, 3, 1)), np.ones(4), 0.0) - 1
        assert np.all((error > min(0.0999, 0.999 * largest)) & (error < largest + 1e-9))
        assert np.all(recorder.samples().P == 1)


def test_a_regression_is_exact_for_products_of_two():
    rng = np.random.default_rng(0)
    X, u = rng.standard_normal((200, 2)), rng.standard_normal((200, 3, 1))
    P = X[:, None] + np.stack([0 * X, X * u[:, 0], X**2 + u[:, 1] - 1], axis=1)
    samples = network_loop.RecordedCalls(X, u, np.ones(200), P, np.zeros(200))
    fitted = Quadratic.of(samples)
    assert fitted.predict(X, u, samples.D_hat, 0.0) == pytest.approx(P, abs=1e-6)
    assert pytest.approx(np.repeat(X[:, None], 3, axis=1), abs=1e-6) == fitted.rest(samples).P


def test_rounds_add_calls_to_what_a_network_learns_from(tmp_path: Path):
    loop = replace(reproduced.small_loop(), rounds=2, quadratic=True)
    training = learning.LoopTraining("small", "fno", Place(tmp_path, tmp_path / "scratch", Console(quiet=True)))
    metrics, (row,) = training.run({"as meant": loop}, TABLE)
    assert row.samples == 0.9 * 3 * 400 + 2 * 400  # two rounds of the regression, then two of the network
    exact = loop.measure(loop.numerical())
    assert metrics["as meant"] == pytest.approx(exact, rel=1e-2)
    assert (tmp_path / "as_meant" / "quadratic.npz").exists()


def test_all_networks_of_a_loop_begin_with_the_same_data():
    loop = replace(reproduced.small_loop(), rounds=1, quadratic=True)
    samples, regression = learning.first_data(loop)
    assert learning.first_data(loop)[0] is samples
    assert regression and len(samples.X) == 2 * 400
    assert len(learning.first_data(replace(loop, rounds=0))[0].X) == 400


def test_the_network_is_saved_and_answers_as_it_did(trained):
    folder, metrics, (row,) = trained
    loop = reproduced.small_loop()
    operator = read(folder / "as_meant", loop.plant(), precision=np.float64).module(loop.plant())
    assert loop.measure(learning.answers(loop, operator)) == pytest.approx(metrics["as meant"], abs=1e-9)
    assert (row.epochs, row.samples, row.parameters) == (3, 360, sum(p.numel() for p in operator.parameters()))


def test_an_end_that_is_read_alone_is_the_same_end(trained):
    loop = reproduced.small_loop()
    operator = read(trained[0] / "as_meant", loop.plant(), precision=np.float64).module(loop.plant())
    X, u, D = np.array([[0.3]]), np.full((1, 21, 1), 0.1), np.array([0.5])
    whole = learning.answers(loop, operator)(X, u, D, 0.0)
    fewer = learning.answers(replace(loop, nodes=5, reads_end=True), operator)(X, u, D, 0.0)
    assert (whole.shape, fewer.shape) == ((1, 21, 1), (1, 5, 1))
    assert fewer[:, 0] == pytest.approx(X)


@pytest.mark.parametrize(
    ("name", "loop"),
    [
        ("unicycle_constant", "as meant"),
        pytest.param("unicycle_constant", "as published", marks=pytest.mark.slow),
        pytest.param("unicycle_time_varying", "as meant", marks=pytest.mark.slow),
        pytest.param("unicycle_time_varying", "as published", marks=pytest.mark.slow),
        pytest.param("unicycle_two_inputs", "as published", marks=pytest.mark.campaign),
        pytest.param("unicycle_two_inputs", "as meant", marks=pytest.mark.campaign),
        pytest.param("chemostat_unknown_delay", "as published", marks=pytest.mark.campaign),
        pytest.param("activator_unknown_delay", "as published", marks=pytest.mark.campaign),
    ],
)
def test_the_loop_for_networks_gives_the_numerical_rows_with_the_numerical_predictor(name: str, loop: str):
    """So what a network's row differs by is the network's."""
    experiment = load_experiment(name)
    rows = {metric: getattr(values, loop.replace(" ", "_")) for metric, values in experiment.measure().items()}
    assert isinstance(experiment.train, loop_networks.LoopNetworks)
    of_networks = experiment.train.loops[loop]
    measured = of_networks.measure(of_networks.numerical())
    for metric, value in measured.items():
        assert value == pytest.approx(rows[metric], rel=1e-6, abs=1e-9)
