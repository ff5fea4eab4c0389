"""The test inside an exported controller: it moves all, passes in both precisions, and fails for another text."""

import subprocess

import limited
import numpy as np
import plants
import pytest
from c_controllers import FLAGS, needs_gcc
from plants import declared
from self_tested import TWELVE
from self_tested import judged as of_mutants

import npred
from npred.exports import c_controller, self_test

pytestmark = needs_gcc


def written(folder, controller, precision, change=("", "")):
    for file, text in zip(("npred.h", "npred.c"), c_controller.sources(controller, precision=precision), strict=True):
        assert change[0] in text or file == "npred.h"
        (folder / file).write_text(text.replace(*change) if change[0] else text)


def own_test(folder, *flags):
    command = ["gcc", *(flags or FLAGS), "-DNPRED_TEST", "npred.c", "-o", "own_test", "-lm"]
    subprocess.run(command, cwd=folder, check=True, timeout=300)
    return subprocess.run([folder / "own_test"], capture_output=True, text=True, timeout=60)


@pytest.mark.parametrize("name", TWELVE)
def test_it_moves_all_and_passes_in_both_precisions(tmp_path, name):
    controller = TWELVE[name][0]()
    test, growth = self_test.designed(controller)
    U, D_hat = self_test.answers(controller, test)
    assert growth < self_test.GROWTH and (np.nanmax(U, axis=0) > np.nanmin(U, axis=0)).all()
    assert np.ptp(D_hat) > 0 or not (controller.adaptation or controller.plant.declares_delay)
    for precision in ("double", "float"):
        written(tmp_path, controller, precision)
        done = own_test(tmp_path)
        assert (done.returncode, precision) == (0, precision), done.stdout
        assert precision == "float" or done.stdout.startswith("largest difference: 0.00e+00")


def test_multiply_adds_and_vectors_pass_too(tmp_path):
    written(tmp_path, TWELVE["EKF"][0](), "double")
    assert own_test(tmp_path, "-std=gnu99", "-O3", "-march=native").returncode == 0


@pytest.mark.parametrize("name", ["scalar", "van_der_pol", "cart_pole", "unicycle", "strict_feedforward3"])
def test_a_law_of_another_gain_fails(tmp_path, name):
    """A controller at rest would give 0 with any gain."""
    plant = npred.plant(name)
    controller = npred.controller(plant, npred.predictor(plant, "heun", 21), None, 0.01, D_hat=0.3, actuator="history")
    clipped = "clip(d, s->input_bounds, z->U);\n    if (q->update)"
    written(tmp_path, controller, "double", (clipped, f"z->U[0] *= 1.000001;\n    {clipped}"))
    assert own_test(tmp_path).returncode in (1, 2)


FILTERED = {"Cart": (0.3, 0.01), "Pole": (0.12, 0.005), "Lane": (0.15, 0.01), "Elbow": (0.1, 0.01)}  # D, dt
SEVEN = [*FILTERED, "near", "swing", "docs"]
Docs = declared(  # of docs/safety.md
    "Docs", "x v", "u", lambda x, u, t, p, M: [x.v, u.u], [(-1.0, 1.0), (-1.0, 1.0)], (-5.0, 5.0),
    kappa=lambda x, t, p, M: [-4 * (x.x - 0.95) - 1.2 * x.v], safe=lambda x, t, p, M: [1.0 - x.x, 1.0 + x.x],
)  # fmt: skip


def filtered(name):
    if name in FILTERED:
        plant, (D, dt) = (
            npred.plant(getattr(plants, name), **{"kappa": "lqr"} if name == "Pole" else {}),
            FILTERED[name],
        )
    else:
        case = limited.cases().get(name)
        plant, D, dt = (case.plant, case.D, case.dt) if case else (npred.plant(Docs), 0.3, 0.01)
    return npred.controller(
        plant, npred.predictor(plant, "rk4", 31), None, dt, D_hat=D, actuator="history", safety=npred.SafetyFilter()
    )


@pytest.mark.parametrize("name", FILTERED)
def test_a_filter_passes_in_float_and_one_of_other_plans_or_limits_fails(tmp_path, name):
    """Each call of its kernel has a memory of its own, and a limit that is what rounding can do in this call."""
    changes = ("high[c]) + added", "high[c]) - added"), ("least_h = smaller(", "least_h = 0.999f * smaller(")
    for change in (("", ""), *changes):
        written(tmp_path, filtered(name), "float", change)
        done = own_test(tmp_path)
        assert (done.returncode == 0) == (not change[0]), change
        assert ("case" in done.stdout) == bool(change[0])


@pytest.mark.campaign
@pytest.mark.parametrize("name", SEVEN)
def test_no_mutant_of_a_filter_that_changes_u_passes_in_float(name):
    row = of_mutants(filtered(name), "float", 200, part="protect")
    print(row)
    assert row.mutants == 200 and not row.matter


@pytest.mark.slow
@pytest.mark.parametrize("name", ["plain", "law"])
def test_no_mutant_that_changes_u_passes(name):
    assert not judged(name, 60).matter


@pytest.mark.campaign
@pytest.mark.parametrize("name", TWELVE)
def test_of_many_at_most_one_in_a_hundred_does(name):
    """Those that are known need states far outside of the box, or move U by less than float's rounding."""
    assert len(judged(name, 1500).matter) <= 15


def judged(name, count):
    make, precision = TWELVE[name]
    row = of_mutants(make(), precision, count)
    assert row.mutants == count and row.passed < 0.9 * count  # many are in code that this controller does not run
    return row
