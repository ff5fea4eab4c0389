"""What an installation takes: lower bounds, and the exact versions that were tested, by name and version alone."""

import re
import subprocess
import tomllib

import pytest
from conftest import HERE

ROOT = HERE.parent
FILE = tomllib.loads((ROOT / "pyproject.toml").read_text())
PROJECT, TARGETS = FILE["project"], FILE["tool"]["hatch"]["build"]["targets"]
EXTRAS = [requirement for extra in PROJECT["optional-dependencies"].values() for requirement in extra]
REQUIRED = [text for text in [*PROJECT["dependencies"], *EXTRAS] if not text.startswith("npred[")]
TESTED = dict(line.split("==") for line in (ROOT / "constraints.txt").read_text().splitlines())


def test_the_tested_set_is_names_and_versions():
    assert all(re.fullmatch(r"[\w.-]+", name) and re.fullmatch(r"[\w.+]+", TESTED[name]) for name in TESTED)


@pytest.mark.parametrize("requirement", REQUIRED)
def test_a_requirement_is_a_lower_bound_that_the_tested_set_keeps(requirement: str):
    """`.ci/lowest` makes the lowest version of the bound."""
    version = pytest.importorskip("packaging.version").Version
    name, bound = re.fullmatch(r"([\w-]+)>=([\d.]+)(?:; .*)?", requirement).groups()  # type: ignore[union-attr]
    tested = {known.lower().replace("_", "-"): number for known, number in TESTED.items()}
    assert version(tested[name]) >= version(bound)


def test_wheel_and_sources_have_the_modules_that_entry_points_name():
    targets = [target for group in PROJECT["entry-points"].values() for target in group.values()]
    assert targets
    for target in [*targets, *PROJECT["scripts"].values()]:
        path = ROOT.joinpath(*target.partition(":")[0].split(".")).with_suffix(".py")
        top = path.relative_to(ROOT).parts[0]
        assert path.is_file() and top in TARGETS["wheel"]["packages"] and top in TARGETS["sdist"]["include"]


@pytest.mark.parametrize("target", ["install", "dev"])
def test_make_takes_the_tested_set(target: str):
    said = subprocess.run(
        ["make", "-n", target, "CONSTRAINTS=constraints.txt"], cwd=ROOT, capture_output=True, text=True, check=True
    ).stdout
    assert re.search(r"pip install .*--constraint constraints.txt -e ", said)
    plain = subprocess.run(["make", "-n", "-B", target], cwd=ROOT, capture_output=True, text=True, check=True).stdout
    assert "pip install" in plain and "--constraint" not in plain
