"""Jobs for the tests of the stages: a pipeline given as tables, folders under tmp_path."""

from pathlib import Path
from typing import Any

from silent import Silent

from npred import plants
from npred.lab import config
from npred.lab.scheduler.executors import Here, Workers
from npred.lab.scheduler.job import Job

PLANT = "activator_repressor"
SMALL = {
    "generate": {"samples": 300, "rollouts": 10, "t_end": 8.0, "dt": 0.01, "nx": 21, "bounds": [0.05, 4.0]},
    "train": {
        "deeponet": {"epochs": 2, "batch": 64, "width": 8, "depth": 1, "basis": 4, "snapshots": [1]},
        "fno": {"epochs": 1, "batch": 64, "width": 4, "modes": 3, "layers": 1},
    },
    "evaluate": {"X0": [0.03, 30.0], "t_end": 4.0, "case_t_end": 6.0, "dt": 0.01, "nx": 21, "case_states": 2,
                 "case_D_hat": [0.8, 1.2]},
    "bench": {"dx": [0.1, 0.05], "calls": 12, "batches": [1, 3], "runtimes": ["torch", "fused"]},
}  # fmt: skip


def tables(**changes: dict[str, Any]) -> dict[str, Any]:
    """SMALL with some keys of some tables changed; a frozen estimate has no bounds."""
    small = {name: table | changes.get(name, {}) for name, table in SMALL.items()}
    if small["generate"].get("adaptation") == "frozen" and "bounds" not in changes["generate"]:
        del small["generate"]["bounds"]
    return {"plant": PLANT} | small | {name: value for name, value in changes.items() if name not in SMALL}


def job(root: Path, name: str, inputs: dict[str, Path] | None = None, jobs: int = 1, model: str | None = None,
        executor: Workers | None = None, **changes: Any) -> Job:  # fmt: skip
    """A job whose payload goes to root/name."""
    pipeline = config.parse(tables(**changes), "tests")
    folder, scratch = root / name, root / f"{name}.scratch"
    for path in (folder, scratch):
        path.mkdir(parents=True)
    plant = plants.resolve(pipeline.plant, pipeline.parameters)
    return Job(pipeline, plant, folder, inputs or {}, scratch, "cpu", jobs, Silent(), model, executor or Here())


def trained(root: Path) -> dict[str, Path]:
    """The folders of data and both networks, by name, as the inputs of the later stages."""
    from npred.lab.stages.generate import generate
    from npred.lab.stages.train import train  # it brings torch

    data = job(root, "generate")
    generate.run(data)
    inputs = {"generate": data.folder}
    for model in ("deeponet", "fno"):
        training = job(root, model, inputs={"generate": data.folder}, model=model)
        train.run(training)
        inputs[model] = training.folder
    return inputs
