"""Data on stdout, the rest on stderr; bars on terminals only."""

import io
import json
import os
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from npred.lab.report.terminal.console import Console, columns


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


def test_the_environment_keeps_it_quiet_too(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("NPRED_QUIET", "1")
    console = Console()
    console.wait("compiling a kernel")
    with console.bar("work", 2, "step") as bar:
        bar.advance(2)
    console.note("note")
    assert capsys.readouterr() == ("", "note\n")


def test_what_is_to_be_expected_once_is_said_once_in_a_run(capsys: pytest.CaptureFixture[str]):
    console = Console()
    for what in ("5 kernels: about 3 s", "a kernel: about 1 s", "a kernel: about 1 s"):
        console.wait(f"compiling {what}, once per plant")
    console.wait("simulating 1 loop: about 3 s")
    console.wait("simulating 1 loop: about 3 s")
    said = capsys.readouterr().err.splitlines()
    assert said == ["compiling 5 kernels: about 3 s, once per plant", *2 * ["simulating 1 loop: about 3 s"]]


def test_details_are_for_the_verbose(capsys: pytest.CaptureFixture[str]):
    Console().detail("hidden")
    Console(verbose=True).detail("shown")
    assert capsys.readouterr().err == "shown\n"


def test_json_refuses_what_is_no_json():
    with pytest.raises(ValueError, match="JSON"):
        Console().json({"x": float("nan")})


def test_a_terminal_gets_a_bar_with_the_count(on_terminal: Callable[[], Terminal]):
    terminal = on_terminal()
    with Console().bar("verify", 50, "results") as bar:
        bar.advance(50)
    for word in ("verify", "50 results", "0:00"):
        assert word in terminal.getvalue()


def test_bars_nest_and_messages_come_between(on_terminal: Callable[[], Terminal]):
    terminal = on_terminal()
    console = Console()
    with console.bar("outer", 2, "cases") as outer:
        for name in ("first", "second"):
            with console.bar(name, 1, "steps") as inner:
                inner.advance()
            console.note(f"[{name}] is done :smile:")
            outer.advance()
    with console.bar("after", 1, "steps") as bar:
        bar.advance()
    for word in ("outer", "2 cases", "second", "1 step", "[first] is done :smile:", "after"):
        assert word in terminal.getvalue()


def test_a_bar_cut_short_gives_the_terminal_back(on_terminal: Callable[[], Terminal]):
    terminal = on_terminal()
    with pytest.raises(KeyboardInterrupt), Console().bar("work", 3, "steps") as bar:
        bar.advance()
        raise KeyboardInterrupt
    assert "stopped" in terminal.getvalue()
    assert terminal.getvalue().endswith("\x1b[?25h")  # the cursor is shown again


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
    first, path = terminal.getvalue()[before:].splitlines()
    assert (first, path) == ("error: a path that is longer than the screen:", "x" * 200)


def test_only_a_screen_folds_what_is_said(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]):
    text = f"see {'x' * 90} and then {'word ' * 30}"
    Console().out(text)
    assert capsys.readouterr().out == text + "\n"
    monkeypatch.setenv("COLUMNS", "80")
    monkeypatch.setattr(sys, "stdout", Terminal())
    Console().out(text)
    lines = sys.stdout.getvalue().splitlines()  # type: ignore[attr-defined]
    assert "x" * 90 in lines  # a path stays whole
    assert max(map(len, lines[2:])) <= 80 and " ".join(lines).split() == text.split()


STRANGE = "\x1b[2J\x9b1m\u202e\u200b\ud800[red]:smile:"
SPELT = r"\x1b[2J\x9b1m\u202e\u200b\ud800[red]:smile:"


def test_nothing_that_is_said_moves_the_cursor(capsys: pytest.CaptureFixture[str]):
    console = Console(verbose=True)
    for say in (console.out, console.note, console.detail, console.warn, console.error):
        say(STRANGE)
    console.out(columns([STRANGE], [[STRANGE + "\n"]]))
    with console.bar(STRANGE, 1, STRANGE) as bar:
        bar.advance(1, STRANGE)
    out, err = capsys.readouterr()
    assert [line for line in (out + err).split("\n") if not line.isprintable()] == []
    assert out.count(SPELT) == 3 and err.count(SPELT) == 7


