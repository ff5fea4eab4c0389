"""What an installation takes: megabytes, seconds, the time of `import npred`; and what works there, without torch.

    python benchmarks/install.py [--extra train …] [--model pipeline/paper.toml:deeponet] [--store artifacts] [--cached]

Each line is a new environment with the wheel of this checkout: without extras, then with each that is named.
Packages are downloaded, unless `--cached` lets pip take those that it has. MB are those of the environment's packages;
pip and setuptools, which are there before, count apart. Times of imports are medians of new processes, beside that of
NumPy, which the names bring. With `--model`, a trained network of the store, the tasks are done with it too.
"""

import os
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path

import harness

from npred.lab.report.terminal.console import columns

REPEATS = 9
NAMES = "npred.plant, npred.predictor, npred.simulate, npred.controller, npred.guarded, npred.load"
IMPORTS = {"import numpy": "import numpy", "import npred": "import npred", "and its names": f"import npred; {NAMES}"}
LOOP = """
import npred
plant = npred.plant("activator_repressor")
law = npred.DelayAdaptation(gamma=1000.0, b=1.0, bounds=(0.1, 4.0))
run = dict(D=1.0, D_hat=2.0, X0=[0.03, 30.0], t_end=20.0, dt=0.005, adaptation=law)
"""
SIMULATE = f"{LOOP}print(npred.simulate(plant, npred.predictor(plant, 'rk4'), **run))"
PLOT = f"{LOOP}npred.simulate(plant, npred.predictor(plant, 'rk4'), **run).plot(D=1.0)[0].figure.savefig('loop.pdf')"
LOAD = f"{LOOP}model = npred.load('{{model}}', store='{{store}}')\n"
RUN = "print(npred.simulate(plant, model, **run))"
GUARD = "print(npred.simulate(plant, npred.guarded(model), **run))"
STEP = """
controller = npred.controller(plant, model, law, 0.005, D_hat=2.0, actuator="measured")
print(controller.step([0.03, 30.0], [[0.0]] * 101))
"""


def scripts(model: str, store: Path) -> dict[str, str]:
    """Python programs by what they do."""
    with_model = {"load, fused, in a loop": LOAD + RUN, "guarded": LOAD + GUARD, "controller": LOAD + STEP}
    programs = {"simulate": SIMULATE, "plot": PLOT} | (with_model if model else {})
    return {task: text.replace("{model}", model).replace("{store}", str(store)) for task, text in programs.items()}


def commands(model: str, store: Path) -> dict[str, list[str]]:
    """Commands of npred by what they do."""
    forms = ("controller", "fmu", "c") if model else ()
    exports = {f"export {form}": ["export", form, model, "-o", form, "--store", str(store)] for form in forms}
    return {"npred --help": ["--help"], **exports}


def megabytes(folder: Path) -> tuple[float, float]:
    """MB on the disk of an environment's packages, and without those that every new one has."""
    (packages,) = folder.glob("lib/python*/site-packages")
    sizes = {path: path.lstat().st_blocks * 512 / 2**20 for path in packages.rglob("*")}
    brought = ("pip", "setuptools", "pkg_resources", "_distutils_hack")
    ours = [size for path, size in sizes.items() if not path.relative_to(packages).parts[0].startswith(brought)]
    return sum(sizes.values()), sum(ours)


def built(folder: Path) -> Path:
    """The wheel of this checkout, as a release has it."""
    pip = [sys.executable, "-m", "pip", "wheel", "--quiet", "--disable-pip-version-check", "--no-deps", "-w", folder]
    subprocess.run([*pip, harness.ROOT], check=True)
    (wheel,) = folder.glob("npred-*.whl")
    return wheel


def install(folder: Path, wheel: Path, extras: str, cached: bool) -> float:
    """A new environment; the seconds that pip takes."""
    subprocess.run([sys.executable, "-m", "venv", folder], check=True)
    pip = [folder / "bin" / "python", "-m", "pip", "install", "--quiet", "--disable-pip-version-check"]
    words = [*pip, *([] if cached else ["--no-cache-dir"]), f"{wheel}{extras}"]
    return harness.seconds(lambda: subprocess.run(words, check=True, cwd=folder))[0]


def seconds(command: list[str], folder: Path) -> float:
    """The time of a process."""
    return harness.seconds(lambda: output(command, folder))[0]


def output(command: list[str], folder: Path) -> str:
    """What a process prints that sees no other npred. Raises CalledProcessError where it fails."""
    alone = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    return subprocess.run(command, cwd=folder, env=alone, check=True, capture_output=True, text=True).stdout


def import_seconds(python: str, text: str, folder: Path) -> float:
    """The median time of some imports, each in a new process, that of Python's start not in it."""
    program = f"import time\nstart = time.perf_counter()\n{text}\nprint(time.perf_counter() - start)"
    return statistics.median(float(output([python, "-c", program], folder)) for _ in range(REPEATS))


if __name__ == "__main__":
    options = harness.options(__doc__, extra=[], model="", store=Path("artifacts"), cached=False)
    path, colon, part = options.model.rpartition(":")
    model = f"{Path(path).absolute()}{colon}{part}" if path else options.model
    rows, tasks = [], []
    for extra in ["", *options.extra]:
        with tempfile.TemporaryDirectory() as temporary:
            folder = Path(temporary) / "venv"
            wheel = built(Path(temporary))
            taken = install(folder, wheel, f"[{extra}]" if extra else "", options.cached)
            python = str(folder / "bin" / "python")
            times = [f"{import_seconds(python, text, folder):.2f} s" for text in IMPORTS.values()]
            whole, added = megabytes(folder)
            name = f"npred[{extra}]" if extra else "npred"
            rows.append([name, f"{whole:.0f}", f"{added:.0f}", f"{taken:.0f} s", *times])
            for task, text in scripts(model, options.store.absolute()).items():
                tasks.append([name, task, f"{seconds([python, '-c', text], folder):.1f} s"])
            for task, words in commands(model, options.store.absolute()).items():
                tasks.append([name, task, f"{seconds([str(folder / 'bin' / 'npred'), *words], folder):.1f} s"])
    head = ["installation", "MB", "without pip, setuptools", "pip install", *IMPORTS]
    print(columns(head, rows, None, numbers=head[1:]))
    print("\nwhat works, as processes of their own (kernels compiled where the machine has none yet)\n")
    print(columns(["installation", "what", "time"], tasks, None, numbers=["time"]))
