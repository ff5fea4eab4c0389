"""What an installation takes: lower bounds, and the exact versions that were tested, by name and version alone."""

import json
import os
import re
import subprocess
import sys
import tarfile
import tomllib
import zipfile
from pathlib import Path

import pytest
from conftest import HERE

import npred

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
        top, *inside = target.partition(":")[0].split(".")
        (package,) = [each for each in TARGETS["wheel"]["packages"] if Path(each).name == top]
        assert ROOT.joinpath(package, *inside).with_suffix(".py").is_file()
        assert package.partition("/")[0] in TARGETS["sdist"]["include"]


@pytest.mark.parametrize("target", ["install", "dev"])
def test_make_takes_the_tested_set(target: str):
    said = subprocess.run(
        ["make", "-n", target, "CONSTRAINTS=constraints.txt"], cwd=ROOT, capture_output=True, text=True, check=True
    ).stdout
    assert re.search(r"install .*--constraint constraints.txt -e ", said)
    plain = subprocess.run(["make", "-n", "-B", target], cwd=ROOT, capture_output=True, text=True, check=True).stdout
    assert ".ci/install" in plain and "--constraint" not in plain


PYTHON = """#!/bin/sh
case "$*" in
    "-m pip config list") printf '%s\\n' ":env:.index-url='b/simple'" "global.index-url='a/simple'" \\
        "global.find-links='/x\\\\n/y'" "download.cert='no'" "install.extra-index-url='c d'" ;;
    "-m uv "*) env | grep ^UV_; exit $FAILS ;;
    *) echo "$*" ;;
esac
"""


@pytest.mark.skipif(sys.platform == "win32", reason="make runs it by sh")
@pytest.mark.parametrize("fails", ["0", "1"])
def test_uv_gets_the_indexes_of_pip_and_pip_installs_where_uv_fails(tmp_path: Path, fails: str):
    python = tmp_path / "python"
    python.write_text(PYTHON)
    python.chmod(0o755)
    command = ["sh", ROOT / ".ci/install", python, "-e", "."]
    done = subprocess.run(command, env=os.environ | {"FAILS": fails}, capture_output=True, text=True, check=True)
    said = done.stdout.splitlines()
    assert {"UV_DEFAULT_INDEX=b/simple", "UV_INDEX=c d", "UV_FIND_LINKS=/x,/y"} < {*said}
    assert said[-1].startswith("-m pip install") == (fails == "1") == said[-1].endswith(" -e .")
    assert done.stderr == ("uv could not install it; pip does\n" if fails == "1" else "")


def test_the_version_is_the_same_everywhere_and_has_a_section_in_the_changelog():
    cited = re.search(r"^version: (.+)$", (ROOT / "CITATION.cff").read_text(), re.MULTILINE)
    assert cited is not None and cited[1] == PROJECT["version"] == npred.__version__
    assert json.loads((ROOT / "codemeta.json").read_text())["version"] == npred.__version__
    assert f"\n## {PROJECT['version']}\n" in (ROOT / "CHANGELOG.md").read_text()


ADDRESS = PROJECT["urls"]["Homepage"]


def test_classifiers_are_those_of_the_index():
    known = pytest.importorskip("trove_classifiers").classifiers
    assert [each for each in PROJECT["classifiers"] if each not in known] == []
    tested = re.search(r"python: \[(.+)\]", (ROOT / ".github/workflows/pythons.yml").read_text())
    pythons = [each.rpartition(" ")[2] for each in PROJECT["classifiers"] if "Python :: 3." in each]
    assert tested is not None and pythons == re.findall(r"[\d.]+", tested[1])


def test_the_paper_cites_what_its_bibliography_has_and_shows_what_is_there():
    text, entries = ((ROOT / "paper" / name).read_text() for name in ("paper.md", "paper.bib"))
    assert set(re.findall(r"@([a-z]+\d{4}[a-z]*|[a-z]+)\b", text)) == set(
        re.findall(r"^@\w+\{(\w+),", entries, re.MULTILINE)
    )
    assert all((ROOT / "paper" / path).is_file() for path in re.findall(r"\]\((\.\.[^)]+)\)", text))
    assert all((ROOT / path).is_file() for path in re.findall(r"`(docs/[^`]+)`", text))


@pytest.mark.slow
def test_wheel_and_sources_have_what_they_should_and_nothing_else(tmp_path: Path):
    pytest.importorskip("hatchling")
    build = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-t", "sdist", "-d", str(tmp_path)]
    subprocess.run(build, cwd=ROOT, check=True, capture_output=True)
    (wheel,), (sources,) = tmp_path.glob("*.whl"), tmp_path.glob("*.tar.gz")
    with zipfile.ZipFile(wheel) as archive:
        in_wheel = {name for name in archive.namelist() if not name.endswith("/")}
    with tarfile.open(sources) as archive:
        in_sources = {name.partition("/")[2] for name in archive.getnames()}
    tracked = subprocess.run(["git", "ls-files"], cwd=ROOT, capture_output=True, text=True, check=True).stdout.split(
        "\n"
    )
    here = [name.removeprefix("siblings/") for name in tracked]
    package = {name for name in here if re.match(r"npred(_\w+)?/(?!tests/)", name)}
    pipelines = {
        f"npred/pipelines/{name.removeprefix('pipeline/')}" for name in tracked if name.startswith("pipeline/")
    }
    metadata = {name for name in in_wheel if ".dist-info/" in name}
    assert in_wheel - metadata == package | pipelines
    assert any(name.endswith("licenses/LICENSE") for name in metadata)
    assert {"LICENSE", "README.md", "pyproject.toml", "docs/llms.txt", "docs/gallery/00_first_loop.py"} <= in_sources
    assert not any(name.startswith(("artifacts", "docs/_build", "docs/examples", ".venv")) for name in in_sources)
