"""Pages made from the code: the commands with their flags, the keys of a pipeline file and of results, named plants."""

import inspect
import json
import re
from collections.abc import Iterator, Sequence
from dataclasses import MISSING, fields, is_dataclass
from pathlib import Path
from typing import Any, get_args, get_origin

import typer.main
from pydantic.fields import FieldInfo
from sphinx.application import Sphinx
from sphinx.pycode import ModuleAnalyzer
from sphinx.util import logging

from npred import cli, plants
from npred.base import registry
from npred.cli.options import Common, Planned, Work
from npred.lab import config
from npred.lab.config.results import Result
from npred.lab.config.section import MOST
from npred.loop.loop import Loop

logger = logging.getLogger(__name__)

IN_COMMON: dict[type[config.Section], tuple[str, str]] = {  # tables that others extend: a heading, and a path below it
    config.LoopTable: ("Loops: `[generate]` and `[evaluate]`", "STAGE"),
    config.Training: ("Networks: every table `[train.NAME]`", "train.NAME"),
}


NESTED = {list: "list", Sequence: "list", tuple: "pair", dict: "table"}


def _own(options: type[Common], *bases: type[Common]) -> list[str]:
    inherited = {field.name for base in bases for field in fields(base)}
    return [field.name for field in fields(options) if field.name not in inherited]


SHARED = [
    ("Every command but `help` takes these flags:", "", _own(Common)),
    ("The flags *of a pipeline*, of the commands that read one:", "of a pipeline", _own(Planned, Common)),
    ("The flags *of work*, of the commands that run stages:", "of work", _own(Work, Planned)),
]


def write(app: Sphinx) -> None:
    """Write the pages below reference/, where they have changed."""
    for make in (commands, configuration, named_plants, results):
        text, path = "\n".join(make()), Path(app.srcdir) / "reference" / f"{make.__name__}.md"
        if not path.exists() or path.read_text(encoding="utf-8") != text:
            path.write_text(text, encoding="utf-8")


def commands() -> Iterator[str]:
    """The page of the command line: the flags in common once, then each command's own."""
    root: Any = typer.main.get_command(cli.app)
    yield from ("# Commands", "", _text(root))
    for caption, _, names in SHARED:
        taker = next(c for c in root.commands.values() if set(names) <= {p.name for p in c.params})
        yield from ("", caption, "")
        yield from _parameters([p for p in taker.params if p.name in names])
    for name, command in root.commands.items():
        yield from _command(f"npred {name}", command)


def _command(path: str, command: Any) -> Iterator[str]:
    arguments = [p for p in command.params if not p.opts[0].startswith("-")]
    shown = " ".join([path, *(_slot(p) for p in arguments)])
    yield from ("", f"## {path}", "", f"`{shown}`", "", _text(command), "")
    has = {p.name for p in command.params}
    taken = [(label, names) for _, label, names in SHARED if set(names) <= has]
    shared = set[str]().union(*(names for _, names in taken))
    yield from _parameters([p for p in command.params if p.name not in shared | {"help"}])
    labels = [label for label, _ in taken if label]
    yield from [f"Also the flags {' and '.join(labels)}."] if labels else []
    for name, child in getattr(command, "commands", {}).items():
        yield from _command(f"{path} {name}", child)


def _text(of: Any) -> str:
    """The help of a command or a parameter."""
    return of.help or ""


def _slot(parameter: Any) -> str:
    word = parameter.metavar or parameter.name.upper()
    word += "…" if parameter.nargs < 0 else ""
    return word if parameter.required else f"[{word}]"


def _parameters(parameters: list[Any]) -> Iterator[str]:
    if not parameters:
        return
    rows = [[_names(p), _text(p), _default(p)] for p in parameters]
    shown = 3 if any(row[2] for row in rows) else 2
    yield f"| {' | '.join(('', '', 'default')[:shown])} |"
    yield "|---" * shown + "|"
    yield from (f"| {' | '.join(map(_cell, row[:shown]))} |" for row in rows)
    yield ""


def _names(parameter: Any) -> str:
    word = parameter.metavar or parameter.name.upper()
    if not parameter.opts[0].startswith("-"):
        return f"`{word}`"
    value = "" if parameter.is_flag else f" `{word}`"
    return ", ".join(f"`{name}`" for name in parameter.opts) + value


def _default(parameter: Any) -> str:
    if parameter.required:
        return "required"
    if isinstance(parameter.show_default, str):
        return parameter.show_default
    if parameter.default in (None, False, ()):
        return ""
    default = f"`{parameter.default}`"
    return f"{default}, or `{parameter.envvar}`" if parameter.envvar else default


