"""The functions of M: NumPy's and SciPy's values, on the tape, in C, on tensors; derivatives by other means."""

import math

import numpy as np
import pytest
import torch
from c_controllers import LANE_BY_LANE, InC, library, needs_gcc
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scipy.interpolate import CubicSpline

import npred
from npred.base.errors import ConfigError
from npred.formulas import array_math, programs
from npred.formulas.tape import INSTEAD, NAMES, M, Tape
from npred.formulas.trace import python
from npred.kernels.c_text import single
from npred.kernels.formula import function, vector
from npred.kernels.kernel import made

REALS = st.floats(-6, 6)
SMOOTH = {  # of two reals: M's, and NumPy's on complex numbers
    "asin": (lambda a, b, M: M.asin(a / 7), lambda a, b: np.arcsin(a / 7)),
    "acos": (lambda a, b, M: M.acos(a / 7), lambda a, b: np.arccos(a / 7)),
    "atan": (lambda a, b, M: M.atan(a * b), lambda a, b: np.arctan(a * b)),
    "atan2": (lambda a, b, M: M.atan2(a, b + 7), lambda a, b: np.arctan(a / (b + 7))),
    "atan2 behind": (lambda a, b, M: M.atan2(a + 7, b), lambda a, b: np.pi / 2 - np.arctan(b / (a + 7))),
    "sinh": (lambda a, b, M: M.sinh(a - b), lambda a, b: np.sinh(a - b)),
    "cosh": (lambda a, b, M: M.cosh(a - b), lambda a, b: np.cosh(a - b)),
}
PIECEWISE = {
    "floor": (lambda a, b, M: M.floor(a), lambda a, b: np.floor(a)),
    "mod": (lambda a, b, M: M.mod(a, b), np.mod),
    "%": (lambda a, b, M: a % b, np.mod),
    "clip": (lambda a, b, M: M.clip(a, -1.0, b), lambda a, b: np.clip(a, -1.0, b)),
    "atan2": (lambda a, b, M: M.atan2(a, b), np.arctan2),
    "and": (
        lambda a, b, M: M.where(M.logical_and(a < b, a > 0), a, b),
        lambda a, b: np.where(np.logical_and(a < b, a > 0), a, b),
    ),
    "or": (
        lambda a, b, M: M.where(M.logical_or(a < b, a > 0), a, b),
        lambda a, b: np.where(np.logical_or(a < b, a > 0), a, b),
    ),
    "not": (
        lambda a, b, M: M.where(M.logical_not(a < b), a, b),
        lambda a, b: np.where(np.logical_not(a < b), a, b),
    ),
    "numbers as conditions": (
        lambda a, b, M: M.where(M.logical_and(M.logical_not(a), M.logical_or(a, b)), 1.0, 2.0),
        lambda a, b: np.where(np.logical_and(np.logical_not(a), np.logical_or(a, b)), 1.0, 2.0),
    ),
}
POINTS, VALUES = [-3.0, -1.0, -0.5, 1.0, 4.0], [0.3, -1.0, 2.0, 2.5, -0.7]
SPLINE = CubicSpline(POINTS, VALUES)


def traced(formula):
    """The outputs and their derivative along (da, db) on one tape."""
    a, b, *along = (Tape()).inputs("x", 4)
    outputs = [formula(a, b, M)]
    return [*outputs, *programs.derivative(outputs, [a, b], along)]


def compiled(formulas, count=4):
    """What takes `count` floats to the values of the formulas of x0, x1, … in C."""
    text = function("{name}", formulas, [vector("x", count)], {"y": len(formulas)}, 1)
    kernel = made("mathematics", "X, t, &U", LANE_BY_LANE, {"F": text})

    def call(*values):
        U = np.empty((len(formulas), 3))
        kernel(np.tile(np.array(values, dtype=float)[:, None], 3), 0.0, U)
        assert ((U[:, :1] == U) | np.isnan(U)).all()  # all lanes alike
        return U[:, 0]

    return call


OF_ALL = {name: traced(m) for name, (m, _) in (SMOOTH | {f"piecewise {k}": v for k, v in PIECEWISE.items()}).items()}
IN_C = {name: compiled(outputs) for name, outputs in OF_ALL.items()}
IN_PYTHON = {name: python(outputs, ["x0", "x1", "x2", "x3"]) for name, outputs in OF_ALL.items()}
ON_FLOATS = {name: python(outputs, ["x0", "x1", "x2", "x3"], math) for name, outputs in OF_ALL.items()}


