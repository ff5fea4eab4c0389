"""`npred identify`: what a recording tells of a plant, a page of it, and a pipeline with the delay that was found."""

import shutil
from pathlib import Path

from npred.cli.execute import bring
from npred.cli.recorded import Recorded
from npred.errors import ConfigError
from npred.plants import Plant
from npred.results import IdentifiedResult
from npred.stages.identify.identify import PAGE
from npred.stages.report import toml_text

MADE = "# made by npred identify"


def identify(options: Recorded, output: Path | None) -> None:
    """The answer of the stage; the page and the pipeline are written beside each other."""
    artifact = bring(options, ["identify"])[-1].artifact
    result, plant = IdentifiedResult.read(artifact.folder), options.planner().plant
    path = output or Path(f"{options.config.name}.toml")
    files = [_page(artifact.folder / PAGE, path.with_suffix(".html"))]
    files += [_pipeline(options, plant, result, path)] if all(result.identifiable) else []
    said = "\n".join([*result.sentences, *(f"wrote {file}" for file in files)])
    if not all(result.identifiable):
        said += "\nno pipeline was written: the recording does not tell the delay"
    options.show(result.json_object() | {"files": list(map(str, files))}, lambda: said)


def _page(source: Path, path: Path) -> Path:
    try:
        shutil.copyfile(source, path)
    except OSError as error:
        raise ConfigError(
            f"{path}: expected a file that can be written, got: {error.strerror}; name another by -o"
        ) from None
    return path


def _pipeline(options: Recorded, plant: Plant, result: IdentifiedResult, path: Path) -> Path:
    """The pipeline file with the longest delay and its interval, and the parameters. Another's file is left alone."""
    if path.exists() and not path.read_text(encoding="utf-8", errors="replace").startswith(MADE):
        raise ConfigError(f"{path}: expected no such file, or one that npred identify made; name another by -o")
    longest = max(range(plant.m), key=lambda j: result.D[j])
    D, (low, high) = result.D[longest], result.interval[longest]
    loop = {"D": float(f"{D:.6g}"), "bounds": [float(f"{end:.6g}") for end in (low, high)]}
    middle = [
        sum(plant.box[state]) / 2 if state in plant.box else float(x)
        for state, x in zip(plant.states, plant.guess, strict=True)
    ]
    loop |= {} if plant.declares_V else {"adaptation": "delay-observer", "actuator": "history"}
    tables = {
        "name": options.config.name, "plant": options.config.plant,
        **({"kappa": options.config.kappa} if options.config.kappa else {}),
        "parameters": options.config.parameters | {k: v for k, v in result.parameters.items() if k in plant.parameters},
        "generate": loop, "evaluate": loop | {"X0": middle},
    }  # fmt: skip
    head = f"{MADE} {options.pipeline.name}\n" + "".join(f"# {sentence}\n" for sentence in result.sentences)
    if plant.m > 1 and plant.one_delay:
        delays = ", ".join(f"{delay:.6g}" for delay in result.D)
        head += f"# The inputs have different delays: write delays = ({delays}) in the plant's class.\n"
    path.write_text(f"{head}\n{toml_text.dumps(tables)}", encoding="utf-8")
    return path
