"""`npred plants check`: nothing wrong with the built-in plants; each mistake is named, with its line and its cure."""

import json
import re

import numpy as np
import pytest
from follower import Follower, follower
from scipy.linalg import solve_continuous_lyapunov
from typer.testing import CliRunner

from npred import plants
from npred.cli import app
from npred.errors import ConfigError
from npred.plant_check import Answer, check, rest, settled
from npred.plants import Plant

TANK = """
class Tank:
    states = ("h",)
    inputs = ("q",)
    parameters = {"outflow": 0.5, "level": 1.0}
    box = {"h": (0.5, 2.0)}
    guess = (0.8,)

    def f(x, u, t, p, M):
        return [u.q - p.outflow * M.sqrt(x.h)]

    def kappa(x, t, p, M):
        return [p.outflow * M.sqrt(x.h) + p.level - x.h]

    def V(x, t, p, M):
        return (x.h - p.level) ** 2
"""
QUESTIONS = [
    *("trace", "smooth law", "box", "finite", "equilibrium", "stability", "V", "jacobians", "stiffness", "completeness")
]


@pytest.fixture
def tank(tmp_path):
    """The name of a plant file with a piece of the tank replaced."""

    def make(old="", new=""):
        assert old in TANK
        (tmp_path / "my_plant.py").write_text(TANK.replace(old, new) if old else TANK)
        return f"{tmp_path / 'my_plant.py'}:Tank"

    return make


def answers(plant: Plant, **settings) -> dict:
    return {answer.check: answer for answer in check(plant, **settings)}


@pytest.mark.parametrize("name", [row["name"] for row in plants.named() if plants.resolve(row["name"]).rests])
def test_built_in_plants_have_no_answer_of_no(name):
    found = check(plants.resolve(name), delay=0.5)
    assert settled(found)
    assert [answer.check for answer in found] == QUESTIONS


@pytest.mark.parametrize(
    ("old", "new", "question", "words"),
    [
        ("[u.q - p", "[u.q, u.q - p", "trace", r"Tank: f \(my_plant.py:9\) expected to return 1 .*, got 2; return"),
        ("[p.outflow * M.sqrt(x.h) +", "[u.q +", "trace", "kappa failed at my_plant.py:13: .*only f knows the inputs"),
        ("- p.outflow *", "- p.drain *", "trace", "f failed at my_plant.py:10: .*expected one of outflow, level"),
        ('box = {"h": (0.5, 2.0)}', "box = {}", "box", 'plant Tank: box has no range for h; add box = {"h":'),
        ("(0.5, 2.0)", "(-0.5, 2.0)", "finite", r"kappa \(my_plant.py:12\) is not finite at h = -0.\d+, .*shrink box"),
        ("(x.h - p.level) ** 2", "x.h - p.level", "finite", r"V \(my_plant.py:15\) expected at least 0 .*, got -0.\d+"),
        ("+ p.level - x.h", "+ 1 + x.h**2", "equilibrium", r"py:12\) leads to no equilibrium .* `guess`"),
        ("guess =", "input_bounds = [(0.0, 0.3)]\n    guess =", "equilibrium", "rests with q = 0.5, outside input_b"),
        ("+ p.level - x.h", "+ x.h - p.level", "stability", r"py:12\) does not stabilise .*: eigenvalues 1 at"),
        ("+ p.level - x.h", "+ M.sqrt(M.abs(x.h - 1))", "stability", "no derivative at the equilibrium; guard"),
        ("* M.sqrt(x.h)]\n\n    def k", "* M.sqrt(x.h) + x.h**9]\n\n    def k", "completeness", "py:9.: the open"),
        ("[u.q - p.", "[u.q - 900 * (x.h - 1) - p.", "stiffness", "= 9 with .* expected below 2; take 45. nodes or"),
    ],
)  # fmt: skip
def test_a_mistake_is_one_answer_of_no_with_its_line_and_cure(tank, old, new, question, words):
    answer = answers(plants.resolve(tank(old, new)))[question]
    assert answer.verdict == "no"
    assert "\n" not in answer.text
    assert re.search(words, answer.text), answer.text


def test_a_plant_without_a_V_is_offered_one(tank):
    """x' = -x about 1: V = (h - 1)² / 2 solves the Lyapunov equation; declared, it satisfies."""
    name = tank("    def V(x, t, p, M):\n        return (x.h - p.level) ** 2\n", "")
    found = answers(plants.resolve(name))["V"]
    assert found.verdict == "no" and "plant Tank: found no V(x, t, p, M)" in found.text
    offered = re.search(r"V = (.+) solves the Lyapunov equation, and falls at 100% of \d+ states", found.text)
    assert offered is not None
    written = re.sub(r"\bh\b", "x.h", offered[1]) if "x.h" not in offered[1] else offered[1]
    again = plants.resolve(tank("return (x.h - p.level) ** 2", f"return {written}"))
    assert answers(again)["V"].verdict == "yes"


def test_a_plant_that_tracks_without_a_V_is_told():
    class Follower:
        states, inputs, box = ("x",), ("u",), {"x": (-1.0, 1.0)}

        def f(x, u, t, p, M):
            return [u.u]

        def kappa(x, t, p, M):
            return [M.cos(t) - (x.x - M.sin(t))]

        def reference(t, p, M):
            return [M.sin(t)]

    found = answers(Plant("follower", Follower))
    assert found["reference"].verdict == "yes" and found["V"].verdict == "no"


def test_what_cannot_be_asked_is_not_asked(tank):
    assert list(answers(plants.resolve(tank("[u.q - p", "[u.q, u.q - p")))) == ["trace"]
    assert list(answers(plants.resolve(tank('box = {"h": (0.5, 2.0)}', "box = {}")))) == [
        *("trace", "smooth law", "box", "equilibrium", "stability")
    ]


