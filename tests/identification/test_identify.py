"""Delays and parameters from recordings that SciPy has made; and recordings that cannot tell."""

from pathlib import Path

import numpy as np
import pytest
from recorded import recording, steps
from scipy.integrate import solve_ivp
from test_model import BOX

import npred
from npred.base.errors import ConfigError
from npred.identification.identify import Settings, prepared, recorded
from npred.identification.log import Log

PERIOD = 0.05


class Decay:
    """X' = a X + b U."""

    states, inputs = ("X",), ("U",)
    parameters = {"a": -0.5, "b": 1.0}
    f = lambda x, u, t, p, M: [p.a * x.X + p.b * u.U]
    kappa = lambda x, t, p, M: [-x.X]


class Pair:
    """Two states with an input each."""

    states, inputs = ("X", "Y"), ("U", "W")
    parameters = {"a": 1.0}
    f = lambda x, u, t, p, M: [u.U - p.a * x.X + 0.3 * x.Y, u.W - 2.0 * x.Y]
    kappa = lambda x, t, p, M: [-x.X, -x.Y]


class Cart(Pair):
    """A position that is measured, and a speed that is not."""

    states, inputs, outputs = ("X", "Y"), ("U",), ("position",)
    parameters = {"drag": 0.8}
    f = lambda x, u, t, p, M: [x.Y, u.U - p.drag * x.Y]
    kappa = lambda x, t, p, M: [-x.X]
    output = lambda x, t, p, M: [x.X]


def decay() -> npred.plants.Plant:
    return npred.plants.make("decay", Decay)


def decayed(
    D: float, noise: float = 0.02, seed: int = 0, count: int = 400, hold: int = 6, a: float = -0.5, b: float = 1.0
):
    return recording(lambda x, u: a * x + b * u, [0.0], steps(count, 1, hold, seed), [D], PERIOD, noise, seed)


def test_a_delay_and_a_parameter_are_found_and_said():
    found = npred.identify(decay(), *decayed(0.337, a=-0.6), free=["a"], longest=1.5)
    assert abs(found.D[0] - 0.337) < 0.1 * PERIOD and found.identifiable.all()
    assert found.interval[0, 0] <= 0.337 <= found.interval[0, 1]
    low, high = found.parameter_intervals["a"]
    assert low <= -0.6 <= high and high - low < 0.1
    assert found.held_back["model"] < 0.5 * min(found.held_back["no_delay"], found.held_back["first_order_lag"])
    assert "\nU arrives 0.33" in str(found) and "\na = -0.59" in str(found)


@pytest.mark.parametrize(("first", "count"), [(150, 1), (212, 2), (301, 3)])
def test_a_glitch_is_named_by_its_rows_and_no_others(first, count):
    """The initial state of its segment follows it, so that the good rows beside it are missed, too."""
    t, U, X = decayed(0.337)
    rows = np.flatnonzero(np.isfinite(X[:, 0]))[first : first + count]
    X[rows] += 0.5
    answer = npred.identify(decay(), t, U, X, free=["a"], longest=1.5)
    named = ", ".join(map(str, rows))
    assert f" at row{'s' * (count > 1)} {named}; " in str(answer)
    assert answer.identifiable.all() and abs(answer.D[0] - 0.337) < 0.2 * PERIOD


def test_rows_in_any_order_and_twice_tell_the_same():
    t, U, X = decayed(0.337)
    one = npred.identify(decay(), t, U, X, longest=1.5)
    mixed = np.random.default_rng(0).permutation(np.append(np.arange(len(t)), np.arange(40)))
    other = npred.identify(decay(), t[mixed], U[mixed], X[mixed], longest=1.5)
    assert np.array_equal(one.D, other.D) and np.array_equal(one.interval, other.interval)


@pytest.mark.slow
def test_nine_of_ten_intervals_hold_the_delay_also_where_the_model_is_off():
    held = []
    for seed in range(20):
        rng = np.random.default_rng([5, seed])
        D, a, b = rng.uniform(0.1, 0.9), -0.5 * (1 + rng.uniform(-0.03, 0.03)), 1 + rng.uniform(-0.03, 0.03)
        low, high = npred.identify(decay(), *decayed(D, 0.03, seed, a=a, b=b), longest=1.5).interval[0]
        held.append(low <= D <= high)
    assert np.mean(held) >= 0.85


