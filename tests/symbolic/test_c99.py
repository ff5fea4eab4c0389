"""The translator to C99: what a kernel computes in Python it computes in C, and what C lacks is refused."""

import ctypes
import math
import shutil
import subprocess

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from npred.symbolic import kernels
from npred.symbolic.c99 import Array, Term, Unit, comment, literal
from npred.symbolic.c99.liveness import Lives

needs_gcc = pytest.mark.skipif(shutil.which("gcc") is None, reason="no gcc on this machine")
FLAGS = ["-std=c99", "-O2", "-Wall", "-Wextra", "-Wpedantic", "-Wshadow", "-Werror"]
HEAD = "#include <math.h>\n#include <stdint.h>\n#include <string.h>\n"

ARITHMETIC = """\
def kernel(a, k, n, out):
    out[0] = k // n
    out[1] = k % n
    out[2] = a[0] % a[1]
    out[3] = max(a[0], a[1])
    out[4] = min(a[0], a[1], a[2])
    out[5] = a[0] if a[0] < a[1] <= a[2] else -a[1]
    out[6] = 1.0 if not a[0] <= a[1] or np.isnan(a[2]) else 0.0
    out[7] = np.sign(a[0]) + abs(a[1])
    out[8] = k / n
    out[9] = a[0] - (a[1] - a[2]) - -a[1]
    out[10] = (a[0] - 2.0 * a[1]) ** 3
    out[11] = round(a[0] / 3.0) + int(a[1])
    out[12] = a[0] / (a[1] * a[2]) / a[2]
    out[13] = np.inf if np.isfinite(a[0]) else np.nan
"""
MEMORY = """\
def kernel(a, k, n, out):
    x, y = np.empty((3, 2)), np.empty(2)
    rest = out[3:]
    x[:] = 0.5
    x[1] = a[:2]
    x[:, 1] += a[2]
    y[:] = np.abs(x[1]) + x[2]
    total, before = 0.0, 1.0
    for i in range(3):
        total, before = total + x[i, 0] * before, total
    out[0], out[1] = out[1], total
    flat = x.reshape(-1)
    out[2] = flat[k % 6] + flat[-1] + x[-2, 0]
    for i, value in enumerate((y[0], y[1], before)):
        rest[i] = value
    j = 0
    while j < n:
        j += 2
    rest[3] = j
    for i in range(2, -1, -1):
        rest[4 + i] = x[i, 1] * i
    for i in range(10):
        if i * i > k:
            break
    else:
        rest[7] = -1.0
    rest[8] = i
    large = np.empty(40)
    for i in range(40):
        large[i] = i if i < 20 else 0.5
    rest[9] = large[k] + large[39 - k]
"""
CALLS = """\
@njit
def both(x, n):
    if x < 0.0:
        return n, -x
    return n + 1, x * x


@njit
def views(m, n):
    return m[:n], m[n:]


@njit
def grow(m, by):
    for i in range(len(m)):
        m[i] += by


"""
CALLING = """\
def kernel(a, k, n, out):
    count, size = both(a[0], n)
    low, high = views(out, 5)
    low[0], high[0] = count, size
    grow(low, a[1])
    grow(high, 1.0)
"""


def in_python(text, preamble, arguments):
    names = {}
    head = "import math\nimport numpy as np\ndef njit(f):\n    return f\n"
    exec(head + preamble + text, names)
    with np.errstate(all="ignore"):
        names["kernel"](*arguments)


def compiled(text, preamble, folder, real="double", size=14):
    """The function in C, of a (3,), k, n and out (size,)."""
    unit = Unit("c", real)
    shapes = {"a": (3,), "out": (size,)}
    arrays = {name: Array.whole(name, real, shape) for name, shape in shapes.items()}
    arguments = [arrays["a"], Term("k", "int"), Term("n", "int"), arrays["out"]]
    function = unit.function(kernels.uncompiled("kernel", text, preamble), arguments)
    memory = f"    static struct {function.name}_memory memory;\n" if function.memory else ""
    wrapper = f"void run(const {real} *a, int k, int n, {real} *out);\nvoid run(const {real} *a, int k, int n, "
    wrapper += f"{real} *out)\n{{\n{memory}    {function.name}(a, k, n, out{', &memory' if memory else ''});\n}}\n"
    (folder / "kernel.c").write_text("\n\n".join([HEAD, *unit.structs, unit.declarations(), wrapper]))
    command = ["gcc", *FLAGS, "-shared", "-fPIC", "kernel.c", "-o", "kernel.so", "-lm"]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=60)
    assert (done.returncode, done.stderr) == (0, "")
    return ctypes.CDLL(str(folder / "kernel.so")).run


