"""A module imports only from floors below its own, and the command line starts without the heavy libraries."""

import ast
import subprocess
import sys
from collections.abc import Mapping
from functools import cache
from pathlib import Path

import pytest
from conftest import process_environment

ROOT = Path(__file__).parent.parent / "npred"
FLOORS = [
    {"docstrings", "errors", "grid", "json_files", "notebook", "progress", "randomness", "source_lines"},
    {"array_checks", "config", "defaults", "kernels", "parallel", "registry", "symbolic", "terminal"},
    {"plants", "results", "store"},
    {"data", "laws", "operators", "recordings"},
    {"delays", "training"},
    {"observers", "predictors", "safety"},
    {"conditions", "diagnosis", "exports", "identification", "loop", "runtimes"},
    {"figures", "tuning"},
    {"stages"},
    {"pipeline"},
    {"api", "runs"},
    {"cli", "__main__"},
]
FLOOR = {name: floor for floor, names in enumerate(FLOORS) for name in names}
MODULES = {path.relative_to(ROOT).as_posix(): path.read_text() for path in sorted(ROOT.rglob("*.py"))}
del MODULES["__init__.py"]
HEAVY = ("torch", "h5py", "sympy", "matplotlib", "scipy", "onnxruntime", "distributed")


def room(file: str) -> str:
    return file.removesuffix(".py").split("/")[0]


@cache
def imports(text: str) -> list[tuple[int, str]]:
    """Line and first name below npred of each import from this package, those inside functions included."""
    places = []
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Import):
            places += [(node.lineno, a.name.split(".")[1]) for a in node.names if a.name.startswith("npred.")]
        elif isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] == "npred":
            below = (node.module or "").split(".")[1:]
            places += [(node.lineno, name) for name in (below[:1] or [a.name for a in node.names])]
    return places


def across(modules: Mapping[str, str]) -> list[tuple[str, str, str]]:
    """Each import of another room: `file:line imports room`, the file's room, the other."""
    found = [(file, room(file), *each) for file, text in modules.items() for each in imports(text)]
    return [(f"{file}:{line} imports {name}", own, name) for file, own, line, name in found if name != own]


def without_a_floor(modules: Mapping[str, str]) -> list[str]:
    return sorted({room(file) for file in modules} - FLOOR.keys())


def upwards(modules: Mapping[str, str]) -> list[str]:
    return [place for place, own, name in across(modules) if FLOOR[name] > FLOOR[own]]


def in_circles(modules: Mapping[str, str]) -> list[str]:
    edges = {(own, name) for _, own, name in across(modules)}
    for _ in FLOOR:
        edges |= {(a, d) for a, b in edges for c, d in edges if b == c}
    return sorted(a for a, b in edges if a == b)


def between(modules: Mapping[str, str], own: str, other: str) -> list[str]:
    return [place for place, *rooms in across(modules) if rooms == [own, other]]


def test_a_module_is_on_a_floor_and_imports_from_those_below():
    assert without_a_floor(MODULES) == []
    places = upwards(MODULES)
    assert not places, "\n".join(places)  # pytest cuts a list short


def test_rooms_of_one_floor_do_not_import_each_other_in_circles():
    assert in_circles(MODULES) == []


def test_networks_and_predictors_meet_in_the_neural_predictor_only():
    places = between(MODULES, "predictors", "operators")
    assert {place.partition(":")[0] for place in places} == {"predictors/neural.py"}


def test_no_stage_knows_the_store():
    places = between(MODULES, "stages", "store")
    assert not places, "\n".join(places)


def test_npred_does_not_know_its_siblings():
    """The packages beside it: they import npred, and it reaches them by entry points."""
    siblings = [path.parent.name for path in ROOT.parent.glob("npred_*/__init__.py")]
    assert len(siblings) == 3
    texts = {file: text for file, text in MODULES.items() if any(name in text for name in siblings)}
    assert list(texts) == []


def test_an_offence_is_named_with_its_file_and_line():
    text = "import numpy\nfrom npred import cli, errors\ndef f():\n    import npred.store.locks\n"
    planted = {"stages/a.py": text, "cli/b.py": text, "attic/c.py": ""}
    assert upwards(planted) == ["stages/a.py:2 imports cli"] and without_a_floor(planted) == ["attic"]
    assert between(planted, "stages", "store") == ["stages/a.py:4 imports store"]
    assert in_circles({"plants/a.py": "import npred.store", "store/b.py": "import npred.plants"}) == ["plants", "store"]


@pytest.mark.parametrize("arguments", [["--help"], ["status", "{p}"], ["why", "train", "{p}"], ["ls"], ["plants"]])
def test_light_commands_import_nothing_heavy(arguments: list[str], pipeline: Path):
    program = (
        "import sys\nfrom npred.cli import main\ntry:\n    main()\nfinally:\n"
        f"    print('HEAVY', [m for m in {HEAVY} if m in sys.modules])"
    )
    command = [sys.executable, "-c", program, *(a.format(p=pipeline) for a in arguments)]
    done = subprocess.run(command, cwd=pipeline.parent, env=process_environment(), capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.splitlines()[-1] == "HEAVY []"


def test_help_loads_few_modules(tmp_path: Path):
    program = "import sys\nfrom npred.cli import main\ntry:\n    main()\nfinally:\n    print(*sys.modules)"
    command = [sys.executable, "-c", program, "--help"]
    done = subprocess.run(command, cwd=tmp_path, env=process_environment(), capture_output=True, text=True, check=True)
    loaded = done.stdout.splitlines()[-1].split()
    assert 10 < sum(name.partition(".")[0] == "npred" for name in loaded) <= 30
    assert len(loaded) < 450  # with those of typer, rich and Python itself
