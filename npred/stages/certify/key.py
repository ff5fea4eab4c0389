"""What the key of a certificate holds."""

from typing import Any

from npred.config import Pipeline
from npred.stages.configuration import box, loop, networks, table

NO_LOOPS_OF_IT = ("scenarios", "map_D", "map_D_hat0")


def configuration(config: Pipeline, model: str | None, device: str) -> dict[str, Any]:
    """The table; the distribution of the data, from which fresh rollouts are drawn; the loops are as in [evaluate]."""
    loops = {key: value for key, value in loop(config, "evaluate").items() if key not in NO_LOOPS_OF_IT}
    tables = {"certify": table(config.optional("certify")), "evaluate": loops, "generate": loop(config, "generate")}
    return tables | networks(config) | box(config)
