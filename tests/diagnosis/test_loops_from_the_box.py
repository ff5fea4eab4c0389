"""`npred plants check` simulates loops from the box: where the linearised margin is not theirs, when they settle, if a
predictor is needed, and what a constant disturbance leaves.
"""

import json
import re
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from typer.testing import CliRunner

import npred
from npred import diagnosis
from npred.base import progress
from npred.base.matrices import exponential
from npred.cli import app
from npred.diagnosis import Case, disturbance, loops
from npred.plants import Plant


class Servo:
    """A servo with Coulomb friction, smoothed: near rest it damps by a / eps, in motion hardly."""

    states, inputs, guess = ("angle", "speed"), ("u",), (1.0, 0.0)
    parameters = {"a": 1.0, "eps": 0.05, "c": 0.1}
    box, units = {"angle": (0.0, 2.0), "speed": (-0.5, 0.5)}, {"angle": "rad", "speed": "rad/s"}
    input_bounds = ((-4.0, 4.0),)
    f = lambda x, u, t, p, M: [x.speed, -p.a * M.tanh(x.speed / p.eps) - p.c * x.speed + u.u]
    kappa = lambda x, t, p, M: [-8 * (x.angle - 1) - x.speed]


def test_nothing_is_said_of_control_steps_that_are_the_checks_own():
    """A fast law with a long delay has loops of few steps: those of a pipeline are others."""

    class Fast:
        states, inputs, box = ("y",), ("u",), {"y": (0.0, 20.0)}
        f = lambda x, u, t, p, M: [(u.u - x.y) / 0.1]
        kappa = lambda x, t, p, M: [10 - 4 * (x.y - 10)]

    lines = []
    with progress.listener(lines.append):
        diagnosis.check(npred.plant(Fast), 1.0)
    assert not [line for line in lines if "dt" in line]


class Line:
    """x' = a x + u about 0."""

    states, inputs, parameters, box = ("x",), ("u",), {"a": 1.0}, {"x": (-1.0, 1.0)}
    f = lambda x, u, t, p, M: [p.a * x.x + u.u]
    kappa = lambda x, t, p, M: [-(p.a + 1) * x.x]


class Heater:
    """A plate that a heater warms through a long pipe; a fan, of which the model does not know, cools it."""

    states, inputs, guess = ("T",), ("power",), (40.0,)
    parameters = {"capacity": 200.0, "loss": 20.0, "aim": 40.0, "gain": 60.0}
    box, input_bounds, units = {"T": (20.0, 60.0)}, ((0.0, 2000.0),), {"T": "K", "power": "W"}
    f = lambda x, u, t, p, M: [(u.power - p.loss * (x.T - 20)) / p.capacity]
    kappa = lambda x, t, p, M: [p.loss * (p.aim - 20) - p.gain * (x.T - p.aim)]


class Compartments:
    """A drug that spreads into two compartments, one of which takes five hours; the pump acts late."""

    states, inputs, guess, time_unit = ("c1", "c2", "c3"), ("rate",), (4.0, 4.0, 4.0), "min"
    parameters = {"aim": 4.0}
    box = {"c1": (0.0, 8.0), "c2": (0.0, 8.0), "c3": (0.0, 8.0)}
    f = lambda x, u, t, p, M: [
        0.112 * (x.c2 - x.c1) + 0.042 * (x.c3 - x.c1) - 0.119 * x.c1 + u.rate / 15.9,
        0.055 * (x.c1 - x.c2), 0.0033 * (x.c1 - x.c3),
    ]  # fmt: skip
    kappa = lambda x, t, p, M: [15.9 * 0.119 * p.aim - 5 * (x.c1 - p.aim)]


class Swing:
    """A damped oscillator whose input is bounded: no command of any loop takes it out of a bound."""

    states, inputs, parameters = ("x", "v"), ("u",), {"damping": 0.1, "gain": 2.0}
    box, input_bounds = {"x": (-1.0, 1.0), "v": (-1.0, 1.0)}, ((-1.0, 1.0),)
    f = lambda x, u, t, p, M: [x.v, u.u - x.x - p.damping * x.v]
    kappa = lambda x, t, p, M: [-p.gain * x.v]


