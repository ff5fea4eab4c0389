"""Progress where there is no screen: a line now and then."""

import heapq
import threading

import pytest

from npred.progress import EVERY, Bar, counted


class Clock:
    """A clock that tests set."""

    now = 0.0

    def __call__(self) -> float:
        return self.now


def lines(total: int, unit: str, done: int = 0) -> tuple[Clock, list[str], Bar]:
    clock, said = Clock(), list[str]()
    return clock, said, Bar("train", total, unit, done, clock, lambda n, left: None, said.append)


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


SECONDS = {"rk4": 1e-5, "no_adaptation": 1e-5, "deeponet": 2e-4, "fno": 4e-3}  # of a step


def worst(threads: int, shares: int = 17, steps: int = 1000, reports: int = 40) -> float:
    """The worst factor between the time left and what was said after the first tenth, of what is wrong by more than
    one share: shares of each kind in turns, which threads take one after the other, in simulated time.
    """
    clock, said = Clock(), list[tuple[float, float | None]]()
    total = dict.fromkeys(SECONDS, shares * steps)
    bar = Bar("loops", total, "steps", 0, clock, lambda n, left: said.append((clock.now, left)), lambda line: None)
    queue = [kind for _ in range(shares) for kind in SECONDS]
    events: list[tuple[float, int, str, int]] = [(0.0, k, "", 0) for k in range(threads)]
    while events:
        clock.now, thread, kind, rest = heapq.heappop(events)
        if kind:
            with pytest.MonkeyPatch.context() as patch:
                patch.setattr(threading, "get_ident", lambda thread=thread: thread)
                bar.advance(steps // reports, kind=kind)
        if not rest and queue:
            kind, rest = queue.pop(0), reports
        if rest:
            heapq.heappush(events, (clock.now + steps / reports * SECONDS[kind], thread, kind, rest - 1))
    end, share = clock.now, steps * SECONDS["fno"]
    told = [(end - now, left or 0.0) for now, left in said if 0.1 * end < now < end]
    return max((max(true / left, left / true) for true, left in told if abs(true - left) > share), default=1.0)


@pytest.mark.parametrize("threads", [1, 2, 4, 16])
def test_the_time_left_is_right_where_a_step_of_one_kind_takes_as_long_as_hundreds_of_another(threads: int):
    assert worst(threads) < 1.5


def test_the_time_left_forgets_work_beside_it_that_has_ended():
    clock, said = Clock(), list[tuple[float, float | None]]()
    bar = Bar("train", 100, "epochs", 0, clock, lambda n, left: said.append((clock.now, left)), lambda line: None)
    for epoch in range(100):
        clock.now += 2.0 if epoch < 8 else 0.9
        bar.advance()
    true = {now: clock.now - now for now, _ in said}
    assert all(1 / 1.5 < (left or 0.0) / true[now] < 1.5 for now, left in said if now > 0.25 * clock.now and true[now])


def test_what_was_measured_before_the_work_begins_tells_the_time_left_at_once():
    clock = Clock()
    left = []
    bar = Bar("bench", {"a": 100, "b": 100}, "calls", 0, clock, lambda n, rest: left.append(rest), lambda line: None)
    bar.expect("a", 1.0)
    bar.expect("b", 3.0)
    clock.now = 10.0
    bar.advance(10, kind="a")
    assert left == [pytest.approx(390.0)]
