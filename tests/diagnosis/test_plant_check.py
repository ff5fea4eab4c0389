"""`npred plants check`: nothing wrong with the built-in plants; each mistake is named, with its line and its cure."""

import json
import re
import subprocess
import sys

import numpy as np
import pytest
from conftest import process_environment
from follower import Follower, follower
from reactor import Reactor
from scipy.linalg import solve_continuous_lyapunov
from typer.testing import CliRunner

from npred import diagnosis, plants
from npred.base.errors import ConfigError
from npred.cli import app
from npred.diagnosis import check, equilibrium, settled
from npred.diagnosis.case import Check
from npred.lab import config
from npred.lab.scheduler import pipeline_fit
from npred.plants import Plant

QUESTIONS = [
    *("trace", "smooth law", "box", "finite", "delay", "equilibrium", "stability", "V", "input bounds", "convergence"),
    *("prediction", "delay margin", "disturbance", "PI", "stiffness", "completeness"),
]


def answers(plant: Plant, **settings) -> dict:
    return {answer.check: answer for answer in check(plant, **settings)}


@pytest.mark.parametrize("name", [row["name"] for row in plants.named() if plants.resolve(row["name"]).rests])
def test_built_in_plants_have_no_answer_of_no(name):
    found = check(plants.resolve(name), delay=0.5)
    assert settled(found)
    others = ("feasibility", "adaptation", "PI")
    without = {"PI"} | ({"delay margin"} if plants.resolve(name).declares_delay else set())
    expected = [question for question in QUESTIONS if question not in without]
    assert [answer.check for answer in found if answer.check not in others] == expected


@pytest.mark.parametrize(
    ("old", "new", "question", "words"),
    [
        ("[u.U - p", "[u.U, u.U - p", "trace", r"Tank: f \(my_plant.py:10\) expected to return 1 .*, got 2; return"),
        ("[p.c * M.sqrt(x.h) +", "[u.U +", "trace", "kappa failed at my_plant.py:14: .*only f knows the inputs"),
        ("- p.c *", "- p.drain *", "trace", "f failed at my_plant.py:11: .*expected one of c, level"),
        ('box = {"h": (0.5, 2.0)}', "box = {}", "box", 'plant Tank: box has no range for h; add box = {"h":'),
        ("(0.5, 2.0)", "(-0.5, 2.0)", "finite", r"f \(my_plant.py:10\) is not finite at h = -0.\d+, .*shrink box"),
        ("(x.h - p.level) ** 2", "x.h - p.level", "finite", r"V \(my_plant.py:16\) expected at least 0 .*, got -0.\d+"),
        ("+ p.level - x.h", "+ 1 + x.h**2", "equilibrium", r"py:13\) leads to no rest .* `guess`"),
        ("guess =", "input_bounds = [(0.0, 0.3)]\n    guess =", "equilibrium", "rests with U = 0.5, outside input_b"),
        ("+ p.level - x.h", "+ x.h - p.level", "stability", r"py:13\) does not stabilise .*: eigenvalues 1 at"),
        ("+ p.level - x.h", "+ M.sqrt(M.abs(x.h - 0.8))", "stability", "no derivative at rest; guard"),
        ("* M.sqrt(x.h)]\n\n    def k", "* M.sqrt(x.h) + x.h**3]\n\n    def k", "completeness", "py:10.: the open"),
        ("[u.U - p.", "[u.U - 900 * (x.h - 1) - p.", "stiffness", "= 9 with .* expected below 2; take 45. nodes or"),
    ],
)
def test_a_mistake_is_one_answer_of_no_with_its_line_and_cure(tank_file, old, new, question, words):
    answer = answers(plants.resolve(tank_file(old, new)), delay=1.0)[question]
    assert answer.verdict == "no"
    assert "\n" not in answer.text
    assert re.search(words, answer.text), answer.text


def test_a_rest_beyond_a_bound_by_rounding_is_within_it(tank_file):
    plant = plants.resolve(tank_file("guess =", "input_bounds = [(0.0, 0.5 - 1e-12)]\n    guess ="))
    assert equilibrium.equilibrium(diagnosis.Case(plant, 1.0, 101, 64))[0] == "yes"


