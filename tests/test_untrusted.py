"""Files from elsewhere cannot run code: nothing is unpickled, and no artifact names a plant's file that is then run."""

import ast
import json
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import torch
from conftest import HERE, process_environment, settings_of
from safetensors.torch import save_file
from store_samples import put, question

from npred import plants
from npred.base import registry
from npred.base.errors import ConfigError, StoreError
from npred.lab import config
from npred.lab.config import FNO, DeepONet
from npred.lab.scheduler.models import load_model
from npred.lab.scheduler.plan import nodes
from npred.lab.store import Store
from npred.lab.training import operators
from npred.networks.weights import read

ROOT = HERE.parent
MODULES = [p for folder in ("npred", "benchmarks", "docs") for p in sorted((ROOT / folder).rglob("*.py"))]
UNPICKLE = {"pickle", "cPickle", "dill", "cloudpickle", "joblib", "shelve", "marshal"}


def unpickles(path: Path) -> Iterator[str]:
    """Where a module could unpickle: an import, torch.load, np.load without allow_pickle=False, pandas."""
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import | ast.ImportFrom):
            names = {alias.name.split(".")[0] for alias in node.names} | {
                (getattr(node, "module", "") or "").split(".")[0]
            }
            yield from (f"{path.name}:{node.lineno} {name}" for name in names & UNPICKLE)
        elif isinstance(node, ast.Call) and ast.unparse(node.func) in (
            "torch.load",
            "torch.jit.load",
            "np.load",
            "numpy.load",
        ):
            safe = {k.arg: ast.unparse(k.value) for k in node.keywords}.get("allow_pickle") == "False"
            if not (ast.unparse(node.func) in ("np.load", "numpy.load") and safe):
                yield f"{path.name}:{node.lineno} {ast.unparse(node.func)}"


def test_nothing_is_unpickled(tmp_path: Path):
    assert [found for path in MODULES for found in unpickles(path)] == []
    for line in (
        "import pickle",
        "from joblib import load",
        "torch.load(p)",
        "np.load(p)",
        "np.load(p, allow_pickle=True)",
    ):
        (tmp_path / "m.py").write_text(line)
        assert len(list(unpickles(tmp_path / "m.py"))) == 1, line


@pytest.mark.parametrize("source", [None, "0" * 64])
def test_an_artifact_does_not_run_the_plant_that_it_names(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, source: str | None
):
    monkeypatch.chdir(tmp_path)
    Path("evil.py").write_text("open('ran', 'w')\nclass Tank:\n    pass\n")
    plant = {"name": "evil.py:Tank", "parameters": {}, "source": source, "program": "x"}
    found = put(Store(Path("artifacts")), question(config={"plant": plant}))
    for spec in (str(found.folder), found.manifest.key):
        with pytest.raises(ConfigError, match=r"expected a built-in plant, got 'evil\.py:Tank' .*; use PIPELINE:MODEL"):
            load_model(spec)
    assert not Path("ran").exists()


@pytest.mark.parametrize("plant", [None, "scalar", {}, {"name": ["scalar"]}, {"name": "scalar", "parameters": [1]}])
def test_an_artifact_without_a_plant_is_one_line(tmp_path: Path, plant: Any):
    made = put(Store(tmp_path), question(config={"plant": plant}))
    with pytest.raises(ConfigError, match="expected a built-in plant"):
        load_model(str(made.folder))


def model(folder: Path, table: DeepONet | FNO) -> dict[str, Any]:
    """A saved model, and its model.json."""
    plant = plants.resolve("scalar")
    operators.save(folder, operators.build(table, plant, operators.Scaling(1, 1)), table)
    return json.loads((folder / "model.json").read_text())


