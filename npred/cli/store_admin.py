"""The commands that look after the store and the machine."""

import os
import platform
from pathlib import Path

from npred.base import devices
from npred.base.errors import StoreError, installed
from npred.cli.gc import shortened
from npred.cli.options import Common
from npred.lab.store import Artifact
from npred.lab.store.manifest import NAME, versions

SHOWN = 4  # names of results on a line
PACKAGES = ("npred", "numpy", "torch", "h5py", "pydantic", "safetensors", "typer", "onnxruntime", "distributed")


def doctor(options: Common) -> None:
    """Versions, devices, threads and the store, every file read: corrupt has changed bytes, incomplete fewer."""
    store = options.results
    artifacts, broken = store.survey()
    faulty = {*broken, *map(Path, _faults(options, artifacts))}
    lacking = {a.folder for a in artifacts if not all((a.folder / name).exists() for name in a.manifest.files)}
    lacking |= {folder for folder in broken if not (folder / NAME).exists()}
    above = next(path for path in [store.root, *store.root.absolute().parents] if path.exists())
    facts: dict[str, object] = {"python": platform.python_version(), "platform": platform.platform()}
    facts |= {key: value for key, value in devices.hardware("cpu").items() if key in ("cpu", "cores")}
    facts |= {"torch_threads": None, "gpus": []}
    if installed("torch"):
        import torch

        facts["torch_threads"] = torch.get_num_threads()
        facts["gpus"] = [torch.cuda.get_device_name(index) for index in range(torch.cuda.device_count())]
    facts |= {"compiler": versions()["compiler"], "packages": devices.packages(*PACKAGES)}
    facts["store"] = {
        "path": str(store.root),
        "writable": os.access(above, os.W_OK),
        "artifacts": len(artifacts),
        "bytes": sum(artifact.size for artifact in artifacts),
        "corrupt": len(faulty - lacking),
        "incomplete": len(lacking),
        "broken": [str(folder) for folder in broken],
        "leftovers": [str(path) for path in store.leftovers()],
    }
    options.show(facts, lambda: "\n".join(f"{name}: {_words(value)}" for name, value in facts.items()))


def _words(value: object) -> str:
    if isinstance(value, dict):
        return ", ".join(f"{key} {_words(item)}" for key, item in value.items())
    if value is None or isinstance(value, bool):
        return {None: "absent", True: "yes", False: "no"}[value]
    return ", ".join(map(str, value)) or "none" if isinstance(value, list) else str(value)


def verify(options: Common) -> None:
    """Read every file of every result. Raises StoreError where one is not as it was written."""
    sound, broken = options.results.survey()
    faults = {str(folder): "no sound manifest" for folder in broken} | _faults(options, sound)
    made_with = {a.folder: a.manifest.circumstances for a in sound} | {folder: {} for folder in broken}
    table, entries = [], []
    for folder, circumstances in made_with.items():
        fault = faults.get(str(folder))
        state = "corrupt" if fault else "sound"
        table.append([shortened(folder), state, fault or ""])
        entries.append({"folder": str(folder), "state": state, "made_with": circumstances, "fault": fault})
    options.show_table({"artifacts": entries}, ["artifact", "state", "fault"], table)
    for name in dict.fromkeys(name for circumstances in made_with.values() for name in circumstances):
        results: dict[str, list[str]] = {}  # by the processor, say, or a mode of a library
        for artifact in sound:
            if value := artifact.manifest.circumstances.get(name):  # none where the stage does not need it
                results.setdefault(value, []).append(artifact.name)
        if len(results) > 1 and not options.json:
            options.console.out(f"made with different {name}:")
            for value, names in results.items():
                more = f" and {len(names) - SHOWN} more" if len(names) > SHOWN else ""
                options.console.out(f"  {value}: {', '.join(names[:SHOWN])}{more}")
    if faults:
        first = next(iter(faults))
        raise StoreError(f"{options.store}: expected sound results, got {len(faults)} corrupt, as {first}; remove them")


def _faults(options: Common, artifacts: list[Artifact]) -> dict[str, str]:
    """The fault of each result, by folder; every file is read."""
    faults = {}
    with options.console.bar("verify", len(artifacts), "results") as bar:
        for artifact in artifacts:
            try:
                artifact.verify()
            except StoreError as error:
                faults[str(artifact.folder)] = str(error)
            bar.advance()
    return faults
