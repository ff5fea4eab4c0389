"""Every registered experiment: complete, and as the page about it shows it."""

import re
from pathlib import Path

import pytest

import npred_experiments
from npred.lab.report.terminal.console import Console
from npred.lab.store import Store
from npred_experiments import EXPERIMENTS, rows
from npred_experiments.experiment import NUMERICAL, Place, load
from npred_experiments.planner import ExperimentPlanner

DOCS = Path(__file__).parents[2] / "docs"
PAGE = (DOCS / "reproduce.md").read_text()
MEASURED = (DOCS / "published.md").read_text().replace("−", "-").split("\n## ")
NAMES = EXPERIMENTS.names()
FILES = Path(npred_experiments.__file__).parent.glob("*.py")


def test_every_file_with_an_experiment_is_registered():
    assert sorted(path.stem for path in FILES if "\nEXPERIMENT = " in path.read_text()) == NAMES


@pytest.mark.parametrize("name", NAMES)
def test_an_experiment_names_its_source_and_each_row_once(name: str):
    experiment = load(name)
    named = [(row.predictor, row.metric) for row in [*experiment.numerical, *experiment.networks]]
    assert len(set(named)) == len(named)
    assert {row.predictor for row in experiment.numerical} == {NUMERICAL}
    assert NUMERICAL not in {row.predictor for row in experiment.networks}
    assert experiment.title and f"`{name}`" in PAGE


def test_an_experiment_is_keyed_by_what_it_imports():
    planner = ExperimentPlanner("horizon_loop", Store(Path("none")))
    settings = planner.settings(planner.possible()[0])
    assert settings["experiment"] == {"name": "horizon_loop", "target": "npred_experiments.horizon_loop:EXPERIMENT"}
    assert list(settings["code"]) == [
        f"npred_experiments{name}" for name in ("", ".experiment", ".horizon_loop", ".horizons")
    ]


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_the_page_shows_what_the_command_prints(name: str):
    place = Place(Path("none"), Path("none"), Console())
    result = rows.joined([load(name).measured(name, NUMERICAL, place)], networks=False)
    section = next(part for part in MEASURED if f"\n`{name}`: " in part)
    lines = [re.split(r"(?<!\\) ?\| ?", line)[1:-1] for line in section.splitlines() if line.startswith("|")]
    left_out = {"predictor": NUMERICAL, "published": "–", "as published": "–"}
    shown = [left_out | dict(zip(lines[0], line, strict=True)) for line in lines[2:]]
    for _, predictor, metric, published, as_published, as_meant in rows.cells_of(result):
        (near,) = (r for r in shown if (r["predictor"], r["metric"]) == (predictor, metric.replace("|", "\\|")))
        assert near["published"] == published
        if "e-" not in as_published:  # a rounding error is another on another machine
            exact = [near["as published"], near["as meant"]] == [as_published, as_meant]
            assert exact or _close(near["as meant"], as_meant)


def _close(left: str, right: str) -> bool:
    return abs(float(left) - float(right)) <= 1e-6 * abs(float(left)) + 1e-6