def test_inputs_have_delays_of_their_own():
    f = lambda x, u: np.array([u[0] - x[0] + 0.3 * x[1], u[1] - 2.0 * x[1]])
    table = recording(f, [0.0, 0.0], steps(500, 2, 5, 1), [0.21, 0.63], PERIOD, 0.01, 1)
    found = npred.identify(npred.plants.make("pair", Pair), *table, longest=1.2)
    assert np.abs(found.D - [0.21, 0.63]).max() < 0.2 * PERIOD and found.identifiable.all()


def test_a_state_that_is_not_measured_is_no_obstacle():
    f = lambda x, u: np.array([x[1], u[0] - 0.8 * x[1]])
    table = recording(f, [0.0, 0.0], steps(600, 1, 10, 2), [0.4], PERIOD, 0.002, 2, outputs=1)
    found = npred.identify(npred.plants.make("cart", Cart), *table, free=["drag"], longest=1.2)
    assert (
        abs(found.D[0] - 0.4) < PERIOD
        and found.parameter_intervals["drag"][0] <= 0.8 <= found.parameter_intervals["drag"][1]
    )


def test_a_black_box_is_fitted_by_differences(tmp_path: Path):
    (tmp_path / "box.py").write_text(BOX)
    f = lambda x, u: np.array([x[1], -1.2 * np.sin(x[0]) - x[1] + u[0]])
    table = recording(f, [0.1, 0.0], steps(300, 1, 8, 3), [0.26], PERIOD, 0.01, 3)
    found = npred.identify(npred.plant(f"{tmp_path}/box.py:Box", a=-1.0), *table, free=["a"], longest=1.0)
    assert abs(found.D[0] - 0.26) < PERIOD and abs(found.parameters["a"] + 1.2) < 0.1


def test_a_constant_at_the_input_is_found():
    t, U, X = decayed(0.337)
    found = npred.identify(decay(), t, U - 0.2, X, longest=1.5, offset=True)
    assert abs(found.D[0] - 0.337) < 0.2 * PERIOD and abs(found.parameters["offset of U"] - 0.2) < 0.03


def test_a_delay_that_jumps_is_seen_over_windows():
    early, late = decayed(0.2, 0.005, 4, 700), decayed(0.6, 0.005, 4, 700)
    t, U, X = early
    X = np.where((t < 17.5)[:, None], X, late[2])  # the same samples: only the delay is another
    found = npred.identify(decay(), t, U, X, longest=1.2)
    windows, (low, high) = found.windows, found.interval[0]
    assert windows is not None and "windows of the log have different ones" in str(found)
    assert not found.identifiable[0] and low <= 0.2 and high >= 0.6 and abs(found.D[0] - 0.6) < PERIOD
    assert (
        np.abs(windows.D[windows.t < 16] - 0.2).max() < PERIOD
        and np.abs(windows.D[windows.t > 20] - 0.6).max() < PERIOD
    )


def test_a_delay_that_jumps_while_the_longest_one_passes_is_seen():
    """At 6 s: of the first 7 s only commands are used."""
    early, late = decayed(0.2, 0.005, 4, 700), decayed(0.6, 0.005, 4, 700)
    found = npred.identify(decay(), *early[:2], np.where((early[0] < 6)[:, None], early[2], late[2]))
    assert not found.identifiable[0] and found.interval[0, 0] <= 0.2 and found.interval[0, 1] >= 0.6
    assert "windows of the log have different ones" in str(found)


@pytest.mark.parametrize(("jitter", "noise"), [(0.0, 0.02), (0.3, 0.005), (0.15, 0.03)])
def test_a_delay_that_differs_from_command_to_command_is_not_certain(jitter, noise):
    """As on a network; by 0.3 s errors keep their sign, by 0.15 s they are lost in the noise of the sensor."""
    rng, fine, D = np.random.default_rng(7), 10, 0.5
    sent = np.cumsum(rng.integers(4, 20, 100)) * PERIOD
    arrives = np.maximum.accumulate(sent + D + rng.uniform(-1, 1, 100) * jitter)
    levels, t = rng.uniform(-1, 1, 101), np.arange(1000 * fine) * PERIOD / fine
    U, X = levels[np.searchsorted(sent, t, "right")], np.zeros(len(t))
    for k, late in enumerate(levels[np.searchsorted(arrives, t, "right")][:-1]):
        X[k + 1] = X[k] + (t[1] - t[0]) * (late - 0.5 * X[k])
    found = npred.identify(decay(), t[::fine], U[::fine], X[::fine] + noise * rng.standard_normal(1000), longest=2.0)
    low, high = found.interval[0]
    assert found.identifiable[0] == (jitter == 0) and low <= D - 0.5 * jitter and D + 0.5 * jitter <= high, found
    assert ("differs from command to command" in str(found)) == (jitter > 0)


