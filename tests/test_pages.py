"""benchmarks/pages.py: which commands and figures of a page it sees, and that a stale figure is one."""

import subprocess
import sys
from pathlib import Path

import pages
import pytest
from conftest import HERE

FILE = HERE.parent / "benchmarks" / "pages.py"

PAGE = """# A page

`npred tune` says 9.9 and 3.4·10⁻³ (`python benchmarks/laws.py`, 2.5 µs; not `python benchmarks/laws.py MODEL`):

| a | 1.25e-3 |
|---|---|
| b: `python benchmarks/defaults.py` | 0.5 |
| c | −0.75 |

## Below

It is 7.7. `npred gc --yes` and `make test` are not run.

```sh
npred plants check \\
    cart_pole   # 3.3
make smoke
```

```text
rest 1.5
```
"""


def test_commands_have_the_figures_of_their_paragraph_row_and_what_follows():
    first, second, third = pages.named(PAGE)
    assert first.commands == ["python benchmarks/laws.py"]
    assert first.figures == [("9.9", False), ("3.4e-3", False), ("2.5", True), ("1.25e-3", False)]
    assert second.commands == ["python benchmarks/defaults.py"] and second.figures == [("0.5", False), ("−0.75", False)]
    assert third.commands == ["npred plants check      cart_pole", "make smoke"] and third.figures == [("1.5", False)]


@pytest.mark.parametrize(
    ("figure", "timing", "printed", "side"),
    [
        ("1.25e-3", False, [0.001254], "reprinted"),
        ("1.25e-3", False, [0.001245], "reprinted"),
        ("1.25e-3", False, [0.00126], "differs"),
        ("18.9", False, [18.87], "reprinted"),
        ("15.5", False, [18.87], "differs"),
        ("15.5", False, [99.0], "not printed"),
        ("−0.6068", False, [0.60683], "reprinted"),
        ("−0.6068", False, [0.6069], "differs"),
        ("1.2", False, [0.012], "reprinted"),
        ("1.2", False, [0.0126], "differs"),
        ("2.5", True, [3.1], "reprinted"),
        ("2.5", True, [3.2], "differs"),
    ],
)
def test_a_figure_is_reprinted_by_a_number_that_rounds_to_it_and_a_timing_within_a_quarter(
    figure, timing, printed, side
):
    assert pages.verdict(figure, timing, printed) == side


def test_a_stale_figure_or_a_command_too_long_ends_with_1_and_a_page_without_one_with_0(tmp_path: Path):
    """The margins of `scalar`, D = 1, are (-0.8342, 0.3729): D_hat from 0.1658 to 1.373."""
    page = tmp_path / "page.md"
    page.write_text("D̂ from 0.1658 to 1.473 (`npred plants check scalar --delay 1`).\n")
    found = [
        subprocess.run([sys.executable, str(FILE), str(page), *more], capture_output=True, text=True, timeout=300)
        for more in ([], ["--only", "bench"], ["--longest", "0.01"])
    ]
    assert [done.returncode for done in found] == [1, 0, 1], found[0].stdout
    assert "TOO LONG" in found[2].stdout and "1 failed" in found[2].stdout
    assert "differs      1.473" in found[0].stdout and "reprinted    0.1658" in found[0].stdout
