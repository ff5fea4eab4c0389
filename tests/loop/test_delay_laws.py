"""Delay laws in a pipeline: by name or from a user's file, in the key by content, mistakes told before a run."""

from pathlib import Path

import numpy as np
import pytest
from jobs import job, tables

from npred import config, plants
from npred.data.dataset import Dataset
from npred.errors import ConfigError
from npred.loop import delay_laws
from npred.loop.adaptation import DelayAdaptation
from npred.pipeline import stage_registry
from npred.stages.generate import generate

LAW = """
import npred

class Towards(npred.DelayLaw):
    def rate(self, plant, X, u, P, D_hat, t):
        return self.gamma * (1.0 - D_hat)
"""


@pytest.fixture
def law(tmp_path: Path) -> str:
    """A law's file; its name for a pipeline."""
    (tmp_path / "my_law.py").write_text(LAW)
    return f"{tmp_path / 'my_law.py'}:Towards"


def loop(**changes) -> config.Loop:
    return config.Loop(**{"gamma": 2.0, "b": 0.5, "bounds": (0.2, 3.0)} | changes)


def question(stage: str, adaptation: str | None) -> dict:
    changed = {} if adaptation is None else {stage: {"adaptation": adaptation}}
    return stage_registry.question(
        stage_registry.Node(stage, None, ()), config.parse(tables(**changed), "tests"), "cpu"
    )


def test_laws_by_name_and_from_a_file(law):
    assert delay_laws.resolve(loop()) == DelayAdaptation(2.0, 0.5, (0.2, 3.0))
    assert delay_laws.resolve(loop(adaptation="frozen")) is None
    own = delay_laws.resolve(loop(adaptation=law))
    assert own is not None
    assert (type(own).__name__, own.gamma, own.b, own.bounds) == ("Towards", 2.0, 0.5, (0.2, 3.0))


@pytest.mark.parametrize("stage", ["generate", "evaluate"])
def test_only_another_law_than_the_papers_enters_the_key_and_by_its_file(stage, law):
    plain, frozen, own = (question(stage, name) for name in (None, "frozen", law))
    assert question(stage, "bresch-pietri-krstic") == plain
    assert "adaptation" not in plain[stage]
    assert frozen[stage] == plain[stage] | {"adaptation": "frozen"}
    path = Path(law.partition(":")[0])
    moved = path.rename(path.parent / "moved.py")
    assert question(stage, f"{moved}:Towards") == own
    moved.write_text(LAW + "# another\n")
    assert question(stage, f"{moved}:Towards") != own


def test_data_are_made_with_the_law(tmp_path, law):
    """D_hat' = gamma (1 - D_hat) from 2 s: after t seconds D_hat = 1 + exp(-gamma t), but for Euler's steps."""
    changes = {"D_hat0": [[2.0, 2.0]], "gamma": 0.5, "samples": 60, "rollouts": 3}
    for name in ("frozen", law):
        run = job(tmp_path, name[-7:], plant="scalar", generate=changes | {"adaptation": name})
        generate.run(run)
        data = Dataset.read(run.folder / "data.h5")
        expected = 2.0 if name == "frozen" else 1.0 + np.exp(-0.5 * data.t)
        np.testing.assert_allclose(data.D_hat, expected, atol=3e-3)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (LAW.replace("(npred.DelayLaw)", ""), "expected a subclass of npred.DelayLaw"),
        (LAW.replace("def rate", "def phi"), "expected a law with rate .* abstract method '?rate'?"),
        (LAW.replace("class Towards", "class Away"), "expected a class Towards, found Away"),
        (LAW.replace("return", "retrun x"), "my_law.py:6: expected Python, got a syntax error"),
        (LAW + "1 / 0\n", "my_law.py:7: failed on import: ZeroDivisionError"),
        (LAW + "    def check(self, plant):\n        raise npred.errors.ConfigError('not this one')\n", "not this one"),
    ],
)
def test_a_file_that_is_no_law_is_told(law, text, message):
    Path(law.partition(":")[0]).write_text(text)
    with pytest.raises(ConfigError, match=message) as caught:
        delay_laws.check(loop(adaptation=law), plants.resolve("scalar"))
    assert "\n" not in str(caught.value)


def test_a_missing_file_is_told():
    with pytest.raises(ConfigError, match=r"adaptation none.py:Law: expected a Python file, found none at none.py"):
        delay_laws.resolve(loop(adaptation="none.py:Law"))
