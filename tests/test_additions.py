"""A new part is two files at most, besides tests and docs: one of each kind is added to a copy of npred, and works."""

import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from conftest import ROOT, process_environment

REGISTRY = "npred/base/registry.py"
HEAD = """
import numpy as np, npred
from npred.lab.config import Evaluate, Pipeline, conditions
plant = npred.plant("scalar")
rk4 = npred.predictor(plant, "rk4", nx=51)

def run(predictor=rk4, **parts):
    settings = {"X0": [0.5], "D": 0.5, "D_hat": 0.5, "t_end": 1.0, "dt": 0.01}
    return npred.simulate(plant, predictor, **settings | parts)

def table(**keys):
    return Evaluate.model_validate({"X0": [0.5]} | keys)
"""
OBSERVER = '''
from npred.estimation.observers.luenberger import Luenberger
from npred.kernels.kernel import made
from npred.prediction.delays import problem

CORRECT = """
static inline void KERNEL(Shape d, const double *Y, double t, const double *p, double gate, const double *law,
                          double *memory, double *innovation, double *spread, double *work)
{
    (void)d, (void)t, (void)p, (void)gate, (void)law, (void)work;
    for (int i = 0; i < N; i++) {
        innovation[i] = Y[i] - memory[i];
        spread[i] = INFINITY;
        memory[i] = isnan(Y[i]) ? memory[i] : Y[i];
    }
}
"""

class Trusting(Luenberger):
    pulls = False

    @property
    def correct(self):
        return made("trusting", problem.CORRECT_BY, CORRECT, {}, {"N": self.plant.n})
'''
METHOD = """
from npred.prediction.methods.base import OneStep

class Ralston(OneStep):
    name, order = "ralston", 2

    @staticmethod
    def step(f, x, u0, um, u1, t, h):
        return x + h / 4 * (f(x, u0, t) + 3 * f(x + 2 * h / 3 * f(x, u0, t), u0 + 2 * (u1 - u0) / 3, t + 2 * h / 3))
"""
KINDS = {  # what is added to each file, by the text that follows it; and what works then
    "error of a sensor": (
        {
            "npred/loop/measurement.py": {
                '"noise", "relative_noise", "bias"': '"skew", ',
                "    noise: PerState = 0.0": "    skew: PerState = field(default=0.0, kw_only=True)  #: of the scale\n",
                "        step = np.broadcast_to(self": "        Y = Y * (1 + np.asarray(self.skew))\n",
            },
            "npred/kernels/c/sensor_errors.h": {"        y[c * lanes] = ": "        value *= 1.0 + s->skew[c];\n"},
        },
        """
skewed = npred.Measurement(skew=0.5)
assert run(X0=[1.0], D_hat=0.0, measurement=skewed).U[0] == run(X0=[1.5], D_hat=0.0).U[0]
assert skewed.sampled(np.ones(1), np.random.default_rng(0)) == 1.5
both = table(measurement={"skew": 0.1}, scenarios=[{"name": "a", "measurement": {"skew": 0.5}}])
assert both.measurement.skew == 0.1 and both.under(both.scenarios[0]).measurement.skew == 0.5
""",
    ),
    "law κ": (
        {
            "npred/laws/gentle.py": {
                "": "from npred.laws.regulator import lqr\n\ndef gentle(plant):\n    return lqr(plant, R=[100.0])\n"
            },
            REGISTRY: {'        "sontag": E': '        "gentle": Entry("npred.laws.gentle:gentle", "gentle"),\n'},
        },
        """
gentle, usual = (npred.plant("scalar", kappa=name) for name in ("gentle", "lqr"))
assert abs(gentle.kappa(np.ones(1))) < abs(usual.kappa(np.ones(1)))
assert Pipeline.model_validate({"name": "a", "plant": "scalar", "kappa": "gentle"}).kappa == "gentle"
""",
    ),
    "observer of the state": (
        {
            "npred/estimation/observers/trusting.py": {"": OBSERVER},
            REGISTRY: {
                '        "luenberger": E': '        "trusting": Entry('
                '"npred.estimation.observers.trusting:Trusting", "trusting"),\n'
            },
        },
        """
observer = conditions.observer(table(actuator="history", observer={"kind": "trusting"}), plant)
assert type(observer).__name__ == "Trusting"
np.testing.assert_allclose(run(actuator="history", observer=observer).X, run(actuator="history").X, atol=1e-9)
""",
    ),
    "numerical method": (
        {
            "npred/prediction/methods/ralston.py": {"": METHOD},
            REGISTRY: {
                '"rk4", "rosenbrock", "semi': '"ralston", ',
                '        "rk4": E': '        "ralston": Entry('
                '"npred.prediction.methods.ralston:Ralston", "Ralston"),\n',
            },
        },
        """
from typing import get_args
from npred.base.registry import METHODS, Method
ralston = npred.predictor(plant, "ralston", nx=51)
np.testing.assert_allclose(run(ralston, integrator="ralston").X, run().X, atol=1e-3)
assert table(predictor="ralston").predictor in get_args(Method) == tuple(METHODS.builtin)
""",
    ),
    "part of a loop": (
        {
            "npred/loop/loop.py": {
                "    timing: Timing | None = None\n": "    load: float = 0.0  #: added to the plant's inputs\n",
                "    timing: Timing | None\n": "    load: float\n",
            },
            "npred/loop/simulation.py": {
                "        if self.loop.disturbance is None:": "        if self.loop.load:\n"
                "            return np.full((self.count, m, 1), self.loop.load)\n"
            },
        },
        """
np.testing.assert_array_equal(run(load=0.2).X, run(disturbance=lambda t: [0.2]).X)
assert (run(load=0.2).X[1:] != run().X[1:]).all()
""",
    ),
}


@pytest.mark.parametrize("kind", KINDS)
def test_a_new_part_is_two_files(kind: str, tmp_path: Path):
    files, works = KINDS[kind]
    assert len(files) <= 2
    shutil.copytree(ROOT / "npred", tmp_path / "npred", ignore=shutil.ignore_patterns("__pycache__"))
    for name, additions in files.items():
        path = tmp_path / name
        text = path.read_text() if path.exists() else ""
        for following, added in additions.items():
            assert text.count(following) == 1, (name, following)
            text = text.replace(following, added + following)
        path.write_text(text)
    program, environment = HEAD + works, process_environment(PYTHONPATH=str(tmp_path))
    command = [sys.executable, "-c", program]
    done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