def test_windows_are_said_where_they_are_asked_for():
    found = npred.identify(decay(), *decayed(0.337), longest=1.5, time_varying=True)
    assert "windows of time the delay of U is" in str(found) and "a constant delay fits all of them" in str(found)
    assert found.identifiable.all() and found.windows is not None


def test_commands_between_the_rows_may_be_half_a_row_older():
    """Ten commands in a row of the log, which has the first one of each."""
    step, rng = PERIOD / 10, np.random.default_rng(3)
    t, rates, phases = np.arange(5000) * step, rng.uniform(0.5, 9, 12), rng.uniform(0, 7, 12)
    u, X, late = np.sin(np.multiply.outer(t, rates) + phases).sum(axis=1) / 3, np.zeros(5000), round(0.3 / step)
    for k in range(4999):
        held = u[max(k - late, 0)]
        X[k + 1] = 2 * held + (X[k] - 2 * held) * np.exp(-0.5 * step)
    table = t[::10], u[::10], X[::10] + 0.02 * rng.standard_normal(500)
    found = npred.identify(decay(), *table, longest=1.0)
    assert found.identifiable.all() and found.interval[0, 0] <= 0.3 <= found.interval[0, 1]
    assert "in straight lines" in str(found)
    exact = npred.identify(decay(), *table, longest=1.0, hold="linear")
    assert abs(exact.D[0] - 0.3) < 0.1 * PERIOD and np.ptp(exact.interval) < np.ptp(found.interval)


@pytest.mark.parametrize(("seed", "count"), [(5, 500), (6, 800)])
def test_a_mode_that_the_plant_lacks_is_no_certain_delay(seed, count):
    f = lambda x, u: np.array([x[1], 9.0 * (2 * u[0] - x[0]) - 2.4 * x[1]])
    table = recording(f, [0.0, 0.0], steps(count, 1, 20, seed), [0.3], PERIOD, 0.01, seed, outputs=1)
    found = npred.identify(decay(), *table, longest=1.5, free=["a", "b"])
    assert not found.identifiable.any() and "of them follow the commands" in str(found), found
    assert found.interval[0, 0] <= 0.3 <= found.interval[0, 1]


def still(seed: int):
    t, U, X = decayed(0.3, 0.0, seed)
    return t, 0 * U, np.where(np.isnan(X), X, 0.02 * np.random.default_rng(seed).standard_normal(X.shape))


def lagged(seed: int):
    f = lambda x, u: np.array([-0.5 * x[0] + x[1], (u[0] - x[1]) / 0.2])
    return recording(f, [0.0, 0.0], steps(400, 1, 15, seed), [0.0], PERIOD, 0.02, seed, outputs=1)


def small(seed: int):
    t, U, X = decayed(0.3, 0.0, seed)
    return t, 1e-3 * U, 1e-3 * X + 0.05 * np.random.default_rng(seed).standard_normal(X.shape)


def closed(seed: int):
    """U = -X + noise of the sensor, about rest: nothing moves but by that noise."""
    rng, X, rows = np.random.default_rng(seed), 0.0, []
    sent = np.zeros(406)
    for k in range(400):
        seen = X + 0.02 * rng.standard_normal()
        sent[k + 6] = -0.3 * seen
        rows.append((k * PERIOD, -0.3 * seen, seen))
        X = X * np.exp(-0.5 * PERIOD) + sent[k] * (1 - np.exp(-0.5 * PERIOD)) / 0.5
    t, U, Y = np.array(rows).T
    return t, U[:, None], Y[:, None]


@pytest.mark.parametrize("table", [still, small, lagged, closed])
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_what_a_log_cannot_tell_is_said(table, seed: int):
    found = npred.identify(decay(), *table(seed), longest=1.5)
    assert not found.identifiable.any() and ("not identifiable" in str(found) or found.refused)
    truth = {lagged: 0.0}.get(table, 0.3)
    assert found.interval[0, 0] <= truth <= found.interval[0, 1]


