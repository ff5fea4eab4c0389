"""What the key of the data holds."""

from pathlib import Path
from typing import Any

from npred.config import Pipeline
from npred.errors import ConfigError
from npred.json_files import regular, sha256
from npred.stages.configuration import loop, loop_parts


def configuration(config: Pipeline, model: str | None, device: str) -> dict[str, Any]:
    """The table; data of a file enter by what they are."""
    section = loop(config, "generate")
    source = section.pop("data")
    try:
        data = {"data": sha256(regular(Path(source)))} if source else {}
    except OSError as error:
        cure = "check the path"
        raise ConfigError(f"generate.data: expected a file at {source}, got: {error.strerror}; {cure}") from None
    return {"generate": section | data}


def parts(config: Pipeline, model: str | None) -> dict[str, str]:
    """The method and the law of the loops."""
    return loop_parts(config, "generate")
