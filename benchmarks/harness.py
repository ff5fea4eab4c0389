"""What the benchmarks share: options, tables, networks, times, controllers in C and as FMUs, CMA-ES, other commits."""

import argparse
import ctypes
import subprocess
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

import npred
from npred.base.errors import ConfigError, DivergedError
from npred.exports import c_controller, c_files, fmu

ROOT = Path(__file__).resolve().parents[1]
PAPER = "pipeline/paper.toml:deeponet"
SIZE = "unsigned long size(void);\nunsigned long size(void) { return sizeof(npred_controller); }\n"


def options(text: str | None, places: Mapping[str, Any] = {}, **named: Any) -> argparse.Namespace:
    """What the command line asks for; `text` is what --help says.

    `places` are arguments without a flag: `...` and a type are required, a list or a mapping stand for any number of
    words (of a mapping: of its keys), by default all. A flag has its default, or a type, and is None then; False is
    switched on; a list takes several values, of the kind of its first, a mapping some of its keys; of a tuple of words
    one is taken, by default the first.
    """

    def kind(values: Any) -> Any:
        first = values[0] if isinstance(values, list) and values else str
        return first if isinstance(first, type) else type(first)

    parser = argparse.ArgumentParser(description=text, formatter_class=argparse.RawDescriptionHelpFormatter)
    for name, value in places.items():
        if isinstance(value, list | Mapping):
            parser.add_argument(name, nargs="*", type=kind(value))
        elif value is ... or isinstance(value, type):
            parser.add_argument(name, type=str if value is ... else value)
        else:
            parser.add_argument(name, nargs="?", default=value, type=type(value))
    for name, value in named.items():
        flag = "--" + name.replace("_", "-")
        if value is False:
            parser.add_argument(flag, action="store_true")
        elif isinstance(value, Mapping):
            parser.add_argument(flag, nargs="+", choices=value, default=[*value], metavar="NAME")
        elif isinstance(value, list):
            parser.add_argument(flag, nargs="*", default=[] if value[:1] == [kind(value)] else value, type=kind(value))
        elif isinstance(value, tuple):
            parser.add_argument(flag, choices=value, default=value[0])
        elif isinstance(value, type):
            parser.add_argument(flag, type=value)
        else:
            parser.add_argument(flag, default=value, type=type(value))
    asked = parser.parse_args()
    for name, value in places.items():
        given = getattr(asked, name)
        if isinstance(value, Mapping) and (wrong := [word for word in given if word not in value]):
            parser.error(f"{name}: expected some of {', '.join(value)}, got {', '.join(wrong)}")
        if isinstance(value, list | Mapping) and not given:
            setattr(asked, name, [*value])
    return asked


def chosen(text: str | None, *parts: Callable[[], Any]) -> list[Callable[[], Any]]:
    """Those of a benchmark's parts that the command line names, by default all."""
    by_name = {part.__name__: part for part in parts}
    return [by_name[name] for name in options(text, {"parts": by_name}).parts]


def head(*names: Any) -> None:
    """The first lines of a table in Markdown."""
    row(*names)
    print("|" + "---|" * len(names), flush=True)


def row(*cells: Any) -> None:
    print("| " + " | ".join(map(str, cells)) + " |", flush=True)


def pipeline(model: str) -> Any:
    """That of PIPELINE:NETWORK."""
    from npred.lab import config

    return config.load(Path(model.rpartition(":")[0]))


def network(asked: argparse.Namespace, nx: int | None = None) -> Any:
    """The trained network that `model` names, of `store`, fused, on nx nodes."""
    return npred.load(asked.model, nx=nx or asked.nx, store=asked.store, runtime="fused")


def samples(model: str, store: Path | str | None) -> Any:
    """The data of a network."""
    from npred.lab.scheduler.models import load_data
    from npred.lab.training.data import shards

    found = load_data(model.rpartition(":")[0], None if store is None else Path(store))
    return shards.survey(found.folder / "data.h5")


def box(plant: Any) -> np.ndarray:
    """The low and the high ends of a plant's box, (2, n)."""
    return np.array([plant.box[name] for name in plant.states]).T


def half_widths(plant: Any) -> np.ndarray:
    return np.ptp(box(plant), axis=0) / 2


def starts(plant: Any, count: int, rng: np.random.Generator) -> np.ndarray:
    """States of the box, (count, n)."""
    return rng.uniform(*box(plant), (count, plant.n))


def rk4(f: Callable[[Any], Any], x: Any, h: Any) -> Any:
    """A step of Kutta's method."""
    k1 = f(x)
    k2 = f(x + h / 2 * k1)
    k3 = f(x + h / 2 * k2)
    return x + h / 6 * (k1 + 2 * k2 + 2 * k3 + f(x + h * k3))


def seconds(call: Callable[[], Any], clock: Callable[[], float] = time.perf_counter) -> tuple[float, Any]:
    """What a call takes, and its answer."""
    start = clock()
    answer = call()
    return clock() - start, answer


def evolve(
    score: Callable[[list[np.ndarray]], Sequence[float]], centre: np.ndarray, width: float, popsize: int, seed: int
) -> Iterator[bool]:
    """CMA-ES in [0, 1]^k makes the score small: after each population whether it would stop."""
    import cma

    settings = {"bounds": [0, 1], "popsize": popsize, "seed": seed, "verbose": -9}
    search = cma.CMAEvolutionStrategy(centre, width, settings)
    while True:
        points = search.ask()
        search.tell(points, score(points))
        yield bool(search.stop())


