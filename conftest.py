"""What several test modules share: a small pipeline file, fake stages, npred as a process."""

import json
import os
import subprocess
import sys
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import browsers
import fake_stages
import pytest
import tank
from filelock import FileLock
from hypothesis import HealthCheck, settings
from typer.testing import CliRunner, Result

from npred import plants
from npred.cli import app
from npred.identification import fit
from npred.kernels import compiler
from npred.lab.config import Pipeline
from npred.lab.report.figures.figure import Panel, inline
from npred.lab.report.figures.style import SCREEN, medium
from npred.lab.scheduler.plan import STAGES, Node, Planner
from npred.lab.stages.report import html_page
from npred.lab.store import Store
from npred.loop import engine

Call = Callable[..., Result]
if "NPRED_TEST_GPU" not in os.environ:
    os.environ["CUDA_VISIBLE_DEVICES"] = ""  # the tests' results and keys are the CPU's, also where there is a GPU
OWN_SETTINGS = ("NPRED_STORE", "NPRED_PIPELINE", "NPRED_EXECUTOR", "NPRED_QUIET")  # of who runs the tests
ROOT = Path(__file__).parent
HERE = ROOT / "tests"
# How long a draw takes says what else the machine does, not what the code does.
settings.register_profile("npred", deadline=None, derandomize=True, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("npred")
# The modules that take longest, from the longest on
LONGEST = (
    "test_docs", "test_self_test", "test_identify", "test_stack", "test_units_of_time", "test_chain",
    "test_plant_check", "test_c_stamps", "test_onnx", "test_c_controller", "test_c_compilers", "test_fmu",
    "test_recording_to_pipeline", "test_experiments", "test_cortex_m", "test_other_systems", "test_formula",
    "test_models", "test_without_extras",
)  # fmt: skip
QUICK = tuple("-O1" if flag == "-O3" else flag for flag in compiler.FLAGS)
TANK = """
class Tank:
    states, inputs, guess, box = ("h",), ("q",), (1.0,), {"h": (0.5, 2.0)}

    def f(x, u, t, p, M):
        return [u.q - x.h]

    def kappa(x, t, p, M):
        return [2 - x.h]

    def V(x, t, p, M):
        return (x.h - 1) ** 2
"""
TINY = """
name = "tiny"
plant = "scalar"
[generate]
samples = 500
rollouts = 50
[train]
models = ["deeponet", "fno"]
[train.deeponet]
epochs = 30
snapshots = [7]
[train.fno]
epochs = 100
lr = 0.002
[evaluate]
X0 = [0.5]
[bench]
calls = 1000
"""


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """The longest modules first, then those with the most slow tests: side by side, none runs alone at the end.

    All workers need one order, so it depends on nothing that another run may write meanwhile.
    """
    slow = Counter(item.path for item in items if item.get_closest_marker("slow"))
    places = {name: place for place, name in enumerate(LONGEST)}
    items.sort(key=lambda item: (places.get(item.path.stem, len(LONGEST)), -slow[item.path]))


@pytest.fixture(autouse=True)
def _no_settings_of_ones_own(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in OWN_SETTINGS:
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr("npred.base.progress.PATIENCE", 1e6)  # what takes long differs from machine to machine
    monkeypatch.setattr("npred.base.progress._said", set())  # a line is said once by a process


def sketched(panel: Panel, prefix: str) -> str:
    """A panel whose curves are put on axes, and neither laid out nor written: that takes most of a page's time."""
    from matplotlib.figure import Figure

    with medium(SCREEN):
        panel.draw(Figure().subplots())
    return "<svg></svg>"


@pytest.fixture(scope="session", autouse=True)
def _sketches() -> Iterator[None]:
    """The pages of a test that does not ask for `drawn`, in this process."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(html_page, "inline", sketched)
        yield


@contextmanager
def drawings() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(html_page, "inline", inline)
        yield


@pytest.fixture
def drawn() -> Iterator[None]:
    """Pages have their figures: those of the report, of the answer of identify, and of docs/report.md."""
    with drawings():
        yield


@pytest.fixture(scope="module")
def quickly_compiled() -> Iterator[None]:
    """Kernels of this process are optimised less: for plants that no other test has, and many of them."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(compiler, "FLAGS", QUICK)
        yield
    for kept in (engine.loaded, plants.restored, plants.remade, fit._joining):  # other tests compile theirs
        kept.cache_clear()


@pytest.fixture
def pipeline(tmp_path: Path) -> Path:
    """A pipeline file beside an empty store."""
    path = tmp_path / "tiny.toml"
    path.write_text(TINY)
    return path


@pytest.fixture
def tank_file(tmp_path: Path) -> Callable[..., str]:
    """A plant of a user's file, with a piece of the tank's text replaced; the name by which it is resolved."""

    def write(old: str = "", new: str = "", text: str = tank.TANK) -> str:
        assert old in text
        (tmp_path / "my_plant.py").write_text(text.replace(old, new) if old else text)
        return f"{tmp_path / 'my_plant.py'}:Tank"

    return write


@pytest.fixture
def package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[..., None]]:
    """Install a package that registers parts, plants by default, as `pip install` leaves it."""

    def install(entries: str, text: str = TANK, group: str = "npred.plants") -> None:
        (tmp_path / "shed_of_tanks.py").write_text(text)
        info = tmp_path / "shed_of_tanks-1.0.dist-info"
        info.mkdir()
        (info / "METADATA").write_text("Metadata-Version: 2.1\nName: shed-of-tanks\nVersion: 1.0\n")
        (info / "entry_points.txt").write_text(f"[{group}]\n{entries}\n")

    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "shed_of_tanks", raising=False)
    yield install
    sys.modules.pop("shed_of_tanks", None)


