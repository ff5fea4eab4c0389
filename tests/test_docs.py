"""What README and docs say: their Python runs, their commands exist, and the pages build without a warning.

A block whose first line is `# name.py` or `# name.toml` is that file. A block after a comment `<!-- not run: … -->` is
not run. The tests marked slow run every other block in the order of its page, on pipelines of the smallest sizes.
"""

import importlib
import json
import re
import shlex
import subprocess
import sys
import tomllib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import pytest
import typer.main
from conftest import HERE, process_environment
from docs_pages import built, dead
from typer.testing import CliRunner

from npred.cli import app
from npred.exports import FORMATS
from npred.lab import config
from npred.loop.measurement import Sensors
from npred.loop.safety import SafetyFilter
from npred.loop.timing import ControlClock
from npred_experiments import EXPERIMENTS
from npred_experiments.experiment import load

ROOT = HERE.parent
GENERATED = {"commands.md", "configuration.md", "named_plants.md", "results.md"}
PAGES = [
    *(ROOT / name for name in ("README.md", "CONTRIBUTING.md", "benchmarks/README.md")),
    *sorted(page for page in (ROOT / "docs").rglob("*.md") if page.name not in GENERATED),
]
BLOCK = re.compile(r"(<!-- not run: [^>]*-->\n)?^```(\w*)\n(.*?)^```", re.MULTILINE | re.DOTALL)
INLINE = re.compile(r"`(npred [a-z][^`]*)`")
FILE = re.compile(r"# (\w+\.(?:py|toml))\n")
SMOKE = tomllib.loads((ROOT / "pipeline" / "smoke.toml").read_text())
BY_NAME = {"models", "coverage", "outside", "mse_by_state", "sup_by_state", "versions"}
LONG = {"docs/reproduce.md"}  # minutes: its commands train every published network
TRAINED = ("npred.load(", "npred.train(", "onnxruntime")


class Block(NamedTuple):
    """A fenced block of a page."""

    language: str
    text: str
    run: bool

    @property
    def commands(self) -> list[str]:
        """The npred commands of a shell block, without their comments."""
        lines = self.text.replace("\\\n", " ").splitlines() if self.language == "sh" else []
        return [line for line in lines if line.startswith("npred ")]


def blocks(page: Path) -> list[Block]:
    return [Block(language, text, not marked) for marked, language, text in BLOCK.findall(page.read_text())]


def commands() -> Iterator[tuple[str, str]]:
    """Each npred command of the pages with its page, in shell blocks and within lines."""
    for page in PAGES:
        lines = [line for block in blocks(page) for line in block.commands]
        inline = INLINE.findall(BLOCK.sub("", page.read_text()))
        yield from ((page.name, line.replace("…", "")) for line in [*lines, *inline])


@pytest.mark.parametrize(("page", "line"), sorted(set(commands())))
def test_a_command_and_its_flags_exist(page: str, line: str):
    words = shlex.split(line, comments=True)[1:]
    command: Any = typer.main.get_command(app)
    while words and words[0] in getattr(command, "commands", {}):
        command = command.commands[words.pop(0)]
    assert command.name != "npred", f"{page}: there is no such command"
    try:
        command.make_context(command.name, words)
    except Exception as error:  # within a line a command may be named without its arguments
        assert type(error).__name__ == "MissingParameter", f"{page}: {error}"


def pages_with(*languages: str) -> list[Any]:
    chosen = [page for page in PAGES if any(block.language in languages and block.run for block in blocks(page))]
    return [pytest.param(page, id=str(page.relative_to(ROOT))) for page in chosen]


def needs_networks(page: Path) -> bool:
    """Whether a page has more to run than test_python_that_needs_no_trained_network_runs does."""
    return any(b.run and (b.commands or any(word in b.text for word in TRAINED)) for b in blocks(page))


def marked(params: list[Any]) -> list[Any]:
    """The pages as slow tests, and those in LONG as a campaign's."""
    marks = ((p, pytest.mark.campaign if p.id in LONG else pytest.mark.slow) for p in params)
    return [pytest.param(*p.values, id=p.id, marks=mark) for p, mark in marks]


@pytest.mark.parametrize("page", pages_with("toml"))
def test_a_pipeline_of_a_page_is_whole(page: Path, tmp_path: Path):
    for block in blocks(page):
        named = FILE.match(block.text)
        if named and named[1].endswith(".toml"):
            (tmp_path / named[1]).write_text(block.text)
            config.load(tmp_path / named[1])


