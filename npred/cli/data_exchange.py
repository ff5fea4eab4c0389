"""`npred import`, and `npred export` of data: samples from and for other programs."""

from collections.abc import Callable, Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple, Self

import numpy as np

from npred import plants
from npred.cli.options import Common, Exporting, writable
from npred.data import exchange, shards
from npred.data.dataset import MEANING, Dataset, attributes
from npred.delays import problem_of
from npred.errors import ConfigError, required, room_on_disk
from npred.json_files import plain
from npred.pipeline import load_data

RELATIVE = 0.05  # residual over what P moves: Euler's method leaves a third of it at dx = 0.01
START = 1e-3  # of P(0) from X, in units of the state: files in single precision round a state of 1000 by less
CELL = 0.5  # of a cell of the grid: by how much the delay that fits best may be off
SHUFFLED = 0.1  # of exchange.together
Checks = dict[str, Any]  # of exchange.checks: numbers by state, and one


class Split(NamedTuple):
    """How many rows are held out, and how many deviations away the nearest training row is."""

    held_out: int
    nearest: float

    @classmethod
    def of(cls, data: Dataset, test: np.ndarray) -> Self:
        """The split that holds out these rows (N,)."""
        return cls(int(test.sum()), exchange.nearest(data, test))


def bring(
    options: Common, form: str, inputs: Path, outputs: Path, plant_name: str, rollouts: int | None, output: Path
) -> None:
    """Write the rows of two files as one HDF5 file, and say what holds of them. Raises ConfigError where it cannot."""
    if form != "npy":
        raise ConfigError(f"import: expected npy, got {form!r}; name the format of the two files")
    if output.resolve() in (inputs.resolve(), outputs.resolve()):
        raise ConfigError(f"import: expected another file than the two, got --output {output}; name one")
    plant = plants.resolve(plant_name)
    problem_of(plant).needs("import")
    data = exchange.part(plant, exchange.read(inputs), exchange.read(outputs), rollouts)
    nx, checks = data.u.shape[1], exchange.checks(plant, data)
    splits = {"rows": Split.of(data, exchange.split(len(data), None)[1])}
    together = exchange.together(data) if rollouts else None
    if rollouts:
        splits["rollouts"] = Split.of(data, data.test)
    for line in _doubts(checks, together, nx):
        options.console.warn(line)
    with room_on_disk(output):
        data.write(writable(output), attributes(plant, "imported"))
    measured = {name: split._asdict() for name, split in splits.items()}
    document = {
        "file": str(output), "plant": plant.name, "samples": len(data), "nx": nx, "checks": checks,
        "splits": measured if together is None else measured | {"together": together},
    }  # fmt: skip
    first = f"{output}: {len(data)} samples on {nx} nodes for plant {plant.name}"
    options.show(plain(document), lambda: "\n".join([first, *_summary(output, checks, splits)]))


def export(options: Exporting, form: str, spec: str, output: Path | None) -> None:
    """Write the samples of a generate artifact. Raises ConfigError where there is none, MissingError without scipy."""
    artifact = load_data(spec, options.store, options.set)
    data = Dataset.read(artifact.folder / "data.h5")
    path = writable(output or Path(f"data.{'h5' if form == 'hdf5' else form}"))
    with room_on_disk(path), TemporaryDirectory(dir=path.parent, prefix=".npred-") as aside:
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


def _doubts(checks: Checks, together: float | None, nx: int) -> list[str]:
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
    if together is not None and together < SHUFFLED:
        lines.append("the rows look shuffled: no nearer to their rollout than by chance; leave out --rollouts")
    return lines


def _summary(output: Path, checks: Checks, splits: dict[str, Split]) -> Iterator[str]:
    yield f"sup |P(0) - X|: {_by_state(checks['start'])}"
    yield f"sup residual of P = X + D_hat ∫ f(P, u): {_by_state(checks['residual'])}"
    yield f"rms of it over rms of P - X: {_by_state(checks['relative'])}; P fits {checks['horizon']:.4f} D_hat best"
    for name, split in splits.items():
        away = f"the nearest training row {split.nearest:.3g} deviations away"
        yield f"split by {name}: {split.held_out} rows held out, {away}"
    yield f"held out in the file: by {'rollouts' if 'rollouts' in splits else 'rows; with --rollouts N, by rollout'}"
    yield f'use it: data = "{output}" below [generate]'


def _by_state(values: dict[str, float]) -> str:
    return ", ".join(f"{state} {value:.3g}" for state, value in values.items())
