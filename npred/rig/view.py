"""The live view of a rig: what its log ends with, in place on the terminal; it costs the two sides nothing."""

from pathlib import Path

from rich.console import Console
from rich.live import Live
from rich.table import Table

from npred.json_files import escaped
from npred.terminal.streams import MESSAGES

TAIL = 4096  # bytes of the log's end that are read


class View:
    """A table of the last value of each column."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._live = Live(console=Console(file=MESSAGES), auto_refresh=False)
        self._live.start()

    def draw(self) -> None:
        """Show the log as it ends now."""
        try:
            with self.path.open("rb") as file:
                names = file.readline().decode().strip().split(",")
                file.seek(max(file.seek(0, 2) - TAIL, len(",".join(names)) + 1))
                lines = file.read().decode().split("\n")[1:-1]
        except (OSError, ValueError):  # not yet
            return
        table, last = Table("column", "last", box=None), last_values(names, lines)
        for name in names:
            table.add_row(escaped(name), last.get(name, ""))
        self._live.update(table, refresh=True)

    def close(self) -> None:
        """Leave the last state on the screen."""
        self._live.stop()


def last_values(names: list[str], lines: list[str]) -> dict[str, str]:
    """The last cell of each column that is not empty."""
    return {
        name: cell for line in lines if not line.startswith("#")
        for name, cell in zip(names, line.split(","), strict=False) if cell
    }  # fmt: skip
