"""Loops that cannot be asked for are told before memory is read that is not there; laws that give no gain get one."""

import numpy as np
import pytest

import npred
from npred import plants
from npred.base.errors import ConfigError
from npred.estimation.adaptation import DelayAdaptation, suited_gamma
from npred.estimation.delay_observer import DelayObserver
from npred.lab.config import parse
from npred.lab.scheduler import pipeline_fit
from npred.loop import metrics
from npred.loop.closed_loop import simulate
from npred.loop.measurement import Measurement
from npred.plants import Plant
from npred.prediction.methods import RK4, Euler, Predictor

SCALAR, CLOCK = plants.resolve("scalar"), plants.resolve("activator_repressor")
LOOP = {"D": 0.1, "D_hat": 0.1, "X0": [1.0], "t_end": 0.2, "dt": 0.01}


def run(predictor="own", plant=SCALAR, **change):
    return simulate(plant, Euler(SCALAR, 5) if predictor == "own" else predictor, **LOOP | change)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"plant": "scalar"}, "plant: expected a Plant, got 'scalar'"),
        ({"predictor": "rk4"}, "predictor: expected a Predictor, got 'rk4'"),
        ({"predictor": RK4(CLOCK)}, "expected one of plant scalar, got one of activator_repressor"),
        ({"predictor": Euler(plants.resolve("scalar", {"a": 0.7}))}, "got one of scalar, whose parameters differ"),
        ({"adaptation": {"gamma": 1.0}}, "adaptation: expected a DelayLaw"),
        ({"integrator": "picard"}, "integrator: expected a one-step method, as euler, heun or rk4, got 'picard'"),
        ({"t_end": 1e12}, r"t_end: expected what fits into memory, .* got a record of 4.8 PB; shorten t_end"),
        ({"t_end": 1e300, "dt": 1e-300}, "got a record of inf"),
        ({"D": 1e12}, r"D: expected what fits into memory, .* got the history of 1.6 PB"),
        ({"D": lambda t: 0.3 if t < 0.01 else 1e12}, "got the history of 1.6 PB; shorten D, the bounds"),
        ({"D": lambda t: 0.3, "t_end": 1e300, "dt": 1e-300}, "got a record of inf"),
        ({"D": lambda t: 0.3, "t_end": None}, "t_end: expected a real number, got None"),
        ({"measurement": Measurement(delay=1e12)}, "got the history of 1.6 PB"),
        ({"adaptation": DelayObserver(bounds=(0.1, 1e12))}, "got the history of 1.6 PB"),
        ({"every": 0}, "every: expected a whole number of steps from 1 on, got 0"),
        ({"every": 1.5}, "every: expected a whole number"),
        ({"samples": np.array([5, 2])}, "samples: expected sorted whole steps of 0 to 20"),
        ({"samples": [3, 21]}, "samples: expected sorted whole steps"),
        ({"samples": [-1, 3]}, "samples: expected sorted whole steps"),
        ({"samples": np.array(3)}, "samples: expected sorted whole steps"),
        ({"u0": [1.0, 2.0]}, "u0: expected a finite number per input"),
        ({"u0": np.nan}, "u0: expected a finite number per input"),
        ({"input_bounds": [(np.nan, 1.0)]}, r"input_bounds: expected low <= high for U, got \(nan, 1\)"),
        ({"input_bounds": (1.0, 2.0, 3.0)}, r"input_bounds: expected a pair \(low, high\) for each of U"),
        ({"D": np.ones(3), "D_hat": np.ones(4)}, r"leading axes X0 \(\), D \(3,\), D_hat \(4,\)"),
        ({"X0": np.zeros((0, 1))}, r"expected at least one loop, got a batch of shape \(0,\)"),
        ({"D": "long"}, "D: expected an array of real numbers, got 'long'"),
        ({"t_end": 0.001}, "dt, t_end: expected 0 < dt <= t_end"),
        ({"t_end": None}, "t_end: expected a real number, got None"),
        ({"dt": [0.01, 0.02]}, r"dt: expected a real number, got an array of shape \(2,\)"),
        ({"X0": [1.0 + 0j]}, r"X0: expected an array of real numbers, got \[\(1\+0j\)\]"),
        ({"X0": np.ma.array([1.0], mask=[1])}, "X0: expected an array of real numbers, got a masked array"),
        ({"X0": np.array([[1.0], [np.inf]])}, r"X0: expected finite numbers, got inf at \[1, 0\]"),
        ({"D": [0.1, np.nan]}, r"D: expected a delay of at least 0, got nan at \[1\]"),
    ],
)  # fmt: skip
def test_a_wrong_argument_is_told(change, message):
    with pytest.raises(ConfigError, match=message):
        run(**change)


