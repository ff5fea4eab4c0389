"""What the commands do that run stages."""

from dataclasses import dataclass
from typing import Any

from npred import devices, executors
from npred.cli.options import Work
from npred.console import columns
from npred.errors import ConfigError
from npred.pipeline import STAGES, Node, Outcome, Runner, Step, networks, nodes
from npred.store import short


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


def stage(options: Work, name: str, model: str | None = None) -> None:
    """One stage with what it needs upstream; `model` keeps one network of the train stage.

    Raises ConfigError for a network that there is none of.
    """
    if model is not None and model not in networks():
        raise ConfigError(f"--model: expected {' or '.join(networks())}, got {model!r}; name one of them")
    _work(options, [name], (name,), model)


def _work(options: Work, targets: list[str], answers: tuple[str, ...], model: str | None = None) -> None:
    planner = options.planner(frozenset(targets) if options.force else frozenset())
    wanted = nodes(options.config, targets, model)
    devices.require(planner.device)
    if options.dry_run:
        rows = [_planned(step) for step in planner.plan(wanted)]
        options.show(_document(rows, None), lambda: _table(rows))
        return
    jobs = options.jobs or devices.cores()
    with executors.opened(options.executor, jobs) as executor:
        outcomes = Runner(planner, options.console, jobs, executor).run(wanted)
    rows = [_done(outcome) for outcome in outcomes]
    final = [outcome for outcome in outcomes if outcome.node.stage in answers]
    if options.json:
        options.console.json(_document(rows, _result(final)))
    else:
        _report(options, rows, final)


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


def _report(options: Work, rows: list[Row], final: list[Outcome]) -> None:
    options.console.out(_table(rows))
    for outcome in final:
        options.console.out(f"\n{outcome.node.title}: {outcome.artifact.folder}")
        options.console.out(STAGES[outcome.node.stage].summary(outcome.artifact.result()))
