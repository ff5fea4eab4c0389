"""The controller as an FMU: FMPy's steps are npred.controller's, its states, its refusals, its file."""

import shutil
import struct
import subprocess
import xml.etree.ElementTree as ET
import zipfile
from pathlib import Path

import numpy as np
import pytest
from c_controllers import closed_loop, differ
from conftest import HERE
from fmus import InFmu, Measured, exported, needs_cc
from operator_samples import SMALL, operator
from typer.testing import CliRunner

import npred
from npred.base.errors import ConfigError, DivergedError, NpredError
from npred.cli import app
from npred.exports import c_files
from npred.guard.guarded import Guarded
from npred.networks.fused import Fused
from npred.plants import Plant
from npred.plants.builtin.activator_repressor import ActivatorRepressor

fmpy = pytest.importorskip("fmpy")
pytestmark = needs_cc
PLANT, UNICYCLE = npred.plant("activator_repressor"), npred.plant("unicycle")
PAPER = npred.DelayAdaptation(1000.0, bounds=(0.1, 4.0))
X0, POSE, DT = [0.03, 30.0], [0.3, -0.2, 0.2], 0.01
VERSIONS = (3, 2)


def heun(plant=PLANT, **options):
    return npred.controller(
        plant, npred.predictor(plant, "heun", 21), PAPER, DT, D_hat=2.0, **({"actuator": "measured"} | options)
    )


def network():
    fused = Fused(PLANT, operator(SMALL[0]).double(), 21, precision=np.float64)
    return npred.controller(PLANT, npred.guarded(fused, 0.01), PAPER, DT, D_hat=2.0, actuator="measured")


def doubting():
    guarded = npred.guarded(npred.predictor(PLANT, "euler", 21), 1.25e-5)
    return npred.controller(PLANT, guarded, PAPER, DT, D_hat=2.0, actuator="measured")


SEEKING = npred.DelayObserver(bounds=(0.2, 2.0), candidates=20)


def observing():
    return npred.controller(PLANT, npred.predictor(PLANT, "heun", 21), SEEKING, DT, D_hat=1.5, actuator="history")


def turning():
    return npred.controller(UNICYCLE, npred.predictor(UNICYCLE, "rk4", 21), None, DT, D_hat=0.6, actuator="history")


def estimating():
    """Its samples are one state of two, some late and some missing."""
    observer = npred.observers.EKF(PLANT, offset=True, outputs=PLANT.states[:1])
    law, watchdog = npred.DelayObserver(bounds=(0.05, 0.4), candidates=15), npred.Watchdog(5.5 * DT, "zero")
    named = {"observer": observer, "watchdog": watchdog, "actuator": "history"}
    return npred.controller(PLANT, npred.predictor(PLANT, "heun", 21), law, DT, D_hat=0.2, **named)


class Limited(ActivatorRepressor):
    """The repressor is to stay above a floor, with an input that cannot always do so."""

    input_bounds = ((-0.5, 0.5),)
    safe = lambda x, t, p, M: [x.x2 - 18.0]


def protecting():
    plant, safety = Plant("limited", Limited), npred.SafetyFilter(2.0, delay=0.02, horizon=0.3)
    return npred.controller(
        plant,
        npred.predictor(plant, "heun", 21),
        None,
        DT,
        D_hat=0.2,
        actuator="history",
        outlier_limit=None,
        safety=safety,
    )


CASES = {
    "measured": (heun, 1.0, X0), "network, guard": (network, 1.0, X0), "observer": (observing, 1.0, X0),
    "two delays": (turning, 0.6, POSE), "guard": (doubting, 1.0, X0),
}  # fmt: skip


@pytest.fixture(scope="module")
def instance(tmp_path_factory):
    """Instances of controllers' FMUs, each compiled once: (what makes it, version) -> another instance."""
    files = {}

    def new(make, version=3, start=0.0, h=DT, **parameters):
        if (make, version) not in files:
            folder = tmp_path_factory.mktemp(make.__name__)
            files[make, version] = *exported(make(), folder, version), folder / "extracted"
        path, written, folder = files[make, version]
        run = InFmu(path, folder, written, h, start, **parameters)
        run.path, run.written = path, written
        return run

    return new