def line(**parts):
    return Plant("line", type("Line", (Line,), parts))


def answers(plant, delay, **settings):
    return {answer.check: answer for answer in diagnosis.check(plant, delay=delay, **settings)}


def test_a_margin_without_end_is_not_that_of_a_servo_with_friction():
    """The linearised loop is stable for every D_hat. Without prediction the loop swings, by twice the step and more."""
    plant, D = Plant("servo", Servo), 0.3
    assert npred.delay_margin(plant, D) == (-D, np.inf)
    found = answers(plant, D)
    margin = found["delay margin"]
    assert margin.verdict == "warn" and "any longer" not in margin.text
    assert "; loops from the box are not: with D_hat = 0 s" in margin.text
    start = loops.starts(Case(plant, D, 101, 256))
    bare = npred.simulate(plant, npred.predictor(plant, "rk4"), D=D, D_hat=0.0, X0=start, t_end=60.0, dt=0.005)
    angle = bare.X[:, -4000:, 0]
    swinging = np.ptp(angle, axis=1) > 0.5
    without = found["prediction"].figures["without"]
    assert without["swinging"] == swinging.mean() > 0.5
    low, high = map(float, re.search(r"% swing, angle between (\S+) and (\S+) rad", margin.text).groups())
    assert (low, high) == pytest.approx((angle.min(), angle.max()), abs=0.03) and high - low > 2
    assert found["prediction"].figures["with"]["settled"] == 1


@pytest.mark.parametrize(
    ("parts", "D", "words"),
    [
        ({"input_bounds": ((-1.5, 1.5),)}, 0.3, "diverge"),  # |x| > 1.5 leaves
        ({"kappa": lambda x, t, p, M: [-x.x - M.sin(M.pi * x.x)], "box": {"x": (-2.5, 2.5)}}, 0.05, "rest elsewhere"),
        ({"kappa": lambda x, t, p, M: [-2 * x.x + x.x**3]}, 0.3, "diverge"),
    ],
)
def test_a_margin_that_is_not_that_of_the_box_is_said(parts, D, words):
    """Saturation, several rests, and a law that is right near rest only."""
    plant = line(**{"box": {"x": (-2.0, 2.0)}} | parts)
    margin = answers(plant, D)["delay margin"]
    assert margin.verdict == "warn" and "from the box are not: " in margin.text and words in margin.text
    small = line(**parts | {"box": {"x": (-0.1, 0.1)}})
    assert answers(small, D)["delay margin"].verdict == "yes"


def test_loops_in_a_linear_margin_settle_however_slowly():
    """Small and large states are alike; near the end of the margin loops take many times the slowest time constant."""
    margin = answers(npred.plant("scalar"), 1.0)["delay margin"]
    assert (
        margin.verdict == "yes"
        and "; loops from the box are stable too, with D_hat = 0.2492 s and 1.336 s" in margin.text
    )
    slow = margin.figures["loops"][0]
    assert slow["settled"] == 1 and slow["settling_time_largest"] > 50


def test_the_settling_time_is_that_of_the_loops():
    """|x| falls as e^-t, from the time on at which the first command acts, to 2 % of half the box."""
    D, found = 0.5, answers(line(), 0.5)
    largest = np.log(np.abs(Case(line(), D, 101, 256).X[:64]).max() / 0.02)
    assert found["convergence"].figures["settling_time_largest"] == pytest.approx(largest, abs=0.051)
    assert f"{found['convergence'].figures['settling_time_largest']:.3g} s (slowest)" in found["convergence"].text
    exact, h = found["prediction"].figures["with"], found["prediction"].figures["dt"]
    rate = -np.log(2 - np.exp(h)) / h  # of commands that are held
    assert exact["settling_time_largest"] == pytest.approx(D + np.log(0.99 * np.exp(D) / 0.02) / rate, abs=h)
    assert exact["overshoot"]["x"] < 1e-6


