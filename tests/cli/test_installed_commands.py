"""Commands that installed packages register: they stand beside npred's own, and one that fails stops no other."""

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

from conftest import process_environment

GREET = """
from typing import Annotated
from npred.cli.options import Common, flag

def greet(options: Common, *, name: Annotated[str, flag("Whom.")] = "you") -> None:
    \"\"\"Say a word.\"\"\"
    options.show({"word": name}, lambda: f"hello {name}")
"""


def run(folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    environment = process_environment()
    environment["PYTHONPATH"] += f":{folder}"
    command = [sys.executable, "-m", "npred", *arguments]
    return subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, timeout=60)


def test_a_command_of_a_package_has_the_flags_of_its_class(package: Callable[..., None], tmp_path: Path):
    package("greet = shed_of_tanks:greet\nls = shed_of_tanks:greet", GREET, "npred.commands")
    assert run(tmp_path, "greet", "--name", "Ada", "--json").stdout.split() == ["{", '"word":', '"Ada"', "}"]
    assert "Say a word." in run(tmp_path, "--help").stdout
    assert "hello" not in run(tmp_path, "ls").stdout  # npred's own stays


def test_one_that_fails_is_a_warning(package: Callable[..., None], tmp_path: Path):
    package("greet = shed_of_tanks:greet", "raise ValueError('broken')", "npred.commands")
    done = run(tmp_path, "ls")
    assert done.returncode == 0 and "command greet: shed-of-tanks failed on import" in done.stderr
