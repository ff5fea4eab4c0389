"""Costly plants, whose lanes go together from call to call: the numbers of one lane, and loops that are vectorised."""

import re
import subprocess
from pathlib import Path

import numpy as np
import pytest

import npred
from npred.formulas import called_functions
from npred.kernels import compiler, formula

SHIPPED = ["van_der_pol", "cart_pole", "unicycle", "pvtol", "chemostat", "planar_arm7", "xarm6"]


@pytest.mark.parametrize("lanes", [1, 7, 8, 9, 70])
def test_lanes_side_by_side_are_those_one_by_one(lanes):
    plant, rng = npred.plant("planar_arm6"), np.random.default_rng(0)
    assert called_functions.called(plant)
    predictor = npred.predictor("rk4", plant, nx=11)
    X, u = rng.uniform(-0.5, 0.5, (lanes, plant.n)), rng.uniform(-1, 1, (lanes, 11, plant.m))
    D_hat = rng.uniform(0.05, 0.2, lanes)
    one_by_one = np.stack([predictor(X[k], u[k], float(D_hat[k])) for k in range(lanes)])
    np.testing.assert_allclose(predictor(X, u, D_hat), one_by_one, rtol=1e-10, atol=1e-12)


def test_a_variable_that_outlives_a_call_is_an_array_and_another_is_not():
    program = ["v0 = x0", "v1 = v0 * v0", "v2 = plant_f(v1, (2.0))", "v3 = v2[1]", "v4 = v0 + v3", "y[0] = v4"]
    text = "\n".join(formula.grouped(program, {"f": 2}, lambda line: f"const double {line};"))
    assert "double v0[GROUP];" in text and "double v2[2][GROUP];" in text and "double q0[2][GROUP];" in text
    assert "    v0[l] = x0;" in text and "    const double v1 = v0[l] * v0[l];" in text
    assert "    q0[0][l] = v1;" in text and "    const double v3 = v2[1][l];" in text
    assert text.index("CALLED(plant_f, count, q0, v2);") < text.index("v3 =")


@pytest.mark.slow
@pytest.mark.parametrize("name", SHIPPED)
def test_the_loops_over_lanes_of_shipped_plants_are_vectorised(name, tmp_path: Path):
    """In the prediction and in the simulated plant: gcc says so of the line with the loop over lanes."""
    if "gcc" not in subprocess.run([*compiler.command(), "--version"], capture_output=True, text=True).stdout.lower():
        pytest.skip("asks gcc")
    plant = npred.plant(name)
    family = npred.prediction.delays.problem_of(plant)
    for kernel in (family.sweep(npred.prediction.methods.RK4.step), family.advance(npred.prediction.methods.RK4.step)):
        (tmp_path / "kernel.c").write_text(kernel.unit)
        flags = [*compiler.FLAGS, "-fopt-info-vec-optimized", "kernel.c", "-o", "kernel.so", "-lm"]
        told = subprocess.run([*compiler.command(), *flags], cwd=tmp_path, check=True, capture_output=True, text=True)
        done = {int(row) for row in re.findall(r"kernel\.c:(\d+):\d+: optimized: loop vectorized", told.stderr)}
        calls = called_functions.called(plant)
        inside = "plant_f_of" if calls else "STEP("
        lines = kernel.unit.splitlines()
        loops = [k for k, line in enumerate(lines, 1) if "LANES for" in line and any(
            inside in near for near in (lines[k - 3 : k] if calls else lines[k - 1 : k + 3]))]  # fmt: skip
        assert loops and done & set(loops), kernel.name
