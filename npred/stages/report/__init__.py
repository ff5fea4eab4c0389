"""All results on one page."""

from npred.stages.declaration import Stage

STAGE = Stage(
    name="report",
    version=7,
    upstream=("generate", "train", "evaluate", "certify", "bench"),
    result_class="npred.results:Reported",
    help="All results as one HTML file; or as PDF, SVG and PNG, CSV and LaTeX.",
)
