"""Rollouts with the numerical predictor: the training data."""

from npred.stages.declaration import Stage

STAGE = Stage(
    __name__,
    version=4,
    upstream=(),
    result_class="npred.results:Generated",
)
