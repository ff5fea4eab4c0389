"""The controller in C: the same closed loops as npred.controller, its state, its refusals."""

import ctypes
import re
import struct
import subprocess

import numpy as np
import pytest
from c_controllers import FLAGS, InC, closed_loop, differ, library, needs_gcc
from conftest import HERE
from operator_samples import SMALL, operator
from varying_delays import with_delay

import npred
from npred.base.errors import ConfigError, DivergedError
from npred.exports import c_controller, c_files
from npred.loop.clock import STAMPS
from npred.networks.fused import Fused

pytestmark = needs_gcc
PLANT, UNICYCLE = npred.plant("activator_repressor"), npred.plant("unicycle")
IN_SPACE = with_delay(lambda x, t, p, M: 0.3 * (x.x**2 + x.y**2) + 0.3)
PAPER = npred.DelayAdaptation(1000.0, bounds=(0.1, 4.0))
X0, POSE = [0.03, 30.0], [0.3, -0.2, 0.2]


def network(kind, precision=np.float64, nx=51):
    return Fused(PLANT, operator(SMALL[kind]).double(), nx, precision=precision)


def controllers():
    """Each with the true delay and the start of its loop."""
    heun, euler = npred.predictor(PLANT, "heun", 51), npred.predictor(PLANT, "euler", 51)
    turns, slow = npred.predictor(UNICYCLE, "rk4", 41), npred.predictor(IN_SPACE, "heun", 41)
    observer = npred.DelayObserver(bounds=(0.2, 2.0), candidates=20)
    measured = {"deeponet": network(0), "fno": network(1), "heun": heun, "rk4": npred.predictor(PLANT, "rk4", 51)}
    measured |= {"deeponet, guard": npred.guarded(network(0), 0.01), "euler, guard": npred.guarded(euler, 0.01)}
    measured |= {"picard": npred.predictor(PLANT, "picard", 21)}
    cases = {
        name: (npred.controller(PLANT, predictor, PAPER, 0.01, D_hat=2.0, actuator="measured"), 1.0, X0)
        for name, predictor in measured.items()
    }
    for name in ("deeponet", "fno", "deeponet, guard"):  # no data, no training: their loops converge where D is short
        law = npred.DelayAdaptation(1000.0, bounds=(0.05, 0.2))
        cases[name] = (npred.controller(PLANT, measured[name], law, 0.01, D_hat=0.2, actuator="measured"), 0.1, X0)
    cases["observer"] = (npred.controller(PLANT, heun, observer, 0.01, D_hat=1.5, actuator="history"), 1.0, X0)
    cases["observer, measured"] = (
        npred.controller(PLANT, heun, observer, 0.01, D_hat=1.5, actuator="measured"),
        1.0,
        X0,
    )
    cases["l1, history"] = (
        npred.controller(PLANT, heun, npred.L1Adaptation(0.01, bounds=(0.1, 2.0)), 0.01, D_hat=1.2, actuator="history"),
        1.0, X0,
    )  # fmt: skip
    cases["bounded"] = (
        npred.controller(PLANT, heun, PAPER, 0.01, D_hat=2.0, input_bounds=[(-0.001, 0.002)], actuator="measured"),
        1.0,
        X0,
    )
    cases["two delays"] = (npred.controller(UNICYCLE, turns, None, 0.01, D_hat=0.6, actuator="history"), 0.6, POSE)
    at_once = npred.plants.resolve("unicycle", delays=(0.0, 0.6))
    soon = npred.predictor(at_once, "rk4", 41)
    cases["one input at once"] = (npred.controller(at_once, soon, None, 0.01, D_hat=0.6, actuator="history"), 0.6, POSE)
    cases["two delays, guard"] = (
        npred.controller(UNICYCLE, npred.guarded(turns, 1e-3), None, 0.01, D_hat=0.6, actuator="history"), 0.6, POSE,
    )  # fmt: skip
    cases["declared"] = (npred.controller(IN_SPACE, slow, None, 0.01, actuator="history"), IN_SPACE.delay, POSE)
    cases["declared, guard"] = (
        npred.controller(IN_SPACE, npred.guarded(slow, 1e-3), None, 0.01, actuator="history"), IN_SPACE.delay, POSE,
    )  # fmt: skip
    return cases


