"""TOML text: what is written reads back as it was."""

import tomllib
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from npred.lab import config
from npred.lab.config import dumps

LEAVES = st.one_of(
    st.booleans(), st.integers(-(2**60), 2**60), st.floats(allow_nan=False), st.text('aé"\\ \n#', max_size=5)
)
KEYS = st.text("ab .é_-1", min_size=1, max_size=3)
FLAT = st.dictionaries(KEYS, st.one_of(LEAVES, st.lists(LEAVES, max_size=3)), max_size=3)
TABLES = st.dictionaries(KEYS, st.one_of(LEAVES, FLAT, st.dictionaries(KEYS, FLAT, max_size=2)), max_size=3)


@given(TABLES)
def test_what_is_written_reads_back(table):
    assert tomllib.loads(dumps(table)) == table


def test_tables_of_a_list_are_written_in_a_line():
    table = {"a": [{"b": 1.5, "c d": {"e": "f"}, "g": None}, {}]}
    assert dumps(table) == 'a = [{ b = 1.5, "c d" = { e = "f" } }, {  }]\n'
    assert tomllib.loads(dumps(table)) == {"a": [{"b": 1.5, "c d": {"e": "f"}}, {}]}


def test_what_has_no_value_is_left_out():
    assert dumps({"a": None, "b": {"c": None, "d": (1, [2.5, float("inf")])}}) == "[b]\nd = [1, [2.5, inf]]\n"


@pytest.mark.parametrize("path", sorted(Path("pipeline").glob("*.toml")), ids=lambda path: path.stem)
def test_a_resolved_pipeline_reads_back(path):
    made = config.load(path)
    assert config.parse(tomllib.loads(dumps(made.model_dump())), "text") == made