def test_a_delay_beyond_the_longest_one_is_said():
    found = npred.identify(decay(), *decayed(1.2), longest=0.6)
    assert not found.identifiable[0] and "not identifiable" in str(found)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"free": ["c"]}, "expected parameters of plant decay: a, b, got 'c'"),
        ({"U": np.zeros((3, 2))}, "expected t (N,), U (N, 1), X (N, 1)"),
    ],
)
def test_what_does_not_fit_is_one_line(change, words):
    t, U, X = decayed(0.3)
    arguments = {"t": t, "U": U, "X": X, "longest": 1.5} | change
    with pytest.raises(ConfigError) as failure:
        npred.identify(decay(), arguments.pop("t"), arguments.pop("U"), arguments.pop("X"), **arguments)
    assert words in str(failure.value) and "\n" not in str(failure.value)


def test_a_plant_that_knows_its_delay_is_refused():
    with pytest.raises(ConfigError, match="it declares delay"):
        npred.identify(npred.plant("transport_tank"), np.arange(9.0), np.arange(9.0), np.zeros((9, 2)))


def test_a_plant_that_is_far_from_the_given_one_is_said():
    found = npred.identify(decay(), *decayed(0.3, 0.005, b=1.5), longest=1.5)
    assert not found.identifiable[0] and "the plant, with its parameters, does not explain the log" in str(found)
    assert "The log fits only with another value of b" in str(found)
    assert npred.identify(decay(), *decayed(0.3, 0.005, b=1.5), longest=1.5, free=["b"]).identifiable.all()


def test_a_delay_of_a_sine_may_be_one_period_longer():
    wave = 0.8 * np.sin(2 * np.pi * np.arange(500) / 20)[:, None]  # a period of 1 s
    t, U, X = recording(lambda x, u: -0.5 * x + u, [0.0], wave, [0.3], PERIOD, 0.05, 1)
    late = t > 5.1  # the log begins amidst
    table = t[late], U[late], X[late]
    found = npred.identify(decay(), *table, longest=2.5)
    assert not found.identifiable[0] and found.interval[0, 0] <= 0.31 and found.interval[0, 1] >= 1.2


class Room:
    """A room; time in a unit of its own."""

    states, inputs, parameters, box = ("T",), ("q",), {"K": 5.0, "tau": 4.0}, {"T": (0.0, 40.0)}
    f = lambda x, u, t, p, M: [(p.K * u.q - x.T) / p.tau]
    kappa = lambda x, t, p, M: [(10.0 - (x.T - 10.0)) / p.K]


@pytest.mark.parametrize(("unit", "header"), [("s", "t"), ("min", "t (min)"), ("min", "t [s]"), ("h", "time")])
def test_one_unit_of_time_from_the_file_to_the_last_sentence(tmp_path: Path, unit: str, header: str):
    """A delay of 2 and a time constant of 5 in the plant's unit, whatever the file's unit is."""
    u = steps(300, 1, 12, 4, 2.0) + 2.5
    t, U, X = recording(lambda x, u: (6 * u - x) / 5, [15.0], u, [2.0], 0.25, 0.01, 4, jitter=0.0)
    stamp = {
        "t [s]": lambda s: f"{60 * s:.3f}",
        "time": lambda s: str(np.datetime64("2024-01-01") + np.timedelta64(round(3600 * s), "s")).replace("T", " "),
    }.get(header, lambda s: f"{s:.4f}")
    cell = lambda value: "" if np.isnan(value) else f"{value:.6f}"
    lines = [f"{stamp(s)},{cell(v)},{cell(y)}\n" for s, v, y in zip(t, U[:, 0], X[:, 0], strict=True)]
    (tmp_path / "room.csv").write_text(f"{header},q,T\n" + "".join(lines))
    plant = npred.plants.make("room", type("Room", (Room,), {"time_unit": unit}))
    found = npred.identify(plant, tmp_path / "room.csv", free=["K", "tau"])
    assert found.identifiable.all() and abs(found.D[0] - 2) < 0.05, found
    assert abs(found.parameters["tau"] - 5) < 0.15 and f"q arrives {found.D[0]:.4g} {unit} late" in str(found)
    assert f"in {unit}" in found.sentences[0]