NAMES = [
    "deeponet", "fno", "heun", "rk4", "deeponet, guard", "euler, guard", "picard", "observer", "observer, measured",
    "l1, history", "bounded", "two delays", "two delays, guard", "one input at once", "declared", "declared, guard",
]  # fmt: skip
LONG = ["deeponet, guard", "fno", "rk4", "observer", "two delays, guard", "declared", "declared, guard"]


@pytest.fixture(scope="module")
def cases():
    return controllers()


def both(case, folder, steps, precision="double"):
    """States and commands of the loop in Python, and of that in C."""
    controller, D, start = case
    compiled = library(controller, folder, precision)
    measured, nx = controller.actuator == "measured", controller.predictor.nx
    runs = [controller.fresh(), InC(compiled, controller.plant, precision)]
    return [closed_loop(run, controller.plant, D, controller.dt, steps, start, measured, nx) for run in runs]


@pytest.mark.parametrize("name", NAMES)
def test_a_closed_loop_is_that_of_the_controller(cases, tmp_path, name):
    (X, U), (X_c, U_c) = both(cases[name], tmp_path, 600)
    assert np.isfinite(U).all()
    assert differ(X, X_c) < 1e-12 and differ(U, U_c) < 1e-12


@pytest.mark.campaign
@pytest.mark.parametrize("name", LONG)
def test_so_is_a_long_one(cases, tmp_path, name):
    (X, U), (X_c, U_c) = both(cases[name], tmp_path, 100_000)
    assert differ(X, X_c) < 1e-12 and differ(U, U_c) < 1e-12


@pytest.mark.parametrize("name", ["rk4", "observer", "two delays, guard", "one input at once", "declared"])
def test_in_float_it_is_so_to_float_s_rounding(cases, tmp_path, name):
    (X, U), (X_c, U_c) = both(cases[name], tmp_path, 400, "float")
    assert differ(X, X_c) < 1e-3 and differ(U, U_c) < 1e-2


@pytest.mark.parametrize("t", [0.7, 1e6 + 0.7])
def test_in_float_a_law_that_repeats_knows_its_phase_after_a_million_seconds(cases, tmp_path, t):
    """A float of a million has steps of 1/16."""
    case = cases["two delays"][0]
    controller, run = case.fresh(), InC(library(case, tmp_path, "float"), UNICYCLE, "float")
    controller.t = t
    assert run.library.npred_set_time(run.memory, ctypes.c_double(t)) == 0
    np.testing.assert_allclose(run.step(POSE), controller.step(POSE), rtol=1e-3)


def test_goes_on_from_a_saved_state_to_the_bit(cases, tmp_path):
    controller = cases["observer"][0]
    compiled = library(controller, tmp_path)
    one, other = InC(compiled, PLANT), InC(compiled, PLANT)
    X = np.array(X0) * (1 + 0.1 * np.random.default_rng(0).standard_normal((900, 2)))
    for x in X[:600]:  # past the end of the ring buffers
        one.step(x)
    saved = one.state()
    assert other.restore(saved) == 0
    for x in X[600:]:
        np.testing.assert_array_equal(one.step(x), other.step(x))
    assert bytes(one.state()) == bytes(other.state()) != bytes(saved)


def test_two_side_by_side_are_independent(cases, tmp_path):
    controller = cases["deeponet, guard"][0]
    compiled = library(controller, tmp_path)
    pair, alone = [InC(compiled, PLANT) for _ in range(2)], [InC(compiled, PLANT) for _ in range(2)]
    u, X = np.zeros((51, 1)), [np.array(X0), np.array([0.05, 20.0])]
    mixed = [[run.step(x, u) for run, x in zip(pair, X, strict=True)] for _ in range(50)]
    apart = [[run.step(x, u) for _ in range(50)] for run, x in zip(alone, X, strict=True)]
    np.testing.assert_array_equal(np.swapaxes(mixed, 0, 1), apart)


