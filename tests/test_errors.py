"""What of a foreign error is shown; small files, seeds, nodes and arrays from anywhere."""

import os
import sys
from fractions import Fraction
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from npred.base import array_checks, grid, json_files, randomness
from npred.base.errors import ConfigError, MissingError, first_line, imported, installed, required


@pytest.mark.parametrize(
    ("error", "line"),
    [
        (ValueError("first\nsecond"), "first"),
        (RuntimeError("\n  after an empty line\n"), "after an empty line"),
        (KeyError(), "KeyError"),
        (OSError(" \n"), "OSError"),
    ],
)
def test_the_first_line_says_something(error: Exception, line: str):
    assert first_line(error) == line


def test_a_text_without_a_word_says_what_is_said_otherwise():
    assert first_line("\n \n", "no word") == "no word" and first_line("\n a \nb", "no word") == "a "


@pytest.fixture
def module(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    """A module that imports torch first, in a process that lacks it."""
    (tmp_path / "takes_torch.py").write_text("import torch\nimport nowhere_to_be_found\n")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setitem(sys.modules, "torch", None)  # type: ignore[arg-type]
    return "takes_torch"


def test_a_module_without_its_package_names_the_extra(module):
    with pytest.raises(
        MissingError, match=r"^a: expected the package torch, found none; pip install 'npred\[train\]'$"
    ):
        imported("a", module)
    with pytest.raises(MissingError, match=r"pip install 'npred\[onnx\]'$"):
        imported("a", module, "onnx")
    with pytest.raises(
        MissingError, match=r"^b: expected the package PyTorch, found none; pip install 'npred\[gpu\]'$"
    ):
        required("b", "torch", "PyTorch", "gpu")
    assert not installed("torch") and installed("numpy") and not installed("nowhere_to_be_found")


def test_a_module_that_lacks_what_no_extra_has_fails_as_it_is(module, monkeypatch):
    monkeypatch.setitem(sys.modules, "torch", sys)
    with pytest.raises(ModuleNotFoundError, match="nowhere_to_be_found"):
        imported("a", module)


def test_a_notebook_shows_the_lines_of_the_caller_and_not_those_of_npred(capsys: pytest.CaptureFixture):
    interactiveshell = pytest.importorskip("IPython.core.interactiveshell")
    shell = interactiveshell.InteractiveShell()
    shell.run_cell(
        "import npred\ndef mine():\n    return npred.generate('smoke', settings={'generate.sample': 2})\nmine()"
    )
    shown = "".join(capsys.readouterr())
    assert "in mine" in shown and "ConfigError: smoke: generate.sample: unknown key" in shown
    assert "runs.py" not in shown and "interactiveshell" not in shown and len(shown.splitlines()) < 8
    shell.run_cell("1 / 0")
    assert "ZeroDivisionError" in capsys.readouterr().out  # as usual


def test_a_table_is_read(tmp_path: Path):
    (tmp_path / "a.json").write_text('{"mse": 0.5}')
    assert json_files.table(tmp_path / "a.json") == {"mse": 0.5}


@pytest.mark.parametrize("text", ["[1]", "3", "{", "[" * 100_000, '{"a": ' + "9" * 5000 + "}", "\xff"])
def test_what_is_no_table_is_refused(tmp_path: Path, text: str):
    (tmp_path / "a.json").write_bytes(text.encode("latin-1"))
    with pytest.raises(ValueError, match=r"JSON|Expecting|integer|utf-8"):
        json_files.table(tmp_path / "a.json")


def test_what_is_too_long_is_not_read(tmp_path: Path):
    (tmp_path / "a.json").write_text("[1, 2]")
    assert json_files.read(tmp_path / "a.json", limit=6) == b"[1, 2]"
    with pytest.raises(ValueError, match="6 bytes, more than 5"):
        json_files.read(tmp_path / "a.json", limit=5)


def test_links_and_pipes_are_not_opened(tmp_path: Path):
    (tmp_path / "link").symlink_to("/etc/passwd")
    os.mkfifo(tmp_path / "pipe")
    for name in ("link", "pipe", "."):
        with pytest.raises(ValueError, match="a link, a folder or a device"):
            json_files.read(tmp_path / name)
    with pytest.raises(FileNotFoundError):
        json_files.read(tmp_path / "nothing")


def test_what_moves_a_cursor_is_spelt_out():
    strange = {"a\x1b[2J\n": ["\x9b1m", "\u202e", "\ud800", 1, None, {"ε µ": "\\x1b"}]}
    plain = {r"a\x1b[2J\n": [r"\x9b1m", r"\u202e", r"\ud800", 1, None, {"ε µ": r"\x1b"}]}
    assert json_files.escaped(strange) == plain


def test_what_is_read_whole_is_a_file(tmp_path: Path):
    (tmp_path / "file").write_text("1")
    (tmp_path / "link").symlink_to(tmp_path / "file")
    os.mkfifo(tmp_path / "pipe")
    for name in ("file", "link", "missing"):
        assert json_files.regular(tmp_path / name) == tmp_path / name
    for path in (tmp_path / "pipe", tmp_path, Path("/dev/zero")):
        with pytest.raises(OSError, match="a pipe, a device or a folder"):
            json_files.regular(path)


def test_values_become_plain_json():
    value = {"a": np.float64(1.5), "b": np.array([1.0, np.inf]), 3: (float("nan"), True, "x", None, np.int32(4))}
    assert json_files.plain(value) == {"a": 1.5, "b": [1.0, None], "3": [None, True, "x", None, 4]}


PATHS = st.lists(st.text(max_size=8) | st.integers(0, 2**31), min_size=1, max_size=3)


@given(st.integers(0, 2**40), PATHS)
def test_a_child_is_a_function_of_seed_and_path(seed: int, path: list[str | int]):
    first, second = (randomness.generator(seed, *path).random(4) for _ in range(2))
    assert (first == second).all()


def test_children_differ_by_seed_name_and_index():
    paths = [
        (0, "rollout", 0),
        (0, "rollout", 1),
        (1, "rollout", 0),
        (0, "split", 0),
        (0, "rollout"),
        (0, 0, "rollout"),
    ]
    drawn = {randomness.generator(*path).random() for path in paths}
    assert len(drawn) == len(paths)


def test_the_streams_stay_the_same_from_version_to_version():
    # Stored results depend on them: a change here has to raise the versions of the stages.
    assert randomness.integer(0, "train", "deeponet") == 2436932721760796240
    assert randomness.generator(7, "rollout", 17).integers(0, 2**62) == 3706524562308589976


@given(st.integers(0, 2**40), PATHS)
def test_integers_fit_63_bits(seed: int, path: list[str | int]):
    assert 0 <= randomness.integer(seed, *path) < 2**63


def test_neighbouring_children_are_uncorrelated():
    draws = [randomness.generator(0, "rollout", k).standard_normal() for k in range(2000)]
    products = [a * b for a, b in pairwise(draws)]
    assert abs(sum(products) / len(products)) < 4 / len(products) ** 0.5


SIZES = st.integers(2, 400)


@given(SIZES)
def test_both_ends_are_nodes_and_the_spacing_is_even(nx: int):
    x = grid.nodes(nx)
    assert (x[0], x[-1], len(x)) == (0.0, 1.0, nx)
    np.testing.assert_allclose(np.diff(x), 1 / (nx - 1), rtol=1e-9)


@given(SIZES, st.floats(-5, 5), st.floats(-5, 5))
def test_the_quadrature_is_exact_for_straight_lines(nx: int, a: float, b: float):
    integral = grid.trapezoid(nx) @ (a + b * grid.nodes(nx))
    assert integral == pytest.approx(a + b / 2, abs=1e-12)


def test_the_quadrature_is_of_second_order():
    errors = [abs(grid.trapezoid(nx) @ np.exp(grid.nodes(nx)) - np.expm1(1)) for nx in (11, 21, 41, 81)]
    orders = np.diff(np.log2(errors))
    np.testing.assert_allclose(orders, -2, atol=0.02)


@pytest.mark.parametrize(("dx", "nx"), [(0.01, 101), (0.005, 201), (0.001, 1001), (0.5, 3)])
def test_dx_counts_both_ends(dx: float, nx: int):
    assert grid.count(dx) == nx
    assert np.diff(grid.nodes(nx))[0] == pytest.approx(dx)


@pytest.mark.parametrize(("old", "nx"), [(5, 9), (21, 101), (101, 21), (7, 7)])
def test_refine_is_exact_on_cubics_and_keeps_nodes(old, nx):
    cubic = lambda x: np.stack([1 - 2 * x + 3 * x**2 - 4 * x**3, x], axis=-1)
    np.testing.assert_allclose(grid.refine(cubic(grid.nodes(old)), nx), cubic(grid.nodes(nx)), atol=1e-13)


def test_refine_is_linear_on_few_nodes_and_takes_batches():
    values = np.array([[[0.0], [1.0], [0.0]], [[2.0], [2.0], [4.0]]])
    refined = grid.refine(values, 5)
    np.testing.assert_allclose(refined[..., 0], [[0, 0.5, 1, 0.5, 0], [2, 2, 2, 3, 4]], atol=1e-14)


REFUSED = {
    "text": "a", "numbers as text": ["1", "2"], "ragged": [[1, 2], [3]], "a dictionary": {"x": 1}, "None": [None, 1.0],
    "a gradient": torch.ones(2, requires_grad=True), "complex": [1j], "complex list": [1.0, 2 + 0j],
    "masked": np.ma.array([1.0, 2.0], mask=[0, 1]), "nothing masked": np.ma.array([1.0]), "a mask": np.ma.masked,
    "masked items": [np.ma.masked, 1.0], "masked rows": [np.ma.array([1.0], mask=[1])],
    "a date": np.array(["2020"], "M8[s]"), "a duration": np.array([1], "m8[s]"), "an object": [np.timedelta64(1), 1.0],
    "too large": [10**400],
}  # fmt: skip


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("value", REFUSED.values(), ids=REFUSED)
def test_what_is_no_array_of_real_numbers_is_refused(value):
    with pytest.raises(ConfigError, match="X: expected an array of real numbers") as refused:
        array_checks.floats("X", value)
    assert len(str(refused.value).splitlines()) == 1


@pytest.mark.parametrize("value", [[1, 2.5], [True], np.float16([0.5]), [10**30, 1.0], [Fraction(1, 4)], []])
def test_real_numbers_of_all_kinds_are_taken(value):
    np.testing.assert_array_equal(array_checks.floats("X", value), [float(item) for item in value])


def test_a_number_has_no_axes():
    assert array_checks.number("dt", np.array(0.5)) == 0.5
    with pytest.raises(ConfigError, match=r"dt: expected a real number, got an array of shape \(1,\)"):
        array_checks.number("dt", [0.5])
    with pytest.raises(ConfigError, match=r"dt: expected a real number, got \(1\+1j\)"):
        array_checks.number("dt", 1 + 1j)


def test_the_first_wrong_value_is_named_with_its_place():
    X = np.zeros((1000, 3))
    X[7, 2] = np.nan
    with pytest.raises(ConfigError, match=r"X: expected finite numbers, got nan at \[7, 2\]; replace it$"):
        array_checks.finite("X", X)
    for seconds in (-1.0, np.nan, np.inf):
        with pytest.raises(ConfigError, match=f"D: expected a delay of at least 0, got {seconds:g}; give 0 or more"):
            array_checks.delays("D", np.array(seconds))


def test_batches_broadcast_or_are_told():
    assert array_checks.batch(X=(3, 1), D=(4,)) == (3, 4)
    with pytest.raises(ConfigError, match=r"X \(3,\), D \(4,\)"):
        array_checks.batch(X=(3,), D=(4,))


def test_an_array_fits_where_it_broadcasts_to_the_shape():
    assert array_checks.fits((), (3,)) and array_checks.fits((1, 3), (2, 3))
    assert not array_checks.fits((2, 3), (3,)) and not array_checks.fits((2,), (3,))


def test_floats_are_float64():
    assert array_checks.floats("X", torch.ones(2, dtype=torch.float32)).dtype == np.float64


def test_samples_that_are_finite_are_known():
    X, u, D_hat = np.zeros((4, 2)), np.zeros((4, 5, 1)), np.zeros(4)
    X[0, 1], u[1, 4, 0], D_hat[2] = np.nan, np.inf, np.nan
    np.testing.assert_array_equal(array_checks.finite_rows(X, u, D_hat), [False, False, False, True])
