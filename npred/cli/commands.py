"""Every command with its own flags. The function of `npred.cli` that does it, by the name beside the panel, takes them
under the same names; it is imported when it is called, so that `npred --help` is quick.
"""

from pathlib import Path
from typing import Annotated

import typer

import npred
from npred.cli import completion
from npred.cli.app import app, command
from npred.cli.options import Common, Planned, Running, Work
from npred.cli.usage import Command
from npred.registry import STAGES, stage

RUN, LOOK, CARE = "Run", "Look", "Look after"


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


@command(RUN, "execute.everything")
def run(options: Work) -> None:
    """All stages, in order, each from the store when its key is there."""


def _network(
    options: Work,
    *,
    model: Annotated[
        str | None,
        typer.Option(
            help="A network, as deeponet; those of the pipeline by default.", autocompletion=completion.models
        ),
    ] = None,
) -> None: ...


def _stage(options: Work) -> None: ...


for _name in STAGES:
    if _name != "report":  # it comes after the sweep
        _flags = _network if stage(_name).per_network else _stage
        command(RUN, "execute.stage", name=_name, help=stage(_name).help, stage_name=_name)(_flags)


@command(RUN, "sweep.sweep")
def sweep(
    options: Running,
    *,
    to: Annotated[
        str,
        typer.Option(
            metavar="STAGE",
            help="The last stage of each cell; bench for latencies.",
            autocompletion=completion.words(*STAGES),
        ),
    ] = "evaluate",
    output: Annotated[
        Path | None, typer.Option("-o", "--output", metavar="DIR", help="For table and figure; sweep-NAME by default.")
    ] = None,
    csv: Annotated[bool, typer.Option("--csv", help="Print the table as CSV.")] = False,
) -> None:
    """A grid of pipelines: --set train.deeponet.width=32,64,128 --set seed=0:10; what cells share is made once."""


@command(RUN, "reproduce.reproduce")
def reproduce(
    options: Common,
    *,
    names: Annotated[
        list[str] | None,
        typer.Argument(metavar="NAME", help="Experiments; all by default.", autocompletion=completion.experiments),
    ] = None,
    listed: Annotated[bool, typer.Option("--list", help="Print the experiments, and run nothing.")] = False,
    numerical: Annotated[bool, typer.Option("--numerical", help="The rows of numerical predictors only.")] = False,
    force: Annotated[bool, typer.Option("--force", help="Measure again what the store has.")] = False,
    output: Annotated[
        Path | None,
        typer.Option("-o", "--output", metavar="FILE", help="The page: HTML, or Markdown for a name that ends in .md."),
    ] = None,
) -> None:
    """Published experiments: each printed number beside the same loop run here, as published and as it is meant."""


@command(RUN, "report.report", help=stage("report").help)
def report(
    options: Work,
    *,
    output: Annotated[
        Path | None, typer.Option("-o", "--output", help="The HTML file, or the folder of the figures.")
    ] = None,
    figures: Annotated[
        str | None,
        typer.Option(
            metavar="ieee1|ieee2|slides",
            help="Figures and tables for a paper instead of the page.",
            autocompletion=completion.words("ieee1", "ieee2", "slides"),
        ),
    ] = None,
) -> None: ...


@command(LOOK, "inspect.status")
def status(
    options: Planned,
    *,
    check: Annotated[bool, typer.Option("--check", help="Read every file; exit 3 unless all is fresh.")] = False,
) -> None:
    """The state of each result: fresh, stale or missing."""


@command(LOOK, "inspect.why")
def why(
    options: Planned,
    *,
    stage: Annotated[str, typer.Argument(help="A stage, or a network.", autocompletion=completion.stages)],
) -> None:
    """The reason that a stage would run again: what changed, before -> after."""


@command(LOOK, "inspect.show")
def show(
    options: Common,
    *,
    reference: Annotated[
        str | None,
        typer.Argument(
            metavar="STAGE/KEY",
            help="A key, a stage or a network; the latest by default.",
            autocompletion=completion.artifacts,
        ),
    ] = None,
) -> None:
    """The content of a result: question, files, answer."""