def test_a_predictor_with_parameters_of_its_own_may_predict_a_plant_that_drifted():
    class Still(Predictor):
        def predict(self, X, u, D_hat, t):
            return np.repeat(X[:, None], u.shape[1], axis=1)

    nominal, drifted = Still(SCALAR, 5), plants.resolve("scalar", {"a": 0.7})
    assert np.isfinite(run(nominal, drifted).X).all()


def test_the_same_plant_resolved_again_is_the_same_plant():
    np.testing.assert_array_equal(run(plant=plants.resolve("scalar")).X, run().X)


def test_samples_may_be_a_list_and_one_inputs_bounds_a_pair():
    loop = run(samples=[0, 7], input_bounds=(-0.5, 0.0))
    np.testing.assert_array_equal(loop.samples.X, loop.X[[0, 7]])
    assert loop.U.min() == -0.5 and loop.U.max() <= 0.0


def test_a_step_longer_than_the_delay_is_for_a_delay_that_is_known():
    """X(t + D), where commands arrive, shrinks in each step as without delay; an estimate sees a single command."""
    a, c, slow = 0.5, 1.0, {"D": 0.12, "D_hat": 0.12, "dt": 0.3, "t_end": 3.0}
    X = run(**slow).X[:, 0]
    np.testing.assert_allclose(X[2:] / X[1:-1], np.exp(a * 0.3) - (a + c) / a * np.expm1(a * 0.3), rtol=2e-3)
    for law in (DelayObserver(), DelayAdaptation(gamma=1.0)):
        with pytest.raises(
            ConfigError, match=r"dt: expected at most the delay, 0.12, .* got 0.3; shorten the step, or"
        ):
            run(adaptation=law, **slow)


class Tank:
    """The README's."""

    states, inputs, box, guess = ("h",), ("q",), {"h": (0.5, 2.0)}, (1.0,)

    @staticmethod
    def f(x, u, t, p, M):
        return [u.q - 0.5 * M.sqrt(x.h)]

    @staticmethod
    def kappa(x, t, p, M):
        return [0.5 * M.sqrt(x.h) - x.h + 1.0]

    @staticmethod
    def V(x, t, p, M):
        return (x.h - 1.0) ** 2


def test_the_papers_plant_has_the_papers_gain():
    assert suited_gamma(npred.plant("activator_repressor"), 1.0) == 1000.0


@pytest.mark.parametrize("D", [0.25, 1.0, 2.0])
def test_of_the_scalar_plant_it_is_the_integral_in_closed_form(D):
    """X(D) = exp(a D) X0 and then exp(-c t): dU/dt = (a + c) c X, V = X², the largest of starts near 1."""
    a, c = 0.5, 1.0
    X = np.exp(a * D) * np.exp(-c * np.linspace(0, 20, 200_001))
    power = 1.5 * ((a + c) * c * X) ** 2
    exact = 1 / (np.sum(power / (1 + X**2 + D**2 * power)) * 1e-4)
    assert exact / 2.6 < suited_gamma(SCALAR, D) <= 1.1 * exact  # rounded down to 1, 2, 5; the box's starts are inside


def test_it_is_one_two_or_five_times_a_power_of_ten_and_the_delay():
    found = {f"{suited_gamma(SCALAR, D) / D:.0e}"[0] for D in (0.1, 0.3, 1.0, 3.0)}
    assert found <= {"1", "2", "5"}


def test_a_plant_that_gives_none_is_told():
    nowhere = {"f": staticmethod(lambda x, u, t, p, M: [u.q - M.sqrt(x.h - 5)])}
    falls = {"kappa": staticmethod(lambda x, t, p, M: [0.5 * M.sqrt(x.h) + 9 * (x.h - 1.0)])}
    for change, words in (
        ({"box": {}}, "expected a gain, because plant Tank has no box for h; give gamma"),
        (nowhere, r"expected a gain, none could be derived: plant Tank: .* no rest .*; or give gamma"),
        (falls, "expected a gain, none could be derived, because loops of plant Tank overflow"),
    ):
        with pytest.raises(ConfigError, match=f"gamma: {words}"):
            suited_gamma(Plant("Tank", type("Other", (Tank,), change)), 1.0)


@pytest.mark.parametrize(("name", "D"), [("scalar", 1.0), ("van_der_pol", 1.0), ("chemostat", 1.5), ("Tank", 0.12)])
def test_loops_of_a_law_with_nothing_given_converge_from_twice_the_delay(name, D):
    """With gamma = 1000 scalar reached 3e3, and van_der_pol and chemostat ended with a wrong estimate. From the input
    at rest chemostat's estimate moves less and the loop is ten times slower."""
    plant = Plant("Tank", Tank) if name == "Tank" else npred.plant(name)
    X0 = [float(np.mean(ends) + 0.3 * np.ptp(ends)) for ends in plant.box.values()]
    run = npred.simulate(
        plant, npred.predictor(plant, "rk4", 31), D=D, D_hat=[0.5 * D, 2 * D], X0=X0, t_end=60.0, dt=D / 50,
        adaptation=npred.DelayAdaptation(), every=10, u0=[0.0],
    )  # fmt: skip
    assert metrics.converged(metrics.radius(run, plant.equilibrium), plant.equilibrium).all()
    assert np.abs(run.X).max() < 20


