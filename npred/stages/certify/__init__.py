"""What is known of a network: a bound with a confidence, an adversary's search, loops with and without the guard."""

from npred.stages.declaration import Stage

STAGE = Stage(
    name="certify",
    version=5,
    upstream=("generate", "train"),
    result_class="npred.results:Certified",
    help="A bound of a network's error with a confidence, an adversary's search, and loops that the guard keeps.",
    data=r"(errors|worst)\.h5",
    draws=True,
    table_class="npred.stages.certify.table:Certify",
)
