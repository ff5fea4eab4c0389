"""Every command with its own flags; a module of `npred.cli` does the work, imported with the first command of it, so
that `npred --help` is quick.
"""

import inspect
from pathlib import Path
from typing import Annotated, Any

import typer

import npred
from npred import cli
from npred.base.errors import ConfigError
from npred.base.registry import COMMANDS, STAGES, declared_stage
from npred.cli.app import app, command, with_flags
from npred.cli.identify import Recorded
from npred.cli.options import Common, Exporting, ExportingLoop, Planned, Running, Work, argument, flag
from npred.exports import FORMATS
from npred.lab.report.terminal.console import Console

MEDIA = ("ieee1", "ieee2", "page")
RESULT = argument("STAGE/KEY", "A result, as for show.")


def _version(asked: bool) -> None:
    if asked:
        typer.echo(f"npred {npred.__version__}")
        raise typer.Exit


@app.callback()
def _root(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version and exit.")
    ] = False,
) -> None: ...


@command()
def run(options: Work) -> None:
    """Run all stages in order; a result that is already in the store is reused."""
    cli.execute.everything(options)


def _add_stage(stage: str) -> None:
    """A command that runs one stage; where the stage is one for each network, of one network or all."""
    declared = declared_stage(stage)

    def of_networks(
        options: Work,
        *,
        model: Annotated[str | None, flag("A network, as deeponet; those of the pipeline by default.")] = None,
    ) -> None:
        cli.execute.stage(options, stage, model)

    def of_all(options: Work) -> None:
        cli.execute.stage(options, stage)

    command(name=stage, help=declared.help)(of_networks if declared.per_network else of_all)


for _stage in STAGES:
    if _stage not in ("bench", "identify", "report"):  # which take more
        _add_stage(_stage)


@command(help=declared_stage("bench").help)
def bench(
    options: Work,
    *,
    no_networks: Annotated[
        bool,
        flag(
            "Train none: say in seconds from the cost of f, of a plant as my_plant.py:Tank too, whether one could pay.",
            "--no-networks",
        ),
    ] = False,
) -> None:
    cli.execute.could_pay(options) if no_networks else cli.execute.stage(options, "bench")


@command()
def sweep(
    options: Running,
    *,
    to: Annotated[str, flag("The last stage of each cell; bench for latencies.", word="STAGE")] = "evaluate",
    output: Annotated[
        Path | None, flag("For table and figure; sweep-NAME by default.", "-o", "--output", word="DIR")
    ] = None,
    csv: Annotated[bool, flag("Print the table as CSV.", "--csv")] = False,
) -> None:
    """A grid of pipelines: --set train.deeponet.width=32,64,128 --set seed=0:10; what cells share is made once."""
    cli.sweep.sweep(options, to, output, csv)


@command(help=declared_stage("identify").help)
def identify(
    options: Recorded,
    *,
    output: Annotated[
        Path | None, flag("The pipeline that is written; LOG's name with .toml, here, by default.", "-o", "--output")
    ] = None,
) -> None:
    cli.identify.identify(options, output)


@command()
def tune(
    options: Planned,
    *,
    free: Annotated[
        list[str] | None, flag("A gain of kappa, or gamma or b, and its range, as k1=0.5:5.", word="NAME[=LOW:HIGH]")
    ] = None,
    output: Annotated[Path | None, flag("A pipeline with the new numbers.", "-o", "--output", word="FILE")] = None,
) -> None:
    """Search better gamma, b and gains of kappa on the loops of [evaluate]; say so if nothing is to be gained."""
    cli.tune.tune(options, free or [], output)


@command(help=declared_stage("report").help)
def report(
    options: Work,
    *,
    output: Annotated[Path | None, flag("The HTML file, or the folder of the figures.", "-o", "--output")] = None,
    figures: Annotated[
        str | None, flag("Figures and tables for a paper instead of the page.", word="|".join(MEDIA))
    ] = None,
) -> None:
    cli.execute.report(options, output, figures)


@command()
def status(
    options: Planned, *, check: Annotated[bool, flag("Read every file; exit 3 unless all is fresh.", "--check")] = False
) -> None:
    """The state of each result: fresh, stale or missing."""
    cli.inspect.status(options, check)


@command()
def why(options: Planned, *, stage: Annotated[str, argument(None, "A stage, or a network.")]) -> None:
    """The reason that a stage would run again: what changed, before -> after."""
    cli.inspect.why(options, stage)


@command()
def show(
    options: Common,
    *,
    reference: Annotated[
        str | None, argument("STAGE/KEY", "A key, a stage or a network; the latest by default.")
    ] = None,
) -> None:
    """The content of a result: question, files, answer."""
    cli.inspect.show(options, reference)


@command()
def ls(
    options: Common,
    *,
    shown: Annotated[
        list[str] | None, flag("A setting as a column, as seed; repeatable.", "--show", word="KEY")
    ] = None,
) -> None:
    """Every result in the store, the most recent last."""
    cli.inspect.ls(options, shown or [])


@command()
def diff(
    options: Common,
    *,
    a: Annotated[str, argument("A", "A result, as for show.")],
    b: Annotated[str, argument("B", "Another.")],
) -> None:
    """The differences of two results: in their questions, and in their answers."""
    cli.inspect.diff(options, a, b)


