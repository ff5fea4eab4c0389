"""Bound a network's error by fresh rollouts, search for its worst inputs, and test its guard."""

from typing import Any

from npred.base import registry
from npred.lab.scheduler.declaration import Slices, Stage

STAGE = Stage(
    __name__,
    version=14,
    upstream=("generate", "train"),
    result_class="npred.lab.config.results:Certified",
    table_class="npred.lab.stages.certify.table:Certify",
)
NO_LOOPS_OF_IT = ("scenarios", "map_D", "map_D_hat")


def key(slices: Slices) -> dict[str, Any]:
    """The table; the distribution of the data, from which fresh rollouts are drawn; the loops are as in [evaluate]."""
    from npred.lab.scheduler.configuration import table

    loops = {name: value for name, value in slices.loop("evaluate").items() if name not in NO_LOOPS_OF_IT}
    tables = {"certify": table(slices.config.optional("certify")), "evaluate": loops}
    searches = [registry.CERTIFICATES.identity(name) for name in registry.CERTIFICATES.names()]  # by packages
    tables |= {"generate": slices.loop("generate"), "certificates": searches}
    return tables | slices.networks | slices.box
