"""The report of a run: one file that needs nothing else, with the results' own numbers, the same bytes again."""

import csv
import html
import itertools
import re
import shutil
import subprocess
import sys
import tomllib
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import h5py
import pytest
from conftest import HERE, Call, document, one_line, process_environment
from jobs import SMALL, job
from jobs import tables as job_tables
from result_samples import BENCHED, END, ERRORS, RADIUS, evaluation, timing

from npred import plants
from npred.base import json_files
from npred.base.errors import StoreError
from npred.cli.report import OWNER, PLACE
from npred.lab import config
from npred.lab.config.results import Benched, PredictorId
from npred.lab.report.figures import EvaluationData
from npred.lab.report.figures.style import MEDIA
from npred.lab.scheduler.plan import STAGES
from npred.lab.stages.report import report, tables
from npred.lab.stages.report.report import PipelineResults, sentences
from npred.plants.builtin.activator_repressor import ActivatorRepressor
from npred.plants.notation import markup

pytestmark = pytest.mark.usefixtures("drawn")
LIMIT = 1_500_000  # bytes
LOADED = ("src", "srcset", "data", "poster", "action", "formaction", "background")
VOID = {"meta", "link", "input", "br", "img", "hr"}

FNO = PredictorId("fno")


def unset(text: str) -> str:
    """The text of a page without its subscripts' tags."""
    return re.sub(r"_\{(.*?)\}", r"\1", text)


