"""What the shell offers where Tab is pressed: asked as bash asks, of this process."""

import json
from pathlib import Path

import pytest
from conftest import Call, document
from typer.testing import CliRunner

from npred.cli import app


@pytest.fixture
def offered(call: Call):
    """The words that complete a line."""

    def complete(line: str) -> list[str]:
        words = line.split(" ")
        asked = {"_NPRED_COMPLETE": "complete_bash", "COMP_WORDS": line, "COMP_CWORD": str(len(words) - 1)}
        done = CliRunner().invoke(app, prog_name="npred", env=asked)
        assert (done.exit_code, done.stderr) == (0, ""), done.output
        return done.stdout.split()

    return complete


def test_commands_pipelines_and_plants(offered):
    assert offered("npred gene") == ["generate"]
    assert offered("npred run s") == ["scalar", "slow_unicycle", "smoke", "state_delay", "strict_feedforward3"]
    assert offered("npred run t") == ["time_delay", "tiny.toml"]
    Path("pyproject.toml").touch()
    assert offered("npred run py") == []
    Path("deep").mkdir()
    Path("deep/one.toml").write_text("\x00")
    assert offered("npred status deep/") == ["deep/one.toml"]
    assert offered("npred plants check cart") == ["cart_pole"]
    assert offered("npred reproduce horizon") == ["horizon_loop"]


def test_keys_and_the_value_of_the_only_one_that_fits(offered):
    assert offered("npred run --set train.fno.wi") == ["train.fno.width=", "train.fno.width=32"]
    assert {"train.fno.width", "train.deeponet.basis", "seed", "evaluate.X0"} <= set(offered("npred run --set "))
    assert offered("npred why train tiny.toml --set train.deeponet.epochs=")[1:] == ["train.deeponet.epochs=30"]
    assert offered("npred run --set generate.predictor=h") == ["generate.predictor=heun"]
    assert offered("npred run --set generate.D")[:2] == ["generate.D", "generate.D_hat0"]  # a key and the start of one
    assert offered("npred sweep --set no.such") == []


def test_a_pipeline_that_is_broken_offers_its_keys_all_the_same(offered):
    Path("tiny.toml").write_text("[[[")
    assert offered("npred run tiny.toml --set bench.calls") == ["bench.calls=", "bench.calls=20000"]


def test_stages_networks_and_words(offered):
    stages = ["identify", "generate", "train", "evaluate", "certify", "bench", "report"]
    assert offered("npred why ") == [*stages, "deeponet", "fno"]
    assert offered("npred train --model f") == ["fno", "fno_gru"]
    assert offered("npred report --figures ieee") == ["ieee1", "ieee2"]
    assert offered("npred sweep --to b") == ["bench"]


def test_results_of_the_store(offered, call: Call):
    assert offered("npred show ") == []
    made = {row["stage"]: row["key"] for row in document(call("generate", "tiny.toml", "--json"))["stages"]}
    name = f"generate/{made['generate'][:12]}"
    for line in ("npred show ", "npred diff gen", "npred export-artifact ", "npred export onnx "):
        assert offered(line) == [name]
    assert offered("npred show --store elsewhere ") == []


def test_a_store_that_cannot_be_read_offers_nothing(offered):
    Path("artifacts/generate").mkdir(parents=True)
    Path(f"artifacts/generate/{'0' * 64}").write_text(json.dumps([]))
    assert offered("npred show ") == []


def test_what_a_pipeline_says_of_itself_is_text(call: Call):
    """For a shell that shows it beside the name; typer takes it for rich's markup."""
    Path("tiny.toml").write_text("# as [evaluate], [/but] shorter\n")
    asked = {"_NPRED_COMPLETE": "complete_fish", "_TYPER_COMPLETE_ARGS": "npred run ti"}
    asked |= {"_TYPER_COMPLETE_FISH_ACTION": "get-args"}
    done = CliRunner().invoke(app, prog_name="npred", env=asked)
    assert "tiny.toml\tas [evaluate], [/but] shorter" in done.stdout.splitlines()