@pytest.mark.parametrize("name", SMOOTH)
@settings(max_examples=40)
@given(REALS, REALS, REALS, REALS)
def test_smooth_functions_and_their_derivatives_are_numpys_by_a_complex_step(name, a, b, da, db):
    _, on_complex = SMOOTH[name]
    step = 1e-30
    expected = [on_complex(a, b), np.imag(on_complex(a + 1j * step * da, b + 1j * step * db)) / step]
    for of in (IN_C, IN_PYTHON, ON_FLOATS):
        np.testing.assert_allclose(of[name](a, b, da, db), expected, rtol=2e-13, atol=2e-13)


@pytest.mark.parametrize("name", PIECEWISE)
@settings(max_examples=60)
@given(REALS | st.just(0.0), REALS.filter(lambda b: abs(b) > 1e-3))
@example(1.0, 0.1)
@example(-1.0, 0.1)
@example(1.0, -0.3)
@example(-6.0, 3.0)
@example(2.0, 2.0)
def test_piecewise_functions_are_numpys(name, a, b):
    m, reference = PIECEWISE[name]
    expected = float(reference(np.float64(a), np.float64(b)))
    for of in (IN_C, IN_PYTHON, ON_FLOATS):
        assert float(of[f"piecewise {name}"](a, b, 0.0, 0.0)[0]) == pytest.approx(expected, rel=1e-15, abs=0)
    assert m(a, b, M) == pytest.approx(expected, rel=1e-15, abs=0), "numbers alone"
    arrays = np.full(3, a), np.full(3, b)
    np.testing.assert_allclose(m(*arrays, array_math.NUMPY), expected, rtol=1e-15)
    np.testing.assert_allclose(IN_PYTHON[f"piecewise {name}"](*arrays, 0.0, 0.0)[0], expected, rtol=1e-15)
    tensors = tuple(map(torch.tensor, arrays))
    if "%" not in name and "numbers" not in name:
        np.testing.assert_allclose(m(*tensors, array_math.of(tensors[0])), expected, rtol=1e-12, atol=1e-300)


@pytest.mark.parametrize(("name", "a", "b"), [(name, 0.83, b) for name in PIECEWISE for b in (0.37, -0.61, 2.3)])
def test_their_derivatives_between_jumps_equal_differences_of_fourth_order(name, a, b):
    _, of = PIECEWISE[name]
    at = lambda s: of(np.float64(a + s * 0.7), np.float64(b - s * 0.4))
    h = 1e-3
    expected = (8 * (at(h) - at(-h)) - (at(2 * h) - at(-2 * h))) / (12 * h)
    for functions in (IN_C, IN_PYTHON, ON_FLOATS):
        assert functions[f"piecewise {name}"](a, b, 0.7, -0.4)[1] == pytest.approx(expected, rel=1e-8, abs=1e-10)


@pytest.mark.parametrize(("a", "b"), [(math.nan, 1.0), (1.0, math.inf), (-1.0, math.inf), (math.inf, 2.0)])
@pytest.mark.filterwarnings("ignore:invalid value")
def test_edges_of_mod_and_of_tables_are_numpys(a, b):
    x, y = Tape().inputs("x", 2)
    outputs = [M.mod(x, y), M.interp(x, POINTS, VALUES), M.floor(x), M.clip(x, -1.0, 1.0)]
    expected = np.mod(a, b), np.interp(a, POINTS, VALUES), np.floor(a), np.clip(a, -1.0, 1.0)
    np.testing.assert_array_equal(compiled(outputs, 2)(a, b), expected)
    np.testing.assert_array_equal(
        python(outputs, ["x0", "x1"])(np.array([a]), np.array([b])), np.c_[expected].reshape(4, 1)
    )


def cubic(x, order=0):
    """SciPy's spline, held beyond the ends."""
    inside = (POINTS[0] <= x) & (x < POINTS[-1])
    level = 0.0 if order else SPLINE(np.clip(x, POINTS[0], POINTS[-1]))
    return np.where(inside, SPLINE(x, order), level)


def tables():
    (x, *_) = Tape().inputs("x", 1)
    orders = [M.interp(x, POINTS, VALUES, "cubic", k) for k in range(4)]
    slopes = [programs.derivative([output], [x], [1.0])[0] for output in orders]
    linear = M.interp(x, POINTS, VALUES)
    return [
        linear,
        *programs.derivative([linear], [x], [1.0]),
        M.interp(x, POINTS, VALUES, derivative=1),
        *orders,
        *slopes,
    ]


