"""What was made for a plant is refused in a loop of another one, and taken in one of the same plant, made again."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import npred
from npred import plants
from npred.base.errors import ConfigError
from npred.estimation.delay_law import DelayLaw
from npred.plants import Plant
from npred.prediction.methods import RK4, Predictor


class Swing:
    """A pendulum with damping, whose angle is measured; the same names as its siblings."""

    states, inputs, outputs, parameters = ("q", "v"), ("u",), ("y",), {"c": 0.5}
    box = {"q": (-1.0, 1.0), "v": (-1.0, 1.0)}

    def f(x, u, t, p, M):
        return [x.v, -M.sin(x.q) - p.c * x.v + u.u]

    def kappa(x, t, p, M):
        return [-x.q - x.v]

    def output(x, t, p, M):
        return [x.q]


class Stiff(Swing):
    """Another f."""

    def f(x, u, t, p, M):
        return [x.v, -4 * M.sin(x.q) - p.c * x.v + u.u]


class Sine(Swing):
    """Another sensor."""

    def output(x, t, p, M):
        return [M.sin(x.q)]


class Walled(Swing):
    """Another wall."""

    state_bounds = {"q": (-1.0, 1.0)}


class Turned(Swing):
    """The same with another name of a state."""

    states, box = ("w", "v"), {"w": (-1.0, 1.0), "v": (-1.0, 1.0)}

    def f(x, u, t, p, M):
        return [x.v, -M.sin(x.w) - p.c * x.v + u.u]

    def kappa(x, t, p, M):
        return [-x.w - x.v]

    def output(x, t, p, M):
        return [x.w]


class Wider(Swing):
    """Another box, from which an EKF has its numbers."""

    box = {"q": (-2.0, 2.0), "v": (-1.0, 1.0)}


class Elsewhere(Swing):
    """Another guess."""

    guess = (0.1, 0.0)


class Weak(Swing):
    """Other input bounds."""

    input_bounds = ((-3.0, 3.0),)


class Guarded(Swing):
    """It has limits."""

    def safe(x, t, p, M):
        return [1.0 - x.q]


MOVED, SENSED = (Stiff, Turned), (Sine, Walled, Wider, Elsewhere, Weak, Guarded)
PLANT = npred.plant(Swing)
NAMED = {"D_hat": 0.2, "actuator": "history"}


class Held(Predictor):
    """One in Python, as a network: it has numbers of its own."""

    def predict(self, X: np.ndarray, u: np.ndarray, D_hat: np.ndarray, t: Any) -> np.ndarray:
        return np.repeat(X[:, None], u.shape[1], axis=1)


@dataclass(frozen=True)
class Still(DelayLaw):
    """A delay law that knows a plant."""

    plant: Plant | None = None

    def rate(self, plant: Plant, X: Any, u: Any, P: Any, D_hat: np.ndarray, t: float) -> np.ndarray:
        return np.zeros_like(D_hat)


class Sensor:
    """An observer in Python that knows a plant."""

    def __init__(self, plant: Plant) -> None:
        self.plant = plant

    def estimated(self, X_hat: np.ndarray, Y: np.ndarray, U: np.ndarray, t: float) -> np.ndarray:
        return Y


# Parts by the name of their argument, made for a plant; those that may be of other parameters
OF_PLANT: dict[str, Callable[[Plant], dict[str, Any]]] = {
    "EKF": lambda plant: {"observer": npred.observers.EKF(plant)},
    "Luenberger": lambda plant: {"observer": npred.observers.Luenberger(plant)},
    "RK4": lambda plant: {"predictor": RK4(plant, 11)},
    "guarded": lambda plant: {"predictor": npred.guarded(Held(plant, 11))},
    "delay law": lambda plant: {"adaptation": Still(1.0, 1.0, (0.1, 0.3), plant)},
}
DRIFTING: dict[str, Callable[[Plant], dict[str, Any]]] = {
    "in Python": lambda plant: {"predictor": Held(plant, 11)},
    "law of the watchdog": lambda plant: {"watchdog": npred.Watchdog(0.1, then=npred.laws.lqr(plant))},
}
SIMULATED: dict[str, Callable[[Plant], dict[str, Any]]] = {
    "sensor": lambda plant: {"measurement": npred.Measurement(observer=Sensor(plant).estimated)},
}


def controlled(plant: Plant, parts: dict[str, Any]) -> None:
    parts = {"predictor": RK4(plant, 11), "adaptation": None} | NAMED | parts
    npred.controller(plant, parts.pop("predictor"), parts.pop("adaptation"), 0.01, **parts)


def simulated(plant: Plant, parts: dict[str, Any]) -> None:
    parts = {"predictor": RK4(plant, 11), "D": 0.2, "X0": [0.1, 0.0], "t_end": 0.3, "dt": 0.01} | NAMED | parts
    npred.simulate(plant, parts.pop("predictor"), progress=False, **parts)


@pytest.mark.parametrize("other", [*MOVED, *SENSED, {"c": 0.7}], ids=[*(o.__name__ for o in (*MOVED, *SENSED)), "c"])
@pytest.mark.parametrize("name", [*OF_PLANT, *DRIFTING, *SIMULATED])
def test_a_part_of_another_plant_is_refused_and_of_the_same_one_made_again_taken(name, other):
    make = (OF_PLANT | DRIFTING | SIMULATED)[name]
    foreign = npred.plant(Swing, **other) if isinstance(other, dict) else npred.plant(other)
    runs = (simulated,) if name in SIMULATED else (controlled, simulated)
    serves = name in DRIFTING and (isinstance(other, dict) or other in SENSED)
    for run in runs:
        run(PLANT, make(npred.plant(type("Swing", (Swing,), {}))))
        if serves:
            run(PLANT, make(foreign))
            continue
        with pytest.raises(ConfigError, match=r": expected one of plant Swing, got one of .*, whose .* differ; make"):
            run(PLANT, make(foreign))


def test_a_state_of_another_plants_controller_is_refused_and_nothing_changes():
    one, same, other = (
        npred.controller(of, npred.predictor(of, "rk4", 11), None, 0.05, D_hat=0.2)
        for of in (PLANT, npred.plant(type("Copy", (Swing,), {})), npred.plant(Stiff))
    )
    one.step([0.3, 0.1])
    before = other.state()
    with pytest.raises(ConfigError, match="state: expected one of plant Stiff, got another's"):
        other.restore(one.state())
    assert other.state() == before
    same.restore(one.state())
    assert np.array_equal(same.step([0.2, 0.1]), one.step([0.2, 0.1]))


def test_another_plant_may_be_simulated():
    simulated(PLANT, {"truth": npred.plant(Stiff)})


def test_a_law_that_was_designed_for_another_plant_is_refused_wherever_a_plant_takes_one():
    law = npred.laws.lqr(npred.plant(Stiff))
    told = "kappa: expected one of plant .*, got one of another plant, whose f differ"
    for take in (
        lambda: npred.plant(Swing, kappa=law), lambda: PLANT.controlled(law),
        lambda: npred.plant(type("Swing", (Swing,), {"kappa": law})),
    ):  # fmt: skip
        with pytest.raises(ConfigError, match=told):
            take()
    text = npred.laws.Law(law.text, law.guess)  # pasted, it is anyone's
    assert npred.plant(Swing, kappa=text).law == law
    assert npred.plant(Swing, kappa=npred.laws.lqr(PLANT), c=0.7).law.made_for == PLANT.formulas


def test_what_answers_in_a_networks_place_is_of_the_same_plant():
    with pytest.raises(ConfigError, match="exact: expected one of plant Swing, got one of Swing, whose parameters"):
        npred.guarded(Held(PLANT, 11), exact=RK4(npred.plant(Swing, c=0.7), 11))


@settings(max_examples=30, deadline=None)
@given(c=st.floats(-2, 2), name=st.sampled_from(["van_der_pol", "chemostat", "scalar", "cart_pole", "unicycle"]))
def test_two_plants_have_one_identity_only_if_they_are_the_same(c, name):
    assert npred.plant(Swing, c=c).identity == npred.plant(type("Copy", (Swing,), {}), c=c).identity
    assert (npred.plant(Swing, c=c).identity == PLANT.identity) is (c == 0.5)
    assert plants.resolve(name).identity == plants.resolve(name).identity
    assert plants.resolve(name).formulas != PLANT.formulas
