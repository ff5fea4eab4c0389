"""Which pipeline is meant: a path, a name that ships with npred, the environment's, or the only one here."""

import subprocess
import sys
import zipfile
from pathlib import Path

import pytest
from conftest import HERE, process_environment

from npred.base import defaults
from npred.base.errors import ConfigError
from npred.lab import config

SHIPPED = HERE.parent / "pipeline"


@pytest.fixture(autouse=True)
def elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty folder, which is the current one."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("NPRED_PIPELINE", raising=False)
    return tmp_path


def test_every_pipeline_of_the_repository_has_its_name_anywhere():
    assert defaults.shipped() == {path.stem: path for path in SHIPPED.glob("*.toml")}
    assert config.load(defaults.pipeline("smoke")).name == "smoke"


def test_a_file_comes_before_a_name_and_a_folder_does_not():
    Path("smoke").mkdir()
    assert defaults.pipeline("smoke") == SHIPPED / "smoke.toml"
    Path("paper").write_text('plant = "scalar"')
    assert defaults.pipeline("paper") == Path("paper")


def test_the_default_is_the_environments_then_the_repositorys_then_the_only_one_here(monkeypatch: pytest.MonkeyPatch):
    Path("pyproject.toml").touch()
    Path("tank.toml").touch()
    assert defaults.pipeline() == Path("tank.toml")
    Path("pipeline").mkdir()
    Path("pipeline/paper.toml").touch()
    assert defaults.pipeline() == defaults.PIPELINE
    monkeypatch.setenv("NPRED_PIPELINE", "smoke")
    assert defaults.pipeline() == SHIPPED / "smoke.toml"
    assert defaults.pipeline("tank.toml") == Path("tank.toml")
    monkeypatch.setenv("NPRED_PIPELINE", "")
    assert defaults.pipeline() == defaults.PIPELINE


@pytest.mark.parametrize(("files", "seen"), [([], "got no TOML file"), (["a.toml", "b.toml"], "got a.toml, b.toml")])
def test_none_or_several_are_said(files: list[str], seen: str):
    for name in files:
        Path(name).touch()
    with pytest.raises(ConfigError, match=f"{seen}; name a pipeline, as in npred run smoke"):
        defaults.pipeline()


def test_a_name_that_is_none_is_answered_with_the_closest():
    Path("tank.toml").touch()
    for name, near in (("smoek", "smoke"), ("tank", "tank.toml")):
        with pytest.raises(ConfigError, match=f"{name}: expected a pipeline file, or one of .*did you mean {near}"):
            config.load(defaults.pipeline(name))


@pytest.mark.slow
def test_the_wheel_has_the_pipelines_and_finds_them_outside_the_repository(tmp_path: Path):
    """Unpacked and not installed, which needs no packages and no network; the build needs hatchling."""
    pytest.importorskip("hatchling")
    build = "from hatchling.build import build_wheel; import sys; print(build_wheel(sys.argv[1]))"
    made = subprocess.run(
        [sys.executable, "-c", build, str(tmp_path)], cwd=HERE.parent, capture_output=True, text=True, check=True
    )
    with zipfile.ZipFile(tmp_path / made.stdout.split()[-1]) as wheel:
        wheel.extractall(tmp_path / "site")
    run = [sys.executable, "-m", "npred", "run", "smoke", "--dry-run"]
    environment = process_environment(PYTHONPATH=str(tmp_path / "site"))
    done = subprocess.run(run, cwd=tmp_path, env=environment, capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")
    assert not (tmp_path / "site" / "pipeline").exists()
    assert {path.name for path in (tmp_path / "site/npred/pipelines").iterdir()} == {p.name for p in SHIPPED.iterdir()}
