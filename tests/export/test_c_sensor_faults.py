"""A sensor that fails for a time, in the exported controller and in an FMU: what they do is what Python does."""

import numpy as np
import pytest
from c_controllers import InC, library, needs_gcc
from faulty_sensors import DT, FAULTS, Loop, controller
from fmus import InFmu, exported, needs_cc

FAILS = ("inf", "1e+308", "1e+12", "4", "ramp", "all kinds", "burst")
SAID = ("late", "refused", "missed", "renewed", "handed_over")


class InBoth(Loop):
    """A loop of the controller in Python, whose calls another one gets too."""

    def __init__(self, one, other):
        super().__init__(one)
        self.other, self.size = other, np.full(self.plant.m, 1e-3)

    def call(self, Y):
        t = len(self.errors) * DT
        super().call(Y)
        self.size = np.maximum(self.size, np.abs(self.U))
        assert (np.abs(self.other(t, Y) - self.U) <= 1e-7 * self.size).all()


def failing(loop, fault):
    return loop.run(0.5).run(2.0, FAULTS[fault]()).run(3.0)


@pytest.fixture(scope="module", params=["EKF", "Luenberger"])
def compiled(request, tmp_path_factory):
    make = lambda: controller("chemostat", request.param)
    return make, library(make(), tmp_path_factory.mktemp("faults"))


@needs_gcc
@pytest.mark.parametrize("fault", FAILS)
def test_in_c(compiled, fault):
    make, made = compiled
    c, held = InC(made, make().plant), [make().u0]

    def other(t, Y):
        code, U = c.step_at(t, Y, t)
        held[0] = U if code == 0 else held[0]
        return held[0]

    loop = failing(InBoth(make(), other), fault)
    says, python = c.status(1), loop.one.status
    assert [getattr(says, name) for name in SAID] == [getattr(python, name) for name in SAID]
    assert not says.handed_over and says.age < DT and c.restore(c.state()) == 0


@needs_cc
@pytest.mark.parametrize("version", [3, 2])
def test_in_an_fmu(tmp_path, version):
    make = lambda: controller("chemostat", "EKF")
    path, written = exported(make(), tmp_path, version)
    for fault in ("inf", "1e+308", "4"):
        run = InFmu(path, tmp_path / "extracted", written, DT)
        loop = failing(InBoth(make(), lambda _, Y, run=run: run.step(Y)), fault)
        assert run.get("renewed") == loop.one.status.renewed and run.get("refused") == loop.one.status.refused
        assert run.get("age") < DT and not run.flag("handed_over")
        run.restore(run.state())
        run.close()
