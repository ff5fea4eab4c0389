"""What the commands do that run stages."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from npred import devices, executors
from npred.cli.options import Work
from npred.console import columns
from npred.errors import ConfigError
from npred.pipeline import STAGES, Node, Outcome, Planner, Runner, Step, networks, nodes
from npred.store import short

PAGE = "report.html"


@dataclass(frozen=True)
class Row:
    """A node's line in the answer."""

    node: Node
    key: str | None
    action: str
    reason: str
    seconds: float

    def json(self) -> dict[str, Any]:
        """As `--json` prints it."""
        row = {"stage": self.node.stage, "key": self.key, "action": self.action}
        model = {"model": self.node.model} if self.node.model else {}
        return row | model | {"reason": self.reason, "seconds": round(self.seconds, 3)}

    def cells(self) -> list[str]:
        """As people read it."""
        return [self.node.title, short(self.key or "-"), self.action, f"{self.seconds:.1f}", self.reason]


def everything(options: Work) -> None:
    """Every stage; the answer is that of evaluate and of bench together."""
    _work(options, list(STAGES), ("evaluate", "bench"))


def stage(options: Work, name: str, model: str | None = None, output: Path | None = None) -> None:
    """One stage with what it needs upstream; `model` keeps one network of the train stage, `output` is a page's file.

    Raises ConfigError for a network that there is none of.
    """
    if model is not None and model not in networks():
        raise ConfigError(f"--model: expected {' or '.join(networks())}, got {model!r}; name one of them")
    _work(options, [name], (name,), model, output)


def bring(options: Work, targets: list[str], model: str | None = None) -> list[Outcome]:
    """The targets and all that they need, from the store or run."""
    planner, wanted = _planner(options, targets), nodes(options.config, targets, model)
    jobs = options.jobs or devices.cores()
    options.results.remember(options.pipeline)  # also where the run is interrupted
    heading = f"{options.config.name} on {planner.device}"
    with (
        _recorded(options) as record,
        options.console.watch(heading, [node.title for node in wanted]),
        executors.opened(options.executor, jobs) as executor,
    ):
        outcomes = Runner(planner, options.console, jobs, executor).run(wanted)
        record(outcomes)
    if not options.set:  # what an override asks for, the file does not
        keys = {done.node.name: done.artifact.manifest.key for done in outcomes}
        options.results.remember(options.pipeline, keys)
    return outcomes


@contextmanager
def _recorded(options: Work) -> Iterator[Callable[[list[Outcome]], None]]:
    """TensorBoard's event files while the block runs; what it yields adds the trainings that the store had."""
    if options.tensorboard is None:
        yield lambda outcomes: None
        return
    from npred.events import Events

    options.console.events = events = Events(options.tensorboard)

    def record(outcomes: list[Outcome]) -> None:
        for done in outcomes:
            if done.node.stage == "train" and done.action == "hit":
                events.replay(done.node.title, done.artifact.folder / "metrics.jsonl")

    try:
        yield record
    finally:
        events.close()


def _work(
    options: Work, targets: list[str], answers: tuple[str, ...], model: str | None = None, output: Path | None = None
) -> None:
    if options.dry_run:
        rows = [_planned(step) for step in _planner(options, targets).plan(nodes(options.config, targets, model))]
        options.show(_document(rows, None), lambda: _table(rows))
        return
    outcomes = bring(options, targets, model)
    rows = [_done(outcome) for outcome in outcomes]
    final = [outcome for outcome in outcomes if outcome.node.stage in answers]
    page = publish(options, outcomes, output)
    if options.json:
        options.console.json(_document(rows, _result(final)) | ({"report": str(page)} if page else {}))
    else:
        _tell(options, rows, final, page)


def _planner(options: Work, targets: list[str]) -> Planner:
    planner = options.planner(frozenset(targets) if options.force else frozenset())
    devices.require(planner.device)
    return planner


def publish(options: Work, outcomes: list[Outcome], output: Path | None) -> Path | None:
    """Copy the page to `output`, by default to the pipeline's name in the store; None where no report was made.

    A store that cannot be written leaves it where it is. Raises ConfigError for an `output` that cannot be.
    """
    made = [outcome for outcome in outcomes if outcome.node.stage == "report"]
    if not made:
        return None
    path = output or options.store / f"{options.pipeline.stem}.html"
    aside = path.with_name(path.name + ".part")
    try:
        aside.write_bytes((made[-1].artifact.folder / PAGE).read_bytes())
        aside.replace(path)  # a browser that reads it meanwhile sees the old page or the new one
    except OSError as error:
        if output is None:
            return made[-1].artifact.folder / PAGE
        raise ConfigError(f"{path}: expected a file that can be written, got: {error.strerror}; name another") from None
    return path


def _planned(step: Step) -> Row:
    return Row(step.node, step.key, step.action, step.reason, 0.0)


def _done(outcome: Outcome) -> Row:
    return Row(outcome.node, outcome.artifact.manifest.key, outcome.action, outcome.reason, outcome.seconds)


def _document(rows: list[Row], result: dict[str, Any] | None) -> dict[str, Any]:
    return {"stages": [row.json() for row in rows], "result": result}


def _result(final: list[Outcome]) -> dict[str, Any]:
    merged: dict[str, Any] = {}
    for outcome in final:
        result = outcome.artifact.result()
        merged |= {outcome.node.model: result} if outcome.node.model else result
    return merged


def _table(rows: list[Row]) -> str:
    return columns(["stage", "key", "action", "seconds", "reason"], [row.cells() for row in rows])


def _tell(options: Work, rows: list[Row], final: list[Outcome], page: Path | None) -> None:
    options.console.out(_table(rows))
    for outcome in final:
        options.console.out(f"\n{outcome.node.title}: {outcome.artifact.folder}")
        options.console.out(STAGES[outcome.node.stage].summary(outcome.artifact.result()))
    if page:
        options.console.out(f"\nreport: {page}")