def both(instance, case, version, steps):
    """States and commands of the loop in Python, and of that around the FMU."""
    make, D, start = CASES[case]
    controller = make()
    plant, measured, nx = controller.plant, controller.actuator == "measured", controller.predictor.nx
    runs = [Measured(controller), instance(make, version)]
    return [closed_loop(run, plant, D, DT, steps, start, measured, nx) for run in runs]


@pytest.mark.parametrize("version", VERSIONS)
@pytest.mark.parametrize("case", CASES)
def test_a_closed_loop_is_that_of_the_controller(instance, case, version):
    (X, U), (X_fmu, U_fmu) = both(instance, case, version, 1000)
    assert differ(X, X_fmu) < 1e-12 and differ(U, U_fmu) < 1e-12


@pytest.mark.campaign
@pytest.mark.parametrize("case", ["measured", "observer", "two delays", "guard"])
def test_so_is_a_long_one(instance, case):
    """Of loops that converge: an untrained network's amplifies rounding."""
    (X, U), (X_fmu, U_fmu) = both(instance, case, 3, 100_000)
    assert differ(X, X_fmu) < 1e-12 and differ(U, U_fmu) < 1e-12


def states(count):
    return np.array(X0) * (1 + 0.1 * np.random.default_rng(0).standard_normal((count, 2)))


@pytest.mark.parametrize("version", VERSIONS)
def test_goes_on_from_a_saved_state_to_the_bit(instance, version):
    one, other = (instance(observing, version) for _ in range(2))
    X = states(800)
    for x in X[:500]:  # past the end of the ring buffers
        one.step(x)
    saved = one.state()
    other.restore(saved)
    for x in X[500:]:
        np.testing.assert_array_equal(one.step(x), other.step(x))
    assert one.state() == other.state() != saved


@pytest.mark.parametrize("version", VERSIONS)
def test_two_side_by_side_are_independent(instance, version):
    pair, alone = ([instance(observing, version) for _ in range(2)] for _ in range(2))
    X = states(200).reshape(2, 100, 2)
    mixed = [[run.step(x) for run, x in zip(pair, rows, strict=True)] for rows in np.swapaxes(X, 0, 1)]
    apart = [[run.step(x) for x in rows] for run, rows in zip(alone, X, strict=True)]
    np.testing.assert_array_equal(np.swapaxes(mixed, 0, 1), apart)


@pytest.mark.parametrize("version", VERSIONS)
@pytest.mark.parametrize("make", [heun, observing])
def test_a_control_step_that_is_refused_holds_u_and_goes_on_as_in_python(instance, version, make):
    run, controller, u = instance(make, version), make(), [np.zeros((21, 1))] if make is heun else []
    for k in range(6):
        X = np.array([np.nan if k in (2, 3) else X0[0], X0[1]])
        before = run.get("U")
        after = run.step(X, *u)
        if k in (2, 3):
            with pytest.raises(DivergedError):
                controller.step(X, *u)
            assert after == before
        else:
            np.testing.assert_allclose(after, controller.step(X, *u), rtol=1e-12)
    refused = "expected finite inputs, got one that is not; U keeps its value"
    assert run.messages == [f"step at 0.02 s: {refused}", f"step at 0.03 s: {refused}"]
    assert run.get("time") == pytest.approx(controller.t) == 0.06


def test_a_wrong_sample_is_predicted_over_as_in_python(instance):
    run, controller = instance(turning), turning()
    for k in range(40):
        X = np.array(POSE) + 9.0 * (k in (20, 21))
        np.testing.assert_allclose(run.step(X), controller.step(X), rtol=1e-12)
        assert controller.status.missed == (k - 19 if k in (20, 21) else 0)


