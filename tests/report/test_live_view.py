"""The live view: what it shows of each stage; and the console that shows it on terminals only."""

import io
import sys
import threading

import pytest
from rich.console import Console as Rich

from npred.lab.report.terminal.console import Console
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
def test_no_row_is_wrapped(clock: Clock, width: int):
    view = LiveView("a pipeline on cuda:0", ["generate", "train deeponet", "train fno"], clock)
    view.finish("generate", "hit")
    view.doing("train fno", "importing and compiling")
    with view.bar("train deeponet", 2000) as advance:
        advance(1000, "1000/2000 epochs")
        clock.now = 3599.0
        lines = shown(view, width)
        assert len(lines) == 3 and max(map(len, lines)) <= width
        if width >= 80:
            assert "1000/2000 epochs" in lines[1] and "0:59:59" in lines[1] and "━" in lines[1]


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
