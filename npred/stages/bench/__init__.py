"""The time of a predictor call, each with its error beside it."""

from npred.stages.declaration import Stage

STAGE = Stage(
    __name__,
    version=12,
    upstream=("generate", "train"),
    result_class="npred.results:Benched",
)
