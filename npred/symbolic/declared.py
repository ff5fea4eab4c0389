"""What the formula compiler needs to know of a plant, which stands on a higher floor."""

from collections.abc import Sequence
from typing import Any, ClassVar, Protocol


class Declared(Protocol):
    """Names, sizes, parameters and functions; npred.plants.Plant has them."""

    traced: ClassVar[bool]

    @property
    def name(self) -> str: ...
    @property
    def declaration(self) -> Any: ...
    @property
    def states(self) -> Sequence[str]: ...
    @property
    def inputs(self) -> Sequence[str]: ...
    @property
    def parameters(self) -> dict[str, float]: ...
    @property
    def n(self) -> int: ...
    @property
    def m(self) -> int: ...

    def call(self, name: str, x: list[Any] | None, u: list[Any] | None, t: Any, p: Any, M: Any) -> list[Any]:
        """A declared function on components of any kind."""
        ...

    def place(self, name: str) -> str:
        """A declared function in words, with file and line."""
        ...
