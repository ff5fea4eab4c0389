"""Formulas and loops in C: every operation is that of the interpreter, lane for lane, edges are those of IEEE 754."""

import ctypes
import ctypes.util
import math
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from c_controllers import LANE_BY_LANE, find_nothing, needs_gcc
from conftest import HERE
from hypothesis import given
from hypothesis import strategies as st

import npred
from npred.formulas import called_functions
from npred.formulas.tape import OPS, M, Tape
from npred.kernels import compiler, formula
from npred.kernels.c_text import single
from npred.kernels.formula import function, vector
from npred.kernels.kernel import FOLDER, Failure, Shape, address, callback, made, skeleton
from npred.loop import signals
from npred.loop.engine import LOOP, ON_A_CLOCK

REALS = st.floats(0.1, 5) | st.floats(-5, -0.1) | st.just(0.0)
CONDITIONS = ("lt", "le", "logical_and", "logical_or", "logical_not")
NUMBERS = [op for op in OPS if op not in (*CONDITIONS, "interp")]


def compiled(outputs, count):
    """What takes `count` floats to the values of outputs of x0, x1, …"""
    text = function("{name}", outputs, [vector("x", count)], {"y": len(outputs)}, 1)
    kernel = made("formula", "X, t, &U", LANE_BY_LANE, {"F": text})

    def call(*values):
        U = np.empty((len(outputs), 3))
        kernel(np.tile(np.array(values, dtype=float)[:, None], 3), 0.0, U)
        assert ((U[:, :1] == U) | np.isnan(U)).all()  # all lanes alike
        return U[:, 0].tolist()

    return call


def arity(op):
    """The number of its arguments."""
    return OPS[op].text.count("{")


def every_operation():
    a, b = (tape := Tape()).inputs("x", 2)
    arguments = {1: (a,), 2: (a, b), 3: (tape.node("lt", (a, b)), a, b)}
    return [tape.node(op, arguments[arity(op)]) for op in NUMBERS]


all_at_once = compiled(every_operation(), 2)


def expected(op, a, b):
    arguments = {1: (a,), 2: (a, b), 3: (a < b, a, b)}[arity(op)]
    try:
        found = OPS[op].value(*arguments)
    except ZeroDivisionError:
        return None  # by the sign of zero, an infinity or NaN
    except ValueError:
        return math.nan
    return math.nan if isinstance(found, complex) else found


@given(REALS, REALS)
def test_every_operation_is_that_of_the_interpreter(a, b):
    for op, found in zip(NUMBERS, all_at_once(a, b), strict=True):
        value = expected(op, a, b)
        if value is not None and (op, a) != ("log", 0.0):
            np.testing.assert_allclose(found, value, rtol=9e-16, err_msg=f"{op} of {a}, {b}")


def test_edges_are_those_of_floating_point():
    found = dict(zip(NUMBERS, all_at_once(0.0, 0.0), strict=True))
    assert math.isnan(found["div"]) and found["log"] == -math.inf and found["pow"] == 1.0
    found = dict(zip(NUMBERS, all_at_once(math.nan, 1.0), strict=True))
    assert math.isnan(found["add"]) and math.isnan(found["sin"]) and math.isnan(found["abs"])


@pytest.mark.parametrize(("a", "b", "less", "at_most"), [(1, 2, 1, 1), (2, 2, 0, 1), (3, 2, 0, 0)])
def test_conditions_choose(a, b, less, at_most):
    x, y = (tape := Tape()).inputs("x", 2)
    chosen = [M.where(tape.node(op, (x, y)), 1.0, 0.0) for op in ("lt", "le")]
    assert compiled([*chosen, 7.5, math.inf, -math.inf], 2)(a, b) == [less, at_most, 7.5, math.inf, -math.inf]


@given(st.lists(st.floats(-2, 2), min_size=3, max_size=3))
def test_a_trace_is_the_function(values):
    np.testing.assert_allclose(traced(*values), swings(*values, np), rtol=1e-14, atol=1e-14)


def swings(x, y, z, M):
    swing = M.sin(x) * y + 2.0 * M.cos(z) ** 2
    return [swing, M.where(x <= y, swing / (1.0 + z * z), -abs(z)), M.maximum(x, M.tanh(y)), 0.25]


