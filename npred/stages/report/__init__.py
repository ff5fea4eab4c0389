"""All results as one HTML file; or as PDF, SVG and PNG, CSV and LaTeX."""

from npred.stages.declaration import Stage

STAGE = Stage(
    __name__,
    version=9,
    upstream=("generate", "train", "evaluate", "certify", "bench"),
    result_class="npred.results:Reported",
)
