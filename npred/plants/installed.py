"""Plants that installed packages register: entry points of the group `npred.plants`, each name = "module:Class"."""

from collections.abc import Collection
from typing import Any

from npred.errors import ConfigError

GROUP = "npred.plants"


def names(taken: Collection[str] = ()) -> list[str]:
    """The registered names but those that are taken, sorted; nothing of the packages is imported."""
    return sorted(set(_entries()) - set(taken))


def find(name: str) -> Any:
    """The registered declaration of that name, or None. Raises ConfigError, naming the package, where it fails."""
    entry = _entries().get(name)
    if entry is None:
        return None
    try:
        return entry.load()
    except (Exception, SystemExit) as error:
        package = entry.dist.name if entry.dist else "a package"
        told = " ".join(f"{type(error).__name__}: {error}".split())
        raise ConfigError(f"plant {name}: {package} failed on import of {entry.value}: {told}; fix it") from None


def _entries() -> dict[str, Any]:
    from importlib.metadata import entry_points

    return {entry.name: entry for entry in entry_points(group=GROUP)}