def test_a_plant_without_a_V_is_offered_one(tank_file):
    """x' = -x about 1: V = (h - 1)² / 2 solves the Lyapunov equation; declared, it satisfies."""
    name = tank_file("    def V(x, t, p, M):\n        return (x.h - p.level) ** 2\n", "")
    found = answers(plants.resolve(name))["V"]
    assert found.verdict == "warn" and "plant Tank: expected V(x, t, p, M), a Lyapunov function, which " in found.text
    assert "found none; delay-observer, l1 and frozen need none; a candidate: V = " in found.text
    offered = re.search(r"V = (.+) solves the Lyapunov equation, and falls at 100% of \d+ states", found.text)
    assert offered is not None
    written = re.sub(r"\bh\b", "x.h", offered[1]) if "x.h" not in offered[1] else offered[1]
    again = plants.resolve(tank_file("return (x.h - p.level) ** 2", f"return {written}"))
    assert answers(again)["V"].verdict == "yes"


def test_a_plant_that_tracks_without_a_V_is_told():
    found = answers(Plant("bare", type("Bare", (Follower,), {"V": None})))
    assert found["reference"].verdict == "yes" and found["V"].verdict == "warn"


def test_what_cannot_be_asked_is_not_asked(tank_file):
    assert list(answers(plants.resolve(tank_file("[u.U - p", "[u.U, u.U - p")))) == ["trace"]
    assert list(answers(plants.resolve(tank_file('box = {"h": (0.5, 2.0)}', "box = {}")))) == [
        *("trace", "smooth law", "box", "delay", "equilibrium", "stability")
    ]


@pytest.mark.parametrize(
    ("law", "kinks"),
    [
        ("M.sign(p.level - x.h)", "sign: a law of signs chatters"),
        ("M.where(x.h < 1, 1 - x.h, 0.0) + M.maximum(x.h, 0.2)", "maximum, where: its derivative may jump"),
    ],
)
def test_kinks_of_the_law_are_a_warning(tank_file, law, kinks):
    plant = plants.resolve(tank_file("p.c * M.sqrt(x.h) + p.level - x.h", law))
    answer = answers(plant)["smooth law"]
    assert answer.verdict == "warn"
    assert kinks in answer.text


def test_a_choice_by_a_parameter_is_no_kink(tank_file):
    plant = plants.resolve(tank_file("+ p.level - x.h", "+ M.where(p.level > 0.5, p.level, 1.0) - x.h"))
    assert answers(plant)["smooth law"].verdict == "yes"


def test_a_V_that_rises_is_a_warning_with_a_better_one():
    """x' = v, v' = -x - v: x² rises where x v > 0."""

    class Spring:
        states, inputs = ("x", "v"), ("F",)
        box = {"x": (-1.0, 1.0), "v": (-1.0, 1.0)}
        f = lambda x, u, t, p, M: [x.v, u.F - x.x]
        kappa = lambda x, t, p, M: [-x.v]
        V = lambda x, t, p, M: x.x**2

    answer = answers(Plant("Spring", Spring))["V"]
    assert answer.verdict == "warn"
    assert "V = 1.5 * x.x ** 2 + 1 * x.x * x.v + 1 * x.v ** 2 solves" in answer.text
    assert answer.text.endswith("falls at 100% of 768 states")


def test_a_V_of_zero_gets_a_better_one(tank_file):
    answer = answers(plants.resolve(tank_file("(x.h - p.level) ** 2", "0.0")))["V"]
    assert answer.verdict == "warn"
    assert "V = 0.5 * (x.h - 1) ** 2 solves" in answer.text


def test_lyapunov_equation():
    A = np.random.default_rng(0).normal(size=(4, 4)) - 5 * np.eye(4)
    np.testing.assert_allclose(equilibrium.lyapunov(A), solve_continuous_lyapunov(A.T, -np.eye(4)), rtol=1e-10)


def test_a_plant_that_tracks_has_no_equilibrium_and_that_is_no_failure(tank_file):
    found = answers(plants.resolve(tank_file("+ p.level - x.h", "+ p.level + M.sin(t) - x.h")))
    assert found["reference"].verdict == "warn"
    assert "stability" not in found and "completeness" in found


def test_a_reference_is_compared_with_the_loop_of_the_law():
    assert answers(follower())["reference"].verdict == "yes"
    bent = type("Bent", (Follower,), {"reference": staticmethod(lambda t, p, M: [1.1 * p.A * M.sin(p.w * t)])})
    answer = answers(Plant("Bent", bent))["reference"]
    assert answer.verdict == "no" and "expected a trajectory of f with kappa, got one" in answer.text


