"""`npred export fmu`: the controller of a pipeline's evaluated loop as a Functional Mock-up Unit."""

from pathlib import Path

from npred.cli import export_controller
from npred.cli.export_controller import Choices
from npred.cli.options import Common, writable
from npred.runtimes import c_library, fmu

NO_LIBRARY = "sources only, for there is no C compiler here; install one, or let the importer build them"
NO_PLACE = "sources only, for FMI 2.0 has no name for this machine; take --fmi 3, or let the importer build them"


def export(options: Common, key: str, output: Path | None, version: int, choices: Choices) -> None:
    """Write the FMU. Raises ConfigError as npred.runtimes.fmu.write does."""
    path = writable(output or Path(f"{choices.name}.fmu"))
    built = export_controller.build(options, key, choices)
    written = fmu.write(
        built.controller, path, version=version, name=choices.name, precision=choices.precision, model=built.about,
        X0=built.table.X0 or built.controller.plant.target(0.0), t_end=built.table.t_end, test=built.test,
    )  # fmt: skip
    document = {"file": str(path)} | built.document(choices, "fmu") | {
        "fmi": version, "library": written.library, "token": written.token,
        "variables": [variable.name for variable in written.variables],
    }  # fmt: skip
    options.show(document, lambda: f"{path}: {built.controller!r} as FMI {version}.0, {_holds(written.library)}")


def _holds(library: str | None) -> str:
    """What the archive holds, in words."""
    if library:
        return f"{library} and sources"
    return NO_PLACE if c_library.compiler() else NO_LIBRARY
