"""Progress where there is no screen: a line now and then."""

import threading

from npred.base.progress import counted
from npred.lab.report.terminal.console import EVERY, Bar, Console


class Clock:
    """A clock that tests set."""

    now = 0.0

    def __call__(self) -> float:
        return self.now


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


def test_threads_count_together():
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