class Page(HTMLParser):
    """What the tests ask of a page: its elements with their attributes, the text of its tables, and what is open."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.elements: list[tuple[str, dict[str, str | None]]] = []
        self.tables: dict[str, list[list[str]]] = {}
        self.open: list[str] = []
        self.cell = False
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        found = dict(attrs)
        self.elements.append((tag, found))
        if tag not in VOID:
            self.open.append(tag)
        if tag == "table":
            self.tables[found["id"]] = []
        elif tag == "tr":
            self.rows.append([])
        elif tag in ("td", "th"):
            self.rows[-1].append("")
            self.cell = True

    def handle_startendtag(self, tag, attrs):
        self.elements.append((tag, dict(attrs)))

    def handle_endtag(self, tag):
        assert self.open.pop() == tag
        self.cell = self.cell and tag not in ("td", "th")

    def handle_data(self, data):
        if self.cell:
            self.rows[-1][-1] += data.strip()

    @property
    def rows(self) -> list[list[str]]:
        return list(self.tables.values())[-1]


@pytest.fixture(scope="module")
def text(reported) -> str:
    return (reported[1]["report"].artifact.folder / report.NAME).read_text()


@pytest.fixture(scope="module")
def page(text) -> Page:
    return Page(text)


@pytest.fixture(scope="module")
def results(reported) -> PipelineResults:
    path, outcomes = reported
    made = job(path.parent / "read", "report").plant
    folders = {name: done.artifact.folder for name, done in outcomes.items() if name != "report"}
    return PipelineResults(config.load(path), made, folders)


def test_a_run_that_is_killed_in_training_leaves_a_page_of_its_data_and_the_numerical_loop(tmp_path: Path):
    file, endless = tmp_path / "tiny.toml", {model: each | {"epochs": 10**6} for model, each in SMALL["train"].items()}
    file.write_text(config.dumps({"name": "tiny"} | job_tables(train=endless)))
    command = [sys.executable, "-m", "npred", "run", str(file), "--store", str(tmp_path / "store")]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True, env=process_environment()) as run:
        assert run.stderr is not None
        said = next(line for line in run.stderr if "the report so far" in line)
        run.kill()
    text = (tmp_path / "store" / "tiny.html").read_text()
    page = Page(text)
    assert said.split()[-1] == str(tmp_path / "store" / "tiny.html")
    assert "the run went on with: deeponet, fno, evaluate, bench." in text
    assert [found["id"] for tag, found in page.elements if tag == "section"] == ["summary", "loop", "provenance"]
    assert "no adaptation" in text and "DeepONet" not in text


def test_what_an_evaluation_announces_is_checked_before_room_is_made(
    reported, results: PipelineResults, tmp_path: Path
):
    done = reported[1]["evaluate"].artifact
    for file, name in (("errors.h5", "networks/fno/sup"), ("figure1.h5", "fno/t"), ("coverage.h5", "D_hat/edges")):
        folder = shutil.copytree(done.folder, tmp_path / file)
        with h5py.File(folder / file, "r+") as opened:
            del opened[name]
            opened.create_dataset(name, shape=(10**13,), dtype="f8")
        with pytest.raises(StoreError, match=f"{name} of shape .* is larger than what is stored of it"):
            EvaluationData.read(folder, results.plant, results.config.evaluate, results.evaluated)


def test_a_result_too_long_for_a_table_is_not_read(reported, results: PipelineResults, tmp_path: Path):
    path, outcomes = reported
    folders = {name: done.artifact.folder for name, done in outcomes.items() if name != "report"}
    folders["bench"] = tmp_path
    with (tmp_path / "result.json").open("wb") as file:
        file.truncate(json_files.LIMIT + 1)
    with pytest.raises(StoreError, match=f"more than {json_files.LIMIT}"):
        PipelineResults(config.load(path), results.plant, folders)


def test_nothing_is_loaded_and_nothing_could_be(page, text):
    for tag, attributes in page.elements:
        for name in LOADED:
            assert name not in attributes, (tag, name)
        link = attributes.get("href") or attributes.get("xlink:href") or "#"
        assert link.startswith("#") or (tag, link) == ("link", "data:,")
    assert not re.search(r"@import|url\((?!#)", text)
    policy = next(a["content"] for tag, a in page.elements if a.get("http-equiv") == "Content-Security-Policy")
    assert "default-src 'none'" in policy
    assert len(text.encode()) < LIMIT


def test_it_is_well_formed_and_no_name_is_given_twice(page):
    assert page.open == []
    names = [attributes["id"] for _, attributes in page.elements if "id" in attributes]
    assert len(names) == len(set(names))
    asked = [a["href"][1:] for tag, a in page.elements if tag == "a"]
    asked += [
        name
        for _, a in page.elements
        for key in ("aria-labelledby", "data-copies")
        for name in (a.get(key) or "").split()
    ]
    assert set(asked) <= set(names)


def test_every_figure_is_there_and_told_in_words(page, results):
    drawn = [a for tag, a in page.elements if tag == "svg" and a.get("role") == "img"]
    assert len(drawn) == sum(len(figure.panels) for figure in results.figures().values())
    assert all(len(a["aria-labelledby"].split()) == 2 for a in drawn)
    assert all(a.get("aria-hidden") == "true" for tag, a in page.elements if tag == "svg" and a not in drawn)
    shown = [a["id"] for tag, a in page.elements if tag == "figure"]
    assert shown == [f"figure-{name}" for name in results.figures()]


def test_the_tables_say_what_the_results_say(page, results):
    for name, table in results.tables().items():
        shown = page.tables[f"table-{name}"]
        assert shown[0] == [unset(column.head) for column in table.columns]
        assert shown[1:] == [[*map(unset, row)] for row in table.texts]
    predictors, _, eps_sup, *_ = results.tables()["accuracy"].columns
    assert eps_sup.values[predictors.values.index("FNO")] == results.evaluated.models[FNO].eps_sup
    assert set(results.tables()["kinds"].columns[1].values) == {"nominal rollouts", "rows with a redrawn D̂"}
    shown, *_, in_loop = results.tables()["loops"].columns
    errors = dict(zip(shown.values, in_loop.values, strict=True))
    assert errors.pop("no adaptation") is None and all(error > 0 for error in errors.values())
    assert set(results.tables()["speed"].columns[3].values) <= {row.median_us for row in results.benched.rows}


def test_headings_that_do_not_explain_themselves_are_explained_below_their_table(text, results):
    heads = {"radius, median", "worst", "ε_{κ}", "relative L²", "× Euler", "× O(nx²) sums"}
    heads |= {column.head for column in results.tables()["loops"].columns if column.head.startswith(("map", "sup |P"))}
    columns = {column.head: column for table in results.tables().values() for column in table.columns}
    assert len(heads) == 8
    for head in heads:
        said = f"<dt>{markup(head)}</dt><dd>{markup(columns[head].about)}</dd>"
        assert columns[head].about and said in text


def test_a_page_and_the_terminal_say_that_networks_do_not_predict_and_what_to_do(text, results, reported, monkeypatch):
    caution = results.evaluated.caution  # two epochs
    assert re.match(
        "No network here predicts well: the mean error is .*% .* Train longer .*then on more samples", caution
    )
    assert caution in text and caution in STAGES["evaluate"].summary(results.evaluated.json_object(), 80)
    assert caution == reported[1]["report"].artifact.result()["summary"][0]
    monkeypatch.setattr("npred.lab.config.results.evaluate.POOR", 1e9)
    assert results.evaluated.caution == ""


def test_the_rows_of_the_readme_have_the_names_of_the_tables_that_it_names():
    lines = (HERE.parent / "README.md").read_text().partition("| `npred evaluate --wide` |")[2].splitlines()[2:]
    rows = [line.split(" | ")[0].removeprefix("| ") for line in itertools.takewhile(bool, lines)]
    evaluated = evaluation("numerical", "fno", figure1_bounded=END)
    made = [table for table in (tables.accuracy(evaluated), tables.kinds(evaluated), tables.loops(evaluated)) if table]
    heads = {re.sub(r"(?<=of )\d+$", "47", column.head) for table in made for column in table.columns}
    for row in rows:
        name = row.partition(" (num")[0].replace("\\|", "|")
        quantity, _, kind = name.partition(", ")
        assert name in heads or (quantity in heads and kind in evaluated.kinds), row
    assert len(rows) == 8


def test_three_sentences_bear_the_numbers(reported, text):
    result = reported[1]["report"].artifact.result()
    assert len(result["summary"]) == 1 + 3 and result["bytes"] == len(text.encode())
    evaluated = reported[1]["evaluate"].artifact.result()
    assert f"{evaluated['models']['fno']['eps_sup']:.2g}" in result["summary"][1]
    assert all(sentence.replace("'", "&#39;") in text for sentence in result["summary"])


LOST = {
    "kinds": {"exploring": ERRORS | {"eps_sup": 3.5, "above": 1.0}}, "eps_sup": None, "mse": 0.25,
    "radius": RADIUS | {"cases": 20, "converged": 0.0, "median": None},
}  # fmt: skip
NONE_TIMED = Benched.of(BENCHED, "a test")


def test_the_sentences_know_loops_that_are_lost_and_a_benchmark_without_networks():
    said = sentences(plants.resolve("scalar"), evaluation("numerical", "no_adaptation", "fno", **LOST), NONE_TIMED)
    assert said[0] == (
        "On 12,345 held-out samples of nominal rollouts the largest error of a prediction is ∞ for the FNO (mean "
        "square 0.25); on 100 of exploring rollouts it is 3.5."
    )
    assert said[1] == (
        "20 closed loops, delay unknown to the controller. End within 0.01 of rest: numerical predictor 0, "
        "FNO 0 (median radius ∞), without adaptation 0."
    )
    assert said[2] == "No network was timed."


def test_the_sentences_know_delays_that_are_held_and_plants_without_a_published_predictor():
    timed = NONE_TIMED.model_copy(update={"rows": [timing("fno", "torch", us=200.0)]})
    said = sentences(plants.resolve("scalar"), evaluation("numerical", "fno", **LOST), timed)
    assert said[1] == (
        "20 closed loops, constant delay estimate. End within 0.01 of rest: numerical predictor 0, "
        "FNO 0 (median radius ∞)."
    )
    assert said[2] == "A call of the FNO, torch, takes 200.0 µs at dx = 0.1."


def test_the_pipeline_can_be_copied_and_run_again(reported, text):
    path, outcomes = reported
    settings = re.search(r'<pre id="copied-pipeline"[^>]*>(.*?)</pre>', text, re.DOTALL)[1]
    settings = settings.replace("&#34;", '"').replace("&#39;", "'")
    assert config.parse(tomllib.loads(settings), "page") == config.load(path)
    for name, done in outcomes.items():
        assert name == "report" or done.artifact.manifest.key in text


def test_files_of_ones_own_are_named_beside_the_pipeline_on_the_page(reported, tmp_path, text):
    path, outcomes = reported
    inputs = {name: done.artifact.folder for name, done in outcomes.items() if name != "report"}
    named = config.load(path, [f"plant={tmp_path}/tank.py:Tank", "generate.data=sub/d.h5"])
    made = replace(job(tmp_path, "named", inputs=inputs), config=named)
    report.run(made)
    page = (made.folder / report.NAME).read_text()
    assert "Saved as <code>tiny.toml</code> beside tank.py, d.h5, it gives these results again" in page
    assert "&#34;tank.py:Tank&#34;" in page and str(tmp_path) not in page and "sub/" not in page
    assert "Saved as <code>tiny.toml</code>, it gives" in text


def test_a_page_of_another_plant_names_no_figure_of_the_paper_and_its_own_units(reported, tmp_path, text):
    path, outcomes = reported
    inputs = {name: done.artifact.folder for name, done in outcomes.items() if name != "report"}
    units = {"labels": {"x1": "activator"}, "units": {"x1": "mol/m^3"}, "time_unit": "h", "figure": ""}
    plant = plants.make("Clock", type("Clock", (ActivatorRepressor,), units))
    made = replace(job(tmp_path, "other", inputs=inputs), config=config.load(path), plant=plant)
    report.run(made)
    page = (made.folder / report.NAME).read_text()
    assert "Fig. 1" in text and "Fig. 1" not in page and "published" not in page
    assert "states activator, x<sub>2</sub>; inputs U; delay D = 1 h, unknown" in page
    for title in ("activator (mol/m³)", "density of x<sub>2</sub>", "delay estimate D̂ (h)"):
        assert f"<h3>{title}</h3>" in page
    assert "radius versus ε<sub>κ</sub>" in page and ">t (h)</text>" in page and ">t (s)</text>" not in page


def test_the_same_results_give_the_same_bytes(reported, tmp_path, text):
    path, outcomes = reported
    inputs = {name: done.artifact.folder for name, done in outcomes.items() if name != "report"}
    again = replace(job(tmp_path, "again", inputs=inputs), config=config.load(path))
    report.run(again)
    assert (again.folder / report.NAME).read_text() == text


@pytest.fixture
def here(reported, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folder of the pipeline and its store."""
    monkeypatch.chdir(reported[0].parent)
    monkeypatch.setenv("NPRED_STORE", "store")
    return reported[0].parent