@command(LOOK, "inspect.ls")
def ls(
    options: Common,
    *,
    shown: Annotated[
        list[str] | None, typer.Option("--show", metavar="KEY", help="A setting as a column, as seed; repeatable.")
    ] = None,
) -> None:
    """Every result in the store, the most recent last."""


@command(LOOK, "inspect.diff")
def diff(
    options: Common,
    *,
    a: Annotated[str, typer.Argument(metavar="A", help="A result, as for show.", autocompletion=completion.artifacts)],
    b: Annotated[str, typer.Argument(metavar="B", help="Another.", autocompletion=completion.artifacts)],
) -> None:
    """The differences of two results: in their questions, and in their answers."""


@app.command("help", cls=Command, rich_help_panel=LOOK)
def help_(
    context: typer.Context,
    words: Annotated[
        list[str] | None, typer.Argument(metavar="[COMMAND]...", help="As `run` or `plants check`.")
    ] = None,
) -> None:
    """The help of a command, with its flags; all commands without a name."""
    root = context.find_root()
    root.command.main([*(words or []), "--help"], prog_name=root.info_name, standalone_mode=False)


@command(LOOK, "inspect.plants", group=True)
def plants(options: Common) -> None:
    """The plants that are built in or installed; `npred plants check` asks what is wrong with one."""


@command(LOOK, "inspect.check", to=plants)
def check(
    options: Common,
    *,
    plant: Annotated[
        str,
        typer.Argument(
            metavar="PLANT",
            help="A name, a file as my_plant.py:Tank, or a pipeline as tank.toml.",
            autocompletion=completion.plants,
        ),
    ],
    delay: Annotated[
        float | None,
        typer.Option(help="The largest delay to predict over, in seconds; the pipeline's or the plant's, else 1."),
    ] = None,
    nodes: Annotated[
        int | None, typer.Option(help="Nodes of the prediction; dx = 0.01 is 101; the pipeline's, else 101.")
    ] = None,
) -> None:
    """Check a plant, one answer per question; exit 3 where an answer is no."""


@command(RUN, "scaffold.init")
def init(
    options: Common,
    *,
    name: Annotated[str, typer.Argument(metavar="NAME", help="The plant's name, as my_plant.")],
    source: Annotated[
        str | None,
        typer.Option(
            "--from",
            metavar="PLANT",
            help="A plant to copy, by name or as my_plant.py:Tank; a tank with comments by default.",
            autocompletion=completion.plants,
        ),
    ] = None,
) -> None:
    """A new plant to start from: NAME.py and NAME.toml in this folder."""


@command(LOOK, "export.export")
def export(
    options: Common,
    *,
    form: Annotated[
        str,
        typer.Argument(
            metavar="onnx|c|controller|fmu|npy|hdf5|mat",
            help="A model as ONNX graph or C99 file, the whole controller as C99 or FMU; data as the others.",
            autocompletion=completion.words("onnx", "c", "controller", "fmu", "npy", "hdf5", "mat"),
        ),
    ],
    key: Annotated[
        str,
        typer.Argument(
            metavar="KEY",
            help="PIPELINE:MODEL or MODEL; PIPELINE for data; a folder or key.",
            autocompletion=completion.artifacts,
        ),
    ],
    output: Annotated[
        Path | None,
        typer.Option(
            "-o",
            "--output",
            help="The file; by default MODEL-NX.onnx or .c, data.npy, .h5, .mat; a controller's folder, NAME.fmu.",
        ),
    ] = None,
    nx: Annotated[
        int | None,
        typer.Option(help="Nodes of the actuator state, any number; by default 101, a controller's as in evaluate."),
    ] = None,
    atol: Annotated[float, typer.Option(help="How far an ONNX graph's P and U may be from the model's.")] = 1e-4,
    precision: Annotated[str, typer.Option(metavar="double|float", help="A controller's numbers.")] = "double",
    predictor: Annotated[
        str, typer.Option(metavar="METHOD", help="A controller's numerical predictor, as rk4, instead of a network.")
    ] = "",
    name: Annotated[str, typer.Option(help="What a controller's files and C names begin with.")] = "npred",
    actuator: Annotated[
        str, typer.Option(metavar="measured|history", help="A controller's source of u; by default as in evaluate.")
    ] = "",
    guard: Annotated[
        float | None, typer.Option(help="A controller's guard: the largest error of U that passes; as in evaluate.")
    ] = None,
    fmi: Annotated[int, typer.Option(metavar="3|2", help="An FMU's version of FMI.")] = 3,
    mex: Annotated[
        bool, typer.Option("--mex", help="A controller's gateway to MATLAB and Octave too, NAME_mex.c.")
    ] = False,
) -> None:
    """A trained model, P and U = kappa(P(1)), the whole controller of the evaluated loop, or the data, for another
    program."""


