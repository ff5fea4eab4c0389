"""`npred tune`: its cost and its choice against closed forms, and what it says where there is nothing to gain."""

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.optimize import minimize_scalar
from typer.testing import CliRunner, Result

from npred import plants
from npred.base.errors import ConfigError
from npred.cli import app
from npred.lab import config
from npred.lab.config import Pipeline
from npred.lab.config.results import Tuned
from npred.lab.report.terminal.console import Console
from npred.lab.stages.tuning import Loops, Settling, Yardstick, compared, gains, tune

PLANT = """
class Line:
    states, inputs, guess, box = ("x",), ("q",), (0.0,), {"x": (0.5, 2.0)}
    parameters = {"a": 0.5, "k": 1.0, "aim": 0.0}

    def f(x, u, t, p, M):
        return [p.a * x.x + u.q]

    def kappa(x, t, p, M):
        return [-(p.a + p.k) * x.x + p.aim]

    def V(x, t, p, M):
        return x.x**2
"""
LIMITED = (
    PLANT.replace("{", "{{").replace("}", "}}")
    + """
    def safe(x, t, p, M):
        return [{}]
"""
)
A, D, T = 0.5, 0.4, 12.0
TABLES: dict[str, Any] = {
    "plant": "line.py:Line",
    "evaluate": {
        "adaptation": "frozen", "D": D, "D_hat": D, "case_D_hat": [D], "X0": [1.0], "t_end": T, "case_t_end": T,
        "dt": 0.002, "nx": 11,
    },
    "tune": {"free": ["k"], "bounds": {"k": [0.5, 6.0]}, "starts": 4, "held_out": 6, "evaluations": 60},
}  # fmt: skip


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "line.py").write_text(PLANT)
    return tmp_path


def pipeline(**tables: Any) -> Pipeline:
    merged = {key: value | tables.get(key, {}) if isinstance(value, dict) else value for key, value in TABLES.items()}
    return config.parse(merged | {key: value for key, value in tables.items() if key not in merged}, "line.toml")


def tuned(chosen: Pipeline, **more: Any) -> Tuned:
    return tune(chosen, plants.resolve(chosen.plant, chosen.parameters), **more)


def exact(X0: np.ndarray, k: float) -> tuple[np.ndarray, np.ndarray]:
    """Settling time and integral of U² in closed form: X(D) = X0 exp(a D), U(t) = -(a + k) X(t + D), then X' = -rate X.

    rate is k, and a little more since U is held for steps of .002 s.
    """
    X_D, rate = np.abs(X0) * np.exp(A * D), k * (1 + (A + k) * 0.002 / 2)
    return D + np.log(X_D / 0.01) / rate, ((A + k) * X_D) ** 2 * (1 - np.exp(-2 * rate * T)) / (2 * rate)


def starts(chosen: Pipeline, purpose: str, states: int) -> np.ndarray:
    return Loops(chosen, plants.resolve(chosen.plant), states, purpose).conditions[0].X0[:, 0]


@pytest.mark.parametrize("k", [0.8, 3.0])
def test_times_and_efforts_are_those_of_the_closed_form(k: float):
    chosen = pipeline(evaluate={"nx": 41})
    loops = Loops(chosen, plants.resolve(chosen.plant), 5, "training")
    outcome = loops.run({"k": k}, lambda steps: None)
    time, effort = exact(starts(chosen, "training", 5), k)
    assert outcome.time[:, 0] == pytest.approx(time, abs=0.006)
    assert outcome.effort[:, 0] == pytest.approx(effort, rel=5e-4) and outcome.settled.all()


def test_the_search_ends_at_the_least_cost_of_the_closed_form():
    chosen = pipeline(tune={"effort": 1.0})
    result = tuned(chosen)
    X0 = starts(chosen, "training", 4)
    time, effort = (part.mean() for part in exact(X0, 1.0))

    def cost(k: float) -> float:
        times, efforts = exact(X0, k)
        return float(np.mean(times / time + efforts / (efforts + effort)))

    best: Any = minimize_scalar(cost, bounds=(0.5, 6.0), method="bounded", options={"xatol": 1e-6})
    assert 0.6 < best.x < 5.9  # inside the range
    assert cost(result.numbers[0].after) == pytest.approx(best.fun, rel=2e-3)
    assert result.training.cost.after == pytest.approx(best.fun, rel=5e-3)


