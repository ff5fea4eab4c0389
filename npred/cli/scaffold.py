"""What `npred init` writes: a plant file with comments, and a pipeline that runs as it is."""

from importlib.resources import files
from keyword import iskeyword
from pathlib import Path

from npred.cli.options import Common
from npred.errors import ConfigError

TEMPLATES = {".py": "plant.py.txt", ".toml": "pipeline.toml.txt"}


def init(options: Common, name: str) -> None:
    """Write NAME.py and NAME.toml here. Raises ConfigError for a name that Python refuses, and where a file exists."""
    class_name = "".join(word.capitalize() for word in name.split("_"))
    written = name.isascii() and name.isidentifier() and name.islower() and class_name.isidentifier()
    if not written or iskeyword(name) or iskeyword(class_name):
        raise ConfigError(f"init: expected a name as my_plant, small letters and _, got {name!r}; choose another")
    texts = {Path(name + suffix): _text(template, name, class_name) for suffix, template in TEMPLATES.items()}
    there = [str(path) for path in texts if path.exists()]
    if there:
        raise ConfigError(f"init: expected no {' or '.join(there)} here, found it; choose another name or move it")
    for path, text in texts.items():
        with path.open("x", encoding="utf-8") as file:
            file.write(text)
    spec = f"{name}.py:{class_name}"
    todo = f"wrote {name}.py and {name}.toml\nnext: npred plants check {spec}, then npred run {name}.toml"
    options.show({"plant": spec, "files": [str(path) for path in texts]}, lambda: todo)


def _text(template: str, name: str, class_name: str) -> str:
    text = (files("npred") / "templates" / template).read_text(encoding="utf-8")
    return text.replace("NAME", name).replace("CLASS", class_name)