@pytest.mark.parametrize(("name", "bad"), [("rk4", np.nan), ("rk4", np.inf), ("observer", np.nan)])
def test_a_bad_measurement_is_refused_as_in_python(cases, tmp_path, name, bad):
    controller, measured = cases[name][0].fresh(), name == "rk4"
    run, u = InC(library(controller, tmp_path), PLANT), [np.zeros((51, 1))] if measured else []
    for X, given in ((X0, u), ([bad, 30.0], u), (X0, [np.full((51, 1), bad)] if measured else u), (X0, u)):
        alike(run, controller, X, given)


@pytest.mark.parametrize("reading", [0, 1])
def test_a_node_that_is_not_finite_is_refused_in_the_means_and_in_the_values(cases, tmp_path, reading):
    case, readings = cases["rk4"][0], [np.zeros((51, 1)), np.zeros((51, 1))]
    readings[reading][20] = np.nan
    assert InC(library(case, tmp_path), PLANT).code(X0, *readings) == 1
    with pytest.raises(DivergedError, match="expected finite X and u"):
        case.fresh().step(X0, *readings)


def alike(run, controller, X, u=()):
    """A step in C and in Python: the same U, or both refused; the code of the first."""
    U = np.full(controller.plant.m, np.nan)
    code = run.code(X, *u, out=U)
    try:
        np.testing.assert_allclose(U, controller.step(X, *u), rtol=1e-9, atol=1e-12)
        assert code == 0
    except DivergedError:
        assert code > 0 and np.isnan(U).all()
    return code


class Faulty:
    """A controller whose samples are wrong now and then, and whose actuator now and then does something else."""

    def __init__(self, run, plant, size):
        self.run, self.k, self.U, self.codes = run, -1, np.zeros(plant.m), []
        low, high = np.array([plant.box[name] for name in plant.states]).T
        self.width = size * (high - low)

    def step(self, X):
        self.k += 1
        wrong = {30: X + 3 * self.width, 31: X - 5 * self.width, 60: X * np.nan, 90: X + 1e200 * self.width}
        sent, code = self.sent(wrong.get(self.k, X))
        self.codes.append(code)
        if code == 0:
            self.U = sent
        if self.k == 120:
            self.U = self.U + 0.1
            self.applied(self.U)
        return self.U

    def sent(self, X):
        U = np.zeros(len(self.U))
        return U, self.run.code(X, out=U)

    def applied(self, U):
        assert self.run.library.npred_applied(self.run.memory, U.ctypes.data_as(ctypes.c_void_p)) == 0


class FaultyInPython(Faulty):
    def sent(self, X):
        try:
            return self.run.step(X).copy(), 0
        except DivergedError as refusal:
            return None, 2 if "the prediction from X" in str(refusal) else 4 if "raise history_length" in str(
                refusal
            ) else 1

    def applied(self, U):
        self.run._engine.replace(U)


@pytest.mark.parametrize("gate", [None, 1.0])
@pytest.mark.parametrize("name", ["two delays", "declared", "observer"])
def test_wrong_samples_are_refused_and_predicted_over_as_in_python(cases, tmp_path, name, gate):
    """Far off, not finite, too large for a prediction; and once the actuator got another command.

    Believed samples are less far off: from 6 half widths one prediction makes 300 of a rounding error of 1e-15.
    """
    case, D, start = cases[name]
    plant, named = case.plant, {"actuator": "history", "outlier_limit": gate}
    named |= {} if plant.declares_delay else {"D_hat": case.D_hat}
    controller = npred.controller(plant, case.predictor, case.adaptation, 0.01, **named)
    size = 1.0 if gate else 0.1
    runs = Faulty(InC(library(controller, tmp_path), plant), plant, size), FaultyInPython(controller, plant, size)
    (X_c, U_c), (X, U) = (closed_loop(run, plant, D, 0.01, 300, start, False) for run in runs)
    assert runs[0].codes == runs[1].codes and runs[0].codes[60] == 1
    assert runs[0].codes[90] in ((0,) if gate else (2, 4))
    assert differ(X, X_c) < 1e-11 and differ(U, U_c) < 1e-11


