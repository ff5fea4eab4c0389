"""Data on stdout, the rest on stderr; bars on terminals only."""

import io
import json
import os
import sys
from collections.abc import Callable

import pytest

from npred.console import EVERY, Console, columns


class Clock:
    """A clock that tests set."""

    now = 0.0

    def __call__(self) -> float:
        return self.now


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


@pytest.fixture
def on_terminal(monkeypatch: pytest.MonkeyPatch) -> Callable[[], Terminal]:
    """Makes stderr a terminal when called, for pytest takes stderr over after the fixtures."""
    monkeypatch.setenv("TERM", "xterm-256color")
    monkeypatch.setenv("COLUMNS", "120")
    monkeypatch.delenv("NO_COLOR", raising=False)

    def call() -> Terminal:
        monkeypatch.setattr(sys, "stderr", Terminal())
        return sys.stderr  # type: ignore[return-value]

    return call


def test_data_go_to_stdout_and_messages_to_stderr(capsys: pytest.CaptureFixture[str]):
    console = Console()
    console.out("data")
    console.json({"x": [1, None, "ε"]})
    console.note("note")
    console.warn("careful")
    console.error("wrong\nin two lines")
    out, err = capsys.readouterr()
    assert out.startswith("data\n")
    assert json.loads(out.removeprefix("data\n")) == {"x": [1, None, "ε"]}
    assert err.splitlines() == ["note", "warning: careful", "error: wrong in two lines"]


def test_quiet_keeps_warnings_and_errors(capsys: pytest.CaptureFixture[str]):
    console = Console(quiet=True)
    console.note("note")
    with console.bar("work", 2, "step") as bar:
        bar.advance(2)
    console.warn("careful")
    assert capsys.readouterr() == ("", "warning: careful\n")


def test_details_are_for_the_verbose(capsys: pytest.CaptureFixture[str]):
    Console().detail("hidden")
    Console(verbose=True).detail("shown")
    assert capsys.readouterr().err == "shown\n"


def test_json_refuses_what_is_no_json():
    with pytest.raises(ValueError, match="JSON"):
        Console().json({"x": float("nan")})


def test_without_a_terminal_progress_is_a_line_now_and_then(capsys: pytest.CaptureFixture[str]):
    clock = Clock()
    with Console(clock=clock).bar("train", 40, "epoch") as bar:
        for _ in range(40):
            clock.now += EVERY / 4
            bar.advance(note="loss 0.5")
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 10
    assert lines[0] == "train: 4/40 epoch in 10.0 s, 90 s left, loss 0.5"
    assert lines[-1] == "train: 40/40 epoch in 100.0 s, loss 0.5"


def test_short_work_is_one_line(capsys: pytest.CaptureFixture[str]):
    with Console().bar("generate", 1000, "sample") as bar:
        for _ in range(10):
            bar.advance(100)
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("generate: 1000/1000 sample in 0.")


def test_a_terminal_gets_a_bar_with_count_rate_and_note(on_terminal: Callable[[], Terminal]):
    terminal = on_terminal()
    with Console().bar("train", 50, "epoch") as bar:
        bar.advance(50, note="loss 0.25")
    for word in ("train", "100%", "50/50", "epoch/s", "loss 0.25"):
        assert word in terminal.getvalue()


def test_bars_nest_and_messages_come_between(on_terminal: Callable[[], Terminal]):
    terminal = on_terminal()
    console = Console()
    with console.bar("outer", 2, "case") as outer:
        for name in ("first", "second"):
            with console.bar(name, 1, "step") as inner:
                inner.advance()
            console.note(f"[{name}] is done")
            outer.advance()
    with console.bar("after", 1, "step") as bar:
        bar.advance()
    for word in ("outer", "2/2", "second", "[first] is done", "after"):
        assert word in terminal.getvalue()


def test_a_bar_cut_short_gives_the_terminal_back(on_terminal: Callable[[], Terminal]):
    terminal = on_terminal()
    with pytest.raises(KeyboardInterrupt), Console().bar("work", 3, "step") as bar:
        bar.advance()
        raise KeyboardInterrupt
    assert "1/3" in terminal.getvalue()
    assert terminal.getvalue().endswith("\n")


def test_stopping_ends_other_threads_at_their_next_word_of_progress():
    console = Console(quiet=True)
    with console.bar("work", 3, "step") as bar:
        bar.advance()
        console.stop()
        with pytest.raises(KeyboardInterrupt):
            bar.advance()


def test_colours_are_for_terminals_that_want_them(on_terminal: Callable[[], Terminal], monkeypatch: pytest.MonkeyPatch):
    terminal = on_terminal()
    Console().error("wrong")
    assert "\x1b[31m" in terminal.getvalue()
    monkeypatch.setenv("NO_COLOR", "1")
    before = len(terminal.getvalue())
    Console().error("a path that is longer than the screen: " + "x" * 200)
    (line,) = terminal.getvalue()[before:].splitlines()
    assert "\x1b[31m" not in line


def test_anything_else_is_printed_by_rich(capsys: pytest.CaptureFixture[str]):
    from rich.table import Table

    table = Table("predictor", "µs")
    table.add_row("euler " * 20, "1.3")
    Console().out(table)
    assert ("euler " * 20).strip() in capsys.readouterr().out  # not cut where stdout is no screen


def test_columns_align_and_are_never_cut(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setitem(os.environ, "COLUMNS", "10")
    text = columns(["stage", "reason"], [["train", "x" * 300], ["a longer name", "y"]])
    lines = text.splitlines()
    assert [line.index(word) for line, word in zip(lines, ["reason", "xxx", "y"], strict=True)] == [15, 15, 15]
    assert lines[1].endswith("x" * 300)
    assert not any(line.endswith(" ") for line in lines)
