"""Views of closed loops: a summary in text, a plot, a data frame."""

import io
import re
from collections.abc import Iterator
from importlib import import_module
from typing import TYPE_CHECKING, Any

import numpy as np

from npred.base import array_checks, notebook
from npred.base.errors import ConfigError, MissingError

if TYPE_CHECKING:
    from npred.loop.trajectories import Trajectories

DRAWN = 20  # loops, at most, in a notebook without a call


def summary(loops: "Trajectories") -> str:
    """The numbers of loops and times, then a line per series: its range over all times, and its end."""
    count, shape = loops.escaped.size, loops.escaped.shape
    batch = ("1 loop" if not shape else f"{count} loops") + (f" {shape}" if len(shape) > 1 else "")
    lines = [f"Trajectories: {batch}, {len(loops.t)} times from {loops.t[0]:g} to {loops.t[-1]:g} {loops.time_unit}"]
    named = dict(series(loops))
    width = max(map(len, named))
    for name, values in named.items():
        unit = f" {loops.time_unit}" if name == "D_hat" else ""
        lines.append(f"  {name:{width}}  {_span(values)}, ends at {_span(values[..., -1])}{unit}")
    overflown = loops.escaped[loops.escaped >= 0]
    if overflown.size:
        what = "it overflows" if not shape else f"{overflown.size} of {count} overflow"
        lines.append(f"  {what}, first at control step {overflown.min()}")
    if overtaking := infeasible(loops):
        lines.append("  commands would overtake each other, {}\n  {}".format(*overtaking))
    if words := at_bound(loops):
        lines.append(f"  {words}")
    return "\n".join(lines)


def at_bound(loops: "Trajectories") -> str:
    """The number of loops whose D_hat ended at a bound of its law, in words; empty where none did."""
    low, high = loops.ends or (-np.inf, np.inf)
    last = loops.D_hat[..., -1]
    count = int(((last <= low) | (last >= high)).sum()) if low < high else 0
    which = f"in {count} of {last.size} loops " if last.ndim else ""
    return f"D_hat ended at its bound {which}and the delay may lie outside; widen bounds" if count else ""


def infeasible(loops: "Trajectories") -> tuple[str, str] | None:
    """Where commands would overtake each other first, and 1 - D_X f - D_t there, in words; None where they never do."""
    steps = loops.infeasible.reshape(-1)
    if not (marked := np.flatnonzero(steps >= 0)).size:
        return None
    loop = marked[np.argmin(steps[marked])]
    X = loops.breach.reshape(-1, len(loops.states))[loop]
    at = ", ".join(f"{name} = {value:.4g}" for name, value in zip(loops.states, X, strict=True))
    margin = f"1 - D_X f - D_t = {loops.margin.reshape(-1)[loop]:.3g}, expected above 0"
    return f"first at control step {steps[loop]}, {at}:", margin


def plot(loops: "Trajectories", D: Any = None, ax: Any = None, label: str | None = None) -> np.ndarray:
    """A panel for each state, input and D_hat, all loops in each; the axes (n + m + 1,). D adds the true delay.

    Raises ConfigError for an `ax` that is not one axes for each panel.
    """
    named = dict(series(loops))
    if ax is None:
        from matplotlib import pyplot

        figure = pyplot.figure(figsize=_size(len(named)), layout="constrained")
        axes = figure.subplots(len(named), 1, sharex=True, squeeze=False)[:, 0]
    else:
        axes = np.ravel(np.array(ax, dtype=object))
        drawn = all(hasattr(panel, "axhline") for panel in axes)
        if len(axes) != len(named) or not drawn:
            axes_of, got = f"matplotlib axes, for {', '.join(named)}", f"{len(axes)} axes" if drawn else repr(ax)
            todo = "give what the first loop.plot() returned"
            raise ConfigError(f"ax: expected {len(named)} {axes_of}, got {got}; {todo}")
    # what has a label has one colour in all panels, the next one of matplotlib's cycle
    colour = {} if label is None else {"color": f"C{len(axes[0].get_legend_handles_labels()[1])}"}
    for panel, (name, values) in zip(axes, named.items(), strict=True):
        lines = panel.plot(loops.t, values.reshape(-1, len(loops.t)).T, linewidth=1.2, **colour)
        declared = name.removeprefix("X.").removeprefix("U.")
        unit = loops.time_unit if name == "D_hat" else (loops.units or {}).get(declared, "")
        text = (loops.labels or {}).get(declared, name) + (f" ({unit})" if unit else "")
        text = re.sub(r"_\{([^}]+)\}", r"$_{\\mathrm{\1}}$", text)  # subscripts and powers as matplotlib sets them
        panel.set_ylabel(re.sub(r"\^\{?(-?\d+)\}?", r"$^{\1}$", text))
        panel.grid(visible=True, alpha=0.3)
        if label is not None:
            lines[0].set_label(label)
    if D is not None:
        for delay in np.unique(array_checks.floats("D", D)):
            axes[-1].axhline(delay, color="black", linestyle="--", linewidth=0.8)
    axes[-1].set_xlabel(f"t ({loops.time_unit})")
    if label is not None:  # above the panels, where no line is
        axes[0].legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=3, frameon=False)
    return axes