def test_nothing_on_a_screen_moves_the_cursor(on_terminal: Callable[[], Terminal]):
    terminal = on_terminal()
    console = Console()
    with console.watch(STRANGE, [STRANGE]):
        console.doing(STRANGE, STRANGE)
        console.error(STRANGE)
        with console.bar(STRANGE, 1, STRANGE) as bar:
            bar.advance(1, STRANGE)
    console.error(STRANGE)
    shown = terminal.getvalue()
    assert "\x1b[2J" not in shown and not set(shown) & set("\x9b\u202e\u200b\ud800")
    assert "[red]:smile:" in shown


def test_json_holds_any_text_and_moves_no_cursor(capsys: pytest.CaptureFixture[str]):
    Console().json({STRANGE: STRANGE})
    out = capsys.readouterr().out
    assert json.loads(out) == {STRANGE: STRANGE}
    assert all(line.isprintable() for line in out.splitlines())


def test_the_log_has_what_is_said_and_each_epoch(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    console = Console(quiet=True)
    console.keep_log(tmp_path, "tiny")
    console.note("a note")
    console.detail("a detail")
    console.warn(STRANGE)
    console.doing("train fno", "importing")
    console.measured("train fno", {"epoch": 3, "loss": 0.25})
    with console.bar("train fno", 3, "epochs", done=2) as bar:
        bar.advance(1, "loss 0.25")
    console.finish("train fno", "run", 1.5)
    console.close()
    (path,) = (tmp_path / "logs").iterdir()
    lines = [line[10:] for line in path.read_text().splitlines()]
    assert lines[1:4] == ["a note", "a detail", f"warning: {SPELT}"]
    assert lines[4:6] == ["train fno: importing", "train fno: epoch 3, loss 0.25"]
    assert lines[6].startswith("train fno: 3/3 epochs in ") and lines[7] == "train fno: done after 1.5 s"
    assert capsys.readouterr().err == f"warning: {SPELT}\n"


def test_columns_align_and_are_never_cut(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setitem(os.environ, "COLUMNS", "10")
    text = columns(["stage", "reason"], [["train", "x" * 300], ["a longer name", "y"]])
    lines = text.splitlines()
    assert [line.index(word) for line, word in zip(lines, ["reason", "xxx", "y"], strict=True)] == [15, 15, 15]
    assert lines[1].endswith("x" * 300)
    assert not any(line.endswith(" ") for line in lines)


def test_columns_fold_the_widest_until_the_screen_holds_them():
    head, rows = ["stage", "key", "reason"], [["train fno", "0123456789ab", "word " * 40], ["evaluate", "-", "z" * 100]]
    lines = columns(head, rows, 80).splitlines()
    assert max(map(len, lines)) <= 80
    assert "".join(lines).count("word") == 40 and "".join(lines).count("z") == 100  # nothing is cut
    assert all(line.startswith(" " * 25) for line in lines[2:] if not line.startswith("evaluate"))


def test_keys_are_not_broken_for_sentences():
    rows = [
        ["activator_repressor", "x1, x2", "a=1 b=2 " * 10],
        ["generate/0123456789ab", "theta1, theta2, " * 3, "c=3"],
    ]
    lines = columns(["plant", "states", "parameters"], rows, 80).splitlines()
    assert max(map(len, lines)) <= 80
    assert any("activator_repressor" in line for line in lines)
    assert any("generate/0123456789ab" in line for line in lines)
    narrow = columns(["plant", "states", "parameters"], rows, 36).splitlines()
    assert max(map(len, narrow)) <= 36 and "".join(narrow).count("a=1") == 10


def test_numbers_are_aligned_at_their_right_and_hats_take_no_column():
    assert columns(["D̂", "µs"], [["1", "9.5"], ["22", "100.5"]], numbers=["µs"]).splitlines() == [
        "D̂      µs",
        "1     9.5",
        "22  100.5",
    ]
