"""Views of closed loops (npred.loop.trajectories.Trajectories): a summary in text, a plot, a data frame."""

import io
from collections.abc import Iterator, Sequence
from importlib import import_module
from typing import Any

import numpy as np

from npred.base import array_checks, notebook
from npred.base.errors import ConfigError, MissingError, unlisted
from npred.plants import notation

DRAWN = 20  # loops, at most, in a notebook without a call
SIGNALS = ("X", "U", "D_hat")
TAIL, GROWTH, REACH = 0.1, 1.5, 100.0  # shares of the horizon; factors of |X|, and of a series' size
LETTER, LINE = 0.6, 4.5  # of a legend: a letter, and a line with its gaps, as shares of the size of letters
KEPT, LOST = "kept", "lost"  # the group of a loop's lines


def summary(loops: Any) -> str:
    """The numbers of loops and times, then a line per series: its range over all times, and its end."""
    count, shape = loops.escaped.size, loops.escaped.shape
    batch = ("1 loop" if not shape else f"{count} loops") + (f" {shape}" if len(shape) > 1 else "")
    lines = [f"Trajectories: {batch}, {len(loops.t)} times from {loops.t[0]:g} to {loops.t[-1]:g} {loops.time_unit}"]
    named = dict(series(loops))
    width = max(map(len, named))
    for name, values in named.items():
        unit = f" {loops.time_unit}{_uncertain(loops)}" if name == "D_hat" else ""
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


def _uncertain(loops: Any) -> str:
    """How far the last D_hat may be off, in words; empty where no observer says it."""
    spread = loops.D_hat_spread[np.isfinite(loops.D_hat_spread)]
    return f" ± {_span(spread)}" if spread.size else ""


def at_bound(loops: Any) -> str:
    """The number of loops whose D_hat ended at a bound of its law, in words; empty where none did."""
    low, high = loops.ends or (-np.inf, np.inf)
    last = loops.D_hat[..., -1]
    count = int(((last <= low) | (last >= high)).sum()) if low < high else 0
    which = f"in {count} of {last.size} loops " if last.ndim else ""
    return f"D_hat ended at its bound {which}and the delay may lie outside; widen bounds" if count else ""


def infeasible(loops: Any) -> tuple[str, str] | None:
    """Where commands would overtake each other first, and 1 - D_X f - D_t there, in words; None where they never do."""
    steps = loops.infeasible.reshape(-1)
    if not (marked := np.flatnonzero(steps >= 0)).size:
        return None
    loop = marked[np.argmin(steps[marked])]
    X = loops.breach.reshape(-1, len(loops.states))[loop]
    at = ", ".join(f"{name} = {value:.4g}" for name, value in zip(loops.states, X, strict=True))
    margin = f"1 - D_X f - D_t = {loops.margin.reshape(-1)[loop]:.3g}, expected above 0"
    return f"first at control step {steps[loop]}, {at}:", margin


def plot(
    loops: Any, D: Any = None, ax: Any = None, label: str | None = None,
    signals: Sequence[str] = SIGNALS, size: str | tuple[float, float] | None = None,
) -> np.ndarray:  # fmt: skip
    """A panel for each series of `signals`, all loops in each; the axes. D adds the true delay.

    Raises ConfigError for an `ax` that is not one axes for each panel, an unknown signal, or a size that is none.
    """
    if ax is not None and signals == SIGNALS:  # those of the first loop
        panels = [getattr(panel, "get_gid", str)() for panel in np.ravel(np.array(ax, dtype=object))]
        signals = panels if all(name in dict(series(loops)) for name in panels) else signals
    named = _chosen(loops, signals)
    if ax is None:
        from matplotlib import pyplot

        figure = pyplot.figure(figsize=_size(len(named), size), layout="constrained")
        axes = figure.subplots(len(named), 1, sharex=True, squeeze=False)[:, 0]
    elif size is not None:
        raise ConfigError(f"size: expected none beside ax, whose figure has one, got {size!r}; leave one of them out")
    else:
        axes = np.ravel(np.array(ax, dtype=object))
        drawn = all(hasattr(panel, "axhline") for panel in axes)
        if len(axes) != len(named) or not drawn:
            axes_of, got = f"matplotlib axes, for {', '.join(named)}", f"{len(axes)} axes" if drawn else repr(ax)
            todo = "give what the first loop.plot() returned"
            raise ConfigError(f"ax: expected {len(named)} {axes_of}, got {got}; {todo}")
    # what has a label has one colour in all panels, the next one of matplotlib's cycle
    colour = {} if label is None else {"color": f"C{len(axes[0].get_legend_handles_labels()[1])}"}
    letters = 7 if size == "article" else axes[0].yaxis.label.get_fontsize()
    leaves = _lost(loops)
    for panel, (name, values) in zip(axes, named.items(), strict=True):
        lines = panel.plot(loops.t, values.reshape(-1, len(loops.t)).T, linewidth=1.2, **colour)
        for line, left in zip(lines, leaves, strict=True):
            line.set_gid(LOST if left else KEPT)
        panel.set_gid(name)
        panel.set_ylabel(_label(loops, name), fontsize=letters)
        panel.tick_params(labelsize=letters)
        panel.grid(visible=True, alpha=0.3)
        if label is not None:
            lines[0].set_label(label)
        if name != "D_hat":
            _clip(panel)
        elif D is not None:
            for delay in np.unique(array_checks.floats("D", D)):
                panel.axhline(delay, color="black", linestyle="--", linewidth=0.8)
    axes[-1].set_xlabel(f"t ({loops.time_unit})", fontsize=letters)
    if label is not None:  # above the panels, where no line is
        longest = max(map(len, axes[0].get_legend_handles_labels()[1]))
        room = 72 * axes[0].figure.bbox.width / axes[0].figure.dpi / letters  # in letters, beside which stands a line
        columns = max(1, int(room / (LETTER * longest + LINE)))
        axes[0].legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=columns, frameon=False, fontsize=letters)
    return axes


