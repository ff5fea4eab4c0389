"""Packets with latencies of their own: a loop against an event queue that shares no code with npred, and properties.

Times of the queue are whole ticks, ten in a control step, so that ties are exact. The plant is x' = x / 2 + u, with
the law u = -3 x / 2 of the state that is predicted in closed form.
"""

import heapq
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import npred
from npred.base.errors import ConfigError
from npred.loop.timing import schedule

TICKS, DT, D, STEPS = 10, 0.02, 50, 60  # a control step; the delay in ticks; control steps
A, K, LOST = 0.5, 1.5, math.inf
PLANT = npred.plant("scalar", a=A, c=K - A)
RK4 = npred.predictor(PLANT, "rk4", 51)
LATENCIES = st.lists(st.one_of(st.integers(0, 80), st.just(LOST)), min_size=1, max_size=7).filter(
    lambda ticks: min(ticks) < 80
)
EACH = st.lists(st.one_of(st.integers(0, 80), st.just(LOST)), min_size=STEPS + 1, max_size=STEPS + 1)
seconds = DT / TICKS


def simulated(measurement=None, **timing):
    aged = {"max_sample_age": 2.0} if measurement or "sample_latency" in timing else {}
    return npred.simulate(
        PLANT, RK4, D=D * seconds, D_hat=D * seconds, X0=[1.0], t_end=STEPS * DT, dt=DT, actuator="history", u0=[0.0],
        timing=npred.Timing(**timing), measurement=measurement, outlier_limit=None, progress=False, **aged,
    )  # fmt: skip


def same(*runs):
    return all((run.X == runs[0].X).all() and (run.U == runs[0].U).all() for run in runs)


def moved(x, u, ticks):
    """The plant's state after some ticks with an input that is held."""
    grown = math.exp(A * ticks * seconds)
    return grown * x + (grown - 1) / A * u


def predicted(x, begin, end, commands):
    """The state at `end` from that at `begin`, by the commands (tick, U) that are held D later."""
    cuts = sorted({begin, end, *(tick + D for tick, _ in commands if begin < tick + D < end)})
    for a, b in zip(cuts[:-1], cuts[1:], strict=True):
        x = moved(x, next((U for tick, U in reversed(commands) if tick + D <= a), 0.0), b - a)
    return x


def queued(samples, commands):
    """X at control steps and U, by a queue of events: what acts, samples that arrive, calls, commands that arrive."""
    ACTS, ROW, SAMPLE, CALL, COMMAND = range(5)
    events = [(TICKS * k, kind, k, None) for k in range(STEPS + 1) for kind in (ROW, CALL)]
    heapq.heapify(events)
    x, at, u, sent, X, U = 1.0, 0, 0.0, [], [], []
    newest, actuator = (-1, None), -1  # the sample that the controller has, the command that the actuator has
    while events:
        tick, kind, number, value = heapq.heappop(events)
        if tick > TICKS * STEPS:
            break
        x, at = moved(x, u, tick - at), tick
        if kind == ACTS:
            u = value
        elif kind == ROW:
            X.append(x)
            travels = samples[number % len(samples)] if number else 0
            if travels < LOST:
                heapq.heappush(events, (tick + travels, SAMPLE, number, x))
        elif kind == SAMPLE and number > newest[0]:
            newest = number, value
        elif kind == CALL:
            now = predicted(newest[1], TICKS * newest[0], tick, sent)
            sent.append((tick, 0.0))  # acts from tick + D on only
            U.append(-K * predicted(now, tick, tick + D, sent))
            sent[-1] = tick, U[-1]
            if commands[number % len(commands)] < LOST:
                heapq.heappush(events, (tick + commands[number % len(commands)], COMMAND, number, U[-1]))
        elif kind == COMMAND and number > actuator:
            actuator = number
            heapq.heappush(events, (tick + D, ACTS, number, value))
    return np.array(X), np.array(U)


@settings(max_examples=60, deadline=None)
@given(LATENCIES, LATENCIES)
def test_a_loop_is_that_of_the_queue_of_packets(samples, commands):
    run = simulated(
        sample_latency=[seconds * tick for tick in samples], command_latency=[seconds * tick for tick in commands]
    )
    X, U = queued(samples, commands)
    scale = 1e-6 * max(1.0, np.abs(U).max())
    np.testing.assert_allclose(run.X[:, 0], X, rtol=0, atol=scale)
    np.testing.assert_allclose(run.U[:, 0], U, rtol=0, atol=scale)


def overtaken(ticks):
    """The latencies without the packets that arrive with or after a newer one."""
    arrives = TICKS * np.arange(len(ticks)) + np.array(ticks, dtype=float)
    later = np.append(np.minimum.accumulate(arrives[::-1])[::-1][1:], LOST)
    return np.where(arrives < later, ticks, LOST)


@settings(max_examples=25, deadline=None)
@given(EACH, EACH)
def test_the_newest_wins(samples, commands):
    """Packets that a newer one overtakes may as well be lost."""
    samples[0] = 0  # the first one is there at once
    assert same(
        *(
            simulated(sample_latency=seconds * of(samples), command_latency=seconds * of(commands))
            for of in (np.array, overtaken)
        )
    )


@settings(max_examples=25, deadline=None)
@given(EACH, st.lists(st.integers(0, TICKS - 1), min_size=STEPS + 1, max_size=STEPS + 1))
def test_the_order_in_which_samples_arrive_before_a_call_does_not_matter(samples, earlier):
    late = np.ceil(np.array(samples) / TICKS) * TICKS
    other = np.maximum(late - np.array(earlier), 0)
    assert same(*(simulated(sample_latency=seconds * each) for each in (late, np.where(late == LOST, LOST, other))))


