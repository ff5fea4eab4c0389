"""Bound a network's error by fresh rollouts, search for its worst inputs, and test its guard."""

from npred.stages.declaration import Stage

STAGE = Stage(
    __name__,
    version=10,
    upstream=("generate", "train"),
    result_class="npred.results:Certified",
    table_class="Certify",
)