def configuration() -> Iterator[str]:
    """The page of the pipeline file: a section per table, a row per key."""
    yield from ("# Configuration", "", "A pipeline is a TOML file; `--set table.key=value` overrides a key for a run.")
    yield "An unknown key or a value out of range is an error that names the key. Delays and times are in the plant's"
    yield "unit of time, by default seconds."
    yield from ("The pipelines in `pipeline/` are examples. STAGE is `generate` or `evaluate`.", "")
    yield from _table("Top level", "", config.Pipeline, set())


def results() -> Iterator[str]:
    """The page of the results: a section per stage and per table in its result, a row per key."""
    yield from ("# Results", "", "The keys of `result.json`, which `--json` prints: see")
    yield "[documents for programs](documents.md). Keys may be added; none is dropped or renamed."
    yield "`null` is a number that is not finite. In a heading `*` stands for each name, or for each entry of a list."
    yield "ε and κ are those of [theory](../theory.md)."
    described: dict[type, str] = {}
    for name in registry.STAGES:
        yield from _result(name, registry.declared_stage(name).result, described)


def _result(path: str, model: type[Result], described: dict[type, str]) -> Iterator[str]:
    """A section of the keys that no section before has, then the tables below them."""
    if model in described:
        return
    stage, _, below = path.partition(".")
    place = f"{stage}: `{below}`" if below else stage
    owners = {name: _owner(model, name) for name in model.model_fields}
    before = {name: described[owner] for name, owner in owners.items() if owner in described}
    keys = [name for name in owners if name not in before]
    described |= dict.fromkeys([model, *owners.values()], place)
    yield from ("", f"### {place}" if below else f"## {place}", "", _words(model), "")
    for section in dict.fromkeys(before.values()):
        names = [f"`{name}`" for name in before if before[name] == section]
        yield from (f"Also {', '.join(names)}, as in {section}.", "")
    yield from ("| key | what |", "|---|---|")
    tables: list[tuple[str, type[Result]]] = []
    for name in keys:
        field = model.model_fields[name]
        key = field.serialization_alias or name
        yield f"| `{key}` | {_cell(_meaning(model, name))} |"
        kinds = [kind for kind in _parts(field.annotation) if isinstance(kind, type) and issubclass(kind, Result)]
        each = ".*" if get_origin(field.annotation) in (dict, list) else ""
        tables += [(f"{path}.{key}{each}", kind) for kind in kinds]
    for section, kind in tables:
        yield from _result(section, kind, described)


def _owner(model: type, name: str) -> type:
    """The class that declares a field."""
    return next(base for base in model.__mro__ if name in vars(base).get("__annotations__", {}))


def _parts(kind: Any) -> list[Any]:
    """A type and all types in it."""
    return [kind, *(part for inner in get_args(kind) for part in _parts(inner))]


def named_plants() -> Iterator[str]:
    """The page of the built-in plants: the first sentence of each one's docstring."""
    yield from (
        "# Built-in plants",
        "",
        "What `npred plants` lists: files of `npred/plants/builtin/`, and arms of `npred_robots`.",
        "",
    )
    yield from ("| name | states | inputs | |", "|---|---|---|---|")
    for entry in plants.named():
        first, *_ = (inspect.getdoc(plants.resolve(entry["name"]).declaration) or "").split("\n\n")
        cells = [f"`{entry['name']}`", _few(entry["states"]), _few(entry["inputs"]), _cell(" ".join(first.split()))]
        yield f"| {' | '.join(cells)} |"


def _few(names: list[str]) -> str:
    return ", ".join(names) if len(names) < 5 else f"{names[0]} … {names[-1]}: {len(names)}"


