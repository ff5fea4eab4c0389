"""`npred init`: a plant file and its pipeline, from comments or from a plant that there is."""

import inspect
import re
import sys
import tomllib
from importlib.resources import files
from keyword import iskeyword
from pathlib import Path
from typing import Annotated

from npred import plants
from npred.base import defaults, registry
from npred.base.errors import ConfigError
from npred.cli.options import Common, argument, flag

TEMPLATES = ("plant.py.txt", "pipeline.toml.txt")


def init(
    options: Common,
    *,
    name: Annotated[str, argument("NAME", "The plant's name, as my_plant.")],
    source: Annotated[
        str | None,
        flag("A plant to copy: a name, or my_plant.py:Tank; by default a tank with comments.", "--from", word="PLANT"),
    ] = None,
) -> None:
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
    templates = files("npred.cli") / "templates"
    fresh = [
        (templates / template).read_text(encoding="utf-8").replace("NAME", name).replace("CLASS", class_name)
        for template in TEMPLATES
    ]
    for path, text in zip(paths, _copies(source, name, class_name, fresh[1]) if source else fresh, strict=True):
        with path.open("x", encoding="utf-8") as file:
            file.write(text)
    spec = f"{name}.py:{class_name}"
    todo = f"wrote {name}.py and {name}.toml\nnext: npred plants check {spec}, then npred run {name}.toml"
    options.show({"plant": spec, "files": [str(path) for path in paths]}, lambda: todo)


def _copies(source: str, name: str, class_name: str, template: str) -> tuple[str, str]:
    """The plant's file with its class renamed, and a pipeline of the plant that is part of npred, else the template."""
    plant = plants.resolve(source)
    texts = {name: path.read_text(encoding="utf-8") for name, path in defaults.shipped().items()}
    # that of its name, else pipeline/paper.toml or the first that has this plant
    names = sorted(texts, key=lambda name: (name != source, name != defaults.PIPELINE.stem))
    toml = next((texts[name] for name in names if tomllib.loads(texts[name])["plant"] == source), None)
    if toml is None:  # the template: it starts in the middle of the box, and where nothing rests so do the networks
        middle = [sum(plant.box[state]) / 2 if state in plant.box else 0.0 for state in plant.states]
        X0 = f"X0 = {[round(value, 6) for value in middle]}"
        toml = re.sub(r"^X0 = \S.*?(?=  |$)", X0, template, flags=re.MULTILINE)
        if hasattr(plant.declaration, "reference"):
            anchor = r'\1\nanchor = "initial"    # nothing rests here'
            toml = re.sub(r"^(\[train\.\w+\])$", anchor, toml, flags=re.MULTILINE)
    else:
        toml = re.sub(r"^baselines = .*\n", "", toml, flags=re.MULTILINE)  # they lie beside that pipeline
        toml = re.sub(r"^name = .*$", f'name = "{name}"', toml, count=1, flags=re.MULTILINE)
        toml = re.sub(r"^plant = .*$", f'plant = "{name}.py:{class_name}"', toml, count=1, flags=re.MULTILINE)

    # a declaration without V is completed by a class of npred below it
    modules = [sys.modules.get(k.__module__) for k in plant.declaration.__mro__ if "states" in vars(k)]
    in_file = registry.in_file(source)
    path = registry.split(source)[0] if in_file else Path(inspect.getfile(next(filter(None, modules))))
    text, old = path.read_text(encoding="utf-8"), plant.declaration.__name__
    if re.search(rf"^class {old}\b", text, re.MULTILINE):
        return re.sub(rf"\b{old}\b", class_name, text), toml
    declaration = registry.split(source)[1] if in_file else f'PLANTS["{source}"]'  # a family: a class for this member
    return f"{text.rstrip()}\n{class_name} = {declaration}\n", toml