def test_loops_that_creep_for_longer_than_is_looked_are_not_said_to_rest_elsewhere():
    """A state of a rate of 1e-3 / s beside one of 100 / s."""

    class Creep:
        states, inputs, box = ("x", "y"), ("u",), {"x": (-1.0, 1.0), "y": (-1.0, 1.0)}
        f = lambda x, u, t, p, M: [-1e-3 * x.x, -100 * x.y + u.u]
        kappa = lambda x, t, p, M: [-x.y]

    case = Case(Plant("creep", Creep), 0.5, 101, 256, "as asked", None)
    names = [question.name for question in diagnosis.QUESTIONS]
    row = [case.ask(question) for question in diagnosis.QUESTIONS[: names.index("prediction") + 1]][-1]
    assert row is not None
    assert row.verdict == "yes" and "have not settled after" in row.text and "the longest time simulated" in row.text
    assert "elsewhere" not in row.text


def test_a_plant_that_needs_no_predictor_is_named():
    slow = answers(line(parameters={"a": -0.1}, kappa=lambda x, t, p, M: [-0.1 * x.x]), 0.1)["prediction"]
    assert slow.verdict == "yes" and slow.text.startswith("no predictor is needed: 16 loops from the box, D = 0.1 s")
    fast = answers(line(), 0.8)["prediction"]
    assert "need no predictor" not in fast.text
    assert fast.figures["with"]["settled"] == 1 > fast.figures["without"]["settled"]


def test_a_predictor_is_needed_where_the_loop_without_is_as_fast_but_overshoots():
    """x' = u with u = -x, D = 0.6 s."""
    row = answers(line(parameters={"a": 0.0}), 0.6)["prediction"]
    exact, bare = row.figures["with"], row.figures["without"]
    assert bare["settling_time_largest"] < exact["settling_time_largest"] and "need no predictor" not in row.text
    assert bare["overshoot"]["x"] > 0.1 > 0.01 > exact["overshoot"]["x"]
    assert row.text.endswith(f"overshoot x {bare['overshoot']['x']:.3g}")


def test_the_offset_that_a_disturbance_leaves_is_the_one_of_the_loop():
    """At rest a X + U + d = 0 and P = X - d (e^{aD} - 1) / a; U = -(a + c) P, here a = 0.5, c = D = 1."""
    row = answers(npred.plant("scalar"), 1.0)["disturbance"]
    d = row.figures["disturbance"]["U"]
    case = Case(npred.plant("scalar"), 1.0, 101, 256)
    assert d == pytest.approx(0.1 * np.ptp(1.5 * case.X))
    assert abs(row.figures["offset"]["X"]) == pytest.approx(d * (1 + 1.5 * (np.exp(0.5) - 1) / 0.5), rel=1e-3)


def test_a_heater_with_a_fan_is_offered_integral_action():
    """The lag is 10 s. The check offers the observer; it takes the offset that a fan causes to less than 1 K."""
    plant, D = Plant("heater", Heater), 3.0
    row = answers(plant, D)["disturbance"]
    assert row.verdict == "yes"
    size, off, seconds = map(float, re.fullmatch(
        r"a constant disturbance of (\S+) W at power, a tenth of its range, moves the rest: T (\S+) K; an observer "
        r"with offset=True removes this, to 1 % of half the box in (\S+) s", row.text,
    ).groups())  # fmt: skip
    assert size == 200 and off == pytest.approx(abs(row.figures["offset"]["T"]), rel=0.01) and off > 3
    assert seconds == pytest.approx(row.figures["settling_time_with_offset"], rel=0.01) and seconds < 60
    windy, ends = Plant("windy", Heater, {"loss": 30.0}), []
    for observer in (None, npred.observers.EKF(plant, offset=True)):
        run = npred.simulate(
            plant, npred.predictor(plant, "rk4", 51), D=D, D_hat=D, X0=[40.0], t_end=60.0, dt=0.06, truth=windy,
            u0="equilibrium", actuator="history", observer=observer,
        )  # fmt: skip
        ends.append(abs(run.X[-200:, 0] - 40).max())
    assert ends[0] > 3 and ends[1] < 1


