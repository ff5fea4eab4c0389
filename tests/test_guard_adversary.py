"""The adversary of benchmarks/guard_adversary.py: its reference, and that it finds a guard's blind spot."""

from types import SimpleNamespace

import guard_adversary as adversary
import numpy as np
import pytest
from input_histories import means

import npred
from npred.base import grid
from npred.guard.guarded import Guarded
from npred.lab.training.data.dataset import Dataset
from npred.loop import metrics
from npred.networks.domain import Domain
from npred.prediction.methods import RK4

PLANT, NX = npred.plant("activator_repressor"), 21
BLIND = 1.2  # s: for a delay above it the guard sees nothing of the error
TOLERANCE = 0.02


class Wrong(RK4):
    """RK4 with an error of U that grows with D_hat."""

    def predict(self, X, u, D_hat, t):
        return super().predict(X, u, D_hat, t) * (1 + 0.2 * D_hat[:, None, None] * np.array([1.0, -1.0]))


class Blind(Guarded):
    """A guard that sees no error where the delay is above BLIND."""

    def judge(self, P_hat, X, u, D_hat, t=0.0):
        error, fallback = super().judge(P_hat, X, u, D_hat, t)
        return np.where(D_hat > BLIND, 0.0, error), np.where(D_hat > BLIND, self.beyond(X, u, D_hat, t) > 1, fallback)


def calls(plant, count, seed=0, nx=NX):
    """Inputs from the plant's box, u smooth and positive."""
    rng, x = np.random.default_rng(seed), np.linspace(0.0, 1.0, nx)
    low, high = np.array([plant.box[name] for name in plant.states]).T
    a, b = rng.uniform(0.0, 0.5, (2, count, 1))
    u = (0.3 + a * np.cos(2 * x + b))[..., None]
    u = np.repeat(u, plant.m, axis=2)
    X, D_hat = rng.uniform(low, high, (count, plant.n)), rng.uniform(0.5, 1.5, count)
    return adversary.Calls(X, u, D_hat, rng.uniform(0.0, 2.0, count))


def cubic(x):
    """A u of which the adversary's cubic reading makes no error, (..., 1)."""
    return 0.3 + 0.5 * x[..., None] ** 3


