"""The networks, one artifact per network."""

from npred.stages.declaration import Stage

STAGE = Stage(
    __name__,
    version=2,
    upstream=("generate",),
    result_class="npred.results:Trained",
    per_network=True,
    needs="torch",
    summary_module="summary",
)
