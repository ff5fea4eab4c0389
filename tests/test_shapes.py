"""Arrays as a caller gave them."""

import numpy as np
import pytest
import torch

from npred import shapes
from npred.errors import ConfigError


@pytest.mark.parametrize("given", ["a", [[1, 2], [3]], {"x": 1}, torch.ones(2, requires_grad=True)])
def test_what_is_no_array_of_numbers_is_told(given):
    with pytest.raises(ConfigError, match="X: expected an array of numbers"):
        shapes.floats("X", given)


def test_batches_broadcast_or_are_told():
    assert shapes.batch(X=(3, 1), D=(4,)) == (3, 4)
    with pytest.raises(ConfigError, match=r"X \(3,\), D \(4,\)"):
        shapes.batch(X=(3,), D=(4,))


def test_an_array_fits_where_it_broadcasts_to_the_shape():
    assert shapes.fits((), (3,)) and shapes.fits((1, 3), (2, 3))
    assert not shapes.fits((2, 3), (3,)) and not shapes.fits((2,), (3,))


def test_floats_are_float64():
    assert shapes.floats("X", torch.ones(2, dtype=torch.float32)).dtype == np.float64
