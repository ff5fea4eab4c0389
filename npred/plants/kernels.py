"""Generated text to compiled kernel, cached on disk under the hash of the text.

Numba's own cache does not see an edit in another file and never hits for closures, so each kernel is a file of its
own, named by its content: the name is the version. `_pointer` kernels reach the one engine as function pointers.
"""

import hashlib
import importlib.util
import os
import sys
import tempfile
from collections.abc import Callable, Sequence
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any

HEADER = """import math

import numpy as np
from numba import njit

{preamble}
@njit({signature!r}, cache=True, nogil=True, error_model="numpy", fastmath={{{fastmath}}})
"""
FASTMATH = ("contract", "nsz", "arcp")


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
    return getattr(_module(f"npred_{name}_{_digest(text)}", text), name)


def folder() -> Path:
    """Where kernels are kept: $NPRED_CACHE, else the user's cache, else a temporary folder if that is read-only."""
    home = Path(os.environ.get("XDG_CACHE_HOME", Path.home() / ".cache"))
    chosen = Path(os.environ.get("NPRED_CACHE", home / "npred")) / "kernels"
    try:
        chosen.mkdir(parents=True, exist_ok=True)
        tempfile.TemporaryFile(dir=chosen).close()
        return chosen
    except OSError:
        return Path(tempfile.mkdtemp(prefix="npred-kernels-"))


def _digest(text: str) -> str:
    import numba

    return hashlib.sha256(f"{numba.__version__}\n{text}".encode()).hexdigest()[:20]


@cache
def _module(name: str, text: str) -> ModuleType:
    path = _written(_cache() / f"{name}.py", text)
    spec = importlib.util.spec_from_file_location(name, path)
    assert spec and spec.loader
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module  # before it runs: Numba looks the module up by its name
    spec.loader.exec_module(module)
    return module


@cache
def _cache() -> Path:
    return folder()


def _written(path: Path, text: str) -> Path:
    """The file with that text. An existing one is left alone: its time stamp is part of Numba's key."""
    if not path.exists():
        handle, temporary = tempfile.mkstemp(dir=path.parent, suffix=".tmp")
        with os.fdopen(handle, "w", encoding="utf-8") as file:
            file.write(text)
        os.replace(temporary, path)
    return path


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
