"""What the key of the data holds."""

from pathlib import Path
from typing import Any

from npred.config import Pipeline
from npred.errors import ConfigError
from npred.json_files import regular, sha256
from npred.stages.configuration import loop


def configuration(config: Pipeline, model: str | None, device: str) -> dict[str, Any]:
    """The table; data of a file enter by what they are."""
    section = loop(config, "generate")
    source = section.pop("data")
    return {"generate": section | ({"data": _digest(Path(source))} if source else {})}


def _digest(path: Path) -> str:
    """The digest of a file of data: of what it holds, not of its path."""
    try:
        return sha256(regular(path))
    except OSError as error:
        raise ConfigError(f"generate.data: expected a file at {path}, got: {error.strerror}; check the path") from None