def test_a_better_gain_is_judged_on_other_starts():
    chosen = pipeline()
    result = tuned(chosen)
    cost = result.held_out.cost
    assert result.gained and cost.gain and cost.gain > 0.5 and cost.interval
    assert cost.interval[0] <= cost.gain <= cost.interval[1]
    assert result.numbers[0].before == 1.0 and result.held_out.loops == 6 and result.evaluations <= 60
    assert not set(starts(chosen, "training", 4)) & set(starts(chosen, "held out", 6))
    X0 = starts(chosen, "held out", 6)
    before, after = (exact(X0, k)[0].mean() for k in (1.0, result.numbers[0].after))
    time, effort, peak = result.held_out.settle_time, result.held_out.effort, result.held_out.peak
    assert (time.before, time.after) == pytest.approx((before, after), abs=0.012)
    assert peak.after == pytest.approx((X0 * np.exp(A * D)).mean(), rel=2e-3) and f"{time.gain:.1%}" in result.sentence
    assert effort.after == pytest.approx(exact(X0, result.numbers[0].after)[1].mean(), rel=1e-3)
    assert effort.falls is False and effort.change().startswith("rises by") and effort.change() in result.sentence


def test_nothing_to_gain_is_said_where_the_best_is_there_already():
    result = tuned(pipeline(parameters={"k": 3.0}, tune={"bounds": {"k": [1.5, 3.05]}}))
    cost = result.held_out.cost
    assert not result.gained and cost.gain is not None and cost.gain < result.margin
    assert result.sentence.startswith("no clear gain: with the best of")


def test_a_cost_that_falls_while_no_figure_of_the_loops_does_is_no_gain():
    lost = {"t_end": 2.0, "case_t_end": 2.0}  # no loop settles: those with more gain end nearer
    result = tuned(pipeline(evaluate=lost, tune={"bounds": {"k": [0.5, 1.5]}, "evaluations": 12, "margin": 0.001}))
    assert result.held_out.cost.falls and result.held_out.unsettled == (6, 6)
    assert not result.gained and result.sentence.startswith("no clear gain")


def test_each_law_is_judged_against_its_rest():
    chosen = pipeline()
    loops = Loops(chosen, plants.resolve(chosen.plant), 5, "training")
    moved = loops.run({"k": 2.0, "aim": -1.0}, lambda steps: None)  # to x = -0.5, where the loop ends
    assert moved.settled.all() and (moved.peak > 1).all()


def test_the_answer_depends_on_the_seed_and_not_on_the_threads():
    short = {"evaluations": 18}
    one, two = (tuned(pipeline(tune=short), jobs=jobs) for jobs in (1, 2))
    assert one == two
    assert tuned(pipeline(tune=short, seed=1)).numbers != one.numbers


def test_an_interruption_gives_the_best_up_to_then():
    class Stopping(Console):
        def detail(self, text: str) -> None:
            self.stop()  # as Ctrl-C: at the next report of progress

    result = tuned(pipeline(), console=Stopping(quiet=True))
    assert result.interrupted and 0 < result.evaluations < 60
    assert result.gained and result.numbers[0].after > 1 and result.sentence.startswith("interrupted")


def test_gamma_and_b_vary_where_the_delay_adapts_and_scenarios_count():
    table = {"adaptation": "bresch-pietri-krstic", "bounds": [0.1, 0.8], "case_D_hat": [0.2, 0.7]}
    table |= {"scenarios": [{"name": "noisy", "measurement": {"relative_noise": 0.001}}]}
    chosen = pipeline(evaluate=table, tune={"free": [], "bounds": {"b": [1.0, 1.0]}, "evaluations": 6})
    result = tuned(chosen)
    assert [number.name for number in result.numbers] == ["gamma"]  # b is held
    assert result.training.loops == 4 * 2 * 2 and result.held_out.loops == 6 * 2 * 2


