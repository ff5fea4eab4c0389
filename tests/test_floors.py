"""A room imports only from those before it, and the command line starts without the heavy libraries."""

import ast
import subprocess
import sys
from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path

import pytest
from conftest import process_environment

ROOT = Path(__file__).parent.parent / "npred"
ROOMS = (  # a room imports from those before it
    "base", "formulas", "kernels", "plants", "prediction", "networks", "guard", "laws", "estimation", "loop",
    "identification", "diagnosis", "exports",
    "lab/config", "lab/training", "lab/store", "lab/report", "lab/scheduler", "lab/stages", "cli", "",
)  # fmt: skip
APPLICATION = ("lab/", "cli")
MODULES = {path.relative_to(ROOT).as_posix(): path.read_text() for path in sorted(ROOT.rglob("*.py"))}
HEAVY = ("torch", "h5py", "sympy", "matplotlib", "scipy", "onnxruntime", "distributed")


def room(parts: Sequence[str]) -> str:
    """The folder of npred/, or of npred/lab/, that a module is in; "" for npred/ itself."""
    if len(parts) < 2:
        return ""
    return "/".join(parts[:2]) if parts[0] == "lab" else parts[0]


@cache
def imported(text: str) -> list[tuple[int, str]]:
    """Line and dotted name of all that is imported, inside functions too."""
    nodes = list(ast.walk(ast.parse(text)))
    names = [(node.lineno, a.name) for node in nodes if isinstance(node, ast.Import) for a in node.names]
    froms = [node for node in nodes if isinstance(node, ast.ImportFrom)]
    return names + [(node.lineno, f"{node.module}.{a.name}") for node in froms for a in node.names]


def imports(text: str) -> list[tuple[int, str]]:
    """Line and room of each import from this package."""
    found = [(line, name.split(".")) for line, name in imported(text)]
    return [(line, room([*parts[1:], "x"])) for line, parts in found if parts[0] == "npred" and len(parts) > 1]


def circles(modules: Mapping[str, str]) -> list[str]:
    """The modules, texts by dotted names, that import themselves through others."""
    there = {name: [each for _, each in imported(text)] for name, text in modules.items()}
    arrows = {name: {each if each in modules else each.rpartition(".")[0] for each in there[name]} for name in modules}
    for middle in modules:  # all that is reached through the modules so far
        arrows = {name: far | arrows[middle] if middle in far else far for name, far in arrows.items()}
    return sorted(name for name, far in arrows.items() if name in far)


def across(modules: Mapping[str, str]) -> list[tuple[str, str, str]]:
    """Each import of another room: `file:line imports room`, the file's room, the other."""
    found = [(file, room(file.split("/")), *each) for file, text in modules.items() for each in imports(text)]
    return [(f"{file}:{line} imports {name}", here, name) for file, here, line, name in found if name not in ("", here)]


def upwards(modules: Mapping[str, str]) -> list[str]:
    return [place for place, here, there in across(modules) if ROOMS.index(there) > ROOMS.index(here)]


def between(modules: Mapping[str, str], here: str, there: str) -> list[str]:
    return [place for place, *rooms in across(modules) if rooms == [here, there]]


def test_every_module_is_in_a_room():
    assert {room(file.split("/")) for file in MODULES} == set(ROOMS)


def test_a_room_imports_from_those_before_it():
    places = upwards(MODULES)
    assert not places, "\n".join(places)  # pytest cuts a list short


def test_the_library_imports_nothing_of_the_application():
    places = [place for place, here, there in across(MODULES)
              if here and not here.startswith(APPLICATION) and there.startswith(APPLICATION)]  # fmt: skip
    assert not places, "\n".join(places)


def test_no_stage_knows_the_store():
    places = between(MODULES, "lab/stages", "lab/store")
    assert not places, "\n".join(places)


def test_no_modules_import_each_other_in_a_circle():
    packages = [ROOT, *ROOT.parent.glob("siblings/*")]
    paths = {path.relative_to(top.parent): path for top in packages for path in top.rglob("*.py")}
    names = {".".join(path.with_suffix("").parts).removesuffix(".__init__"): file for path, file in paths.items()}
    assert len(names) > 250 and circles({name: file.read_text() for name, file in names.items()}) == []


def test_a_circle_is_found_also_inside_functions():
    a, b = "def f():\n    from p.b import g\n", "import p.c\nimport p.d"
    c, d = "from p import a\n", "import sys"
    assert circles({"p.a": a, "p.b": b, "p.c": c, "p.d": d, "p": "from p import c"}) == ["p.a", "p.b", "p.c"]


def test_npred_does_not_know_its_siblings():
    """The packages beside it: they import npred, and it reaches them by entry points."""
    siblings = [path.parent.name for path in ROOT.parent.glob("siblings/*/__init__.py")]
    assert len(siblings) == 4
    texts = {file: text for file, text in MODULES.items() if any(name in text for name in siblings)}
    assert list(texts) == []


def test_an_offence_is_named_with_its_file_and_line():
    text = "import numpy\nfrom npred import cli\ndef f():\n    import npred.lab.store.claims\n"
    planted = {"lab/stages/a.py": text, "cli/b.py": text}
    assert upwards(planted) == ["lab/stages/a.py:2 imports cli"]
    assert between(planted, "lab/stages", "lab/store") == ["lab/stages/a.py:4 imports lab/store"]


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
