"""Loops that ended since commands would overtake each other, 1 - D_X f - D_t <= 0, and the warning about them."""

from collections.abc import Mapping
from typing import NamedTuple

from npred.loop.closed_loop import Trajectories
from npred.loop.trajectory_views import infeasible
from npred.results import Contender
from npred.terminal.console import Console


class Ended(NamedTuple):
    """The number of loops that ended, and step, state and margin of the first, in words; 0 and nothing if none did."""

    count: int
    where: str


def ended(loops: Trajectories) -> Ended:
    """Those of a batch of loops."""
    return Ended(int((loops.infeasible >= 0).sum()), " ".join(infeasible(loops) or ()))


def warn(progress: Console, by_contender: Mapping[Contender, Ended], scenario: str = "") -> None:
    """One warning for all contenders, of a scenario if one is named; none where no loop ended."""
    each = [(contender, loops) for contender, loops in by_contender.items() if loops.count]
    if each:
        counts = ", ".join(f"{loops.count} of {contender.label}" for contender, loops in each)
        where = f'in the scenario "{scenario}" ' if scenario else ""
        what = f"{where}loops in which commands would overtake each other count as lost"
        progress.warn(f"{what}: {counts}; {each[0][1].where}")