def test_report_writes_the_page_where_it_is_told(call: Call, here: Path, tmp_path: Path, text: str):
    found = document(call("report", "tiny.toml", "--json"))
    assert found["report"] == "store/tiny.html" and unmarked(Path("store/tiny.html")) == text
    assert {row["action"] for row in found["stages"]} == {"hit"}
    assert call("run", "tiny.toml").stdout.endswith("\nreport: store/tiny.html\n")
    call("report", "tiny.toml", "-o", str(tmp_path / "page.html"))
    assert unmarked(tmp_path / "page.html") == text
    assert "no/folder" in one_line(call("report", "tiny.toml", "-o", "no/folder/page.html"), 2)


def unmarked(path: Path) -> str:
    """A page as its result has it, without the line that says what made it."""
    return re.sub(f"{OWNER.pattern}.*</p>", PLACE, path.read_text())


def test_a_page_says_which_file_and_which_flags_made_it(call: Call, here: Path, tmp_path: Path):
    call("report", "tiny.toml")
    line = '<p class="about" data-pipeline="tiny.toml">From <code>tiny.toml</code></p>'
    assert line in Path("store/tiny.html").read_text()
    Path("noted.toml").write_text("# Is it all wired up?\n# <Nothing> else.\n" + Path("tiny.toml").read_text())
    call("report", "noted.toml")
    assert (
        "<code>noted.toml</code>. Is it all wired up? &lt;Nothing&gt; else.</p>" in Path("store/noted.html").read_text()
    )
    models = 'train.models=["deeponet","fno"]'
    call("report", "tiny.toml", "--set", models, "-o", str(tmp_path / "page.html"))
    said = f"From <code>tiny.toml</code> with <code>--set {html.escape(models)}</code></p>"
    assert said in (tmp_path / "page.html").read_text()


