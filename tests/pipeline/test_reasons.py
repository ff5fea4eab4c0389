"""Why a stage would run: a plant's file that changed, in words and lines."""

from collections.abc import Callable
from pathlib import Path

import pytest
from conftest import TANK, Call, document

from npred.store import Store

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
