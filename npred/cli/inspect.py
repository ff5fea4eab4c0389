"""The commands that look at a pipeline or at the store, and change nothing."""

import time
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated

from npred.base.errors import ConfigError, NpredError, UnmetError, unlisted
from npred.base.json_files import escaped
from npred.base.registry import RESOLVERS
from npred.cli.options import Common, Planned, argument, drawable, flag
from npred.lab.report.terminal.console import columns
from npred.lab.scheduler.plan import STAGES, Step, nodes, usual
from npred.lab.scheduler.reasons import changes, differences, flat
from npred.lab.store import Artifact, short


def status(
    options: Planned,
    *,
    check: Annotated[bool, flag("Read every file; exit 3 unless all results are fresh.", "--check")] = False,
) -> None:
    """The state of every node; `check` reads every file and raises UnmetError unless all is fresh."""
    steps = options.planner().plan(nodes(options.config, usual(options.config)))
    for step in steps if check else ():
        if step.artifact:
            step.artifact.verify()
    rows = [[s.node.title, short(s.key or "-"), s.state, s.reason.removeprefix(f"{s.state}: ")] for s in steps]
    document = {"stages": [_step(step) for step in steps]}
    options.show_table(document, ["stage", "key", "state", "reason"], rows)
    late = [step.node.title for step in steps if step.state != "fresh"]
    if check and late:
        raise UnmetError(f"expected every stage fresh, got {', '.join(late)} not; run npred run {options.pipeline}")


def why(options: Planned, *, stage: Annotated[str, argument(None, "A stage, or a network.")]) -> None:
    """The reason of a stage, a network, or a package's result without a pipeline; else raises ConfigError."""
    brought = map(RESOLVERS.installed, RESOLVERS.names())
    planners = [planner for module in brought for planner in module.planners(options.results, stage)]
    asked = [step for planner in planners for step in planner.plan(planner.nodes())]
    if not asked and stage.endswith(".toml"):
        raise ConfigError(f"why: expected a stage or a network, got a pipeline; write npred why train {stage}")
    if not asked:
        steps = options.planner().plan(nodes(options.config, usual(options.config)))
        asked = [step for step in steps if stage in (step.node.stage, step.node.model)]
        if not asked:
            names = dict.fromkeys(name for s in steps for name in (s.node.stage, s.node.name))
            raise ConfigError(unlisted("why", stage, names))
    document = {"stages": [_step(step) for step in asked]}
    options.show(document, lambda: "\n".join(f"{step.node.title}: {step.reason}" for step in asked))


def show(
    options: Common,
    *,
    reference: Annotated[
        str | None, argument("STAGE/KEY", "A key, a stage or a network; the latest by default.")
    ] = None,
) -> None:
    """A result, verified: manifest and answer."""
    artifacts = [options.results.find(reference)] if reference else options.results.artifacts()
    if not artifacts:
        raise ConfigError(f"show: expected a result in {options.store}, got an empty store; run npred run")
    artifact = artifacts[-1].verify()
    result = artifact.result()
    document = {"folder": str(artifact.folder), "manifest": artifact.manifest.model_dump(), "result": result}
    manifest = artifact.manifest
    circumstances = ", ".join(f"{name} {value}" for name, value in manifest.circumstances.items() if value)
    facts = [
        f"{artifact.name}  {artifact.folder}",
        *(f"  {name}  {file.size} bytes" for name, file in manifest.files.items()),
        *(f"  from {name}: {short(source.key)}" for name, source in manifest.question.inputs.items()),
        *(f"  {line.replace(': unset ->', ' =')}" for line in changes({}, manifest.question.config)),
        f"  made with {circumstances}",
    ]
    stage, width = manifest.question.stage, options.console.width
    options.show(document, lambda: "\n".join([*facts, _summary(stage, result, width)]))


