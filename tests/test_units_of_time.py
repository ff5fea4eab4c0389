"""A plant written in another unit of time is the same plant: its loops, estimates, laws and answers are the same.

Each is rewritten mechanically: f is divided by the factor, times are multiplied by it, and nothing else is changed.
"""

import numpy as np
import pytest

import npred
from npred import diagnosis, plants
from npred.base.errors import ConfigError
from npred.lab import config
from npred.loop import control_step, hold
from npred.plants import speed
from npred.prediction.delays import problem_of

pytestmark = pytest.mark.usefixtures("quickly_compiled")
UNITS = {"ms": 1000.0, "h": 1 / 3600}  # of them in a second
PUSH = {"disturbance": {"amplitude": 0.1}}
QUICK = ("activator_repressor", "scalar", "van_der_pol", "transport_tank")
SHIPPED = [(name, unit) for name in QUICK for unit in UNITS]  # of those that take long to compile one unit, no decimal
LIKE_OTHERS = tuple(f"planar_arm{n}" for n in (3, 4, 5, 6))  # as the arms of 2 and of 7 joints
SHIPPED += [
    pytest.param(name, "h", marks=pytest.mark.slow) for name in plants.names() if name not in QUICK + LIKE_OTHERS
]


class Series:
    """Two tanks, one flowing into the other, whose level stays below a rim; time in minutes."""

    states, inputs, time_unit = ("h1", "h2"), ("q",), "min"
    box, input_bounds, guess = {"h1": (0.2, 0.8), "h2": (0.2, 0.55)}, ((0.0, 1.2),), (0.55, 0.55)

    def f(x, u, t, p, M):
        first, second = M.sqrt(M.maximum(x.h1, 1e-3)), M.sqrt(M.maximum(x.h2, 1e-3))
        return [u.q - 0.6 * first, 0.6 * first - 0.6 * second]

    kappa = lambda x, t, p, M: [0.6 * 0.55**0.5 - 1.0 * (x.h1 - 0.55) - 4.0 * (x.h2 - 0.55)]
    V = lambda x, t, p, M: (x.h1 - 0.55) ** 2 + (x.h2 - 0.55) ** 2
    safe = lambda x, t, p, M: [0.57 - x.h2]


def rewritten(plant, unit, kappa=""):
    """The plant in that unit, and how many of it are in the plant's own."""
    old, factor = plant.declared, UNITS[unit] * {"s": 1.0, "min": 60.0}[plant.time_unit]
    functions = {
        "f": lambda x, u, t, p, M: [rate / factor for rate in old.f(x, u, t / factor, p, M)],
        "delay": lambda x, t, p, M: factor * old.delay(x, t / factor, p, M),
        **{
            name: lambda x, t, p, M, name=name: getattr(old, name)(x, t / factor, p, M)
            for name in ("kappa", "V", "output", "safe")
        },
        "reference": lambda t, p, M: old.reference(t / factor, p, M),
    }
    parts = {name: staticmethod(function) for name, function in functions.items() if getattr(old, name, None)}
    parts |= {"time_unit": unit, "mechanics": None}
    parts |= {"delays": tuple(factor * D for D in plant.delays)} if plant.delays else {}
    parts |= {"period": factor * plant.period} if plant.period else {}
    return plants.resolve(type(old.__name__, (old,), parts), plant.parameters, kappa), factor


def same(one, other, factor, plant):
    """X and U of two runs, and D_hat by the factor: 1e-9 of what the loop's states and inputs reach."""
    for name, scale in (("X", 1.0), ("U", 1.0), ("D_hat", factor)):
        expected = getattr(one, name)
        size = np.abs(expected).max(axis=tuple(range(expected.ndim - (name != "D_hat"))))
        assert (np.abs(getattr(other, name) / scale - expected) <= 1e-9 * (size + 1e-3)).all(), (plant.name, name)


def run(plant, factor, law=None, nx=11, steps=100, **loop):
    """A loop with all defaults but D, of the usual time constant, t_end and dt."""
    D = max(plant.delays) / factor if plant.delays else control_step.simple(0.2 / speed.rates(plant).usual / factor)
    times = {} if plant.declares_delay else {"D": factor * D, "D_hat": factor * D * (1.4 if law else 1.0)}
    low, high = np.array([plant.box.get(name, (-0.1, 0.1)) for name in plant.states]).T
    X0, dt = low + 0.6 * (high - low), factor * D / 25
    return npred.simulate(
        plant, npred.predictor(plant, "rk4", nx), X0=X0, dt=dt, t_end=steps * dt, adaptation=law, **times, **loop
    )


@pytest.mark.parametrize(("name", "unit"), SHIPPED)
def test_a_shipped_plant_with_the_observer_of_the_delay(name, unit):
    plant = npred.plant(name)
    other, factor = rewritten(plant, unit)
    observed = problem_of(plant).refusal("observer") is None and not plant.declares_delay
    law = npred.DelayObserver() if observed else None
    one, reference = run(plant, 1.0, law, actuator="history"), speed.of_reference(plant)
    same(one, run(other, factor, law, actuator="history"), factor, plant)
    assert speed.of_reference(other) * factor == pytest.approx(reference, rel=1e-5)


