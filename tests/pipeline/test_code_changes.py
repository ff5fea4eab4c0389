"""What changed in a plant's file, in its author's lines."""

import pytest

from npred.pipeline.reasons import code_change
from npred.store import SourceText

TEXT = '''
"""A tank."""


class Other:
    def kappa(x, t, p, M):
        return [0]


class Tank:
    """A tank.

    Of water.
    """

    def f(x, u, t, p, M):
        return [u.q - x.h]

    def kappa(x, t, p, M):
        error = x.h - goal()
        return [2 - error]  # the law


def goal():
    return 1.0
'''


def changed(old: str = "", new: str = "", function: str = "kappa") -> str:
    assert old in TEXT
    before, after = (SourceText(file="my_plant.py", text=text) for text in (TEXT, TEXT.replace(old, new, 1)))
    return code_change(function, "Tank", before, after)


@pytest.mark.parametrize(
    ("old", "new", "lines"),
    [
        ("[2 - error]", "[3 - error]", "return [2 - error] -> return [3 - error]"),
        ("        error = x.h", "        # so\n        error  =  x.h", None),
        ("error = x.h - goal()\n", "error = x.h - goal()\n        error = error / 2\n", "new: error = error / 2"),
        ("        error = x.h - goal()\n", "", "dropped: error = x.h - goal()"),
        ("return 1.0", "return 1.5", "return 1.0 -> return 1.5"),
        ("[u.q - x.h]", "[u.q]", "return [u.q - x.h] -> return [u.q]"),
        ("class Other:\n    def kappa", "class Other:\n    def f(x): pass\n    def kappa", "new: def f(x): | pass"),
        ("Of water.", "Of oil.", None),
    ],
)
def test_a_change_is_told_in_the_lines_that_differ(old, new, lines):
    cause = ", by code that it imports" if lines is None else f": {lines}"
    assert changed(old, new) == f"kappa changed in my_plant.py{cause}"


def test_the_functions_own_lines_come_before_those_of_the_file():
    before = SourceText(file="a.py", text=TEXT)
    after = SourceText(file="a.py", text=TEXT.replace("2 - error", "3 - error").replace("u.q - x.h", "u.q"))
    assert code_change("f", "Tank", before, after) == "f changed in a.py: return [u.q - x.h] -> return [u.q]"
    assert code_change("kappa", "Tank", before, after).endswith(": return [2 - error] -> return [3 - error]")
    assert code_change("plant", "Tank", before, after).count("->") == 2


def test_long_changes_are_counted():
    more = "".join(f"        error = error + {k}\n" for k in range(5))
    said = changed("        return [2 - error]", f"{more}        return [2 - error]")
    assert said.endswith("new: error = error + 0 | error = error + 1 | and 3 more lines")


@pytest.mark.parametrize("text", ["class", "x = (" * 300, "\0", "pass\n" * 3000, "\\\n\x0c(", "'''"])
def test_texts_that_are_no_python_are_told_without_lines(text):
    before, after = (SourceText(file="a.py", text=text) for text in (text, TEXT))
    assert code_change("kappa", "Tank", before, after) == "kappa changed in a.py"


def test_without_a_text_it_is_said_that_something_changed():
    assert code_change("kappa", "Tank", None, SourceText(file="a.py", text=TEXT)) == "kappa changed"


def test_nothing_in_the_lines_moves_a_cursor():
    said = changed("[2 - error]", "[2 - len('\x1b[2J\u202e')]")
    assert said.isprintable() and "\\x1b[2J" in said
