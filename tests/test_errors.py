"""What of a foreign error is shown."""

import pytest

from npred.errors import first_line


@pytest.mark.parametrize(
    ("error", "line"),
    [
        (ValueError("first\nsecond"), "first"),
        (RuntimeError("\n  after an empty line\n"), "after an empty line"),
        (KeyError(), "KeyError"),
        (OSError(" \n"), "OSError"),
    ],
)
def test_the_first_line_says_something(error: Exception, line: str):
    assert first_line(error) == line