@app.command("help")
def help_(
    context: typer.Context,
    words: Annotated[list[str] | None, argument("[COMMAND]...", "As `run` or `plants check`.")] = None,
) -> None:
    """Help of a command, or of all."""
    root = context.find_root()
    root.command.main([*(words or []), "--help"], prog_name=root.info_name, standalone_mode=False)


PLANTS = "The plants that are built in or installed; `npred plants check` asks what is wrong with one."
plants = typer.Typer()
app.add_typer(plants, name="plants", help=PLANTS, short_help=PLANTS)


@plants.callback(invoke_without_command=True)
@with_flags
def _plants(options: Common) -> None:
    cli.inspect.plants(options)


@command(to=plants, waits="checking the plant: its formulas, its equilibrium, the loops of its law")
def check(
    options: Common,
    *,
    plant: Annotated[str, argument("PLANT", "A name, a file as my_plant.py:Tank, or a pipeline as tank.toml.")],
    delay: Annotated[
        float | None, flag("The largest delay to predict over, in seconds; the pipeline's or the plant's, else 1.")
    ] = None,
    nodes: Annotated[int | None, flag("Nodes of the prediction; dx = 0.01 is 101; the pipeline's, else 101.")] = None,
    kappa: Annotated[
        str, flag("A law designed from f in place of the plant's, as lqr; it is printed to be pasted.", word="LAW")
    ] = "",
    u0: Annotated[
        str | None, flag("The input before t = 0: equilibrium, law or numbers, as [0.5].", word="VALUE")
    ] = None,
    figure: Annotated[Path | None, flag("A figure of the delay margin: SVG, PDF or PNG.", word="FILE")] = None,
) -> None:
    """Check a plant, one answer per question; exit 3 where an answer is no."""
    cli.inspect.check(options, plant, delay, nodes, kappa, figure, u0)


@command()
def init(
    options: Common,
    *,
    name: Annotated[str, argument("NAME", "The plant's name, as my_plant.")],
    source: Annotated[
        str | None,
        flag(
            "A plant to copy, by name or as my_plant.py:Tank; a tank with comments by default.", "--from", word="PLANT"
        ),
    ] = None,
) -> None:
    """A new plant to start from: NAME.py and NAME.toml in this folder."""
    cli.scaffold.init(options, name, source)


exporting = typer.Typer(no_args_is_help=True, help="A controller or a trained network for another program.")
app.add_typer(exporting, name="export")


def _add_format(form: str) -> None:
    """A command that writes a format, whose options are its flags."""
    declared = FORMATS[form]

    def write(
        options: Exporting,
        *,
        key: Annotated[str, argument("KEY", "PIPELINE:MODEL or MODEL; a folder or key.")],
        output: Annotated[
            Path | None, flag("The file, or the folder of a controller's; named by default.", "-o", "--output")
        ] = None,
        **values: Any,
    ) -> None:
        cli.export.export(options, form, key, output, values)

    first, *shared, _ = inspect.signature(write).parameters.values()
    flags = [
        inspect.Parameter(
            name,
            inspect.Parameter.KEYWORD_ONLY,
            default=option.default or "",
            annotation=Annotated[
                str if option.default == () else type(option.default), flag(option.help, word=option.word)
            ],
        )
        for name, option in declared.options.items()
    ]
    first = first.replace(annotation=Exporting if declared.network else ExportingLoop)
    write.__signature__ = inspect.Signature([first, *shared, *flags])  # type: ignore[attr-defined]
    waits = "reading, writing and testing it: some seconds, minutes for large networks"
    command(to=exporting, name=form, help=declared.help, waits=waits)(write)


for _form in FORMATS:
    _add_format(_form)


@command()
def verify(options: Common) -> None:
    """Every file of every result against its digest; exit 4 where one differs."""
    cli.store_admin.verify(options)


@command()
def gc(
    options: Common,
    *,
    pipelines: Annotated[
        list[Path] | None, argument(None, "Pipelines whose results stay; all in pipeline/ by default.")
    ] = None,
    set: Annotated[
        list[str] | None, flag("What a sweep was run with: its results stay as well.", "--set", word="KEY=VALUES")
    ] = None,
    yes: Annotated[bool, flag("Delete what the plan names.", "--yes")] = False,
    device: Annotated[str, flag("auto, cpu, cuda or cuda:N, as in the runs to keep.")] = "auto",
) -> None:
    """Delete what no pipeline needs: the plan first, deleted with --yes."""
    cli.gc.gc(options, pipelines or [], set or [], device, yes)


@command(waits="importing the packages and reading the store: some seconds")
def doctor(options: Common) -> None:
    """Versions, devices, threads and the store."""
    cli.store_admin.doctor(options)


def _add_installed(name: str) -> None:
    """A command that an installed package registers: a function as those above. One that fails is left out."""
    try:
        command(name=name)(COMMANDS.installed(name))
    except ConfigError as error:
        Console().warn(str(error))


for _name in COMMANDS.names():
    if _name not in {each.name for each in app.registered_commands}:
        _add_installed(_name)
