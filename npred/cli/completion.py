"""Completion in the shell, where Tab is pressed. It never fails and prints nothing: a broken file offers nothing.

typer leaves out what does not begin with the letters that are typed.
"""

import re
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Literal, get_args, get_origin

import typer

import npred
from npred import defaults
from npred.registry import STAGES, Registry

if TYPE_CHECKING:
    from pydantic.fields import FieldInfo

    from npred.config import Pipeline

Offer = str | tuple[str, str]  # a word, and what the shell says beside it
Complete = Callable[[typer.Context, str], list[Offer]]


def _offered(find: Callable[[typer.Context, str], Iterable[Offer]]) -> Complete:
    """The words that a function finds; none where it fails."""

    def complete(ctx: typer.Context, incomplete: str) -> list[Offer]:
        try:
            return list(find(ctx, incomplete))
        except Exception:
            return []

    return complete


def words(*choices: str) -> Complete:
    """These words."""
    return lambda ctx, incomplete: list(choices)


def of(parts: Registry) -> Complete:
    """The names of these parts."""
    return _offered(lambda ctx, incomplete: parts.names())


@_offered
def pipelines(ctx: typer.Context, incomplete: str) -> Iterator[Offer]:
    """The pipelines that are part of npred, and the TOML files of the folder that is typed."""
    yield from ((name, _first_comment(path)) for name, path in defaults.shipped().items())
    folder = incomplete.rpartition("/")[0]
    for path in sorted(Path(folder or ".").glob("*.toml")):
        if path.name not in defaults.NO_PIPELINE:
            yield f"{folder}/{path.name}" if folder else path.name, _first_comment(path)


@_offered
def settings(ctx: typer.Context, incomplete: str) -> Iterator[Offer]:
    """The keys of a pipeline; of the only one that fits, its values, so that the shell puts no space behind it."""
    from npred import config

    key, sign, _ = incomplete.partition("=")
    keys = config.leaves(networks=_pipeline(ctx).train.named)
    fields = {name: field for name, field in keys if (name == key if sign else name.startswith(key))}
    if len(fields) > 1:
        yield from fields
    for name, field in fields.items() if len(fields) == 1 else ():
        yield from (f"{name}={value}" for value in ["", *_values(ctx, name, field)])


@_offered
def artifacts(ctx: typer.Context, incomplete: str) -> Iterator[Offer]:
    """The results in the store, the most recent first."""
    from npred.store import Store

    for artifact in reversed(Store(ctx.params.get("store") or defaults.store()).artifacts()):
        asked = artifact.manifest.question
        yield artifact.name, f"{asked.model or asked.stage} of {artifact.manifest.pipeline}"


def _values(ctx: typer.Context, key: str, field: "FieldInfo") -> list[str]:
    """The words that a key takes, else its value in the pipeline."""
    from npred.pipeline.reasons import flat

    if get_origin(field.annotation) is Literal:
        return list(get_args(field.annotation))
    for registry in (item for item in field.metadata if isinstance(item, Registry)):
        return registry.names()
    return [value.strip('"') for name, value in flat(_pipeline(ctx).model_dump()).items() if name == key]


def _pipeline(ctx: typer.Context) -> "Pipeline":
    """The pipeline that is typed, else the default one, else one with all defaults."""
    from npred import config
    from npred.errors import NpredError

    rest = ctx.args[-1] if ctx.args else None  # before an option without its value, arguments have no names yet
    try:
        return config.load(defaults.pipeline(ctx.params.get("pipeline_name") or rest))
    except NpredError:
        return config.Pipeline(plant="")


def literal(text: str) -> str:
    """Text for typer, which takes it for rich's markup."""
    return re.sub(r"(?=\[[a-z#/@][^[]*?])", r"\\", text)


def _first_comment(path: Path) -> str:
    with path.open(encoding="utf-8", errors="replace") as file:
        line = file.readline(200).strip()
    return literal(line.removeprefix("#").strip()) if line.startswith("#") else ""


stages = _offered(lambda ctx, incomplete: [*STAGES, *_pipeline(ctx).train.models])  # and the networks
models = _offered(lambda ctx, incomplete: _pipeline(ctx).train.names)
plants = _offered(lambda ctx, incomplete: npred.plants.names())
devices = words("auto", "cpu", "cuda")
