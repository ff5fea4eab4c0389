"""Windows and macOS, as far as another system can tell: no POSIX, another encoding, names that differ only by case."""

import importlib
import json
import pkgutil
import subprocess
import sys
from collections import Counter
from pathlib import Path

import pytest
from conftest import HERE, process_environment

from npred import plants
from npred.base import registry

READ = ["--help", "plants", "help", "show paper", "ls", "reproduce --list", "status smoke", "doctor", "why smoke"]
PROGRAM = str(HERE / "as_on_windows.py")


def npred(*words: str, folder: Path, **environment: str) -> subprocess.CompletedProcess[bytes]:
    environment = process_environment(**environment)
    return subprocess.run([sys.executable, PROGRAM, *words], cwd=folder, env=environment, capture_output=True)


@pytest.mark.slow
def test_the_whole_chain_runs_without_posix(tmp_path):
    first = npred("run", "smoke", "--store", "store", "--jobs", "2", folder=tmp_path)
    assert first.returncode == 0, first.stderr.decode()
    again = npred("run", "smoke", "--store", "store", "--json", folder=tmp_path)
    assert {row["action"] for row in json.loads(again.stdout)["stages"]} == {"hit"}


def test_every_module_is_imported_without_posix(tmp_path):
    program = f"""
import as_on_windows, importlib
as_on_windows.forget()
for name in {modules()!r}:
    importlib.import_module(name)
"""
    done = subprocess.run(
        [sys.executable, "-c", program], cwd=tmp_path, env=process_environment(), capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr


@pytest.mark.slow
def test_the_tests_are_collected_without_posix(tmp_path):
    tests = [str(folder) for folder in (HERE, *HERE.parent.glob("siblings/*/tests"))]
    program = f"""
import as_on_windows, distributed, fmpy, platformdirs.unix, pytest, sys, torch._dynamo, xdist
as_on_windows.forget()
sys.exit(pytest.main([*{tests!r}, "--collect-only", "-qq", "-p", "no:cacheprovider"]))
"""
    done = subprocess.run(
        [sys.executable, "-c", program], cwd=tmp_path, env=process_environment(), capture_output=True, text=True
    )
    assert done.returncode == 0, done.stdout[-2000:]


def modules() -> list[str]:
    """All modules of npred, its rig and its robots that load no torch, which asks for POSIX itself."""
    torch = (
        "npred.lab.training",
        "npred.lab.training.operators",
        "npred.lab.stages.train",
        "npred.__main__",
        "npred.lab.training.neural",
    )
    packages = [importlib.import_module(name) for name in ("npred", "npred_rig", "npred_robots")]
    names = [found.name for p in packages for found in pkgutil.walk_packages(p.__path__, f"{p.__name__}.")]
    return [name for name in names if not name.startswith((*torch, "npred.exports.onnx", "npred.lab.stages.certify"))]


def test_a_console_of_windows_shows_what_is_printed(tmp_path):
    """By commands of one process: each as a process of its own would import the same for a second."""
    program = f"""
import as_on_windows, os, sys
as_on_windows.forget()
os.environ["NPRED_STORE"] = "store"
from npred.__main__ import main
for words in {READ!r}:
    sys.argv = ["npred", *words.split()]
    print(">", words, flush=True)
    try:
        main()
    except SystemExit:
        pass
"""
    environment = process_environment(PYTHONIOENCODING="cp1252", PYTHONUTF8="0")
    done = subprocess.run([sys.executable, "-c", program], cwd=tmp_path, env=environment, capture_output=True)
    assert done.returncode == 0 and b"Traceback" not in done.stderr and b"UnicodeEncodeError" not in done.stderr
    shown = done.stdout.decode("cp1252")
    assert [words for words in READ if f"> {words}" not in shown] == []


def test_what_windows_lacks_is_taken_away():
    program = """
import as_on_windows, os, signal
as_on_windows.forget()
print(hasattr(os, "fork"), hasattr(signal, "SIGHUP"))
"""
    done = subprocess.run([sys.executable, "-c", program], env=process_environment(), capture_output=True, text=True)
    assert done.stdout == "False False\n"


def test_no_two_files_differ_by_case_only():
    listed = subprocess.run(["git", "ls-files"], cwd=HERE.parent, capture_output=True, text=True, check=True).stdout
    assert repeated(listed.splitlines()) == []


def test_no_two_names_differ_by_case_only():
    for names in (plants.names(), registry.NETWORKS.names(), registry.RUNTIMES.names()):
        assert repeated(names) == []


def repeated(names) -> list[str]:
    return [name for name, count in Counter(map(str.casefold, names)).items() if count > 1]
