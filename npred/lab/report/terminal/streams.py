"""The streams that people read: which text may go there, in which encoding, and how a closed or full one ends.

All of npred's words on stdout and stderr pass through here, so that no text of a result, a plant or an error moves the
cursor, turns the direction of writing or hides behind characters without a width.
"""

import os
import shutil
import sys
import textwrap
from contextlib import suppress
from functools import partial
from io import TextIOWrapper
from typing import TextIO, cast

from npred.base.errors import NpredError
from npred.base.json_files import escaped


def printable(text: str) -> str:
    """The text with all that a terminal obeys or hides spelt out, but for its line ends."""
    return "\n".join(escaped(line) for line in text.split("\n"))


def is_utf8(stream: TextIO) -> bool:
    """True if a stream takes any character; one without an encoding, in memory, does."""
    return (getattr(stream, "encoding", None) or "utf-8").lower().replace("-", "") == "utf8"


def is_terminal(stream: TextIO | None) -> bool:
    """True if a stream is a screen; one that is closed is none."""
    try:
        return stream is not None and stream.isatty()
    except (OSError, ValueError):
        return False


def width(stream: TextIO | None) -> int | None:
    """The columns of the screen that a stream is, or None where it is none: nothing is folded for a file or a pipe."""
    return shutil.get_terminal_size().columns if is_terminal(stream) else None


def folded(text: str, limit: int | None) -> str:
    """The text with lines of more than `limit` columns broken between words; a path stays whole, to be copied."""
    if limit is None:
        return text
    fill = partial(textwrap.fill, break_long_words=False, break_on_hyphens=False, replace_whitespace=False)
    return "\n".join(fill(line, limit) for line in text.split("\n"))


def answer(text: str) -> None:
    """The text and a line end on stdout. Raises NpredError where it is closed or full, BrokenPipeError for `head`."""
    try:
        sys.stdout.write(text + "\n")
        sys.stdout.flush()
    except OSError as error:
        silence(sys.stdout)
        raise error if isinstance(error, BrokenPipeError) else unwritable(error.strerror) from None
    except (ValueError, AttributeError):  # the file is closed, or there is none
        raise unwritable("a closed one") from None


def unwritable(reason: str | None) -> NpredError:
    """The failure of a stdout that takes nothing."""
    todo = "the results are in the store, send stdout elsewhere"
    return NpredError(f"stdout: expected a stream that takes the answer, got {reason}; {todo}")


def silence(stream: TextIO) -> None:
    """Send the rest of a stream to nowhere: Python would fail to write it when it ends."""
    with suppress(OSError, ValueError):
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, stream.fileno())
        os.close(nowhere)


def prepare() -> None:
    """Spell out the characters that the encoding of a stream lacks, as \\u03b5; a closed stderr takes all, unseen."""
    if sys.stderr is None:
        sys.stderr = open(os.devnull, "w", encoding="utf-8")  # noqa: SIM115
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")


class Messages:
    """stderr as rich and `Console` write to it: one that is closed or full loses words, and no work.

    While a live view is up, what others write to sys.stderr goes to the view, which writes here: to stderr itself.
    """

    @property
    def stream(self) -> TextIO:
        """stderr itself."""
        return getattr(sys.stderr, "rich_proxied_file", sys.stderr)

    @property
    def encoding(self) -> str:
        return getattr(self.stream, "encoding", None) or "utf-8"

    def write(self, text: str) -> int:
        """Write as much of the text as can be written."""
        try:
            self.stream.write(text)
        except (OSError, ValueError):
            silence(self.stream)
        return len(text)

    def flush(self) -> None:
        try:
            self.stream.flush()
        except (OSError, ValueError):
            silence(self.stream)

    def isatty(self) -> bool:
        return is_terminal(self.stream)


MESSAGES = cast(TextIO, Messages())
