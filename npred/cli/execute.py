"""The commands that run stages."""

from collections.abc import Callable, Sequence
from contextlib import ExitStack, closing
from pathlib import Path
from typing import Annotated

from npred.base import devices
from npred.base.errors import ConfigError, room_on_disk, unlisted
from npred.base.registry import declared_stage
from npred.cli.options import Staged, Trains, Work, flag, writable_folder
from npred.cli.report import free_path, is_complete, place, publish, sign, write_figures
from npred.lab.config.results import Benched, Evaluated, Reported
from npred.lab.report.figures.style import MEDIA
from npred.lab.report.terminal.console import Events, columns
from npred.lab.scheduler import executors
from npred.lab.scheduler.plan import STAGES, Planner, Step, nodes, usual
from npred.lab.scheduler.retention import remember
from npred.lab.scheduler.runner import Outcome, Runner
from npred.lab.store import short


def run(options: Trains) -> None:
    """Every stage; the answer is that of evaluate and of bench together, and for people how it all ends."""
    _work(options, None)


def stage_command(stage: str) -> Callable[..., None]:
    """The command that runs one stage with the stages before it; of a stage per network, of one or of all."""

    def of_networks(
        options: Trains,
        *,
        model: Annotated[str | None, flag("A network, as deeponet; by default all of the pipeline.")] = None,
    ) -> None:
        if model is not None and model not in (names := options.config.train.names):
            raise ConfigError(unlisted("--model", model, names))
        _work(options, stage, model)

    def of_all(options: Work) -> None:
        _work(options, stage)

    def after_training(options: Trains) -> None:
        _work(options, stage)

    declared = declared_stage(stage)
    return of_networks if declared.per_network else after_training if "train" in declared.upstream else of_all


def bench(
    options: Trains,
    *,
    no_networks: Annotated[
        bool,
        flag(
            "Train nothing: say from the cost of f if a network could pay. PIPELINE may be my_plant.py:Tank.",
            "--no-networks",
        ),
    ] = False,
) -> None:
    """The stage, or without networks whether one could pay for a plant; then nothing is trained or stored."""
    if not no_networks:
        _work(options, "bench")
        return
    from npred import plants
    from npred.lab import config
    from npred.lab.scheduler import sources
    from npred.lab.stages.bench import without_networks

    source = options.pipeline_name or options.pipeline
    table = sources.table(source)
    for text in options.set or []:
        config.override(table, text)
    pipeline = config.parse(table, str(source))
    plant = plants.resolve(*pipeline.of_plant)
    measured = without_networks.measure(pipeline, plant)
    options.show(measured.json_object(), lambda: without_networks.summary(measured, options.console.width))


def report(
    options: Trains,
    *,
    output: Annotated[Path | None, flag("The HTML file, or the folder for the figures.", "-o", "--output")] = None,
    figures: Annotated[
        str | None, flag("Write figures and tables for a paper instead of the page.", word="|".join(MEDIA))
    ] = None,
) -> None:
    """The page, or for a medium of print its figures and tables, as files. Raises ConfigError for no such medium."""
    if figures is None or options.dry_run:
        _work(options, "report", output=output)
        return
    from npred import plants
    from npred.lab.stages.report.report import PipelineResults

    if figures not in MEDIA:
        raise ConfigError(unlisted("--figures", figures, MEDIA))
    default = free_path(options, options.pipeline.stem, lambda name: options.store / f"{name}-{figures}")
    folder = writable_folder(output or default, "figures")
    folders = {done.node.name: done.artifact.folder for done in bring(options, ["evaluate", "bench"], borrows=True)}
    plant = plants.resolve(*options.config.of_plant)
    results = PipelineResults(options.config, plant, folders)
    with room_on_disk(folder):
        files = write_figures(results, folder, MEDIA[figures])
        if output is None:
            sign(options, folder)
    document = {"folder": str(folder), "files": [file.name for file in files]}
    options.show(document, lambda: "\n".join(map(str, files)))


