"""Every command with its own flags; what it does is imported when it is called, so that `npred --help` is quick."""

from pathlib import Path
from typing import Annotated

import typer

from npred.cli.app import command
from npred.cli.options import Common, Planned, Work

RUN, LOOK, CARE = "Run", "Look", "Look after"


@command(RUN)
def run(options: Work) -> None:
    """All stages, in order, each from the store when its key is there."""
    from npred.cli import execute

    execute.everything(options)


@command(RUN)
def generate(options: Work) -> None:
    """Rollouts with the numerical predictor: the training data."""
    from npred.cli import execute

    execute.stage(options, "generate")


@command(RUN)
def train(
    options: Work,
    *,
    model: Annotated[str | None, typer.Option(help="deeponet or fno; those of the pipeline by default.")] = None,
) -> None:
    """The networks, each as an artifact of its own."""
    from npred.cli import execute

    execute.stage(options, "train", model)


@command(RUN)
def evaluate(options: Work) -> None:
    """Held-out errors and closed loops: eps and the convergence radius."""
    from npred.cli import execute

    execute.stage(options, "evaluate")


@command(RUN)
def bench(options: Work) -> None:
    """The time of a predictor call, each with its error beside it."""
    from npred.cli import execute

    execute.stage(options, "bench")


@command(LOOK)
def status(
    options: Planned,
    *,
    check: Annotated[bool, typer.Option("--check", help="Read every file; exit 3 unless all is fresh.")] = False,
) -> None:
    """What is fresh, stale or missing."""
    from npred.cli import look

    look.status(options, check)


@command(LOOK)
def why(options: Planned, *, stage: Annotated[str, typer.Argument(help="A stage, or a network.")]) -> None:
    """Why a stage would run again: what changed, before -> after."""
    from npred.cli import look

    look.why(options, stage)


@command(LOOK)
def show(
    options: Common,
    *,
    reference: Annotated[
        str | None, typer.Argument(metavar="STAGE/KEY", help="A key, a stage or a network; the latest by default.")
    ] = None,
) -> None:
    """What is inside a result: question, files, answer."""
    from npred.cli import look

    look.show(options, reference)


@command(LOOK)
def ls(options: Common) -> None:
    """Every result in the store, the most recent last."""
    from npred.cli import look

    look.ls(options)


@command(LOOK)
def diff(
    options: Common,
    *,
    a: Annotated[str, typer.Argument(metavar="A", help="An artifact, as for show.")],
    b: Annotated[str, typer.Argument(metavar="B", help="Another.")],
) -> None:
    """How two results differ: in their questions, and in their answers."""
    from npred.cli import look

    look.diff(options, a, b)


@command(LOOK)
def plants(options: Common) -> None:
    """The plants that are built in."""
    from npred.cli import look

    look.plants(options)


@command(CARE)
def gc(
    options: Common,
    *,
    pipelines: Annotated[
        list[Path] | None, typer.Argument(help="Pipelines whose results stay; all in pipeline/ by default.")
    ] = None,
    yes: Annotated[bool, typer.Option("--yes", help="Delete what the plan names.")] = False,
    device: Annotated[str, typer.Option(help="auto, cpu, cuda or cuda:N, as in the runs to keep.")] = "auto",
) -> None:
    """What no pipeline needs: the plan first, deleted with --yes."""
    from npred.cli import maintain

    maintain.gc(options, pipelines, yes, device)


@command(CARE)
def doctor(options: Common) -> None:
    """Versions, devices, threads and the store."""
    from npred.cli import maintain

    maintain.doctor(options)