@pytest.mark.parametrize("rate", [0.5, 3.0, 10.0])
@pytest.mark.parametrize("first", [1.0, None])
def test_steps_of_the_integration_are_right_at_the_answer_not_at_the_first_guess(rate, first):
    """With one step of RK4 a sample the fastest rate would be 2.78."""
    t, u = np.arange(400.0), np.repeat(np.random.default_rng(0).uniform(-1, 1, 80), 5)
    x, X, D = 0.0, [], 3.4
    for k in range(400):  # exact: the input changes once in a second, after D % 1
        X.append(x)
        for span, late in ((D % 1, 4), (1 - D % 1, 3)):
            held = u[max(k - late, 0)]
            x = held + (x - held) * np.exp(-rate * span)
    y = np.array(X) + 0.01 * np.random.default_rng(1).standard_normal(400)

    class Fast:
        states, inputs, parameters = ("x",), ("u",), {"a": first or rate}
        f = lambda x, u, t, p, M: [p.a * (u.u - x.x)]
        kappa = lambda x, t, p, M: [-x.x]

    found = npred.identify(npred.plants.make("fast", Fast), t, u, y, free=["a"])
    low, high = found.parameter_intervals["a"]
    assert low <= rate <= high and found.interval[0, 0] <= D <= found.interval[0, 1], found


class Heater:
    """A heater: K and T0 act alike while its power is constant."""

    states, inputs, parameters = ("T",), ("h",), {"K": 0.3, "tau": 40.0, "T0": 28.0}
    box, guess = {"T": (25.0, 60.0)}, (40.0,)
    f = lambda x, u, t, p, M: [(p.K * u.h + p.T0 - x.T) / p.tau]
    kappa = lambda x, t, p, M: [(40 - p.T0 - 2.0 * (x.T - 40.0)) / p.K]


def heated(begin: float, power: float = 30.0, seed: int = 0, D: float = 3.0):
    """A step at `begin` of 300 s: K .4, tau 30, T0 30."""
    t = np.arange(300.0)
    rise = np.where(t > begin + D, 1 - np.exp(-(t - begin - D) / 30), 0.0)
    return t, power * (t >= begin), 30 + 0.4 * power * rise + 0.03 * np.random.default_rng(seed).standard_normal(300)


@pytest.mark.parametrize("begin", [12.0, 40.0, 100.0])
def test_a_step_in_the_first_fifth_of_a_log_tells_the_delay(begin):
    found = npred.identify(npred.plants.make("heater", Heater), *heated(begin), free=["K", "tau", "T0"])
    assert found.identifiable.all() and found.interval[0, 0] <= 3 <= found.interval[0, 1], found
    assert abs(found.parameters["K"] - 0.4) < 0.03
    assert ("its first command is assumed" in str(found)) is (begin < 60)


@pytest.mark.parametrize("first", [20.0, 30.0])
def test_of_parameters_that_act_alike_the_combination_is_named(first):
    """The heater is on from the begin: K and T0 are known as 30 K + T0 = 42."""
    plant = npred.plants.make("heater", Heater, {"T0": first})
    t, _, T = heated(-10.0)
    found = npred.identify(plant, t, 30.0 + 0 * t, T, free=["K", "T0", "tau"])
    assert "K is not identifiable" in str(found) and "T0 is not identifiable" in str(found)
    combination = found.details["combination"]
    assert set(combination.names) == {"K", "T0"}
    K, T0 = (combination.factors[combination.names.index(name)] for name in ("K", "T0"))
    assert abs(K / T0 - 30) < 0.1 and abs(combination.value / T0 - 42) < 0.3
    assert not found.identifiable.any()


@pytest.mark.parametrize("hold", [None, "linear", "zero"])
def test_an_input_that_is_sampled_but_not_held_is_no_delay_below_zero(hold):
    """The input is a smooth noise, of which the log has samples: held, they act half a period before."""
    rng, t = np.random.default_rng(3), np.arange(600) * PERIOD
    rates, phases = rng.uniform(0.5, 9, 12), rng.uniform(0, 7, 12)
    signal = lambda s: np.sin(np.multiply.outer(s, rates) + phases).sum(axis=-1) / 3
    solved = solve_ivp(lambda s, x: -0.5 * x + signal(s), (0, t[-1]), [0.0], t_eval=t, rtol=1e-9, atol=1e-11)
    X = solved.y[0] + 1e-3 * rng.standard_normal(len(t))
    found = npred.identify(decay(), t, signal(t), X, longest=1.0, hold=hold)
    if hold == "zero":
        assert not found.identifiable.any() and "before its command" in str(found)
    else:
        assert found.identifiable.all() and found.interval[0, 1] < 0.2 * PERIOD, found
        assert ("straight lines fit better" in str(found)) is (hold is None)