@pytest.mark.parametrize("page", pages_with("python"))
def test_python_that_needs_no_trained_network_runs(page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.chdir(tmp_path)
    space: dict[str, Any] = {}
    for block in blocks(page):
        if block.run and not keep(block, small=False) and not any(word in block.text for word in TRAINED):
            execute(block, page, space)


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A store for all pages: what one has made is there for the next."""
    return tmp_path_factory.mktemp("store")


@pytest.mark.parametrize("page", marked([page for page in pages_with("python", "sh") if needs_networks(*page.values)]))
def test_a_page_runs_from_top_to_bottom(
    page: Path, store: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest
):
    pytest.importorskip("onnxruntime")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("NPRED_STORE", str(store))
    monkeypatch.setattr("npred.cli.report.FORMATS", ("svg",))  # the others: tests/report/test_figures.py
    if page.name == "report.md":
        request.getfixturevalue("drawn")
    for name in ("paper", "smoke"):
        write(tmp_path / "pipeline" / f"{name}.toml", SMOKE | {"name": name})
    call("npred train pipeline/paper.toml -q")
    space: dict[str, Any] = {}
    for block in blocks(page):
        if block.run and not keep(block, small=True):
            for line in block.commands:
                call(line)
            execute(block, page, space)


@pytest.mark.slow
def test_every_key_of_a_run_is_told(store: Path, monkeypatch: pytest.MonkeyPatch, extension: Callable[[str], Any]):
    monkeypatch.setenv("NPRED_STORE", str(store))
    done = CliRunner().invoke(app, ["run", str(ROOT / "pipeline" / "smoke.toml"), "-q", "--json"])
    told = (ROOT / "docs/reference/documents.md").read_text() + "\n".join(extension("reference").results())
    found = set(keys_of(json.loads(done.stdout)))
    assert {"stages", "eps_relative", "matches", "pays_from_ns"} <= found
    assert [key for key in sorted(found) if f"`{key}`" not in told] == []


def keys_of(value: Any) -> Iterator[str]:
    """The keys of a JSON document at every depth, but for names of networks, states and packages."""
    pairs = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, item in pairs:
        if isinstance(key, str):
            yield key
        yield from keys_of(list(item.values()) if key in BY_NAME else item)


def keep(block: Block, small: bool) -> bool:
    """Write a block that is a file; a pipeline gets the sizes of pipeline/smoke.toml where it gives none."""
    named = FILE.match(block.text)
    if named is None:
        return False
    path = Path(named[1])
    if small and path.suffix == ".toml":
        write(path, merged(SMOKE, tomllib.loads(block.text)))
    else:
        path.write_text(block.text)
    return True


def call(line: str) -> None:
    done = CliRunner().invoke(app, shlex.split(line, comments=True)[1:])
    assert done.exit_code == 0, f"{line}\n{done.output}"


def execute(block: Block, page: Path, space: dict[str, Any]) -> None:
    if block.language == "python":
        exec(compile(block.text, f"a block of {page.name}", "exec"), space)


def merged(below: dict[str, Any], above: dict[str, Any]) -> dict[str, Any]:
    """Nested tables, the second's values in the place of the first's."""
    inner = {k: merged(v, above[k]) for k, v in below.items() if isinstance(v, dict) and isinstance(above.get(k), dict)}
    return below | above | inner


def write(path: Path, pipeline: dict[str, Any]) -> None:
    path.parent.mkdir(exist_ok=True)
    path.write_text("\n".join(lines_of("", pipeline)))


def lines_of(name: str, table: dict[str, Any]) -> Iterator[str]:
    """TOML of nested tables: a JSON value is one of TOML's too, infinity apart."""
    if name:
        yield f"[{name}]"
    for key, value in table.items():
        if not isinstance(value, dict):
            yield f"{key} = {json.dumps(value).replace('Infinity', 'inf')}"
    for key, value in table.items():
        if isinstance(value, dict):
            yield from lines_of(f"{name}.{key}".strip("."), value)


@pytest.fixture
def extension(monkeypatch: pytest.MonkeyPatch) -> Callable[[str], Any]:
    """A module of docs/extensions."""
    pytest.importorskip("furo")
    monkeypatch.syspath_prepend(str(ROOT / "docs" / "extensions"))
    return importlib.import_module


ARTICLE = ("Luke Bhan", "Miroslav Krstic", "Yuanyuan Shi", "2025", "https://arxiv.org/abs/2508.20367")
PREPRINTS = ("CITATION.cff", "docs/reproduce.md")


@pytest.mark.parametrize("name", ["README.md", "docs/index.md", "docs/fidelity.md"])
def test_the_article_is_cited_in_full_where_it_is_first_named(name: str):
    text = (ROOT / name).read_text()
    told = " ".join(text[text.index("[DAPF]") :].split()).replace("> ", "")[:600]
    assert [part for part in ARTICLE if part not in told] == []


def test_the_citation_file_names_the_article_as_the_readme_does():
    text = (ROOT / "CITATION.cff").read_text()
    assert "arXiv:2508.20367" in text and "year: 2025" in text and ARTICLE[-1] in text
    assert all(name.split()[1] in text for name in ARTICLE[:3])


def test_the_citation_file_names_every_preprint_that_is_reproduced():
    cited, page = (set(re.findall(r"arXiv:(\d{4}\.\d{5})", (ROOT / name).read_text())) for name in PREPRINTS)
    sources = " ".join(load(name).source for name in EXPERIMENTS.names())
    reproduced = set(re.findall(r"arXiv:(\d{4}\.\d{5})", sources))
    assert reproduced <= cited and reproduced <= page


def test_the_reference_has_every_flag_and_every_key(extension: Callable[[str], Any]):
    reference = extension("reference")
    told = "\n".join(reference.commands())
    for form in FORMATS:
        shown = CliRunner().invoke(app, ["export", form, "--help"], env={"COLUMNS": "200"}).output
        assert set(re.findall(r"--[a-z-]+", shown)) - {"--help"} <= set(re.findall(r"--[a-z-]+", told))
    assert "## npred plants check" in told and "## npred export fmu" in told
    keys = "\n".join(reference.configuration())
    for model in (config.Generate, config.DeepONet, config.FNO, config.Network, config.Evaluate, config.Bench):
        assert all(f"| `{name}` | " in keys for name in model.model_fields)
    for table, kind in {"measurement": Sensors, "timing": ControlClock, "safety": SafetyFilter}.items():
        section = keys.partition(f"## `[STAGE.{table}]`")[2].partition("##")[0]
        assert all(re.search(rf"^\| `{name}` \|.*\| .+ \|$", section, re.MULTILINE) for name in vars(kind()))


def test_the_reference_has_every_key_of_every_result(extension: Callable[[str], Any]):
    page = "\n".join(extension("reference").results())
    headings = re.findall(r"^###? (.+)$", page, re.MULTILINE)
    assert {"generate", "train", "evaluate", "evaluate: `models.*.radius`", "bench: `rows.*`", "report"} <= set(
        headings
    )
    assert "| `from` | first time" in page and "largest \\|P̂ − P\\|" in page
    assert re.findall(r"^\| `\w+` \|  \|$", page, re.MULTILINE) == []


def test_primes_are_no_powers_and_a_tag_is_a_number(extension: Callable[[str], Any]):
    formula = extension("mathml").mathml("X'(t) = |e|^2")
    assert formula.count("<msup>") == 1 and "′" in formula
    assert extension("mathml").TAG.findall(r"a = b \tag{12}") == ["12"]


@pytest.mark.slow
def test_the_documentation_builds_without_a_warning_and_asks_no_one(tmp_path: Path):
    pytest.importorskip("furo")
    command = [sys.executable, "-m", "sphinx", "-W", "--keep-going", "-n", "-q", "docs", str(tmp_path)]
    done = subprocess.run(command, cwd=ROOT, env=process_environment(), capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")
    assert dead(tmp_path) == []
    commands = (tmp_path / "reference" / "commands.html").read_text()
    assert "--set train.deeponet.width" in commands and not re.search(r"–[a-z]", commands)
    python = (tmp_path / "reference" / "python.html").read_text()
    for section in ("Parameters", "Returns", "Raises"):
        assert python.count(f">{section}<span") > 15
    for page in tmp_path.rglob("*.html"):
        fetched = re.findall(r"<(?:script|img|link|iframe)\b[^>]*(?:src|href)=\"(https?:[^\"]+)", page.read_text())
        assert fetched == [], page.name


def test_on_paper_no_code_is_cut_and_nothing_lies_on_the_text(browser: Any, tmp_path: Path):
    pytest.importorskip("furo")
    page = browser.new_page(viewport={"width": 700, "height": 1000})
    page.goto(built("identify", "mathml", tmp_path).as_uri())
    cut = "[...document.querySelectorAll('pre, .table-wrapper')].filter((e) => e.scrollWidth > e.clientWidth).length"
    assert page.evaluate(cut) > 0  # on a screen they scroll
    page.emulate_media(media="print")
    assert page.evaluate(cut) == 0
    lying = "[...document.querySelectorAll('.skip-to-content, .sidebar-drawer, .toc-drawer, .mobile-header')]"
    assert page.evaluate(f"{lying}.map((e) => getComputedStyle(e).display)") == ["none"] * 4


def test_the_pages_that_llms_txt_names_exist():
    names = re.findall(r"\]\(([^)]+)\)", (ROOT / "docs" / "llms.txt").read_text())
    assert len(names) > 10 and [name for name in names if not (ROOT / "docs" / name).exists()] == []
