"""What enters the question of a stage, and why it would run: the keys that differ."""

import re
from collections.abc import Callable
from pathlib import Path

import pytest
from conftest import TANK, Call, document, settings_of

from npred.lab import config
from npred.lab.scheduler import reasons
from npred.lab.scheduler.plan import nodes, usual
from npred.lab.store import Artifact, Question, Store
from npred.lab.store.manifest import Manifest

LAW = """
import npred

class Law(npred.DelayLaw):
    def rate(self, plant, X, u, P, D_hat, t):
        return 0.0 * D_hat
"""


@pytest.fixture
def edit(call: Call, pipeline: Path) -> Callable[..., dict[str, str]]:
    """Run all stages with a plant and a law of one's own, change the file, and get the reason of each stage."""
    folder = pipeline.parent
    (folder / "tank.py").write_text(TANK)
    (folder / "law.py").write_text(LAW)
    text = pipeline.read_text().replace('"scalar"', '"tank.py:Tank"')
    pipeline.write_text(text.replace("[evaluate]", '[evaluate]\nadaptation = "law.py:Law"'))

    def reasons(file: str, old: str, new: str) -> dict[str, str]:
        assert call("run", pipeline, "--store", "store").exit_code == 0
        before = (folder / file).read_text()
        assert old in before
        (folder / file).write_text(before.replace(old, new))
        stages = document(call("status", pipeline, "--store", "store", "--json"))["stages"]
        return {stage.get("model", stage["stage"]): stage["reason"] for stage in stages}

    return reasons


@pytest.mark.parametrize(
    ("old", "new"), [("class Tank", "# a remark\nclass Tank"), ("return [2 - x.h]", 'return [\n2 - x.h]  # "law"')]
)
def test_a_remark_runs_nothing(edit, old, new):
    assert set(edit("tank.py", old, new).values()) == {"up to date"}


DIGESTS = "[0-9a-f]{12} -> [0-9a-f]{12}"


def test_another_formula_is_told_by_its_function(edit, call, pipeline):
    reasons = edit("tank.py", "2 - x.h", "3 - x.h")
    assert re.fullmatch(f"plant.program.kappa: {DIGESTS}", reasons["generate"])
    assert reasons["fno"].startswith(f"stale: {reasons['generate']}; generate runs first")
    assert call("why", "generate", pipeline, "--store", "store").stdout == f"generate: {reasons['generate']}\n"


def test_a_law_of_ones_own_is_known_by_its_file(edit):
    reasons = edit("law.py", "0.0 * D_hat", "1.0 * D_hat")
    assert reasons["generate"] == "up to date"
    assert re.fullmatch(f"evaluate.adaptation.source: {DIGESTS}", reasons["evaluate"])


def test_diff_tells_the_same(edit, call, pipeline):
    reasons = edit("tank.py", "2 - x.h", "3 - x.h")
    assert call("generate", pipeline, "--store", "store").exit_code == 0
    after, before = (a.name for a in Store(pipeline.parent / "store").artifacts()[::-1] if "generate" in a.name)
    said = document(call("diff", before, after, "--store", "store", "--json"))["question"]
    assert said == [reasons["generate"]]


def test_the_closest_of_many_results_is_the_most_recent_of_those_with_the_fewest_differences():
    questions = [asked(source, seed) for source in ("a" * 64, "b" * 64) for seed in range(50)]
    made = [Artifact(Path(), Manifest.model_construct(question=each, pipeline="p")) for each in questions]
    assert reasons.reason(asked("c" * 64, 7), "p", made) == f"plant.program.source: {'b' * 12} -> {'c' * 12}"


def asked(source, seed):
    program = {"program": {"source": source}, "name": "p"}
    return Question(stage="generate", version=1, model=None, config={"plant": program, "seed": seed}, inputs={})


@pytest.mark.parametrize(
    ("before", "after", "changed"),
    [
        ({"a": {"b": 1, "c": 2}}, {"a": {"b": 1, "c": 3}}, ["a.c: 2 -> 3"]),
        ({"a": 1}, {"a": 1.0}, ["a: 1 -> 1.0"]),
        ({"a": True}, {"a": 1}, ["a: true -> 1"]),
        ({"a": {"b": 1}}, {"a": 2}, ["a.b: 1 -> unset", "a: unset -> 2"]),
        ({"a": {}}, {}, []),
        ({"a": [1, 2]}, {"a": [2, 1], "b\n": "\x1b"}, ["a: [1, 2] -> [2, 1]", r'b\n: unset -> "\u001b"']),
        ({"b": 1, "a": 2}, {"a": 2, "b": 1}, []),
    ],
)
def test_changes_are_those_of_leaves(before, after, changed):
    assert reasons.changes(before, after) == changed


LAW_OF_A_FILE = """
from npred import DelayLaw

class Own(DelayLaw):
    def rate(self, plant, X, u, P, D_hat, t):
        return {factor} * D_hat  # {comment}
"""


def evaluate_question(**tables):
    made = config.parse({"plant": "scalar"} | tables, "tests")
    node = next(node for node in nodes(made, usual(made)) if node.name == "evaluate")
    return settings_of(node, made)["evaluate"]


def test_each_key_of_a_real_loop_enters_the_question():
    plain = evaluate_question()
    defaults = {
        "actuator": "measured",
        "measurement": {"relative_noise": 0.0},
        "disturbance": {"omega": 1.0},
        "truth": {},
    }
    assert evaluate_question(evaluate=defaults | {"scenarios": []}) == plain
    for key, value in {"actuator": "history", "measurement": {"relative_noise": 0.1}, "truth": {"a": 0.6},
                       "disturbance": {"amplitude": 0.1}, "scenarios": [{"name": "a"}]}.items():  # fmt: skip
        changed = evaluate_question(evaluate={key: value})
        assert {name for name in changed if changed[name] != plain[name]} == {key}


def test_the_law_of_a_scenario_enters_by_what_its_file_holds(tmp_path):
    answers = []
    for folder, factor, comment in (("a", 0, "one"), ("b", 0, "another"), ("c", 1, "one")):
        path = tmp_path / folder / "own.py"
        path.parent.mkdir()
        path.write_text(LAW_OF_A_FILE.format(factor=factor, comment=comment))
        scenario = {"name": "own law", "adaptation": f"{path}:Own"}
        answers.append(evaluate_question(evaluate={"scenarios": [scenario]})["scenarios"])
    assert answers[0] == answers[1] != answers[2]