@command(LOOK, "data_exchange.bring")
def import_(
    options: Common,
    *,
    form: Annotated[str, typer.Argument(metavar="npy", help="The format: the layout that [DAPF]'s authors published.")],
    inputs: Annotated[Path, typer.Argument(metavar="INPUTS", help="Rows of D_hat, inputs, states, node after node.")],
    outputs: Annotated[
        Path, typer.Argument(metavar="OUTPUTS", help="Rows of P, one number per state, node after node.")
    ],
    plant_name: Annotated[
        str,
        typer.Option(
            "--plant",
            help="The plant whose samples they are: a name or my_plant.py:Tank.",
            autocompletion=completion.plants,
        ),
    ] = "activator_repressor",
    rollouts: Annotated[
        int | None,
        typer.Option(min=2, help="How many rollouts, if the rows of one lie together: to hold out whole ones."),
    ] = None,
    output: Annotated[Path, typer.Option("-o", "--output", help="The HDF5 file to write.")] = Path("data.h5"),
) -> None:
    """Data of others as a file that a pipeline can train on, checked against the predictor equation."""


@command(CARE, "store_admin.verify")
def verify(options: Common) -> None:
    """Every file of every result against its digest; exit 4 where one differs."""


@command(CARE, "gc.gc")
def gc(
    options: Common,
    *,
    pipelines: Annotated[
        list[Path] | None,
        typer.Argument(
            help="Pipelines whose results stay; all in pipeline/ by default.", autocompletion=completion.pipelines
        ),
    ] = None,
    set: Annotated[
        list[str] | None,
        typer.Option(
            "--set",
            metavar="KEY=VALUES",
            help="What a sweep was run with: its results stay as well.",
            autocompletion=completion.settings,
        ),
    ] = None,
    older: Annotated[float, typer.Option(min=0, metavar="DAYS", help="Only what is older than so many days.")] = 0.0,
    keep: Annotated[
        str | None, typer.Option(metavar="SIZE", help="The oldest only, until the store has this size: 500M, 2G.")
    ] = None,
    yes: Annotated[bool, typer.Option("--yes", help="Delete what the plan names.")] = False,
    device: Annotated[
        str, typer.Option(help="auto, cpu, cuda or cuda:N, as in the runs to keep.", autocompletion=completion.devices)
    ] = "auto",
) -> None:
    """Delete what no pipeline needs: the plan first, deleted with --yes."""


@command(CARE, "store_admin.export_artifact")
def export_artifact(
    options: Common,
    *,
    reference: Annotated[
        str, typer.Argument(metavar="STAGE/KEY", help="A result, as for show.", autocompletion=completion.artifacts)
    ],
    output: Annotated[
        Path | None, typer.Option("-o", "--output", help="The file; by default STAGE-KEY.tar here.")
    ] = None,
) -> None:
    """A result as one tar with its digests, to take elsewhere."""


@command(CARE, "store_admin.import_artifact")
def import_artifact(
    options: Common, *, path: Annotated[Path, typer.Argument(metavar="FILE.tar", help="What export-artifact wrote.")]
) -> None:
    """A result from elsewhere into the store, checked; nothing in it is run."""


@command(CARE, "store_admin.doctor")
def doctor(options: Common) -> None:
    """Versions, devices, threads and the store."""