@pytest.mark.parametrize("gate", [None, 1.0])
def test_samples_of_noise_alone_leave_no_history_that_each_step_is_refused_for(tmp_path, gate):
    """Of 20 000 standard normal samples, doubled, the C file of this plant once took 33."""
    plant = npred.plant("unicycle_time_delay")
    controller = npred.controller(
        plant, npred.predictor(plant, "heun", 21), None, 0.01, actuator="history", outlier_limit=gate
    )
    run = InC(library(controller, tmp_path), plant)
    samples = 2 * np.random.default_rng(0).standard_normal((5000, 3))
    assert [run.code(X) for X in samples] == [0] * 5000


@pytest.mark.parametrize(("name", "D_hat", "wrong"), [("heun", 1.25, 5.0), ("two delays", 0.5, 2.0)])
def test_estimate_and_time_can_be_set_as_in_python(cases, tmp_path, name, D_hat, wrong):
    """A law's first step from then on is Euler's, a clocked law knows the time, and no sample is expected."""
    case, _, start = cases[name]
    controller, run = case.fresh(), InC(library(case, tmp_path), case.plant)
    u = [1e-3 * np.ones((51, 1))] if case.actuator == "measured" else []
    set_D_hat = lambda value: run.library.npred_set_D_hat(run.memory, ctypes.c_double(value))
    set_time = lambda value: run.library.npred_set_time(run.memory, ctypes.c_double(value))

    def steps(X, count=3):
        assert [alike(run, controller, X, u) for _ in range(count)] == [0] * count
        assert struct.unpack_from("<d", bytes(run.state()), 40) == pytest.approx((controller.D_hat,), rel=1e-13)

    steps(np.array(start))
    controller.D_hat = D_hat
    assert set_D_hat(D_hat) == 0
    steps(1.1 * np.array(start))
    controller.t = 7.3
    assert set_time(7.3) == 0
    if u:
        steps(1.2 * np.array(start))
    else:
        steps(np.array(start) + 2.0, 1)  # too far, had something been expected
        assert controller.status.missed == 0
    before = bytes(run.state())
    assert (set_D_hat(wrong), set_D_hat(np.nan), set_time(np.inf), set_time(np.nan)) == (3, 3, 3, 3)
    assert u or run.library.npred_applied(run.memory, (ctypes.c_double * 2)(0.1, np.nan)) == 3
    assert bytes(run.state()) == before


def test_a_prediction_that_diverges_is_refused_as_in_python(tmp_path):
    class Cube:
        states, inputs = ("x",), ("u",)
        f = lambda x, u, t, p, M: [x.x**3 + u.u]
        kappa = lambda x, t, p, M: [-(x.x**3) - x.x]
        V = lambda x, t, p, M: x.x**2

    plant = npred.plants.Plant("cube", Cube)
    controller = npred.controller(
        plant,
        npred.predictor(plant, "rk4", 51),
        npred.DelayAdaptation(1.0, bounds=(0.1, 2.0)),
        0.01,
        actuator="measured",
    )
    run = InC(library(controller, tmp_path), plant)
    u = [np.zeros((51, 1))]
    assert [alike(run, controller, [X], u) for X in (0.1, 3.0, 0.1)] == [0, 2, 0]


def test_a_state_of_another_controller_is_refused(cases, tmp_path):
    folders = [tmp_path / name for name in "ab"]
    runs = []
    for folder, name in zip(folders, ("rk4", "heun"), strict=True):
        folder.mkdir()
        runs.append(InC(library(cases[name][0], folder), PLANT))
    before = bytes(runs[1].state())
    assert runs[1].restore(runs[0].state()) == 3
    assert bytes(runs[1].state()) == before


