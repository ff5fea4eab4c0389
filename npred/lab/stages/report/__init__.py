"""Write all results to one HTML file; or as PDF, SVG and PNG, CSV and LaTeX."""

from typing import Any

from npred.lab.scheduler.declaration import Slices, Stage

STAGE = Stage(
    __name__,
    version=10,
    upstream=("generate", "train", "evaluate", "certify", "bench"),
    result_class="npred.lab.config.results:Reported",
)
UNFINISHED = "This page is not complete."  # on one that is written while its run goes on


def key(slices: Slices) -> dict[str, Any]:
    """The whole pipeline, which the page shows, and its labels."""
    from npred.lab.scheduler.configuration import table

    return {"pipeline": table(slices.config.with_file_names())} | slices.notation