def html(loops: "Trajectories") -> str:
    """The summary and the plot, as a notebook shows them; no plot of more than DRAWN loops."""
    text = notebook.preformatted(summary(loops))
    if loops.escaped.size > DRAWN:
        return text
    from matplotlib import rc_context
    from matplotlib.figure import Figure

    count, buffer = len([*series(loops)]), io.StringIO()
    figure = Figure(_size(count), layout="constrained")  # free of pyplot, which would show it too
    plot(loops, ax=figure.subplots(count, 1, sharex=True))
    with rc_context({"svg.fonttype": "none"}):
        figure.savefig(buffer, format="svg", metadata={"Date": None})
    return text + buffer.getvalue()[buffer.getvalue().index("<svg") :]


def _size(panels: int) -> tuple[float, float]:
    """Width and height of their figure, in inches."""
    return 6.4, 1.0 + 1.2 * panels


def dataframe(loops: "Trajectories") -> Any:
    """One row per loop and time, a column per series; the index is t, behind the loop's number on each axis of a batch.

    Raises MissingError without pandas.
    """
    frames = pandas()
    columns = {name: values.reshape(-1) for name, values in series(loops)}
    shape = loops.escaped.shape
    if not shape:
        return frames.DataFrame(columns, index=frames.Index(loops.t, name="t"))
    axes = ["loop"] if len(shape) == 1 else [f"loop{k}" for k in range(len(shape))]
    index = frames.MultiIndex.from_product([*map(range, shape), loops.t], names=[*axes, "t"])
    return frames.DataFrame(columns, index=index)


def pandas() -> Any:
    """The package, which is no dependency. Raises MissingError without it."""
    try:
        return import_module("pandas")
    except ImportError:
        raise MissingError("to_dataframe: expected the package pandas, found none; pip install pandas") from None


def series(loops: "Trajectories") -> Iterator[tuple[str, np.ndarray]]:
    """Name and values (..., nt) of each state, each input and D_hat.

    Without names they are X1, X2, …, U1, …; a name that stands twice, or is D_hat, gets its letter in front.
    Raises ConfigError where the names do not fit the arrays.
    """
    names: dict[str, tuple[str, ...]] = {}
    for letter, values, declared in (("X", loops.X, loops.states), ("U", loops.U, loops.inputs)):
        size = values.shape[-1]
        if declared and len(declared) != size:
            raise ConfigError(f"Trajectories: expected {size} names for {letter}, got {', '.join(declared)}; name each")
        names[letter] = declared or tuple(f"{letter}{k + 1}" for k in range(size))
    every = [*names["X"], *names["U"], "D_hat"]
    for letter, values in (("X", loops.X), ("U", loops.U)):
        for k, name in enumerate(names[letter]):
            yield name if every.count(name) == 1 else f"{letter}.{name}", values[..., k]
    yield "D_hat", loops.D_hat


def _span(values: np.ndarray) -> str:
    """The range of the finite values in four digits, or the one value that there is."""
    finite = values[np.isfinite(values)]
    if not finite.size:
        return "nan"
    low, high = f"{finite.min():.4g}", f"{finite.max():.4g}"
    return low if low == high else f"{low} … {high}"