def in_c(run, a, k, n, out):
    a, out = (np.array(values, dtype=float) for values in (a, out))
    run(a.ctypes.data_as(ctypes.c_void_p), k, n, out.ctypes.data_as(ctypes.c_void_p))
    return out


@needs_gcc
@pytest.mark.parametrize(("text", "preamble"), [(ARITHMETIC, ""), (MEMORY, ""), (CALLING, CALLS)])
def test_a_kernel_in_c_is_the_kernel_in_python(tmp_path_factory, text, preamble):
    run = compiled(text, preamble, tmp_path_factory.mktemp("kernel"))
    numbers = st.floats(-1e6, 1e6) | st.sampled_from([0.0, -0.0, 0.5, 1.5, 2.5])
    rows, counts = st.lists(numbers, min_size=3, max_size=3), st.integers(1, 12)
    whole = st.integers(-30, 30) if text is ARITHMETIC else st.integers(0, 39)

    @settings(max_examples=200, deadline=None)
    @given(rows, whole, counts)
    def same(a, k, n):
        out = np.arange(14.0)
        in_python(text, preamble, (np.array(a), k, n, out))
        np.testing.assert_allclose(in_c(run, a, k, n, np.arange(14.0)), out, rtol=1e-15, atol=0)

    same()


@needs_gcc
@pytest.mark.parametrize("a", [[math.nan, 1.0, 2.0], [1.0, math.nan, 2.0], [math.inf, 1.0, -math.inf]])
def test_so_it_is_for_what_is_not_finite(tmp_path, a):
    text = "\n".join(line for line in ARITHMETIC.splitlines() if "round" not in line) + "\n"
    out = np.arange(14.0)
    in_python(text, "", (np.array(a), 7, 3, out))
    np.testing.assert_array_equal(in_c(compiled(text, "", tmp_path), a, 7, 3, np.arange(14.0)), out)


@pytest.mark.parametrize(
    ("line", "what"),
    [
        ("out[0] = sum([k, n])", "List"),
        ("out[0] = {k: n}[k]", "Dict"),
        ("out[0] = (lambda x: x)(k)", "Lambda"),
        ("try:\n        pass\n    finally:\n        pass", "Try"),
        ("out[0] = unknown + k", "the name unknown"),
        ("out[0] = (k, n)[k]", "a tuple by a variable"),
        ("out[0] = k @ n", "MatMult"),
    ],
)
def test_what_c_lacks_is_refused_with_its_line(line, what):
    text = f"def kernel(a, k, n, out):\n    {line}\n"
    arguments = [Array.whole("a", "double", (3,)), Term("k", "int"), Term("n", "int"), Array.whole("o", "double", (9,))]
    with pytest.raises(NotImplementedError, match=f"kernel, line 2: expected a kernel's dialect, got {what}"):
        Unit("c").function(kernels.uncompiled("kernel", text), arguments)


@pytest.mark.parametrize(("second", "fits"), [("out[2:4]", True), ("out[1:3]", False), ("out[k:]", False)])
def test_arguments_that_share_memory_are_refused(second, fits):
    preamble = "@njit\ndef copy(to, source):\n    to[0] = source[1]\n    to[1] = source[0]\n\n\n"
    text = f"def kernel(k, out):\n    copy(out[:2], {second})\n"
    arguments = [Term("k", "int", low=0), Array.whole("out", "double", (4,))]
    unit, kernel = Unit("c"), kernels.uncompiled("kernel", text, preamble)
    if fits:
        assert unit.function(kernel, arguments).written == {"out"}
    else:
        with pytest.raises((NotImplementedError, KeyError), match=r"share memory|not known at the export"):
            unit.function(kernel, arguments)


@pytest.mark.parametrize(
    ("value", "kind", "text"),
    [
        (0.1, "double", "0.1"), (0.1, "float", "0.1f"), (3.0, "float", "3.0f"), (1e-300, "float", "1.1754944e-38f"),
        (-1e300, "float", "-3.4028235e+38f"), (math.inf, "float", "INFINITY"), (7, "int", "7"),
        (1e22, "double", "1e+22"),
    ],
)  # fmt: skip
def test_numbers_are_written_so_that_a_guard_against_0_stays_one(value, kind, text):
    assert literal(value, kind) == text


def test_variables_that_outlive_a_block():
    text = """\
def f(n):
    last = 0
    for i in range(n):
        here = i + 1
        if here > 2:
            last = here
            unread = 3
    return last
"""
    lives = Lives(kernels.uncompiled("f", text).tree.body)
    assert lives.outliving == {"last"}
    assert [statement.targets[0].id for statement in lives.idle] == ["unread"]


@given(st.text())
def test_no_text_ends_or_begins_a_comment(text):
    inside = comment(text)
    assert not {"*/", "/*", "??"} & {inside[i : i + 2] for i in range(len(inside))} and inside.isprintable()
