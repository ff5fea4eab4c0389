"""The delay and the parameters of a plant by a recording of it, and what the recording does not tell."""

from npred.stages.declaration import Stage

STAGE = Stage(
    __name__,
    version=1,
    upstream=(),
    result_class="npred.results:IdentifiedResult",
    table_class="Identify",
)
