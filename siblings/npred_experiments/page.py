"""Published experiments as one page, and as Markdown: published numbers beside measured ones."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from importlib.resources import files
from statistics import median
from typing import Any, NamedTuple

from npred.base.registry import NETWORKS
from npred.lab.report.figures.figure import Figure, LegendEntry, Panel
from npred.lab.report.figures.style import LineStyle, log, short
from npred.lab.report.figures.table import Column, Table
from npred_experiments.experiment import CORRECTED, NUMERICAL, Reproduced, ReproducedRow, load
from npred_experiments.rows import cells_of

TITLE = "Published experiments"
ABOUT = (
    "Published predictor-feedback experiments, run by npred. As published: in the published loop, with its errors. "
    "As meant: the same quantity with the right plant, law, transport and metric. Networks are npred's, of the "
    "published kinds."
)
PRINTED = "The table has the first metric of which a source prints a number; `npred reproduce NAME` prints all."
LINES = {
    "published": LineStyle("crimson", width=0, marker="X"),
    "npred's network": LineStyle("blue", width=0, marker="o"),
}
LEAST = 1e-7  # a distance that is shown


class Digits(float):
    """A number that is written with the digits that its source prints."""

    text: str

    def __new__(cls, value: float, text: str) -> "Digits":
        """The number, and how it is written."""
        number = super().__new__(cls, value)
        number.text = text
        return number

    def __format__(self, form: str) -> str:
        return self.text


class Excess(NamedTuple):
    """How far a network's row is from the numerical predictor's, as a share of it."""

    experiment: str
    metric: str
    network: str
    published: float | None
    measured: float | None


def page(results: Sequence[Reproduced]) -> str:
    """The page as HTML that needs nothing else; the same results give the same bytes."""
    from npred.lab.stages.report import html_page

    figure = _excesses_drawn(excesses(results))
    names = [result.name for result in results]
    return html_page.filled(
        (files("npred_experiments") / "page.html").read_text(encoding="utf-8"),
        name=TITLE,
        about=ABOUT,
        said=summary(results),
        figures=[figure] if figure else [],
        chapters=[_chapter(result) for result in results],
        facts={"Experiments": {name: load(name).source for name in names}},
        names="".join(f" {name}" for name in names),
    )


def markdown(results: Sequence[Reproduced]) -> str:
    """The first metric of which a source prints a number, as a page of the documentation; the other page has all."""
    printed = [result.model_copy(update={"rows": _first_printed(result)}) for result in results]
    names = [f"`{result.name}`" if i == 0 else "" for result in printed for i in range(len(result.rows))]
    alike = zip(*(_rows(result).columns for result in printed), strict=True)
    others = [replace(columns[0], values=[v for column in columns for v in column.values]) for columns in alike]
    table = Table("rows", "", [Column("experiment", names), *others])
    return "\n".join([f"# {TITLE}, measured", "", ABOUT, PRINTED, "", *summary(results), "", table.markdown(), ""])


def _first_printed(result: Reproduced) -> list[ReproducedRow]:
    rows = [row for row, _ in _printed(result)]
    return [row for row in rows if row.metric == rows[0].metric]


def summary(results: Sequence[Reproduced]) -> list[str]:
    """The result, in at most three sentences, each counted from the rows."""
    printed = [(row, cells) for result in results for row, cells in _printed(result) if row.predictor == NUMERICAL]
    same = sum(cells[3] in cells[4:] for _, cells in printed)
    sentences = [f"Of {len(printed)} printed numbers of numerical predictors, {same} have the same digits here."]
    pairs = [(e.published, e.measured) for e in excesses(results) if e.published and e.measured is not None]
    if pairs:
        nearer = sum(here < there for there, here in pairs)
        ratio = median(there / max(here, 1e-9) for there, here in pairs)
        sentences.append(
            f"Of {len(pairs)} printed numbers of networks, npred's network of the same kind is nearer to the numerical "
            f"predictor's in {nearer}; in the median, {short(ratio)} times nearer."
        )
    trained = [each for result in results for each in result.trained]
    if trained:
        most = max(each.seconds for each in trained)
        sentences.append(f"{len(trained)} networks were trained, each in at most {most:.0f} s.")
    return sentences


def excesses(results: Sequence[Reproduced]) -> list[Excess]:
    """Each network's row in the published loop against the numerical row: |network - numerical| / numerical, of printed
    numbers against the printed one.

    Where the numerical row is zero to the printed digits, an error of prediction say, the network's error itself.
    """
    return [excess for result in results for excess in _excesses(result)]


def _excesses(result: Reproduced) -> Iterator[Excess]:
    numerical = {row.metric: row for row in result.rows if row.predictor == NUMERICAL}
    for row in result.rows:
        base = numerical.get(row.metric)
        if row.predictor == NUMERICAL or base is None or row.published is None or base.as_published is None:
            continue
        exact, rounding = base.as_published, abs(base.as_published) < 1e-6
        scale = 1.0 if rounding else abs(exact)
        printed = exact if base.published is None else base.published
        measured = None if row.as_published is None else abs(row.as_published - exact) / scale
        yield Excess(result.name, row.metric, row.predictor, abs(row.published - printed) / scale, measured)


def _excesses_drawn(rows: Sequence[Excess]) -> Figure | None:
    """One panel per experiment: published and measured distances from the numerical row."""
    names = list(dict.fromkeys(row.experiment for row in rows if row.measured is not None))
    panels = tuple(_panel(name, [row for row in rows if row.experiment == name]) for name in names)
    caption = (
        "Distance of a network's row from the numerical predictor's, as a share of it (an error itself, where the "
        "numerical one is zero), in the published loop."
    )
    legend = [LegendEntry(label, style) for label, style in LINES.items()]
    return Figure("excess", "Networks and the numerical predictor", caption, panels, legend) if panels else None


def _panel(name: str, rows: Sequence[Excess]) -> Panel:
    labels = [f"{_label(row.network)}, {row.metric}" for row in rows]

    def draw(axis: Any) -> None:
        places = range(len(rows))
        for values, style in zip(
            zip(*((r.published, r.measured) for r in rows), strict=True), LINES.values(), strict=True
        ):
            shown = [float("nan") if value is None else max(value, LEAST) for value in values]
            axis.plot(shown, places, linestyle="none", marker=style.marker, color=style.colour)
        log(axis, "x")
        axis.set(yticks=list(places), yticklabels=labels, ylim=(len(rows) - 0.5, -0.5))

    alt = "; ".join(
        f"{label}: published {_share(r.published)}, here {_share(r.measured)}"
        for label, r in zip(labels, rows, strict=True)
    )
    return Panel(_heading(name), alt, draw)


def _share(value: float | None) -> str:
    return "none" if value is None else short(value)


def _chapter(result: Reproduced) -> dict[str, Any]:
    experiment = load(result.name)
    return {"id": result.name, "title": _heading(result.name), "source": experiment.source, "tables": tables(result)}


def _heading(name: str) -> str:
    title = load(name).title
    return title[0].upper() + title[1:]


def tables(result: Reproduced) -> list[Table]:
    """The rows of an experiment, the times of predictions, and the networks that were trained."""
    return [_rows(result), *_times(result), *_trained(result)]


def _rows(result: Reproduced) -> Table:
    rows = [(row, cells) for row, cells in zip(result.rows, cells_of(result), strict=True)]
    numbers = [
        Column(head, [_digits(getattr(row, key), cells[place]) for row, cells in rows], "s")
        for head, key, place in (
            ("published", "published", 3),
            ("as published", "as_published", 4),
            ("as meant", "as_meant", 5),
        )
    ]
    columns = [
        Column("predictor", [_label(row.predictor) for row, _ in rows]),
        Column("metric", [row.metric for row, _ in rows]),
        *numbers,
    ]
    return Table(f"{result.name}-rows", "Published and measured", columns)


def _times(result: Reproduced) -> Iterator[Table]:
    times = result.times
    if not times:
        return
    yield Table(f"{result.name}-times", "Time of one prediction", [
        Column("predictor", [_label(each.predictor) for each in times]),
        Column("of one prediction", [each.setting for each in times]),
        Column("published, ms", [each.published_ms for each in times], ".3g"),
        Column("here, ms", [each.ms for each in times], ".3g"),
        Column("sup error", [each.error for each in times], digits=2),
    ])  # fmt: skip


def _trained(result: Reproduced) -> Iterator[Table]:
    trained = result.trained
    if not trained:
        return
    yield Table(f"{result.name}-networks", "Networks trained here", [
        Column("network", [_label(each.network) for each in trained]),
        Column("loop", [each.loop for each in trained]),
        Column("parameters", [each.parameters for each in trained], ",d"),
        Column("samples", [each.samples for each in trained], ",d"),
        Column("epochs", [each.epochs for each in trained], "d"),
        Column("mean square, held out", [each.mse for each in trained], digits=2),
        Column("sup error, held out", [each.eps_sup for each in trained], digits=2),
        Column("seconds", [each.seconds for each in trained], ".0f"),
    ])  # fmt: skip


def _printed(result: Reproduced) -> Iterator[tuple[ReproducedRow, list[str]]]:
    """The rows of which a number is printed."""
    for row, cells in zip(result.rows, cells_of(result), strict=True):
        if row.published is not None:
            yield row, cells


def _digits(value: float | None, text: str) -> Digits | None:
    return None if value is None else Digits(value, text)


def _label(predictor: str) -> str:
    return CORRECTED.get(predictor, predictor if predictor == NUMERICAL else NETWORKS.label(predictor))
