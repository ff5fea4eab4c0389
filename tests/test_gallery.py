"""The gallery's examples: the README shows the first, the documentation's build runs all, and notebooks run too.

The build itself is in test_docs.py: an example that fails ends it.
"""

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from conftest import HERE, process_environment

ROOT = HERE.parent
EXAMPLES = sorted((ROOT / "docs" / "gallery").glob("[0-9]*.py"))
NOTEBOOKS = ("00_first_loop", "08_from_a_recording", "10_limits")


def test_the_readme_shows_the_first_example_as_it_is():
    shown = re.findall(r"```python\n(.*?)```", (ROOT / "README.md").read_text(), re.DOTALL)[0]
    assert EXAMPLES[0].read_text().endswith(shown)


def test_examples_and_the_readme_fit_eighty_columns():
    pages = [*EXAMPLES, ROOT / "README.md"]
    lines = [(page.name, line) for page in pages for line in page.read_text().splitlines()]
    assert [place for place in lines if len(place[1]) > 80] == []


@pytest.mark.slow
@pytest.mark.parametrize("name", NOTEBOOKS)
def test_an_example_runs_as_a_notebook_and_shows_its_picture(name: str, tmp_path: Path):
    pytest.importorskip("nbconvert")
    pytest.importorskip("ipykernel")
    gallery = pytest.importorskip("sphinx_gallery.py_source_parser")
    from sphinx_gallery.gen_gallery import DEFAULT_GALLERY_CONF
    from sphinx_gallery.notebook import jupyter_notebook

    path = ROOT / "docs" / "gallery" / f"{name}.py"
    _, text = gallery.split_code_and_text_blocks(path)
    cells = jupyter_notebook(text, DEFAULT_GALLERY_CONF, str(path.parent))
    (tmp_path / "example.ipynb").write_text(json.dumps(cells))
    convert = [sys.executable, "-m", "nbconvert", "--to", "notebook", "--execute", "example.ipynb", "--output", "done"]
    environment = process_environment(PATH=f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}")
    environment.pop("MPLBACKEND", None)  # the kernel's: pictures in the page
    done = subprocess.run(convert, cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    outputs = [
        output
        for cell in json.loads((tmp_path / "done.ipynb").read_text())["cells"]
        for output in cell.get("outputs", [])
    ]
    assert any("image/png" in output.get("data", {}) for output in outputs)
