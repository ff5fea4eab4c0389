"""The files of each stage's result: which may come in from elsewhere, and which are drawn again here.

A figure can carry a script (SVG, HTML) or a command (LaTeX), and all of them follow from the arrays beside them. So of
a result from elsewhere arrays, weights and JSON are taken, figures and tables for print are left out, and a name that
the stage does not give refuses the whole.
"""

import re

from npred.defaults import RESULT
from npred.errors import StoreError
from npred.pipeline.experiments import STAGE
from npred.pipeline.stage_registry import STAGES
from npred.store import Manifest

DRAWN = re.compile(r"[a-z][a-z0-9_]*\.(svg|png|pdf|tex)")


def drawn(manifest: Manifest) -> frozenset[str]:
    """The files of a result that are drawn from its others.

    Raises StoreError for a result of another stage, a page among them, and for a file that its stage does not write.
    """
    stage = manifest.question.stage
    if stage == "report":
        raise StoreError("expected a result, got a page; npred report makes it anew from its results")
    if stage == STAGE:
        raise StoreError("expected a result of a pipeline, got an experiment; npred reproduce measures it here")
    if stage not in STAGES:
        names = ", ".join(name for name, entry in STAGES.items() if entry.data)
        raise StoreError(f"expected a result of {names}, got one of {stage}; this npred has no such stage")
    entry = STAGES[stage]
    others = [name for name in manifest.files if name != RESULT and not re.fullmatch(entry.data, name)]
    for name in others:
        if not entry.draws or not DRAWN.fullmatch(name):
            raise StoreError(f"expected the files of a result of {stage}, got {name} among them; export it anew")
    return frozenset(others)