def test_a_page_is_not_overwritten_by_another_pipeline_of_its_name(call: Call, here: Path):
    call("report", "tiny.toml")
    before = Path("store/tiny.html").read_bytes()
    for folder, name in (("a", "tiny-a.html"), ("b/a", "tiny-*.html"), ("a", "tiny-a.html")):
        Path(folder).mkdir(parents=True, exist_ok=True)
        other = shutil.copy("tiny.toml", f"{folder}/tiny.toml")
        result = call("report", other, "--json")
        path = Path(document(result)["report"])
        assert path.match(name) and f'data-pipeline="{other}"' in path.read_text()
        assert f"store/tiny.html belongs to tiny.toml; the one of {other} is {path}" in result.stderr
    assert len(list(Path("store").glob("tiny*.html"))) == 3 and Path("store/tiny.html").read_bytes() == before
    assert document(call("report", "tiny.toml", "--json"))["report"] == "store/tiny.html"


def test_figures_of_two_pipelines_of_one_name_have_folders_of_their_own(call: Call, here: Path, monkeypatch):
    monkeypatch.setattr("npred.cli.report.FORMATS", ("svg",))
    monkeypatch.setattr(PipelineResults, "figures", lambda self: {})
    Path("c").mkdir()
    other = shutil.copy("tiny.toml", "c/tiny.toml")
    files = [("tiny.toml", "tiny-ieee1"), (other, "tiny-c-ieee1"), ("tiny.toml", "tiny-ieee1")]
    for file, name in files:
        assert document(call("report", file, "--figures", "ieee1", "--json"))["folder"] == f"store/{name}"
        assert Path(f"store/{name}/pipeline.txt").read_text() == f"{file}\n"


