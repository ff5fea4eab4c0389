"""The input before t = 0: its default, what is refused, and what the loops and the keys make of it."""

from pathlib import Path

import numpy as np
import pytest
from conftest import settings_of
from jobs import job
from reactor import Reactor
from scipy.integrate import solve_ivp

from npred import plants
from npred.base.errors import ConfigError, DivergedError
from npred.lab import config
from npred.lab.scheduler import pipeline_fit
from npred.lab.scheduler.plan import nodes
from npred.lab.stages.generate import generate
from npred.lab.training.data.dataset import Dataset
from npred.loop.closed_loop import simulate
from npred.plants import Plant, inputs
from npred.prediction.methods import RK4

REACTOR, SCALAR = Plant("reactor", Reactor), plants.resolve("scalar")
NAME = f"{Path(__file__).parents[1] / 'reactor.py'}:Reactor"
LOOPS = {
    "samples": 60, "rollouts": 20, "D": 12.0, "D_hat": [[7.0, 17.0]], "bounds": [1.0, 25.0], "gamma": 1.0, "dt": 0.5,
    "t_end": 300.0, "nx": 41,
}  # fmt: skip


def pipeline(stage="generate", plant=NAME, **keys):
    return config.parse({"plant": plant, stage: keys}, "tests")


def test_the_default_is_the_input_at_rest_else_zero_where_the_bounds_allow_it():
    limits = inputs.bounds(SCALAR, None)
    np.testing.assert_array_equal(inputs.before(SCALAR, None, limits, np.zeros((3, 1))), np.zeros((3, 1)))
    held = inputs.before(REACTOR, None, inputs.bounds(REACTOR, None), np.array([[0.5, 340.0], [0.4, 350.0]]))
    np.testing.assert_allclose(held, [[300.0], [300.0]], atol=1e-3)
    for bounds, u0 in (((-1.0, 350.0), 300.0), ((-1.0, 250.0), 0.0)):  # a rest out of reach is none
        found = inputs.before(REACTOR, None, inputs.bounds(REACTOR, [bounds]), np.zeros((1, 2)))
        np.testing.assert_allclose(found, [[u0]], atol=1e-3)


def test_the_law_holds_kappa_of_each_start_within_the_bounds():
    X0 = np.array([[0.5, 345.0], [0.5, 355.0], [0.5, 330.0]])
    held = inputs.before(REACTOR, "law", inputs.bounds(REACTOR, None), X0)
    np.testing.assert_allclose(held[:, 0], [325.0, 275.0, 350.0])


