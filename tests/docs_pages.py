"""The extensions of the documentation, for tests."""

import subprocess
import sys
from pathlib import Path

from conftest import HERE, process_environment

DOCS = HERE.parent / "docs"
sys.path.append(str(DOCS / "extensions"))


def built(name: str, extension: str, folder: Path) -> Path:
    """The HTML of one page of docs/, built without the others, to which its links lead nowhere."""
    source = folder / "source"
    source.mkdir()
    (source / f"{name}.md").write_text((DOCS / f"{name}.md").read_text(encoding="utf-8"), encoding="utf-8")
    settings = {
        "extensions": f"myst_parser,{extension}", "html_theme": "furo", "root_doc": name,
        "html_static_path": str(DOCS / "_static"), "html_css_files": "npred.css",
        "suppress_warnings": "myst.xref_missing",
    }  # fmt: skip
    words = [word for key, value in settings.items() for word in ("-D", f"{key}={value}")]
    environment = process_environment(PYTHONPATH=f"{HERE.parent}:{DOCS / 'extensions'}")
    command = [sys.executable, "-m", "sphinx", "-q", "-W", "-C", *words, str(source), str(folder / "html")]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    return folder / "html" / f"{name}.html"