def _table(heading: str, path: str, model: type, described: set[type]) -> Iterator[str]:
    """A section for the keys that the model adds to a table in common or that have another default, and its tables.

    The model is a Section, or a dataclass of the library.
    """
    if model in described:
        return
    described.add(model)
    common = next((base for base in IN_COMMON if base in model.__mro__[1:]), None)
    if common:
        yield from _table(*IN_COMMON[common], common, described)
    before = common.model_fields if common else {}
    keys = {k: f for k, f in _keys(model).items() if k not in before or f.default != before[k].default}
    yield from ("", f"## {heading}", "", _words(model), "", "| key | type | default | meaning |", "|---|---|---|---|")
    for name, field in keys.items():
        if _inner(field) is None:
            yield f"| `{name}` | {_cell(_type(field))} | {_value(field)} | {_cell(_meaning(model, name))} |"
        elif field.default is None or issubclass(model, config.LoopTable):
            yield f"| `{name}` | table | | {_cell(_meaning(model, name))} |"
    for name, field in keys.items():
        if inner := _inner(field):
            below = f"{path}.{name}".strip(".")
            yield from _table(f"`[{below}]`", below, inner, described)
    if model is config.Evaluate:
        yield from _table("`[[evaluate.scenarios]]`", "evaluate.scenarios", config.Scenario, described)
    if model is config.Train:
        yield from _table("`[train.NAME]`", "train.NAME", config.Network, described)


def _field(kind: Any, default: Any) -> FieldInfo:
    if default is MISSING:
        return FieldInfo.from_annotation(kind)
    return FieldInfo.from_annotated_attribute(kind, default)


def _keys(model: type) -> dict[str, FieldInfo]:
    """The fields of a model or a dataclass by name."""
    if is_dataclass(model):
        return {field.name: _field(field.type, field.default) for field in fields(model)}
    return model.model_fields


def _meaning(model: type, name: str) -> str:
    """The comment behind #: at a field, in the class that declares it, or the description that the field has."""
    if description := _keys(model)[name].description:
        return description
    meaning = ""
    for owner in (_owner(model, name), Loop):  # a key of a loop that says nothing itself is that of npred.Loop
        comments = ModuleAnalyzer.for_module(owner.__module__).find_attr_docs()
        meaning = meaning or " ".join(comments.get((owner.__name__, name), [])).strip()
    if not meaning:
        logger.warning("%s.%s has no meaning; write it behind #: in its line", model, name)
    return meaning


def _inner(field: FieldInfo) -> type | None:
    """The table that a key is, or may be."""
    kinds = _parts(field.annotation) if get_origin(field.annotation) is not list else []
    classes = (kind for kind in kinds if isinstance(kind, type))
    return next((kind for kind in classes if issubclass(kind, config.Section) or is_dataclass(kind)), None)


def _words(model: type) -> str:
    """The model's docstring as running text, without the errors that it raises."""
    paragraphs = (model.__doc__ or "").split("\n\n")
    return " ".join(word for text in paragraphs if not text.strip().startswith("Raises ") for word in text.split())


def _value(field: FieldInfo) -> str:
    if field.is_required():
        return "required"
    return "none" if field.default is None else f"`{json.dumps(field.default, ensure_ascii=False)}`"


def _type(field: FieldInfo) -> str:
    return _limited(_name(field.annotation), field.metadata)


def _name(kind: Any) -> str:
    """A type as a reader of TOML knows it."""
    if kind is type(None):
        return ""
    origin, inner = get_origin(kind), get_args(kind)
    if isinstance(kind, type) and issubclass(kind, config.Section):
        return "tables"
    if origin is None:
        return {float: "number", int: "integer", str: "text", bool: "true or false", Any: "values"}.get(kind, str(kind))
    if hasattr(kind, "__metadata__"):
        return _limited(_name(inner[0]), kind.__metadata__)
    if origin in NESTED:
        return NESTED[origin] + " of " + _plural(_name(inner[-1]))
    if all(isinstance(part, str) for part in inner):
        return " · ".join(f"`{part}`" for part in inner if part)
    return " or ".join(text for text in map(_name, inner) if text)


def _plural(name: str) -> str:
    return re.sub(r"^(number|integer|pair)", r"\1s", name)


def _limited(name: str, bounds: Sequence[Any]) -> str:
    return f"{name} {', '.join(text for text in map(_limit, bounds) if text)}".strip()


def _limit(item: Any) -> str:
    """A bound in words; pydantic keeps bounds as objects of the package annotated_types, or within a FieldInfo."""
    if isinstance(item, FieldInfo):
        return ", ".join(text for text in map(_limit, item.metadata) if text)
    signs = {"gt": ">", "ge": "≥", "lt": "<", "le": "≤"}
    bounds = ((sign, getattr(item, name)) for name, sign in signs.items() if hasattr(item, name))
    return next((f"{sign} {bound:g}" for sign, bound in bounds if bound != MOST), "")


def _cell(text: str) -> str:
    return text.replace("|", "\\|")


def setup(app: Sphinx) -> dict[str, bool]:
    """Write the pages before Sphinx looks for sources."""
    app.connect("builder-inited", write)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