def bring(
    options: Staged, targets: list[str], model: str | None = None, borrows: bool = False,
    so_far: Callable[[Path], object] | None = None,
) -> list[Outcome]:  # fmt: skip
    """The targets and all that they need, from the store or run; `borrows` as for Planner, `so_far` for Runner."""
    needed, jobs, console = nodes(options.config, targets, model), options.jobs or devices.cores(), options.console
    with ExitStack() as stack:
        if folder := getattr(options, "tensorboard", None):
            console.events = stack.enter_context(closing(Events(folder)))
        stack.enter_context(console.watch(options.config.name, [node.title for node in needed]))
        executor = stack.enter_context(executors.opened(getattr(options, "executor", executors.LOCAL), jobs))
        planner = _planner(options, targets, borrows)  # on the screen already: to look for a GPU imports torch
        console.head(f"{options.config.name} on {planner.device}")
        remember(options.results, options.pipeline)  # also where the run is interrupted
        console.keep_log(options.store, options.pipeline.stem)
        outcomes = Runner(console, jobs, executor, so_far).run(planner, needed)
        for done in outcomes:
            if console.events and done.node.stage == "train" and done.action == "hit":
                console.events.replay(done.node.title, done.artifact.folder / "metrics.jsonl")
    if not options.set:  # what an override asks for, the file does not
        keys = {done.node.name: done.artifact.manifest.key for done in outcomes}
        remember(options.results, options.pipeline, keys)
    return outcomes


def _work(options: Work, stage: str | None, model: str | None = None, output: Path | None = None) -> None:
    """Run a stage, or without one all, and say what came out."""
    targets = [stage] if stage else usual(options.config)
    if options.dry_run:
        steps = _planner(options, targets).plan(nodes(options.config, targets, model))
        options.show(_document(steps, None), lambda: _table(options, steps))
        return
    path = place(options, output) if "report" in targets else None

    def written(folder: Path) -> Path | None:
        return path and publish(options, folder, path, asked=output is not None)

    def so_far(folder: Path) -> None:
        options.console.note(f"the report so far, which stages complete as they end: {written(folder)}")

    kept = path is not None and is_complete(path)  # until there is a new page as complete
    outcomes = bring(options, targets, model, so_far=None if kept else so_far)
    final = [outcome for outcome in outcomes if outcome.node.stage in ([stage] if stage else ["evaluate", "bench"])]
    page = written(outcomes[-1].artifact.folder)
    if options.json:
        result: dict[str, object] = {}
        for outcome in final:
            answer = outcome.artifact.result()
            result |= {outcome.node.model: answer} if outcome.node.model else answer
        options.console.json(_document(outcomes, result) | ({"report": str(page)} if page else {}))
        return
    lines = [_table(options, outcomes)] if options.wide else []
    if stage is None and not options.wide:  # the report's sentences, and a table of the predictors
        from npred.lab.stages.bench import bench
        from npred.lab.stages.report import tables

        folders = {outcome.node.stage: outcome.artifact.folder for outcome in outcomes}
        times = bench.fastest(Benched.read(folders["bench"]), options.config.evaluate.predictor)
        table = tables.predictors(Evaluated.read(folders["evaluate"]), times).terminal(options.console.width)
        lines.append("\n\n".join([*Reported.read(folders["report"]).summary, table]) + "\n")
    else:
        for outcome in final:
            artifact = outcome.artifact
            lines.append(STAGES[outcome.node.stage].summary(artifact.result(), options.console.width, options.wide))
            lines.append(f"\n{outcome.node.title}: {artifact.folder if options.wide else artifact.name}")
    options.console.out("\n".join([*lines, *([f"report: {page}"] if page else [])]))


def _planner(options: Staged, targets: list[str], borrows: bool = False) -> Planner:
    """A stage that is asked for is timed here; a report, which only draws times, takes those that there are."""
    planner = options.planner(frozenset(targets) if options.force else frozenset(), borrows or "bench" not in targets)
    devices.require(planner.device)
    return planner


def _document(stages: Sequence[Step | Outcome], result: dict[str, object] | None) -> dict[str, object]:
    rows = []
    for stage in stages:
        model = {"model": stage.node.model} if stage.node.model else {}
        row = {"stage": stage.node.stage, "key": stage.key, "action": stage.action} | model
        seconds = None if stage.seconds is None else round(stage.seconds, 3)
        rows.append(row | {"reason": stage.reason, "seconds": seconds})
    return {"stages": rows, "result": result}


def _table(options: Work, stages: Sequence[Step | Outcome]) -> str:
    times = ["–" if s.seconds is None else f"{s.seconds:.1f}" for s in stages]
    column = "s last time" if options.dry_run else "seconds"
    head = ["stage", "key", "action", column, "reason"]
    rows = [[s.node.title, short(s.key or "-"), s.action, t, s.reason] for s, t in zip(stages, times, strict=True)]
    if all(s.seconds is None for s in stages):  # a plan of what never ran
        head, rows = [*head[:3], head[4]], [[*row[:3], row[4]] for row in rows]
    return columns(head, rows, options.console.width, {column})