def test_a_derivative_that_is_not_finite_is_an_answer_of_no(tank_file, monkeypatch):
    plant = plants.resolve(tank_file())
    right = plant.jacobians
    _ = plant.equilibrium
    asked = [question for question in diagnosis.QUESTIONS if question.name not in ("stability", "V", "convergence")]
    monkeypatch.setattr(diagnosis, "QUESTIONS", asked)
    monkeypatch.setattr(plant, "jacobians", lambda *at: np.nan * np.array(right(*at)))
    answer = answers(plant)["stiffness"]
    assert answer.verdict == "no" and "(my_plant.py:10): no derivative at h = " in answer.text


@pytest.mark.parametrize("settings", [{"delay": 0.0}, {"delay": np.inf}, {"nx": 1}])
def test_settings_that_make_no_sense_are_told(settings):
    with pytest.raises(ConfigError, match=f"{next(iter(settings))}: expected"):
        check(plants.resolve("scalar"), **settings)


def test_the_command_says_it_to_people_and_programs(tank_file):
    call = lambda *arguments: CliRunner().invoke(app, ["plants", "check", *arguments])
    good = call(tank_file(), "--json")
    assert good.exit_code == 0
    document = json.loads(good.stdout)
    assert document["fine"] is True
    assert [answer["check"] for answer in document["answers"] if answer["check"] != "adaptation"] == QUESTIONS
    assert "stability" in call(tank_file()).stdout
    bad = call(tank_file("+ p.level - x.h", "+ x.h - p.level"), "--json")
    assert bad.exit_code == 3
    assert json.loads(bad.stdout)["fine"] is False
    (line,) = bad.stderr.splitlines()
    assert "the answer is no for stability" in line
    assert call("nonesuch").exit_code == 2
    assert call("scalar", "--delay", "-1").exit_code == 2


def test_V_is_looked_at_on_all_sides_of_rest():
    """The paper's V falls in its box, which lies on one side of rest, and rises close to rest on another side."""
    found = answers(plants.resolve("activator_repressor"))
    assert found["V"].verdict == "warn" and "falls at 100% of 768 states" in found["V"].text


def declared(**parts):
    """x' = a x + u with kappa = -2 x about 0, and some parts changed."""
    plain = {
        "states": ("x",), "inputs": ("u",), "box": {"x": (-3.0, 3.0)}, "parameters": {"a": 1.0},
        "f": lambda x, u, t, p, M: [p.a * x.x + u.u],
        "kappa": lambda x, t, p, M: [-2 * x.x],
        "V": lambda x, t, p, M: x.x**2,
    }  # fmt: skip
    return Plant("line", type("Line", (), plain | parts))


def test_the_share_of_kappa_outside_the_bounds_is_said_and_the_clipped_loop_tried():
    """|u| <= 1/2 holds x' = x + u from |x| < 1/2 alone."""
    found = answers(declared(input_bounds=[(-0.5, 0.5)]), samples=1000)
    assert found["stability"].verdict == found["V"].verdict == "yes"
    share = re.search(r"kappa is outside u in \[-0.5, 0.5\] at (\d+)% of 1000 states", found["input bounds"].text)
    assert share is not None and int(share[1]) == pytest.approx(100 * (1 - 0.25 / 3), abs=2)
    lost = re.search(r"(\d+)% of 64 loops without delay do not converge, as from x = ", found["convergence"].text)
    assert found["convergence"].verdict == "no" and lost is not None
    assert int(lost[1]) == pytest.approx(100 * (1 - 0.5 / 3), abs=10)
    free = answers(declared())["input bounds"]
    kept = re.fullmatch(r"none are declared; a controller keeps u in \[-(\d+), (\d+)\], 10 times the .*", free.text)
    assert free.verdict == "yes" and kept and kept[1] == kept[2] and float(kept[1]) > 0
    wide = answers(declared(input_bounds=[(-6.0, 6.0)]))
    assert wide["input bounds"].verdict == wide["convergence"].verdict == "yes"


def test_a_law_that_stabilises_near_rest_only_does_not_pass():
    """x' = -x + x³ leaves from |x| > 1, though its eigenvalue is -1."""
    found = answers(declared(kappa=lambda x, t, p, M: [-2 * x.x + x.x**3]))
    assert found["stability"].verdict == "yes" and found["convergence"].verdict == "no"
    near = answers(declared(kappa=lambda x, t, p, M: [-2 * x.x + x.x**3], box={"x": (-0.9, 0.9)}))
    assert near["convergence"].verdict == "yes"


