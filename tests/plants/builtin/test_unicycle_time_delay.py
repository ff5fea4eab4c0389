"""The unicycle whose delay varies in time: the law is the unicycle's, arrivals have a closed form, loops converge."""

import numpy as np
import plant_claims
import pytest
from varying_delays import InTime

import npred
from npred import diagnosis, plants
from npred.base import defaults
from npred.lab import config
from npred.lab.scheduler import pipeline_fit
from npred.lab.scheduler.configuration import identity
from npred.prediction.methods import RK4

PLANT = plants.resolve("unicycle_time_delay")


def test_all_but_the_delay_is_the_unicycles():
    unicycle = plants.resolve("unicycle")
    for name in ("f", "kappa", "V", "reference"):
        assert identity(PLANT)["program"][name] == identity(unicycle)["program"][name]
    assert PLANT.one_delay and PLANT.delays is None and PLANT.box == unicycle.box


@pytest.mark.parametrize("b", [2.0, 4.0])
def test_the_time_of_arrival_is_that_of_the_docstring(b):
    a, t = 1.0, np.linspace(0, 50, 101)
    s = (a + b * t - 1 + np.sqrt((a + b * t - 1) ** 2 + 4 * b * (1 + t))) / (2 * b)
    plant = npred.plant("unicycle_time_delay", a=a, b=b)
    np.testing.assert_allclose(s - plant.delay(np.zeros((101, 3)), s), t, rtol=0, atol=1e-12)
    if b == 2:
        np.testing.assert_allclose(InTime.sigma(t), s, rtol=1e-14)


def test_commands_never_overtake_each_other():
    answers = {answer.check: answer for answer in diagnosis.check(PLANT)}
    assert answers["feasibility"].verdict == "yes" and diagnosis.settled(list(answers.values()))


def test_from_the_first_command_on_it_converges_as_the_unicycle_does():
    """From the box, as 1 / sqrt(t)."""
    X0 = plant_claims.box(PLANT, 8)
    loops = npred.simulate(PLANT, RK4(PLANT, 25), X0=X0, t_end=500.0, dt=0.025, every=20)
    late = loops.t > 20
    assert (np.linalg.norm(loops.X[:, late], axis=-1) * np.sqrt(loops.t[late])).max() < 0.5
    assert (loops.infeasible == -1).all()


def test_its_pipeline_fits():
    pipeline = config.load(defaults.shipped()["time_delay"])
    assert plants.resolve(pipeline.plant).name == PLANT.name
    pipeline_fit.require(PLANT, pipeline, ("generate", "train", "evaluate", "bench"))
