"""A tiny pipeline through the real stages, once for all tests that look at its report."""

from pathlib import Path

from jobs import tables
from silent import Silent

from npred.lab import config
from npred.lab.config import dumps
from npred.lab.scheduler.plan import Planner, nodes, usual
from npred.lab.scheduler.runner import Outcome, Runner
from npred.lab.store import Store

MAP = {
    "map_D": [0.5, 1.0],
    "map_D_hat": [0.8, 1.2, 2.0],
    "case_t_end": 4.0,
    "t_end": 3.0,
    "figure_bounds": [[-9.0, 9.0]],
}
REDRAW = {"redraw": 0.25}  # rows of two kinds are held out
BENCH = {"dx": [0.1], "calls": 10, "batches": [1]}


def run(folder: Path) -> tuple[Path, dict[str, Outcome]]:
    """The pipeline's file beside its store, and what became of each node."""
    path = folder / "tiny.toml"
    path.write_text(dumps({"name": "tiny"} | tables(evaluate=MAP, bench=BENCH, generate=REDRAW)))
    made = config.load(path)
    planner = Planner(made, Store(folder / "store"), "cpu")
    console: object = Silent()
    outcomes = Runner(console, jobs=1).run(planner, nodes(made, usual(made)))  # type: ignore[arg-type]
    return path, {outcome.node.name: outcome for outcome in outcomes}