def test_a_law_that_leads_elsewhere_does_not_pass():
    """x' = -sin(pi x) rests at each even number."""
    found = answers(declared(kappa=lambda x, t, p, M: [-x.x - M.sin(M.pi * x.x)]))
    assert found["convergence"].verdict == "no"


def test_a_slow_loop_that_still_converges_is_a_warning():
    """|x| falls as 1 / t: without a rate at rest it is that at which f crosses the box."""

    plant = declared(
        box={"x": (1.0, 2.0)},
        f=lambda x, u, t, p, M: [u.u],
        kappa=lambda x, t, p, M: [-0.1 * x.x * M.abs(x.x) + 1e-9 * M.exp(-t) * x.x],
        reference=lambda t, p, M: [0.0 * t],
    )
    answer = answers(plant)
    assert answer["convergence"].verdict == "warn" and "still converge" in answer["convergence"].text


def test_an_equilibrium_outside_the_box_is_said():
    answer = answers(declared(box={"x": (1.0, 2.0)}))["equilibrium"]
    assert answer.verdict == "warn" and "outside the box, x in [1, 2]" in answer.text


def test_a_stiff_plant_is_not_called_unbounded():
    found = answers(declared(parameters={"a": -1e4}), delay=1.0)
    assert found["stiffness"].verdict == "no" and "completeness" not in found
    assert found["convergence"].verdict == "yes"


def test_the_V_that_is_offered_is_not_offered_again():
    """Pasted as text it equals the one of the Lyapunov equation, also where that falls on a part of the box only."""
    plant = Plant("reactor", Reactor)
    offered = re.search(r"V = (.+) solves the Lyapunov equation, and falls at 100%", answers(plant)["V"].text)
    assert offered is not None
    pasted = {"V": eval(f"lambda x, t, p, M: {offered[1]}")}
    assert answers(Plant("pasted", type("Pasted", (Reactor,), pasted)))["V"].verdict == "yes"
    local = answers(declared(kappa=lambda x, t, p, M: [-2 * x.x + x.x**3], V=lambda x, t, p, M: 0.5 * x.x**2))["V"]
    assert local.verdict == "yes" and "the box is larger than that region" in local.text
    other = answers(declared(kappa=lambda x, t, p, M: [-2 * x.x + x.x**3], V=lambda x, t, p, M: x.x**4))["V"]
    assert other.verdict == "warn" and "V = " not in other.text.partition("no x'Sx")[2]


def test_the_delay_is_the_plants_or_the_pipelines_before_it_is_assumed():
    chain = declared(states=("x", "y"), inputs=("u", "v"), delays=(0.4, 2.5), box={"x": (0, 1), "y": (0, 1)},
                     f=lambda x, u, t, p, M: [u.u, u.v], kappa=lambda x, t, p, M: [-x.x, -x.y])  # fmt: skip
    assert answers(chain)["delay"].text == "2.5 s, the longest of the plant's delays"
    assert answers(declared())["delay"].text.startswith("1 s, assumed")
    assert answers(chain, delay=0.1)["delay"].text == "0.1 s, as asked"
    loops = {"D": [0.5, 0.7], "D_hat": [[0.2, 0.9]]}
    tables = {"plant": "scalar", "generate": loops, "evaluate": {"D": 0.5, "D_hat": 0.6, "case_D_hat": [0.3]}}
    found = pipeline_fit.check(plants.resolve("scalar"), config.parse(tables, "tests"))
    (text,) = [answer.text for answer in found if answer.check == "delay"]
    assert text.startswith("0.9 s, the longest delay or first estimate")


def test_the_open_loop_starts_with_u0():
    found = answers(Plant("reactor", Reactor), delay=12.0)["completeness"]
    assert found.verdict == "yes" and "u0: Tc = 300 of the rest" in found.text


RAISES = """
import math

import numpy as np


class Raises:
    traced, states, inputs, box = False, ("x",), ("u",), {"x": (-30.0, 30.0)}

    def f(X, u, t, p):
        return np.array([[math.exp(x * x) - 1 + v] for x, v in zip(X[:, 0], u[:, 0])])

    def kappa(X, t, p):
        return -2 * X

    def V(X, t, p):
        return X[:, 0] ** 2
"""


