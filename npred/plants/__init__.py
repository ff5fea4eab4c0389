"""Plants by name or from a user's file."""

import copyreg
import importlib
import inspect
import pkgutil
from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

from npred.base import registry
from npred.base.errors import ConfigError, similar, unlisted
from npred.plants import builtin
from npred.plants.base import Plant
from npred.plants.black_box import BlackBox

Kappa = Callable[..., Any] | str | Mapping[str, Any]  # a law, its name, or its name with what it takes
Values = tuple[tuple[str, float], ...]  # parameters, each with its name


def plant(name: str | type, *, kappa: Kappa = "", **parameters: float) -> Plant:
    """The plant of a built-in name, of a file or of a class, with parameters overridden.

    Parameters
    ----------
    name : str or class
        A name that npred has, "my_plant.py:Tank", or the class.
    kappa : function (x, t, p, M), or the name of a law of npred.laws, as "lqr", optional
        Takes the place of its law; also a policy's file, "policy.onnx".
    **parameters : float
        Values of the plant's parameters, by name.

    Returns
    -------
    Plant
        X'(t) = f(X(t), U(t - D)) with the control law kappa and the function V [DAPF, eqs. 1-4].

    Raises
    ------
    ConfigError
        For a name, a file or a law that is not there, and for a class that declares no plant.
    """
    return resolve(name, parameters, kappa)


def resolve(
    name: str | type, parameters: Mapping[str, float] = {}, kappa: Kappa = "", delays: Sequence[float] | None = None
) -> Plant:
    """The plant as `plant` makes it, its parameters in a table.

    `kappa` may also be a table of a law's name and its arguments, {"law": "pole_placement", "poles": [-1, -2]}.
    `delays`, one per input, take the place of those that the class declares.
    """
    spec = source = None  # a class of a script has neither
    if isinstance(name, type):
        kind, declaration = name.__name__, name
    elif not isinstance(name, str):
        raise ConfigError(f"plant: expected a name, my_plant.py:Tank or a class, got {name!r}; give one")
    elif registry.in_file(name):
        (path, kind), (declaration, source) = registry.split(name), registry.load("plant", name)
        spec = f"{path.absolute()}:{kind}"
    elif name.endswith(".py"):
        raise ConfigError(f"plant {name}: expected the class too, got the file alone; write {name}:Tank, say")
    else:
        kind = spec = name
        declaration = _builtin().get(name) or registry.PLANTS.installed(name)
        if declaration is None:
            near = similar(name, [*names(), *map(str, Path().glob("*.py"))])
            any_of = f"one of {', '.join(names())}, or a file as my_plant.py:Tank"
            raise ConfigError(f"plant {name!r}: expected {any_of}{near}")
    if delays is not None:
        source = source or registry.declaring(declaration)
        parts = {"delays": tuple(delays), "__module__": declaration.__module__}
        declaration = type(declaration.__name__, (declaration,), parts)
    plant = make(kind, declaration, parameters, source)
    plant.spec = spec
    return controlled(plant, kappa)


def controlled(plant: Plant, kappa: Kappa) -> Plant:
    """The plant with that law; itself where there is none. Raises ConfigError for a law that does not serve it."""
    if callable(kappa) or not kappa:
        return plant.controlled(kappa) if callable(kappa) else plant
    by_file = {"law": "policy", "path": str(kappa)}
    table = by_file if registry.is_policy(kappa) else {"law": kappa} if isinstance(kappa, str) else dict(kappa)
    name = str(table.pop("law", ""))
    design = registry.LAWS.load("kappa", name)
    try:
        inspect.signature(design).bind(plant, **table)
    except TypeError as error:
        takes = list(inspect.signature(design).parameters)
        for key in table:
            if key not in takes:
                raise ConfigError(unlisted(f"kappa {name}", key, takes[1:], "arguments", "drop it")) from None
        what, cure = f"kappa {name}: expected what {name}({', '.join(takes)}) takes", "write it"
        raise ConfigError(f"{what}, got a table: {error}; {cure}") from None
    other = plant.controlled(design(plant, **table))
    other.law_table = {"law": name} | table
    return other


