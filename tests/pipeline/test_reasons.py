"""Why a stage would run: a plant's file that changed, in words and lines."""

from collections.abc import Callable
from pathlib import Path

import pytest
from conftest import TANK, Call, document

from npred.pipeline import reasons
from npred.store import Artifact, Question, Store
from npred.store.manifest import Manifest

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


def test_another_formula_is_told_in_its_lines(edit, call, pipeline):
    reasons = edit("tank.py", "2 - x.h", "3 - x.h")
    assert reasons["generate"] == "kappa changed in tank.py: return [2 - x.h] -> return [3 - x.h]"
    assert reasons["fno"].startswith(f"stale: {reasons['generate']}; upstream generate will run")
    assert call("why", "generate", pipeline, "--store", "store").stdout == f"generate: {reasons['generate']}\n"


def test_a_law_of_ones_own_is_known_by_its_file(edit):
    reasons = edit("law.py", "0.0 * D_hat", "1.0 * D_hat")
    changed = "evaluate.adaptation changed in law.py: return 0.0 * D_hat -> return 1.0 * D_hat"
    assert (reasons["generate"], reasons["evaluate"]) == ("up to date", changed)


def test_diff_tells_the_lines_too(edit, call, pipeline):
    edit("tank.py", "2 - x.h", "3 - x.h")
    assert call("generate", pipeline, "--store", "store").exit_code == 0
    after, before = (a.name for a in Store(pipeline.parent / "store").artifacts()[::-1] if "generate" in a.name)
    said = document(call("diff", before, after, "--store", "store", "--json"))["question"]
    assert said == ["kappa changed in tank.py: return [2 - x.h] -> return [3 - x.h]"]


def test_each_result_has_the_code_that_it_was_made_with(edit, call, pipeline):
    edit("tank.py", "return [2 - x.h]", "return [2 - x.h]  # the law")
    sources = {a.manifest.question.stage: a.manifest.sources for a in Store(pipeline.parent / "store").artifacts()}
    assert sources["report"]["plant"].text == TANK
    assert sources["evaluate"]["evaluate.adaptation"].text == LAW and "evaluate.adaptation" not in sources["generate"]
    assert "plant: tank.py, its text in manifest.json" in call("show", "generate", "--store", "store").stdout


def test_the_words_are_of_the_closest_result_and_are_made_for_no_other(monkeypatch):
    """Each costs time, and a store has thousands of results."""
    said = []
    monkeypatch.setattr(reasons, "code_change", lambda *of: said.append(of) or "changed")
    made = [
        Artifact(Path(), Manifest.model_construct(question=asked(source, seed), pipeline="p", sources={}))
        for source in ("a", "b") for seed in range(50)
    ]  # fmt: skip
    assert reasons.reason(asked("c", 7), "p", made) == "changed"
    assert [before.count("a") for before in said] == [0] and len(said) == 1


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