@pytest.mark.parametrize("unit", UNITS)
@pytest.mark.parametrize(
    ("law", "loop"),
    [
        (npred.DelayAdaptation(), {}),
        (npred.L1Adaptation(), {"actuator": "history"}),
        (None, {"actuator": "history", "safety": npred.SafetyFilter(), "u0": "equilibrium"}),
    ],
    ids=["paper", "l1", "safety"],
)
def test_the_laws_and_the_filter_with_their_defaults(law, loop, unit):
    plant = npred.plant(Series)
    other, factor = rewritten(plant, unit)
    one = run(plant, 1.0, law, **loop)
    same(one, run(other, factor, law, **loop), factor, plant)


@pytest.mark.parametrize("unit", UNITS)
def test_an_observer_of_the_state_and_a_watchdog(unit):
    plant = npred.plant(Series)
    other, factor = rewritten(plant, unit)

    def clocked(each, k):
        return run(
            each, k, npred.DelayObserver(), steps=150, actuator="history", timing=npred.Timing(jitter=0.2),
            observer=npred.observers.EKF(each, outputs=["h2"], offset=True), watchdog=npred.Watchdog(0.062 * k, "zero"),
            measurement=npred.Measurement(noise=1e-3, period=0.042 * k, drop=0.3),
        )  # fmt: skip

    one = clocked(plant, 1.0)
    two = clocked(other, factor)
    same(one, two, factor, plant)
    assert one.clock.handed_over.any() and not one.clock.handed_over.all()


@pytest.mark.parametrize("unit", UNITS)
@pytest.mark.parametrize("name", ["cart_pole", "pvtol", "strict_feedforward2"])
def test_a_law_that_is_designed_has_the_same_gains(name, unit):
    """Also where all rates of the plant are 0."""
    plant = plants.resolve(name, {}, "lqr")
    other, _ = rewritten(npred.plant(name), unit, kappa="lqr")
    X = np.random.default_rng(0).uniform(-1, 1, (20, plant.n))
    np.testing.assert_allclose(other.kappa(X), plant.kappa(X), rtol=1e-6)


@pytest.mark.parametrize("unit", UNITS)
@pytest.mark.parametrize("name", ["scalar", "transport_tank", "slow_unicycle"])
def test_the_check_gives_the_same_answers_in_the_unit(name, unit):
    plant = npred.plant(name)
    other, factor = rewritten(plant, unit)
    D = None if plant.declares_delay or plant.delays else 0.5
    answers = [diagnosis.check(plant, D, samples=64)]
    answers.append(diagnosis.check(other, D and factor * D, samples=64))
    assert [a[:2] for a in answers[0]] == [a[:2] for a in answers[1]]
    assert f" {unit}" in " ".join(answer.text for answer in answers[1])


@pytest.mark.parametrize("unit", UNITS)
def test_a_recording_has_the_same_delay_in_the_unit(unit):
    plant = npred.plant("scalar")
    other, factor = rewritten(plant, unit)
    t, rng = np.arange(400) * 0.05, np.random.default_rng(0)
    U = np.repeat(rng.uniform(-1, 1, (40, 1)), 10, axis=0)
    X = npred.predictor(plant, "rk4", 400)(np.array([0.2]), np.vstack([np.zeros((10, 1)), U])[:400], t[-1])
    X = X + 1e-3 * rng.standard_normal(X.shape)
    one, two = (npred.identify(each, k * t, U, X) for each, k in ((plant, 1.0), (other, factor)))
    np.testing.assert_allclose(two.D / factor, one.D, rtol=1e-6)
    assert f" {unit}" in str(two) and abs(one.D[0] - 0.5) < 0.1


def test_the_observer_finds_the_delay_of_two_tanks_in_any_unit():
    """30 s; with rates per second it stayed where it began."""
    ends = []
    for factor in (1.0, 60.0, 1 / 60):
        f = staticmethod(lambda x, u, t, p, M, k=factor: [rate / k for rate in Series.f(x, u, t, p, M)])
        plant = npred.plant(type("Tanks", (Series,), {"f": f}))
        loop = npred.simulate(
            plant, npred.predictor(plant, "rk4", 21), D=0.5 * factor, D_hat=factor, X0=[0.3, 0.5], t_end=10 * factor,
            dt=0.01 * factor, adaptation=npred.DelayObserver(), actuator="history",
        )  # fmt: skip
        ends.append(loop.D_hat[-1] / factor * 60)
    np.testing.assert_allclose(ends, 30.0, atol=0.2)


