"""Keys and digests: the same question has the same key, on every machine."""

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from npred import json_files

SHORT = 12


def canonical(value: Any) -> str:
    """JSON with sorted keys and no spaces: one text a value. Raises ValueError for NaN and infinities."""
    return json.dumps(value, sort_keys=True, separators=(",", ":"), ensure_ascii=False, allow_nan=False)


def sha256(value: Any) -> str:
    """The sha256 of a value's canonical JSON, in hexadecimal."""
    return hashlib.sha256(canonical(value).encode()).hexdigest()


def sha256_file(path: Path) -> str:
    """The sha256 of a file's bytes, in hexadecimal."""
    return json_files.sha256(path)


def key(stage: str, version: int, model: str | None, config: Mapping[str, Any], inputs: Mapping[str, str]) -> str:
    """The key of a result: sha256 of {stage, its version, model, its slice of the config, digests of its inputs}."""
    question = {"stage": stage, "version": version, "model": model, "config": config, "inputs": inputs}
    return sha256(question)


def short(text: str) -> str:
    """The first 12 digits, enough for people."""
    return text[:SHORT]