def test_two_inputs_that_move_together_have_no_delay_of_their_own():
    f = lambda x, u: np.array([u[0] - x[0] + 0.3 * x[1], u[1] - 2.0 * x[1]])
    u = np.repeat(steps(300, 1, 5, 1), 2, axis=1)
    found = npred.identify(npred.plants.make("pair", Pair), *recording(f, [0.0, 0.0], u, [0.2, 0.5], PERIOD, 0.01, 1))
    assert not found.identifiable.any() and "U and W move together" in str(found)


def test_a_gain_is_known_up_to_an_exchange_of_equal_inputs():
    """Two equal inputs whose delays and gains may be exchanged: each interval holds both gains."""

    class Twins:
        states, inputs, parameters = ("X",), ("U", "W"), {"a": 2.0, "b": 1.0}
        f = lambda x, u, t, p, M: [p.a * u.U + p.b * u.W - x.X]
        kappa = lambda x, t, p, M: [-x.X / p.a, 0.0]

    f = lambda x, u: np.array([2.0 * u[0] + u[1] - x[0]])
    u = np.repeat(steps(300, 1, 5, 1), 2, axis=1)
    log = recording(f, [0.0], u, [0.2, 0.5], PERIOD, 0.01, 1)
    found = npred.identify(npred.plants.make("twins", Twins), *log, free=["a", "b"])
    assert not found.identifiable.any()
    for low, high in found.parameter_intervals.values():
        assert low < 1.05 and high > 1.95, found


def test_one_bad_sample_costs_that_sample():
    t, U, X = decayed(0.337)
    clean = npred.identify(decay(), t, U, X, longest=1.5)
    X = X.copy()
    X[np.flatnonzero(np.isfinite(X[:, 0]))[200]] = -127.0
    found = npred.identify(decay(), t, U, X, longest=1.5)
    assert found.identifiable.all() and abs(found.D[0] - clean.D[0]) < 0.05 * PERIOD and "bad sample" in str(found)


def test_several_logs_are_one_problem(tmp_path: Path):
    """Half of the log each tells less than both, and a command of the one does not reach the other."""
    t, U, X = decayed(0.337, count=300)
    parts = [t < 0.5 * t[-1], t >= 0.5 * t[-1]]
    for k, rows in enumerate(parts):
        cells = [
            [f"{v:.6f}" if np.isfinite(v) else "" for v in row]
            for row in zip(t[rows], U[rows, 0], X[rows, 0], strict=True)
        ]
        (tmp_path / f"{k}.csv").write_text("t,U,X\n" + "".join(",".join(row) + "\n" for row in cells))
    paths = [tmp_path / "0.csv", tmp_path / "1.csv"]
    both, one = (npred.identify(decay(), p, longest=1.0) for p in (paths, paths[0]))
    assert both.identifiable.all() and both.interval[0, 0] <= 0.337 <= both.interval[0, 1]
    assert np.ptp(both.interval) < np.ptp(one.interval)


class SlowHeater:
    """A heater's block, which is not measured, and its sensor; an error of y0 is one of both."""

    states, inputs = ("y", "b"), ("u",)
    parameters = {"K": 0.9, "tau": 100.0, "tau2": 15.0, "y0": 18.0}
    box, guess = {"y": (20.0, 60.0), "b": (20.0, 60.0)}, (40.0, 40.0)
    f = lambda x, u, t, p, M: [(x.b - x.y) / p.tau2, (p.K * u.u + p.y0 - x.b) / p.tau]
    kappa = lambda x, t, p, M: [(40.0 - p.y0) / p.K]


