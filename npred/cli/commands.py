"""Every command with its own flags; a module of `npred.cli` does the work, imported with the first command of it, so
that `npred --help` is quick.
"""

from pathlib import Path
from typing import Annotated

import typer

import npred
from npred import cli
from npred.cli import completion
from npred.cli.app import Command, Group, app, command, with_flags
from npred.cli.options import Common, Exporting, Planned, Rigged, Running, Timed, Work, argument, flag
from npred.cli.recorded import Recorded
from npred.registry import STAGES, declared_stage

RUN, LOOK, CARE = "Run", "Look", "Look after"
FORMS = ("onnx", "c", "controller", "fmu", "npy", "hdf5", "mat")
MEDIA = ("ieee1", "ieee2", "page")
RESULT = argument("STAGE/KEY", "A result, as for show.", completion.artifacts)


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


@command(RUN)
def run(options: Work) -> None:
    """Run all stages in order; a result that is already in the store is reused."""
    cli.execute.everything(options)


def _add_stage(stage: str) -> None:
    """A command that runs one stage; where the stage is one for each network, of one network or all."""
    declared = declared_stage(stage)

    def of_networks(
        options: Work,
        *,
        model: Annotated[
            str | None, flag("A network, as deeponet; those of the pipeline by default.", offers=completion.models)
        ] = None,
    ) -> None:
        cli.execute.stage(options, stage, model)

    def of_all(options: Work) -> None:
        cli.execute.stage(options, stage)

    command(RUN, name=stage, help=declared.help)(of_networks if declared.per_network else of_all)


for _stage in STAGES:
    if _stage not in ("bench", "identify", "report"):  # which take more
        _add_stage(_stage)


@command(RUN, help=declared_stage("bench").help)
def bench(
    options: Timed,
    *,
    no_networks: Annotated[
        bool, flag("Train none: say in seconds from the cost of f whether one could pay.", "--no-networks")
    ] = False,
) -> None:
    cli.execute.could_pay(options) if no_networks else cli.execute.stage(options, "bench")


@command(RUN)
def sweep(
    options: Running,
    *,
    to: Annotated[
        str, flag("The last stage of each cell; bench for latencies.", word="STAGE", offers=completion.words(*STAGES))
    ] = "evaluate",
    output: Annotated[
        Path | None, flag("For table and figure; sweep-NAME by default.", "-o", "--output", word="DIR")
    ] = None,
    csv: Annotated[bool, flag("Print the table as CSV.", "--csv")] = False,
) -> None:
    """A grid of pipelines: --set train.deeponet.width=32,64,128 --set seed=0:10; what cells share is made once."""
    cli.sweep.sweep(options, to, output, csv)


@command(RUN)
def reproduce(
    options: Common,
    *,
    names: Annotated[list[str] | None, argument("NAME", "Experiments; all by default.", completion.experiments)] = None,
    listed: Annotated[bool, flag("Print the experiments, and run nothing.", "--list")] = False,
    numerical: Annotated[bool, flag("The rows of numerical predictors only.", "--numerical")] = False,
    force: Annotated[bool, flag("Measure again what the store has.", "--force")] = False,
    output: Annotated[
        Path | None, flag("The page: HTML, or Markdown for a name that ends in .md.", "-o", "--output", word="FILE")
    ] = None,
) -> None:
    """Published experiments: each printed number beside the same loop run here, as published and as it is meant."""
    cli.reproduce.reproduce(options, names, listed, numerical, force, output)


@command(RUN, help=declared_stage("identify").help)
def identify(
    options: Recorded,
    *,
    output: Annotated[
        Path | None, flag("The pipeline that is written; LOG's name with .toml, here, by default.", "-o", "--output")
    ] = None,
) -> None:
    cli.identify.identify(options, output)


@command(RUN)
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


