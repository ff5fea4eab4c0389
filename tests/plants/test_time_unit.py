"""The unit of a plant's clock: nothing that is printed about a plant in hours names seconds."""

import re
import zipfile

import numpy as np
import pytest
from c_controllers import needs_gcc

import npred
from npred import diagnosis
from npred.base.errors import ConfigError
from npred.exports import c_controller
from npred.plants import Plant

SECONDS = re.compile(r"[\d\])}] ?s\b|\bseconds?\b|\bin s\b")


class Vat:
    """A vat whose feed arrives late; time in hours."""

    states, inputs, time_unit = ("h",), ("q",), "h"
    box, guess = {"h": (0.5, 1.5)}, (1.0,)
    f = lambda x, u, t, p, M: [u.q - x.h]
    kappa = lambda x, t, p, M: [2.0 - x.h]
    V = lambda x, t, p, M: (x.h - 1.0) ** 2


class LateVat(Vat):
    delay = lambda x, t, p, M: 0.4 + 0.2 * x.h


class ClockedVat(Vat):
    period = 24.0
    kappa = lambda x, t, p, M: [2.0 - x.h + 0.1 * M.sin(t)]
    reference = lambda t, p, M: [1.0]


HOURS = {"vat": Vat, "late": LateVat, "clocked": ClockedVat}
LAW = npred.DelayObserver(bounds=(0.1, 2.0), candidates=5)


def controller(plant, **options):
    law = None if plant.declares_delay else LAW
    return npred.controller(plant, npred.predictor(plant, "rk4", 5), law, 0.01, actuator="history", u0=[1.0], **options)


def bare(vat, law, dt):
    return npred.controller(vat, npred.predictor(vat, "rk4", 5), law, dt)


def run(vat, **options):
    return npred.simulate(vat, npred.predictor(vat, "rk4", 5), X0=[1.0], t_end=1.0, **options)


def names_no_seconds(text):
    assert not (found := SECONDS.search(text)), text[max(found.start() - 60, 0) : found.end() + 20]


def test_a_time_is_printed_with_its_unit():
    assert Plant("vat", Vat).time_text(0.01) == "0.01 h"
    assert npred.plant("scalar").time_text(1 / 3, ".3g") == "0.333 s"
    assert Plant("bare", type("Bare", (Vat,), {"time_unit": ""})).time_text(2.0) == "2"


@pytest.mark.parametrize("name", HOURS)
def test_the_controller_in_python_and_in_c(name):
    made = controller(Plant(name, HOURS[name]))
    assert "dt = 0.01 h, t = 0 h, D_hat = " in repr(made)
    header, source = c_controller.sources(made)
    assert "The control step is 0.01 h" in header
    for text in (repr(made), header, source):
        names_no_seconds(text)


@pytest.mark.parametrize("name", HOURS)
def test_the_check_of_the_plant(name):
    answers = diagnosis.check(Plant(name, HOURS[name]), samples=64)
    assert any(re.search(r"\d h\b", answer.text) for answer in answers)
    for answer in answers:
        names_no_seconds(answer.text)


@needs_gcc
@pytest.mark.parametrize("version", [3, 2])
def test_the_fmu(tmp_path, version):
    npred.export(controller(Plant("vat", Vat)), "fmu", tmp_path / "vat.fmu", fmi=version)
    with zipfile.ZipFile(tmp_path / "vat.fmu") as opened:
        for file in opened.namelist():
            if not file.startswith("binaries"):
                names_no_seconds(opened.read(file).decode())
        described = opened.read("modelDescription.xml").decode()
    assert 'unit="h"' in described and 'unit="s"' not in described


@pytest.mark.parametrize(
    ("wrong", "expected"),
    [
        (lambda vat: controller(vat, D_hat=9.0), r"within the bounds \[0.1, 2\] h, got 9"),
        (lambda vat: controller(vat, history_length=1.0), "expected at least the largest delay, 2 h, got 1.0"),
        (lambda vat: bare(vat, None, 0.01), "expected a delay in h, for nothing"),
        (lambda vat: bare(vat, LAW, -1.0), "above 0, got -1.0; give a time in h"),
        (run, "a delay in h, got none"),
        (lambda vat: npred.controller(vat, npred.predictor(vat, "rk4", 5), LAW, 0.01).restore({"D_hat": 1, "step": 0,
         "t0": np.inf}), "t: expected a finite time, got inf"),
        (lambda vat: diagnosis.check(vat, delay=-1.0), "delay: expected a time above 0, got -1 h"),
        (lambda vat: run(vat, D=-1.0, D_hat=1.0), "D: expected a delay of at least 0, got -1"),
    ],
)  # fmt: skip
def test_errors(wrong, expected):
    with pytest.raises(ConfigError, match=expected) as caught:
        wrong(Plant("vat", Vat))
    names_no_seconds(str(caught.value))
