"""Every registered experiment: complete, and as the page about it shows it."""

import json
import re
from pathlib import Path

import pytest

import npred_experiments
from npred.lab.report.terminal.console import Console
from npred.lab.store import Store
from npred_experiments import EXPERIMENTS, rows
from npred_experiments.experiment import NUMERICAL, Place, load
from npred_experiments.planner import ExperimentPlanner

DOCS = Path(__file__).parents[3] / "docs"
PAGE = (DOCS / "reproduce.md").read_text()
PUBLISHED = (DOCS / "published.md").read_text().replace("−", "-").splitlines()
MEASURED = json.loads((Path(__file__).parent / "measured.json").read_text())  # npred reproduce --numerical --json
NAMES = EXPERIMENTS.names()
LABELS = ("predictor", "metric", "published")
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
def test_the_command_prints_the_numbers_of_the_page_and_those_that_were_measured_before(name: str):
    place = Place(Path("none"), Path("none"), Console())
    result = rows.joined([load(name).measured(name, NUMERICAL, place)], networks=False)
    (before,) = (each["rows"] for each in MEASURED["experiments"] if each["name"] == name)
    for row, old in zip(result.json_object()["rows"], before, strict=True):
        assert [row[key] for key in LABELS] == [old[key] for key in LABELS]
        assert all(_close(row[key], old[key]) for key in ("as_published", "as_meant"))
    shown = _shown(name)
    assert shown or not any(row["published"] is not None for row in before)
    for _, predictor, metric, published, as_published, as_meant in rows.cells_of(result):
        if (predictor, metric) not in shown:
            continue
        assert shown[predictor, metric][0] == published
        if "e-" not in as_published:  # a rounding error is another on another machine
            exact = shown[predictor, metric][1:] == [as_published, as_meant]
            assert exact or _close(float(shown[predictor, metric][2]), float(as_meant))


def _shown(name: str) -> dict[tuple[str, str], list[str]]:
    """The page's numbers of an experiment by predictor and metric."""
    shown, of = {}, ""
    for line in (line for line in PUBLISHED if line.startswith("| ")):
        first, predictor, metric, *numbers = (c.strip() for c in re.split(r"(?<!\\)\|", line)[1:-1])
        of = first.strip("`") or of
        if of == name:
            shown[predictor, metric.replace("\\|", "|")] = numbers
    return shown


def _close(left: float | None, right: float | None) -> bool:
    if left is None or right is None:
        return left is right
    return abs(left - right) <= 1e-6 * abs(left) + 1e-6