# controllers


def sources(controller: Any, folder: Path, **settings: Any) -> None:
    """Write the files of a controller in C."""
    for file, text in zip(("npred.h", "npred.c"), c_controller.sources(controller, **settings), strict=True):
        (folder / file).write_text(text)


def command_line(*words: str) -> str:
    """What a command of npred prints, in this process."""
    from typer.testing import CliRunner

    from npred.cli import app

    done = CliRunner().invoke(app, [*words])
    if done.exit_code:
        raise SystemExit(done.output)
    return done.output


class InPython:
    """A controller with `set`, `step` (DivergedError where a sample is refused) and `begin`, which forgets all."""

    def __init__(self, controller: Any, folder: Path) -> None:
        self.first = controller
        self.begin()

    def begin(self) -> None:
        self.one = self.first.fresh()

    def set(self, **values: float) -> None:
        self.one.set(**values)

    def step(self, X: np.ndarray) -> np.ndarray:
        return self.one.step(X).copy()


class InC:
    """The same of the exported C."""

    def __init__(self, controller: Any, folder: Path) -> None:
        sources(controller, folder)
        (folder / "size.c").write_text(f'#include "npred.c"\n{SIZE}')
        c_files.build([folder / "size.c"], folder / "npred.so", "controller")
        self.library, self.first = ctypes.CDLL(str(folder / "npred.so")), c_controller.settable(controller)
        self.library.size.restype, self.m = ctypes.c_ulong, controller.plant.m
        self.begin()

    def begin(self) -> None:
        self.values, self.memory = self.first, ctypes.create_string_buffer(self.library.size())
        self.library.npred_init(self.memory)

    def set(self, **values: float) -> None:
        wanted = self.values | values
        numbers = np.array([*wanted.values()])
        if self.library.npred_set_parameters(self.memory, numbers.ctypes.data_as(ctypes.c_void_p)):
            raise ConfigError("refused")
        self.values = wanted

    def step(self, X: np.ndarray) -> np.ndarray:
        X, U = np.ascontiguousarray(X), np.zeros(self.m)
        if self.library.npred_step(self.memory, *(a.ctypes.data_as(ctypes.c_void_p) for a in (X, U))):
            raise DivergedError("refused")
        return U


class InFmu:
    """The same of the FMU, by FMPy; a step that is refused says so in the log."""

    def __init__(self, controller: Any, folder: Path) -> None:
        import fmpy

        path, self.dt, self.slave, self.messages = folder / "controller.fmu", controller.dt, None, []
        npred.export(controller, "fmu", path)
        listed = fmu.variables(controller, controller.plant.target(0.0), arrays=True)
        self.places = {variable.name: k for k, variable in enumerate(listed)}
        self.X, self.U = ([k for k, one in enumerate(listed) if one.block == block] for block in "XU")
        self.described: Any = fmpy.read_model_description(str(path))
        self.unzipped = fmpy.extract(str(path), str(folder / "fmu"))
        self.begin()

    def begin(self) -> None:
        from fmpy.fmi3 import FMU3Slave

        if self.slave:
            self.slave.terminate()
            self.slave.freeInstance()
        self.t, self.slave = 0.0, FMU3Slave(
            guid=self.described.instantiationToken, unzipDirectory=self.unzipped,
            modelIdentifier=self.described.coSimulation.modelIdentifier, instanceName="one",
        )  # fmt: skip
        self.slave.instantiate(logMessage=lambda *call: self.messages.append(call[3]))
        self.slave.enterInitializationMode(startTime=0.0)
        self.slave.exitInitializationMode()

    def set(self, **values: float) -> None:
        from fmpy.fmi1 import FMICallException

        try:
            self.slave.setFloat64([self.places[f"parameter.{name}"] for name in values], [*values.values()])
        except FMICallException as error:
            raise ConfigError("refused") from error

    def step(self, X: np.ndarray) -> np.ndarray:
        self.messages.clear()
        self.slave.setFloat64(self.X, X.tolist())
        self.slave.doStep(self.t, self.dt)
        self.t += self.dt
        if self.messages:
            raise DivergedError("refused")
        return np.array(self.slave.getFloat64(self.U))


KINDS = {"Python": InPython, "C": InC, "FMU": InFmu}


# other commits


@contextmanager
def worktree(commit: str) -> Iterator[Path]:
    """A folder with the files of a commit, and beside it room for caches."""
    with tempfile.TemporaryDirectory() as folder:
        tree, git = Path(folder) / "base", ["git", "-C", str(ROOT), "worktree"]
        subprocess.run([*git, "add", "--quiet", "--detach", str(tree), commit], check=True)
        try:
            yield tree
        finally:
            subprocess.run([*git, "remove", "--force", str(tree)], check=True)


def in_turn(takers: Sequence[Callable[[], float]], rounds: int) -> np.ndarray:
    """What each takes in each round, (takers, rounds), in an order that alternates."""
    times = np.empty((len(takers), rounds))
    for turn in range(rounds):
        order: Iterable[int] = range(len(takers)) if turn % 2 else reversed(range(len(takers)))
        for k in order:
            times[k, turn] = takers[k]()
    return times
