"""What exported controllers and the kernel of the safety filter take from the stack: no function more than a
microcontroller has.
"""

import re
import subprocess

import numpy as np
import pytest
from c_controllers import InC, library, needs_gcc
from conftest import QUICK
from self_tested import TWELVE

import npred
from npred.base.errors import ConfigError
from npred.exports import c_controller
from npred.kernels import compiler
from npred.loop.safety import filter as safety
from npred.plants import Plant

pytestmark = needs_gcc


def joints(count):
    """So many joints with stops and limits of their speeds, sent beyond the stops."""

    class Arm:
        states = tuple(f"{name}{i}" for name in "qw" for i in range(count))
        inputs = tuple(f"T{i}" for i in range(count))
        box, input_bounds = dict.fromkeys(states, (-0.5, 0.5)), ((-5.0, 5.0),) * count
        f = lambda x, u, t, p, M: [*x[count:], *u]
        kappa = lambda x, t, p, M: [-4 * (x[i] - 1.2) - 3 * x[count + i] for i in range(count)]
        safe = lambda x, t, p, M: [
            b - s * x[o + i] for o, b in ((0, 1.0), (count, 0.8)) for s in (1, -1) for i in range(count)
        ]

    return Plant("arm", Arm)


def of_joints(count, delay):
    plant, kept = joints(count), npred.SafetyFilter(delay=delay)
    return npred.controller(
        plant, npred.predictor(plant, "rk4", 31), None, 0.01, D_hat=0.05, actuator="history", safety=kept
    )


FRAME = ("-Wframe-larger-than=4096", "-Werror", "-fno-semantic-interposition")  # which inlines as a program does
MADE = {
    name: TWELVE[name][0] for name in ("plain", "EKF", "guard", "filter", "declared", "law", "observer of the delay")
}
MADE |= {"seven joints": lambda: of_joints(7, 0.02), "twelve joints": lambda: of_joints(12, 0.02)}


@pytest.mark.parametrize("precision", ["double", "float"])
@pytest.mark.parametrize("name", MADE)
def test_no_function_of_an_export_has_a_frame_above_4_kb_and_its_header_tells_its_size(
    tmp_path, monkeypatch, name, precision
):
    monkeypatch.setattr(c_controller, "_test", lambda *of: "")  # of twelve joints it takes minutes
    if "joints" in name:
        monkeypatch.setattr(compiler, "FLAGS", QUICK)
    compiled = library(MADE[name](), tmp_path, precision, FRAME)
    told = re.findall(r"takes (\d+) bytes of memory, of which its state is (\d+)", (tmp_path / "npred.h").read_text())
    assert told == [(str(compiled.size_of_controller()), str(compiled.size_of_saved()))]


@pytest.mark.parametrize("count", [1, 7])
def test_nor_has_the_filter_where_loops_are_simulated(tmp_path, count):
    (tmp_path / "kernel.c").write_text(npred.SafetyFilter(delay=0.02).kernels(joints(count))["protect"].unit)
    subprocess.run(["gcc", *compiler.FLAGS, *FRAME, "kernel.c", "-o", "k.so"], cwd=tmp_path, check=True, timeout=300)


@pytest.mark.parametrize("count", [7, 12])
def test_an_arm_of_many_joints_stops_in_python_and_in_c(tmp_path, monkeypatch, count):
    monkeypatch.setattr(c_controller, "_test", lambda *of: "")
    monkeypatch.setattr(compiler, "FLAGS", QUICK)
    controller = of_joints(count, 0.02)
    in_c, X = InC(library(controller, tmp_path, more=FRAME), controller.plant), np.zeros(2 * count)
    X[:count], X[count:] = 0.6, 0.7
    for _ in range(3):
        np.testing.assert_array_equal(in_c.step(X), controller.step(X))
    assert controller.status.filtered


@pytest.mark.parametrize("ends", [1, 3])
def test_the_memory_of_a_filter_is_counted_as_the_compiler_does(ends):
    """But for what limits that depend on time need, and integers, which in single precision are as long as numbers."""
    plant = joints(2)
    unit = safety.kernel(plant, ends).unit + "\nlong size(void)\n{\n    return sizeof(Rollouts);\n}\n"
    size, counted = compiler.library(unit).size() // 8, safety.scratch(plant, ends)
    assert 0.98 * counted < size <= counted


def test_a_plant_whose_plans_would_need_absurd_memory_is_refused():
    assert safety.scratch(joints(44), 3) < safety.LARGEST < safety.scratch(joints(45), 3)
    with pytest.raises(ConfigError, match=r"at most 64 MB, got 6\d MB .*; declare fewer limits$"):
        npred.SafetyFilter(delay=0.02).kernels(joints(45))
