"""A bound of a network's error with a confidence, an adversary's search, and loops that the guard keeps."""

from npred.stages.declaration import Stage

STAGE = Stage(
    __name__,
    version=9,
    upstream=("generate", "train"),
    result_class="npred.results:Certified",
    data=r"(errors|worst)\.h5",
    draws=True,
    table_class="Certify",
)