def test_a_slow_compartment_is_no_divergence_and_its_rest_is_that_of_the_linear_equations():
    """The loop creeps to its rest for longer than is simulated: A X + B (U + d) = 0, U = K (e^{AD} X + G U)."""
    row = answers(Plant("compartments", Compartments), 1.0)["disturbance"]
    assert "diverge" not in row.text and "moves the rest: c1 " in row.text
    A = np.array([[-0.273, 0.112, 0.042], [0.055, -0.055, 0.0], [0.0033, 0.0, -0.0033]])
    B, K = np.array([[1 / 15.9], [0.0], [0.0]]), np.array([[-5.0, 0.0, 0.0]])
    ahead = exponential(np.block([[A, B], [np.zeros((1, 4))]]))  # D = 1
    equations = np.block([[A, B], [K @ ahead[:3, :3], K @ ahead[:3, 3:] - 1]])
    rest = np.linalg.solve(equations, np.append(-B[:, 0] * row.figures["disturbance"]["rate"], 0.0))
    np.testing.assert_allclose([row.figures["offset"][name] for name in Compartments.states], rest[:3], rtol=1e-6)


@settings(max_examples=12, deadline=None)
@given(st.floats(0.02, 1.0), st.floats(0.5, 5.0), st.floats(0.2, 4.0))
def test_no_loop_is_said_to_diverge_that_no_command_can_take_out_of_a_bound(damping, gain, D):
    """Whatever delay and gain: it settles, swings, rests elsewhere, or was not looked at for long enough."""
    found = answers(Plant("swing", Swing, {"damping": damping, "gain": gain}), D)
    figures = [*found["prediction"].figures.values(), *found["delay margin"].figures["loops"]]
    shares = [each["diverging"] for each in figures if isinstance(each, dict)]
    assert len(shares) == 4 and not any(shares)
    assert not any("diverge" in row.text for row in found.values())


def test_a_loop_that_leaves_every_bound_diverges_and_one_that_is_on_its_way_is_not_said_to():
    """x' = x + u without a predictor, |u| <= 1.5; x' = u with u = -1.5 at most, pushed by more than that."""
    bare = answers(line(box={"x": (1.6, 2.0)}, input_bounds=((-1.5, 1.5),)), 0.3)["prediction"].figures["without"]
    assert bare["diverging"] == 1 and bare["moving_away"] == 0
    drift = line(parameters={"a": 0.0}, input_bounds=((-1.0, 1.0),), kappa=lambda x, t, p, M: [-x.x])
    case = Case(drift, 0.3, 101, 256)
    pushed = loops.simulated(case, 0.3, np.zeros((1, 1)), disturbance=lambda t: [1.5])
    assert pushed.leaving.all() and not pushed.diverges.any() and pushed.fails.all()
    T, x = map(
        float,
        re.fullmatch(r"all still move away after (\S+) s, x by then (\S+) from its target", pushed.text()).groups(),
    )
    assert x == pytest.approx(0.5 * T + np.log(1.5) + 0.5, abs=1.5)  # 0.5 faster than the command, once that is -1


def test_the_state_that_is_farthest_from_its_target_is_named():
    """In widths of the box: the angle is near its target, which is not 0."""
    case, ends = Case(Plant("servo", Servo), 0.3, 101, 256), np.array([[0.9, -0.4], [1.1, 0.4]])[:, None]
    fate = loops.Fate(np.array([np.inf]), np.array([False]), np.array([True]))
    one = loops.Ensemble(case, 0.3, 1.0, fate, np.ones(1), np.zeros(1, bool), *ends, *ends, np.zeros((1, 2)))
    assert one.text() == "all still move away after 1 s, speed by then 0.4 rad/s from its target"


def test_loops_that_creep_to_where_they_were_are_not_moved(monkeypatch):
    """They have not settled within what is simulated, but their rest is known."""
    case = Case(Plant("servo", Servo), 0.3, 101, 256)
    creeps = SimpleNamespace(fate=SimpleNamespace(settled=np.array([False])))
    monkeypatch.setattr(disturbance, "_disturbed", lambda *_, **__: creeps)
    monkeypatch.setattr(disturbance, "_rest", lambda *_: case.plant.equilibrium + 1e-4)
    verdict, text, _ = disturbance.rejected(case)
    assert verdict == "yes" and text.endswith(" leaves every state within 1 % of half the box")


