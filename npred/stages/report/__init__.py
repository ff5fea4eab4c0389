"""All results as one HTML file; or as PDF, SVG and PNG, CSV and LaTeX."""

from typing import TYPE_CHECKING, Any

from npred.stages.declaration import Stage

if TYPE_CHECKING:
    from npred.stages.configuration import Slices

STAGE = Stage(
    __name__,
    version=9,
    upstream=("generate", "train", "evaluate", "certify", "bench"),
    result_class="npred.results:Reported",
)


def key(slices: "Slices") -> dict[str, Any]:
    """The whole pipeline, which the page shows, and its labels."""
    from npred.stages.configuration import table

    return {"pipeline": table(slices.config.beside())} | slices.notation
