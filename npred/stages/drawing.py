"""What all figures share: colours that colour-blind readers can tell, and files that are the same for the same data."""

from pathlib import Path
from typing import Any

COLOURS = ("#000000", "#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")  # Okabe and Ito
STYLES = ("-", "--", "-.", ":")


def figure(width: float, height: float) -> Any:
    """An empty matplotlib figure of that many inches."""
    import matplotlib
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    matplotlib.rcParams["svg.hashsalt"] = "npred"  # else the identifiers inside an SVG are random
    made = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(made)
    return made


def save(drawn: Any, folder: Path, name: str) -> None:
    """Write name.svg and name.png, without dates."""
    drawn.savefig(folder / f"{name}.svg", metadata={"Date": None})
    drawn.savefig(folder / f"{name}.png", dpi=160, metadata={"Software": None})


def words(name: str) -> str:
    """A contender's name for people."""
    return name.replace("_", " ")