@command(RUN, help=declared_stage("report").help)
def report(
    options: Work,
    *,
    output: Annotated[Path | None, flag("The HTML file, or the folder of the figures.", "-o", "--output")] = None,
    figures: Annotated[
        str | None,
        flag(
            "Figures and tables for a paper instead of the page.", word="|".join(MEDIA), offers=completion.words(*MEDIA)
        ),
    ] = None,
) -> None:
    cli.execute.report(options, output, figures)


@command(RUN)
def rig(
    options: Rigged,
    *,
    log: Annotated[Path | None, flag("The log that is written; NAME-rig.csv here by default.", word="FILE.csv")] = None,
    figure: Annotated[Path | None, flag("A figure of the log: SVG, PDF or PNG.", word="FILE")] = None,
) -> None:
    """Plant and controller of the evaluated loop as two processes on a real clock, with a network between them."""
    cli.rig.rig(options, log, figure)


@command(LOOK)
def status(
    options: Planned, *, check: Annotated[bool, flag("Read every file; exit 3 unless all is fresh.", "--check")] = False
) -> None:
    """The state of each result: fresh, stale or missing."""
    cli.inspect.status(options, check)


@command(LOOK)
def why(
    options: Planned, *, stage: Annotated[str, argument(None, "A stage, or a network.", completion.stages)]
) -> None:
    """The reason that a stage would run again: what changed, before -> after."""
    cli.inspect.why(options, stage)


@command(LOOK)
def show(
    options: Common,
    *,
    reference: Annotated[
        str | None, argument("STAGE/KEY", "A key, a stage or a network; the latest by default.", completion.artifacts)
    ] = None,
) -> None:
    """The content of a result: question, files, answer."""
    cli.inspect.show(options, reference)


@command(LOOK)
def ls(
    options: Common,
    *,
    shown: Annotated[
        list[str] | None, flag("A setting as a column, as seed; repeatable.", "--show", word="KEY")
    ] = None,
) -> None:
    """Every result in the store, the most recent last."""
    cli.inspect.ls(options, shown or [])


@command(LOOK)
def diff(
    options: Common,
    *,
    a: Annotated[str, argument("A", "A result, as for show.", completion.artifacts)],
    b: Annotated[str, argument("B", "Another.", completion.artifacts)],
) -> None:
    """The differences of two results: in their questions, and in their answers."""
    cli.inspect.diff(options, a, b)


@app.command("help", cls=Command, rich_help_panel=LOOK)
def help_(
    context: typer.Context,
    words: Annotated[list[str] | None, argument("[COMMAND]...", "As `run` or `plants check`.")] = None,
) -> None:
    """The help of a command, with its flags; all commands without a name."""
    root = context.find_root()
    root.command.main([*(words or []), "--help"], prog_name=root.info_name, standalone_mode=False)


plants = typer.Typer(cls=Group)
app.add_typer(plants, name="plants", rich_help_panel=LOOK)


@plants.callback(invoke_without_command=True)
@with_flags
def _plants(options: Common) -> None:
    """The plants that are built in or installed; `npred plants check` asks what is wrong with one."""
    cli.inspect.plants(options)


