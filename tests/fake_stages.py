"""Stages that take no time, for the tests of what runs them; also a program that is `npred` with these stages.

FAKE_LOG is a file that gets a line a run. FAKE_HANG is a stage that writes half of its result, says so on the file
descriptor FAKE_READY, and goes on when the descriptor FAKE_GO says so.
"""

import os
import select
import sys
from collections.abc import Callable, MutableMapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from result_samples import BENCHED, HARDWARE, SCORES, TRAINED, evaluated

from npred.base.json_files import plain
from npred.lab.scheduler.declaration import Stage
from npred.lab.scheduler.plan import STAGES
from npred.lab.stages.report import UNFINISHED


@dataclass(frozen=True)
class Answer:
    """A result of any form."""

    document: dict[str, Any]

    def json_object(self) -> dict[str, Any]:
        return plain(self.document)


@dataclass(frozen=True)
class Fake(Stage):
    def run(self, job: Any) -> Any:
        return Answer(run(self.name, job))

    def summary(self, document: dict[str, Any], width: int | None = None, wide: bool = False) -> str:
        return f"{'details' if wide else 'summary'} of {document}"


def install(table: MutableMapping[str, Stage] = STAGES, **versions: int) -> None:
    """Put a fake in the place of each stage of the table."""
    for name, stage in table.items():
        table[name] = Fake(**vars(stage) | {"version": versions.get(name, stage.version)})


def run(name: str, job: Any) -> dict[str, Any]:
    """The data depend on plant, seed and rollouts only, so that another `samples` gives the same result."""
    if name == "report" and "bench" not in job.inputs:  # the report so far
        return ANSWERS[name](job)
    resumed = (job.scratch / "checkpoint").exists()
    _log(f"{name}:{job.model or ''}:{'resumed' if resumed else 'new'}")
    (job.folder / "data.bin").write_bytes(b"half of")
    (job.scratch / "checkpoint").write_text("epoch 3")
    if os.environ.get("FAKE_HANG") == name and not resumed and job.model in (None, "deeponet"):
        _hang(job)
    (job.folder / "data.bin").write_bytes(f"{name} {_content(name, job)}".encode() * 20)
    return ANSWERS[name](job)


RADIUS = {"median": 0.1, "worst": 0.25, "converged": 0.75, "cases": 4, "predicted": 0.5}
MODEL = SCORES | {"mse": 1.0, "eps_sup": 0.5, "radius": RADIUS}
ANSWERS: dict[str, Callable[[Any], dict[str, Any]]] = {
    "generate": lambda job: {"rollouts": job.config.generate.rollouts},
    "train": lambda job: TRAINED | {"mse": float("nan"), "epochs": getattr(job.config.train, job.model).epochs},
    "evaluate": lambda job: evaluated(dict.fromkeys(sorted(job.inputs), MODEL)),
    "bench": lambda job: BENCHED | {"hardware": HARDWARE | {"device": job.device, "threads": job.jobs}},
    "report": lambda job: {
        "summary": ["Errors.", "Loops.", "Times."],
        "bytes": (job.folder / "report.html").write_text("complete" if "bench" in job.inputs else UNFINISHED),
    },
}


def _content(name: str, job: Any) -> str:
    if name == "generate":
        return f"{job.config.seed} {job.config.generate.rollouts}"
    return " ".join((folder / "data.bin").read_text() for folder in job.inputs.values())[:50]


def _log(line: str) -> None:
    if path := os.environ.get("FAKE_LOG"):
        with Path(path).open("a") as file:
            file.write(line + "\n")


def _hang(job: Any) -> None:
    """Work that goes on until it is let go, with a word of progress now and then."""
    os.write(int(os.environ["FAKE_READY"]), b"!")
    with job.progress.bar("hang", 1, "step") as bar:
        while not select.select([int(os.environ["FAKE_GO"])], [], [], 0.02)[0]:
            bar.advance(0)


if __name__ == "__main__":
    from npred.cli import main

    install()
    sys.argv[0] = "npred"
    main()