@pytest.mark.parametrize("version", VERSIONS)
@pytest.mark.parametrize("make", [turning, estimating])
def test_samples_that_are_late_or_missing_and_the_status_are_those_of_python(instance, version, make):
    rng, controller, starts = np.random.default_rng(5), make(), 3.0
    start, past, seen = X0 if make is estimating else POSE, [], set()
    run = instance(make, version, start=starts)
    controller.t = starts
    for k in range(300):
        X = np.array(start) * (1 + 0.1 * np.sin(0.05 * k)) + 9.0 * (k in (80, 81))
        past.append(X[: len(controller.outputs)])
        late = int(rng.integers(0, 26)) if k % 5 == 4 else 0
        missing = k % 7 == 6 or 150 <= k < 160
        run.set("sample_age", -1.0 if missing else late * DT)
        Y, t = past[max(k - late, 0)], starts + k * DT
        U = controller.step(None if missing else Y, t=t, sampled_at=t - late * DT)
        np.testing.assert_allclose(run.step(Y), U, rtol=1e-12, atol=1e-15)
        status, places = controller.status, run.places
        assert (run.get("late"), run.get("refused")) == (status.late, status.refused)
        assert run.get("age") == pytest.approx(status.age, abs=1e-9)
        if "offset.U" in places:
            np.testing.assert_allclose(run.get("offset.U"), status.offset, rtol=1e-11)
            np.testing.assert_allclose(run.get("D_hat_spread"), status.D_hat_spread, rtol=1e-9)
            assert run.flag("handed_over") == status.handed_over
        seen |= {status.late > 0, 10 * (status.refused > 0), 20 + status.handed_over}
    assert seen >= {True, 10} and run.messages == []
    assert make is turning or (seen >= {20, 21} and "offset.U" in run.places)


@pytest.mark.parametrize("version", VERSIONS)
def test_what_a_safety_filter_did_is_that_of_python(instance, version):
    run, controller, seen = instance(protecting, version), protecting(), set()
    for k in range(200):
        X = np.array(X0) * (1 + 0.3 * np.sin(0.1 * k))
        np.testing.assert_allclose(run.step(X), controller.step(X), rtol=1e-12, atol=1e-15)
        status = controller.status
        assert (run.flag("filtered"), run.flag("unkept")) == (status.filtered, status.unkept)
        assert run.get("kept") == pytest.approx(status.kept, rel=1e-12)
        seen |= {"filtered" if status.filtered else "free", "unkept" if status.unkept else "kept"}
    assert seen == {"filtered", "free", "unkept", "kept"}


def test_before_the_first_sample_it_says_so(instance):
    run, oldest = instance(turning), UNICYCLE.time_text(turning().memory.oldest * DT)
    run.set("sample_age", -1.0)
    run.step(POSE)
    assert run.get("age") == -1.0 and run.messages == [
        "step at 0 s: expected a sample that can be used, got none so far or since a long pause; give one with a "
        f"sample_age of at most {oldest}; U keeps its value"
    ]
    for k, age in enumerate((np.inf, np.nan)):
        run.set("sample_age", age)
        run.step(POSE)
        assert "expected a finite sample_age" in run.messages[1 + k]
    run.set("sample_age", 0.0)
    run.step(POSE)
    assert run.get("age") == 0.0 and len(run.messages) == 3


def test_of_several_steps_in_one_those_that_are_refused_hold_u(instance):
    run, controller = instance(observing, h=3 * DT), observing()
    run.step(X0)
    U = [controller.step(X0).copy() for _ in range(3)][-1]
    np.testing.assert_allclose(run.step([np.nan, 30.0]), U, rtol=1e-12)
    for _ in range(3):
        with pytest.raises(DivergedError):
            controller.step([np.nan, 30.0])
    assert len(run.messages) == 3
    run.step(X0)
    np.testing.assert_allclose(run.get("U"), [controller.step(X0)[0] for _ in range(3)][-1], rtol=1e-12)