def test_figures_and_tables_for_a_paper(call: Call, here: Path, tmp_path: Path, results: PipelineResults, monkeypatch):
    monkeypatch.setattr("npred.cli.report.FORMATS", ("svg",))  # the others: tests/report/test_figures.py
    found = document(call("report", "tiny.toml", "--figures", "ieee1", "-o", str(tmp_path / "figures"), "--json"))
    wanted = {f"{name}.{form}" for name in results.figures() for form in ("svg",)}
    wanted |= {f"{name}.{form}" for name in results.tables() for form in ("csv", "tex")}
    assert {path.name for path in Path(found["folder"]).iterdir()} == set(found["files"]) == wanted
    with (tmp_path / "figures/accuracy.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert float(rows[-1]["ε sup"]) == results.evaluated.models[FNO].eps_sup
    refused = one_line(call("report", "tiny.toml", "--figures", "poster"), 2)
    assert all(medium in refused for medium in MEDIA)


def test_the_sentence_on_time_is_of_the_fastest_network_on_the_finest_grid():
    rows = [
        timing("fno", "fused", 0.1, 1.0),
        timing("fno", "torch", 0.01, 200.0),
        timing("deeponet", "fused", 0.01, 12.0, speedup_published=1234.4, speedup_compiled=5.0),
        timing("fno", "fused", 0.01, 90.0),
        timing("deeponet", "torch", 0.01, 900.0, speedup_published=16.4, speedup_compiled=0.07),
        timing("rk4", "compiled", 0.01, 2.0),
    ]
    said = sentences(
        plants.resolve("scalar"), evaluation("numerical", "fno"), NONE_TIMED.model_copy(update={"rows": rows})
    )
    assert said[2] == (
        "A call of the DeepONet, fused, takes 12.0 µs at dx = 0.01, 1,234 times as fast as interpreted O(nx²) sums "
        "(by torch 16 times) and 5 times as fast as compiled Euler."
    )
