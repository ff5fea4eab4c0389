"""The live view: what it shows of each stage; and the console that shows it on terminals only."""

import io
import sys
import threading

import pytest
from rich.console import Console as Rich

from npred.console import Console
from npred.live import Live


class Clock:
    now = 0.0

    def __call__(self) -> float:
        return self.now


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.fixture
def live(clock: Clock) -> Live:
    return Live("paper on cpu", ["generate", "train fno", "evaluate"], clock)


def shown(live: Live) -> list[str]:
    """The lines of the table, without the heading and without spaces at their ends."""
    rich = Rich(width=120, file=io.StringIO(), record=True)
    rich.print(live.table())
    return [line.rstrip() for line in rich.export_text().splitlines()][2:]


def test_stages_wait_run_and_are_done(live: Live, clock: Clock):
    live.finish("generate", "hit", 0.1)
    with live.bar("train fno", 40, "epoch", lambda: None) as bar:
        clock.now = 30.0
        bar.advance(10, "loss 0.5")
        done, running, waiting = shown(live)
        assert done.split() == ["✓", "generate", "from", "the", "store"]
        assert running.startswith("▸  train fno") and "10/40 epoch  1:30" in running and running.endswith("loss 0.5")
        assert waiting.split() == ["·", "evaluate"]
    live.finish("train fno", "run", 120.0)
    assert shown(live)[1].split() == ["✓", "train", "fno", "120.0", "s"]


def test_a_training_tells_loss_and_error_in_columns(live: Live):
    with live.bar("train fno", 40, "epoch", lambda: None) as bar:
        live.measured("train fno", {"epoch": 1, "loss": 0.25, "mse": 1.0, "eps_sup": 0.039})
        bar.advance(1, "loss 0.25")
    line = shown(live)[1]
    assert "2.50e-01" in line and "3.90e-02" in line and "loss" not in line


def test_work_that_is_no_stage_gets_a_row_of_its_own(live: Live):
    with live.bar("warm up", 3, "call", lambda: None) as bar:
        bar.advance(0)
        assert "0/3 call" in shown(live)[3] and "–" in shown(live)[3]


def test_threads_count_together(live: Live):
    with live.bar("evaluate", 4000, "steps", lambda: None) as bar:
        threads = [threading.Thread(target=lambda: [bar.advance() for _ in range(1000)]) for _ in range(4)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        assert "4000/4000 steps  0:00" in shown(live)[2]


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
    assert console.live is None
    text = sys.stderr.getvalue()  # type: ignore[attr-defined]
    assert "tiny on cpu" in text and "warning: far out" in text
    assert text.rindex("1.5 s") > text.index("far out")


def test_stopping_reaches_the_bars_of_the_view(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(sys, "stderr", Terminal())
    console = Console()
    with console.watch("tiny", ["train"]), console.bar("train", 2, "epoch") as bar:
        console.stop()
        with pytest.raises(KeyboardInterrupt):
            bar.advance()


def test_elsewhere_there_are_plain_lines(capsys: pytest.CaptureFixture[str]):
    console = Console()
    with console.watch("tiny", ["generate"]), console.bar("generate", 2, "steps") as bar:
        bar.advance(2)
        console.measured("generate", {"epoch": 1})
        console.finish("generate", "run", 1.0)
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("generate: 2/2 steps in ")
