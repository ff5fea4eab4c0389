"""The live view and bars: what a console shows of each stage, on terminals, in notebooks and without a screen."""

import io
import re
import sys
import threading
from types import ModuleType, SimpleNamespace
from typing import Any

import pytest
from rich.cells import cell_len
from rich.console import Console as Rich

from npred.base.progress import counted
from npred.lab.report.terminal import notebook
from npred.lab.report.terminal.console import EVERY, Bar, Console
from npred.lab.report.terminal.live_view import LiveView


class Clock:
    now = 0.0

    def __call__(self) -> float:
        return self.now


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.fixture
def view(clock: Clock) -> LiveView:
    return LiveView("paper on cpu", ["generate", "train fno", "evaluate"], clock)


def shown(view: LiveView, width: int = 120) -> list[str]:
    """The lines of the table, without the heading and without spaces at their ends."""
    rich = Rich(width=width, file=io.StringIO(), record=True)
    rich.print(view.get_renderable())
    return [line.rstrip() for line in rich.export_text().splitlines()][1:]


def test_stages_wait_run_and_are_done(view: LiveView, clock: Clock):
    view.finish("generate", "hit")
    with view.bar("train fno", 40) as advance:
        for k in (1, 2, 3):
            clock.now = 10.0 * k
            advance(5, f"{5 * k}/40 epochs, loss 2.5e-01")
        done, running, waiting = shown(view)
        assert done.split() == ["✓", "generate", "from", "the", "store", "0:00:00"]
        assert running.startswith("▸ train fno") and "━" in running
        assert running.split()[-6:] == ["15/40", "epochs,", "loss", "2.5e-01", "0:00:30", "0:00:50"]
        assert waiting.split()[:2] == ["·", "evaluate"]
    clock.now = 3720.0
    view.finish("train fno", "run")
    clock.now = 9999.0
    assert shown(view)[1].split() == ["✓", "train", "fno", "1:02:00"]


def test_a_stage_says_what_it_does_from_its_first_moment(view: LiveView, clock: Clock):
    view.doing("evaluate", "importing")
    clock.now = 41.0
    assert shown(view)[2].split() == ["▸", "evaluate", "importing", "0:00:41"]
    view.doing("evaluate", "compiling")
    with view.bar("evaluate", 20_000) as advance:
        clock.now = 65.0
        assert "0:01:05" in shown(view)[2] and "compiling" in shown(view)[2]  # until it moves
        advance(5_000, "5000/20000 steps")
        assert "5000/20000 steps" in shown(view)[2] and "compiling" not in shown(view)[2]
    view.doing("evaluate", "drawing")
    assert shown(view)[2].split() == ["▸", "evaluate", "drawing", "0:01:05"]


def test_the_time_left_after_a_resume_counts_this_run_only(view: LiveView, clock: Clock):
    with view.bar("train fno", 180, done=116) as advance:
        for k in range(5):
            clock.now = 10.0 * k
            advance(1, "")
        assert shown(view)[1].split()[-2:] == ["0:00:40", "0:09:50"]


def test_work_that_is_no_stage_gets_a_row_of_its_own(view: LiveView):
    with view.bar("warm up", 3) as advance:
        advance(0, "0/3 calls")
        assert "0/3 calls" in shown(view)[3]
        advance(3, "3/3 calls")
    assert shown(view)[3].split() == ["✓", "warm", "up", "3/3", "calls", "0:00:00"]


def test_words_move_no_cursor(view: LiveView):
    view.doing("generate", "\x1b[2Jlooking")
    with view.bar("warm \u202eup", 3) as advance:
        advance(1, "1/3 ca\u202ells")
        lines = shown(view)
    assert r"\x1b[2Jlooking" in lines[0] and r"warm \u202eup" in lines[3] and r"1/3 ca\u202ells" in lines[3]


@pytest.mark.parametrize("width", [40, 60, 80, 100, 200])
@pytest.mark.parametrize("words", ["", "loss 2.50e-01, ε sup 1.20e-01", "a long sentence " * 20, "wide 零件 " * 30])
def test_a_row_is_one_line_and_ends_with_its_times(clock: Clock, width: int, words: str):
    view = LiveView("a pipeline on cuda:0" * 20, ["generate", "train deeponet", "train fno"], clock, width)
    view.finish("generate", "hit")
    view.doing("train fno", f"importing {words}")
    with view.bar("train deeponet", 2000) as advance, view.bar(f"scenarios {words}", 100) as move:
        for k in (1, 2):
            clock.now = 1799.5 * k
            advance(500, f"{500 * k}/2000 epochs, {words}")
            move(5, f"{5 * k}/100 steps")
        lines = shown(view, width)
        assert len(lines) == 4 and max(map(cell_len, lines)) <= width - 2  # two are for the terminal's ^C
        assert all(line.startswith(mark) for line, mark in zip(lines, "✓▸▸▸", strict=True))
        assert lines[1].endswith(" 0:59:59 0:59:59") and lines[2].endswith(" 0:59:59")
        assert lines[3].endswith(" 0:59:59 8:59:51")
        assert "━" in lines[1]