TABLES = tables()
TABLES_IN_C, TABLES_IN_PYTHON = compiled(TABLES, 1), python(TABLES, ["x0"])


@settings(max_examples=60)
@given(st.floats(-5, 6))
@example(-3.0)
@example(4.0)
@example(1.0)
@example(-1e300)
def test_tables_are_numpys_lines_and_scipys_spline(x):
    k = np.searchsorted(POINTS, x, side="right")
    slope = (VALUES[k] - VALUES[k - 1]) / (POINTS[k] - POINTS[k - 1]) if 0 < k < len(POINTS) else 0.0
    expected = [np.interp(x, POINTS, VALUES), slope, slope, *(cubic(x, k) for k in (0, 1, 2, 3, 1, 2, 3)), 0.0]
    np.testing.assert_allclose(TABLES_IN_C(x), expected, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(TABLES_IN_PYTHON(x), expected, rtol=1e-12, atol=1e-12)
    on_arrays = [np.broadcast_to(value, 3) for value in TABLES_IN_PYTHON(np.full(3, x))]
    np.testing.assert_allclose(on_arrays, np.tile(np.array(expected, dtype=float)[:, None], 3), rtol=1e-12, atol=1e-12)
    X = torch.full((3,), x, dtype=torch.float64, requires_grad=True)
    y = array_math.of(X).interp(X, POINTS, VALUES, "cubic")
    np.testing.assert_allclose(y.detach(), expected[3], rtol=1e-12, atol=1e-12)
    if x not in (POINTS[0], POINTS[-1]):  # where it has two slopes
        np.testing.assert_allclose(torch.autograd.grad(y.sum(), X)[0], expected[4], rtol=1e-12, atol=1e-12)


@settings(max_examples=30, deadline=None)
@given(st.lists(st.tuples(st.floats(0.05, 3), st.floats(-4, 4)), min_size=4, max_size=30), st.floats(0, 1))
def test_a_spline_through_any_points_is_scipys(steps, share):
    points, values = np.cumsum([h for h, _ in steps]), np.array([v for _, v in steps])
    x = points[0] + share * (points[-1] - points[0])
    expected = float(CubicSpline(points, values)(x))
    assert array_math.NUMPY.interp(x, points, values, "cubic") == pytest.approx(expected, rel=1e-8, abs=1e-8)


def test_single_precision_has_the_functions_of_floats():
    text = single("double y = atan2(sinh(a), cosh(b)) + asin(a) + acos(a) + fmod(a, 2.0) + atan(b);")
    assert text == "float y = atan2f(sinhf(a), coshf(b)) + asinf(a) + acosf(a) + fmodf(a, 2.0f) + atanf(b);"


class Everything:
    """Every function of M in f and in the law."""

    states, inputs, parameters, box = ("h", "v"), ("q",), {"c": 0.5}, {"h": (-1.0, 1.0), "v": (-1.0, 1.0)}

    def f(x, u, t, p, M):
        bend = (
            0.1 * M.atan2(x.h, 2 + M.cosh(x.v)) + 0.05 * M.asin(M.clip(x.v, -0.9, 0.9)) - 0.05 * M.acos(0.3 * x.h / 2)
        )
        table = 0.1 * M.interp(x.h, POINTS, VALUES, "cubic") + 0.02 * M.interp(x.v, POINTS, VALUES)
        return [x.v, u.q - p.c * x.v - M.atan(x.h) + bend + table + 0.03 * M.mod(x.v + 0.5, 2.0)]

    def kappa(x, t, p, M):
        near = M.logical_and(M.logical_not(x.h > 0.5), M.logical_or(x.h > -0.5, x.v < 9.0))
        hold = (
            M.where(near, -x.h, -0.9 * x.h - 0.05)
            - 0.01 * M.floor(x.h)
            + 0.01 * M.interp(x.h, POINTS, VALUES, "cubic", 1)
        )
        return [hold - 0.3 * M.sinh(0.2 * x.v)]

    def V(x, t, p, M):
        return x.h**2 + x.v**2


def exported(precision, folder):
    plant = npred.plant(Everything)
    controller = npred.controller(plant, npred.predictor(plant, "rk4", 11), None, 0.01, D_hat=0.2, actuator="measured")
    return controller, InC(library(controller, folder, precision), plant, precision)


@needs_gcc
@pytest.mark.parametrize(("precision", "near"), [("double", 1e-12), ("float", 2e-5)])
def test_an_exported_controller_computes_them_all(precision, near, tmp_path):
    controller, in_C = exported(precision, tmp_path)
    for k in range(40):
        X = np.array([math.sin(0.3 * k), math.cos(0.2 * k)])
        u = np.full((11, 1), 0.1 * math.sin(k))
        np.testing.assert_allclose(in_C.step(X, u), controller.step(X, u), rtol=near, atol=near)


def test_the_numbers_of_a_table_are_in_the_program_and_in_a_printed_law():
    plant = npred.plant(Everything)
    assert str(POINTS[2]) in plant.program["f"] and str(VALUES[1]) in plant.program["f"]
    other = type("Other", (Everything,), {"f": lambda x, u, t, p, M: [x.v, u.q + M.interp(x.h, [0, 1], [0, 2])]})
    same = type(
        "Other", (Everything,), {"f": lambda x, u, t, p, M: [x.v, u.q + M.interp(x.h, (0, 1), np.array([0, 2]))]}
    )
    assert npred.plant(other).program["f"] == npred.plant(same).program["f"] != plant.program["f"]
    law = npred.plant(other, kappa={"law": "feedback_linearisation", "poles": [-1.0, -2.0]})
    X = np.random.default_rng(0).uniform(-1, 2, (20, 2))
    pasted = type("Pasted", (other,), {"kappa": law.law.function})
    assert "M.interp(" in str(law.law)
    np.testing.assert_array_equal(npred.plant(pasted).kappa(X), law.kappa(X))


def test_every_name_serves_symbols_arrays_and_tensors():
    torch_too = vars(array_math.of(torch.zeros(1)))
    assert {*NAMES} == {*vars(array_math.NUMPY)} == {*torch_too}
    x = Tape().input("x")
    assert all(getattr(M, name) is not None for name in NAMES) and x is not None


NUMPYS = ["arctan2", "arcsin", "fmod", "hypot", "interp1d"]


@pytest.mark.parametrize("name", NUMPYS)
def test_names_of_other_libraries_lead_to_ms(name):
    with pytest.raises(AttributeError, match=rf"got '{name}'; write ") as caught:
        getattr(M, name)
    assert str(caught.value).endswith(INSTEAD[name])


def test_a_wrong_count_of_arguments_is_named():
    with pytest.raises(TypeError, match=r"M\.atan2 expected 2 arguments, got 1; give 2"):
        M.atan2(1.0)


@pytest.mark.parametrize(
    ("table", "message"),
    [
        (([0, 1, 1], [0, 1, 2]), "the points rising"),
        (([0, math.nan], [0, 1]), "expected finite numbers"),
        (([0, 1, 2], [0, 1]), "as many values as points, at least 2 if linear, got 3 and 2"),
        (([0, 1, 2], [0, 1, 2], "cubic"), "at least 4 if cubic, got 3 and 3"),
        (([0, 1], [0, 1], "cubik"), "kind: expected one of linear, cubic, got 'cubik'; did you mean cubic"),
        (([0, 1], [0, 1], "linear", 2), "a derivative of 0 to 1, got 2"),
    ],
)
def test_a_table_that_is_none_is_refused(table, message):
    with pytest.raises(ValueError, match=message):
        M.interp(Tape().input("x"), *table)


def plant_of(f):
    return npred.plant(type("Tank", (Everything,), {"f": f}))


@pytest.mark.parametrize(
    ("wrong", "cure"),
    [
        (lambda x, u, t, p, M: [x.v, u.q + np.interp(x.h, POINTS, VALUES)], "write M.interp"),
        (lambda x, u, t, p, M: [x.v, u.q + np.sin(x.h)], "write M.sin"),
        (lambda x, u, t, p, M: [x.v, u.q + np.arctan2(x.h, x.v)], "write M.atan2"),
        (lambda x, u, t, p, M: [x.v, u.q + math.atan2(x.h, x.v)], "write M.atan2"),
        (lambda x, u, t, p, M: [x.v, u.q + np.clip(x.h, 0, 1)], "write M.clip"),
        (lambda x, u, t, p, M: [x.v, u.q + max(x.h, 0)], "write M.maximum"),
        (lambda x, u, t, p, M: [x.v, u.q + math.floor(x.h)], "write M.floor"),
        (lambda x, u, t, p, M: [x.v, u.q + round(x.h)], r"write M.floor\(a \+ 0.5\)"),
        (lambda x, u, t, p, M: [x.v, u.q + x.h // 2], r"write M.floor\(a / b\)"),
        (lambda x, u, t, p, M: [x.v, M.where((x.h < 1) & (x.h > 0), 1, 0)], r"write M.logical_and\(a, b\)"),
        (lambda x, u, t, p, M: [x.v, M.where(not x.h < 1, 1, 0)], "write M.where"),
        (lambda x, u, t, p, M: [x.v, M.interp(x.h, [0, p.c], [0, 1])], "expected a table of numbers.*; multiply what"),
        (lambda x, u, t, p, M: [x.v, u.q + SPLINE(x.h)], "M.sin and its like|scipy takes no state"),
        (lambda x, u, t, p, M: [x.v, x.h(t - 1)], "only inputs arrive late; for a state x.h at t - tau declare states"),
        (lambda x, u, t, p, M: [x(t - 1)[1], u.q], "only inputs arrive late; for a state"),
        (lambda x, u, t, p, M: [x.v, u(t - 1)[0]], "inputs arrive late by themselves: write u.name for U"),
        (lambda x, u, t, p, M: [x.v, u.q(t - 1)], "inputs arrive late by themselves: write u.q for U"),
        (lambda x, u, t, p, M: [x.v, u[0](t)], r"inputs arrive late by themselves: write u\[0\] for U"),
        (lambda x, u, t, p, M: [x.v, p.c(x.h + 1)], r"write \* for a product"),
        (lambda x, u, t, p, M: [x.v, x.h(x.v + 1)], r"write \* for a product"),
        (lambda x, u, t, p, M: [x.v, u.q - x.h^2], r"write \*\* for a power"),
        (lambda x, u, t, p, M: [x.v, 2^x.h], r"write \*\* for a power"),
        (lambda x, u, t, p, M: [x.v, u.q + maths.sin(x.h)], "name 'maths' is not defined; write M.sin$"),  # noqa: F821
        (lambda x, u, t, p, M: [x.v, numpy.linalg.norm(x.h)], "write M.sqrt of the sum"),  # noqa: F821
        (lambda x, u, t, p, M: [maths.pi, u.q], "write M.pi$"),  # noqa: F821
        (lambda x, u, t, p, M: [x.v, json.loads(x.h)], "what the file defines; write import json above"),  # noqa: F821
        (lambda x, u, t, p, M: [x.v, u.q + M.arctan(x.h)], "got 'arctan'; write M.atan$"),
    ],
)  # fmt: skip
def test_what_cannot_be_traced_names_the_way_out(wrong, cure):
    with pytest.raises(ConfigError, match=rf"plant Tank: f failed at test_mathematics.py:\d+: .*{cure}") as caught:
        plant_of(wrong).printed("f")
    assert "\n" not in str(caught.value)


def test_on_arrays_they_do_so_too():
    with pytest.raises(ConfigError, match=r"expected one of M's .*; write M.atan2$"):
        plant_of(lambda x, u, t, p, M: [x.v, M.arctan2(x.h, x.v)]).f(np.ones((3, 2)), np.ones((3, 1)))


@pytest.mark.parametrize(
    ("wrong", "cure"),
    [
        (lambda x, u, t, p, M: [x.v, x.h^2 + u.q], r"write \*\* for a power"),
        (lambda x, u, t, p, M: [x.v, p.c^2 + u.q], r"write \*\* for a power"),
        (lambda x, u, t, p, M: [x.v, u.q(t - 1)], "inputs arrive late by themselves: write u.q"),
        (lambda x, u, t, p, M: [x.v, x.h(t - 1)], "only inputs arrive late"),
    ],
)  # fmt: skip
def test_arrays_of_states_have_the_same_advice_as_symbols(wrong, cure):
    with pytest.raises(ConfigError, match=cure):
        plant_of(wrong).f(np.ones((3, 2)), np.ones((3, 1)))


def test_a_casadi_function_names_the_way_out():
    casadi = pytest.importorskip("casadi")
    h = casadi.SX.sym("h")
    rate = casadi.Function("rate", [h], [casadi.sin(h)])
    with pytest.raises(
        ConfigError, match=r"casadi takes no state of a trace: write its formulas with M, or set traced"
    ):
        plant_of(lambda x, u, t, p, M: [x.v, u.q + rate(x.h)]).printed("f")


@pytest.mark.parametrize("law", ["M.floor(x.h)", "M.mod(x.h, 1.0)", "M.atan2(x.h, 1.0)", "M.clip(x.h, 0.0, 1.0)"])
def test_their_kinks_are_named(law):
    x = Tape().input("h")
    law = eval(law, {"M": M, "x": type("X", (), {"h": x})})
    assert programs.kinks([law], [x])
