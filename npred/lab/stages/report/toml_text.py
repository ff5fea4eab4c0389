"""Nested tables as TOML text, for `tomllib` reads it and nothing in Python's library writes it."""

import json
import re
from collections.abc import Mapping


def dumps(table: Mapping[str, object]) -> str:
    """The text whose tables are these; a key with the value None is left out, as TOML has no null."""
    return "\n".join(_lines(table, ())).strip() + "\n"


def _lines(table: Mapping[str, object], path: tuple[str, ...]) -> list[str]:
    filled = {key: value for key, value in table.items() if value is not None}
    leaves = [f"{_key(key)} = {_value(value)}" for key, value in filled.items() if not isinstance(value, Mapping)]
    head = ["", f"[{'.'.join(map(_key, path))}]"] if path and (leaves or not filled) else []
    below = [
        line for key, value in filled.items() if isinstance(value, Mapping) for line in _lines(value, (*path, key))
    ]
    return [*head, *leaves, *below]


def _key(key: str) -> str:
    return key if re.fullmatch("[A-Za-z0-9_-]+", key) else json.dumps(key, ensure_ascii=False)


def _value(value: object) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False)
    if isinstance(value, Mapping):
        return f"{{ {', '.join(f'{_key(key)} = {_value(item)}' for key, item in value.items() if item is not None)} }}"
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(_value, value))}]"
    return repr(value)