@pytest.fixture
def fakes(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    """Fake stages in the table; the file that gets a line for each of their runs."""
    table = dict(STAGES)
    fake_stages.install(table)
    for name, stage in table.items():
        monkeypatch.setitem(STAGES, name, stage)
    log = tmp_path / "log"
    log.touch()
    monkeypatch.setenv("FAKE_LOG", str(log))
    return log


@pytest.fixture
def call(fakes: Path, pipeline: Path, monkeypatch: pytest.MonkeyPatch) -> Call:
    """A command with fake stages, in this process, beside the pipeline file tiny.toml."""
    monkeypatch.chdir(pipeline.parent)
    monkeypatch.setenv("COLUMNS", "200")
    return lambda *arguments: CliRunner().invoke(app, [str(argument) for argument in arguments])


def document(result: Result, code: int = 0) -> Any:
    """The JSON document that a command printed."""
    assert result.exit_code == code, result.output
    return json.loads(result.stdout)


def one_line(result: Result, code: int) -> str:
    """The one line that a command failed with."""
    assert result.exit_code == code, result.output
    (line,) = result.stderr.splitlines()
    if result.stdout:  # with --json, a document that says the same
        assert json.loads(result.stdout)["error"]["message"] == line.removeprefix("error: ")
    return line


@pytest.fixture
def npred(tmp_path: Path) -> Callable[..., subprocess.CompletedProcess[str]]:
    """`npred` with fake stages as a process of its own, in tmp_path."""

    def call(*arguments: str, **environment: str) -> subprocess.CompletedProcess[str]:
        command = [sys.executable, str(HERE / "fake_stages.py"), *arguments]
        return subprocess.run(
            command, cwd=tmp_path, env=process_environment(**environment), capture_output=True, text=True, timeout=60
        )

    return call


def process_environment(**more: str) -> dict[str, str]:
    """The environment of a child that imports npred from this checkout."""
    paths = os.pathsep.join(map(str, (ROOT, ROOT / "siblings", HERE)))
    kept = {name: value for name, value in os.environ.items() if name not in OWN_SETTINGS}
    return kept | {"PYTHONPATH": paths, "COLUMNS": "200", "OMP_NUM_THREADS": "1", "NPRED_QUIET": "1"} | more


@pytest.fixture(scope="session")
def reported(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, Any]]:
    """A tiny pipeline's file, and the outcomes of a run of all stages into `store` beside it.

    Tests side by side have one folder: the process that comes first computes, the others find all done.
    """
    import reported

    base = tmp_path_factory.getbasetemp()
    folder = (base.parent if "PYTEST_XDIST_WORKER" in os.environ else base) / "reported"
    folder.mkdir(exist_ok=True)
    with FileLock(folder / "lock"), drawings():
        return reported.run(folder)


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    """Chromium, headless."""
    with browsers.chromium() as opened:
        yield opened


def settings_of(node: Node, config: Pipeline, device: str = "cpu") -> dict[str, Any]:
    """What the key of a node holds besides its inputs."""
    return Planner(config, Store(Path()), device).settings(node)