@lru_cache(maxsize=16)
def varied(plant: Plant, parameters: Values) -> Plant:
    """The plant with some of its parameters changed. Raises ConfigError for one that it does not have."""
    return type(plant)(plant.name, plant.declared, plant.parameters | dict(parameters), plant.source, plant.law)


def _reduced(plant: Plant) -> tuple[Callable[..., Plant], tuple[object, ...]]:
    """A plant is pickled by name or file where there is one, else with its class; derived parts are made again."""
    parameters = tuple(plant.parameters.items())
    if plant.spec is not None:
        digest = plant.source and plant.source.sha256
        return restored, (plant.spec, parameters, digest, plant.law, plant.delays)
    return remade, (type(plant), plant.name, plant.declared, parameters, plant.law)


for _kind in (Plant, BlackBox):
    copyreg.pickle(_kind, _reduced)


@lru_cache(maxsize=128)
def restored(
    spec: str, parameters: Values, digest: str | None, kappa: Callable[..., Any] | None,
    delays: tuple[float, ...] | None = None,
) -> Plant:  # fmt: skip
    """The plant that was pickled by its name, one per process, for it keeps its compiled code.

    Raises ConfigError where it is not there, or its file has changed since.
    """
    plant = resolve(spec, dict(parameters), kappa or "", delays)
    if (plant.source and plant.source.sha256) != digest:
        raise ConfigError(f"plant {spec}: expected the file that was pickled, got another text; pickle the plant again")
    return plant


@lru_cache(maxsize=128)
def remade(
    kind: type[Plant], name: str, declaration: type, parameters: Values, kappa: Callable[..., Any] | None
) -> Plant:
    """The plant that was pickled with its class, which Python could import; one per process."""
    return kind(name, declaration, dict(parameters), kappa=kappa)


def make(
    name: str, declaration: type, parameters: Mapping[str, float] = {}, source: registry.Source | None = None
) -> Plant:
    """The plant of a declaration: traced, unless it says `traced = False`."""
    kind = Plant if getattr(declaration, "traced", True) else BlackBox
    plant = kind(name, declaration, parameters, source)
    plant.own("kappa", plant.declaration.kappa)  # it may be a law that was designed for another one
    return plant


def named() -> list[dict[str, Any]]:
    """Name, states, inputs and parameters of the plants that have a name: built in, or of installed packages.

    One that cannot be made, of a package that fails on import say, has its name and `error`, a sentence.
    """
    rows: list[dict[str, Any]] = []
    for name in names():
        try:
            p = resolve(name)
            rows.append({"name": name, "states": [*p.states], "inputs": [*p.inputs], "parameters": p.parameters})
        except ConfigError as error:
            rows.append({"name": name, "error": str(error)})
    return rows


def names() -> list[str]:
    """The plants that have a name: built in, or of installed packages, of which nothing is imported."""
    return [*_builtin(), *(name for name in registry.PLANTS.names() if name not in _builtin())]


def is_builtin(name: object) -> bool:
    """True if a name is that of a plant of npred's: to resolve it runs nobody else's code."""
    return isinstance(name, str) and (name in _builtin() or registry.PLANTS.is_npreds(name))


def _builtin() -> dict[str, type]:
    """The declarations of `builtin`: thermal_tank.py has ThermalTank, or PLANTS, a table of names to classes."""
    declarations: dict[str, type] = {}
    for module in pkgutil.iter_modules(builtin.__path__):
        content = importlib.import_module(f"{builtin.__name__}.{module.name}")
        camel = "".join(word.capitalize() for word in module.name.split("_"))
        family = getattr(content, "PLANTS", {module.name: getattr(content, camel, None)})
        declarations |= {name: declaration for name, declaration in family.items() if hasattr(declaration, "states")}
    return declarations