def _chosen(loops: Any, signals: Sequence[str]) -> dict[str, np.ndarray]:
    """The series that are a signal of these, or of its letter X or U, in the order of the signals."""
    every, chosen = dict(series(loops)), dict[str, np.ndarray]()
    names = [*every]
    of = {"X": names[: loops.X.shape[-1]], "U": names[loops.X.shape[-1] : -1]} | {name: [name] for name in names}
    for signal in [signals] if isinstance(signals, str) else signals:
        if signal not in of:
            raise ConfigError(unlisted("signals", signal, of))
        chosen |= {name: every[name] for name in of[signal]}
    if not chosen:
        raise ConfigError(f"signals: expected at least one of {', '.join(of)}, got none; give some")
    return chosen


def _label(loops: Any, name: str) -> str:
    """A series as matplotlib sets it: its label, or its name in letters, and its unit."""
    declared = name.removeprefix("X.").removeprefix("U.")
    if name == "D_hat":
        return notation.mathematics(notation.with_unit(notation.D_HAT, loops.time_unit))
    text = notation.raised((loops.labels or {}).get(declared) or notation.spelt(declared))
    return notation.mathematics(notation.with_unit(text, (loops.units or {}).get(declared, "")))


def _lost(loops: Any) -> np.ndarray:
    """Which loops run away, (count,): they leave the numbers, or the last tenth is still beyond all before it."""
    X = np.abs(loops.X.reshape(-1, *loops.X.shape[-2:]))
    last = max(int((1 - TAIL) * X.shape[1]), 1)
    before, after = X[:, :last].max(axis=1), X[:, last:].max(axis=1, initial=0.0)
    return (loops.escaped.reshape(-1) >= 0) | ~np.isfinite(X).all(axis=(1, 2)) | (after > GROWTH * before).any(axis=1)


def _clip(panel: Any) -> None:
    """Let lost loops leave a panel, so that others can be seen; alone, at REACH times the first tenth of the finite."""
    lines = [(line.get_gid(), np.asarray(line.get_ydata(), dtype=float)) for line in panel.lines]
    kept, lost = ([y for of, y in lines if (of == LOST) == is_lost and len(y)] for is_lost in (False, True))
    if not lost:
        return
    if not any(of == KEPT for of, _ in lines):
        for y in lost:
            size = np.abs(y[: len(y) if np.isfinite(y).all() else int(np.argmin(np.isfinite(y)))])
            reach = REACH * size[: max(int(TAIL * len(size)), 1)].max(initial=1.0)
            kept.append(y[: len(size)][np.maximum.accumulate(size) <= reach])
    panel.set_autoscaley_on(False)  # the range of all lines overflows
    panel.set_ylim(around(kept, lost))


def around(series: Sequence[np.ndarray], others: Sequence[np.ndarray]) -> tuple[float, float]:
    """The range of all series, and of those others that leave it by less than its height; with room on both sides."""

    def span(values: np.ndarray) -> tuple[float, float] | None:
        finite = values[np.isfinite(values)]
        return (float(finite.min()), float(finite.max())) if len(finite) else None

    low, high = span(np.concatenate(series)) or (0.0, 1.0)
    near = [ends for ends in map(span, others) if ends and max(low - ends[0], ends[1] - high) < high - low]
    low, high = min([low, *(a for a, _ in near)]), max([high, *(b for _, b in near)])
    room = 0.15 * (high - low) or 1.0
    return low - room, high + room


def html(loops: Any) -> str:
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


def _size(panels: int, size: str | tuple[float, float] | None = None) -> tuple[float, float]:
    """Width and height of their figure, in inches. Raises ConfigError for what is no size."""
    if size is None:
        return 6.4, 1.0 + 1.2 * panels
    if size == "article":
        return 3.5, 0.5 + 0.85 * panels
    try:
        width, height = map(float, size)  # type: ignore[arg-type]
        if width > 0 and height > 0:
            return width, height
    except (TypeError, ValueError):
        pass
    raise ConfigError(f'size: expected "article", or width and height in inches, got {size!r}; as (7, 4)')


def dataframe(loops: Any) -> Any:
    """A row per loop and time, a column per series; the index is batch axes, then t. Raises MissingError."""
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


def series(loops: Any) -> Iterator[tuple[str, np.ndarray]]:
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