traced = compiled(swings(*Tape().inputs("x", 3), M), 3)


def test_in_single_precision_types_numbers_and_functions_change_and_nothing_else():
    text = "double x2 = sqrt(0.5) * 1e-300 + larger(y[2], 3.0); int k = 2; /* double */ const double z = pow(x2, 1.5);"
    assert single(text) == (
        "float x2 = sqrtf(0.5f) * 1.1754944e-38f + larger(y[2], 3.0f); int k = 2; /* float */ "
        "const float z = powf(x2, 1.5f);"
    )


def test_in_single_precision_no_function_of_the_library_stays_double():
    """One that did would compute in double, and clang says so."""
    texts = [*(path.read_text() for path in FOLDER.glob("*.h")), *formula.TEXTS.values()]
    code = re.sub(r"/\*.*?\*/", "", "\n".join(texts), flags=re.DOTALL)
    library = ctypes.CDLL(ctypes.util.find_library("m"))
    called = set(re.findall(r"\b\w+(?=\()", code)) - {"isnan", "isinf"}  # macros of either type
    doubles = {name for name in called if hasattr(library, f"{name}f")}
    assert {"sin", "ceil"} <= doubles
    assert {name: single(f"{name}(x)") for name in doubles} == {name: f"{name}f(x)" for name in doubles}


TURNS = """
void entry(int count, const double *x, double *y)
{
    for (int k = 0; k < count; k++) {
        y[k] = sine(x[k]);
        y[count + k] = cosine(x[k]);
    }
}
"""


def turns(x, text=lambda text: text):
    """sine and cosine of x (count,), as rows, in the precision of x."""
    entry = compiler.library(text(skeleton("base.h") + TURNS)).entry
    y = np.empty((2, len(x)), dtype=x.dtype)
    entry(len(x), *(ctypes.c_void_p(a.ctypes.data) for a in (x, y)))
    return y


@pytest.mark.parametrize("size", [1e-300, 1e-3, 1.0, 10.0, 1e3, 5e5])
def test_sine_and_cosine_are_right_to_two_units_in_the_last_place(size):
    x = np.random.default_rng(0).uniform(-size, size, 10_000)
    for found, name in zip(turns(x), ("sin", "cos"), strict=True):
        exact = np.array([getattr(math, name)(value) for value in x])
        assert (np.abs(found - exact) <= 2 * np.spacing(np.abs(exact))).all()


def test_sine_and_cosine_of_large_numbers_stay_bounded_and_of_infinite_ones_are_nan():
    x = np.array([1e16, -1e100, 1.7e308, math.inf, -math.inf, math.nan])
    found = turns(x)
    assert (np.abs(found[:, :3]) <= 1).all() and np.isnan(found[:, 3:]).all()


def test_sine_and_cosine_in_single_precision():
    x = np.random.default_rng(0).uniform(-50, 50, 10_000).astype(np.float32)
    wide = x.astype(float)
    np.testing.assert_allclose(turns(x, single), [np.sin(wide), np.cos(wide)], rtol=0, atol=4e-6)  # the last place of x


SHIPPED = ["van_der_pol", "cart_pole", "unicycle", "pvtol", "chemostat", "planar_arm7", "xarm6"]


@pytest.mark.parametrize("lanes", [1, 7, 8, 9, 70])
def test_lanes_side_by_side_are_those_one_by_one(lanes):
    plant, rng = npred.plant("planar_arm6"), np.random.default_rng(0)
    assert called_functions.called(plant)
    predictor = npred.predictor(plant, "rk4", nx=11)
    X, u = rng.uniform(-0.5, 0.5, (lanes, plant.n)), rng.uniform(-1, 1, (lanes, 11, plant.m))
    D_hat = rng.uniform(0.05, 0.2, lanes)
    one_by_one = np.stack([predictor(X[k], u[k], float(D_hat[k])) for k in range(lanes)])
    np.testing.assert_allclose(predictor(X, u, D_hat), one_by_one, rtol=1e-10, atol=1e-12)


