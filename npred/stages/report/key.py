"""What the key of a page holds."""

from typing import Any

from npred.config import Pipeline
from npred.stages.configuration import gamma, notation, table


def configuration(config: Pipeline, model: str | None, device: str) -> dict[str, Any]:
    """The whole pipeline, which the page shows, and its labels."""
    pipeline = table(config.beside())
    for stage in ("generate", "evaluate"):
        if pipeline[stage]["u0"] is None:
            del pipeline[stage]["u0"]
        pipeline[stage]["gamma"] = gamma(config, getattr(config, stage))
    return {"pipeline": pipeline} | notation(config)
