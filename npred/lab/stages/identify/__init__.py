"""Estimate a plant's delay and parameters from a recording, with intervals."""

from typing import Any

from npred.lab.scheduler.declaration import Slices, Stage

STAGE = Stage(
    __name__,
    version=4,
    upstream=(),
    result_class="npred.lab.config.results:IdentifiedResult",
    table_class="npred.lab.stages.identify.table:Identify",
)


def key(slices: Slices) -> dict[str, Any]:
    """The table; the recordings enter by their content, and the measured outputs by their formulas."""
    from npred.lab.scheduler.configuration import content, table

    section = table(slices.config.optional("identify"))
    section["data"] = [content("identify.data", path) for path in slices.config.optional("identify").files]
    return {"identify": section, "outputs": list(slices.plant.outputs)} | slices.output
