"""C files from skeletons: names from anywhere give valid C, and everything else is refused in one line."""

import tempfile
import zipfile
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from c_controllers import find_nothing, needs_gcc
from hypothesis import given, settings
from hypothesis import strategies as st
from operator_samples import PLANT, SMALL, operator, samples

import npred
from npred import exports
from npred.base.errors import NpredError
from npred.exports import WholeController, c_controller, c_files, c_network
from npred.plants import Plant
from npred.prediction.methods import Heun

FLAGS = ["-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Wshadow"]
HOSTILE = [
    "*/", "/*", "//", "??/", "??=", "\\", "\n#error", "*/ int owned; /*", "double", "long", "NAN", "y0",
    "ä", "日本", "%s%n", '"', "'", "{}", "{about}", "{sizes}", "@", "%%", "<DT>", "REAL", "0" * 64, "DIGEST_WORDS",
    "\x00", "\u202e", "a" * 200,
]  # fmt: skip
TEXTS = st.text(max_size=30) | st.sampled_from(HOSTILE) | st.lists(st.sampled_from(HOSTILE), max_size=3).map("".join)
NAMES = st.sampled_from(["h", "double", "long", "NAN", "y0", "self", "memory", "größe", "x0", "P", "main"]) | TEXTS
PREFIXES = st.sampled_from(["npred", "tank", "int", "main", "f", "m", "self", "memory", "x0"]) | TEXTS


def declaration(state, entry, unit):
    """A plant with one state and one input."""
    parts = {
        "states": (state,), "inputs": (entry,), "units": {state: unit},
        "f": lambda x, u, t, p, M: [u[0] - x[0]], "kappa": lambda x, t, p, M: [-x[0]],
        "V": lambda x, t, p, M: x[0] ** 2,
    }  # fmt: skip
    return type("Named", (), parts)


def is_c(*texts):
    with tempfile.TemporaryDirectory() as name:
        for text, suffix in zip(texts, ("c", "h"), strict=False):
            (Path(name) / f"file.{suffix}").write_text(text, encoding="utf-8")
        find_nothing(name, "file.c", *FLAGS)


def check_controller(plant, state, entry, unit, prefix, model):
    try:
        named = Plant(plant, declaration(state, entry, unit))
        controller = npred.controller(named, Heun(named, 5), None, 0.1, D_hat=0.3, actuator="history")
        header, source = c_controller.sources(controller, prefix, model=model)
    except NpredError as error:
        assert len(str(error).splitlines()) == 1 and str(error).isprintable()
    else:
        is_c(source.replace(f'#include "{prefix}.h"', '#include "file.h"'), header)


@needs_gcc
@settings(max_examples=60, deadline=None)
@given(TEXTS, NAMES, NAMES, TEXTS, PREFIXES, TEXTS)
def test_a_controller_of_any_names_is_c_or_refused(plant, state, entry, unit, prefix, model):
    check_controller(plant, state, entry, unit, prefix, model)


@needs_gcc
@pytest.mark.campaign
@settings(max_examples=1000, deadline=None)
@given(TEXTS, NAMES, NAMES, TEXTS, PREFIXES, TEXTS)
def test_so_are_a_thousand(plant, state, entry, unit, prefix, model):
    check_controller(plant, state, entry, unit, prefix, model)


def check_fmu(plant, state, entry, unit, model):
    """The description is XML with the names as they are, and the sources are C."""
    with tempfile.TemporaryDirectory() as name, pytest.MonkeyPatch.context() as patch:
        patch.setattr(c_files, "compiler", lambda: None)  # the sources alone
        try:
            named = Plant(plant, declaration(state, entry, unit))
            controller = npred.controller(named, Heun(named, 5), None, 0.1, D_hat=0.3, actuator="history")
            exports.writer("fmu", {})(WholeController(controller, model), Path(name) / "named.fmu")
        except NpredError as error:
            assert len(str(error).splitlines()) == 1 and str(error).isprintable()
            return
        with zipfile.ZipFile(Path(name) / "named.fmu") as archive:
            archive.extractall(name)
        root = ElementTree.parse(Path(name) / "modelDescription.xml").getroot()
        assert {state, entry} <= {element.get("name") for element in root.iter("Float64")}
        find_nothing(Path(name) / "sources", "fmi3.c", *FLAGS)


@needs_gcc
@settings(max_examples=25, deadline=None)
@given(TEXTS, NAMES, NAMES, TEXTS, TEXTS)
def test_an_fmu_of_any_names_is_xml_and_c_or_refused(plant, state, entry, unit, model):
    check_fmu(plant, state, entry, unit, model)


@needs_gcc
@pytest.mark.campaign
@settings(max_examples=1000, deadline=None)
@given(TEXTS, NAMES, NAMES, TEXTS, TEXTS)
def test_so_are_a_thousand_fmus(plant, state, entry, unit, model):
    check_fmu(plant, state, entry, unit, model)


@needs_gcc
@settings(max_examples=5, deadline=None)
@given(TEXTS)
def test_a_network_s_file_of_any_plant_s_name_is_c(name):
    model, data = operator(SMALL[0]), samples(2, 11, 0)
    plant = Plant("accepted", PLANT.declaration)
    plant.name = name  # which the declaration would refuse
    is_c(c_network.source(model, plant, 11, (data.X, data.u, data.D_hat, np.ones(2))))


def test_a_condition_that_no_variant_is_stays_for_the_compiler():
    text = "#if A\n1\n#ifdef B\n2\n#else\n3\n#endif\n#else\n4\n#endif\n#if defined C\n5\n#endif\n"
    assert c_files.decided(text, {"A": True}) == "1\n#ifdef B\n2\n#else\n3\n#endif\n#if defined C\n5\n#endif\n"
    assert c_files.decided(text, {"A": False}) == "4\n#if defined C\n5\n#endif\n"


def test_names_types_and_parts_are_written_in(tmp_path, monkeypatch):
    text = '#include "npred.h"\n#include "numbers.h"\nnpred_real npred_step(int NPRED_NX); /* by npred 1.0 */\n'
    (tmp_path / "file.c").write_text(text)
    monkeypatch.setattr(c_files, "FOLDER", tmp_path)
    written = c_files.filled("file.c", "tank", "float", included={"numbers": "static const int npred_kept = 1;"})
    assert written == (
        '#include "tank.h"\nstatic const int npred_kept = 1;\nfloat tank_step(int TANK_NX); /* by npred 1.0 */\n'
    )


def test_a_file_that_does_not_compile_is_told_in_one_line(tmp_path):
    if not c_files.compiler():
        pytest.skip("no C compiler on this machine")
    (tmp_path / "wrong.c").write_text("int f(void) { return none; }\n")
    with pytest.raises(NpredError, match=r"^export c: expected sources that compile, got: [^\n]*; report it$"):
        c_files.build([tmp_path / "wrong.c"], tmp_path / "wrong.so", "c")