def test_a_control_step_follows_the_delay_and_the_rates():
    assert [control_step.usual(D) for D in (1.0, 1.5, 2.0, 0.3, 30.0)] == [0.005, 0.005, 0.005, 0.001, 0.1]
    assert control_step.usual([0.0, 3.0, 0.3]) == 0.001
    of_pole = [control_step.usual(D, npred.plant("van_der_pol")) for D in (0.03, 0.3, 3.0)]
    assert of_pole == [0.0005, 0.005, 0.005]  # of the delay, and of the law
    scalar, loop = npred.plant("scalar"), {"X0": [1.0], "t_end": 1.0}
    rk4 = npred.predictor(scalar, "rk4", 5)
    steps = [npred.simulate(scalar, rk4, D=D, D_hat=D_hat, **loop).t[1] for D, D_hat in ((1, 1), (0, 0.3), (0, 0))]
    assert steps == pytest.approx([0.01, 0.005, 0.05])
    assert npred.simulate(scalar, rk4, D=lambda t: 0.3 + t, D_hat=0.3, **loop).t[1] == 0.005


def test_a_control_step_that_is_long_for_the_law_or_the_estimate_is_said_in_one_line(capsys, monkeypatch):
    monkeypatch.delenv("NPRED_QUIET", raising=False)
    scalar = npred.plant("scalar")
    rk4 = npred.predictor(scalar, "rk4", 5)

    def said(**loop):
        npred.simulate(scalar, rk4, X0=[1.0], **loop)
        return capsys.readouterr().err.splitlines()

    npred.simulate(scalar, rk4, X0=[1.0], D=1.0, D_hat=1.0, t_end=1.0)  # compiles
    capsys.readouterr()
    for steps in (1, 2, 3, 20):  # the law of 1 /s has the same loop, whatever the delay
        assert said(D=0.1 * steps, D_hat=0.1 * steps, dt=0.1, t_end=2.5) == []
    (long,) = said(D=10.0, D_hat=10.0, dt=0.5, t_end=12.0)
    lost = hold.loss(scalar, 0.5)
    assert long == (
        f"npred: dt: 0.5 s: with U held so long, states near rest differ by {lost:.0%} from those of kappa in "
        "continuous time; take 0.1 or less, unless kappa is designed for held commands"
    )
    assert said(D=10.0, D_hat=10.0, dt=0.5, t_end=12.0) == []  # once
    (never,) = said(D=2.4, D_hat=2.4, dt=1.2, t_end=4.8)
    assert "with U held so long, states near rest do not settle" not in never
    (never,) = said(D=2.5, D_hat=2.5, dt=2.5, t_end=4.8)
    assert "with U held so long, states near rest do not settle" in never
    short = {"D": 0.31, "D_hat": 0.3, "dt": 0.1, "t_end": 0.9, "adaptation": npred.DelayObserver(bounds=(0.1, 1.0))}
    what = "dt: 0.1 s: a delay of 3.1 control steps is estimated to some percent only"
    assert said(**short) == [f"npred: {what}; take D / 10 or less, 0.031"]
    assert said(D=1.25, D_hat=1.25, t_end=1.0) == [
        "npred: t_end: no command reaches the plant before t_end = 1, with D = 1.25 s"
    ]
    with pytest.raises(ConfigError, match=r"dt: expected at most the delay, 0.002, .* got 0.005; shorten the step"):
        said(D=0.002, D_hat=0.01, dt=0.005, t_end=1.0, adaptation=npred.DelayObserver())


def test_a_controller_says_it_of_the_longest_delay_that_its_law_takes(capsys, monkeypatch):
    monkeypatch.delenv("NPRED_QUIET", raising=False)
    scalar, law = npred.plant("scalar"), npred.DelayObserver(bounds=(0.01, 0.13))
    rk4 = npred.predictor(scalar, "rk4", 5)
    npred.controller(scalar, rk4, law, 0.005, actuator="history")
    assert "D / " not in capsys.readouterr().err
    npred.controller(scalar, rk4, law, 0.02, actuator="history")
    assert "dt: 0.02 s: a delay of 6.5 control steps is estimated" in capsys.readouterr().err
    with pytest.raises(ConfigError, match=r"dt: expected at most the delay, 0.13, .* got 0.2; shorten the step"):
        npred.controller(scalar, rk4, law, 0.2, actuator="history")


def test_a_pipeline_in_another_unit_has_the_same_loops():
    tables = [
        config.parse(
            {
                "plant": "scalar",
                "evaluate": {"D": D, "scenarios": [{"name": "push", **PUSH}]},
                "generate": {"D": D, **PUSH},
            },
            "tests",
        )
        for D in (0.2, 200.0)
    ]
    for stage in ("generate", "evaluate"):
        one, other = (getattr(table, stage) for table in tables)
        assert other.t_end == pytest.approx(1000 * one.t_end) and other.dt == pytest.approx(1000 * one.dt)
    pushes = [[table.generate.disturbance, table.evaluate.scenarios[0].disturbance] for table in tables]
    assert [wave.omega for table in pushes for wave in table] == pytest.approx([5, 5, 0.005, 0.005])
