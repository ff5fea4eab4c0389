"""Plants by name or from a user's file; a plant is one file of this folder and nothing else."""

import hashlib
import importlib
import importlib.util
import pkgutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from npred.errors import ConfigError
from npred.plants import installed
from npred.plants.base import Plant


def resolve(name: str, parameters: Mapping[str, float] = {}) -> Plant:
    """The plant of a built-in or installed name or of `file.py:Class`, with parameters overridden.

    Raises ConfigError, in one line, for an unknown name, a missing or broken file, or an unknown parameter.
    """
    if not isinstance(name, str):
        raise ConfigError(f"plant: expected a name or my_plant.py:Tank, got {name!r}; write it as text")
    path, colon, class_name = name.partition(".py:")
    if colon:
        return _from_file(Path(path + ".py"), class_name, parameters)
    declaration = _builtin().get(name) or installed.find(name)
    if declaration is None:
        known = ", ".join([*_builtin(), *installed.names(_builtin())])
        raise ConfigError(f"plant {name!r}: expected one of {known}, or a file as my_plant.py:Tank")
    return Plant(name, declaration, parameters)


def identity(name: str, parameters: Mapping[str, float] = {}) -> dict[str, Any]:
    """What a stage's key must hold of the plant; see Plant.identity."""
    return resolve(name, parameters).identity


def named() -> list[dict[str, Any]]:
    """Name, states, inputs and parameters of the plants that have a name: built in, or of installed packages."""
    plants = [resolve(name) for name in [*_builtin(), *installed.names(_builtin())]]
    return [
        {"name": p.name, "states": list(p.states), "inputs": list(p.inputs), "parameters": p.parameters} for p in plants
    ]


def is_builtin(name: Any) -> bool:
    """Whether a name is that of a plant of npred's own: to resolve it runs nobody else's code."""
    return isinstance(name, str) and name in _builtin()


def _builtin() -> dict[str, type]:
    """What the modules of this folder declare: thermal_tank.py ThermalTank, or PLANTS, a table of names to classes."""
    found: dict[str, type] = {}
    for module in pkgutil.iter_modules(__path__):
        content = importlib.import_module(f"{__name__}.{module.name}")
        camel = "".join(word.capitalize() for word in module.name.split("_"))
        family = getattr(content, "PLANTS", {module.name: getattr(content, camel, None)})
        found |= {name: declaration for name, declaration in family.items() if hasattr(declaration, "states")}
    return found


def _from_file(path: Path, class_name: str, parameters: Mapping[str, float]) -> Plant:
    if not path.is_file():
        raise ConfigError(f"plant {path}:{class_name}: expected a Python file, found none at {path}; check the path")
    text = path.read_bytes()
    space: dict[str, Any] = {"__name__": path.stem, "__file__": str(path)}
    try:
        exec(compile(text, str(path), "exec"), space)
    except SyntaxError as error:
        line = f":{error.lineno}" if error.lineno else ""
        raise ConfigError(f"plant {path}{line}: expected Python, got a syntax error: {error.msg}") from None
    except (Exception, SystemExit) as error:
        raise ConfigError(f"plant {path}: failed on import: {type(error).__name__}: {error}; mend the file") from None
    if not isinstance(space.get(class_name), type):
        raise ConfigError(f"plant {path}: expected a class {class_name}, found none; check the name after the colon")
    return Plant(class_name, space[class_name], parameters, hashlib.sha256(text).hexdigest())
