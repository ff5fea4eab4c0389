"""The starts of loops: Fig. 1, cases and map, and the range that they are drawn from."""

import types

import numpy as np
from jobs import tables

from npred import plants
from npred.lab import config
from npred.lab.config.conditions import box, starts

PLANT = plants.resolve("activator_repressor")


def test_starts_are_figure_1_then_cases_then_the_map():
    tables_ = tables(evaluate={"map_D": [0.5, 1.5], "map_D_hat0": [0.6, 0.7, 0.8]})
    begin = starts(config.parse(tables_ | {"seed": 0}, "tests"), PLANT)
    assert begin.D_hat0.tolist() == [2.0, 0.8, 1.2, 0.8, 1.2, 0.6, 0.7, 0.8, 0.6, 0.7, 0.8]
    assert begin.D.tolist() == [1.0] * 5 + [0.5] * 3 + [1.5] * 3
    np.testing.assert_array_equal(begin.X0[begin.map], np.tile([0.03, 30.0], (6, 1)))
    np.testing.assert_array_equal(begin.X0[1], begin.X0[2])
    assert (begin.X0[begin.cases, 1] >= 25).all() and (begin.X0[begin.cases, 1] <= 35).all()


def test_experiments_start_in_the_plants_box_and_data_in_the_pipelines():
    pipeline = config.parse({"plant": PLANT.name, "generate": {"box": {"x1": [0.5, 0.7], "x2": [3.0, 4.0]}}}, "tests")
    boxless = types.SimpleNamespace(states=PLANT.states, box={"x2": (1.0, 2.0)})
    np.testing.assert_array_equal(box(boxless, pipeline.generate), [[0.5, 0.7], [1.0, 2.0]])
    np.testing.assert_array_equal(box(boxless, pipeline.generate, data=True), [[0.5, 0.7], [3.0, 4.0]])
