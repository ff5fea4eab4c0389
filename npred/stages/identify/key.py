"""What the key of an identification holds."""

from pathlib import Path
from typing import Any

from npred.config import Pipeline
from npred.errors import ConfigError
from npred.json_files import regular, sha256
from npred.stages.configuration import plant, table


def configuration(config: Pipeline, model: str | None, device: str) -> dict[str, Any]:
    """The table; the recording enters by what it holds, and the measured outputs by their formulas."""
    section = table(config.optional("identify"))
    path, digest = Path(section.pop("data")), ""
    if path.name:
        try:
            digest = sha256(regular(path))
        except OSError as error:
            expected = f"identify.data: expected a file at {path}, got: {error.strerror}; check the path"
            raise ConfigError(expected) from None
    declared = plant(config)
    outputs = {"outputs": list(declared.outputs), **declared.output_program} if declared.declares_output else {}
    return {"identify": section | outputs | {"recording": digest}}


def parts(config: Pipeline, model: str | None) -> dict[str, str]:
    """It names no parts."""
    return {}