@pytest.mark.parametrize(
    ("u0", "held"), [(None, 300.0), ("equilibrium", 300.0), ("law", 325.0), (310.0, 310.0), ([260], 260.0)]
)
def test_the_plant_gets_it_for_the_length_of_the_delay(u0, held):
    loop = simulate(REACTOR, RK4(REACTOR, 11), D=12.0, D_hat=12.0, X0=[0.5, 345.0], t_end=12.0, dt=0.5, u0=u0)
    wanted = solve_ivp(lambda t, X: REACTOR.f(X, np.array([held])), (0, 12), [0.5, 345.0], rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(loop.X[-1], wanted.y[:, -1], rtol=1e-4)


@pytest.mark.parametrize(
    ("u0", "words"),
    [
        (0.0, r"u0: expected within input_bounds \[\[250.0, 350.0\]\], got Tc = 0; give u0"),
        (351.0, "got Tc = 351"),
        ([300.0, 300.0], r"u0: expected a finite number per input \(Tc\)"),
        (float("nan"), "a finite number per input"),
        ("kappa", "u0: expected numbers or one of equilibrium, law, got 'kappa'"),
    ],
)
def test_what_the_plant_does_not_accept_is_refused(u0, words):
    with pytest.raises(ConfigError, match=words):
        simulate(REACTOR, None, D=1.0, D_hat=1.0, X0=[0.5, 350.0], t_end=1.0, u0=u0)


def test_an_equilibrium_is_needed_where_one_is_asked_for():
    class Drifts:
        states, inputs, box = ("x",), ("u",), {"x": (0.0, 1.0)}
        f = lambda x, u, t, p, M: [u.u]
        kappa = lambda x, t, p, M: [M.sin(t) - x.x]

    with pytest.raises(ConfigError, match=r"u0: expected a rest to take it from, got: .*or give u0 as numbers"):
        inputs.before(Plant("drifts", Drifts), "equilibrium", np.array([[-1.0, 1.0]]), np.zeros((1, 1)))
    beyond = np.array([[310.0, 320.0]])
    with pytest.raises(ConfigError, match="got that of the rest, Tc = 300"):
        inputs.before(REACTOR, None, beyond, np.zeros((1, 2)))


@pytest.mark.parametrize("stage", ["generate", "evaluate"])
def test_a_pipeline_that_asks_for_what_is_refused_does_not_start(stage):
    more = {"X0": [0.5, 350.0]} if stage == "evaluate" else {}
    with pytest.raises(ConfigError, match=rf"{stage}.u0: expected within input_bounds .*got Tc = 0"):
        pipeline_fit.require(REACTOR, pipeline(stage, u0=0.0, **more), [stage])
    pipeline_fit.require(REACTOR, pipeline(stage, u0=[280], **more), [stage])


def test_a_reactor_runs_from_its_own_file_and_zero_kelvin_does_not(tmp_path):
    made = job(tmp_path, "reactor", plant=NAME, generate=LOOPS)
    generate.run(made)
    data = Dataset.read(made.folder / "data.h5")
    assert data.u.min() > 249.999 and 330 < data.X[:, 1].min() < data.X[:, 1].max() < 430
    cold = LOOPS | {"input_bounds": [[-1.0, 350.0]], "u0": 0.0}
    with pytest.raises(DivergedError, match=r"or set u0, the input before t = 0 \(here Tc = 0\)"):
        generate.run(job(tmp_path, "cold", plant=NAME, generate=cold))
    hot = job(tmp_path, "hot", plant=NAME, generate=LOOPS | {"u0": "law", "t_end": 4.0, "samples": 160})
    generate.run(hot)
    rows = Dataset.read(hot.folder / "data.h5")
    first = rows.t == 0
    np.testing.assert_allclose(rows.u[first][:, 0, 0], np.clip(REACTOR.kappa(rows.X[first])[:, 0], 250, 350), rtol=1e-6)


def asked(u0, plant="scalar", **more):
    loops = pipeline(plant=plant, **({} if u0 is None else {"u0": u0}), **more)
    return [settings_of(node, loops) for node in nodes(loops, ["generate", "evaluate", "report"])]


def test_the_input_before_the_start_enters_the_keys_as_it_is_written():
    for u0 in (None, 0.0, [0.0], 2.0, "law"):
        data, *_, page = asked(u0)
        assert data["generate"]["u0"] == page["pipeline"]["generate"]["u0"] == u0


ROWS = 60  # over the delay of the histories below


def wave(t):
    return 0.7 * np.sin(3 * t)


def table(D):
    """The mean of the wave over equal parts of [-D, 0]."""
    edges = np.linspace(-D, 0, ROWS + 1)
    return (-0.7 / 3 * np.diff(np.cos(3 * edges)) * ROWS / D)[:, None]


@pytest.mark.parametrize("D", [0.6, 0.9])
def test_a_history_drives_the_plant_until_the_first_command_arrives(D):
    """Against SciPy; 0.9 s is no whole number of a table's rows per control step."""
    exact = solve_ivp(lambda t, X: 0.5 * X + wave(t - D), (0, D), [0.4], rtol=1e-10, atol=1e-12).y[0, -1]
    for u0 in (table(D), lambda t: [wave(t)]):
        loop = simulate(SCALAR, RK4(SCALAR, 201), D=D, D_hat=D, X0=[0.4], t_end=1.0, dt=0.01, u0=u0)
        assert loop.X[round(D / 0.01), 0] == pytest.approx(exact, abs=5e-5)
        assert loop.P[0, 0] == pytest.approx(exact, abs=5e-5)


def test_a_table_extends_over_each_loops_own_delay():
    D = np.array([0.3, 0.6])
    loops = simulate(SCALAR, None, D=D, D_hat=D, X0=[[0.0]] * 2, t_end=0.6, dt=0.01, u0=[[1.0], [-1.0]])
    for delay, X in zip(D, loops.X[:, :, 0], strict=True):
        turn = X[round(delay / 2 / 0.01)]
        assert turn == pytest.approx(2 * np.expm1(0.5 * delay / 2), rel=1e-9)
        assert X[round(delay / 0.01)] == pytest.approx((turn - 2) * np.exp(0.5 * delay / 2) + 2, rel=1e-9)
        assert X.argmax() == round(delay / 2 / 0.01)


def test_a_history_before_its_first_row_goes_on():
    past = inputs.past(SCALAR, [[1.0], [3.0]], inputs.bounds(SCALAR, None), np.zeros((1, 1)), np.array([0.4]))
    np.testing.assert_allclose(past.steps(8, 0.1)[:, 0, 0], [1, 1, 1, 1, 1, 1, 3, 3])
    np.testing.assert_allclose(past.steps(2, 0.3)[:, 0, 0], [1.0, (1.0 + 2 * 3.0) / 3], rtol=1e-12)


@pytest.mark.parametrize(
    ("u0", "words"),
    [
        ([[300.0], [351.0]], "got Tc = 351"),
        ([[300.0, 300.0]], "a finite number per input"),
        (lambda t: [300.0, 300.0], r"u0\(-\d.*\): expected 1 finite numbers, one per input"),
        (lambda t: 351.0, r"u0\(-\d.*\): expected within input_bounds"),
    ],
)
def test_a_history_that_the_plant_does_not_accept_is_refused(u0, words):
    with pytest.raises(ConfigError, match=words):
        simulate(REACTOR, None, D=1.0, D_hat=1.0, X0=[0.5, 350.0], t_end=1.0, u0=u0)


def test_a_pipeline_names_a_history_by_its_rows():
    rows = [[300.0], [310.0], [320.0]]
    asked = pipeline(**LOOPS, u0=rows)
    assert inputs.configured(REACTOR, asked.generate.u0, asked.generate.input_bounds, "generate").tolist() == rows
    assert inputs.sentence(REACTOR, rows, inputs.bounds(REACTOR, None)) == "a history of 3 rows"
    answers = {answer.check: answer.verdict for answer in pipeline_fit.check(REACTOR, asked)}
    assert answers["completeness"] == "yes"
