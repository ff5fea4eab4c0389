"""Every registered experiment: complete, and as the page about it shows it."""

from pathlib import Path

import pytest

from npred import registry
from npred.stages.reproduce import reproduce
from npred.stages.reproduce.experiment import NUMERICAL

PAGE = (Path(__file__).parents[3] / "docs" / "reproduce.md").read_text()
NAMES = registry.EXPERIMENTS.names()


@pytest.mark.parametrize("name", NAMES)
def test_an_experiment_names_its_source_and_each_row_once(name: str):
    experiment = reproduce.load(name)
    rows = [(row.predictor, row.metric) for row in [*experiment.numerical, *experiment.networks]]
    assert len(set(rows)) == len(rows)
    assert {row.predictor for row in experiment.numerical} == {NUMERICAL}
    assert NUMERICAL not in {row.predictor for row in experiment.networks}
    assert experiment.title and f"`{name}`" in PAGE


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_the_page_shows_what_the_command_prints(name: str):
    result = reproduce.joined([reproduce.numerical(name)], networks=False)
    shown = [line.split() for line in PAGE.splitlines()]
    for cells in reproduce.rows(result):
        words = [*" ".join(cells).split()]
        near = [line for line in shown if line[:-3] == words[:-3]]
        assert len(near) == 1
        assert near[0][-3] == words[-3]
        if "e-" not in words[-2]:  # a rounding error is another on another machine
            assert near[0][-2:] == words[-2:] or _close(near[0][-1], words[-1])


def _close(left: str, right: str) -> bool:
    return abs(float(left) - float(right)) <= 1e-6 * abs(float(left)) + 1e-6
