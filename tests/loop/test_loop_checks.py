"""What a loop cannot be asked for: told before the compiled engine reads memory that is not there."""

import numpy as np
import pytest

from npred import plants
from npred.base.errors import ConfigError
from npred.estimation.adaptation import DelayAdaptation
from npred.estimation.delay_observer import DelayObserver
from npred.loop.closed_loop import simulate
from npred.loop.measurement import Measurement
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
        ({"predictor": RK4(CLOCK)}, "expected one of plant scalar .* got one of activator_repressor"),
        ({"predictor": Euler(plants.resolve("scalar", {"a": 0.7}))}, "with its parameters"),
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