def test_a_training_fits_eighty_columns(clock: Clock):
    view = LiveView("paper on cpu", ["generate", "train deeponet"], clock, 80)
    with view.bar("train deeponet", 200) as advance:
        clock.now = 10.0
        advance(50, "50/200 epochs, loss 2.50e-01")
        assert shown(view, 80)[1].split() == [
            *("▸", "train", "deeponet", "━", "50/200", "epochs,", "loss", "2.50e-01", "0:00:10", "-:--:--")
        ]


def test_threads_count_together(view: LiveView):
    with view.bar("evaluate", 4000) as advance:
        threads = [threading.Thread(target=lambda: [advance(1, "") for _ in range(1000)]) for _ in range(4)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        assert view.stages["evaluate"].completed == 4000


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True

    def lines(self) -> list[str]:
        """What stands on the screen after all that was written, of the controls those that the view uses."""
        rows, at, column = [""], 0, 0
        for part in re.findall(r"\x1b\[[?\d;]*[A-Za-z]|\r|\n|[^\x1b\r\n]+", self.getvalue()):
            if part == "\n":
                at, column = at + 1, 0
                rows += [""] * (at == len(rows))
            elif part == "\r":
                column = 0
            elif part == "\x1b[2K":
                rows[at] = ""
            elif up := re.fullmatch(r"\x1b\[(\d+)A", part):
                at -= int(up[1])
            elif not part.startswith("\x1b"):
                rows[at] = rows[at][:column].ljust(column) + part + rows[at][column + len(part) :]
                column += len(part)
        return [row.rstrip() for row in rows]


def test_a_terminal_gets_the_view_and_messages_above_it(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("TERM", "xterm-256color")
    monkeypatch.setenv("COLUMNS", "120")
    monkeypatch.setattr(sys, "stderr", Terminal())
    console = Console()
    with console.watch("tiny on cpu", ["generate"]):
        with console.bar("generate", 2, "steps") as bar:
            bar.advance(2)
        console.warn("far out")
        console.finish("generate", "run", 1.5)
    assert console.view is None
    text = sys.stderr.getvalue()  # type: ignore[attr-defined]
    assert "tiny on cpu" in text and "warning: far out" in text
    assert text.rindex("0:00:00") > text.index("far out")


@pytest.mark.parametrize("others", ["stderr", "stdout"])
def test_what_others_write_stands_above_the_view(monkeypatch: pytest.MonkeyPatch, others: str):
    monkeypatch.setenv("TERM", "xterm-256color")
    screen = Terminal()
    for name in ("stdout", "stderr"):
        monkeypatch.setattr(sys, name, screen)
    console = Console()
    with console.watch("tiny on cpu", ["generate"]):
        console.view.live.auto_refresh = False  # type: ignore[union-attr]
        getattr(sys, others).write("a library\nwarns")
        console.note("one more")
    assert getattr(sys, others) is screen
    assert screen.lines() == ["a library", "one more", "warns", "tiny on cpu", "· generate   -:--:--", ""]


def test_an_answer_in_a_pipe_stays_there_while_the_view_is_up(monkeypatch: pytest.MonkeyPatch, capsys):
    monkeypatch.setattr(sys, "stderr", Terminal())
    console = Console()
    with console.watch("tiny on cpu", ["generate"]):
        console.out("the answer")
    assert capsys.readouterr().out == "the answer\n"


def test_stopping_reaches_the_bars_of_the_view(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(sys, "stderr", Terminal())
    console = Console()
    with console.watch("tiny", ["train"]), console.bar("train", 2, "epoch") as bar:
        console.stop()
        with pytest.raises(KeyboardInterrupt):
            bar.advance()


def test_what_runs_when_a_run_fails_is_shown_as_stopped(view: LiveView):
    view.live.auto_refresh = False
    with pytest.raises(ZeroDivisionError), view:
        view.doing("generate", "importing")
        raise ZeroDivisionError
    assert shown(view)[0].split() == ["✗", "generate", "stopped", "0:00:00"]


def test_a_screen_without_its_signs_gets_plain_lines(monkeypatch: pytest.MonkeyPatch, capsys):
    class Latin(io.TextIOWrapper):
        def isatty(self) -> bool:
            return True

    monkeypatch.setattr(sys, "stderr", Latin(io.BytesIO(), encoding="latin-1", errors="backslashreplace"))
    with Console().watch("tiny", ["generate"]), Console().bar("generate", 2, "steps") as bar:
        bar.advance(2, "ε sup 1")
    sys.stderr.seek(0)
    assert r"2/2 steps in 0.0 s, \u03b5 sup 1" in sys.stderr.read()


def test_elsewhere_there_are_plain_lines(capsys: pytest.CaptureFixture[str]):
    console = Console()
    with console.watch("tiny", ["generate"]), console.bar("generate", 2, "steps") as bar:
        bar.advance(2)
        console.measured("generate", {"epoch": 1})
        console.finish("generate", "run", 1.0)
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("generate: 2/2 steps in ")


@pytest.fixture
def outputs(monkeypatch: pytest.MonkeyPatch) -> list[dict[str, str]]:
    """The states of the one output that a cell has."""
    shown: list[dict[str, str]] = []

    def update(bundle: dict[str, str], raw: bool) -> None:
        shown.append(bundle)

    def display(bundle: dict[str, str], raw: bool, display_id: bool) -> Any:
        assert not shown, "a second output"
        shown.append(bundle)
        return SimpleNamespace(update=update)

    fake, inner = ModuleType("IPython"), ModuleType("IPython.display")
    fake.get_ipython = lambda: SimpleNamespace(kernel=object())  # type: ignore[attr-defined]
    inner.display = display  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "IPython", fake)
    monkeypatch.setitem(sys.modules, "IPython.display", inner)
    return shown


def test_the_view_is_one_output_that_ends_with_the_stages(outputs: list[dict[str, str]], capsys: Any):
    console = notebook.NotebookConsole()
    with console.watch("tank", ["generate"]):
        console.doing("generate", "compiling")
        console.note("generate: running")
        with console.bar("generate", 8, "rollouts") as bar:
            bar.advance(8)
        console.finish("generate", "run", 3.0)
    assert "generate" in outputs[0]["text/plain"]
    assert "✓ generate" in outputs[-1]["text/plain"]
    assert "<pre" in outputs[-1]["text/html"]
    assert capsys.readouterr() == ("", "")


def test_a_warning_stands_below(outputs: list[dict[str, str]], capsys: Any):
    notebook.NotebookConsole().warn("few samples")
    assert capsys.readouterr().err == "warning: few samples\n"


def test_only_a_kernel_is_a_notebook(outputs: list[dict[str, str]], monkeypatch: pytest.MonkeyPatch):
    assert notebook.is_notebook()
    monkeypatch.setattr(sys.modules["IPython"], "get_ipython", lambda: None)
    assert not notebook.is_notebook()


def lines(total: int, unit: str, done: int = 0) -> tuple[Clock, list[str], Bar]:
    clock, said = Clock(), list[str]()
    return clock, said, Bar(Console(clock=clock), "train", total, unit, done, said.append, None)


def test_progress_is_a_line_now_and_then():
    clock, said, bar = lines(40, "epochs")
    for _ in range(40):
        clock.now += EVERY / 4
        bar.advance(note="loss 0.5")
    assert len(said) == 10
    assert said[0] == "train: 4/40 epochs in 10.0 s, 90 s left, loss 0.5"
    assert said[-1] == "train: 40/40 epochs in 100.0 s, loss 0.5"


def test_a_line_amid_an_epoch_has_the_last_loss():
    clock, said, bar = lines(40, "epochs")
    bar.advance(1, "loss 0.5")
    clock.now += 2 * EVERY
    bar.advance(0)
    assert said == ["train: 1/40 epochs in 20.0 s, 780 s left, loss 0.5"]


def test_the_time_left_counts_what_this_run_did():
    clock, said, bar = lines(40, "epochs", done=30)
    clock.now += 2 * EVERY
    bar.advance(0)
    assert said == []
    bar.advance(2)
    assert said == ["train: 32/40 epochs in 20.0 s, 80 s left"]


def test_short_work_is_one_line():
    _, said, bar = lines(1000, "samples")
    for _ in range(10):
        bar.advance(100)
    assert said == ["train: 1000/1000 samples in 0.0 s"]


def test_threads_count_together_without_a_screen():
    _, said, bar = lines(4000, "steps")
    threads = [threading.Thread(target=lambda: [bar.advance() for _ in range(1000)]) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert said == ["train: 4000/4000 steps in 0.0 s"]


def test_units_are_plural_where_there_are_several():
    assert (counted(1, "rollouts"), counted(0, "rollouts"), counted(8, "rollouts")) == (
        "1 rollout",
        "0 rollouts",
        "8 rollouts",
    )
