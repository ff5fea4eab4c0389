"""Delay laws by name or from a user's file, as a pipeline names them."""

from typing import TYPE_CHECKING, Any

from npred import config, registry
from npred.errors import ConfigError
from npred.loop.adaptation import DelayAdaptation
from npred.loop.delay_law import DelayLaw

if TYPE_CHECKING:
    from npred.plants.base import Plant


def resolve(loop: config.Loop) -> DelayLaw | None:
    """The law of a stage's loops: the paper's, None for frozen, or the class that `file.py:Class` names.

    A user's class is made with the loop's gamma, b and bounds. Raises ConfigError, in one line, for a file or class
    that is missing, broken or no law.
    """
    if loop.adaptation == config.FROZEN:
        return None
    if loop.adaptation == config.PAPER:
        return DelayAdaptation(loop.gamma, loop.b, loop.bounds)
    law = registry.load("adaptation", loop.adaptation).declaration
    if not (isinstance(law, type) and issubclass(law, DelayLaw)):
        raise ConfigError(f"adaptation {loop.adaptation}: expected a subclass of npred.DelayLaw; derive it from that")
    try:
        return law(gamma=loop.gamma, b=loop.b, bounds=loop.bounds)
    except TypeError as error:
        raise ConfigError(
            f"adaptation {loop.adaptation}: expected a law with rate that takes gamma, b and bounds, got: {error}"
        ) from None


def identity(loop: config.Loop) -> Any:
    """What a key holds of the law: None for the paper's, a name, or what the file of one's own holds."""
    if not registry.named(loop.adaptation):
        return None if loop.adaptation == config.PAPER else loop.adaptation
    path, name = registry.split(loop.adaptation)
    return {"name": name, "source": registry.read("adaptation", path).sha256}


def check(loop: config.Loop, plant: "Plant") -> None:
    """Raise ConfigError where the law does not load, or refuses the plant."""
    law = resolve(loop)
    if law is not None:
        law.check(plant)
