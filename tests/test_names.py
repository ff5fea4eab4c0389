"""No plant's name occurs in the package outside its own file: adding one touches no other."""

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
