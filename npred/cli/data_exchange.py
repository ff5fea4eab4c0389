"""`npred import`, and `npred export` of data: samples from and for other programs."""

from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from npred import plants
from npred.cli.options import Common, writable
from npred.data import exchange, shards
from npred.data.dataset import MEANING, Dataset, attributes
from npred.delays import family_of
from npred.errors import ConfigError, required
from npred.json_files import plain
from npred.pipeline import load_data
from npred.store import durable

RELATIVE = 0.05  # residual over what P moves: Euler's method leaves a third of it at dx = 0.01
START = 1e-3  # of P(0) from X, in units of the state: files in single precision round a state of 1000 by less
CELL = 0.5  # of a cell of the grid: by how much the delay that fits best may be off
SHUFFLED = 0.1  # of interop.together


def bring(
    options: Common, form: str, inputs: Path, outputs: Path, plant_name: str, rollouts: int | None, output: Path
) -> None:
    """Write the rows of two files as one HDF5 file, and say what holds of them. Raises ConfigError where it cannot."""
    if form != "npy":
        raise ConfigError(f"import: expected npy, got {form!r}; name the format of the two files")
    if output.resolve() in (inputs.resolve(), outputs.resolve()):
        raise ConfigError(f"import: expected another file than the two, got --output {output}; name one")
    plant = plants.resolve(plant_name)
    family_of(plant).needs("import")
    data = exchange.part(plant, exchange.read(inputs), exchange.read(outputs), rollouts)
    answers = {"checks": exchange.checks(plant, data), "splits": _splits(data, rollouts)}
    for line in _doubts(answers, data.u.shape[1]):
        options.console.warn(line)
    with durable.room(output):
        data.write(writable(output), attributes(plant, "imported"))
    document = {"file": str(output), "plant": plant.name, "samples": len(data), "nx": data.u.shape[1], **answers}
    options.show(plain(document), lambda: _summary(document))


def export(options: Common, form: str, spec: str, output: Path | None) -> None:
    """Write the samples of a generate artifact. Raises ConfigError where there is none, MissingError without scipy."""
    artifact = load_data(spec, options.store)
    data = Dataset.read(artifact.folder / "data.h5")
    path = writable(output or Path(f"data.{'h5' if form == 'hdf5' else form}"))
    with durable.room(path), TemporaryDirectory(dir=path.parent, prefix=".npred-") as aside:
        written = WRITERS[form](artifact.folder / "data.h5", data, Path(aside, path.name))
        files = [file.replace(path.parent / file.name) for file in written]
    document = {"files": [str(file) for file in files], "format": form, "samples": len(data), "key": artifact.name}
    options.show(document, lambda: f"{', '.join(document['files'])}: {len(data)} samples of {artifact.name}")


def _npy(source: Path, data: Dataset, path: Path) -> list[Path]:
    paths = [path.with_name(f"{path.stem}-{name}.npy") for name in ("inputs", "outputs")]
    for target, array in zip(paths, exchange.join(data), strict=True):
        np.save(target, array)
    return paths


def _hdf5(source: Path, data: Dataset, path: Path) -> list[Path]:
    if len(shards.files(source)) == 1:
        path.write_bytes(source.read_bytes())
    else:
        data.write(path, shards.attributes(source))
    return [path]


def _mat(source: Path, data: Dataset, path: Path) -> list[Path]:
    matlab = required("export mat", "scipy.io", "scipy", "mat")
    matlab.savemat(path, {name: getattr(data, name) for name in MEANING}, do_compression=True, oned_as="column")
    return [path]


WRITERS: dict[str, Callable[[Path, Dataset, Path], list[Path]]] = {"npy": _npy, "hdf5": _hdf5, "mat": _mat}


def _splits(data: Dataset, rollouts: int | None) -> dict[str, Any]:
    """Both splits: the rows held out, and how near the nearest training row is."""
    _, test = exchange.split(len(data), None)
    splits: dict[str, Any] = {"rows": {"held_out": int(test.sum()), "nearest": exchange.nearest(data, test)}}
    if rollouts:
        splits["rollouts"] = {"held_out": int(data.test.sum()), "nearest": exchange.nearest(data, data.test)}
        splits["together"] = exchange.together(data)
    return splits


def _doubts(answers: dict[str, Any], nx: int) -> list[str]:
    checks = answers["checks"]
    lines = [
        f"{state}: P = X + D_hat ∫ f(P, u) leaves {100 * relative:.3g} % of what P moves: is it another plant?"
        for state, relative in checks["relative"].items()
        if not relative <= RELATIVE
    ]
    lines += [
        f"{state}: P(0) is up to {off:.3g} from X: does the first node lie at x = 0?"
        for state, off in checks["start"].items()
        if not off <= START
    ]
    if not abs(checks["horizon"] - 1) <= CELL / (nx - 1):
        lines.append(
            f"P fits {checks['horizon']:.4f} D_hat better: do the nodes end at x = 1? Expected linspace(0, 1, nx)"
        )
    if answers["splits"].get("together", 1.0) < SHUFFLED:
        lines.append("the rows look shuffled: no nearer to their rollout than by chance; leave out --rollouts")
    return lines


def _summary(document: dict[str, Any]) -> str:
    checks, splits = document["checks"], document["splits"]
    lines = [
        f"{document['file']}: {document['samples']} samples on {document['nx']} nodes for plant {document['plant']}",
        f"sup |P(0) - X|: {_by_state(checks['start'])}",
        f"sup residual of P = X + D_hat ∫ f(P, u): {_by_state(checks['residual'])}",
        f"rms of it over rms of P - X: {_by_state(checks['relative'])}; P fits {checks['horizon']:.4f} D_hat best",
    ]
    for name in ("rows", "rollouts"):
        if name in splits:
            lines.append(
                f"split by {name}: {splits[name]['held_out']} rows held out, the nearest training row "
                f"{splits[name]['nearest']:.3g} deviations away"
            )
    used = "rollouts" if "rollouts" in splits else "rows; with --rollouts N, by rollout"
    return "\n".join([*lines, f'held out in the file: by {used}\nuse it: data = "{document["file"]}" below [generate]'])


def _by_state(values: dict[str, float]) -> str:
    return ", ".join(f"{state} {value:.3g}" for state, value in values.items())