def test_lost_loops_cost_more_than_any_that_settles_and_are_in_order():
    chosen = pipeline()
    plant = plants.resolve(chosen.plant)
    outcomes = [
        Loops(chosen, plant, 2, "training").run({"k": k}, lambda steps: None).time.mean()
        for k in (1.0, -0.1, -0.3, -0.6)
    ]
    assert outcomes[0] < T and np.all(np.diff(outcomes) > 0) and outcomes[1] > 2 * T and outcomes[3] < 3 * T
    failed = Settling.failed(Loops(chosen, plant, 2, "training").run({"k": 1.0}, lambda steps: None), T)
    assert (failed.time == 4 * T).all() and not failed.settled.any()
    assert np.isfinite(Yardstick(1.0, 1.0, 0.1).costs(failed)).all()


def test_the_interval_is_that_of_pairs():
    before = np.random.default_rng(1).uniform(1, 2, (40, 3))
    result = compared(before, 0.8 * before, np.random.default_rng(2))
    assert (result.gain, *result.interval) == pytest.approx((0.2, 0.2, 0.2))  # what the starts differ in falls out
    result = compared(before, before[::-1], np.random.default_rng(2))
    assert result.gain == pytest.approx(0) and not result.falls and "no clear change" in result.change()
    with_gaps = np.where(before > 1.9, np.nan, before)  # loops that do not settle
    result = compared(before, 0.8 * with_gaps, np.random.default_rng(2))
    assert (result.gain, *result.interval) == pytest.approx((0.2, 0.2, 0.2))
    assert compared(before, before * np.nan, np.random.default_rng(2)).interval is None


def test_a_loop_that_breaks_a_limit_does_not_settle(folder: Path):
    (folder / "line.py").write_text(LIMITED.format("1.6 - x.x"))
    chosen = pipeline(evaluate={"safety": {"alpha": 1.0}, "actuator": "history", "u0": [0.0]})
    outcome = Loops(chosen, plants.resolve(chosen.plant), 5, "training").run({"k": 1.0}, lambda steps: None)
    beyond = starts(chosen, "training", 5) * np.exp(A * D) > 1.6  # before the first command arrives
    assert 0 < beyond.sum() < 5
    assert outcome.settled[:, 0].tolist() == (~beyond).tolist() and (outcome.time[beyond] >= 2 * T).all()


def test_gains_are_what_kappa_alone_reads():
    assert gains(plants.resolve("line.py:Line")) == ["k", "aim"]
    assert gains(plants.resolve("planar_arm2")) == ["stiffness", "damping"]
    assert gains(plants.resolve("scalar")) == ["c"]


@pytest.mark.parametrize(
    ("table", "message"),
    [
        ({"free": ["a"], "bounds": {}}, "free: expected gains.*k, aim, got 'a'"),
        ({"free": ["aim"], "bounds": {}}, "expected a range for aim"),
        ({"free": ["aim"], "bounds": {"aim": [-2.0, -0.5]}}, "got aim, which moves the rest from x = 0 to -2;"),
        ({"free": ["k", "aim"], "bounds": {"aim": [0.0, 1e-3]}}, "got aim, which moves the rest"),
        ({"free": [], "bounds": {}}, "expected something to tune"),
        ({"free": ["b"], "bounds": {}}, "got 'b'"),
        ({"free": []}, "bounds: expected gamma, b or a name of free, got 'k'"),
    ],
)
def test_what_cannot_be_tuned_is_refused_in_a_line(table: dict[str, Any], message: str):
    with pytest.raises(ConfigError, match=message):
        tuned(pipeline(tune=table))


