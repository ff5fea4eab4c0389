"""Sphinx's configuration; `make docs` builds docs/_build/html."""

import os
import sys
from pathlib import Path

HERE = Path(__file__).parent
os.environ["NPRED_QUIET"] = "1"  # in the gallery's outputs
sys.path[:0] = [str(HERE.parent), str(HERE.parent / "siblings"), str(HERE / "extensions")]

import npred  # noqa: E402

project, author, copyright = "npred", "The npred authors", "the npred authors, MIT licence"
version = release = npred.__version__

extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx_gallery.gen_gallery"]
extensions += ["docstrings", "hosted", "mathml", "play", "reference"]  # of docs/extensions
myst_enable_extensions = ["deflist", "dollarmath"]
myst_heading_anchors = 3
exclude_patterns = ["_build", "gallery", "reference/README.md"]

sphinx_gallery_conf = {
    "examples_dirs": "gallery",
    "gallery_dirs": "examples",
    "filename_pattern": "/",  # all are run
    "within_subsection_order": "FileNameSortKey",
    "capture_repr": (),  # the page has what is printed, not what its last line returns
    "download_all_examples": False,
    "write_computation_times": False,
    "min_reported_time": 1e9,
    "show_memory": False,
    "reset_modules": ("matplotlib",),
    "nested_sections": False,
    "remove_config_comments": True,
}

html_theme = "furo"
html_title = f"npred {release}"
html_static_path = ["_static"]
html_css_files = ["npred.css"]
html_math_renderer = "mathml"
html_copy_source = html_show_sourcelink = False
highlight_language = "none"
smartquotes = False  # two hyphens are a flag's, not a dash
pygments_style, pygments_dark_style = "a11y-light", "a11y-dark"

autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_preserve_defaults = True
python_use_unqualified_type_names = True
maximum_signature_line_length = 160
nitpicky = True
# Types of other projects: their documentation is not fetched, so that a build needs no network.
nitpick_ignore_regex = [
    ("py:.*", r"(numpy|np|torch|pathlib|collections|typing|pydantic|h5py|types)\..*|optional"),
    ("py:class", r"Neural|Fused|Onnx|npred\.(base\.registry\.Source|kernels\.kernel\.Kernel|loop\.loop\.\w+Parts)"),
    ("py:class", r"npred\.(laws\.policy\.Policy|identification\.identify\.Reading|exports\.FormatOptions)"),
    ("py:class", r"npred\.lab\.(config\..*|scheduler\.runs\.Kind|training\.operators\.scaling\.Scaling)"),
]
