"""Held-out errors and closed loops: eps and the convergence radius."""

from npred.stages.declaration import Stage

STAGE = Stage(
    __name__,
    version=16,
    upstream=("generate", "train"),
    result_class="npred.results:Evaluated",
)
