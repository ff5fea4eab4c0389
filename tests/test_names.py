"""No plant's name occurs in the package outside its own file; messages are in plain words."""

import inspect
import re
from pathlib import Path

import pytest

from npred import plants

PACKAGE = Path(plants.__file__).parent.parent
NAMES = [row["name"] for row in plants.named() if plants.is_builtin(row["name"])]
EXCEPTIONS = {"activator_repressor": {"cli/commands.py"}}  # the plant of the data that [DAPF]'s authors published


@pytest.mark.parametrize("name", NAMES)
def test_a_plants_name_occurs_in_its_own_file_only(name: str):
    declaration = plants.resolve(name).declaration
    own = Path(inspect.getfile(inspect.unwrap(declaration.f)))
    said = rf"\b{declaration.__name__}\b|[\"'.]{name}\b"  # as a class, a string or a module; scalar is a word too
    texts = [path for path in PACKAGE.rglob("*") if path.suffix in (".py", ".txt") and path != own]
    found = {path.relative_to(PACKAGE).as_posix() for path in texts if re.search(said, path.read_text())}
    assert found == EXCEPTIONS.get(name, set())


@pytest.mark.parametrize("path", sorted(PACKAGE.rglob("*.py")), ids=lambda path: str(path.relative_to(PACKAGE)))
def test_messages_are_in_plain_words(path: Path):
    """Not every reader's first language is English: fix, not mend; one number per state, not a number a state."""
    odd = re.findall(r"\bmend\b|\bone an? (?:state|input|loop|joint)\b|\ba number an? \w+", path.read_text())
    assert odd == []