def test_a_function_that_raises_is_an_answer(tmp_path):
    (tmp_path / "raises.py").write_text(RAISES)
    found = answers(plants.resolve(f"{tmp_path / 'raises.py'}:Raises"))
    assert found["finite"].verdict == "no" and "f (raises.py:10) is not finite at x = " in found["finite"].text
    (tmp_path / "fails.py").write_text(RAISES.replace("return -2 * X", "raise OSError('no robot')"))
    answer = answers(plants.resolve(f"{tmp_path / 'fails.py'}:Raises"))["trace"]
    assert answer.verdict == "no" and "OSError: no robot" in answer.text


PIPELINE = """
name = "line"
plant = "line.py:Line"

[parameters]
gain = 3.0

[generate]
adaptation = "frozen"
D = 0.7
D_hat = [[0.7, 0.7]]
nx = 31
box = { x = [-0.5, 0.5] }
input_bounds = [[-4.0, 4.0]]
u0 = [0.25]

[evaluate]
adaptation = "frozen"
X0 = [0.5]
D = 0.7
D_hat = 0.7
case_D_hat = [0.7]
"""
LINE = """
class Line:
    states, inputs, parameters = ("x",), ("u",), {"gain": 0.5}

    def f(x, u, t, p, M):
        return [x.x + u.u]

    def kappa(x, t, p, M):
        return [-p.gain * x.x]
"""


def test_a_pipeline_is_checked_with_its_own_settings(tmp_path):
    """Its parameters stabilise, its box has the range, its estimate takes no V, its input starts at u0."""
    (tmp_path / "line.py").write_text(LINE)
    (tmp_path / "line.toml").write_text(PIPELINE)
    call = CliRunner().invoke(app, ["plants", "check", str(tmp_path / "line.toml"), "--json"])
    found = {row["check"]: row for row in json.loads(call.stdout)["answers"]}
    assert call.exit_code == 0 and found["V"]["text"].endswith("not declared; no law that runs needs it")
    assert found["box"]["text"] == "x in [-0.5, 0.5]" and "eigenvalues of the loop without delay: -2" in str(found)
    assert "31 nodes and a delay of 0.7 s" in found["stiffness"]["text"] and "u0: u = 0.25" in str(found)
    assert found["pipeline"] == {"check": "pipeline", "verdict": "yes", "text": "line fits its plant"}
    (tmp_path / "line.toml").write_text(PIPELINE.replace("[evaluate]", "[evaluate]\nu0 = [1.0, 2.0]"))
    call = CliRunner().invoke(app, ["plants", "check", str(tmp_path / "line.toml"), "--json"])
    wrong = [row for row in json.loads(call.stdout)["answers"] if row["verdict"] == "no"]
    assert call.exit_code == 3 and [row["check"] for row in wrong] == ["pipeline"] and "evaluate.u0" in str(wrong)


class Late:
    """x' = u with u = -x, whose commands come 1 + slope x s late: 1 - D_X f = 1 + slope x under kappa."""

    states, inputs, parameters, box = ("x",), ("u",), {"slope": 0.5}, {"x": (-1.0, 1.0)}
    f = lambda x, u, t, p, M: [u.u]
    kappa = lambda x, t, p, M: [-x.x]
    delay = lambda x, t, p, M: 1 + p.slope * x.x


@pytest.mark.parametrize(("slope", "verdict", "worst"), [(0.5, "yes", 0.5), (0.9, "yes", 0.1), (-0.5, "yes", 0.5)])
def test_the_worst_speed_of_the_commands_on_the_box(slope, verdict, worst):
    answer = answers(Plant("Late", Late, {"slope": slope}))["feasibility"]
    assert answer.verdict == verdict
    assert float(re.findall(r"at least ([\d.]+)", answer.text)[0]) == pytest.approx(worst, abs=0.02)


def test_where_commands_would_overtake_each_other_there_is_a_warning():
    class Fast(Late):
        kappa = lambda x, t, p, M: [-3 * x.x]

    answer = answers(Plant("Fast", Fast))["feasibility"]  # 1 + 1.5 x is negative for x < -2/3, a sixth of the box
    assert answer.verdict == "warn" and "loops that come there cannot go on; shrink box" in answer.text
    assert 0.1 < float(re.findall(r"positive at (\d+)%", answer.text)[0]) / 100 < 0.24


