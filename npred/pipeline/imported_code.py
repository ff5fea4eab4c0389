"""The code behind a part of an installed package: its module, and those of the same package that it imports."""

import ast
from functools import lru_cache
from importlib.util import find_spec, resolve_name
from pathlib import Path

from npred import registry
from npred.registry import Source


def imported_code(module: str) -> dict[str, Source]:
    """The module and all that it imports of its top-level package, also inside functions, by name, sorted.

    The files are read, and none is run; a module without a text, as one compiled from C, is left out.
    """
    top = module.partition(".")[0]
    sources, todo = {}, [module]
    while todo:
        name = todo.pop()
        path = None if name in sources else _file(name)
        if path:
            sources[name] = registry.read(name, path)
            package = name if path.name == "__init__.py" else name.rpartition(".")[0]
            imports = _imports(sources[name].text, package)
            todo += [above for each in (name, *imports) if each.split(".")[0] == top for above in _with_parents(each)]
    return dict(sorted(sources.items()))


def _file(module: str) -> Path | None:
    """The text of a module, found without running the packages above it."""
    top, *below = module.split(".")
    try:
        spec = find_spec(top)
    except ValueError:  # a module without a spec, as __main__
        spec = None
    folders = (spec and spec.submodule_search_locations) or []
    files = [Path(folder, *below, "__init__.py") for folder in folders]
    files += [Path(folder, *below).with_suffix(".py") for folder in folders if below]
    files += [Path(spec.origin)] if spec and spec.origin and not folders and not below else []
    return next((path for path in files if path.is_file() and path.suffix == ".py"), None)


@lru_cache(maxsize=64)
def _imports(text: str, package: str) -> list[str]:
    """The names that a text imports in full; of `from a import b` both a and a.b, for b may be a module."""
    try:
        nodes = list(ast.walk(ast.parse(text)))
    except (SyntaxError, ValueError):
        return []
    imported = [alias.name for node in nodes if isinstance(node, ast.Import) for alias in node.names]
    for node in (node for node in nodes if isinstance(node, ast.ImportFrom)):
        source = resolve_name("." * node.level + (node.module or ""), package)
        imported += [source, *(f"{source}.{alias.name}" for alias in node.names)]
    return imported


def _with_parents(module: str) -> list[str]:
    """a, a.b and a.b.c of a.b.c: to import the last runs the others."""
    parts = module.split(".")
    return [".".join(parts[: count + 1]) for count in range(len(parts))]