@pytest.mark.parametrize(
    ("law", "table", "left"),
    [
        ("delay-observer", {"free": ["k"], "bounds": {"k": [0.5, 6.0]}}, ["k"]),  # gamma and b mean nothing there
        ("l1", {"free": [], "bounds": {}}, ["gamma"]),
        ("bresch-pietri-krstic", {"free": [], "bounds": {}}, ["gamma", "b"]),
    ],
)
def test_only_what_acts_is_free(law: str, table: dict[str, Any], left: list[str]):
    loops = {"adaptation": law, "bounds": [0.1, 0.8], "case_D_hat": [0.2], "actuator": "history"}
    loops |= {"dt": 0.01, "gamma": 0.02}
    search = {**table, "evaluations": 1, "starts": 2, "held_out": 2}
    chosen = config.parse(TABLES | {"evaluate": TABLES["evaluate"] | loops, "tune": search}, "line.toml")
    assert [number.name for number in tuned(chosen).numbers] == left


@pytest.mark.parametrize(
    ("table", "message"),
    [
        ({"free": [], "bounds": {}}, "something to tune, got nothing that changes the loops; .* here: k, aim"),
        ({"free": ["k"], "bounds": {"b": [0.5, 2.0]}}, "got b, which changes nothing in them; leave it out"),
    ],
)
def test_what_the_delay_law_has_no_use_for_is_refused(table: dict[str, Any], message: str):
    loops = {"adaptation": "delay-observer", "bounds": [0.1, 0.8], "case_D_hat": [0.2], "actuator": "history"}
    search = {**table, "starts": 2, "held_out": 2}
    chosen = config.parse(TABLES | {"evaluate": TABLES["evaluate"] | loops, "tune": search}, "line.toml")
    with pytest.raises(ConfigError, match=message):
        tuned(chosen)


def test_a_search_that_takes_long_says_so_beforehand(capsys: pytest.CaptureFixture[str]):
    seconds = iter(range(10**6))
    tuned(pipeline(tune={"evaluations": 30}), console=Console(clock=lambda: float(next(seconds))))
    said = capsys.readouterr().err
    assert re.search(r"^tune: 30 tries, about \d+ (s|min); tune.evaluations says how many$", said, re.MULTILINE)


def call(*arguments: str) -> Result:
    return CliRunner().invoke(app, ["tune", *arguments])


FILE = """
plant = "line.py:Line"

[evaluate]
adaptation = "frozen"
D = 0.4
D_hat = 0.4
case_D_hat = [0.4]
X0 = [1.0]
t_end = 12.0
case_t_end = 12.0
dt = 0.002
nx = 11
scenarios = [{ name = "noisy", measurement = { relative_noise = 0.001 } }]

[tune]
starts = 2
held_out = 3
evaluations = 12
"""


def test_the_command_writes_a_pipeline_that_runs_as_it_is(folder: Path):
    (folder / "line.toml").write_text(FILE)
    (folder / "out").mkdir()
    done = call("line.toml", "--free", "k=0.5:6", "-o", "out/better.toml", "--json")
    assert done.exit_code == 0, done.output
    answer = Tuned.of(json.loads(done.stdout), "stdout")
    better = config.load(folder / "out" / "better.toml")  # the plant's file is found from there
    assert better.parameters["k"] == pytest.approx(answer.numbers[0].after, rel=1e-5)
    again = tuned(better.model_copy(update={"tune": better.tune.model_copy(update={"evaluations": 1})}))  # type: ignore[union-attr]
    assert again.held_out.settle_time.before == pytest.approx(answer.held_out.settle_time.after)
    text = call("line.toml", "--free", "k=0.5:6", "--set", "tune.evaluations=6").stdout
    assert "settling time" in text and "95 % of it" in text


def test_no_pipeline_is_written_where_there_is_nothing_to_gain_or_over_anothers_file(folder: Path):
    (folder / "line.toml").write_text(FILE)
    done = call("line.toml", "--free", "k=0.98:1.02", "-o", "better.toml")
    assert done.exit_code == 0 and "no clear gain" in done.stdout and not (folder / "better.toml").exists()
    refused = call("line.toml", "--free", "k", "-o", "line.toml")
    assert refused.exit_code == 2 and "line.toml: expected no such file" in refused.output
    assert "write k1=0.5:5" in call("line.toml", "--free", "k=5").output