@pytest.mark.parametrize("precision", ["double", "float"])
def test_a_state_with_one_bit_turned_is_refused(cases, tmp_path, precision):
    run = InC(library(cases["observer"][0], tmp_path, precision), PLANT, precision)
    for _ in range(5):
        run.step(X0)
    saved = bytes(run.state())
    for bit in np.random.default_rng(0).integers(0, 8 * len(saved), 20_000):
        turned = bytearray(saved)
        turned[bit // 8] ^= 1 << bit % 8
        assert run.restore(bytes(turned)) == 3
    assert bytes(run.state()) == saved and run.restore(saved) == 0


def sealed(saved):
    """The bytes of a state with the checksum, FNV-1a, of all that comes after it."""
    total = 2166136261
    for byte in saved[20:]:
        total = (total ^ byte) * 16777619 % 2**32
    return saved[:16] + struct.pack("<I", total) + saved[20:]


def test_a_state_that_cannot_be_is_refused_whatever_its_checksum(cases, tmp_path):
    """Indices beyond the ring buffers, times, estimates and commands that are none."""
    controller = cases["observer"][0]
    run = InC(library(controller, tmp_path), PLANT)
    run.step(X0)
    saved, rows = bytes(run.state()), len(controller.memory.signals.held)
    places = {"steps": (24, "<q"), "t0": (32, "<d"), "D_hat": (40, "<d"), "phi": (48, "<d")}
    places |= {"held": (56 + 8 * (rows - 1), "<d"), "total": (56 + 8 * rows, "<d")}
    places |= {"at": (56 + 16 * rows, "<d"), "lag": (56 + 16 * rows + 8 * STAMPS.index("lag"), "<d")}

    def changed(name, value):
        at, kind = places[name]
        return sealed(saved[:at] + struct.pack(kind, value) + saved[at + struct.calcsize(kind) :])

    assert sealed(saved) == saved and struct.unpack_from("<d", saved, places["at"][0]) == (rows - 1,)
    allowed = {"at": (rows - 2, 2 * rows - 1), "steps": (0,), "D_hat": (0.2, 2.0), "phi": (np.nan, 0.0), "held": (0.0,)}
    wrong = {
        "at": (-1, rows - 3, 2 * rows, np.nan),
        "lag": (np.nan,),
        "steps": (-1,),
        "t0": (np.inf, np.nan),
        "D_hat": (np.nan, 0.19, 2.5),
    }
    wrong |= {"phi": (np.inf,), "held": (np.nan, np.inf), "total": (np.nan,)}
    for code, values in ((0, allowed), (3, wrong)):
        answers = {(name, value): run.restore(changed(name, value)) for name in values for value in values[name]}
        assert set(answers.values()) == {code}, answers


WILD = """
#include "npred.c"
#include <stdio.h>
int main(void)
{
    static npred_controller c;
    const double sizes[] = {1, NAN, 1e300, -1e300, INFINITY, 1.7e308, -1e3, 1};
    npred_init(&c);
    for (int i = 0; i < 8; i++) {
        double X[NPRED_N_STATES], U[NPRED_M_INPUTS];
        for (int k = 0; k < NPRED_N_STATES; k++) {
            X[k] = 0.1 * sizes[i];
        }
        MEASURED
        printf("%d", npred_step(&c, X, PASSED U));
    }
    return 0;
}
"""
MEASURED_WILD = """double u[NPRED_NX * NPRED_M_INPUTS];
        for (int k = 0; k < NPRED_NX * NPRED_M_INPUTS; k++) {
            u[k] = k % 3 == 1 ? -sizes[i] : sizes[i];
        }"""


@pytest.mark.parametrize("name", ["deeponet", "fno", "deeponet, guard", "observer", "declared, guard", "two delays"])
def test_wild_samples_are_no_undefined_behaviour(cases, tmp_path, name):
    """An index from NaN, say: the sanitizer ends the program at the first."""
    controller = cases[name][0]
    library(controller, tmp_path)
    measured = (MEASURED_WILD, "u,") if controller.actuator == "measured" else ("", "")
    (tmp_path / "wild.c").write_text(WILD.replace("MEASURED", measured[0]).replace("PASSED", measured[1]))
    flags = ["-fsanitize=undefined,float-cast-overflow", "-fno-sanitize-recover=all"]
    command = ["gcc", *FLAGS, *flags, "wild.c", "-o", "wild", "-lm"]
    built = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=300)
    if built.returncode and "ubsan" in built.stderr:
        pytest.skip("this compiler has no sanitizer")
    done = subprocess.run([tmp_path / "wild"], capture_output=True, text=True, timeout=60)
    assert (built.stderr, done.stderr, done.returncode) == ("", "", 0)
    assert done.stdout[0] == "0" and set(done.stdout) <= set("0124") and "1" in done.stdout


