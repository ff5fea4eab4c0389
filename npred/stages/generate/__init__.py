"""The training data: rollouts with the numerical predictor."""

from npred.stages.declaration import Stage

STAGE = Stage(
    name="generate",
    version=3,
    upstream=(),
    result_class="npred.results:Generated",
    help="Rollouts with the numerical predictor: the training data.",
    data=r"data(-\d{5,})?\.h5",
)