def test_a_delay_that_depends_on_time_is_looked_at_over_a_period():
    class Turning(Late):
        period = 2 * np.pi
        delay = lambda x, t, p, M: 1 + 0.8 * M.sin(t)

    text = answers(Plant("Turning", Turning))["feasibility"].text
    assert float(re.findall(r"at least ([\d.]+)", text)[0]) == pytest.approx(0.2, abs=1e-6)  # 1 - D_t at t = 0


def test_a_negative_delay_is_an_answer_of_no():
    answer = answers(Plant("Late", Late, {"slope": 2.0}))["feasibility"]
    assert answer.verdict == "no" and "expected a finite delay of at least 0 on the box, got -" in answer.text


def test_the_delay_of_a_plant_that_declares_it_is_the_longest_on_its_box():
    found = answers(Plant("Late", Late))
    assert re.fullmatch(r"1\.4\d* s, the longest that the plant declares on the box", found["delay"].text)
    assert found["completeness"].verdict == "yes" and found["V"].text.startswith("not declared; no law")


def test_the_adaptive_loop_is_simulated_with_the_gain_that_suits_the_delay():
    found = answers(plants.resolve("scalar"))["adaptation"]
    assert found.verdict == "yes"
    assert "12 loops" not in found.text
    assert re.match(r"all 9 loops with D = 1 s, gamma = 1, which was derived", found.text)
    assert found.text.endswith("and D_hat(0) = 0.5, 1.5, 2 converge in 40 s")


def test_the_adaptive_loop_is_not_asked_for_where_its_law_does_not_run(tank_file):
    no_V = tank_file("    def V(x, t, p, M):\n        return (x.h - p.level) ** 2\n", "")
    assert "adaptation" not in answers(plants.resolve(no_V))
    assert "adaptation" not in answers(plants.resolve("unicycle"))


BLACK_BOX = """
import numpy as np

class Mass:
    traced = False
    states, inputs, guess = ("q", "w"), ("a",), (0.5, 0.1)
    box = {"q": (-1.0, 2.0), "w": (-1.0, 1.0)}

    def f(X, u, t, p):
        return np.stack([X[..., 1], u[..., 0] - 0.3 * np.sin(X[..., 0] - 1)], axis=-1)

    def kappa(X, t, p):
        return -2 * (X[..., :1] - 1) - 3 * X[..., 1:]
"""


def test_the_V_that_is_offered_for_a_black_box_is_pasted_as_it_is(tmp_path):
    """In columns of X, without a term that is rounding: the rest of w is 1e-17 or so."""
    (tmp_path / "mass.py").write_text(BLACK_BOX)
    plant = plants.resolve(f"{tmp_path / 'mass.py'}:Mass")
    offered = re.search(r"V = (.+) solves the Lyapunov equation", answers(plant)["V"].text)
    assert offered is not None and "- -" not in offered[1] and "e-" not in offered[1] and "x." not in offered[1]
    S = solve_continuous_lyapunov(np.array([[0, 1], [-2.3, -3]]).T, -np.eye(2))
    X = np.random.default_rng(0).uniform(-1, 2, (50, 2))
    e = X - [1.0, 0.0]
    V = eval(f"lambda X, t, p: {offered[1]}")(X, 0.0, None)
    np.testing.assert_allclose(V / V[0], np.einsum("bi,ij,bj->b", e, S, e) / (e[0] @ S @ e[0]), rtol=1e-4)


def test_signs_stand_between_the_terms_of_what_is_offered():
    class Turned:
        states, inputs, guess = ("x", "y"), ("U",), (0.0, 0.0)
        box = {"x": (-3.0, 0.0), "y": (0.0, 1.0)}
        f = lambda x, u, t, p, M: [-(x.x + 1) - 3 * (x.y - 0.5), u.U + 3 * (x.x + 1)]
        kappa = lambda x, t, p, M: [-2 * (x.y - 0.5)]

    plant = Plant("turned", Turned)
    offered = re.search(r"V = (.+) solves the Lyapunov equation", answers(plant)["V"].text)
    assert offered is not None
    assert "(x.x + 1) ** 2 - " in offered[1] and "- -" not in offered[1] and "+ -" not in offered[1]
    assert equilibrium._proportional(_case(plant, offered[1]), *_solution(plant, offered[1]))