def test_allocates_nothing_and_says_what_it_is_of(cases):
    header, source = c_controller.sources(cases["observer"][0], model="paper:heun")
    source = source.partition("#ifdef NPRED_TEST")[0]
    assert "malloc" not in source and set(re.findall(r"#include <(.*)>", source)) == {
        "math.h",
        "stddef.h",
        "stdint.h",
        "string.h",
    }
    assert "Model: paper:heun." in header and len(c_controller.digest(header)) == 64
    assert not re.findall(r"^static (?!const|inline)[^()]*(?:;|=)", source, re.MULTILINE)  # no variable that changes


@pytest.mark.parametrize("name", ["deeponet, guard", "two delays, guard", "observer", "declared"])
def test_the_skeletons_are_c_before_an_export_fills_them_in(cases, tmp_path, monkeypatch, name):
    files, fill = {}, c_files.filled

    def filled(file, prefix, real, variants, included):
        files.update(variants=variants, included=included)
        return fill(file, prefix, real, variants, included)

    monkeypatch.setattr(c_files, "filled", filled)
    c_controller.sources(cases[name][0])
    for part, text in files["included"].items():
        (tmp_path / f"{part}.h").write_text(f"{text}\n")
    (tmp_path / "npred.h").write_text((c_files.FOLDER / "controller.h").read_text())
    defined = [f"-D{variant}={int(holds)}" for variant, holds in files["variants"].items()]
    command = ["gcc", *FLAGS, "-Dnpred_real=double", *defined, f"-I{tmp_path}", "-fsyntax-only"]
    subprocess.run([*command, c_files.FOLDER / "controller.c"], check=True, timeout=120)


@pytest.mark.parametrize("name", ["", "Npred", "1a", "a b", "a;", "ä", "a" * 32])
def test_a_name_that_is_no_identifier_is_refused(cases, name):
    with pytest.raises(ConfigError, match=r"^name: expected a short C identifier"):
        c_controller.sources(cases["rk4"][0], name)


def test_what_runs_in_python_is_refused():
    class Slow(npred.prediction.methods.Euler):
        compiled = False

    with pytest.raises(ConfigError, match="expected a predictor that is compiled, got euler"):
        c_controller.sources(npred.controller(PLANT, Slow(PLANT, 21), PAPER, 0.01, D_hat=1.0, actuator="measured"))


def test_the_example_of_the_documentation_compiles(tmp_path):
    page = (HERE.parent / "docs" / "deployment.md").read_text()
    examples = re.findall(r"^```C\n(.*?)^```", page, re.MULTILINE | re.DOTALL)
    (example,) = (text for text in examples if "every_5_ms" in text)
    heun = npred.predictor(PLANT, "heun", 21)
    files = c_controller.sources(npred.controller(PLANT, heun, PAPER, 0.005, D_hat=2.0, actuator="measured"))
    for name, text in zip(("npred.h", "npred.c", "main.c"), (*files, example), strict=True):
        (tmp_path / name).write_text(text)
    start = "int main(void) { double X[2] = {0.03, 30}, u[21] = {0}, U[1] = {9};\n"
    (tmp_path / "run.c").write_text(
        '#include <stdio.h>\n#include "main.c"\n' + start + 'start(); every_5_ms(X, u, U); printf("%.17g", U[0]); }\n'
    )
    command = ["gcc", *FLAGS, "-Wno-missing-prototypes", "run.c", "npred.c", "-o", "run", "-lm"]
    subprocess.run(command, cwd=tmp_path, check=True, timeout=120)
    done = subprocess.run([tmp_path / "run"], capture_output=True, text=True, check=True, timeout=60)
    U = npred.controller(PLANT, heun, PAPER, 0.005, D_hat=2.0, actuator="measured").step(X0, np.zeros((21, 1)))
    assert float(done.stdout) == pytest.approx(U[0], rel=1e-12)
