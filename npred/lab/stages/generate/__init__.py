"""Make the training data: loops with a numerical predictor."""

from pathlib import Path
from typing import Any

from npred.lab.scheduler.declaration import Slices, Stage

STAGE = Stage(__name__, version=5, upstream=(), result_class="npred.lab.config.results:Generated")


def key(slices: Slices) -> dict[str, Any]:
    """The table; data of a file enter by their content."""
    from npred.lab.scheduler.configuration import content

    section = slices.loop("generate")
    if section["data"]:
        section["data"] = content("generate.data", Path(section["data"]))
    return {"generate": section}
