"""The command `npred rig`, as the command line declares it: its work is imported when it is called."""

from pathlib import Path
from typing import Annotated

from npred.cli.options import flag
from npred_rig.options import Rigged


def rig(
    options: Rigged,
    *,
    log: Annotated[Path | None, flag("Write the log here; by default NAME-rig.csv.", word="FILE.csv")] = None,
    figure: Annotated[Path | None, flag("Draw the log: SVG, PDF or PNG.", word="FILE")] = None,
) -> None:
    """Run plant and controller of [evaluate] as two processes on a real clock, with a network between them."""
    from npred_rig.rig import rig

    rig(options, log, figure)