def _case(plant, V):
    pasted = Plant("turned", type("Pasted", (plant.declaration,), {"V": eval(f"lambda x, t, p, M: {V}")}))
    return diagnosis.Case(pasted, 1.0, 101, 64)


def _solution(plant, V):
    case = _case(plant, V)
    return solve_continuous_lyapunov(plant.linearised()[0].T, -np.eye(2)), equilibrium._towards_rest(case)


def test_a_V_that_no_law_takes_is_not_asked_for(tank_file, tmp_path):
    """A pipeline with a frozen estimate ends with 0, one with the paper's law with 3."""
    plant = tank_file("(x.h - p.level) ** 2", "x.h - p.level")
    tables = '[{stage}]\nD = 0.3\nadaptation = "{law}"\nu0 = "equilibrium"\n'
    for law, code in (("frozen", 0), ("bresch-pietri-krstic", 3)):
        text = f'plant = "{plant}"\n' + "".join(tables.format(stage=s, law=law) for s in ("generate", "evaluate"))
        (tmp_path / "p.toml").write_text(text + "X0 = [0.7]\n")
        done = CliRunner().invoke(app, ["plants", "check", str(tmp_path / "p.toml")])
        assert done.exit_code == code, done.output


def test_the_input_before_the_start_may_be_asked_for(tmp_path):
    """Where nothing flows in, a tank is empty after 2 (sqrt h - 0) / 0.5 s, from h = 0.5 in 2.83 s."""
    text = """
class Tank:
    states, inputs = ("h",), ("q",)
    box, guess = {"h": (0.5, 0.9)}, (1.0,)

    def f(x, u, t, p, M):
        return [u.q - 0.5 * M.sqrt(x.h)]

    def kappa(x, t, p, M):
        return [0.5 + 0.2 * (1 - x.h)]
"""
    (tmp_path / "tank.py").write_text(text)

    def complete(*flags: str):
        arguments = ["plants", "check", f"{tmp_path}/tank.py:Tank", "--delay", "3", "--json", *flags]
        call = CliRunner().invoke(app, arguments)
        return next(a["verdict"] for a in json.loads(call.stdout)["answers"] if a["check"] == "completeness")

    assert (complete("--u0", "[0]"), complete(), complete("--u0", "[0.4]")) == ("no", "yes", "yes")
    wrong = CliRunner().invoke(app, ["plants", "check", "scalar", "--u0", "equilibrum"])
    assert wrong.exit_code == 2 and "error: --u0: " in wrong.output and "did you mean equilibrium?" in wrong.output


@pytest.mark.parametrize("plant", ["scalar", "lawless.py:Lawless"])
@pytest.mark.parametrize(("cache", "words"), [("open", "only you can write to"), ("./open", "an absolute path")])
def test_a_fault_of_the_machine_is_no_verdict_on_a_plant(tmp_path, cache, words, plant):
    """Neither on a law that is offered to one without."""
    (tmp_path / "lawless.py").write_text(
        "class Lawless:\n    states, inputs, box = ('x',), ('u',), {'x': (-1.0, 1.0)}\n"
        "    def f(x, u, t, p, M):\n        return [M.sin(x.x) + u.u]\n"
    )
    (tmp_path / "open" / "kernels").mkdir(parents=True)
    (tmp_path / "open" / "kernels").chmod(0o777)
    folder = cache if cache.startswith(".") else str(tmp_path / cache)
    done = subprocess.run(
        [sys.executable, "-m", "npred", "plants", "check", plant, "-q"],
        cwd=tmp_path, env=process_environment(NPRED_CACHE=folder), capture_output=True, text=True, timeout=120,
    )  # fmt: skip
    assert done.returncode == 5 and not re.search(r" no  ", done.stdout)  # what was found before is printed
    assert words in done.stderr and done.stderr.count("\n") == 1


def test_each_answer_is_said_before_the_next_question_is_asked(monkeypatch: pytest.MonkeyPatch):
    said: list[str] = []
    last = Check("last", lambda case: ("yes", " ".join(said)))
    monkeypatch.setattr(diagnosis, "QUESTIONS", (*diagnosis.QUESTIONS[:8], last))
    answers = diagnosis.check(plants.resolve("scalar"), 1.0, said=lambda answer: said.append(answer.check))
    assert answers[-1].text == "trace, smooth law, box, finite, delay, equilibrium, stability".replace(",", "")
    assert said == [answer.check for answer in answers]
