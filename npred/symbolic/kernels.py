"""Generated text to a compiled kernel, kept on the disk under the hash of the text.

Numba's cache does not see an edit in another file and never hits for closures, so each kernel is a separate file
named by its content: the name is the version. `_pointer` kernels reach the one engine as function pointers.
"""

import ast
import os
import sys
import tempfile
from collections.abc import Callable, Sequence
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple

from npred.symbolic import compile_cache

HEADER = """import math

import numpy as np
from numba import njit

{preamble}
@njit({signature!r}, cache=True, nogil=True, error_model="numpy", fastmath={{{fastmath}}})
"""
FASTMATH = ("contract", "nsz", "arcp")
TEXT = "__text__"  # the variable of a kernel's module that holds its text, for other compilers than Numba's


@cache
def build(
    name: str, signature: str, source: str, preamble: str = "", fastmath: tuple[str, ...] = FASTMATH
) -> Callable[..., Any]:
    """The compiled function `name` of the source text; from the disk where this text was compiled before.

    `preamble` stands before the function: its constants and helpers. nnan and ninf are left out of fastmath: a rollout
    that diverged must stay visible as such.
    """
    flags = ", ".join(f'"{flag}"' for flag in fastmath)
    text = HEADER.format(signature=signature, preamble=preamble, fastmath=flags) + source
    return getattr(_module(compile_cache.named(name, compile_cache.root(), text), text), name)


def _module(name: str, text: str) -> ModuleType:
    """The module of that text. It is run as it stands here: its file is for Numba, which wants one to stand by.

    Under the lock of all that is compiled: another thread's kernel may import this one, and must not find it half run.
    """
    with compile_cache.LOCK:
        if name in sys.modules:
            return sys.modules[name]
        path = compile_cache.root() / f"{name}.py"
        module = sys.modules[name] = ModuleType(name)  # before it runs: Numba looks the module up by its name
        vars(module)[TEXT] = text
        try:
            with compile_cache.kept(name):
                _write(path, text)
                exec(compile(text, str(path), "exec"), vars(module))
        except BaseException:
            del sys.modules[name]
            raise
        return module


class Uncompiled(NamedTuple):
    """A function that is not compiled: its syntax tree, and the names that it sees."""

    tree: ast.FunctionDef
    names: dict[str, Any]


def uncompiled(name: str, source: str, preamble: str = "") -> Uncompiled:
    """What `build` compiles, for other compilers than Numba's."""
    head, _, _ = HEADER.partition("@njit(")
    module = ModuleType(name)
    exec(compile(head.format(preamble=preamble), name, "exec"), vars(module))
    vars(module)[TEXT] = preamble
    tree = ast.parse(source).body[0]
    assert isinstance(tree, ast.FunctionDef)
    return Uncompiled(tree, vars(module))


def definition(function: Callable[..., Any] | Uncompiled) -> tuple[ast.FunctionDef, dict[str, Any]]:
    """The syntax tree of a function that Numba compiles, generated or written, and the names that it sees."""
    if isinstance(function, Uncompiled):
        return function
    plain = getattr(function, "py_func", function)
    space = plain.__globals__
    text = space.get(TEXT) or Path(plain.__code__.co_filename).read_text(encoding="utf-8")
    definitions = {node.name: node for node in _tree(text).body if isinstance(node, ast.FunctionDef)}
    return definitions[plain.__name__], space


@cache
def _tree(text: str) -> ast.Module:
    return ast.parse(text)


def _write(path: Path, text: str) -> None:
    """The file with that text. One that has it is left alone: its time stamp may be part of Numba's key."""
    content = text.encode()
    if path.is_file() and path.read_bytes() == content:
        return
    handle, temporary = tempfile.mkstemp(dir=path.parent, suffix=".tmp")
    with os.fdopen(handle, "wb") as file:
        file.write(content)
        file.flush()
        os.fsync(handle)
    os.replace(temporary, path)


def parameters(count: int) -> list[str]:
    """The lines that load a plant's parameters, p0, p1, …, from the array p."""
    return [f"p{k} = p[{k}]" for k in range(count)]


def fill(skeleton: str, **slots: Sequence[str]) -> str:
    """The skeleton with each line `{slot}` replaced by that slot's lines at its indentation."""
    lines = []
    for line in skeleton.splitlines():
        name = line.strip().removeprefix("{").removesuffix("}")
        if line.strip() != f"{{{name}}}":
            lines.append(line)
        else:
            indent = line[: len(line) - len(line.lstrip())]
            lines += [indent + text for text in slots[name]]
    return "\n".join(lines) + "\n"
