"""A module imports only from floors below its own, and the command line starts without the heavy libraries."""

import ast
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from conftest import process_environment

ROOT = Path(__file__).parent.parent / "npred"
FLOORS = [
    {"errors", "grid", "json_files", "randomness", "toml_text"},
    {"array_checks", "config", "defaults", "parallel", "registry", "symbolic", "terminal"},
    {"plants", "results", "robots", "store"},
    {"data", "operators"},
    {"delays", "training"},
    {"predictors"},
    {"diagnosis", "loop", "runtimes"},
    {"figures"},
    {"stages"},
    {"pipeline"},
    {"api", "sweep"},
    {"cli", "__main__"},
]
FLOOR = {name: floor for floor, names in enumerate(FLOORS) for name in names}
MODULES = sorted(path for path in ROOT.rglob("*.py") if path != ROOT / "__init__.py")
HEAVY = ("torch", "h5py", "sympy", "matplotlib", "scipy", "onnxruntime", "distributed")


def room(path: Path) -> str:
    return path.relative_to(ROOT).with_suffix("").parts[0]


def imports(path: Path) -> Iterator[tuple[int, str]]:
    """Line and first name below npred of each import from this package, those inside functions included."""
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            yield from ((node.lineno, a.name.split(".")[1]) for a in node.names if a.name.startswith("npred."))
        elif isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] == "npred":
            below = (node.module or "").split(".")[1:]
            yield from ((node.lineno, name) for name in (below[:1] or [a.name for a in node.names]))


@pytest.mark.parametrize("path", MODULES, ids=lambda path: str(path.relative_to(ROOT)))
def test_a_module_is_on_a_floor_and_imports_from_those_below(path: Path):
    assert room(path) in FLOOR, f"{room(path)}: give it a floor"
    above = [
        f"{path.name}:{line} imports {name}"
        for line, name in imports(path)
        if name != room(path) and FLOOR[name] > FLOOR[room(path)]
    ]
    assert above == []


def test_rooms_of_one_floor_do_not_import_each_other_in_circles():
    edges = {(room(path), name) for path in MODULES for _, name in imports(path) if name != room(path)}
    for _ in FLOOR:
        edges |= {(a, d) for a, b in edges for c, d in edges if b == c}
    assert [a for a, b in edges if a == b] == []


def test_networks_and_predictors_meet_in_the_neural_predictor_only():
    meeting = [str(p.relative_to(ROOT)) for p in MODULES if room(p) == "predictors" and "operators" in rooms_of(p)]
    assert meeting == ["predictors/neural.py"]
    assert [p for p in MODULES if room(p) == "operators" and "predictors" in rooms_of(p)] == []


def test_no_stage_knows_the_store():
    assert [path.name for path in MODULES if room(path) == "stages" and "store" in rooms_of(path)] == []


def test_experiments_import_no_room_above_the_stages():
    files = (ROOT.parent / "npred_experiments").glob("*.py")
    above = {(path.name, name) for path in files for name in rooms_of(path) if FLOOR[name] > FLOOR["stages"]}
    assert above == set()


def test_one_command_of_npred_loads_modules_of_the_package_of_experiments():
    assert [str(path.relative_to(ROOT)) for path in MODULES if "npred_experiments." in path.read_text()] == [
        "cli/reproduce.py"
    ]


def rooms_of(path: Path) -> set[str]:
    return {name for _, name in imports(path)}


@pytest.mark.parametrize("path", MODULES, ids=lambda path: str(path.relative_to(ROOT)))
def test_nothing_imports_upwards_by_a_relative_import_or_click(path: Path):
    for node in ast.walk(ast.parse(path.read_text())):
        assert not (isinstance(node, ast.ImportFrom) and node.level), f"{path}:{node.lineno}"
        names = [a.name for a in node.names] if isinstance(node, ast.Import) else [getattr(node, "module", None) or ""]
        assert not any(re.match(r"click\b", name) for name in names)


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
    assert 10 < sum(name.partition(".")[0] == "npred" for name in loaded) <= 25
    assert len(loaded) < 450  # with those of typer, rich and Python itself
