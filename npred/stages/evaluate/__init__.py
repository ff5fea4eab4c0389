"""Errors of networks, and closed loops."""

from npred.stages.declaration import Stage

STAGE = Stage(
    name="evaluate",
    version=12,
    upstream=("generate", "train"),
    result_class="npred.results:Evaluated",
    help="Held-out errors and closed loops: eps and the convergence radius.",
    data=r"(errors|figure1|coverage)\.h5",
    draws=True,
)
