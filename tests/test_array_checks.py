"""Arrays as a caller gave them."""

from fractions import Fraction

import numpy as np
import pytest
import torch

from npred.base import array_checks
from npred.base.errors import ConfigError

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