def ls(
    options: Common,
    *,
    shown: Annotated[
        list[str] | None, flag("A setting to show as a column, as seed; repeatable.", "--show", word="KEY")
    ] = None,
) -> None:
    """Every result with a sound manifest and, of the keys to show, its settings; a warning for each of the others."""
    shown, (artifacts, broken) = shown or [], options.results.survey()
    for folder in broken:
        options.console.warn(f"{folder}: expected a sound manifest, got none; remove that folder")
    by_key = {artifact.manifest.key: artifact for artifact in artifacts}
    settings = [{key: _setting(artifact, key, by_key) for key in shown} for artifact in artifacts]
    digest = ["digest"] if options.console.width is None else []  # a screen has no room for it
    header = ["artifact", "model", "pipeline", "made", "size", *digest, *shown]
    rows = [
        [
            a.name, a.manifest.question.model or "-", a.manifest.pipeline,
            time.strftime("%Y-%m-%d %H:%M", time.localtime(a.made)), f"{a.size / 1e6:.1f} MB",
            *(short(a.manifest.digest) for _ in digest), *(s[key] or "-" for key in shown),
        ]
        for a, s in zip(artifacts, settings, strict=True)
    ]  # fmt: skip
    entries = [
        {
            "stage": a.manifest.question.stage, "model": a.manifest.question.model, "key": a.manifest.key,
            "pipeline": a.manifest.pipeline, "digest": a.manifest.digest, "bytes": a.size,
            "folder": str(a.folder), "made": datetime.fromtimestamp(a.made, UTC).isoformat(), "settings": s,
        }
        for a, s in zip(artifacts, settings, strict=True)
    ]  # fmt: skip
    options.show_table({"artifacts": entries}, header, rows)


def diff(
    options: Common,
    *,
    a: Annotated[str, argument("A", "A result, named as for show.")],
    b: Annotated[str, argument("B", "Another result.")],
) -> None:
    """The differences of two results."""
    left, right = (options.results.find(reference).verify() for reference in (a, b))
    before, after = left.manifest, right.manifest
    asked = differences(before.question, after.question)
    answered = changes(left.result(), right.result())
    kinds = [" ".join(filter(None, (each.question.stage, each.question.model))) for each in (before, after)]
    folders = {"a": str(left.folder), "b": str(right.folder)}
    made_with = changes(before.circumstances, after.circumstances)
    names = sorted(name for name in before.files | after.files if before.files.get(name) != after.files.get(name))
    files = [] if asked or kinds[0] != kinds[1] else names  # two answers to one question
    answer = {"stages": kinds, "question": asked, "result": answered, "files": files, "made_with": made_with}
    document = folders | answer
    across = [f"these are results of different stages: {kinds[0]} and {kinds[1]}"] if kinds[0] != kinds[1] else []
    lines = [*across, *asked, *(f"result.{line}" for line in answered), *(f"file {name} differs" for name in files)]
    lines = lines or [f"{left.name} and {right.name}: no difference"]
    options.show(document, lambda: "\n".join([*lines, *(f"made with {line}" for line in made_with)]))


def plants(options: Common) -> None:
    """The plants that are built in, and those of installed packages."""
    from npred.plants import named

    listed, rows = named(), []
    for plant in listed:
        if "error" in plant:
            options.console.warn(plant["error"])
            continue
        parameters = " ".join(f"{name}={value:g}" for name, value in plant["parameters"].items())
        rows.append([plant["name"], ", ".join(plant["states"]), ", ".join(plant["inputs"]), parameters])
    options.show_table({"plants": listed}, ["plant", "states", "inputs", "parameters"], rows)