def test_a_slow_plant_keeps_what_its_whole_log_knows():
    """A time constant of a third of the log and two edges in a row of it; whatever the longest delay is."""
    f = lambda x, u: np.array([(x[1] - x[0]) / 17, (0.6 * u[0] + 21 - x[1]) / 142])
    commands = np.repeat([10.0, 80.0, 30.0, 60.0, 0.0, 100.0], [70, 60, 80, 60, 70, 80])[:, None]
    t, U, X = recording(f, [30.0, 32.0], commands, [8.0], 1.0, 0.005, 5, outputs=1)
    X, truth = np.append(X, np.nan * X, axis=1), {"K": 0.6, "tau": 142.0, "tau2": 17.0, "y0": 21.0}
    plant = npred.plants.make("heater", SlowHeater)
    found = [npred.identify(plant, t, U, X, free=list(truth), longest=longest) for longest in (20.0, 45.0)]
    for each in found:
        assert each.identifiable.all() and abs(each.D[0] - 8) < 1, each
        for name, value in truth.items():
            low, high = each.parameter_intervals[name]
            assert low - 0.01 * value < value < high + 0.01 * value and high - low < 0.2 * value, each
    one, other = (np.array([*each.interval, *each.parameter_intervals.values()]) for each in found)
    assert (np.maximum(one[:, 0], other[:, 0]) <= np.minimum(one[:, 1], other[:, 1])).all()


@pytest.mark.parametrize("row_before", [False, True])
def test_a_step_in_the_first_row_needs_a_row_before_it(tmp_path: Path, row_before):
    t, rng = PERIOD * np.arange(60), np.random.default_rng(0)
    for k, u in enumerate([1.0, -0.5, 2.0]):
        X = 2 * u * (1 - np.exp(-0.5 * np.maximum(t - 0.337, 0))) + 0.01 * rng.standard_normal(60)
        rows = np.stack([t, np.where(row_before & (t == 0), 0.0, u), np.append(0.0, X[:-1])], axis=1)
        np.savetxt(tmp_path / f"{k}.csv", rows, delimiter=",", header="t,U,X", comments="")
    found = npred.identify(decay(), sorted(tmp_path.iterdir()), free=["a"], longest=1.0)
    assert ("put a row with the command before it in front" in str(found)) is not row_before
    assert found.identifiable.all() is np.bool_(row_before)
    assert not row_before or abs(found.D[0] - 0.337) < PERIOD, found


def test_a_column_is_scaled_and_then_shifted(tmp_path: Path):
    """Degrees Fahrenheit to Celsius, and an input that is as it is."""
    (tmp_path / "log.csv").write_text("time,F,U\n0,32,1\n1,212,1\n2,50,3\n")
    log, _ = recorded(decay(), tmp_path / "log.csv", {"X": "F"}, {"F": 5 / 9}, {"F": -160 / 9})
    np.testing.assert_allclose(log.Y[:, 0], [0, 100, 10], atol=1e-12)
    assert log.U[:, 0].tolist() == [1, 1, 3]


def log(period: float, count: int = 900) -> Log:
    rng, t = np.random.default_rng(0), period * np.arange(count)
    return Log.of(t, rng.uniform(-1, 1, (count, 1)), rng.uniform(-1, 1, (count, 1)))


def of_rate(rate: float) -> npred.plants.Plant:
    class Rate:
        states, inputs, box = ("X",), ("U",), {"X": (-1.0, 1.0)}
        f = lambda x, u, t, p, M: [rate * x.X + M.sin(x.X) * u.U]
        kappa = lambda x, t, p, M: [-x.X]

    return npred.plants.make("rate", Rate)


@pytest.mark.parametrize(("rate", "longest"), [(-1.0, 0.05 * 30), (3.0, np.log(30) / 3), (1.0, 0.05 * 30)])
def test_an_error_of_the_begin_grows_by_thirty_in_a_segment_at_most(rate, longest):
    problem, *_ = prepared(of_rate(rate), log(0.05), Settings(longest=0.5))
    spans = problem.segments.t[:, -1] - problem.segments.t[:, 0]
    assert 0.6 * longest < spans.max() <= longest + 0.05


@pytest.mark.parametrize("period", [0.05, 0.5])
def test_half_as_long_steps_change_no_state_by_what_the_noise_would_let_one_see(period):
    problem, *_ = prepared(of_rate(-4.0), log(period), Settings(longest=4 * period))
    X, theta = problem.start()
    pieces = problem.segments.pieces([2 * period])
    steps = problem.model.steps
    x, finer = (type(problem.model)(problem.model.plant, problem.model.free, steps=k).states(X, theta, pieces)
                for k in (steps, 8 * steps))  # fmt: skip
    assert np.mean(np.abs(x - finer) < 0.02 * problem.scale) > 0.98 and (steps > 1) == (period > 0.1)