@pytest.mark.parametrize(
    ("table", "change"),
    [
        (DeepONet(width=4, depth=1, basis=3, trunk=4), {"width": 10**9}),
        (DeepONet(width=4, depth=1, basis=3, trunk=4), {"width": 10**15}),
        (DeepONet(width=4, depth=1, basis=3, trunk=4), {"width": 10**30}),
        (DeepONet(width=4, depth=1, basis=3, trunk=4), {"depth": 10**12}),
        (FNO(width=3, modes=2, layers=1), {"layers": 10**12}),
        (FNO(width=3, modes=2, layers=1), {"modes": 10**9, "width": 10**6}),
    ],
)
def test_no_room_is_made_for_weights_that_are_not_there(tmp_path: Path, table: DeepONet | FNO, change: dict[str, int]):
    found = model(tmp_path, table)
    (tmp_path / "model.json").write_text(json.dumps(found | {"arguments": found["arguments"] | change}))
    with pytest.raises(StoreError, match=r"model\.safetensors: expected weights of this model, got: "):
        read(tmp_path, plants.resolve("scalar"))


@pytest.mark.parametrize(
    "text", ["[]", "{}", '{"model": "cnn", "config": {}}', '{"model": [], "config": 1}', "[" * 9999]
)
def test_a_strange_table_is_one_line(tmp_path: Path, text: str):
    model(tmp_path, FNO(width=3, modes=2, layers=1))
    (tmp_path / "model.json").write_text(text)
    with pytest.raises(StoreError, match=r"model\.json: expected "):
        read(tmp_path, plants.resolve("scalar"))


def test_weights_of_another_precision_or_shape_are_refused(tmp_path: Path):
    plant, table = plants.resolve("scalar"), FNO(width=3, modes=2, layers=1)
    model(tmp_path, table)
    state = {k: v.contiguous() for k, v in read(tmp_path, plant).module(plant).state_dict().items()}
    for name, tensor in {"lift.weight": torch.zeros(3, 9), "lift.bias": torch.zeros(3, dtype=torch.int32)}.items():
        save_file(state | {f"network.{name}": tensor}, tmp_path / "model.safetensors")
        with pytest.raises(StoreError, match=f"network.{name}: expected"):
            read(tmp_path, plant)
    save_file(state, tmp_path / "model.safetensors")
    read(tmp_path, plant)


def test_some_hundreds_of_mutated_files():
    command = [sys.executable, str(HERE / "fuzz.py"), "600", "7"]
    done = subprocess.run(command, env=process_environment(), capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    assert int(done.stdout.splitlines()[-1].split()[1]) > 400  # most of them were refused


@pytest.mark.parametrize("line", ['data = "{}"', 'adaptation = "{}:Law"'])
def test_a_pipe_in_the_place_of_a_file_is_not_waited_for(tmp_path: Path, line: str):
    os.mkfifo(tmp_path / "pipe.py")
    (tmp_path / "p.toml").write_text(f'plant = "scalar"\n[generate]\n{line.format("pipe.py")}\n')
    pipeline = config.load(tmp_path / "p.toml")
    node = nodes(pipeline, ["generate"])[0]
    with pytest.raises(ConfigError, match=r"expected a.* file"):
        settings_of(node, pipeline)


@pytest.mark.parametrize("name", ["*/ int owned; /*", "a b", "", "class", "a\nb"])
def test_a_class_is_an_identifier_everywhere(tmp_path: Path, name: str):
    (tmp_path / "x.py").write_text(f"from npred.plants.builtin.scalar import Scalar\nglobals()[{name!r}] = Scalar\n")
    for call in (plants.resolve, registry.DELAY_LAWS.identity):
        with pytest.raises(ConfigError, match="expected the name of a class after the colon"):
            call(f"{tmp_path}/x.py:{name}")


@pytest.mark.parametrize("name", ["*/ int owned; /*", "a\nb", "", "-x", "a\\", "<b>", "x" * 101])
def test_a_plants_name_is_no_more_than_a_name(name: str):
    with pytest.raises(ConfigError, match=r"plant: expected a name of letters"):
        plants.make(name, plants.resolve("scalar").declaration)
