"""The default pipeline file and store, for the command line and the Python API."""

import os
from pathlib import Path

from npred.base.errors import ConfigError, similar

PIPELINE = Path("pipeline/paper.toml")
PIPELINE_VARIABLE = "NPRED_PIPELINE"
STORE = Path("artifacts")
STORE_VARIABLE = "NPRED_STORE"
RESULT = "result.json"  # a stage's answer, among the files of its result
EXECUTOR_VARIABLE = "NPRED_EXECUTOR"
NO_PIPELINE = ("pyproject.toml",)  # other TOML files that a folder may have


def store() -> Path:
    """The folder of the store: NPRED_STORE, or artifacts/ here."""
    return Path(os.environ.get(STORE_VARIABLE) or STORE)


def shipped() -> dict[str, Path]:
    """The pipelines that are part of npred, by name: in a wheel beside its modules, in a clone in pipeline/."""
    package = Path(__file__).parents[1]
    folders = (package / "pipelines", package.parent / "pipeline")
    folder = next((folder for folder in folders if folder.is_dir()), folders[0])
    return {path.stem: path for path in sorted(folder.glob("*.toml"))}


def pipeline(name: str | Path | None = None) -> Path:
    """The file of a pipeline: a path, or the name of one that is part of npred, where no such file is here.

    Without a name: NPRED_PIPELINE, else pipeline/paper.toml, else the only TOML file here. Raises ConfigError where
    there is none of these.
    """
    name = str(name or os.environ.get(PIPELINE_VARIABLE) or _only())
    return Path(name) if Path(name).is_file() else shipped().get(name, Path(name))


def of_code(path: Path) -> str:
    """The message for a plant where a pipeline is expected."""
    spec = path if ".py:" in str(path) else f"{path}:Tank"
    return f'{path}: expected a pipeline, a TOML file, got code; write plant = "{spec}" to one, and name that'


def missing(path: Path) -> str:
    """The message for a pipeline that is no file."""
    if ".py:" in str(path):
        return of_code(path)
    names = list(shipped())
    near = similar(str(path), [*names, *(str(file) for file in path.parent.glob("*.toml"))])
    return f"{path}: expected a pipeline file, or one of {', '.join(names)}; found no such file{near}"


def _only() -> Path:
    if PIPELINE.is_file():
        return PIPELINE
    here = sorted(path for path in Path().glob("*.toml") if path.name not in NO_PIPELINE)
    if len(here) == 1:
        return here[0]
    files = ", ".join(map(str, here)) or "no TOML file"
    cure = "name a pipeline, as in npred run smoke"
    raise ConfigError(f"expected the name of a pipeline, or one TOML file here, got {files}; {cure}")