@settings(max_examples=10, deadline=None)
@given(st.integers(1, 80), st.integers(1, 9))
def test_a_constant_trace_is_the_constant_delay(ticks, length):
    late = ticks * seconds
    ways = ([late] * length, [(0, late), (1, late)])
    delayed = simulated(npred.Measurement(delay=late))
    assert same(delayed, *(simulated(sample_latency=each) for each in (late, *ways)))
    assert same(*(simulated(command_latency=each) for each in (late, *ways)))


def test_a_burst_delivers_only_its_newest():
    """Samples 1 to 5 come together before the call of step 5, and so do the commands of steps 1 to 5."""
    burst = DT * np.array([0, 4, 3, 2, 1, 0, 0, 0])
    plan = schedule(npred.Timing(sample_latency=burst, command_latency=burst), npred.Measurement(), DT, 8, 0)
    assert plan.sample.tolist() == [0, -1, -1, -1, -1, 5, 6, 7] and not plan.age.any()
    late = npred.Measurement(delay=0.5 * DT)
    plan = schedule(npred.Timing(sample_latency=[*burst[:6], LOST, 0]), late, DT, 9, 0)
    assert plan.number[plan.sample[[0, 6, 8]]].tolist() == [0, 5, 7] and plan.age[[6, 8]].tolist() == [1.0, 1.0]


def test_a_distribution_is_that_of_its_quantiles_and_each_loop_draws_its_own():
    quantiles = [(0.0, 0.01), (0.5, 0.02), (0.9, 0.02), (1.0, 0.2)]
    timing = npred.Timing(sample_latency=quantiles, command_latency=quantiles, seed=3)
    one, other = (schedule(timing, npred.Measurement(), 0.01, 20000, loop) for loop in (0, 1))
    travelled = 0.01 * (one.reaches - one.at)
    np.testing.assert_allclose(np.quantile(travelled, [0.0, 0.25, 0.7, 0.95]), [0.01, 0.015, 0.02, 0.11], rtol=0.05)
    assert not np.array_equal(one.reaches, other.reaches) and not np.array_equal(one.sample, other.sample)


def test_a_recorded_trace_is_its_numbers(tmp_path):
    latencies, times, other = (tmp_path / name for name in ("latency.csv", "times.csv", "other.csv"))
    latencies.write_text("latency, way\n0.02, up\n, up\n0.05, up\n")
    times.write_text("number,sent,received\n0,1.0,1.25\n1,1.5,\n2,2.0,2.125\n")
    assert npred.Timing(sample_latency=latencies).sample_latency == (0.02, LOST, 0.05)
    assert npred.Timing(command_latency=str(times)).command_latency == (0.25, LOST, 0.125)
    for text, words in (
        ("delay\n0.1\n", "columns delay"), ("latency\nfast\n", "could not convert"),
        ("", "not enough values"),
        ("latency\n-0.1\n", "none below 0"), ("sent,received\n1.0,0.5\n", "none below 0"),
    ):  # fmt: skip
        other.write_text(text)
        with pytest.raises(ConfigError, match=f"^timing: sample_latency: expected .*{words}"):
            npred.Timing(sample_latency=other)
    with pytest.raises(ConfigError, match=r"command_latency: expected a CSV file .*none.csv"):
        npred.Timing(command_latency=tmp_path / "none.csv")


@pytest.mark.parametrize(
    "wrong", [-0.1, LOST, [], [LOST], [0.1, -0.1], [(0, 0.1)], [(0, 0.1), (0.9, 0.2)], [(0, 0.2), (1, 0.1)],
              [(0, 0.1), (1, LOST)], [(0, 1, 2), (1, 2, 3)], [[[0.1]]], True, None],
)  # fmt: skip
def test_what_is_no_latency_is_refused_in_one_line(wrong):
    for name in ("sample_latency", "command_latency"):
        with pytest.raises(ConfigError, match=f"^timing: {name}: expected a latency") as told:
            npred.Timing(**{name: wrong})
        assert "\n" not in str(told.value) and "; " in str(told.value)


def test_samples_that_all_come_too_late_are_refused():
    with pytest.raises(ConfigError, match="max_sample_age: expected at least the delay of the samples, 3 s"):
        simulated(npred.Measurement(delay=1.0), sample_latency=[2.0, 3.0])
    assert np.isfinite(simulated(npred.Measurement(delay=1.0), sample_latency=[1.0, 3.0]).X).all()


def test_a_pipeline_reads_a_trace_beside_its_file_and_keeps_its_numbers(tmp_path):
    from npred.lab import config

    (tmp_path / "trace.csv").write_text("latency\n0.25\n\n0.5\n")
    (tmp_path / "loop.toml").write_text(
        'plant = "scalar"\n[evaluate]\nX0 = [1.0]\nadaptation = "frozen"\nactuator = "history"\n'
        'timing = { sample_latency = "trace.csv", command_latency = [[0.0, 0.125], [1.0, 0.25]] }\n'
    )
    pipeline = config.load(tmp_path / "loop.toml")
    timing = pipeline.evaluate.timing
    assert type(pipeline).model_validate_json(pipeline.model_dump_json()).evaluate.timing == timing
    assert timing.sample_latency == (0.25, LOST, 0.5) and timing.command_latency == ((0.0, 0.125), (1.0, 0.25))
