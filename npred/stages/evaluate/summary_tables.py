"""Tables of an evaluation for the terminal: errors, radii and loops that converge, in short and in full."""

from collections.abc import Iterator, Mapping
from math import isfinite

from npred.figures.style import short
from npred.results import Evaluated, PredictorId
from npred.results.evaluate import Behaviour, Scores
from npred.terminal.console import columns

ERRORS = {"MSE": "mse", "ε sup": "eps_sup", "ε κ": "eps_kappa"}
LIMITS = ["least h", "filtered", "unkept"]
RADII = {"radius": "median", "worst": "worst", "from ε κ": "predicted"}


def summary(result: Evaluated, width: int | None = None) -> str:
    """The samples of the errors, and the table of each predictor."""
    return f"{_title(result)}\n\n{table(result, width)}"


def table(result: Evaluated, width: int | None = None, microseconds: Mapping[PredictorId, float] | None = None) -> str:
    """Each predictor's largest error, worst radius and number of loops that converge; and the time of a call, if given.

    Errors are against the numerical predictor: where it predicts, there is none.
    """
    head = ["predictor", "ε sup", "worst radius", "converged"]
    head += LIMITS[:1] if any(scores.limits for scores in result.models.values()) else []
    rows = [[contender.label, *_cells(scores)] for contender, scores in result.models.items()]
    if microseconds is not None:
        head.append("µs per call")
        for contender, row in zip(result.models, rows, strict=True):
            row.append(f"{microseconds[contender]:.1f}" if contender in microseconds else "–")
    return columns(head, rows, width, numbers=head[1:])


def details(result: Evaluated, width: int | None = None) -> str:
    """All numbers of each predictor, in a table wider than most screens."""
    rows = [_all(contender, scores, result) for contender, scores in result.models.items()]
    table = columns(list(rows[0]), [list(row.values()) for row in rows], width)
    return "\n\n".join([_title(result), table, *_scenarios(result, width)])


def _scenarios(result: Evaluated, width: int | None) -> Iterator[str]:
    """The cases under other conditions, where a pipeline has any."""
    does = [behaviour for each in result.scenarios for behaviour in each.models.values()]
    head = ["scenario", "predictor", "radius", "worst", "converged", "lost", "settles", "|D̂ − D|"]
    head += ["fallback"] if any(each.fallback is not None for each in does) else []
    head += LIMITS if any(each.limits for each in does) else []
    rows = [
        [scenario.name, c.label, _cell(does.radius.median), _cell(does.radius.worst), f"{does.radius.converged:.0%}",
         str(does.lost), _cell(does.settle_time, ".1f"), "" if does.D_error is None else _cell(does.D_error, ".3f"),
         *([_share(does.fallback)] if "fallback" in head else []), *_limits(does)]
        for scenario in result.scenarios
        for c, does in scenario.models.items()
    ]  # fmt: skip
    if rows:
        yield columns(head, rows, width, numbers=head[2:])


def _title(result: Evaluated) -> str:
    rows = f"{result.held_out} held-out samples ({result.held_out_kind}), {result.fresh} fresh ones"
    return f"{result.plant}: {rows}, and closed loops"


def _cells(scores: Scores) -> list[str]:
    converged = f"{scores.radius.count} of {scores.radius.cases}"
    error = "–" if scores.eps_sup == 0 else short(scores.eps_sup)
    return [error, short(scores.radius.worst), converged, *_limits(scores)[:1]]


def _all(contender: PredictorId, scores: Scores, result: Evaluated) -> dict[str, str]:
    radius, end, kinds = scores.radius, scores.figure1, list(result.kinds)[1:]
    cells = {"predictor": contender.label} | {head: _cell(getattr(scores, key)) for head, key in ERRORS.items()}
    cells |= {f"{kind}: ε sup": _cell(scores.kinds[kind].eps_sup) for kind in kinds}
    cells |= {f"fresh: {head}": _cell(getattr(scores.fresh, key)) for head, key in ERRORS.items() if head != "ε κ"}
    cells |= {"in the loop": _cell(scores.in_loop) if contender.adapts else ""}
    cells |= {head: _cell(getattr(radius, key)) for head, key in RADII.items()}
    cells |= {"converged": f"{radius.converged:.0%}"}
    cells |= {"settles": "" if scores.settle_ratio is None else f"{scores.settle_ratio:.2f} ×"}
    guarded = any(each.fallback is not None for each in result.models.values())
    cells |= {"fallback": _share(scores.fallback)} if guarded else {}
    cells |= dict(zip(LIMITS, _limits(scores), strict=False))
    cells |= {"map": f"{scores.map.share:.0%}" if scores.map else "", "Fig. 1": _cell(end.radius)}
    cells |= {"D̂" if result.in_loop.D is not None else "D": _cell(end.D_hat_end, ".3f")}
    bounded = scores.figure1_bounded
    return cells | ({"U bounded": _cell(bounded.radius), "its D̂": _cell(bounded.D_hat_end, ".3f")} if bounded else {})


def _limits(does: Scores | Behaviour) -> list[str]:
    """The cells below LIMITS; none of a plant without limits."""
    if does.limits is None:
        return []
    least, filtered, unkept = does.limits.least, does.limits.filtered, does.limits.unkept
    return ["lost" if least is None else f"{least:.3g}", _share(filtered), "" if unkept is None else str(unkept)]


def _share(value: float | None) -> str:
    return "" if value is None else f"{value:.2%}"


def _cell(value: float, form: str = ".1e") -> str:
    return format(value, form) if isfinite(value) else "∞"