@pytest.mark.parametrize(
    ("law", "kinks"),
    [
        ("M.sign(p.level - x.h)", "sign: a law of signs chatters"),
        ("M.where(x.h < 1, 1 - x.h, 0.0) + M.maximum(x.h, 0.2)", "maximum, where: its derivative may jump"),
    ],
)
def test_kinks_of_the_law_are_a_warning(tank, law, kinks):
    plant = plants.resolve(tank("p.outflow * M.sqrt(x.h) + p.level - x.h", law))
    answer = answers(plant)["smooth law"]
    assert answer.verdict == "warn"
    assert kinks in answer.text


def test_a_choice_by_a_parameter_is_no_kink(tank):
    plant = plants.resolve(tank("+ p.level - x.h", "+ M.where(p.level > 0.5, p.level, 1.0) - x.h"))
    assert answers(plant)["smooth law"].verdict == "yes"


def test_a_V_that_rises_is_a_warning_with_a_better_one():
    """x' = v, v' = -x - v: x² rises where x v > 0."""

    class Spring:
        states, inputs = ("x", "v"), ("F",)
        box = {"x": (-1.0, 1.0), "v": (-1.0, 1.0)}

        def f(x, u, t, p, M):
            return [x.v, u.F - x.x]

        def kappa(x, t, p, M):
            return [-x.v]

        def V(x, t, p, M):
            return x.x**2

    answer = answers(Plant("Spring", Spring))["V"]
    assert answer.verdict == "warn"
    assert "V = 1.5 * x.x ** 2 + 1 * x.x * x.v + 1 * x.v ** 2 solves" in answer.text
    assert answer.text.endswith("falls at 100% of 768 states")


def test_a_V_of_zero_gets_a_better_one(tank):
    answer = answers(plants.resolve(tank("(x.h - p.level) ** 2", "0.0")))["V"]
    assert answer.verdict == "warn"
    assert "V = 0.5 * (x.h - 1) ** 2 solves" in answer.text


def test_lyapunov_equation():
    A = np.random.default_rng(0).normal(size=(4, 4)) - 5 * np.eye(4)
    np.testing.assert_allclose(rest.lyapunov(A), solve_continuous_lyapunov(A.T, -np.eye(4)), rtol=1e-10)


def test_a_plant_that_tracks_has_no_equilibrium_and_that_is_no_failure(tank):
    found = answers(plants.resolve(tank("+ p.level - x.h", "+ p.level + M.sin(t) - x.h")))
    assert found["reference"].verdict == "warn"
    assert "stability" not in found and "completeness" in found


def test_a_reference_is_compared_with_the_loop_of_the_law():
    assert answers(follower())["reference"].verdict == "yes"
    bent = type("Bent", (Follower,), {"reference": staticmethod(lambda t, p, M: [1.1 * p.A * M.sin(p.w * t)])})
    answer = answers(Plant("Bent", bent))["reference"]
    assert answer.verdict == "no" and "is no trajectory of f with kappa" in answer.text


@pytest.mark.parametrize("wrong", ["jacobians", "kappa_jacobian"])
@pytest.mark.parametrize("factor", [1.001, np.nan])
def test_a_wrong_derivative_is_found_and_stiffness_not_asked(tank, monkeypatch, wrong, factor):
    plant = plants.resolve(tank())
    right = getattr(plant, wrong)
    _ = plant.equilibrium
    monkeypatch.setattr(rest, "stability", lambda case: Answer("stability", "no", "not asked here"))
    monkeypatch.setattr(plant, wrong, lambda *at: factor * np.array(right(*at)))
    found = answers(plant)
    assert found["jacobians"].verdict == "no"
    assert "stiffness" not in found and found["completeness"].verdict == "yes"


def test_a_kink_on_the_box_is_no_wrong_derivative():
    class Bent:
        states, inputs, box = ("h",), ("q",), {"h": (-1e-4, 1e-4)}

        def f(x, u, t, p, M):
            return [u.q - M.abs(x.h)]

        def kappa(x, t, p, M):
            return [-2 * x.h]

        def V(x, t, p, M):
            return x.h**2

    plant = Plant("Bent", Bent)
    assert answers(plant)["jacobians"].verdict == "yes"


@pytest.mark.parametrize("settings", [{"delay": 0.0}, {"delay": np.inf}, {"nodes": 1}])
def test_settings_that_make_no_sense_are_told(settings):
    with pytest.raises(ConfigError, match=f"{next(iter(settings))}: expected"):
        check(plants.resolve("scalar"), **settings)


def test_the_command_says_it_to_people_and_programs(tank):
    def call(*arguments):
        return CliRunner().invoke(app, ["plants", "check", *arguments])

    good = call(tank(), "--json")
    assert good.exit_code == 0
    document = json.loads(good.stdout)
    assert document["fine"] is True
    assert [answer["check"] for answer in document["answers"]] == QUESTIONS
    assert "stability" in call(tank()).stdout
    bad = call(tank("+ p.level - x.h", "+ x.h - p.level"), "--json")
    assert bad.exit_code == 3
    assert json.loads(bad.stdout)["fine"] is False
    (line,) = bad.stderr.splitlines()
    assert "got stability" in line
    assert call("nonesuch").exit_code == 2
    assert call("scalar", "--delay", "-1").exit_code == 2


def test_V_is_looked_at_on_all_sides_of_rest():
    """The paper's V falls in its box, which lies on one side of rest, and rises close to rest on another side."""
    found = answers(plants.resolve("activator_repressor"))
    assert found["V"].verdict == "warn" and "falls at 100% of 768 states" in found["V"].text