def test_a_variable_that_outlives_a_call_is_an_array_and_another_is_not():
    program = ["v0 = x0", "v1 = v0 * v0", "v2 = plant_f(v1, (2.0))", "v3 = v2[1]", "v4 = v0 + v3", "y[0] = v4"]
    text = "\n".join(formula.grouped(program, {"f": 2}, lambda line: f"const double {line};"))
    assert "double v0[GROUP];" in text and "double v2[2][GROUP];" in text and "double q0[2][GROUP];" in text
    assert "    v0[l] = x0;" in text and "    const double v1 = v0[l] * v0[l];" in text
    assert "    q0[0][l] = v1;" in text and "    const double v3 = v2[1][l];" in text
    assert text.index("CALLED(plant_f, count, q0, v2);") < text.index("v3 =")


@pytest.mark.slow
@pytest.mark.parametrize("name", SHIPPED)
def test_the_loops_over_lanes_of_shipped_plants_are_vectorised(name, tmp_path: Path):
    """In the prediction and in the simulated plant: gcc says so of the line with the loop over lanes."""
    if "gcc" not in subprocess.run([*compiler.command(), "--version"], capture_output=True, text=True).stdout.lower():
        pytest.skip("asks gcc")
    plant = npred.plant(name)
    family = npred.prediction.delays.problem_of(plant)
    for kernel in (family.sweep(npred.prediction.methods.RK4.step), family.advance(npred.prediction.methods.RK4.step)):
        (tmp_path / "kernel.c").write_text(kernel.unit)
        flags = [*compiler.FLAGS, "-fopt-info-vec-optimized", "kernel.c", "-o", "kernel.so", "-lm"]
        told = subprocess.run([*compiler.command(), *flags], cwd=tmp_path, check=True, capture_output=True, text=True)
        done = {int(row) for row in re.findall(r"kernel\.c:(\d+):\d+: optimized: loop vectorized", told.stderr)}
        calls = called_functions.called(plant)
        inside = "plant_f_of" if calls else "STEP("
        lines = kernel.unit.splitlines()
        loops = [k for k, line in enumerate(lines, 1) if "LANES for" in line and any(
            inside in near for near in (lines[k - 3 : k] if calls else lines[k - 1 : k + 3]))]  # fmt: skip
        assert loops and done & set(loops), kernel.name


STRICT = ["-std=c99", "-O1", "-Wall", "-Wextra", "-Wpedantic", "-Wshadow", "-Wconversion"]


@needs_gcc
@pytest.mark.parametrize("files", [LOOP, ON_A_CLOCK])
def test_strict_compilers_find_nothing_in_the_loop(tmp_path, files):
    declared = signals.declared(events=True)
    text = "\n".join([skeleton("base.h"), *declared, *map(skeleton, files)])
    (tmp_path / "loop.c").write_text(text)
    find_nothing(tmp_path, "loop.c", *STRICT)


@pytest.mark.slow
@needs_gcc
def test_no_step_of_a_loop_is_undefined(tmp_path, monkeypatch):
    monkeypatch.setenv("NPRED_CACHE", str(tmp_path))
    monkeypatch.setenv("NPRED_QUIET", "1")
    target, flags = tmp_path / "loops.npz", "-O1 -fsanitize=undefined -fno-sanitize-recover=all"
    done = subprocess.run([sys.executable, HERE / "all_loops.py", target, flags], capture_output=True, text=True)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
    assert {values.shape[0] for values in np.load(target).values()} == {3}


def called(function):
    """What it leaves in U (m, lanes) for X (n, lanes) = 1000, and its failure."""
    X, U, work, failure = np.full((2, 3), 1000.0), np.zeros((1, 3)), np.zeros(1), Failure()
    run = callback(function, "X, &U", {}, failure)
    run(Shape(nx=2, lanes=3, rows=0, n=2, m=1), address(X), address(U), address(work))
    return U, failure


@pytest.mark.filterwarnings("error::RuntimeWarning")
def test_what_leaves_the_floats_is_no_cause_for_a_warning():
    def explode(X, U):
        U[0] = np.exp(X[0]) - np.exp(X[1])

    U, failure = called(explode)
    assert np.isnan(U).all() and U.shape == (1, 3)
    failure.raised()  # nothing


def test_what_it_raises_waits_for_the_loop():
    def fail(X, U):
        raise KeyError("a sensor")

    _, failure = called(fail)
    assert failure.flag.value == 1
    with pytest.raises(KeyError, match="a sensor"):
        failure.raised()
    failure.raised()  # once
