"""The changes of a file of code, in its author's lines: remarks, docstrings and blank lines are no change."""

import ast
import io
import tokenize
from collections.abc import Iterator, Mapping
from difflib import SequenceMatcher

from npred.json_files import escaped
from npred.store.manifest import SourceText

LINES = 2000  # of a file that is compared
SHOWN = 2  # lines of one side of a change


def change(function: str, owner: str, before: SourceText | None, after: SourceText | None) -> str:
    """`kappa changed in my_plant.py: old lines -> new lines`, of that function of the class `owner`, else of the file.

    Without both texts it says that it changed; where the lines are equal, that what they call or import did.
    """
    if before is None or after is None:
        return f"{function} changed"
    hunks = _hunks(before.text, after.text, function, owner)
    if hunks is None:
        return f"{function} changed in {escaped(after.file)}"
    message = f"{function} changed in {escaped(after.file)}"
    return escaped(f"{message}: {'; '.join(hunks)}") if hunks else f"{message}, by code that it imports"


def _hunks(before: str, after: str, function: str, owner: str) -> list[str] | None:
    """The changes of the function's lines, or where it has none those of the file; None for what is no Python."""
    try:
        old, new = _Code(before), _Code(after)
    except (SyntaxError, ValueError, RecursionError, MemoryError, tokenize.TokenError):
        return None
    return _compared(old.function(owner, function), new.function(owner, function)) or _compared(old.lines, new.lines)


def _compared(before: Mapping[int, str], after: Mapping[int, str]) -> list[str]:
    old, new = list(before.values()), list(after.values())
    edits = SequenceMatcher(None, old, new, autojunk=False).get_opcodes()
    return [_hunk(old[a:b], new[c:d]) for kind, a, b, c, d in edits if kind != "equal"]


def _hunk(old: list[str], new: list[str]) -> str:
    if not old or not new:
        return f"{'new' if new else 'dropped'}: {_few(old or new)}"
    return f"{_few(old)} -> {_few(new)}"


def _few(lines: list[str]) -> str:
    more = len(lines) - SHOWN
    return " | ".join(lines[:SHOWN]) + (f" | and {more} more lines" if more > 0 else "")


class _Code:
    """The lines of a Python text that do something, by number. Raises what the parser raises."""

    def __init__(self, text: str) -> None:
        lines = text.replace("\r\n", "\n").split("\n")
        if len(lines) > LINES:
            raise ValueError("a long file")
        self.tree = ast.parse(text)
        for token in tokenize.generate_tokens(io.StringIO(text).readline):
            if token.type == tokenize.COMMENT:
                row, column = token.start
                lines[row - 1] = lines[row - 1][:column]
        for first, last in _docstrings(self.tree):
            lines[first - 1 : last] = [""] * (last - first + 1)
        self.lines = {number: " ".join(line.split()) for number, line in enumerate(lines, 1) if line.strip()}

    def function(self, owner: str, name: str) -> dict[int, str]:
        """The lines of the function in the class of that name, else of any function of that name."""
        classes = [node for node in ast.walk(self.tree) if isinstance(node, ast.ClassDef) and node.name == owner]
        for scope in [*classes, self.tree]:
            for node in ast.walk(scope):
                if isinstance(node, ast.FunctionDef) and node.name == name:
                    last = node.end_lineno or node.lineno
                    return {n: line for n, line in self.lines.items() if node.lineno <= n <= last}
        return {}


def _docstrings(tree: ast.AST) -> Iterator[tuple[int, int]]:
    """First and last line of each."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef) and ast.get_docstring(node, clean=False):
            text = node.body[0]
            yield text.lineno, text.end_lineno or text.lineno
