"""`npred init`: a plant file and its pipeline, from comments or from a plant that there is."""

import inspect
import re
import sys
import tomllib
from importlib.resources import files
from keyword import iskeyword
from pathlib import Path
from typing import TYPE_CHECKING

from npred.base import defaults
from npred.base.errors import ConfigError
from npred.cli.options import Common

if TYPE_CHECKING:
    from npred.plants import Plant

PLANT, PIPELINE = "plant.py.txt", "pipeline.toml.txt"


def init(options: Common, name: str, source: str | None = None) -> None:
    """Write NAME.py and NAME.toml here, from the plant `source` if there is one.

    Raises ConfigError for a name that Python refuses, where a file exists, and for a plant that there is none of.
    """
    class_name = "".join(word.capitalize() for word in name.split("_"))
    written = name.isascii() and name.isidentifier() and name.islower() and class_name.isidentifier()
    if not written or iskeyword(name) or iskeyword(class_name):
        raise ConfigError(f"init: expected a name as my_plant, small letters and _, got {name!r}; choose another")
    paths = Path(name + ".py"), Path(name + ".toml")
    there = [str(path) for path in paths if path.exists()]
    if there:
        raise ConfigError(f"init: expected no {' or '.join(there)} here, found it; choose another name or move it")
    fresh = _filled(PLANT, name, class_name), _filled(PIPELINE, name, class_name)
    for path, text in zip(paths, _copies(source, name, class_name) if source else fresh, strict=True):
        with path.open("x", encoding="utf-8") as file:
            file.write(text)
    spec = f"{name}.py:{class_name}"
    todo = f"wrote {name}.py and {name}.toml\nnext: npred plants check {spec}, then npred run {name}.toml"
    options.show({"plant": spec, "files": [str(path) for path in paths]}, lambda: todo)


def _filled(template: str, name: str, class_name: str) -> str:
    text = (files("npred.cli") / "templates" / template).read_text(encoding="utf-8")
    return text.replace("NAME", name).replace("CLASS", class_name)


def _copies(source: str, name: str, class_name: str) -> tuple[str, str]:
    """The plant's file with its class renamed, and a pipeline of the plant that is part of npred, else the template."""
    from npred import plants

    plant = plants.resolve(source)
    texts = {name: path.read_text(encoding="utf-8") for name, path in defaults.shipped().items()}
    # that of its name, else pipeline/paper.toml or the first that has this plant
    names = sorted(texts, key=lambda name: (name != source, name != defaults.PIPELINE.stem))
    toml = next((texts[name] for name in names if tomllib.loads(texts[name])["plant"] == source), None)
    if toml is None:
        return _renamed(source, plant, class_name), _fitted(_filled(PIPELINE, name, class_name), plant)
    toml = re.sub(r"^baselines = .*\n", "", toml, flags=re.MULTILINE)  # of files that lie beside that pipeline
    toml = re.sub(r"^name = .*$", f'name = "{name}"', toml, count=1, flags=re.MULTILINE)
    toml = re.sub(r"^plant = .*$", f'plant = "{name}.py:{class_name}"', toml, count=1, flags=re.MULTILINE)
    return _renamed(source, plant, class_name), toml


def _renamed(source: str, plant: "Plant", class_name: str) -> str:
    """The text of a plant's file with its class renamed to `class_name`; of a family, with a class for this member."""
    from npred.base import registry

    in_file = registry.in_file(source)
    # a declaration without V is completed by a class of npred below it
    modules = [sys.modules.get(k.__module__) for k in plant.declaration.__mro__ if "states" in vars(k)]
    path = registry.split(source)[0] if in_file else Path(inspect.getfile(next(filter(None, modules))))
    text, old = path.read_text(encoding="utf-8"), plant.declaration.__name__
    if re.search(rf"^class {old}\b", text, re.MULTILINE):
        return re.sub(rf"\b{old}\b", class_name, text)
    declaration = registry.split(source)[1] if in_file else f'PLANTS["{source}"]'
    return f"{text.rstrip()}\n{class_name} = {declaration}\n"


def _fitted(text: str, plant: "Plant") -> str:
    """The template for this plant: it starts in the middle of its box, and where nothing rests so do the networks."""
    middle = [sum(plant.box[state]) / 2 if state in plant.box else 0.0 for state in plant.states]
    text = re.sub(r"^X0 = \S.*?(?=  |$)", f"X0 = {[round(value, 6) for value in middle]}", text, flags=re.MULTILINE)
    if hasattr(plant.declaration, "reference"):
        text = re.sub(
            r"^(\[train\.\w+\])$", r'\1\nanchor = "initial"    # nothing rests here', text, flags=re.MULTILINE
        )
    return text
