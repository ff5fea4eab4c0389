"""An evaluation for people: who errs by how much and whose loops converge, and all that was measured of them."""

from collections.abc import Mapping
from typing import Any

from npred.figures.style import short, words
from npred.terminal.console import columns

Row = dict[str, Any]
ERRORS = {"MSE": "mse", "ε sup": "eps_sup", "ε κ": "eps_kappa"}
RADII = {"radius": "median", "worst": "worst", "from ε κ": "predicted"}


def summary(result: Row, width: int | None = None) -> str:
    """What the errors are of, and the table of each predictor."""
    return f"{_title(result)}\n\n{table(result, width)}"


def table(result: Row, width: int | None = None, microseconds: Mapping[str, float] | None = None) -> str:
    """Each predictor's largest error, worst radius and number of loops that converge; and the time of a call, if given.

    Errors are against the numerical predictor: where it predicts, there is none.
    """
    head = ["predictor", "ε sup", "worst radius", "converged"]
    rows = [[words(name), *_row(row)] for name, row in result["models"].items()]
    if microseconds is not None:
        head.append("µs a call")
        for name, row in zip(result["models"], rows, strict=True):
            row.append(f"{microseconds[name]:.1f}" if name in microseconds else "–")
    return columns(head, rows, width, numbers=head[1:])


def details(result: Row, width: int | None = None) -> str:
    """All numbers of each predictor, in a table wider than most screens."""
    rows = [_all(name, row, _kinds(result)[1:]) for name, row in result["models"].items()]
    return f"{_title(result)}\n\n{columns(list(rows[0]), [list(row.values()) for row in rows], width)}"


def _title(result: Row) -> str:
    rows = f"{result['held_out']} held-out samples ({_kinds(result)[0]}), {result['fresh']} fresh ones"
    return f"{result['plant']}: {rows}, and closed loops"


def _kinds(result: Row) -> list[str]:
    """The kinds of held-out rows; the first are those that the headline's errors are of."""
    return list(result["kinds"])


def _row(row: Row) -> list[str]:
    radius = row["radius"]
    converged = f"{round(radius['converged'] * radius['cases'])} of {radius['cases']}"
    return ["–" if row["eps_sup"] == 0 else short(row["eps_sup"]), short(radius["worst"]), converged]


def _all(name: str, row: Row, kinds: list[str]) -> dict[str, str]:
    radius, figure = row["radius"], row["figure1"]
    cells = {"predictor": words(name)} | {head: _text(row[key]) for head, key in ERRORS.items()}
    cells |= {f"{kind}: ε sup": _text(row["kinds"][kind]["eps_sup"]) for kind in kinds}
    cells |= {f"fresh: {head}": _text(row["fresh"][key]) for head, key in ERRORS.items() if head != "ε κ"}
    cells |= {"in the loop": _text(row["in_loop"])}
    cells |= {head: _text(radius[key]) for head, key in RADII.items()}
    cells |= {"converged": f"{radius['converged']:.0%}"}
    cells |= {"settles": "" if row["settle_ratio"] is None else f"{row['settle_ratio']:.2f} ×"}
    cells |= {"map": f"{row['map']['share']:.0%}" if row["map"] else "", "Fig. 1": _text(figure["radius"])}
    return cells | {"D̂": "∞" if figure["D_hat_end"] is None else f"{figure['D_hat_end']:.3f}"}


def _text(value: float | None) -> str:
    return "∞" if value is None else f"{value:.1e}"
