"""The controller in C on a Cortex-M in QEMU: the host's commands, and sizes that a microcontroller has."""

import shutil

import cortex_m
import numpy as np
import pytest
from operator_samples import SMALL, operator

import npred
from npred.exports import c_controller
from npred.networks.fused import Fused

MISSING = [tool for tool in ("gcc", *cortex_m.TOOLS) if shutil.which(tool) is None]
pytestmark = pytest.mark.skipif(bool(MISSING), reason=f"no {', '.join(MISSING)} on this machine")
PLANT, UNICYCLE = npred.plant("activator_repressor"), npred.plant("unicycle")
LAW = npred.DelayAdaptation(1000.0, bounds=(0.1, 2.0))


def measured(kind):
    network = Fused(PLANT, operator(SMALL[0]), 21, precision=kind)
    return npred.controller(PLANT, npred.guarded(network, 0.01), LAW, 0.02, D_hat=1.5, actuator="measured")


def recalled(kind):
    observer = npred.DelayObserver(bounds=(0.2, 1.0), candidates=10)
    return npred.controller(PLANT, npred.predictor(PLANT, "heun", 21), observer, 0.02, D_hat=0.5, actuator="history")


def with_a_clock(kind):
    return npred.controller(UNICYCLE, npred.predictor(UNICYCLE, "rk4", 21), None, 0.02, D_hat=0.6, actuator="history")


@pytest.mark.parametrize(("precision", "limit"), [("float", 0.05), ("double", 0.0)])
def test_a_safety_filter_runs_there(tmp_path, precision, limit):
    """In float its plans may differ."""
    cortex_m.write(cortex_m.filtered(), precision, tmp_path)
    row = cortex_m.measure(tmp_path, precision)
    assert row["difference"] <= limit and row["stack"] < 4000 and row["ram"] > 10_000


@pytest.mark.parametrize(("precision", "limit"), [("float", 1e-5), ("double", 0.0)])
def test_a_policy_is_the_law_there(tmp_path, precision, limit):
    cortex_m.write(cortex_m.learned(tmp_path), precision, tmp_path)
    row = cortex_m.measure(tmp_path, precision)
    assert row["difference"] <= limit and row["stack"] < 4096 and row["flash"] > 4 * 64 * 64


@pytest.mark.parametrize(("precision", "kind", "limit"), [("float", np.float32, 2e-4), ("double", np.float64, 2e-9)])
@pytest.mark.parametrize("made_of", [measured, recalled, with_a_clock])
def test_its_steps_are_the_host_s_and_its_sizes_are_small(tmp_path, made_of, precision, kind, limit):
    controller = made_of(kind)
    cortex_m.write(controller, precision, tmp_path)
    row = cortex_m.measure(tmp_path, precision)
    assert row["difference"] <= limit
    assert 1000 < row["flash"] < 60_000 and 0 < row["stack"] < 4000 and row["instructions"] > 1000
    z = controller.memory.signals
    numbers = sum(array.size for array in (z.held, z.total, z.observer))
    assert row["ram"] > {"float": 4, "double": 8}[precision] * (numbers if controller.keeps_commands else 42)


def test_a_program_that_computes_something_else_is_seen(tmp_path):
    texts = c_controller.sources(recalled(np.float64))
    copied = "    memcpy(U, self->U"
    wrong = texts[1].replace(copied, f"#ifdef __arm__\n    self->U[0] *= 1.001;\n#endif\n{copied}")
    for text, suffix in zip((texts[0], wrong), "hc", strict=True):
        (tmp_path / f"npred.{suffix}").write_text(text)
    assert cortex_m.measure(tmp_path, "double")["difference"] == pytest.approx(1e-3, rel=0.1)