def test_bounds_follow_the_delay_and_hold_what_is_given():
    law = npred.DelayObserver()
    assert law.suited(SCALAR, 0.5, 1.0).bounds == (0.05, 2.0)
    assert law.suited(SCALAR, np.array([0.5, 1.0]), np.array(7.0)).bounds == (0.1, 7.0)
    given = npred.DelayAdaptation(gamma=2.0, bounds=(0.2, 3.0))
    assert given.suited(SCALAR, 0.5, 1.0) is given


def test_a_controller_takes_the_delay_from_its_first_estimate_or_asks():
    heun = npred.predictor(SCALAR, "heun", 21)
    law = npred.controller(SCALAR, heun, npred.DelayAdaptation(), 0.01, D_hat=0.5, actuator="measured").adaptation
    assert law is not None and law.bounds == (0.05, 2.0) and law.gamma == suited_gamma(SCALAR, 0.5)
    with pytest.raises(ConfigError, match=r"D_hat: expected a first estimate, .* got none; give D_hat"):
        npred.controller(SCALAR, heun, npred.DelayAdaptation(gamma=1.0), 0.01, actuator="measured")


def doubts(name: str, D: float, **evaluate) -> list[str]:
    """What is said before a run of a pipeline that gives nothing but D."""
    pipeline = parse({"plant": name, "generate": {"D": D}, "evaluate": {"D": D} | evaluate}, "tests")
    return pipeline_fit.doubts(plants.resolve(pipeline.plant, {}), pipeline)


def test_lost_loops_are_told_before_a_run_with_a_gain_to_give():
    assert doubts("scalar", 1.0) == []
    (told,) = doubts("scalar", 1.0, gamma=1000.0)
    assert "loops with D = 1 s, gamma = 1000 and D_hat(0) = 0.3, 0.5, 1, 1.5, 2 do not converge, as from" in told
    (told,) = doubts("scalar", 1.0, gamma=20.0)
    assert told.endswith(("; give gamma = 2", "; give gamma = 0.2"))


BOUNDED = """class Bounded:
    states, inputs, box, input_bounds = ("x",), ("U",), {"x": (-1, 1)}, ((-2, 2),)
    def f(x, u, t, p, M): return [x.x + u.U]
    def kappa(x, t, p, M): return [-2 * x.x]
    def V(x, t, p, M): return x.x**2
"""
FAST_AND_SLOW = """class FastAndSlow:
    states, inputs, box = ("x", "y"), ("U",), {"x": (-1, 1), "y": (-1, 1)}
    def f(x, u, t, p, M): return [u.U, -0.1 * x.y]
    def kappa(x, t, p, M): return [-60 * x.x]
    def V(x, t, p, M): return x.x**2 + x.y**2
"""


def test_only_what_lets_the_loops_converge_is_advised(tmp_path):
    """Of x' = x + U with |U| <= 2: after 1 s nothing can bring back what starts near 1, after 0.5 s all laws can."""
    path = tmp_path / "bounded.py"
    path.write_text(BOUNDED)
    (told,) = doubts(f"{path}:Bounded", 1.0)
    assert told.endswith('; with "delay-observer", or a known delay, some do not either; shorten D, or shrink box')
    (told,) = doubts(f"{path}:Bounded", 0.5, gamma=500.0)
    known = '"frozen" and D_hat = D if the delay is known'
    assert told.endswith(f'; set adaptation = "delay-observer", or set adaptation = {known}')


def test_the_loops_of_the_check_have_a_short_control_step(tmp_path):
    """A law of 60 /s is lost with commands that are held for D / 20, and kept with those of D / 50, or of the
    pipeline."""
    path = tmp_path / "fast_and_slow.py"
    path.write_text(FAST_AND_SLOW)
    assert doubts(f"{path}:FastAndSlow", 0.5, D_hat=0.5, case_D_hat=[0.5], gamma=1e-9) == []


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "D"),
    [("activator_repressor", 1.0), ("cart_pole", 0.2), ("strict_feedforward2", 1.0), ("strict_feedforward3", 1.0),
     ("van_der_pol", 1.0), ("chemostat", 1.5), ("pvtol", 0.5)],
)  # fmt: skip
def test_plants_with_nothing_but_the_delay_given_converge(name, D):
    """The rows of benchmarks/defaults.py that take seconds."""
    assert doubts(name, D) == []