def test_a_state_with_one_bit_turned_is_refused(instance):
    run = instance(turning)
    for _ in range(5):
        run.step(POSE)
    saved = run.state()
    for bit in np.random.default_rng(0).integers(0, 8 * len(saved), 500):
        turned = bytearray(saved)
        turned[bit // 8] ^= 1 << bit % 8
        with pytest.raises(Exception, match="status 3"):
            run.restore(bytes(turned))
    assert run.state() == saved


def test_a_state_that_cannot_be_is_refused_whatever_its_checksum(instance):
    """Steps that do not make its time, a mode that is none, a start or a parameter out of range."""
    run = instance(heun)
    run.step(X0, np.zeros((21, 1)))
    saved = run.state()
    start, steps, mode, gamma = len(saved) - 24, len(saved) - 16, len(saved) - 8, saved.index(struct.pack("<d", 1000.0))

    def changed(at, kind, value):
        """With the checksum, FNV-1a, of all that comes before it."""
        total, forged = 2166136261, bytearray(saved)
        struct.pack_into(kind, forged, at, value)
        for byte in forged[:-4]:
            total = (total ^ byte) * 16777619 % 2**32
        struct.pack_into("<I", forged, len(forged) - 4, total)
        return bytes(forged)

    assert changed(steps, "<q", 1) == saved
    for refused in ((steps, "<q", 9), (steps, "<q", -1), (mode, "<i", 3), (start, "<d", np.nan), (gamma, "<d", -1.0)):
        with pytest.raises(Exception, match="status 3"):
            run.restore(changed(*refused))
    assert run.state() == saved
    run.restore(changed(gamma, "<d", 10.0))
    assert run.get("gamma") == 10.0


@pytest.mark.parametrize(("steps", "h"), [(1, 0.04), (4, 0.01), (8, 0.005), (40, 0.001)])
def test_control_steps_are_at_multiples_of_dt_whatever_the_communication_step(instance, steps, h):
    controller, run = observing(), instance(observing, h=h, start=0.3)
    controller.t = 0.3
    for x in states(20):
        for _ in range(steps):
            U = run.step(x)
        expected = [controller.step(x).copy() for _ in range(4)]
    np.testing.assert_allclose(U, expected[-1], rtol=1e-12)


def test_a_communication_step_of_a_rounding_error_does_no_control_step(instance):
    run, twin = instance(observing), instance(observing)
    for x in states(10):
        run.slave.doStep(run.t, 1e-15)  # with the inputs of the step before
        np.testing.assert_array_equal(run.step(x), twin.step(x))


def test_the_outputs_are_those_of_the_last_control_step(instance):
    controller, run, u = doubting(), instance(doubting), np.full((21, 1), 1e-3)
    fallbacks = set()
    for x in states(20):
        run.step(x, u)
        controller.step(x, u)
        assert run.get("D_hat") == pytest.approx(controller.D_hat, rel=1e-13)
        predicted = [run.get(f"predicted.{name}") for name in PLANT.states]
        np.testing.assert_allclose(predicted, controller.P[-1], rtol=1e-12)
        assert run.get("error") == pytest.approx(controller.status.error, rel=1e-9)
        assert run.flag("fallback") == controller.status.fallback
        fallbacks.add(controller.status.fallback)
    assert fallbacks == {False, True}


@pytest.mark.parametrize("version", VERSIONS)
def test_parameters_are_those_of_another_controller(instance, version):
    name, value = next(iter(PLANT.parameters.items()))
    other = npred.plant("activator_repressor", **{name: 1.1 * value})
    law = npred.DelayAdaptation(300.0, bounds=(0.1, 4.0))
    expected = npred.controller(
        other, Guarded(npred.predictor(other, "euler", 21), 1e-5), law, DT, D_hat=0.7, actuator="measured"
    )
    parameters = {f"parameter.{name}": 1.1 * value, "gamma": 300.0, "tolerance": 1e-5, "D_hat0": 0.7}
    run = instance(doubting, version, **parameters)
    for x in states(50):
        np.testing.assert_allclose(run.step(x, np.zeros((21, 1))), expected.step(x, np.zeros((21, 1))), rtol=1e-12)
    assert run.get("D_hat") == pytest.approx(expected.D_hat, rel=1e-12)


@pytest.mark.parametrize("version", VERSIONS)
def test_it_may_be_told_what_the_actuator_has_had(instance, version):
    """By default the input at rest; before the first step U is that."""
    with_u0 = lambda **u0: npred.controller(PLANT, npred.predictor(PLANT, "heun", 21), SEEKING, DT, D_hat=1.5, **u0)
    for expected, told in ((with_u0(), {}), (with_u0(u0=0.3), {"u0.U": 0.3})):
        run = instance(observing, version, **told)
        assert run.get("U") == pytest.approx(float(expected.u0[0]), abs=1e-15)
        for x in states(50):
            np.testing.assert_allclose(run.step(x), expected.step(x), rtol=1e-12)
        with pytest.raises(Exception, match="status 3"):
            run.set("u0.U", 0.1)  # too late


def test_parameters_may_change_while_it_runs_but_not_to_nonsense(instance):
    run, u = instance(heun), np.zeros((21, 1))
    run.step(X0, u)
    run.set("gamma", 10.0)
    for name, value in (("gamma", 0.0), ("gamma", np.nan), (f"parameter.{next(iter(PLANT.parameters))}", np.inf)):
        before = run.get(name)
        with pytest.raises(Exception, match="status 2"):
            run.set(name, value)
        assert run.get(name) == before
    with pytest.raises(Exception, match="status 3"):
        run.set("D_hat0", 1.0)
    assert run.get("gamma") == 10.0 and len(run.messages) == 4


def test_of_several_parameters_of_which_one_is_refused_none_is_set(instance):
    run = instance(heun)
    with pytest.raises(Exception, match="status 3"):
        run._write([run.places["gamma"], run.places["D_hat0"]], [10.0, -1.0])
    assert run.get("gamma") == 1000.0 and run.get("D_hat0") == 2.0


def test_a_state_of_another_fmu_is_refused(instance):
    run, other = instance(observing), instance(turning)
    other.step(POSE)
    run.step(X0)
    before = run.state()
    for wrong in (other.state(), before[:-1], bytes(len(before)), before[:16] + b"\xff" * (len(before) - 16)):
        with pytest.raises(Exception, match="status 3"):
            run.restore(wrong)
    assert run.state() == before


def test_a_call_out_of_turn_is_refused(instance):
    run = instance(heun)
    run.step(X0, np.zeros((21, 1)))
    for t, h in ((5.0, DT), (DT, -1.0), (DT, np.nan)):
        with pytest.raises(Exception, match="status 3"):
            run.slave.doStep(t, h)
    run.slave.terminate()
    with pytest.raises(Exception, match="status 3"):
        run.slave.doStep(DT, DT)
    run.slave.reset()
    run._initialize(0.0)
    run.t = 0.0
    twin = instance(heun)
    np.testing.assert_array_equal(run.step(X0, np.zeros((21, 1))), twin.step(X0, np.zeros((21, 1))))


@pytest.mark.parametrize("version", VERSIONS)
@pytest.mark.parametrize("make", [*(case[0] for case in CASES.values()), estimating])
def test_fmpy_finds_it_valid(instance, make, version):
    from fmpy.validation import validate_fmu

    assert validate_fmu(str(instance(make, version).path)) == []


@pytest.mark.parametrize("version", VERSIONS)
def test_fmpy_simulates_it_from_its_first_values(tmp_path, version):
    path, _ = exported(heun(), tmp_path, version, X0, t_end=0.5)
    result = fmpy.simulate_fmu(str(path), output=["U", "D_hat"])
    expected, u = heun(), np.full((21, 1), PLANT.u_equilibrium)  # the first values of u: the input at rest
    U = [expected.step(X0, u)[0] for _ in range(50)]
    assert result["U"][0] == PLANT.u_equilibrium  # u0: the command before the first control step
    np.testing.assert_allclose(result["U"][1:51], U, rtol=1e-12)
    assert result["D_hat"][0] == 2.0 and result["D_hat"][50] == pytest.approx(expected.D_hat, rel=1e-12)


@pytest.mark.parametrize("version", VERSIONS)
def test_the_same_controller_is_the_same_file(tmp_path, version):
    texts = []
    for folder in (tmp_path / "a", tmp_path / "b"):
        folder.mkdir()
        texts.append(exported(heun(), folder, version)[0].read_bytes())
    assert texts[0] == texts[1]


@pytest.mark.parametrize("version", VERSIONS)
@pytest.mark.parametrize("make", [network, estimating])
def test_the_sources_build_strictly_and_against_the_standard_s_prototypes(instance, tmp_path, version, make):
    run = instance(make, version)
    with zipfile.ZipFile(run.path) as opened:
        opened.extractall(tmp_path)
    folder, headers = tmp_path / "sources", Path(fmpy.__file__).parent / "c-code"
    flags = ["-std=c99", "-O2", "-Wall", "-Wextra", "-Wshadow", "-Werror"]
    standard = [f"-I{headers}", f"-DFMI{version}_FUNCTION_PREFIX=", "-include", f"fmi{version}Functions.h"]
    for more in (["-Wpedantic"], standard):
        subprocess.run(["cc", *flags, *more, "-c", f"fmi{version}.c"], cwd=folder, check=True, timeout=120)
    command = ["nm", "-D", tmp_path / run.written.facts["libraries"][0]]
    listed = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    defined = [line.split()[-1] for line in listed.splitlines() if " T " in line]
    assert defined and all(name.startswith(f"fmi{version}") for name in defined)


def test_its_build_description_names_its_sources(instance):
    with zipfile.ZipFile(instance(heun).path) as opened:
        root = ET.fromstring(opened.read("sources/buildDescription.xml"))
        names = {element.get("name") for element in root.iter("SourceFile")}
        assert names == {"npred.c", "fmi3.c"} <= {name.removeprefix("sources/") for name in opened.namelist()}


@pytest.mark.parametrize("version", VERSIONS)
def test_without_a_compiler_it_holds_its_sources_which_an_importer_builds(tmp_path, monkeypatch, version):
    from fmpy.build import build_platform_binary

    monkeypatch.setattr(c_files, "compiler", lambda: None)
    path, written = exported(heun(actuator="history"), tmp_path, version)
    assert written.facts["libraries"] == []
    assert not [name for name in zipfile.ZipFile(path).namelist() if name.startswith("binaries")]
    if shutil.which("cmake"):
        fmpy.extract(str(path), str(tmp_path / "extracted"))
        build_platform_binary(tmp_path / "extracted")
        run, controller = InFmu(path, tmp_path / "extracted", written, DT), heun(actuator="history")
        for x in states(20):
            np.testing.assert_allclose(run.step(x), controller.step(x), rtol=1e-12)


def test_in_float_it_is_so_to_float_s_rounding(tmp_path):
    path, written = exported(observing(), tmp_path, precision="float")
    run, controller = InFmu(path, tmp_path / "extracted", written, DT), observing()
    for x in states(50):
        np.testing.assert_allclose(run.step(x), controller.step(x), rtol=1e-4)


def test_sources_that_do_not_compile_are_an_error_in_one_line(tmp_path, monkeypatch):
    monkeypatch.setattr(c_files, "FLAGS", (*c_files.FLAGS, "-include", "missing.h"))
    with pytest.raises(NpredError, match=r"^export fmu: expected sources that compile, got: .*missing.h.*; report it$"):
        exported(heun(), tmp_path)
    assert list(tmp_path.iterdir()) == []


class Odd:
    """A plant whose names and units have all that XML and C have to escape."""

    states, inputs = ("größe", "int"), ("void",)
    parameters = {"static": 1.0}
    units = {"größe": "m³ & <s> \"'", "void": "*/ #define ??/"}
    f = lambda x, u, t, p, M: [x[1], u.void - p.static * x[0]]
    kappa = lambda x, t, p, M: [-x[1]]
    V = lambda x, t, p, M: x[0] ** 2 + x[1] ** 2


@pytest.mark.parametrize("version", VERSIONS)
def test_names_of_any_letters_are_valid_xml_and_c(tmp_path, version):
    from fmpy.validation import validate_fmu

    plant = npred.plants.Plant("a - b", Odd)
    path, written = exported(heun(plant, actuator="history"), tmp_path, version)
    assert validate_fmu(str(path)) == [] and written.facts["libraries"]
    described = fmpy.read_model_description(str(path))
    names = {variable.name: variable.unit for variable in described.modelVariables}
    assert names["größe"] == Odd.units["größe"] and names["void"] == Odd.units["void"]


def test_two_variables_of_one_name_are_refused():
    class Twice(Odd):
        states, inputs, units = ("D_hat", "y"), ("void",), {}

    controller = heun(npred.plants.Plant("twice", Twice))
    with pytest.raises(ConfigError, match="expected different names of variables, got 'D_hat' twice"):
        npred.export(controller, "fmu", "never.fmu")


def test_another_version_is_refused():
    with pytest.raises(ConfigError, match=r"^fmi: expected 3 or 2, got 1; give one"):
        npred.export(heun(), "fmu", "never.fmu", fmi=1)


def test_what_a_network_was_trained_for_is_no_parameter(instance):
    """f reads all but the set-point, which kappa leads to."""
    names = [variable.name for variable in instance(network).written.variables]
    free = [name for name in names if name.startswith("parameter.")]
    assert "tolerance" in names and free == ["parameter.x1_set", "parameter.x2_set"]


def test_the_page_s_example_runs(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    flags = ["--predictor", "heun", "--actuator", "history", "--nx", "41", "-o", "controller.fmu"]
    done = CliRunner().invoke(app, ["export", "fmu", "paper", *flags])
    assert done.exit_code == 0, done.output
    page = (HERE.parent / "docs" / "deployment.md").read_text()
    (block,) = [text.split("```")[0] for text in page.split("```python\n")[1:] if "FMU3Slave" in text.split("```")[0]]
    space = {}
    exec(compile(block, "a block of deployment.md", "exec"), space)
    np.testing.assert_allclose(space["X"], PLANT.equilibrium, rtol=0.02)