def check(
    options: Common,
    *,
    plant: Annotated[str, argument("PLANT", "A name, a file as my_plant.py:Tank, or a pipeline as tank.toml.")],
    delay: Annotated[
        float | None,
        flag(
            "The largest delay to predict over, in the plant's unit of time; by default the pipeline's or the plant's."
        ),
    ] = None,
    nx: Annotated[
        int | None, flag("Nodes of the prediction (101 is dx = 0.01); by default the pipeline's, else 101.")
    ] = None,
    kappa: Annotated[
        str, flag("Take a law designed from f, as lqr, instead of the plant's, and print it for your file.", word="LAW")
    ] = "",
    u0: Annotated[
        str | None, flag("The input before t = 0: equilibrium, law, or numbers as [0.5].", word="VALUE")
    ] = None,
    figure: Annotated[Path | None, flag("Draw the delay margin: SVG, PDF or PNG.", word="FILE")] = None,
) -> None:
    """Every question about a plant, or about that of a pipeline, with its answer; the law `kappa` in place of its law,
    and the text of that to be pasted; a `figure` of the delay margin; `u0` as in a pipeline. Raises UnmetError where an
    answer is no.
    """
    from npred import diagnosis, plants
    from npred.lab import config
    from npred.lab.scheduler import pipeline_fit

    pipeline = config.load(Path(plant)) if plant.endswith(".toml") else None
    name, parameters, law, delays = pipeline.of_plant if pipeline else (plant, {}, "", None)
    asked, plot = plants.resolve(name, parameters, kappa or law, delays), figure and drawable(figure)
    shown: list[diagnosis.Answer] = []
    head = "question".ljust(max(len(question.name) for question in diagnosis.QUESTIONS)), "answer", "found"

    def said(answer: diagnosis.Answer) -> None:
        """Print a row as soon as it is known, the first one below the head."""
        lines = columns(head, [answer[:3]], options.console.width).splitlines()
        if not options.json:
            options.console.out("\n".join(lines[bool(shown) :]))
        shown.append(answer)

    settings = {"delay": delay, "nx": nx, "u0": u0 and config.value(u0), "said": said}
    answers = pipeline_fit.check(asked, pipeline, **settings) if pipeline else diagnosis.check(asked, **settings)
    fine = diagnosis.settled(answers)
    for answer in answers[len(shown) :]:
        said(answer)
    entries = [{key: value for key, value in answer._asdict().items() if value is not None} for answer in answers]
    document = {"plant": plant, "fine": fine, "answers": entries}
    document |= {"kappa": str(asked.law), "guess": asked.guess.tolist()} if asked.law_table else {}
    if options.json:
        options.console.json(document)
    elif asked.law_table:
        options.console.out(f"guess = {asked.guess.tolist()}\n\n{asked.law}")
    if plot:
        from npred.lab.report import figures

        if delay is None:
            delay = pipeline_fit.PipelineFit(asked, pipeline).case().D if pipeline else diagnosis.longest(asked)[0]
        figures.write(figures.margin(asked, plot.stem, delay), plot.parent, formats=[plot.suffix[1:]])
    if not fine:
        failed = ", ".join(answer.check for answer in answers if answer.verdict == "no")
        raise UnmetError(f"plants check {plant}: the answer is no for {failed}; the table says what to change")


def _step(step: Step) -> dict[str, object]:
    model = {"model": step.node.model} if step.node.model else {}
    return {"stage": step.node.stage, "key": step.key, "state": step.state, **model, "reason": step.reason}


def _setting(artifact: Artifact, key: str, by_key: dict[str, Artifact]) -> str | None:
    """A setting of the artifact or of its inputs, as JSON."""
    asked = artifact.manifest.question
    value = flat(asked.config).get(key)
    sources = (by_key[source.key] for source in asked.inputs.values() if source.key in by_key)
    return value or next(filter(None, (_setting(source, key, by_key) for source in sources)), None)


def _summary(stage: str, result: dict[str, object], width: int | None = None) -> str:
    """A result that somebody else sent may be of a stage, or of a form, that this npred does not have."""
    result = escaped(result)
    try:
        written = RESOLVERS.installed(stage).summary if stage in RESOLVERS.names() else STAGES[stage].summary
        return written(result, width)
    except (LookupError, NpredError):
        return "\n".join(changes({}, result)).replace(": unset ->", " =")
