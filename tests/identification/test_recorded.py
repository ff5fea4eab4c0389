"""The columns of a recording in the plant's units."""

from pathlib import Path

import numpy as np
from test_identify import decay

from npred.identification.identify import recorded


def test_a_column_is_scaled_and_then_shifted(tmp_path: Path):
    """Degrees Fahrenheit to Celsius, and an input that is as it is."""
    (tmp_path / "log.csv").write_text("time,F,U\n0,32,1\n1,212,1\n2,50,3\n")
    log = recorded(decay(), tmp_path / "log.csv", {"X": "F"}, {"F": 5 / 9}, {"F": -160 / 9})
    np.testing.assert_allclose(log.Y[:, 0], [0, 100, 10], atol=1e-12)
    assert log.U[:, 0].tolist() == [1, 3]
