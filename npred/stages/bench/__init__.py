"""The time of a predictor call."""

from npred.stages.declaration import Stage

STAGE = Stage(
    name="bench",
    version=10,
    upstream=("generate", "train"),
    result_class="npred.results:Benched",
    help="The time of a predictor call, each with its error beside it.",
    data=r"times\.h5",
    draws=True,
)