@pytest.mark.parametrize("name", ["transport_tank", "cart_pole"])
def test_no_cure_is_promised_that_was_not_simulated(name):
    """No observer serves a plant that declares its delay; the cart-pole with 1 s of delay is lost with one, too."""
    done = CliRunner().invoke(app, ["plants", "check", name, "--delay", "1", "--json"])
    (row,) = [row for row in json.loads(done.stdout)["answers"] if row["check"] == "disturbance"]
    assert row["verdict"] == "warn" and "observer" not in row["text"]
    assert (None in row["figures"]["offset"].values()) == (name == "cart_pole")


def test_a_plant_that_is_called_gets_no_loops_and_no_promise_of_them(tmp_path):
    code = "class Called:\n    traced, states, inputs, box = False, ('x',), ('u',), {'x': (-1.0, 1.0)}\n"
    code += "    def f(X, u, t, p):\n        return -X + u\n\n    def kappa(X, t, p):\n        return -0.5 * X\n"
    (tmp_path / "called.py").write_text(code)
    found = answers(npred.plant(f"{tmp_path}/called.py:Called"), 1.0)
    assert "prediction" not in found and found["delay margin"].text.endswith("no loop from the box was simulated")


RIG = """
plant = "line.py:Line"

[evaluate]
X0 = [0.5]
D = 0.3
D_hat = 0.3
case_D_hat = [0.3]
adaptation = "frozen"
actuator = "history"
nx = 31
u0 = [0.1]
"""


def checked(path):
    done = CliRunner().invoke(app, ["plants", "check", str(path), "--json"])
    return done.exit_code, {row["check"]: row for row in json.loads(done.stdout)["answers"]}


def test_a_pipeline_with_evaluate_alone_is_asked_what_that_runs(tmp_path):
    """Not [generate]'s defaults: a delay of 2 s, the paper's law and its V."""
    lines = "class Line:\n    states, inputs, box = ('x',), ('u',), {'x': (-1.0, 1.0)}\n"
    lines += "    def f(x, u, t, p, M):\n        return [x.x + u.u]\n"
    lines += "    def kappa(x, t, p, M):\n        return [-2 * x.x]\n"
    (tmp_path / "line.py").write_text(lines)
    (tmp_path / "rig.toml").write_text(RIG)
    code, rows = checked(tmp_path / "rig.toml")
    assert code == 0 and rows["delay"]["text"].startswith("0.3 s, the longest delay or first estimate")
    assert rows["V"]["verdict"] == "yes" and rows["pipeline"]["text"].endswith("fits its plant, by [evaluate] alone")
    assert "31 nodes" in rows["stiffness"]["text"] and "u0: u = 0.1" in rows["completeness"]["text"]
    assert rows["prediction"]["figures"]["with"]["settled"] == 1
    (tmp_path / "rig.toml").write_text(RIG.replace('adaptation = "frozen"', ""))
    code, rows = checked(tmp_path / "rig.toml")
    assert code == 3 and rows["V"]["verdict"] == "no"  # the paper's law takes one
    (tmp_path / "rig.toml").write_text(RIG + "[generate]\n")
    code, rows = checked(tmp_path / "rig.toml")
    assert code == 3 and rows["delay"]["text"].startswith("2 s")


def test_the_loops_of_a_pipeline_have_its_delay_not_its_longest_estimate(tmp_path):
    (tmp_path / "p.toml").write_text('plant = "scalar"\n[evaluate]\nX0 = [0.5]\nD = 0.7\nactuator = "history"\n')
    _, rows = checked(tmp_path / "p.toml")
    assert rows["delay"]["text"].startswith("1.4 s") and rows["prediction"]["figures"]["D"] == 0.7
    low, high = npred.delay_margin(npred.plant("scalar"), 0.7)
    figures = rows["delay margin"]["figures"]
    assert (figures["low"], figures["high"]) == pytest.approx((0.7 + low, 0.7 + high))
    longest, late = npred.delay_margin(npred.plant("scalar")), figures["without_prediction"]
    assert figures["longest_without_prediction"] == longest and late["D"] == pytest.approx(0.9 * longest)
    assert late["settled"] == 1 and f"without prediction for D below {longest:.4g} s" in rows["delay margin"]["text"]