@pytest.mark.parametrize("name", sorted(adversary.SYSTEMS))
def test_its_plants_are_those_of_npred(name):
    plant, system = npred.plant(name), adversary.SYSTEMS[name]
    X, u, _, t = calls(plant, 50)
    np.testing.assert_allclose(np.array(system.f(X.T, u[:, 0].T)).T, plant.f(X, u[:, 0]), rtol=1e-12, atol=1e-11)
    np.testing.assert_allclose(np.array(system.kappa(X.T, t)).T, plant.kappa(X, t), rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(system.ratios, plant.ratios)


def test_its_readings_are_lines_cubics_constants_around_the_nodes_and_npred_s():
    rng = np.random.default_rng(0)
    u, r = rng.standard_normal((NX, 1)), np.linspace(0.0, 0.5, 5)
    begin, end = grid.lines(u)
    for cell in range(NX - 1):
        for half in (0.0, 0.5):
            x = (cell + half + r) / (NX - 1)
            line, cubic, constant, means = (
                adversary.weights(reading, NX, cell + half + r, cell + half + 0.25) @ adversary.values(u)
                for reading in adversary.READINGS
            )
            np.testing.assert_allclose(line[:, 0], np.interp(x, grid.nodes(NX), u[:, 0]), atol=1e-13)
            np.testing.assert_allclose(cubic, grid.read(u, x), atol=1e-12)
            np.testing.assert_array_equal(constant, np.full((5, 1), u[cell + (half > 0), 0]))
            np.testing.assert_allclose(means, begin[cell] + (half + r[:, None]) * (end - begin)[cell], atol=1e-13)


def test_an_error_is_the_largest_component_s_by_the_reading_that_is_kindest():
    U, exact = np.array([[1.0], [2.0]]), np.array([[[1.5], [2.1]], [[1.2], [2.3]], [[1.0], [3.0]]])
    np.testing.assert_allclose(adversary.gap(U, exact), [0.3])


@pytest.mark.parametrize("name", sorted(adversary.SYSTEMS))
def test_its_search_s_reference_is_of_order_4_and_its_limit_is_dop853_s(name):
    """Also where u jumps at a node, for each reading."""
    system, inputs = adversary.SYSTEMS[name], calls(npred.plant(name), 3)
    inputs.u[:, NX // 3 :] += 0.4
    exact = np.stack([adversary.by_dop853(system, *call) for call in zip(*inputs, strict=True)], axis=-1)
    steps = [4, 8, 16]
    errors = np.array([np.abs(adversary.by_rk4(system, inputs, k) - exact).max(axis=(1, 2)) for k in steps])
    assert (errors[-1] < 1e-6).all()
    for reading in range(len(adversary.READINGS)):
        assert -np.polyfit(np.log(steps), np.log(errors[:, reading]), 1)[0] == pytest.approx(4.0, abs=0.4)


def test_dop853_s_tolerance_is_kept_on_long_cells():
    """x' = u - x with u = 1 has x = 1 + (X - 1) exp(-D_hat) at the end."""
    system = adversary.System(lambda x, u: [u[0] - x[0]], lambda x, t: [x[0]])
    exact = 1 + 2 * np.exp(-8.0)
    np.testing.assert_allclose(
        adversary.by_dop853(system, np.array([3.0]), np.ones((2, 1)), 8.0, 0.0), exact, rtol=1e-11
    )


def test_a_delay_of_each_input_is_npred_s_too():
    """kappa acts where the history of an input has ended: RK4 of npred on many nodes comes to the cubic reading."""
    plant, inputs = npred.plant("unicycle"), calls(npred.plant("unicycle"), 3)
    system = adversary.SYSTEMS["unicycle"]
    inputs.u[:] = cubic(grid.nodes(NX))
    exact = np.stack([adversary.by_dop853(system, *call)[1] for call in zip(*inputs, strict=True)])
    errors = []
    for count in (120, 240):
        P = RK4(plant, count + 1)(inputs.X, means(cubic, count + 1) + 0 * inputs.u[:, :1], inputs.D_hat, inputs.t)
        errors.append(np.abs(metrics.law(plant, P, inputs.t, inputs.D_hat) - exact).max())
    assert errors[1] < errors[0] / 3.5 and errors[1] < 1e-5  # of order 2: each input has a delay of its own


def test_npred_s_own_rk4_comes_to_the_cubic_reading():
    """RK4 from the means of a cubic, which are read to order 3."""
    system, inputs = adversary.SYSTEMS[PLANT.name], calls(PLANT, 3)
    inputs.u[:] = cubic(grid.nodes(NX))
    exact = np.stack([adversary.by_dop853(system, *call)[1] for call in zip(*inputs, strict=True)])
    counts, errors = [40, 80, 160], []
    for count in counts:
        P = RK4(PLANT, count + 1)(inputs.X, means(cubic, count + 1) + 0 * inputs.u[:, :1], inputs.D_hat)
        errors.append(np.abs(PLANT.kappa(P[:, -1], 0.0) - exact).max())
    assert -np.polyfit(np.log(counts), np.log(errors), 1)[0] > 2.8
    assert errors[-1] < 1e-6


@pytest.fixture(scope="module")
def data():
    X, u, D_hat, _ = calls(PLANT, 80, seed=4)
    P = RK4(PLANT, NX)(X, u, D_hat)
    return Dataset(X, u, D_hat, P, D_hat, 0 * D_hat, np.arange(len(X)), np.zeros(len(X), dtype=bool))


def guard(kind, model, data):
    """A guard of that kind that knows where the data were."""
    model.operator = SimpleNamespace(domain=Domain.of_parts(lambda: [data], data.X.std(axis=0), PLANT.phase))
    return kind(model, TOLERANCE)


def searched(kind, model, data, monkeypatch, states="box"):
    monkeypatch.setattr(adversary, "CHAINS", 60)
    monkeypatch.setattr(adversary, "MOVES", 15)
    search = adversary.Search(guard(kind, model, data), adversary.SYSTEMS[PLANT.name], data, states, seed=1)
    search.run(seconds=60.0, calls=3000)
    return search


@pytest.mark.parametrize("states", adversary.STATES)
def test_it_finds_the_blind_spot(data, monkeypatch, states):
    search = searched(Blind, Wrong(PLANT, NX), data, monkeypatch, states)
    assert search.above > 100 and search.made >= 3000
    assert (search.ranges.calls(search.worst[:, :-3]).D_hat > BLIND).all()
    errors, exact = search.confirmed()
    np.testing.assert_allclose(errors, exact, rtol=1e-4)
    assert exact.min() > TOLERANCE and exact[0] == pytest.approx(search.largest, rel=1e-4)


def test_recombined_calls_take_each_input_from_a_row_of_its_own(data):
    search = adversary.Search(guard(Blind, Wrong(PLANT, NX), data), adversary.SYSTEMS[PLANT.name], data, "data", 1)
    rows = np.random.default_rng(2).integers(0, len(data), (4, 30))
    made = search.ranges.calls(search.ranges.of_rows(data, *rows))
    for name, taken in zip(("X", "u", "D_hat"), rows, strict=False):
        np.testing.assert_allclose(getattr(made, name), getattr(data, name)[taken], rtol=1e-12)


def test_of_a_numerical_predictor_it_finds_nothing(data, monkeypatch):
    search = searched(Guarded, RK4(PLANT, NX), data, monkeypatch)
    assert search.passed > 300
    assert search.above == 0 and search.largest < TOLERANCE / 5


def test_the_script_prints_a_row(data, monkeypatch, capsys):
    model = guard(Guarded, Wrong(PLANT, NX), data).model
    monkeypatch.setattr(adversary.harness, "network", lambda _: model)
    monkeypatch.setattr(adversary.harness, "samples", lambda *_: data)
    monkeypatch.setattr("sys.argv", ["guard_adversary.py", "--nx", str(NX), "--seconds", "0.1"])
    adversary.main()
    head, rule, row = capsys.readouterr().out.splitlines()
    assert head.count("|") == rule.count("|") == row.count("|")
    assert row.startswith(f"| `paper.toml:deeponet`, {NX} | box | ")
