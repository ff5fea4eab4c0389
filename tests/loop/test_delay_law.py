"""Laws of one's own for the delay estimate: the loop, the controller, and mistakes told with the line of the law."""

import numpy as np
import pytest
from input_histories import at_nodes

import npred
from npred.errors import ConfigError
from npred.predictors import RK4

PLANT = npred.plant("scalar")
LOOP = {"D": 1.0, "D_hat": [1.6, 0.7], "X0": [[1.0], [0.5]], "t_end": 3.0, "dt": 0.01}


class Towards(npred.DelayLaw):
    """D_hat' = gamma (1 - D_hat)."""

    def rate(self, plant, X, u, P, D_hat, t):
        return self.gamma * (1.0 - D_hat)


class Leaky(npred.DelayAdaptation):
    """The paper's law and a leak towards 1 s."""

    def rate(self, plant, X, u, P, D_hat, t):
        return super().rate(plant, X, u, P, D_hat, t) - 0.5 * (D_hat - 1.0)


class Same(npred.DelayAdaptation):
    """The paper's law, in Python."""

    def rate(self, plant, X, u, P, D_hat, t):
        return super().rate(plant, X, u, P, D_hat, t)


def loops(law, **changes):
    return npred.simulate(PLANT, RK4(PLANT, 51), adaptation=law, **LOOP | changes)


def test_the_estimate_follows_the_rate():
    """D_hat' = gamma (1 - D_hat) in closed form: the error falls with the square of dt."""
    errors = []
    for dt in (0.01, 0.005):
        estimates = loops(Towards(gamma=2.0), dt=dt).D_hat
        exact = 1.0 + np.array([[0.6], [-0.3]]) * np.exp(-2.0 * dt * np.arange(estimates.shape[-1]))
        errors.append(np.abs(estimates - exact).max())
    assert errors[0] < 2e-4
    assert errors[1] / errors[0] == pytest.approx(0.25, abs=0.03)


def test_the_estimate_stays_within_the_bounds():
    found = loops(Towards(gamma=2.0, bounds=(0.5, 0.9)), D_hat=0.6).D_hat
    assert found.max() == 0.9 and (np.diff(found) >= 0).all()


def test_the_papers_law_is_the_same_in_python():
    settings = {"gamma": 3.0, "b": 0.5, "bounds": (0.2, 3.0)}
    compiled, interpreted = loops(npred.DelayAdaptation(**settings)), loops(Same(**settings))
    np.testing.assert_allclose(interpreted.D_hat, compiled.D_hat, rtol=1e-12)
    np.testing.assert_allclose(interpreted.X, compiled.X, rtol=1e-10, atol=1e-13)
    assert np.isfinite(compiled.N).all() and np.isnan(interpreted.N).all()


def test_a_law_may_extend_the_papers():
    found = loops(Leaky(gamma=1.0), t_end=20.0).D_hat[:, -1]
    np.testing.assert_allclose(found, 1.0, atol=1e-3)


def test_a_law_may_replace_phi():
    class Still(npred.DelayAdaptation):
        def phi(self, plant, X, u, P, D_hat, t=0.0):
            return np.zeros(len(D_hat))

    run = loops(Still(gamma=1000.0))
    np.testing.assert_array_equal(run.D_hat, np.broadcast_to(run.D_hat[..., :1], run.D_hat.shape))


def test_the_controller_takes_the_same_steps():
    law = Leaky(gamma=2.0)
    loop = loops(law, D_hat=1.6, X0=[1.0], samples=np.arange(300))
    controller = npred.controller(PLANT, RK4(PLANT, 51), law, 0.01, D_hat=1.6)
    for k in range(300):
        np.testing.assert_allclose(controller.D_hat, loop.D_hat[k], rtol=1e-12)
        U = controller.step(loop.samples.X[k], loop.samples.u[k], at_nodes(loop.U, k, 51, 100))
        np.testing.assert_allclose(U, loop.U[k], rtol=1e-9, atol=1e-12)


def test_what_it_sees_is_the_loops_own_and_may_not_be_written_to():
    class Vandal(npred.DelayLaw):
        def rate(self, plant, X, u, P, D_hat, t):
            X[:] = 0.0

    with pytest.raises(ConfigError, match=r"Vandal: rate \(test_delay_law.py:\d+\) failed at .*read-only; fix"):
        loops(Vandal())


def test_shapes_are_batch_first():
    seen = {}

    class Look(npred.DelayLaw):
        def rate(self, plant, X, u, P, D_hat, t):
            seen.update(X=X.shape, u=u.shape, P=P.shape, D_hat=D_hat.shape, f=plant.f(P, u).shape, t=t)
            return 0.0

    loops(Look())
    expected = {"X": (2, 1), "u": (2, 51, 1), "P": (2, 51, 1), "D_hat": (2,), "f": (2, 51, 1), "t": 3.0}
    assert seen == expected


@pytest.mark.parametrize(
    ("law", "message"),
    [
        (lambda self, plant, X, u, P, D_hat, t: X, r"expected to return \(2,\), one per loop, got \(2, 1\)"),
        (lambda self, plant, X, u, P, D_hat, t: None, r"rate \(test_delay_law.py:\d+\) expected .*, got None"),
        (lambda self, plant, X, u, P, D_hat, t: X.nothing, r"failed at test_delay_law.py:\d+: AttributeError"),
        (lambda self, plant, X: 0.0, r"failed: TypeError: .*takes 3 positional arguments"),
    ],
)
def test_a_law_that_fails_is_told_with_its_line(law, message):
    with pytest.raises(ConfigError, match=message) as caught:
        loops(type("Wrong", (npred.DelayLaw,), {"rate": law})())
    assert "\n" not in str(caught.value)


def test_a_law_may_refuse_a_plant():
    class Choosy(Towards):
        def check(self, plant):
            raise ConfigError(f"Choosy: not for plant {plant.name}")

    with pytest.raises(ConfigError, match="Choosy: not for plant scalar"):
        loops(Choosy())


@pytest.mark.parametrize("wrong", [{"gamma": 0.0}, {"b": -1.0}, {"bounds": (2.0, 1.0)}, {"bounds": (0.1, np.inf)}])
def test_settings_that_make_no_sense_are_told(wrong):
    with pytest.raises(ConfigError, match="adaptation: expected"):
        Towards(**wrong)
