"""The C of the loop: strict compilers find nothing in it, and sanitizers nothing in a run of it."""

import subprocess
import sys

import pytest
from c_controllers import find_nothing, needs_gcc

from npred.kernels.kernel import skeleton
from npred.loop import signals
from npred.loop.engine import LOOP, ON_A_CLOCK

STRICT = ["-std=c99", "-O1", "-Wall", "-Wextra", "-Wpedantic", "-Wshadow", "-Wconversion"]
RUN = """
import ctypes, sys
from npred.kernels import compiler
compiler.FLAGS = (*compiler.FLAGS, "-fsanitize=undefined", "-fno-sanitize-recover=all")
import numpy as np
import npred
for name, options in {
    "scalar": {"D": 0.5, "D_hat": 0.4, "adaptation": npred.DelayAdaptation(bounds=(0.1, 1.0))},
    "van_der_pol": {"D": 0.5, "D_hat": 0.4, "adaptation": npred.DelayObserver(bounds=(0.1, 1.0)), "actuator": "history",
                    "measurement": npred.Measurement(noise=0.01, absolute=[0.1, 0.0], bias=0.1, resolution=[0.0, 0.01],
                                                     period=0.1, jitter=0.5, delay=0.04, drop=0.1)},
    "unicycle": {"D": 0.5, "D_hat": 0.4, "actuator": "history"},
    "slow_unicycle": {"D": lambda t: 0.5 + 0.1 * np.sin(9 * t), "D_hat": 0.5, "actuator": "history", "u0": "law",
                      "timing": npred.Timing(jitter=0.4, lost=0.2, overrun=0.2, tells=True),
                      "observer": npred.observers.EKF(npred.plant("slow_unicycle"), offset=True),
                      "watchdog": npred.Watchdog(0.1, "zero", jump=0.1),
                      "measurement": npred.Measurement(noise=0.01, period=0.05, jitter=0.5, delay=0.04, drop=0.3)},
    "unicycle_time_delay": {},
    "chemostat": {"D": lambda t: 0.5 + 0.1 * np.sin(t), "D_hat": 0.5, "disturbance": lambda t: [0.01]},
}.items():
    plant = npred.plant(name)
    low, high = np.array([plant.box.get(state, (-0.1, 0.1)) for state in plant.states]).T
    model = npred.guarded(npred.predictor("heun", plant, nx=21), 0.01)
    X0 = low + (high - low) * np.linspace(0.4, 0.6, 3)[:, None]
    loop = npred.simulate(plant, model, X0=X0, t_end=2.0, dt=0.02, **options)
    assert loop.X.shape[0] == 3, name
print("done")
"""


@needs_gcc
@pytest.mark.parametrize("files", [LOOP, ON_A_CLOCK])
def test_strict_compilers_find_nothing_in_the_loop(tmp_path, files):
    declared = [*signals.declared(), signals.declared_events()]
    text = "\n".join([skeleton("base.h"), *declared, *map(skeleton, files)])
    (tmp_path / "loop.c").write_text(text)
    find_nothing(tmp_path, "loop.c", *STRICT)


@pytest.mark.slow
@needs_gcc
def test_no_step_of_a_loop_is_undefined(tmp_path, monkeypatch):
    monkeypatch.setenv("NPRED_CACHE", str(tmp_path))
    done = subprocess.run([sys.executable, "-c", RUN], capture_output=True, text=True)
    assert (done.returncode, done.stdout, done.stderr) == (0, "done\n", "")