@command(LOOK, to=plants, waits="checking the plant: its formulas, its equilibrium, the loops of its law")
def check(
    options: Common,
    *,
    plant: Annotated[
        str, argument("PLANT", "A name, a file as my_plant.py:Tank, or a pipeline as tank.toml.", completion.plants)
    ],
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


@command(RUN)
def init(
    options: Common,
    *,
    name: Annotated[str, argument("NAME", "The plant's name, as my_plant.")],
    source: Annotated[
        str | None,
        flag(
            "A plant to copy, by name or as my_plant.py:Tank; a tank with comments by default.",
            "--from",
            word="PLANT",
            offers=completion.plants,
        ),
    ] = None,
) -> None:
    """A new plant to start from: NAME.py and NAME.toml in this folder."""
    cli.scaffold.init(options, name, source)


@command(LOOK, waits="reading what is to be exported, writing and testing it: some seconds, minutes for large networks")
def export(
    options: Exporting,
    *,
    form: Annotated[
        str,
        argument(
            "|".join(FORMS),
            "A model as ONNX graph or C99 file, the whole controller as C99 or FMU; data as the others.",
            completion.words(*FORMS),
        ),
    ],
    key: Annotated[
        str, argument("KEY", "PIPELINE:MODEL or MODEL; PIPELINE for data; a folder or key.", completion.artifacts)
    ],
    output: Annotated[
        Path | None,
        flag(
            "The file; by default MODEL-NX.onnx or .c, data.npy, .h5, .mat; a controller's folder, NAME.fmu.",
            "-o",
            "--output",
        ),
    ] = None,
) -> None:
    """A trained model, P and U = kappa(P(1)), the whole controller of the evaluated loop, or the data, for another
    program."""
    cli.export.export(options, form, key, output)


@command(LOOK)
def import_(
    options: Common,
    *,
    form: Annotated[str, argument("npy", "The format: the layout that [DAPF]'s authors published.")],
    inputs: Annotated[Path, argument("INPUTS", "Rows of D_hat, inputs, states, node after node.")],
    outputs: Annotated[Path, argument("OUTPUTS", "Rows of P, one number per state, node after node.")],
    plant_name: Annotated[
        str, flag("The plant whose samples they are: a name or my_plant.py:Tank.", "--plant", offers=completion.plants)
    ] = "activator_repressor",
    rollouts: Annotated[
        int | None, flag("How many rollouts, if the rows of one lie together: to hold out whole ones.", least=2)
    ] = None,
    output: Annotated[Path, flag("The HDF5 file to write.", "-o", "--output")] = Path("data.h5"),
) -> None:
    """Data of others as a file that a pipeline can train on, checked against the predictor equation."""
    cli.data_exchange.bring(options, form, inputs, outputs, plant_name, rollouts, output)


@command(CARE)
def verify(options: Common) -> None:
    """Every file of every result against its digest; exit 4 where one differs."""
    cli.store_admin.verify(options)


@command(CARE)
def gc(
    options: Common,
    *,
    pipelines: Annotated[
        list[Path] | None,
        argument(None, "Pipelines whose results stay; all in pipeline/ by default.", completion.pipelines),
    ] = None,
    set: Annotated[
        list[str] | None,
        flag(
            "What a sweep was run with: its results stay as well.",
            "--set",
            word="KEY=VALUES",
            offers=completion.settings,
        ),
    ] = None,
    older: Annotated[float, flag("Only what is older than so many days.", word="DAYS", least=0)] = 0.0,
    keep: Annotated[str | None, flag("The oldest only, until the store has this size: 500M, 2G.", word="SIZE")] = None,
    yes: Annotated[bool, flag("Delete what the plan names.", "--yes")] = False,
    device: Annotated[
        str, flag("auto, cpu, cuda or cuda:N, as in the runs to keep.", offers=completion.devices)
    ] = "auto",
) -> None:
    """Delete what no pipeline needs: the plan first, deleted with --yes."""
    cli.gc.gc(options, pipelines or [], set or [], older, keep, device, yes)


@command(CARE)
def export_artifact(
    options: Common,
    *,
    reference: Annotated[str, RESULT],
    output: Annotated[Path | None, flag("The file; by default STAGE-KEY.tar here.", "-o", "--output")] = None,
) -> None:
    """A result as one tar with its digests, to take elsewhere."""
    cli.store_admin.export_artifact(options, reference, output)


@command(CARE)
def import_artifact(
    options: Common, *, path: Annotated[Path, argument("FILE.tar", "What export-artifact wrote.")]
) -> None:
    """A result from elsewhere into the store, checked; nothing in it is run."""
    cli.store_admin.import_artifact(options, path)


@command(CARE, waits="importing the packages and reading the store: some seconds")
def doctor(options: Common) -> None:
    """Versions, devices, threads and the store."""
    cli.store_admin.doctor(options)
